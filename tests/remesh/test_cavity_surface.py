"""Free surfaces in three dimensions: cells of empty space beyond them, spray, drops, and what goes together."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial import ConvexHull, cKDTree

import tipfem as tp
from tipfem.errors import TriangulationError
from tipfem.geometry.place import along_curve
from tipfem.mesh.delaunay import triangulate
from tipfem.mesh.mesh import Mesh, simplex_measure
from tipfem.remesh.cavity.arrays import WALL
from tipfem.remesh.cavity.balance import Wanted, components_of, restore_nearby
from tipfem.remesh.cavity.cavities import measures
from tipfem.remesh.cavity.empty_cells import Slipping, extended, first_nodes, first_on_walls, followed
from tipfem.remesh.cavity.flight import IN_FRONT, SMALL, Flight, dissolved, landed, released, stopped
from tipfem.remesh.stages import conversion
from tipfem.remesh.stages.in_space import wet

WATER, OIL = tp.Fluid("water", 1000.0, 1e-3), tp.Fluid("oil", 800.0, 1e-2)
GRAVITY = (0, 0, -9.81)


def dam(spacing, dimension=3, seed=0, **wall):
    """A dam break in a tank of 1.5 x 0.4 x 0.8 m, or in a slice of it."""
    size, upper = ((1.5, 0.4, 0.8), (0.5, 0.4, 0.4)) if dimension == 3 else ((1.5, 0.8), (0.5, 0.4))
    tank = tp.tank(size, spacing, jitter=0.15 if dimension == 3 else 0.0, seed=seed)
    tank.fill(WATER, box=((0,) * dimension, upper))
    for side in tank.sides if wall else ():
        tank.wall(side, **wall)
    case = tp.Case(tank, [WATER], (0,) * (dimension - 1) + (-9.81,), free_surface=True)
    return tp.Simulation(case, time_step=4e-3)


def front_and_height(simulation):
    """How far the water reaches along the floor, and how high up the wall behind it [m]."""
    x = simulation.particles.position[simulation.mesh.used]
    return x[:, 0].max(), x[x[:, 0] < 1e-6, -1].max()


def wave(spacing, dimension, **wall):
    """A wave of half its length in a tank, along x."""
    size = (1, 0.3, 0.9) if dimension == 3 else (1, 0.9)
    tank = tp.tank(size, spacing, jitter=0.15 if dimension == 3 else 0.0)
    tank.fill(WATER, where=lambda x: x[:, -1] < 0.5 + 0.05 * np.cos(np.pi * x[:, 0]))
    for side in tank.sides:
        tank.wall(side, **wall)
    case = tp.Case(tank, [WATER], (0,) * (dimension - 1) + (-9.81,), free_surface=True)
    return tp.Simulation(case, time_step=8e-3)


def amplitude(simulation):
    """Of the mode of half a wave [m]."""
    x = simulation.particles.position[simulation.mesh.surface.front]
    shape = np.cos(np.pi * x[:, 0])
    return ((x[:, -1] - 0.5) * shape).sum() / (shape**2).sum()


def tank_is_whole(simulation):
    """Check that the cells of fluids and of empty space fill the tank, and no two of them the same place."""
    mesh, surface = simulation.mesh, simulation.mesh.surface
    x = np.concatenate([mesh.position, surface.nodes])
    empty = simplex_measure(x, surface.empty)
    assert empty.min() > 0
    assert mesh.measure.min() > 0
    walls = mesh.position[simulation.particles.wall]
    assert mesh.measure.sum() + empty.sum() == pytest.approx(ConvexHull(walls - walls[0]).volume, rel=1e-11)
    both = Mesh(x, np.concatenate([mesh.cells, surface.empty]))
    inner = both.neighbours[: len(mesh.cells)]
    np.testing.assert_array_equal(np.where(inner < len(mesh.cells), inner, -1), mesh.neighbours)
    used = np.zeros(len(x), dtype=bool)
    used[both.cells] = True
    assert (used | np.append(surface.loose, np.zeros(len(surface.nodes), dtype=bool))).all()


@pytest.mark.parametrize("count", [8, 10, 12, 14])
def test_the_first_mesh_of_a_block_is_the_block(count):
    """With its edges, which no particle leaves."""
    simulation = dam(1 / count)
    assert simulation.mesh.measure.sum() == pytest.approx(0.08, rel=1e-13)
    tank_is_whole(simulation)


def test_the_first_mesh_of_a_ball_has_its_corners_on_it():
    tank = tp.tank((1, 1, 1), 0.1, jitter=0.15).fill(WATER, disc=((0.5, 0.5, 0.5), 0.3))
    simulation = tp.Simulation(tp.Case(tank, [WATER], GRAVITY, free_surface=True))
    mesh = simulation.mesh
    np.testing.assert_allclose(np.linalg.norm(mesh.position[mesh.surface.front] - 0.5, axis=1), 0.3, atol=1e-6)
    assert simulation.volume("water") == pytest.approx(4 / 3 * np.pi * 0.3**3, rel=0.07)
    assert not mesh.surface.loose.any()
    tank_is_whole(simulation)


@pytest.mark.slow
def test_a_dam_breaks_as_in_the_plane():
    """Front within 5 %, height within 1 %, of those of a slice of the same spacing; numerics lose less than 5 %.

    The front is that of the particle that is farthest, and so 1 to 5 % ahead, of five starts.
    """
    space, plane = dam(1 / 12), dam(1 / 12, 2)
    for until in (0.1, 0.2, 0.3):
        for simulation in (space, plane):
            while simulation.time < until - 1e-9:
                simulation.step(until)
        (front, height), (far, high) = front_and_height(space), front_and_height(plane)
        assert front == pytest.approx(far, rel=0.05)
        assert height == pytest.approx(high, rel=0.01)
    assert sum(row["refused_steps"] for row in space.history) == 0
    assert space.numerical_error()["energy"] < 0.05
    assert space.volume("water") == pytest.approx(0.08, rel=1e-12)
    tank_is_whole(space)


@pytest.mark.slow
@pytest.mark.parametrize("wall", [{"law": "layer"}, {"slip": True}, {"law": "no-slip"}])
@pytest.mark.parametrize("seed", range(3))
def test_a_dam_break_runs_through_its_impact(wall, seed):
    simulation = dam(1 / 10, seed=seed, **wall)
    simulation.run(until=1.0, progress=False)
    assert simulation.volume("water") == pytest.approx(0.08, rel=1e-12)
    tank_is_whole(simulation)


@pytest.mark.slow
def test_a_wave_has_the_period_of_the_plane_and_is_not_damped():
    """The first two passages through zero within 1 % of those of a slice, and both crests within 3 % of the first."""
    crossings, crests = [], []
    for dimension in (3, 2):
        simulation = wave(0.1, dimension, slip=True)
        times, heights = [0.0], [amplitude(simulation)]
        while simulation.time < 1.3:
            simulation.step()
            times.append(simulation.time)
            heights.append(amplitude(simulation))
        t, a = np.array(times), np.array(heights)
        k = np.flatnonzero(a[:-1] * a[1:] < 0)[:2]
        crossings.append(t[k] - a[k] * (t[k + 1] - t[k]) / (a[k + 1] - a[k]))
        crests.append(np.abs([a[: k[1]].min(), a[k[1] :].max()]) / a[0])
    np.testing.assert_allclose(crossings[0], crossings[1], rtol=0.01)
    np.testing.assert_allclose(crests[0], 1.0, atol=0.03)


@pytest.mark.slow
def test_a_ball_falls_freely():
    """Its centre as a stone does; its momentum, volume and shape stay."""
    tank = tp.tank((1, 1, 1.5), 0.125, jitter=0.15).fill(WATER, disc=((0.5, 0.5, 1.0), 0.27))
    simulation = tp.Simulation(tp.Case(tank, [WATER], GRAVITY, free_surface=True), time_step=4e-3)
    mass, place = simulation.state.mass, simulation.particles.position
    start, volume = mass @ place / mass.sum(), simulation.volume("water")
    simulation.run(until=0.2, progress=False)
    mass, particles = simulation.state.mass, simulation.particles
    fallen = mass @ particles.position / mass.sum() - start
    np.testing.assert_allclose(fallen, [0, 0, -0.5 * 9.81 * 0.04], atol=1e-3)
    np.testing.assert_allclose(mass @ particles.velocity / mass.sum(), [0, 0, -9.81 * 0.2], atol=1e-9)
    assert simulation.volume("water") == pytest.approx(volume, rel=1e-12)


def test_nodes_are_where_no_particle_is():
    simulation = dam(1 / 10)
    case = simulation.case
    x, nodes = (
        case.particles.position,
        first_nodes(case.particles.position, case.particles.fluid >= 0, 0.1, case.boundary.domain),
    )
    apart = np.linalg.norm(nodes[:, None] - x, axis=2).min(axis=1)
    assert len(nodes) > 40
    assert apart.min() > 0.1
    assert not ((nodes[:, 0] < 0.5) & (nodes[:, 2] < 0.4)).any()


def test_dry_walls_begin_with_fewer_particles():
    """Edges of the tank keep theirs, and so do walls that do not slide and those beside the water."""
    tank = tp.tank((1.5, 0.4, 0.8), 0.05, jitter=0.15).fill(WATER, box=((0, 0, 0), (0.3, 0.4, 0.4)))
    case = tp.Case(tank, [WATER], GRAVITY, free_surface=True)
    particles, domain, planes = case.particles, case.boundary.domain, case.boundary.planes
    wet = particles.fluid >= 0
    given = particles.position, wet
    kept = np.isin(np.arange(len(particles)), first_on_walls(*given, planes, 0.05, domain))
    off = cKDTree(particles.position[wet]).query(particles.position)[0] / 0.05
    assert kept[(planes.sum(axis=1) != 1) | (off < 4)].all()
    for least, most, part in ((4.6, 9.4, 0.25), (9.6, np.inf, 1 / 16)):
        there = (planes.sum(axis=1) == 1) & (off > least) & (off < most)
        assert there.sum() > 50
        assert kept[there].mean() == pytest.approx(part, rel=0.35)
    none = np.zeros_like(planes)
    assert len(first_on_walls(*given, none, 0.05, domain)) == len(particles)


def cube(seed, count=60):
    """Particles of the faces of a cube and of a smaller one in it, and nodes between them; cells beyond the latter."""
    rng = np.random.default_rng(seed)
    axis = np.linspace(0, 1, 6)
    grid = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    grid += 0.02 * rng.normal(size=grid.shape) * ((grid > 0) & (grid < 1))
    hull = (np.abs(grid - 0.5) > 0.49).any(axis=1)
    inner = (np.abs(grid - 0.5) < 0.15).all(axis=1)
    x, nodes = grid[hull | inner], grid[~hull & ~inner]
    mesh = triangulate(np.concatenate([x, nodes]), np.zeros(len(grid), dtype=bool), 0.2)
    fluid = (np.abs(mesh.position[mesh.cells] - 0.5) < 0.2).all(axis=(1, 2))
    return x, nodes, mesh.cells[~fluid], (np.abs(x - 0.5) < 0.25).all(axis=1)


def test_what_the_surface_has_spreads_among_the_nodes():
    """A constant to all that it reaches in the sweeps, and values between those of the particles to all others."""
    x, nodes, cells, inner = cube(0)
    mesh, rows = Mesh(np.concatenate([x, nodes]), cells), len(x) + np.arange(len(nodes), dtype=np.int32)
    same = extended(mesh, np.concatenate([np.ones((len(x), 2)), np.full((len(nodes), 2), np.nan)]), rows)
    np.testing.assert_allclose(same, 1.0, atol=0.02)
    value = np.concatenate([inner.astype(float), np.zeros(len(nodes))])[:, None]
    found = extended(mesh, value, rows)[len(x) :, 0]
    assert found.min() > 0
    assert found.max() < 1


def test_some_of_a_value_is_held():
    """Along the directions that projectors leave, values spread; at right angles to these they stay."""
    x, nodes, cells, inner = cube(1)
    mesh, count = Mesh(np.concatenate([x, nodes]), cells), len(x) + len(nodes)
    value = np.zeros((count, 3))
    value[: len(x)][inner] = 1.0
    rows = np.arange(len(x), count, dtype=np.int32)
    value[rows, 2] = 7.0
    along = np.tile(np.diag([1.0, 1.0, 0.0]), (len(rows), 1, 1))
    found, free = extended(mesh, value, rows, along=along)[rows], extended(mesh, value, rows)[rows]
    np.testing.assert_array_equal(found[:, 2], 7.0)
    np.testing.assert_allclose(found[:, :2], free[:, :2], rtol=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_empty_space_follows_a_motion_that_turns_its_cells_over(seed):
    """By two spacings and a half, where its hull stays; so far that parts would meet it refuses to."""
    x, nodes, cells, inner = cube(seed)
    after = x + inner[:, None] * np.array([0.3, 0.0, 0.0])
    volume = simplex_measure(np.concatenate([x, nodes]), cells).sum()
    held = Slipping(np.zeros(0, dtype=np.int32), np.zeros((0, 3, 3)), np.zeros((len(x), 6), dtype=bool), np.arange(6))
    mesh = Mesh(np.concatenate([x, nodes]), cells)
    moved = followed(mesh, after, 0.2, held)
    found, places = moved.cells, moved.position
    np.testing.assert_array_equal(moved.neighbours, Mesh(places, found).neighbours)
    np.testing.assert_array_equal(places[: len(x)], after)
    each = simplex_measure(places, found)
    assert each.min() > 0
    assert each.sum() == pytest.approx(volume, rel=1e-9)
    assert len(found) != len(cells) or (found != cells).any()
    with pytest.raises(TriangulationError, match=r"at \[.*\] two parts of the free surface"):
        followed(mesh, x + inner[:, None] * np.array([0.7, 0.0, 0.0]), 0.2, held)


def test_a_dry_wall_gives_way_to_a_contact_line():
    """Particles of its faces slide or go where one that slides as well passes them; those held refuse."""
    axis, spacing = np.linspace(0, 1, 6), 0.2
    x = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    outer = np.stack([x[:, k] == end for k in range(3) for end in (0.0, 1.0)], axis=1)
    order = np.argsort(~outer.any(axis=1), kind="stable")
    x, outer = x[order], outer[order]
    count = np.count_nonzero(outer.any(axis=1))
    inside = ~outer.reshape(-1, 3, 2).any(axis=2)
    x = x + 0.02 * np.random.default_rng(0).normal(size=x.shape) * inside
    cells = triangulate(x, outer.any(axis=1), spacing).cells
    planes = outer[:count]
    face = planes.sum(axis=1) == 1
    one = np.flatnonzero(face & planes[:, 4])[np.argmin(np.abs(x[:count][face & planes[:, 4], :2] - 0.2).sum(axis=1))]
    rows = np.setdiff1d(np.flatnonzero(face), one).astype(np.int32)
    along = np.eye(3) - planes[rows].reshape(-1, 3, 2).any(axis=2)[:, None] * np.eye(3)
    after = x[:count].copy()
    after[one, 0] += 2.2 * spacing
    moved = followed(Mesh(x, cells), after, spacing, Slipping(rows, along, planes, np.arange(planes.shape[1])))
    found, places = moved.cells, moved.position
    each = simplex_measure(places, found)
    assert each.min() > 0
    assert each.sum() == pytest.approx(1.0, rel=1e-12)
    assert places[one, 0] == after[one, 0]
    for k in range(6):  # all of them are where they were, on their planes
        np.testing.assert_allclose(places[:count][planes[:, k], k // 2], k % 2, atol=1e-15)
    held = Slipping(rows[:0], along[:0], planes, np.arange(planes.shape[1]))
    with pytest.raises(TriangulationError, match="meet in the step"):
        followed(Mesh(x, cells), after, spacing, held)


def test_what_a_fluid_has_reached_slides_along_with_it():
    """A particle of a dry floor has the velocity along it of the water that has come there, or it would stop that."""
    simulation = dam(1 / 8)
    simulation.step()
    state, remesher = simulation.solved.before, simulation.remesher
    particles, used = state.particles, state.mesh.used
    particles.velocity[used & ~particles.wall] = 2.0, 0.5, -1.0
    particles.velocity[used & particles.wall] = 2.0, 0.5, 0.0
    slipping = conversion.slipping(state, simulation.solved.walls)
    floor = (particles.position[:, 2] == 0) & (state.boundary.planes.sum(axis=1) == 1)
    dry = np.isin(np.arange(len(particles)), slipping.rows) & floor
    _, whole = conversion.whole(remesher._rules, state, particles)
    cavities = conversion.cavities_of(remesher._rules, whole, particles, state.boundary, state.fixed)
    corner = np.where(whole.cells < len(particles), whole.cells, 0)
    real = whole.cells < len(particles)
    near = (real & used[corner]).any(axis=1) & (real & dry[corner]).any(axis=1) & (np.asarray(whole.fluid) == 0)
    cell = whole.cells[np.flatnonzero(near)[0]]
    cavities.label[np.flatnonzero(near)[0]] = 1
    before = cavities.fields.copy()
    wet(cavities, slipping)
    reached = np.intersect1d(cell, np.flatnonzero(dry))
    others = np.setdiff1d(cell, slipping.rows)
    np.testing.assert_allclose(
        cavities.fields[reached, :2], np.tile(before[others, :2].mean(axis=0), (len(reached), 1))
    )
    assert (cavities.fields[reached, 0] > 0).all()
    assert (cavities.fields[reached, 2] == 0).all()
    rest = np.setdiff1d(np.arange(len(before)), np.intersect1d(cell, slipping.rows))
    np.testing.assert_array_equal(cavities.fields[rest], before[rest])


def test_what_has_passed_a_wall_is_stopped_there():
    """Particles of the surface and of the floor, with the part of their velocity that a moving wall leaves them."""
    simulation = dam(1 / 8, slip=True)
    particles, h, boundary = simulation.particles.copy(), 1 / 8, simulation.state.boundary
    slides = boundary.slides
    walls = SimpleNamespace(sliding=boundary.index[slides], columns=boundary.free[slides].reshape(-1, 9))
    x, v = particles.position, particles.velocity
    off = np.flatnonzero(~particles.wall)[0]
    floor = np.flatnonzero(particles.wall & (x[:, 2] < 1e-9) & (np.abs(x[:, 0] - 0.5) < 0.1) & (x[:, 1] > 0.1))[0]
    far = particles.wall & (np.abs(x[:, 0] - 1.5) < 1e-9)
    x[off], v[off] = (0.5, 0.2, -0.3 * h), (1.0, 0.5, -2.0)
    x[floor, 0], v[floor] = 1.5 + 0.2 * h, (3.0, 0.25, 0.0)
    v[far, 0] = -0.5
    may = np.zeros(len(particles), dtype=bool)
    may[[off, floor]] = True
    kept = stopped(particles, may, walls, boundary.planes)
    np.testing.assert_allclose(kept.position[off], (0.5, 0.2, IN_FRONT * h), atol=1e-12)
    np.testing.assert_allclose(kept.velocity[off], (1.0, 0.5, 0.0), atol=1e-12)
    np.testing.assert_allclose(kept.position[floor], (1.5 - IN_FRONT * h, x[floor, 1], 0.0), atol=1e-12)
    np.testing.assert_allclose(kept.velocity[floor], (-0.5, 0.25, 0.0), atol=1e-12)
    others = ~may
    np.testing.assert_array_equal(kept.position[others], x[others])
    assert stopped(particles, may & False, walls, boundary.planes) is particles


def test_empty_space_is_coarse_away_from_the_fluid():
    """And dry walls are; edges within 2 spacings of the water are as long as its own."""
    spacing, kept = 1 / 12, 1.5
    simulation = dam(spacing)
    for _ in range(4):
        simulation.step()
    mesh, surface, particles = simulation.mesh, simulation.mesh.surface, simulation.particles
    x = np.concatenate([mesh.position, surface.nodes])
    one, other = np.triu_indices(4, 1)
    edge = np.unique(np.sort(surface.empty[:, np.stack([one, other])].transpose(0, 2, 1).reshape(-1, 2)), axis=0)
    length = np.linalg.norm(x[edge[:, 0]] - x[edge[:, 1]], axis=1) / spacing
    off = cKDTree(mesh.position[mesh.used]).query(x)[0][edge].max(axis=1) / spacing
    assert length[off < kept].mean() < 1.3
    assert length[off > 5].mean() > 2.2
    dry = particles.wall & ~mesh.used
    far = dry & (cKDTree(mesh.position[mesh.used]).query(mesh.position)[0] > 5 * spacing)
    area = 1.5 * 0.8 * 2 + 0.4 * 0.8 + 0.4 * 1.5  # of walls, of which most is far
    assert 10 < far.sum() < 0.2 * area / spacing**2
    tank_is_whole(simulation)


@pytest.mark.parametrize("seed", [1, 2])
def test_edges_of_a_narrow_tank_keep_a_particle(seed):
    """Corners are held, and an edge between two of them would never be split when the water comes."""
    simulation = dam(0.1, seed=seed, slip=True)
    for _ in range(4):
        simulation.step()
    x = simulation.particles.position
    y = x[(np.abs(x[:, 0] - 1.5) < 1e-9) & (np.abs(x[:, 2]) < 1e-9), 1]
    assert np.diff(np.sort(y)).max() < 3 * 0.1


def test_particles_are_sorted_by_their_places():
    """Where cells have changed, so that those of a cell are near in memory. All else follows them."""
    simulation, is_sorted = dam(1 / 10), []
    while not is_sorted or not is_sorted[-1]:
        simulation.step()
        places = along_curve(simulation.particles.position, simulation.particles.spacing)
        is_sorted.append(bool((np.diff(places) >= 0).all()))
    assert len(is_sorted) > 1
    state = simulation.state
    x, boundary = state.particles.position, state.boundary
    walls = ((x[:, None] < 1e-9) | (x[:, None] > np.array([1.5, 0.4, 0.8]) - 1e-9)).any(axis=(1, 2))
    assert (np.flatnonzero(walls) == boundary.index).all()
    assert (boundary.planes.any(axis=1) == walls).all()
    assert (state.particles.wall == walls).all()


@pytest.mark.slow
def test_empty_space_far_from_the_surface_is_left_alone():
    """Its cells are neither cut nor joined in a step of a dam break, beside a few close to the water."""
    simulation = dam(1 / 16)
    for _ in range(5):
        simulation.step()
    before = np.sort(simulation.mesh.surface.empty, axis=1)
    place = np.concatenate([simulation.mesh.position, simulation.mesh.surface.nodes])
    simulation.step()
    after = np.concatenate([simulation.mesh.position, simulation.mesh.surface.nodes])
    assert abs(len(after) - len(place)) < 0.01 * len(place)
    size = min(len(before), len(simulation.mesh.surface.empty))
    same = (before[:size] == np.sort(simulation.mesh.surface.empty[:size], axis=1)).all(axis=1)
    assert same.mean() > 0.9


def test_spray_lands_with_its_volume_and_momentum():
    """A particle that has come down in the water gives it its volume, and its momentum to the corners of a cell."""
    simulation = dam(1 / 8)
    state, particles = simulation.state, simulation.particles
    nothing = np.zeros(len(particles), dtype=bool)
    _, whole = conversion.whole(simulation.remesher._rules, state, particles)
    ones, density = np.ones(len(particles) + 1, dtype=np.int64), np.array([0.0, 1000.0])
    old = Wanted.of_mesh(whole, np.array([0.0, 0.08]))
    flying = np.flatnonzero(~particles.wall & ~state.mesh.surface.front)[0]
    # A particle that is in the water, but in none of its cells.
    more = particles.shallow_copy(
        position=np.vstack([particles.position, particles.position[flying] + 1e-3]),
        velocity=np.vstack([particles.velocity, [[3.0, 2.0, 1.0]]]),
        wall=np.append(particles.wall, False),
        target=np.append(particles.target, particles.spacing),
    )
    carried = Flight(np.append(nothing, True), np.append(nothing * 0.0, 1e-4), ones)
    place = np.insert(whole.position, len(particles), more.position[-1], axis=0)
    cells = np.where(whole.cells >= len(particles), whole.cells + 1, whole.cells).astype(np.int32)
    shifted = Mesh(place, cells, whole.fluid).with_(neighbours=whole.neighbours)
    new, flight, wanted = landed(shifted, more, carried, old, density, more.position * 0.0)
    assert not flight.loose.any()
    assert wanted.volume.sum() == pytest.approx(0.0801, rel=1e-12)
    mass = np.bincount(cells[np.asarray(whole.fluid) == 1].ravel(), minlength=len(place)) * 0.0
    for column in cells[np.asarray(whole.fluid) == 1].T:
        np.add.at(mass, column, 250.0 * shifted.measure[np.asarray(whole.fluid) == 1])
    gained = (mass[: len(more), None] * (new.velocity - more.velocity)).sum(axis=0)
    full = 0.1 * np.array([3.0, 2.0, 1.0])
    assert (gained > 0.9 * full).all()
    assert (gained < full).all()  # with the mass that it brings, all of it


def test_spray_does_not_pass_a_thin_sheet():
    """One that moves by three spacings in a step lands in a sheet on its way, unless that moves along with it."""
    simulation, way = dam(1 / 8), np.array([0.02, 0.03, -0.36])
    particles = simulation.particles
    _, whole = conversion.whole(simulation.remesher._rules, simulation.state, particles)
    sheet = (np.asarray(whole.fluid) * (np.abs(whole.centres()[:, 2] - 0.2) < 0.1)).astype(np.int32)
    count, end = len(particles), np.array([0.25, 0.2, 0.03])
    more = particles.shallow_copy(
        position=np.vstack([particles.position, end]),
        velocity=np.vstack([particles.velocity, [[0.0, 0.0, -90.0]]]),
        wall=np.append(particles.wall, False),
        target=np.append(particles.target, particles.spacing),
    )
    cells = np.where(whole.cells >= count, whole.cells + 1, whole.cells).astype(np.int32)
    mesh = Mesh(np.insert(whole.position, count, end, axis=0), cells, sheet).with_(neighbours=whole.neighbours)
    nothing = np.zeros(count, dtype=bool)
    ones = np.ones(count + 1, dtype=np.int64)
    flight = Flight(np.append(nothing, True), np.append(nothing * 0.0, 1e-4), ones)
    old, density = Wanted.of_mesh(mesh, np.array([0.0, 0.05]), empty=True), np.array([0.0, 1000.0])
    moves = np.vstack([np.zeros_like(mesh.position[:count]), way])
    for motion, lands in ((moves, True), (np.tile(way, (count + 1, 1)), False), (moves * 0.0, False)):
        new, flown, wanted = landed(mesh, more, flight, old, density, motion)
        assert flown.loose[-1] != lands
        assert wanted.volume.sum() - old.volume.sum() == pytest.approx(1e-4 * lands, abs=1e-15)
        hit = np.flatnonzero((new.velocity[:count] != more.velocity[:count]).any(axis=1))
        assert len(hit) > 0 if lands else not len(hit)
        assert not lands or (mesh.position[hit, 2] > 0.1).all()
    # Out of reach of all cells, but in the cubes around theirs.
    high = more.shallow_copy(position=np.vstack([particles.position, [0.25, 0.2, 0.74]]))
    assert landed(mesh, high, flight, old, density, moves * 0.0)[1].loose[-1]


def pieces_of(spacing: float, chosen):
    """Cavities of a dam, an empty cell whose corners are ``chosen``, now of water, all pieces, and the spray."""
    simulation = dam(spacing)
    state, particles, rules = simulation.state, simulation.particles, simulation.remesher._rules
    _, whole = conversion.whole(rules, state, particles)
    cavities = conversion.cavities_of(rules, whole, particles, state.boundary, state.fixed)
    wet = np.zeros(len(cavities.x), dtype=bool)
    wet[whole.cells[np.asarray(whole.fluid) == 1]] = True
    apart = ~wet[whole.cells].any(axis=1) & (whole.measure < SMALL * spacing**3)
    cell = np.flatnonzero(apart & chosen((cavities.marks & WALL != 0)[whole.cells]))[0]
    cavities.label[cell] = 1
    cavities.mark()
    given = cavities.x, cavities.cells, cavities.across, cavities.label
    return cavities, cell, components_of(*given, empty=True), conversion.flight_of(state, rules.labels)


def test_a_piece_that_is_too_small_flies_on():
    """A cell off the water becomes spray with its volume and velocities, and its corners nodes."""
    cavities, cell, piece, flight = pieces_of(1 / 10, lambda wall: ~wall.any(axis=1))
    corners, before, places = cavities.cells[cell].copy(), cavities.mesh(), cavities.x[cavities.cells]
    measure, count = before.measure.sum(), len(before.cells)
    volume = measures(cavities.x, cavities.cells[[cell]])[0]
    assert volume < SMALL / 10**3
    assert piece[cell] not in np.delete(piece, cell)
    dissolved(cavities, piece)
    assert cavities.label[cell] == 1  # it can fly
    cavities.fields[corners, :3] = np.arange(12.0).reshape(4, 3)
    flight = released(cavities, piece, flight)
    np.testing.assert_array_equal(np.flatnonzero(flight.loose), np.sort(corners))
    np.testing.assert_allclose(flight.volume[corners], volume / 4, rtol=1e-12)
    assert (flight.label[corners] == 1).all()
    np.testing.assert_array_equal(cavities.fields[corners, :3], np.arange(12.0).reshape(4, 3))
    assert cavities.label[cell] == 0
    after = cavities.mesh()
    assert not np.isin(after.cells, corners).any()
    np.testing.assert_array_equal(cavities.x[cavities.cells[:count]], places[:count])
    assert (len(after.cells), after.measure.sum()) == (count, measure)


def test_a_piece_in_a_corner_that_cannot_fly_goes_to_the_water():
    """All of its particles are on walls: its cell becomes empty, and restored volumes have what it had."""
    cavities, cell, piece, flight = pieces_of(1 / 10, lambda wall: wall.all(axis=1))
    assert released(cavities, piece, flight) is flight
    dissolved(cavities, piece)
    assert cavities.label[cell] == 0
    assert piece[cell] == piece.max() == piece[np.flatnonzero(cavities.label == 0)[0]]
    # One beside another fluid stays, and all of a fluid.
    given, water = (cavities.x, cavities.cells, cavities.across, cavities.label), np.flatnonzero(cavities.label == 1)
    cavities.label[water[: len(water) // 2]] = 2
    cavities.label[[cell, cavities.across[cell].max()]] = 2, 1
    dissolved(cavities, components_of(*given, empty=True))
    assert cavities.label[cell] == 2
    cavities.label[cavities.label > 0] = 0
    cavities.label[cell] = 1
    dissolved(cavities, components_of(*given, empty=True))
    assert cavities.label[cell] == 1


@pytest.mark.slow
def test_what_a_film_loses_is_given_back_close_to_it():
    """Not to the whole surface: cells far from a toe that lost a cell keep their places."""
    simulation = dam(1 / 10)
    simulation.run(until=0.2, progress=False)
    state, particles = simulation.state, simulation.particles
    _, whole = conversion.whole(simulation.remesher._rules, state, particles)
    cavities = conversion.cavities_of(simulation.remesher._rules, whole, particles, state.boundary, state.fixed)
    water = np.flatnonzero(np.asarray(whole.fluid) == 1)
    toe = water[np.argmax(whole.centres()[water, 0])]
    lost = whole.measure[toe]
    cavities.label[toe] = 0
    cavities.mark()
    before = cavities.x.copy()
    restore_nearby(cavities, whole, np.array([0.0, 1000.0]))
    moved = np.linalg.norm(cavities.x - before, axis=1) > 0
    assert moved.any()
    apart = np.linalg.norm(before[moved] - whole.centres()[toe], axis=1)
    assert apart.max() < 0.4
    back = cavities.volumes(cavities.label, 2)[1] - (whole.measure[water].sum() - lost)
    assert back == pytest.approx(lost, rel=0.2)


@pytest.mark.slow(but=("arrays", "far away"))
@pytest.mark.parametrize("case", ["oil beside water", "piston", "turned tank", "arrays", "detailed", "far away"])
def test_it_goes_together_with(case):
    """Two fluids under the surface, walls that move, tanks that turn, particles as arrays, options of the method."""
    options, fluids = {}, [WATER]
    tank = tp.tank((1, 0.5, 0.8), 0.125, jitter=0.15)
    tank.fill(WATER, box=((0, 0, 0), (0.5 if case == "oil beside water" else 1, 0.5, 0.4)))
    if case == "oil beside water":
        tank.fill(OIL, box=((0.5, 0, 0), (1, 0.5, 0.4)))
        fluids = [WATER, OIL]
    elif case == "piston":
        tank.wall("left", motion=lambda t: 0.1 * np.sin(4 * t) ** 2, slip=True)
    elif case == "turned tank":
        options["tank_motion"] = tp.Motion(angle=lambda t: 0.4 * np.sin(4 * t) ** 2, axis=(1, 1, 0), pivot=(0, 0, 0))
    elif case == "detailed":
        options["numerics"] = tp.Numerics(budget="detailed", mass="consistent")
    start = tank
    if case in ("arrays", "far away"):
        start = tp.Case(tank, fluids, GRAVITY, free_surface=True).particles
        start.position[:] += 100.0 * (case == "far away")
    simulation = tp.Simulation(tp.Case(start, fluids, GRAVITY, free_surface=True, **options), time_step=4e-3)
    volume = simulation.state.volume.copy()
    simulation.run(until=0.15, progress=False)
    np.testing.assert_allclose(simulation.state.volume, volume, rtol=1e-11)
    assert abs(simulation.history[-1]["energy_residual"]) < 1e-8
    assert sum(row["refused_steps"] for row in simulation.history) == 0
    if case in ("arrays", "far away"):
        assert simulation.particles.max_speed < 1e-9
    tank_is_whole(simulation)


def test_a_drop_falls_into_empty_space():
    """As a ball of water beside the pool, with the velocity of a stone; beside walls there is no room for one."""
    tank = tp.tank((1, 1, 1.4), 0.125, jitter=0.15).fill(WATER, box=((0, 0, 0), (1, 1, 0.4)))
    simulation = tp.Simulation(tp.Case(tank, [WATER], GRAVITY, free_surface=True), time_step=4e-3)
    simulation.step()
    before = simulation.volume("water")
    with pytest.raises(ValueError, match="too close to a wall"):
        simulation.steer(tp.Drop((0.2, 0.5, 0.9), 0.25, "water"))
    simulation.steer(tp.Drop((0.5, 0.5, 0.95), 0.25, "water"))
    assert simulation.volume("water") - before == pytest.approx(4 / 3 * np.pi * 0.25**3, rel=0.12)
    start = simulation.time
    while simulation.time < start + 0.1 - 1e-9:
        simulation.step(start + 0.1)
    high = simulation.particles.position[:, 2] > 0.55
    falls = simulation.particles.velocity[high & simulation.mesh.used]
    np.testing.assert_allclose(falls, np.broadcast_to([0, 0, -0.981], falls.shape), atol=0.02)
    tank_is_whole(simulation)


@pytest.mark.slow
def test_a_run_goes_on_to_the_bit(tmp_path):
    tank = tp.tank((0.8, 0.4, 0.6), 0.1, jitter=0.15).fill(WATER, box=((0, 0, 0), (0.3, 0.4, 0.4)))
    case = tp.Case(tank, [WATER], GRAVITY, free_surface=True)
    whole = tp.Simulation(case, tmp_path, output_interval=0.1, checkpoint_interval=0.1)
    whole.run(until=0.1, progress=False)
    resumed = tp.Simulation.resume(tmp_path)
    for simulation in (whole, resumed):
        for _ in range(6):
            simulation.step()
    for name in ("position", "velocity", "acceleration", "pressure", "fluid"):
        assert getattr(resumed.particles, name).tobytes() == getattr(whole.particles, name).tobytes(), name
    for name in ("empty", "nodes", "volume"):
        one, other = (getattr(simulation.mesh.surface, name) for simulation in (resumed, whole))
        assert one.tobytes() == other.tobytes(), name
