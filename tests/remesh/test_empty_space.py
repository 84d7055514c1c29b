"""Free surfaces whose cells are repaired in place: empty space beyond them, contacts, and spray."""

from __future__ import annotations

import numpy as np
import pytest
from triangulations import areas, as_set, check, cloud, delaunay, grid, masses, of

import tipfem as tp
from tipfem.errors import TriangulationError
from tipfem.geometry.period import no_period
from tipfem.mesh.mesh import Mesh, Surface, simplex_measure
from tipfem.physics.state import Solved
from tipfem.remesh.triangles.edge_operations import MASS, VELOCITY
from tipfem.remesh.triangles.empty_space import around, beyond, followed, without
from tipfem.remesh.triangles.spray import Spray
from tipfem.remesh.volumes import restore_volumes, with_components

WATER = tp.Fluid("water", density=1000.0, viscosity=1e-3)
OIL = tp.Fluid("oil", density=900.0, viscosity=1e-2)
GRAVITY = (0.0, -9.81)


def half(columns=7, rows=7, level=3):
    """A grid of 1 m squares with fluid below a level, and empty space above; its cells and their fluids."""
    x, cells = grid(np.arange(columns), np.arange(rows))
    return x, cells.astype(np.int32), (x[cells, 1].mean(axis=1) > level).astype(np.int32)


def particles_of(x, wall=None, h=1.0) -> tp.Particles:
    wall = np.zeros(len(x), dtype=bool) if wall is None else wall
    return tp.Particles(x, np.zeros(len(x)), wall, np.zeros_like(x), spacing=h)


def test_the_cells_of_the_fluids_and_of_empty_space_are_taken_apart_and_put_together():
    x, cells, fluid = half()
    wall = np.zeros(len(x), dtype=bool)
    wall[(x == 0).any(axis=1) | (x == 6).any(axis=1)] = True
    whole = with_components(Mesh(x, cells, fluid), 2)
    mesh = without(whole, wall, 1, np.ones(len(x)))
    assert as_set(mesh.cells) == as_set(cells[fluid == 0])
    assert as_set(mesh.surface.empty) == as_set(cells[fluid == 1])
    np.testing.assert_array_equal(mesh.surface.front, x[:, 1] == 3)
    np.testing.assert_array_equal(mesh.surface.used, x[:, 1] <= 3)
    np.testing.assert_array_equal(mesh.surface.loose, (x[:, 1] > 3) & ~wall)
    np.testing.assert_array_equal(mesh.surface.volume, mesh.surface.loose.astype(float))
    np.testing.assert_array_equal(mesh.neighbours, Mesh(x, mesh.cells).neighbours)
    np.testing.assert_array_equal(mesh.measure, Mesh(x, mesh.cells).measure)
    again = beyond(mesh, mesh.surface.empty, 1)
    assert as_set(again.cells) == as_set(cells)
    assert np.asarray(again.fluid).sum() == (fluid == 1).sum()


@pytest.mark.parametrize("seed", range(4))
def test_empty_space_follows_a_motion_that_turns_its_cells_over(seed):
    """Its outline stays; what is inside is re-triangulated on the way."""
    rng = np.random.default_rng(seed)
    x = np.concatenate([np.array([[0, 0], [1, 0], [1, 1], [0, 1.0]]), 0.1 + 0.8 * rng.random((20, 2))])
    cells = delaunay(x)
    after = np.clip(x + 0.1 * rng.normal(size=x.shape), 0.02, 0.98)
    after[:4] = x[:4]
    assert simplex_measure(after, cells).min() < 0
    found = followed(cells, x, after, 1.0, no_period(2))
    assert (simplex_measure(after, found) > 0).all()
    assert simplex_measure(after, found).sum() == pytest.approx(1.0, rel=1e-12)
    assert (Mesh(after, found).neighbours < 0).sum() == 4


def test_surfaces_that_pass_through_each_other_refuse_the_step():
    x, cells, fluid = half()
    after = x.copy()
    after[(x[:, 1] == 3) & (x[:, 0] == 2)] += [0.0, 3.5]
    with pytest.raises(TriangulationError, match="meet"):
        followed(cells[fluid == 1], x, after, 1.0, no_period(2))


@pytest.mark.parametrize("seed", range(6))
def test_particles_are_taken_out_of_empty_space(seed):
    """The hull stays, all cells have an area, and the cells off the particles are as they were."""
    x = cloud("square", seed) if seed % 2 else np.concatenate([cloud("square", 1), [[0.47, 0.52], [0.5, 0.1]]])
    t = of(x, delaunay(x), density=[0.0])
    inner = np.flatnonzero(t.wall == 0)
    which, before = inner[:: max(1, len(inner) // 4)], as_set(t.cells)
    area = simplex_measure(x, t.cells).sum()
    done = t.take_out(which)
    t.compact()
    check(t, removed=int(done.sum()))
    assert done.any()
    assert not np.isin(t.cells, which[done]).any()
    assert simplex_measure(x, t.cells).sum() == pytest.approx(area, rel=1e-12)
    away = {cell for cell in before if not set(cell) & set(which[done].tolist())}
    assert away <= as_set(t.cells)


def test_edges_in_empty_space_need_no_particles():
    """However long they are; its edges on the hull do, as those of the surface."""
    x, cells, fluid = half()
    x = x * [1.0, 1.0] + np.where(x[:, 1:] > 3, [[0.0, 4.0]], 0.0)
    for density, inner in (([1.0, 0.0], False), ([1.0, 1.0], True)):
        t = of(x, cells, fluid, density=density)
        named = t.long_edges(2.0)
        cell, i = named // 3, named % 3
        border = (t.neighbours[cell, i] < 0) | (t.fluid[t.neighbours[cell, i]] != t.fluid[cell])
        assert len(named)
        assert (~border).any() == inner
        longest, _ = t.longest_edges(2.0)
        assert set(named.tolist()) <= set(longest.tolist())


def spraying(x, cells, fluid, volume=None, velocity=None):
    """A triangulation of water and empty space, and the spray of its particles in no cell of the water."""
    t = of(x, cells, fluid, wall=np.zeros(len(x)), density=[1000.0, 0.0])
    if velocity is not None:
        t.state[:, VELOCITY : VELOCITY + 2] = velocity
    used = np.zeros(len(x), dtype=bool)
    used[cells[fluid == 0]] = True
    none, own = np.zeros(len(x)), np.zeros(len(x)) if volume is None else volume
    surface = Surface(none > 0, ~used, own > 0, own, none)
    return t, Spray(particles_of(x), surface, 1)


def test_what_is_torn_off_carries_its_volume():
    """A strip of water breaks at a cell in its middle; a piece smaller than a cell flies on."""
    x, cells = grid(np.arange(8), np.arange(8))
    cells = cells.astype(np.int32)
    middle = x[cells].mean(axis=1)
    fluid = np.where(middle[:, 1] < 2, 0, 1).astype(np.int32)
    before = fluid.copy()
    piece = np.flatnonzero((np.abs(middle - [3.5, 5.5]) < 0.5).all(axis=1))[:1]
    before[piece] = fluid[piece] = 0
    t, spray = spraying(x, cells, fluid)
    total = areas(t)[0]
    spray.settle(t, before)
    torn = np.flatnonzero(spray.volume)
    assert set(torn.tolist()) == set(cells[piece].ravel().tolist())
    assert spray.loose[torn].all()
    assert (t.corner[torn] < 0).all()
    t.compact()
    assert areas(t)[0] + spray.volume.sum() == pytest.approx(total, rel=1e-14)
    assert spray.landed[0] == pytest.approx(-0.5, rel=1e-14)
    np.testing.assert_allclose(t.state[:, MASS], masses(t), atol=1e-9)


def test_spray_that_meets_the_water_gives_it_volume_and_momentum():
    x, cells, fluid = half()
    x = np.concatenate([x, [[2.3, 2.4], [4.4, 5.2]]])
    velocity = np.random.default_rng(3).normal(size=(len(x), 2))
    volume = np.zeros(len(x))
    volume[-2:] = 0.3, 0.4
    t, spray = spraying(x, cells, fluid, volume, velocity)
    momentum = t.state[:, MASS] @ t.state[:, VELOCITY : VELOCITY + 2]
    spray.settle(t, fluid.copy())
    np.testing.assert_array_equal(spray.loose[-2:], [False, True])
    np.testing.assert_array_equal(spray.volume[-2:], [0.0, 0.4])
    assert len(x) - 2 in t.removed
    assert len(x) - 1 not in t.removed
    assert spray.landed[0] == pytest.approx(0.3, rel=1e-14)
    changed = np.flatnonzero((t.state[:, VELOCITY : VELOCITY + 2] != velocity).any(axis=1))
    assert len(changed) == 3  # those of its cell: with its mass, they have its momentum too
    mass = t.state[changed, MASS]
    gain = t.state[:, MASS] @ t.state[:, VELOCITY : VELOCITY + 2] - momentum
    mean = mass @ velocity[changed] / mass.sum()
    after = mass @ t.state[changed, VELOCITY : VELOCITY + 2] / mass.sum()
    np.testing.assert_allclose(gain, mass.sum() * (after - mean), atol=1e-9)
    whole = mass.sum() * mean + 300.0 * velocity[-2]
    np.testing.assert_allclose((mass.sum() + 300.0) * after, whole, rtol=1e-12)


def test_spray_that_is_put_into_a_cell_again_gives_back_its_volume():
    """As one that could not be taken out of empty space, into which its neighbour on the surface is moved."""
    x, cells, fluid = half()
    volume = np.zeros(len(x))
    inside, outside, removed = cells[0, 0], *np.setdiff1d(cells[fluid == 1], cells[fluid == 0])[:2]
    volume[[inside, outside, removed]] = 0.1, 0.2, 0.4
    t, spray = spraying(x, cells, fluid, volume)
    t.removed = np.array([removed], dtype=np.int32)
    spray.rejoin(t)
    assert spray.landed[0] == pytest.approx(0.5, rel=1e-14)
    np.testing.assert_array_equal(np.flatnonzero(spray.loose), [outside])
    assert spray.volume.sum() == 0.2


def test_the_fluid_has_its_volume_and_empty_space_the_rest():
    x, cells, fluid = half()
    whole = with_components(Mesh(x, cells, fluid), 2)
    moved, nowhere = whole.measure, np.zeros(len(x), dtype=bool)
    free = np.array([False, True])
    new = restore_volumes(whole, whole, moved, nowhere, np.array([18.3, 0.0]), 0.05, 2, free=free)
    volume = np.bincount(fluid, weights=new.measure)
    np.testing.assert_allclose(volume, [18.3, 36 - 18.3], rtol=1e-13)
    gained = restore_volumes(whole, whole, moved, nowhere, None, 0.05, 2, free=free, gained=np.array([-0.2, 0.0]))
    np.testing.assert_allclose(np.bincount(fluid, weights=gained.measure), [17.8, 18.2], rtol=1e-13)


def test_a_component_is_added_in_empty_space():
    x, cells, fluid = half(9, 9)
    place = np.array([[4.0, 5.6], [4.7, 6.2], [4.1, 6.6]])
    mesh = Mesh(np.concatenate([x, place]), np.concatenate([cells[fluid == 0], [[81, 82, 83]]]).astype(np.int32))
    empty = around(mesh, cells[fluid == 1], len(x), 1.0)
    measure = simplex_measure(mesh.position, empty)
    assert (measure > 0).all()
    assert measure.sum() == pytest.approx(64 - 24 - mesh.measure[-1], rel=1e-12)
    hull = Mesh(mesh.position, np.concatenate([mesh.cells, empty])).neighbours < 0
    assert hull.sum() == 32


def run(tank, steps, fluids=(WATER,), dt=2e-3, **options) -> tp.Simulation:
    """So many steps, in each of which the cells are sound and the volumes kept."""
    sim = tp.Simulation(tp.Case(tank, list(fluids), GRAVITY, free_surface=True, **options), time_step=dt)
    assert sim.case.interface == "sharp"
    for _ in range(steps):
        sim.step()
        mesh, surface = sim.mesh, sim.mesh.surface
        assert (mesh.measure > 0).all()
        whole = simplex_measure(sim.particles.position, surface.empty).sum() + mesh.measure.sum()
        assert whole == pytest.approx(np.prod(tank.size), rel=1e-9)
        assert sim.state.volume_error <= 1e-12
        assert not sim.particles.pressure[surface.pinned].any()
    return sim


@pytest.mark.slow
def test_water_runs_along_a_floor_and_up_a_wall():
    """The edges of the surface are kept but where it meets walls, and the particles are as many as at the start."""
    tank = tp.tank((0.4, 0.4), 0.025).fill(WATER, box=((0, 0), (0.15, 0.25)))
    count = len(tank.sample([WATER], empty=True))
    sim = run(tank, 250)
    assert len(sim.particles) == count
    assert sim.particles.position[sim.mesh.used].max(axis=0) == pytest.approx([0.4, 0.2], abs=0.2)
    assert sum(row["relocated"] for row in sim.history) > 0
    assert max(row["spray_volume_water"] for row in sim.history) > 0
    gain = np.diff([row["kinetic_energy"] + row["potential_energy"] for row in sim.history])
    assert gain.max() < 1e-3 * sim.history[0]["potential_energy"]


@pytest.mark.slow(but=("3-True",))
@pytest.mark.parametrize(("count", "corner"), [(3, False), (3, True), (6, False)])
def test_a_block_that_lands_keeps_its_volume(count, corner):
    """A few particles, at 4 m/s, on the floor and in a corner."""
    left, h = (0.033, 0.01) if corner else (0.2, 0.01)
    velocity = (-1.5, -4.0) if corner else (0.3, -4.0)
    box = ((left, 0.05), (left + count * h, 0.05 + count * h))
    run(tp.tank((0.6, 0.4), h).fill(WATER, box=box, velocity=velocity), 60, dt=1e-3)


@pytest.mark.parametrize("roof", [(), ((0.3, 0.4), (0.3, 0.3))])
def test_walls_stop_a_surface_within_a_step(roof):
    """The lower side of a block passes the floor in a step, in a convex tank and in one that is not."""
    top = 0.3 if roof else 0.4
    tank = tp.tank(shape=tp.shapes.polygon([(0, 0), (0.6, 0), (0.6, 0.4), *roof, (0, top)]), spacing=0.01)
    tank.fill(WATER, box=((0.2, 0.0142), (0.26, 0.0742)), velocity=(0.0, -8.0))
    sim = tp.Simulation(tp.Case(tank, [WATER], GRAVITY, free_surface=True), time_step=2e-3)
    while not sim.mesh.surface.used[sim.particles.wall].any():
        sim.step()
    for row in sim.history:
        assert row["refused_steps"] == 0
        assert abs(row["energy_residual"]) < 1e-9 * row["kinetic_energy"]
    assert sim.state.volume_error <= 1e-12
    floor = np.abs(sim.particles.position[:, 1]) < 1e-9
    assert (floor & sim.mesh.surface.used).sum() >= 5


@pytest.mark.slow
def test_two_fluids_end_at_one_surface():
    """They keep their volumes to round-off, each with a pressure of its own at their interface."""
    tank = tp.tank((0.6, 0.4), 0.03).fill(WATER, box=((0, 0), (0.15, 0.15))).fill(OIL, box=((0, 0.15), (0.15, 0.3)))
    sim = run(tank, 60, fluids=(WATER, OIL))
    assert sim.pressure_jump is not None
    for name in ("water", "oil"):
        assert sim.volume(name) == pytest.approx(0.15**2, rel=1e-12)


def test_walls_that_no_fluid_wets_stay_where_they_are():
    """Also where they slip, and after they have been wet."""
    tank = tp.tank((0.4, 0.3), 0.025).fill(WATER, box=((0, 0), (0.15, 0.2)))
    for side in ("left", "right", "bottom", "top"):
        tank.wall(side, slip=True)
    sim = run(tank, 60)
    dry = sim.mesh.surface.dry(sim.particles.wall)
    assert dry.sum() > 10
    assert not sim.particles.velocity[dry].any()


def test_the_lengths_of_new_meshes_are_refused():
    tank, rule = tp.tank((0.4, 0.3), 0.05).fill(WATER, box=((0, 0), (0.2, 0.2))), tp.SurfaceRule(alpha=1.3)
    numerics = tp.Numerics(surface=rule)
    with pytest.raises(ValueError, match="'interpolated'"):
        tp.Case(tank, [WATER], GRAVITY, free_surface=True, numerics=numerics)
    tp.Case(tank, [WATER], GRAVITY, free_surface=True, numerics=numerics, interface="interpolated")


def test_a_result_of_a_solve_can_be_asked_for_times_within_the_step():
    sim = run(tp.tank((0.4, 0.3), 0.05).fill(WATER, box=((0, 0), (0.2, 0.2))), 3)
    assert isinstance(sim.solved, Solved)
    _, mesh = sim.solved.at(sim.time - 0.5 * sim.solved.dt)
    assert mesh.surface.exists
