"""Bodies that float: their exact Jacobian, energy, light bodies, checkpoints; and bodies that are moved."""

from __future__ import annotations

import math

import numpy as np
import pytest
from resumed_runs import require_same_when_resumed

import tipfem as tp
from tipfem.backend import launch
from tipfem.backend.arrays import download
from tipfem.linalg import fgmres, vector_kernels
from tipfem.physics.bodies.contacts import find_contacts
from tipfem.physics.bodies.term import FloatingBodies
from tipfem.step import solve

AIR, WATER = tp.Fluid("air", 1.2, 1.8e-5), tp.Fluid("water", 1000.0, 1e-3)
SYRUP = tp.Fluid("syrup", 1000.0, 5.0)
GRAVITY = (0.0, -9.81)


def box(centre=(0.5, 0.5), turn=0.3, size=(0.3, 0.2)):
    rotation = np.array([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]])
    corners = 0.5 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * size
    return corners @ rotation.T + centre


def half_full(*bodies, fluids=(AIR, WATER), spacing=0.1, **options):
    tank = tp.tank((1.0, 1.0), spacing).fill(fluids[0]).fill(fluids[1], box=((0, 0), (1, 0.5)))
    for body in bodies:
        tank.add(body)
    return tp.Case(tank, list(fluids), GRAVITY, **options)


class _Stop(Exception):
    """Ends a step where its problem has been examined."""


@pytest.mark.parametrize(
    ("pressure", "mass"),
    [("continuous", "lumped"), ("two-sided", "lumped"), ("two-sided", "consistent"), ("free surface", "lumped")],
)
@pytest.mark.parametrize("hinge", [None, (0.45, 0.6)])
def test_the_jacobian_is_exact(monkeypatch, pressure, mass, hinge):
    """The body turns by 0.04 rad in the step; its springs, dampers and weight have their parts in the derivative."""
    moving = {"hinge": hinge} if hinge else {"velocity": (1.0, -0.5)}
    more = {"angular_velocity": 8.0, "stiffness": (1e3, 2e3, 50.0), "damping": (30.0, 40.0, 5.0)}
    body = tp.Body(box(), density=500.0, law="no-slip", **moving, **more)
    if pressure == "free surface":
        tank = tp.tank((1.0, 1.0), 0.1).fill(SYRUP, box=((0, 0), (1, 0.5))).add(body)
        numerics = tp.Numerics(rho_inf=0.5, mass=mass)
        case = tp.Case(tank, [SYRUP], GRAVITY, free_surface=True, numerics=numerics)
    else:
        numerics = tp.Numerics(rho_inf=0.5, pressure=pressure, mass=mass)
        case = half_full(body, fluids=(AIR, SYRUP), numerics=numerics)
    simulation = tp.Simulation(case, time_step=5e-3)
    simulation.step()
    checked = []

    def examine(problem, x, **_options):
        size, width = problem.size, 3
        problem.residual(x)
        problem.correct(x, 1e-3)
        problem.residual(x)
        problem.linearise()
        base = download(x, size).copy()
        rng = np.random.default_rng(0)
        v = rng.standard_normal(size)
        v[2 : width * problem.nodes : 3] *= 1e4
        owner, cut = problem.equations.owner, problem.cut
        bodies = problem.terms[1]
        assert isinstance(bodies, FloatingBodies)
        assert problem.rows == problem.nodes + 2
        nodes = np.flatnonzero(problem.particles.wall[owner])
        v[3 * nodes] = v[3 * nodes + 1] = 0.0
        if pressure == "free surface":
            dry = np.flatnonzero(problem.mesh.surface.pinned)
            assert (case.body_label[dry] == 0).any()
            v[3 * dry + 2] = 0.0
        # Copies move with their particles, and a body has three unknowns at its two nodes.
        v[0 : width * problem.nodes : 3], v[1 : width * problem.nodes : 3] = v[3 * owner], v[3 * owner + 1]
        v[-4] = v[-2] = v[-1] = 0.0
        if hinge:
            v[-6:-4] = 0.0
        out = problem.buffers.get("test.out", size)
        problem.product(problem.buffers.upload("test.v", v), out)
        product, sides = download(out, size).copy(), []
        for sign in (1.0, -1.0):
            problem.residual(problem.buffers.upload("test.x", base + sign * 1e-6 * v))
            sides.append(download(problem._r, size).copy())
        difference = (sides[0] - sides[1]) / 2e-6
        assert np.abs(product[-3]) > 0.01
        on_body = 3 * bodies._index
        assert not product[on_body].any()
        assert not product[on_body + 1].any()
        if cut:
            copied = np.arange(problem.nodes)[cut.copied]
            assert not product[3 * copied].any()
            assert not product[3 * copied + 1].any()
        np.testing.assert_allclose(product, difference, atol=2e-8 * np.abs(product).max())
        checked.append(True)
        raise _Stop

    monkeypatch.setattr(solve, "newton", examine)
    with pytest.raises(_Stop):
        simulation.step()
    assert checked


@pytest.mark.parametrize("pressure", ["continuous", "two-sided"])
def test_all_threads_one_thread_and_staged_kernels_solve_alike(monkeypatch, pressure):
    """With two bodies, of which one is a circle, and more iterations than the basis first has room for. Bits do not
    depend on the number of threads; staged kernels are compiled in other surroundings."""
    bodies = [
        tp.Body(box((0.3, 0.5), size=(0.2, 0.15)), density=500.0, angular_velocity=8.0),
        tp.Body(tp.shapes.circle((0.72, 0.45), 0.1), density=20.0, name="log"),
    ]
    case = half_full(*bodies, spacing=0.05, numerics=tp.Numerics(pressure=pressure))
    simulation, found = tp.Simulation(case, time_step=2e-3), []
    simulation.step()

    def examine(problem, x, **_options):
        start = x.to_numpy().copy()
        # The first time, relations are those of the prediction.
        for single, fused in ((False, True), (False, True), (True, True), (False, False)):
            monkeypatch.setattr(launch, "is_serial", lambda count, cost, single=single: single)
            problem.system.multigrid.fused = fused
            assert (problem.system.iterations is not None) is fused
            x.from_numpy(start)
            problem._corrected = True
            problem.residual(x)
            problem.linearise()
            z = problem.buffers.get("test.z", problem.size)
            problem.precondition(problem._r, z)
            preconditioned = download(z, problem.size)
            result = problem.correct(x, 1e-13)
            assert result.iterations > fgmres.ROOM
            found.append([preconditioned, download(x, problem.size), np.array([result.iterations])])
        problem.system.multigrid.fused = True
        raise _Stop

    monkeypatch.setattr(solve, "newton", examine)
    with pytest.raises(_Stop):
        simulation.step()
    for all_threads, one, staged in zip(*found[1:], strict=True):
        np.testing.assert_array_equal(all_threads, one)
        np.testing.assert_allclose(all_threads, staged, atol=1e-11 * abs(staged).max())


def energies(row):
    return sum(row[f"{name}_energy"] for name in ("kinetic", "potential", "body_kinetic", "body_potential"))


@pytest.mark.slow(but=("lumped-no-slip-0.0",))
@pytest.mark.parametrize(
    ("mass", "law", "aside"),
    [
        ("lumped", "no-slip", 0.0),
        ("lumped", "layer", 0.0),
        ("consistent", "layer", 0.0),
        ("consistent", "layer", 0.01),  # where relaxations are chosen after the solve
    ],
)
def test_energy_and_volumes_are_accounted_for(mass, law, aside):
    springs = {"stiffness": (100.0, 200.0, 5.0), "damping": (3.0, 4.0, 0.5)}
    bodies = [
        tp.Body(box((0.3 - aside, 0.55), size=(0.2, 0.15)), density=500.0, name="box", law=law, **springs),
        tp.Body(tp.shapes.circle((0.72, 0.35 + aside), 0.1), density=700.0, name="log", law=law, angular_velocity=3.0),
    ]
    numerics = tp.Numerics(newton_tolerance=1e-10, mass=mass)
    simulation = tp.Simulation(half_full(*bodies, spacing=0.05, numerics=numerics))
    simulation.step()
    start = energies(simulation.history[0])
    for _ in range(30):
        simulation.step()
    rows = simulation.history[1:]
    moved = max(row["body_kinetic_energy"] for row in rows)
    assert moved > 0.01
    assert max(abs(row["energy_residual"]) for row in rows) < 1e-9 * moved
    assert sum(row["damper_dissipation"] for row in rows) > 0
    balance = energies(rows[-1]) - start
    for name in ("viscous", "friction", "numerical", "damper"):
        balance += sum(row[f"{name}_dissipation"] for row in rows)
    assert abs(balance) < 3e-3 * moved
    for volume, first in zip(simulation.state.volume, simulation.state.wanted_volume, strict=True):
        assert volume == pytest.approx(first, rel=1e-12)
    states, x = simulation.state.parts["bodies"], simulation.particles.position
    for b, body in enumerate(simulation.case.bodies):  # particles stay where they are on their bodies
        mine = states.label == b
        c, s = np.cos(states.position[b, 2]), np.sin(states.position[b, 2])
        back = (x[mine] - states.position[b, :2]) @ np.array([[c, -s], [s, c]]) + body.reference
        assert body.distance(back).max() < 1e-9


@pytest.mark.slow
@pytest.mark.parametrize("density", [10.0, 1000.0])
def test_iterations_do_not_grow_with_a_body(density):
    """The same sloshing with the body and without; the added mass is a hundred times the mass of the lighter body."""

    def iterations(*bodies):
        slope = [(0.0, 0.0), (1.0, 0.0), (1.0, 0.35), (0.0, 0.65)]
        tank = tp.tank((1.0, 1.0), 0.05).fill(AIR).fill(WATER, shape=slope)
        for body in bodies:
            tank.add(body)
        run = tp.Simulation(tp.Case(tank, [AIR, WATER], GRAVITY))
        for _ in range(10):
            run.step()
        assert sum(row["refused_steps"] for row in run.history) == 0
        return [sum(row[f"{kind}_iterations"] for row in run.history) for kind in ("krylov", "newton")]

    # Without a body the preconditioner has a part of its own, which beside bodies would take more iterations.
    without = iterations()
    for law, krylov, newton in (("no-slip", 1.3, 1.3), ("layer", 1.8, 1.6)):
        found = iterations(tp.Body(box(turn=0.0), density=density, law=law))
        assert found[0] <= krylov * without[0]
        assert found[1] <= newton * without[1]


def test_a_body_of_the_fluid_s_density_hangs_in_it():
    body = tp.Body(tp.shapes.circle((0.5, 0.5), 0.17), density=WATER.density)
    case = tp.Case(tp.tank((1.0, 1.0), 0.05).fill(WATER).add(body), [WATER], GRAVITY)
    simulation = tp.Simulation(case)
    for _ in range(5):
        simulation.step()
    row = simulation.history[-1]
    weight = case.bodies[0].total_mass * 9.81
    assert row["body_force_y"] == pytest.approx(weight, rel=1e-9)
    assert abs(row["body_velocity_y"]) < 1e-10


@pytest.mark.slow
def test_a_run_with_a_body_goes_on_to_the_bit(tmp_path):
    case = half_full(tp.Body(box(), density=500.0), spacing=0.05)
    resumed = require_same_when_resumed(case, tmp_path)
    assert {"body_x", "body_angle", "body_force_y", "body_moment"} <= set(resumed.history[-1])


def test_a_paddle_turns_and_takes_the_fluids_along():
    motion = tp.Motion(angle=lambda t: 20 * t**2)
    case = half_full(tp.Body(box(turn=0.0, size=(0.5, 0.1)), motion=motion), fluids=(SYRUP, WATER), spacing=0.05)
    simulation = tp.Simulation(case)
    while simulation.time < 0.2:
        simulation.step()
    row = simulation.history[-1]
    assert row["body_angle"] == pytest.approx(20 * row["time"] ** 2, rel=1e-12)
    assert row["body_angular_velocity"] == pytest.approx(40 * row["time"], rel=1e-9)
    assert row["body_moment"] < 0
    assert row["external_work"] > 0
    assert simulation.state.volume == pytest.approx(simulation.state.wanted_volume, rel=1e-12)


def pushed(contact):
    motion = tp.Motion(translation=lambda t: (t**2, 0.0))
    body = tp.Body(box((0.65, 0.5), turn=0.0, size=(0.2, 0.2)), motion=motion, contact=contact, name="piston")
    case = tp.Case(tp.tank((1.0, 1.0), 0.05).fill(SYRUP).add(body), [SYRUP], GRAVITY)
    return tp.Simulation(case, time_step=0.02)


def stepped(simulation, end):
    """Step to a time; `run` would refuse a motion that ends at a wall."""
    while simulation.time < end:
        simulation.step(end)


@pytest.mark.slow
def test_a_contact_stops_the_run_or_holds_the_body():
    simulation = pushed("stop")
    with pytest.raises(tp.SimulationError, match=r"body 'piston' is in contact with a wall at .*contact='hold'"):
        stepped(simulation, 0.6)
    assert 0.75 + simulation.time**2 == pytest.approx(0.98, abs=0.01)
    simulation = pushed("hold")
    simulation.run(0.6, progress=False)
    states = simulation.state.parts["bodies"]
    assert states.held.all()
    assert 0.2 < states.position[0, 0] - 0.65 < 0.25
    assert not find_contacts(simulation.particles, simulation.mesh, np.full(len(simulation.particles), -1))


@pytest.mark.parametrize(
    ("made", "message"),
    [
        (
            lambda: half_full(tp.Body(box((0.1, 0.5)), density=1.0)),
            r"body 'body': it is on, or on the wrong side of, the wall 'left' at .*0.\d+ m or more \(3 spacings\) off",
        ),
        (
            lambda: half_full(tp.Body(box((0.25, 0.5), turn=0), density=1.0), spacing=0.05),
            r"body 'body': it is 0.1 m away from the wall 'left' at .*it must be .* 0.15 m or more \(3 spacings\)",
        ),
        (lambda: half_full(tp.Body(box()), tp.Body(box((0.7, 0.2)))), "there is a body 'body' already"),
    ],
)
def test_errors_before_the_run(made, message):
    with pytest.raises(ValueError, match=message):
        made()


def test_a_box_that_falls_onto_water_is_an_impact_and_the_time_integration_gains_nothing():
    falling = tp.Body(box((0.5, 0.43), 0.0, (0.3, 0.14)), density=500.0, velocity=(0.0, -1.5), angular_velocity=2.0)
    tank = tp.tank((1.0, 0.7), 0.05).fill(AIR).fill(WATER, box=((0, 0), (1, 0.3))).add(falling)
    simulation = tp.Simulation(tp.Case(tank, [AIR, WATER], GRAVITY), time_step=3e-3)
    for _ in range(50):
        simulation.step()
    history = simulation.history
    assert sum(row["impact"] for row in history) > 0
    energy = history[0]["body_kinetic_energy"]
    assert sum(row["time_dissipation"] for row in history) > -1e-3 * energy
    assert max(abs(row["energy_residual"]) for row in history) < 1e-9 * energy


def test_a_step_does_not_depend_on_what_an_earlier_one_left_in_the_residual():
    """A body's rows have entries without an equation, which nothing sets."""
    floating = tp.Body(box((0.5, 0.3), 0.1, (0.3, 0.14)), density=500.0)
    tank = tp.tank((1.0, 0.7), 0.07).fill(AIR).fill(WATER, box=((0, 0), (1, 0.3))).add(floating)
    ends = []
    for left in (0.0, 1e-3):
        simulation = tp.Simulation(tp.Case(tank, [AIR, WATER], GRAVITY), time_step=3e-3)
        simulation.step()
        residual = simulation.solver.workspace.buffers.get("residual", 3 * (len(simulation.particles) + 8))
        count = residual.shape[0]
        launch.launch(vector_kernels.fill, residual, left, count, work=(count, vector_kernels.ENTRY))
        simulation.step()
        ends.append((simulation.particles.position, simulation.history[-1]["krylov_iterations"]))
    np.testing.assert_array_equal(ends[0][0], ends[1][0])
    assert ends[0][1] == ends[1][1]
