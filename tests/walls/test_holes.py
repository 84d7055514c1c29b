"""Round holes and arcs of tanks along which fluids slip, with openings, free surfaces and bodies beside them."""

from __future__ import annotations

import numpy as np
import pytest

import tipfem as tp
from tipfem.geometry.plane.curves import old_ends
from tipfem.mesh.mesh import Mesh, as_far_as_cells_bear
from tipfem.physics.bodies.motion import BodyStates

AT, RADIUS = np.array([0.3, 0.155]), 0.05
SYRUP = tp.Fluid("syrup", 1000.0, 0.5)
OIL = tp.Fluid("oil", 900.0, 0.5)


def area_of(position: np.ndarray, pairs: np.ndarray) -> float:
    p, q = position[pairs[:, 0]], position[pairs[:, 1]]
    return 0.5 * float((p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]).sum())


def around(simulation, centre=AT):
    """The particles of the hole, and the faces of the hull between them, with the hole on their left."""
    near = simulation.particles.wall & (np.hypot(*(simulation.particles.position - centre).T) < 1.4 * RADIUS)
    one, other = Mesh(simulation.particles.position, simulation.mesh.all_cells).hull[2:]
    here = near[one] & near[other]
    return np.flatnonzero(near), np.stack([other[here], one[here]], axis=1)


def channel(law, *, body=False, fluids=(SYRUP,), beside=(), fine=1.0, **options):
    """Flow at 1 m/s past a hole of six spacings across, or past a fixed body."""
    circle = tp.shapes.circle(tuple(AT), RADIUS, name="hole")
    corners = [(0, 0), (0.6, 0), (0.6, 0.3), (0, 0.3)]
    shape = tp.shapes.polygon(corners, names=["bottom", "right", "top", "left"], holes=[] if body else [circle])
    tank = tp.tank(shape=shape, spacing=RADIUS / 3 / fine)
    for k, fluid in enumerate(fluids):
        tank.fill(fluid, where=lambda x, k=k: (k == 0) | (x[:, 1] > 0.155), velocity=(1.0, 0.0))
    tank.wall("bottom", slip=True).wall("top", slip=True)
    if body:
        tank.add(tp.Body(circle, name="hole", **law))
    elif law:
        tank.wall("hole", **law)
    for each in beside:
        tank.add(each)
    openings = [tp.Inlet(wall="left", fluid=fluids[0], velocity=1.0), tp.Outlet(wall="right")]
    case = tp.Case(tank, fluids, (0, 0), openings=openings, **options)
    return tp.Simulation(case, probes=[] if body else [tp.WallForce(name="F", wall="hole")])


BESIDE = tp.Body(tp.shapes.circle((0.12, 0.15), 0.03), name="b", density=1000.0)
GRADING = tp.Grading(where=lambda x: np.clip(0.02 + 0.1 * (np.hypot(*(x - AT).T) - RADIUS), 0.02, 0.03))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("law", "options"),
    [
        ({}, {}),
        ({"slip": True}, {}),
        ({"slip_length": 0.01}, {}),
        ({}, {"fluids": (SYRUP, OIL)}),
        ({}, {"fluids": (SYRUP, OIL), "surface_tension": {("syrup", "oil"): 0.5}}),
        ({"slip": True}, {"grading": GRADING}),
        ({}, {"beside": (BESIDE,)}),
    ],
    ids=["layer", "slip", "length", "two", "tension", "graded", "body"],
)
def test_a_hole_between_an_inlet_and_an_outlet_keeps_its_size(law, options):
    """What passes openings made up for nothing on curves: the hole lost 3 % of its radius in 0.1 s, 12 % in 0.9 s."""
    simulation = channel(law, **options)
    volume, start = simulation.state.volume.sum(), area_of(simulation.particles.position, around(simulation)[1])
    off = []
    while simulation.time < 0.1 - 1e-9:
        simulation.step(0.1)
        on, pairs = around(simulation)
        position = simulation.particles.position
        assert len(pairs) == len(on)
        assert area_of(position, pairs) == pytest.approx(start, rel=1e-11)
        distance = np.hypot(*(position[on] - AT).T)
        off.append(np.abs(distance / RADIUS - 1).max())
        assert simulation.state.volume.sum() == pytest.approx(volume, rel=1e-12)
    # Where chords are long, particles stand off the circle; a new one for a step by up to 0.3 spacings, too.
    assert np.mean(off) < 0.025
    assert max(off) < 0.1
    residual = sum(abs(row["energy_residual"]) for row in simulation.history)
    assert residual < 1e-9 * simulation.energy().kinetic


def test_a_hole_keeps_its_size_beside_a_body_with_corners():
    """The volume that corners open in the step is not made up for by the hole."""
    shape = tp.shapes.polygon([(0, 0), (0.6, 0), (0.6, 0.3), (0, 0.3)], holes=[tp.shapes.circle(tuple(AT), RADIUS)])
    tank = tp.tank(shape=shape, spacing=RADIUS / 3).fill(SYRUP)
    for side in tank.sides:
        tank.wall(side, slip=True)
    motion = tp.Motion(translation=lambda t: (0.0, 2 * t * t))
    tank.add(tp.Body(tp.shapes.rectangle((0.07, 0.1), (0.17, 0.2)), slip=True, motion=motion))
    simulation = tp.Simulation(tp.Case(tank, [SYRUP], (0, 0)), time_step=5e-3)
    volume, start = simulation.state.volume.sum(), area_of(simulation.particles.position, around(simulation)[1])
    for _ in range(20):
        simulation.step()
    assert area_of(simulation.particles.position, around(simulation)[1]) == pytest.approx(start, rel=1e-11)
    assert simulation.state.volume.sum() == pytest.approx(volume, rel=1e-12)


@pytest.mark.slow
def test_the_drag_of_a_hole_is_that_of_a_fixed_body():
    """By means over 0.2 s, of ten spacings across; -100 to 3 N where growth was told to elements at openings."""
    means, end = [], 0.6
    for body in (False, True):
        simulation = channel({}, body=body, fine=10 / 6)
        while simulation.time < end - 1e-9:
            simulation.step(end)
        if body:
            time, force = ([row[name] for row in simulation.history] for name in ("time", "hole_force_x"))
        else:
            found = simulation.probes["F"]
            time = found["time"]
            force = np.add(found["pressure_force_x"], found["viscous_force_x"])
        time, force = np.array(time), np.array(force)
        means.append([force[(time > a) & (time <= a + 0.2)].mean() for a in (0.2, 0.4)])
    np.testing.assert_allclose(*means, rtol=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("law", [{}, {"slip": True}], ids=["layer", "slip"])
def test_a_bent_pipe_keeps_its_volume(law):
    arc = tp.shapes.arc((0, 0))
    corners = [(0.1, 0), (0.2, 0), arc, (0, 0.2), (-0.1, 0.2), (-0.1, 0.1), (0, 0.1), arc]
    shape = tp.shapes.polygon(corners, names=["in", "outer", "top", "out", "bottom", "inner"])
    tank = tp.tank(shape=shape, spacing=0.0125).fill(SYRUP)
    for name in ("outer", "inner") if law else ():
        tank.wall(name, **law)
    openings = [tp.Inlet(wall="in", fluid=SYRUP, velocity=0.5), tp.Outlet(wall="out")]
    simulation = tp.Simulation(tp.Case(tank, [SYRUP], (0, 0), openings=openings))
    volume = simulation.volume("syrup")
    for _ in range(60):
        simulation.step()
        assert simulation.volume("syrup") == pytest.approx(volume, rel=1e-12)


def dam(law, *, body=False, across=6):
    water = tp.Fluid("water", 1000.0, 1e-3)
    circle = tp.shapes.circle((0.35, 0.1), RADIUS, name="hole")
    corners = [(0, 0), (0.6, 0), (0.6, 0.5), (0, 0.5)]
    shape = tp.shapes.polygon(corners, names=["bottom", "right", "top", "left"], holes=[] if body else [circle])
    tank = tp.tank(shape=shape, spacing=2 * RADIUS / across).fill(water, box=((0, 0), (0.2, 0.3)))
    if body:
        tank.add(tp.Body(circle, name="b", **law))
    elif law:
        tank.wall("hole", **law)
    return tp.Simulation(tp.Case(tank, [water], (0, -9.81), free_surface=True))


@pytest.mark.slow
@pytest.mark.parametrize("body", [False, True], ids=["hole", "body"])
@pytest.mark.parametrize("law", [{}, {"slip": True}], ids=["layer", "slip"])
def test_particles_stay_on_a_circle_that_a_dam_break_hits(law, body):
    """New ones on dry parts stayed on chords, and the next between them: half a spacing off, and runs ended at
    0.28 s."""
    simulation, volume = dam(law, body=body), None
    while simulation.time < 0.5 - 1e-9:
        simulation.step(0.5)
        position, h = simulation.particles.position, simulation.particles.spacing
        distance = np.hypot(*(position - [0.35, 0.1]).T)
        on = simulation.particles.wall & (np.abs(distance - RADIUS) < 0.9 * h)
        off = np.abs(distance[on] - RADIUS) / h
        assert off.max() < 0.35  # where cells beside a new particle are flat, it goes there in steps
        assert np.median(off) < 0.02
        volume = volume or simulation.volume("water")
        assert simulation.volume("water") == pytest.approx(volume, rel=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["wall", "body"])
def test_new_particles_are_put_on_curves_at_once(kind):
    """Each new particle of a circle is nearer to it than a tenth of what its chord is, where cells leave it room."""
    simulation = dam({"slip": True}, body=kind == "body", across=8)
    seen = 0
    while simulation.time < 0.35 - 1e-9:
        simulation.step(0.35)
        position, state = simulation.particles.position, simulation.state
        on, pairs = around(simulation, [0.35, 0.1])
        new = np.zeros(len(position), dtype=bool)
        new[on] = state.relocated[on]
        if not new.any():
            continue
        index, ends = old_ends(pairs, new)
        assert len(index) == new.sum()
        chord = np.linalg.norm(position[ends[:, 1]] - position[ends[:, 0]], axis=1)
        sagitta = chord**2 / (8 * RADIUS)
        off = np.abs(np.hypot(*(position[index] - [0.35, 0.1]).T) - RADIUS)
        seen += int((off < 0.1 * sagitta).sum())
        assert (off < 1.1 * sagitta).all()
        if kind == "body":
            assert (simulation.state.part(BodyStates).label[index] == 0).all()
    assert seen > 2


def test_the_old_neighbours_of_new_particles_are_found():
    pairs = np.array([[0, 5], [5, 6], [6, 1], [1, 2], [2, 7], [7, 0]])
    is_new = np.zeros(8, dtype=bool)
    is_new[[5, 6, 7]] = True
    index, ends = old_ends(pairs, is_new)
    found = dict(zip(index.tolist(), ends.tolist(), strict=True))
    assert found == {5: [0, 1], 6: [0, 1], 7: [2, 0]}


def test_particles_go_as_far_as_their_cells_bear():
    position = np.array([[0.0, 0], [1, 0], [0.5, 0.4], [0.5, 0.0]])
    mesh = Mesh(position, np.array([[0, 3, 2], [3, 1, 2]], dtype=np.int32))
    moves = np.array([False, False, False, True])
    for goal, reached in ((0.2, 0.2), (0.35, 0.175)):  # a fifth of 0.4 is left
        to = position.copy()
        to[3, 1] = goal
        result = as_far_as_cells_bear(mesh, position, to, moves)
        np.testing.assert_allclose(result[3], [0.5, reached])
        np.testing.assert_array_equal(result[:3], position[:3])
