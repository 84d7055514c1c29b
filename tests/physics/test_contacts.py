"""Bodies that float and touch: weights, friction, stacks, and what the history has of them."""

from __future__ import annotations

import shutil

import numpy as np
import pytest

import tipfem as tp
from tipfem.backend.launch import launch
from tipfem.errors import Invalid
from tipfem.geometry.plane.domain import Domain
from tipfem.geometry.plane.touching import SKIN
from tipfem.linalg.newton import newton
from tipfem.physics.bodies.motion import BodyStates
from tipfem.physics.bodies.physics import Bodies
from tipfem.physics.contact.candidates import candidates
from tipfem.physics.contact.forces import Contacts, Law, balanced
from tipfem.physics.contact.kernels import sweep
from tipfem.step import solve as step_solve

WATER = tp.Fluid("water", density=1000.0, viscosity=1e-3)
H, G = 0.05, 9.81
rectangle = tp.shapes.rectangle


def run_of(*bodies, water=((0, 0), (0.2, 0.1)), size=(1.6, 0.8), gravity=(0.0, -G), at=(0.0, 0.0)):
    """A tank with bodies, and some water."""
    start = np.array(at)
    corners = [tuple(start + corner) for corner in ((0, 0), (size[0], 0), size, (0, size[1]))]
    tank = tp.tank(shape=tp.shapes.polygon(corners), spacing=H).fill(WATER, box=tuple(start + c for c in water))
    for body in bodies:
        tank.add(body)
    return tp.Case(tank, [WATER], gravity, free_surface=True)


def box(low, high, name="box", at=(0.0, 0.0), **options):
    """A body that may touch, of 800 kg/m^3 and with seeping gaps unless options say otherwise."""
    shift = np.array(at)
    options = {"density": 800.0, "gap": "seep", "friction": 0.3, **options}
    return tp.Body(rectangle(shift + low, shift + high), name=name, **options)


def rows_until(simulation: tp.Simulation, time: float) -> list[dict[str, float]]:
    """The history of a run."""
    while simulation.time < time:
        simulation.step()
    return simulation.history


@pytest.mark.parametrize(("gap", "carried", "within"), [("seep", 0.6, 1e-6), ("seal", 1.795, 3e-5)])
@pytest.mark.parametrize("at", [(0.0, 0.0), (-3.0, 7.0)])
def test_box_on_the_floor_under_water(gap, carried, within, at):
    """It carries its weight less its buoyancy; sealed, its weight and that of the 0.3975 m of water on it."""
    block = box((0.4, 0), (0.8, 0.2), density=2500.0, gap=gap, at=at)
    simulation = tp.Simulation(run_of(block, water=((0, 0), (1.2, 0.6)), size=(1.2, 0.9), at=at))
    weight = block.total_mass * G
    for row in rows_until(simulation, 0.05):
        assert abs(row["box_contact_force_y"] / weight - carried) < within
        assert abs(row["box_velocity_y"]) < 1e-6
        assert row["box_touches"] == 2
        assert not row["impact"]
        assert abs(row["energy_residual"]) < 1e-9
    assert abs(simulation.state.volume_error) < 1e-12


def test_steps_at_rest_begin_with_the_contacts_of_the_last_one():
    """Half of them or more need no correction, and what rests is quiet."""
    block = box((0.4, 0), (0.8, 0.2), density=2500.0)
    simulation = tp.Simulation(run_of(block, water=((0, 0), (1.2, 0.6)), size=(1.2, 0.9)), time_step=4e-3)
    rows = rows_until(simulation, 0.178)
    assert sum(row["newton_iterations"] for row in rows[-20:]) <= 10
    assert max(abs(row["box_velocity_y"]) for row in rows[-20:]) < 1e-11
    assert np.isfinite(simulation.state.part(BodyStates).contacts.lightness).all()


def test_box_on_a_slope():
    """It stands where the slope is less than its friction, and slides as Coulomb's law has it where it is more."""
    for slope in (0.29, 0.31):
        angle = np.arctan(slope)
        gravity = G * np.array([np.sin(angle), -np.cos(angle)])
        simulation = tp.Simulation(run_of(box((0.5, 0), (0.8, 0.2)), gravity=tuple(gravity)))
        row = rows_until(simulation, 0.1)[-1]
        speed = max(0.0, G * (np.sin(angle) - 0.3 * np.cos(angle))) * row["time"]
        assert abs(row["box_velocity_x"] - speed) < 1e-5
        normal = row["box_contact_force_y"]
        assert abs(normal / (48.0 * G * np.cos(angle)) - 1) < 1e-5
        friction = min(0.3, slope) * normal
        assert abs(row["box_contact_force_x"] + friction) < 1e-4 * normal
        works = [row["contact_dissipation"] for row in simulation.history]
        moved = simulation.history[-1]["box_x"] - 0.65
        assert abs(sum(works) - 0.3 * normal * moved) < 1e-3 * normal * max(moved, 1e-6)
        assert max(abs(row["energy_residual"]) for row in simulation.history) < 1e-10


def test_stack_stands():
    """Each body carries what is on it."""
    low, up = box((0.4, 0), (0.8, 0.2), "low"), box((0.45, 0.2), (0.7, 0.35), "up", density=1200.0)
    simulation = tp.Simulation(run_of(up, low))
    for row in rows_until(simulation, 0.05):
        assert abs(row["low_contact_force_y"] / (low.total_mass * G) - 1) < 1e-8
        assert abs(row["up_contact_force_y"] / (up.total_mass * G) - 1) < 1e-8
        assert row["low_touches"] == 4
        assert max(abs(row[f"{name}_velocity_y"]) for name in ("low", "up")) < 1e-9
    assert abs(row["up_y"] - (0.275 + 2 * SKIN * H)) < 1e-10


@pytest.mark.slow
def test_body_that_falls():
    """It comes to rest, and its energy is accounted for."""
    block = box((0.6, 0.25), (0.9, 0.4))
    simulation = tp.Simulation(run_of(block))
    fall = np.sqrt(2 * (0.25 - SKIN * H) / G)
    rows = rows_until(simulation, fall + 0.05)
    late = [row["box_y"] - 0.075 - SKIN * H for row in rows if row["time"] > fall * 1.05]
    assert min(row["box_y"] for row in rows) > 0.075 + 0.99 * SKIN * H
    assert max(abs(row["energy_residual"]) for row in rows) < 1e-9
    assert max(np.abs(late)) < 1e-6
    assert abs(rows[-1]["box_velocity_y"]) < 1e-5  # it fell at 2.2 m/s


@pytest.mark.slow
@pytest.mark.parametrize("e", [0.8, 0.4])
def test_body_bounces(e):
    """With e times the speed, and by e^2 of its fall; its energy is accounted for."""
    fall = 0.25 - SKIN * H
    simulation = tp.Simulation(run_of(box((0.6, 0.25), (0.9, 0.4), restitution=e)))
    rows = rows_until(simulation, np.sqrt(2 * fall / G) * (1 + 1.8 * e))
    heights = np.array([row["box_y"] - 0.075 - SKIN * H for row in rows])
    least = heights.argmin()
    assert rows[least + 1]["box_velocity_y"] == pytest.approx(-e * rows[least]["box_velocity_y"], rel=1e-2)
    assert heights[least:].max() == pytest.approx(e**2 * fall, rel=0.02)
    assert heights.min() > -1e-3 * SKIN * H
    assert max(abs(row["energy_residual"]) for row in rows) < 1e-9


@pytest.mark.slow
@pytest.mark.parametrize(("left", "low"), [(1.0, 0.2), (0.45, 0.4)])
def test_body_that_rests_while_another_one_falls(left, low):
    """Beside it or onto it: the forces on it add up to its weight in all steps, those after the impact, too."""
    block = box((0.4, 0), (0.8, 0.2), "block", density=1200.0)
    simulation = tp.Simulation(run_of(block, box((left, low), (left + 0.3, low + 0.15))))
    rows = rows_until(simulation, 0.23)
    assert any(row["impact"] for row in rows)
    assert rows[-1]["box_touches"] == 2
    forces = np.array([row["block_contact_force_y"] for row in rows])
    assert np.abs(forces / (block.total_mass * G) - 1).max() < 1e-5


@pytest.mark.slow
def test_dam_break_pushes_a_box():
    """It slides with the friction of Coulomb's law, and does not rise."""
    block = box((0.5, 0), (0.7, 0.2), density=1500.0, gap="seal")
    simulation = tp.Simulation(run_of(block, water=((0, 0), (0.3, 0.4))))
    rows = rows_until(simulation, 0.35)
    slides = [row for row in rows if row["box_velocity_x"] > 0.02 and not row["impact"]]
    assert rows[-1]["box_x"] > 0.61
    assert len(slides) > 5
    for row in slides:
        assert abs(row["box_contact_force_x"] / (0.3 * row["box_contact_force_y"]) + 1) < 1e-3
        assert abs(row["energy_residual"]) < 1e-11
        assert abs(row["box_y"] - (0.1 + SKIN * H)) < 1e-5
    assert simulation.state.volume_error < 1e-12


@pytest.mark.slow
def test_contacts_are_found_by_the_iterations_of_the_fluids():
    """In water that moves, a box on the floor asks for one iteration more than the same box afloat, at most."""
    found = []
    for low, options in ((0.0, {"density": 2500.0}), (0.4, {"density": 500.0, "gap": None, "friction": None})):
        case = run_of(box((0.9, low), (1.2, low + 0.15), **options), water=((0, 0), (1.6, 0.45)), gravity=(0.3, -G))
        rows = rows_until(tp.Simulation(case), 0.2)[3:]
        assert max(row["max_speed"] for row in rows) > 0.03
        found.append(np.mean([row["newton_iterations"] for row in rows]))
    on_floor, afloat = found
    assert on_floor < afloat + 1


def test_steps_with_a_contact_are_solved_once(monkeypatch):
    """In water that moves: what contacts ask for is found by the iterations, not by solving again."""
    solves, again = [], Bodies.again
    monkeypatch.setattr(Bodies, "again", lambda *given: solves.append(1) or again(*given))
    simulation = tp.Simulation(
        run_of(box((0.9, 0.0), (1.2, 0.15), density=2500.0), water=((0, 0), (1.6, 0.45)), gravity=(0.3, -G))
    )
    rows_until(simulation, 0.03)
    solves.clear()
    before = len(simulation.history)
    rows_until(simulation, 0.2)
    assert len(solves) < 1.2 * (len(simulation.history) - before)


@pytest.mark.slow
def test_solving_again_begins_where_the_last_solve_ended(monkeypatch):
    """With the motion of bodies, and of the water that slides along them: the first residual is a small part."""
    firsts, ratios, again, solve = [], [], Bodies.again, newton
    monkeypatch.setattr(Bodies, "again", lambda *given: (found := again(*given), found[1] and firsts.clear())[0])

    def recorded(problem, x, **options):
        firsts.append(problem.residual(x))
        ratios.extend([firsts[-1] / firsts[0]] * (len(firsts) > 1))
        return solve(problem, x, **options)

    monkeypatch.setattr(step_solve, "newton", recorded)
    simulation = tp.Simulation(run_of(box((0.5, 0), (0.7, 0.2), density=1500.0), water=((0, 0), (0.3, 0.4))))
    rows_until(simulation, 0.4)
    assert len(ratios) > 1
    assert np.median(ratios) < 0.02


@pytest.mark.slow
def test_box_goes_on_from_a_checkpoint(tmp_path):
    """To the bit, while it lands."""

    def case():
        return run_of(box((0.6, 0.05 + 2 * H), (0.9, 0.3)))

    whole = tp.Simulation(case(), tmp_path / "run")
    whole.run(0.15, progress=False)
    shutil.copytree(tmp_path / "run", tmp_path / "part")
    whole.run(0.25, progress=False)
    resumed = tp.Simulation.resume(tmp_path / "part", case())
    resumed.run(0.25, progress=False)
    assert any(row["box_touches"] for row in whole.history)
    np.testing.assert_array_equal(resumed.particles.position, whole.particles.position)
    for name in ("box_y", "box_velocity_y", "box_contact_force_y", "contact_dissipation"):
        assert resumed.history[-1][name] == whole.history[-1][name]


def places(angle: float = 0.1):
    """A tilted box over a floor and over another box, with their poses."""
    tank = Domain([np.array([[0, 0], [1, 0], [1, 1], [0, 1.0]])], [["t"] * 4], [[-1] * 4])
    low = np.array([[0.2, 0.01], [0.6, 0.01], [0.6, 0.2], [0.2, 0.2]])
    c, s = np.cos(angle), np.sin(angle)
    up = np.array([[-0.1, 0], [0.1, 0], [0.1, 0.1], [-0.1, 0.1]]) @ np.array([[c, s], [-s, c]]) + (0.4, 0.22)
    outlines = [tank, *(Domain([of], [["b"] * 4], [[-1] * 4]) for of in (low, up))]
    pose = np.array([[0, 0, 0], [0.3, 0.1, 0.0], [0.4, 0.22, angle]])
    may = np.ones((3, 3), dtype=bool)
    np.fill_diagonal(may, False)
    return candidates(outlines, pose, may, H), pose


def test_rows_are_derivatives_of_gaps():
    """By finite differences, of both solids."""
    found, pose = places()
    assert {tuple(key[:2]) for key in found.key.tolist()} == {(1, 0), (2, 1)}
    normal, _ = found.rows(pose)
    for k in range(pose.size):
        step = np.zeros(pose.size)
        step[k] = 1e-6
        change = found.gaps(pose + step.reshape(pose.shape)) - found.gaps(pose - step.reshape(pose.shape))
        assert normal[:, k] == pytest.approx(change / 2e-6, abs=1e-8)


def test_sweeps_obey_the_law():
    """Signorini's conditions and Coulomb's, for random loads on one box."""
    found, pose = places(0.0)
    count, rng = len(found), np.random.default_rng(3)
    free, lengths = np.repeat([True, True], 3), np.array([0.2, 0.1])
    given = np.full(count, 0.4), free, lengths, H, G, 1e-2, 1e4
    law = Law(found, pose, np.zeros((3, 3)), *given)
    mobility, none = np.diag([1.0, 1, 5, 2, 2, 9]) * 1e-6, Contacts.none(np.eye(6))
    assert (none.of(found.key)[1] == 2).all()
    for _ in range(5):
        increment = 0.02 * rng.standard_normal((2, 3)) * (1, 1, 0.0)
        force = law.adjusted(np.zeros((count, 2)), increment, mobility)
        moved = increment + (mobility @ law.wrench(force, increment).ravel()).reshape(2, 3)
        normal, along = law.places.rows(pose + np.vstack([np.zeros(3), 0.5 * increment]))
        change = (moved - increment).ravel()
        gap = law.gaps(increment) + normal[:, 3:] @ change - law.skin
        slip = law.slips(increment) + along[:, 3:] @ change
        assert force[:, 0].min() >= 0
        assert gap.min() > -1e-8
        assert np.abs(gap * force[:, 0]).max() < 1e-6 * max(force[:, 0].max(), 1)
        assert (np.abs(force[:, 1]) <= 0.4 * force[:, 0] * (1 + 1e-12)).all()
        slides = (np.abs(slip) > 1e-7) & (force[:, 0] > 0)
        assert force[slides, 1] == pytest.approx(-0.4 * force[slides, 0] * np.sign(slip[slides]))


def test_slopes_without_friction_are_noted():
    """Of the tank and of a body below; not where one of the two has friction, nor on a level floor."""

    def doubts(gravity=(2.0, -9.6), **options):
        return run_of(box((0.5, 0), (0.8, 0.2), **options), gravity=gravity).doubts()

    (line,) = doubts(friction=None)
    assert "body 'box' stands on a slope of 0.208 of the tank" in line
    assert "a friction of 0.208 or more keeps it there" in line
    assert doubts() == doubts((0.0, -G), friction=None) == []
    assert doubts(friction=None, free=("angle",)) == []
    low, up = box((0.4, 0), (0.8, 0.2), "low"), box((0.45, 0.2), (0.7, 0.35), "up", friction=0.0)
    assert run_of(low, up, gravity=(2.0, -9.6)).doubts() == []
    slippery = tp.Body(rectangle((0.4, 0), (0.8, 0.2)), name="low", gap="seal")
    (line,) = run_of(slippery, up, gravity=(2.0, -9.6)).doubts()
    assert "body 'up' stands on a slope of 0.208 of body 'low'" in line


@pytest.mark.parametrize("other", [False, True])
def test_body_that_starts_too_near(other):
    """Neither on a wall or a body, nor three spacings off: the error says where it would touch."""
    near = box((0.4, 0.24 if other else 0.02), (0.8, 0.4))
    low = [tp.Body(rectangle((0.3, 0), (0.9, 0.2)), name="low", gap="seal")] if other else []
    with pytest.raises(Invalid, match="To let it touch that, draw it there"):
        run_of(*low, near)


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"density": None}, "needs a density or a mass; say 'seal'"),
        ({"gap": None}, "only a body that may touch others has it"),
        ({"gap": None, "friction": None, "restitution": 0.5}, "only a body that may touch others has it"),
        ({"friction": -0.1}, "friction is -0.1"),
        ({"restitution": 1.5}, "restitution is 1.5"),
    ],
)
def test_what_does_not_work_is_refused(options, told):
    """In a sentence, before the run."""
    with pytest.raises(Invalid, match=told):
        run_of(box((0.6, 0.0), (0.9, 0.2), **options))


def by_sweeps(force, wrong, response, friction, count):
    """Projected Gauss-Seidel, row by row; forces, and gaps and slips with them."""
    force, wrong, size = force.copy(), wrong.copy(), len(friction)
    for _ in range(count):
        for k in range(size):
            for row in (k, k + size):
                asked = force[row] - wrong[row] / response[row, row]
                limit = friction[k] * force[k]
                asked = max(asked, 0.0) if row == k else min(max(asked, -limit), limit)
                wrong += (asked - force[row]) * response[:, row]
                force[row] = asked
    return force, wrong


def test_sweeps_are_those_row_by_row():
    """As many as asked for, or until nothing moves; without a response nothing is done."""
    random = np.random.default_rng(7)
    rows = random.normal(size=(8, 10))
    response, friction, start = rows @ rows.T, np.full(4, 0.3), random.normal(size=8)
    first = np.append(random.uniform(0, 1, 4), np.zeros(4))
    for count in (1, 3, 50):
        force, wrong, moved = first.copy(), start + response @ first, np.zeros(1)
        twin, left = by_sweeps(force, wrong, response, friction, count)
        launch(sweep, response, friction, count, 0.0, force, wrong, moved)
        np.testing.assert_allclose(force, twin, rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(wrong, left, rtol=1e-11, atol=1e-11)
        assert (moved[0] > 0) == (count < 50)
    force, wrong = first.copy(), start + response @ first
    launch(sweep, response, friction, 10_000, 1e-6, force, wrong, moved)
    assert 0 < moved[0] < 1e-6
    launch(sweep, np.zeros((8, 8)), friction, 5, 0.0, first, start, moved)
    assert moved[0] == 0


@pytest.mark.slow
def test_forces_after_a_few_sweeps_are_those_of_many():
    random = np.random.default_rng(5)
    agreed = slid = 0
    for _ in range(20):
        rows = random.normal(size=(10, 12))
        response, friction = rows @ rows.T, np.full(5, 0.3)
        start = random.normal(size=10)
        force, wrong = by_sweeps(np.zeros(10), start, response, friction, 16)
        found = balanced(force, wrong, response, friction, 1e-10, 1e-10)
        many, left = by_sweeps(force, wrong, response, friction, 4000)
        if found is not None:
            np.testing.assert_allclose(response @ (found - many), np.zeros(10), atol=1e-7)
            np.testing.assert_allclose(found, many, atol=1e-6)
            agreed += 1
            slid += bool((np.abs(many[5:]) > 0.299 * many[:5])[many[:5] > 0].any())
        # Of other contacts than those that hold there are none.
        wrong_set = np.where(many > 0, 0.0, 1.0)
        wrong_set[5:] = 0.0
        bad = balanced(wrong_set, left + response @ (wrong_set - many), response, friction, 1e-10, 1e-10)
        assert bad is None or np.allclose(bad, many, atol=1e-6)
    assert agreed > 10
    assert slid > 3


def test_slips_of_a_side_that_do_not_agree():
    """A side that sticks at both ends: its slips cannot both vanish, and the forces are found without a sweep more."""
    rows = np.array([[0.0, 1, -1], [0, 1, 1], [1, 0, 0], [1, 0, 0]])  # of gaps and slips, by x, y and the angle
    response, friction = rows @ np.diag([1.0, 1.0, 3.0]) @ rows.T, np.full(2, 0.3)
    force, off = np.array([2.0, 2.0, 0.1, -0.1]), 1e-8
    wrong = np.array([1e-7, -1e-7, off, -off])
    assert balanced(force, wrong, response, friction, 1e-12, 0.5 * off) is None
    found = balanced(force, wrong, response, friction, 1e-12, 2 * off)
    left = wrong + response @ (found - force)
    assert np.abs(left[:2]).max() < 1e-12
    assert left[2:] == pytest.approx([off, -off], rel=1e-6)
