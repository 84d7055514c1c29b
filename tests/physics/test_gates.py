"""Gates: bodies that touch walls, the closed gaps below and beside them, and what opens."""

from __future__ import annotations

import shutil

import numpy as np
import pytest

import tipfem as tp
from tipfem.errors import Invalid
from tipfem.geometry.plane.domain import Domain
from tipfem.geometry.plane.touching import SKIN, shifts_apart
from tipfem.mesh.mesh import Mesh, simplex_measure
from tipfem.physics.bodies.motion import BodyStates
from tipfem.physics.contact.gaps import gap_widths, owners, relabelled, touching_particles

WATER = tp.Fluid("water", density=1000.0, viscosity=1e-3)
AIR = tp.Fluid("air", density=1.2, viscosity=1.8e-5)
H, G = 0.03, 9.81
DEPTH = 10 * H


def lift(time: float) -> tuple[float, float]:
    """At 2 m/s from 0.02 s on, after 0.02 s in which it sets off."""
    s = max(time - 0.02, 0.0)
    ramp = 0.02
    return 0.0, min(s - ramp / np.pi * np.sin(np.pi * s / ramp) if s < ramp else 2 * s - ramp, 0.4)


def gate(*, at=(0.0, 0.0), other=0.0, motion=lift, gap="seal", x=0.45, pocket=False, free_surface=True, **options):
    """Water 10 spacings deep behind a gate, ``other`` deep in front of it, in a tank with its corner ``at`` a place."""
    start, end = np.array(at), np.array(at) + (1.2, 0.9)
    wide = (3 - 2 * SKIN) * H if pocket else 3 * H
    left = x + (SKIN * H if pocket else 0.0)
    outline = [(0, 0), (1.2, 0), (1.2, 0.9), (0, 0.9)]
    if pocket:
        outline[2:3] = [(1.2, 0.5), (x + 3 * H, 0.5), (x + 3 * H, 0.9), (x, 0.9), (x, 0.5)]
        outline[-1:] = [(0, 0.5)]
    tank = tp.tank(shape=tp.shapes.polygon([tuple(start + corner) for corner in outline]), spacing=H)
    middle = left + 0.5 * wide
    tank.fill(WATER, box=(start, start + (middle, DEPTH)) if free_surface else None)
    if other:
        tank.fill(WATER, box=(start + (middle, 0), (end[0], start[1] + other)))
    box = tp.shapes.rectangle(start + (left, 0), start + (left + wide, 0.55))
    tank.add(tp.Body(box, name="gate", motion=tp.Motion(translation=motion) if motion else None, gap=gap, **options))
    return tp.Case(tank, [WATER], (0.0, -G), free_surface=free_surface)


def fastest(simulation: tp.Simulation) -> float:
    """Largest speed of the fluid [m/s]."""
    speed = np.linalg.norm(simulation.particles.velocity, axis=1)
    states = simulation.state.part(BodyStates)
    return float(speed[(states.label < 0) & ~simulation.mesh.surface.pinned].max())


def hydrostatic(depth: float) -> float:
    """Force on a gate, a skin above the floor, and on half of the mouth below it [N/m]."""
    skin = SKIN * H
    return 1000 * G * (0.5 * (depth - skin) ** 2 + 0.5 * skin * (depth - 0.5 * skin))


@pytest.mark.parametrize(
    ("at", "other", "pocket"), [((0, 0), 0.0, False), ((0, 0), 0.18, True), ((-3, 7), 0.18, False)]
)
def test_closed_gate_is_at_rest(at, other, pocket):
    """No leak, no motion, and the force is that of the water's weight."""
    simulation = tp.Simulation(gate(at=at, other=other, pocket=pocket, motion=None))
    volume = simulation.state.volume.copy()
    for _ in range(5):
        simulation.step()
    assert fastest(simulation) < 1e-10
    assert np.abs(simulation.state.volume / volume - 1).max() < 1e-13
    force = simulation.history[-1]["gate_force_x"]
    assert abs(force / (hydrostatic(DEPTH) - (hydrostatic(other) if other else 0.0)) - 1) < 2e-5
    assert abs(simulation.history[-1]["gate_force_y"]) < 1e-8
    assert simulation.state.part(BodyStates).in_gaps.any()


def test_lifted_gate_lets_the_water_out():
    """Its lip takes no water up with it, and the front is as fast as the one that no gate has held."""
    simulation, volume = tp.Simulation(gate()), None
    front, lifted = {}, []
    while simulation.time < 0.19:
        simulation.step()
        volume = simulation.state.volume.copy() if volume is None else volume
        row = simulation.history[-1]
        assert abs(row["energy_residual"]) < 1e-9
        front[row["time"]] = simulation.particles.position[np.unique(simulation.mesh.cells), 0].max()
        lifted += [abs(row["gate_force_y"])] if row["time"] > 0.06 else []
    assert np.mean(lifted) < 0.01 * hydrostatic(DEPTH)
    assert abs(simulation.state.volume / volume - 1).max() < 1e-12
    times, place = np.array(list(front)), np.array(list(front.values()))
    assert (place[times < 0.02] == 0.45).all()
    free = tp.tank((1.2, 0.9), H).fill(WATER, box=((0, 0), (0.45, DEPTH)))
    other = tp.Simulation(tp.Case(free, [WATER], (0.0, -G), free_surface=True))
    found = {}
    while other.time < 0.15:
        other.step()
        found[other.time] = other.particles.position[np.unique(other.mesh.cells), 0].max()
    for reach in (0.5, 0.55):
        late = np.interp(reach, place, times) - np.interp(reach, list(found.values()), list(found))
        assert 0.02 < late < 0.045  # it begins to open at 0.02 s, and is 0.4 spacings open at 0.035 s


@pytest.mark.parametrize("full", [False, True])
@pytest.mark.parametrize("rolls", [False, True])
def test_gate_that_goes_along_with_a_tank(full, rolls):
    """Water stays on its side; gaps and water fill a full tank, which moves all of the water that it does not turn."""
    motion = tp.Motion(translation=lambda t: (0.05 * (1 - np.cos(6 * t)), 0.0))
    if rolls:
        motion = tp.Motion(angle=lambda t: 0.1 * (1 - np.cos(6 * t)), pivot=(0.6, 0.2))
    size, height = (1.2, 0.8), 0.3 if full else 0.5
    tank = tp.tank(size, 0.05).fill(WATER, box=((0, 0), size if full else (0.4, 0.3)))
    tank.add(tp.Body(tp.shapes.rectangle((0.4, 0), (0.55, height)), name="gate", motion=motion, gap="seal"))
    simulation = tp.Simulation(tp.Case(tank, [WATER], (0, -9.81), free_surface=True, tank_motion=motion))
    while simulation.time < 0.2:
        simulation.step()
        assert abs(simulation.history[-1]["energy_residual"]) < 1e-11
    state, particles = simulation.state, simulation.particles
    assert state.volume_error < 1e-13
    velocity = particles.velocity[~particles.wall]
    if full:
        gaps = np.abs(simplex_measure(state.mesh.position, state.mesh.surface.empty)).sum()
        assert state.volume.sum() + gaps == pytest.approx(1.2 * 0.8 - 0.15 * height, abs=1e-12)
        assert rolls or np.ptp(velocity, axis=0).max() < 2e-3 * np.abs(velocity).max()
    else:
        inside = motion.pose(simulation.time, 1e-4, 2).origin(particles.position[~particles.wall])
        assert inside[:, 0].max() < 0.4


def test_tank_that_presses_on_a_body_is_refused():
    tank = tp.tank((1.2, 0.8), 0.05).fill(WATER, box=((0, 0), (0.4, 0.3)))
    tank.add(tp.Body(tp.shapes.rectangle((0.4, 0), (0.55, 0.5)), name="gate", gap="seal"))
    heave = tp.Motion(translation=lambda t: (0.0, 0.03 * (1 - np.cos(6 * t))))
    simulation = tp.Simulation(tp.Case(tank, [WATER], (0, -9.81), free_surface=True, tank_motion=heave))
    with pytest.raises(ValueError, match=r"tank_motion takes the wall 'bottom' to body 'gate' at t = 0\.0482"):
        simulation.run(0.2, progress=False)


@pytest.mark.slow
def test_gate_beside_an_outlet_lets_the_water_off_its_lip():
    """Nothing passes the outlet before the front is there, though the lip's particle is put back each step."""
    tank = tp.tank((0.9, 1.0), H).fill(WATER, box=((0, 0), (0.345, DEPTH)))
    motion = tp.Motion(translation=lambda t: (0.0, min(4 * t * t, 0.4)))
    tank.add(tp.Body(tp.shapes.rectangle((0.3, 0), (0.39, 0.5)), name="gate", gap="seal", motion=motion))
    openings = [
        tp.Inlet(between=((0, 0), (0, 0.15)), fluid=WATER, velocity=0.1, ramp=0.05),
        tp.Outlet(between=((0.6, 0), (0.9, 0)), name="drain"),
    ]
    case = tp.Case(tank, [WATER], (0.0, -G), openings=openings, free_surface=True)
    simulation, lips = tp.Simulation(case, time_step=5e-3), 0
    start = simulation.state.volume.copy()
    while simulation.time < 0.25:
        simulation.step(0.25)
        corners, row = simulation.state.part(BodyStates).corners, simulation.history[-1]
        lips += corners is not None and (corners[:, 1:3] < 0).any()
        assert abs(row["through_drain_water"]) < 1e-3 * max(row["through_inlet_water"], 5e-5)
    assert lips > 10
    passed = simulation.state.parts["openings"].total.sum(axis=0)
    assert simulation.state.volume - start == pytest.approx(passed, rel=1e-12)


@pytest.mark.slow
def test_gate_that_leaves_through_a_pocket():
    """Nothing fills the pocket, and water from both sides fills what the gate leaves."""
    simulation = tp.Simulation(gate(pocket=True, other=0.18, motion=lambda t: (0.0, min(1.5 * t * t / 0.1, 0.3))))
    while simulation.time < 0.25:
        simulation.step()
    assert simulation.particles.position[np.unique(simulation.mesh.cells), 1].max() < 0.5
    assert simulation.state.volume_error < 1e-12
    assert simulation.mesh.components.at_particle.max() == 0  # one piece


def test_gaps_are_told_by_outlines():
    """The width is that of the gap, not of a narrow cell in it; what touches closes, what is wide fills again."""
    x = np.array([[0, 0], [0.1, 0], [0.2, 0], [0, 0.05], [0.01, 0.05], [0.2, 0.05], [0.1, 0.5]])
    cells = np.array([[0, 4, 3], [0, 1, 4], [1, 2, 5], [1, 5, 4], [4, 5, 6]], dtype=np.int32)
    label = np.array([-1, -1, -1, 0, 0, 0, -1])
    owner = owners(label, np.array([True] * 6 + [False]))
    assert gap_widths(x, cells, owner) == pytest.approx([0.05, 0.05, 0.05, 0.05, np.inf])
    mesh = Mesh(x, cells, np.zeros(5, dtype=np.int32))
    body = np.array([[-0.1, 0.05], [0.3, 0.05], [0.3, 0.3], [-0.1, 0.3]])
    outlines = {1: Domain([body], [["b"] * 4], [[-1] * 4])}
    shut = relabelled(mesh, x, owner, outlines, np.array([False, True]), 1.0, 1)
    assert shut.fluid.tolist() == [1, 1, 1, 1, 0]
    assert relabelled(shut, x, owner, outlines, np.array([False, True]), 0.08, 1) is shut
    opened = relabelled(shut, x, owner, outlines, np.array([False, True]), 0.05, 1)
    assert opened.fluid.tolist() == [0] * 5


def test_gaps_touch_up_to_where_they_are_wide():
    """A wedge that touches at its end is one gap as far as its mouth; one that touches nowhere has no particles."""
    floor, body = [[0.05 * k, 0.0] for k in range(5)], [[0.05 * k, 0.004 + 0.008 * k] for k in range(5)]
    x, owner = np.array(floor + body), np.array([0] * 5 + [1] * 5)
    cells = np.array([[k, k + 1, k + 5 + j] for k in range(4) for j in (0, 1)] + [[0, 1, 5], [3, 9, 8]])
    assert touching_particles(x, cells, owner, 0.05).all()
    assert not touching_particles(x + 0.01 * (owner[:, None] == 1) * (0, 1), cells, owner, 0.05).any()
    wide = x + (owner == 1)[:, None] * (0.0, 1.0) * (x[:, :1] > 0.12)
    assert touching_particles(wide, cells, owner, 0.05).tolist() == [True] * 4 + [False] + [True] * 3 + [False] * 2
    assert not touching_particles(x, None, owner, 0.05).any()


def test_flap_on_its_foot_lets_no_water_off():
    """Its foot touches the floor all the time, and is no brink, from which the water would slide off."""
    foot, turns = 1.5 * H, np.linspace(np.pi, 2 * np.pi, 7)
    arc = np.array([0.6, foot]) + foot * np.stack([np.cos(turns), np.sin(turns)], axis=1)
    shape = [*arc.tolist(), (0.6 + foot, 0.5), (0.6 - foot, 0.5)]
    swing = tp.Motion(angle=lambda t: -0.4 * t, pivot=(0.6, foot))
    tank = tp.tank((1.2, 0.9), H).fill(WATER, box=((0.6, 0), (1.2, DEPTH)))
    tank.add(tp.Body(shape, name="flap", motion=swing, gap="seal"))
    simulation = tp.Simulation(tp.Case(tank, [WATER], (0.0, -G), free_surface=True))
    while simulation.time < 0.12:
        simulation.step()
        assert simulation.state.part(BodyStates).corners is None


def test_shifts_put_a_stack_on_skins():
    """Boxes drawn on the floor and on each other end up a skin apart, whichever comes first."""

    def box(low, high):
        return Domain([np.array([[0.3, low], [0.6, low], [0.6, high], [0.3, high]])], [["b"] * 4], [[-1] * 4])

    tank = Domain([np.array([[0, 0], [1, 0], [1, 1], [0, 1.0]])], [["t"] * 4], [[-1] * 4])
    may = np.ones((3, 3), dtype=bool)
    shift, touch, left = shifts_apart([box(0.2, 0.4), box(0.0, 0.2)], tank, may, 0.1)
    assert left is None
    assert shift == pytest.approx(np.array([[0, 0.01], [0, 0.005]]), abs=1e-8)
    assert touch.tolist() == [[False, False, True], [False, False, True], [True, True, False]]


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"free_surface": False}, "needs free_surface = true"),
        ({"gap": None}, "give it gap = 'seal'"),
        ({"pocket": True, "x": 0.4501}, None),
    ],
)
def test_what_does_not_work_is_refused(options, told):
    """In a sentence, before the run."""
    if told is None:
        tank = tp.tank((1.0, 1.0), H).fill(WATER, box=((0, 0), (1, 0.3)))
        tank.add(tp.Body(tp.shapes.rectangle((0.0, 0.2), (1.0, 0.5)), name="lid", gap="seal"))
        with pytest.raises(Invalid, match="make it narrower by"):
            tp.Case(tank, [WATER], (0.0, -G), free_surface=True)
        return
    with pytest.raises(ValueError, match=told):
        gate(**options)


FULL = 0.8, 0.6  # size of full tanks [m]


def in_full_tank(fluids, shape, motion, **options):
    """A simulation of a box in a tank full of water, or of it up to 0.4 m and another fluid above."""
    tank = tp.tank(FULL, 0.05)
    for k, fluid in enumerate(fluids):
        tank.fill(fluid, box=((0, 0.4 * k), (FULL[0], FULL[1] if k == len(fluids) - 1 else 0.4)))
    tank.add(tp.Body(tp.shapes.rectangle(*shape), name="box", gap="seal", motion=motion, **options))
    return tp.Simulation(tp.Case(tank, fluids, (0.0, -G), free_surface=True))


def gap_areas(simulation, end):
    """The area of the gaps after each step until ``end`` [m^2]; what is not in them is in the fluids, to round-off."""
    whole, result = FULL[0] * FULL[1] - 0.06, []
    while simulation.time < end:
        simulation.step(end)
        row, state = simulation.history[-1], simulation.state
        result.append(np.abs(simplex_measure(state.mesh.position, state.mesh.surface.empty)).sum())
        assert state.volume.sum() + result[-1] == pytest.approx(whole, abs=1e-12)
        assert state.volume_error < 1e-12
        assert abs(row["energy_residual"]) < 1e-10
    return result


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fluids", "full", "level", "way"),
    [([WATER], False, 0.21, 1), ([WATER], True, 0.3, -1), ([WATER, AIR], True, 0.21, 1), ([WATER, AIR], True, 0.06, 1)],
    ids=["free surface", "full", "under an interface", "through an interface"],
)
def test_box_is_dragged_along_the_floor(fluids, full, level, way):
    """By six spacings: the mouths of its gap go with it, and volume and energy close."""

    def along(time):
        s = min(time / 0.6, 1.0)
        return way * 6 * H * (s - np.sin(2 * np.pi * s) / (2 * np.pi)), 0.0

    tank = tp.tank((0.9, 0.3), H)
    if full:
        tank.fill(fluids[-1])
    tank.fill(WATER, box=((0, 0), (0.9, level)))
    left = 0.3 if way > 0 else 0.42
    block = tp.shapes.rectangle((left, 0.0), (left + 0.18, 0.09))
    tank.add(tp.Body(block, name="box", gap="seal", motion=tp.Motion(translation=along)))
    simulation = tp.Simulation(tp.Case(tank, fluids, (0.0, -G), free_surface=True))
    while simulation.time < 0.62:
        simulation.step()
        position, empty = simulation.mesh.position, simulation.mesh.surface.empty
        label = simulation.state.part(BodyStates).label
        gap = empty[gap_widths(position, empty, owners(label, simulation.particles.wall)) < 0.5 * H]
        beyond = np.abs(position[gap][..., 0] - simulation.history[-1]["box_x"]).max() - 0.09
        assert -1e-9 < beyond < H
        assert abs(simulation.history[-1]["energy_residual"]) < 1e-9
    assert simulation.history[-1]["box_x"] == pytest.approx(left + 0.09 + way * 6 * H, abs=1e-9)
    assert simulation.state.volume_error < 1e-12


@pytest.mark.slow
@pytest.mark.parametrize("fluids", [[WATER], [WATER, AIR]])
def test_box_is_lifted_off_the_floor_of_a_full_tank(fluids):
    """And put down again: what its gap takes up has left the water, and comes back; volumes and energy close."""
    h = 0.05
    lift = tp.Motion(translation=lambda t: (0.0, 0.6 * h * (1 - np.cos(10 * t))))
    simulation = in_full_tank(fluids, ((0.25, 0.0), (0.55, 0.2)), lift)
    start = simulation.state.volume
    assert start.sum() == pytest.approx(FULL[0] * FULL[1] - 0.06 - 0.3 * SKIN * h, abs=1e-12)
    assert max(gap_areas(simulation, 0.7)) > 0.3 * 0.5 * h
    rows = simulation.history
    for fluid, volume in list(zip(fluids, start, strict=True))[1:]:
        assert [row[f"volume_{fluid.name}"] for row in rows] == pytest.approx([volume] * len(rows), rel=1e-12)
    opened = [row["volume_water"] > start[0] + 0.9 * 0.3 * SKIN * h for row in rows]
    assert any(opened)  # water is below the box
    assert not opened[-1]  # it touches again


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fluids", "shape", "motion"),
    [
        # Films beside mouths, and pieces of fluids that a gap cuts off, stay what they are.
        ([WATER], ((0.0, 0.0), (0.3, 0.2)), {"translation": lambda t: 2 * (0.03 * (1 - np.cos(10 * t)),)}),
        ([WATER], ((0.25, 0.0), (0.55, 0.2)), {"angle": lambda t: 0.15 * (1 - np.cos(8 * t)), "pivot": (0.25, 0.0)}),
        ([WATER, AIR], ((0.0, 0.3), (0.3, 0.5)), {"translation": lambda t: (0.03 * (1 - np.cos(10 * t)), 0.0)}),
    ],
    ids=["off a corner", "turned", "off a wall at an interface"],
)
def test_no_volume_is_lost_in_full_tanks(fluids, shape, motion):
    """Nor energy, however a gap opens and closes."""
    assert max(gap_areas(in_full_tank(fluids, shape, tp.Motion(**motion)), 0.7)) > 0.005


def test_sealed_bodies_that_float_need_empty_space():
    with pytest.raises(ValueError, match=r"needs empty space above the fluids.*say gap = 'seep'"):
        in_full_tank([WATER], ((0.25, 0.0), (0.55, 0.2)), None, density=500.0)


@pytest.mark.slow
@pytest.mark.parametrize("full", [False, True])
def test_gate_goes_on_from_a_checkpoint(full, tmp_path):
    """To the bit, while it opens."""
    lift = tp.Motion(translation=lambda t: (0.0, 0.03 * (1 - np.cos(10 * t))))
    case = in_full_tank([WATER, AIR], ((0.25, 0.0), (0.55, 0.2)), lift).case if full else gate()
    whole = tp.Simulation(case, tmp_path / "run", time_step=4e-3)
    whole.run(0.04, progress=False)
    shutil.copytree(tmp_path / "run", tmp_path / "part")
    whole.run(0.08, progress=False)
    resumed = tp.Simulation.resume(tmp_path / "part", case)
    resumed.run(0.08, progress=False)
    np.testing.assert_array_equal(resumed.particles.position, whole.particles.position)
    np.testing.assert_array_equal(resumed.particles.velocity, whole.particles.velocity)


def test_flap_is_a_plate_on_a_round_foot():
    """Its area is that of the plate above the foot's centre, and of half a polygon of twelve corners."""
    shape = tp.shapes.flap((0.6, 0.1), height=0.7, thickness=0.2)
    assert shape.area == pytest.approx(0.2 * 0.6 + 0.5 * 12 * 0.5 * 0.1**2 * np.sin(np.pi / 6))
    np.testing.assert_allclose(shape.box, [[0.5, 0.1], [0.7, 0.8]])
    for wrong in ({"height": 0.1, "thickness": 0.2}, {"height": 0.1, "thickness": 0.0}):
        with pytest.raises(ValueError, match="0 < thickness < height"):
            tp.shapes.flap((0.6, 0.1), **wrong)
