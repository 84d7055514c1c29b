"""Graded spacings: targets, thinned lattices, particles that come and go, and chains on the background grid."""

from __future__ import annotations

import re

import numpy as np
import pytest
from grid_levels import hierarchy, level_matrix
from scipy import sparse
from scipy.spatial import cKDTree
from states import first_state, moved_to

import tipfem as tp
from tipfem.backend.launch import launch
from tipfem.case.grading import Grading, limit_gradation_at_points, thinned
from tipfem.case.numerics import FittedRule
from tipfem.geometry.box_points import BoxPoints
from tipfem.geometry.period import no_period
from tipfem.mesh.components import ON_INTERFACE
from tipfem.mesh.delaunay import triangulate
from tipfem.mesh.mesh import Mesh
from tipfem.remesh.gradation import limit_gradation
from tipfem.remesh.remeshers import FittedRemesher
from tipfem.remesh.stages import repairing
from tipfem.remesh.triangles.fitted import hull_corners, repair

WATER = tp.Fluid("water", density=998.0, viscosity=1e-3)
AIR = tp.Fluid("air", density=1.2, viscosity=1.8e-5)
GRADING = Grading({"air": 0.16}, growth=0.25)


def column(grading=GRADING, **options) -> tp.Case:
    """A column of water in a tank of 1 m x 1 m, at 0.02 m."""
    tank = tp.tank((1.0, 1.0), 0.02).fill(AIR).fill(WATER, box=((0, 0), (0.3, 0.4)))
    return tp.Case(tank, [WATER, AIR], (0.0, -9.81), grading=grading, **options)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Grading(0.01), ["largest is 0.01", "{'air': 0.01}"]),
        (lambda: Grading({"air": -1}), ["air is -1 m", "> 0"]),
        (lambda: Grading({"air": 1}, growth=2), ["growth is 2", "from 0.02 to 0.5"]),
        (lambda: Grading(where=3), ["where is 3", "function of positions"]),
        (lambda: column(Grading({"oil": 0.1})), ["'oil'", "['water', 'air']"]),
        (lambda: column(Grading({"air": 0.01})), ["air is 0.01 m", "below the spacing of 0.02 m"]),
        (lambda: Grading({"air": float("inf")}), ["air is inf", "finite number > 0"]),
        (lambda: column(0.1), ["grading is 0.1", "must be a Grading"]),
        (lambda: column(interface="interpolated"), ["grading", "it needs 'sharp'"]),
        (lambda: column(Grading(where=lambda x: x)), ["where gave shape (2601, 2)", "shape (2601,)"]),
        (lambda: column(Grading({"air": 0.1}, where=lambda x: 0 * x[:, 0])), ["where gave 0.0 at [0.0, 0.0]", "> 0"]),
    ],
)
def test_bad_gradings_are_refused(make, words):
    with pytest.raises(ValueError, match=re.escape(words[0])) as error:
        make()
    for word in words[1:]:
        assert word in str(error.value)


def test_targets_grow_as_a_cone_around_what_is_fine():
    """From one fine point: its own target, growth times the distance more elsewhere, up to what is wished there."""
    x = np.random.default_rng(0).uniform(size=(2000, 2))
    wish = np.full(len(x), 0.1)
    wish[7] = 0.01
    expected = np.minimum(0.1, 0.01 + 0.2 * np.linalg.norm(x - x[7], axis=1))
    np.testing.assert_allclose(limit_gradation_at_points(x, wish, 0.2), expected, rtol=1e-12)
    many = np.random.default_rng(1).uniform(0.01, 0.1, len(x))
    target = limit_gradation_at_points(x, many, 0.2)
    assert (target <= many).all()
    near = cKDTree(x).query(x, k=8)[1][:, 1:]
    steps = target[:, None] - target[near] - 0.2 * np.linalg.norm(x[:, None] - x[near], axis=2)
    assert steps.max() < 0.09 / 15  # sizes are taken to their lower step


@pytest.mark.parametrize("growth", [0.1, 0.4])
def test_growth_is_limited_along_every_edge_of_a_mesh(growth):
    """The kernel gives what relaxation over all edges does, whatever the order of triangles and corners."""
    rng = np.random.default_rng(2)
    particles = column(None).particles
    x = particles.position
    mesh = triangulate(x, particles.wall, 0.02)
    wish = rng.uniform(0.02, 0.3, len(x))
    edges = np.concatenate([mesh.cells[:, [0, 1]], mesh.cells[:, [1, 2]], mesh.cells[:, [2, 0]]])
    edges = np.concatenate([edges, edges[:, ::-1]])
    length = np.linalg.norm(x[edges[:, 0]] - x[edges[:, 1]], axis=1)
    expected = wish.copy()
    for _ in range(200):
        np.minimum.at(expected, edges[:, 0], expected[edges[:, 1]] + growth * length)
    for cells in (mesh.cells, mesh.cells[rng.permutation(len(mesh.cells))][:, [2, 0, 1]].copy()):
        target = wish.copy()
        assert (
            launch(limit_gradation, x, cells, no_period(2).array, target, np.zeros(len(x), dtype=np.int32), growth, 2)
            < 100
        )
        np.testing.assert_allclose(target, expected, rtol=1e-8)


def test_a_tank_is_thinned_away_from_its_interface_and_keeps_its_faces():
    fine, coarse = column(None).particles, column().particles
    assert len(coarse) < 0.4 * len(fine)
    all_of_them = {tuple(x) for x in fine.position.round(9)}
    assert {tuple(x) for x in coarse.position.round(9)} <= all_of_them
    water = np.flatnonzero(fine.fluid == 0)
    assert (coarse.fluid == 0).sum() == len(water)
    assert coarse.spacing == 0.02
    distance, _ = cKDTree(coarse.position).query(coarse.position, k=2)
    gap = distance[:, 1]
    far = (coarse.position > 0.8).all(axis=1) & ~coarse.wall
    assert gap[far].min() > 0.5 * 0.16
    for corner in [(0, 0), (1, 0), (0, 1), (1, 1)]:
        assert (coarse.position == corner).all(axis=1).any()
    mesh = triangulate(coarse.position, coarse.wall, 0.02)
    np.testing.assert_allclose(mesh.measure.sum(), 1.0, rtol=1e-12)


def test_a_function_of_places_refines_there():
    where = lambda x: np.where(np.linalg.norm(x - 0.7, axis=1) < 0.1, 0.03, 1.0)  # noqa: E731
    plain, refined = (column(Grading({"air": 0.16}, where=w)).particles for w in (None, where))
    near = [(np.linalg.norm(p.position - 0.7, axis=1) < 0.1).sum() for p in (plain, refined)]
    assert near[1] >= 4 * near[0]


def test_without_a_larger_target_nothing_is_thinned():
    even = column(Grading()).particles
    assert len(even) == len(column(None).particles)
    points = BoxPoints.of(np.array([4.0, 4.0]), 1.0, [set(), set()], no_period(2), None, fitted=False)
    fluid = np.zeros(25, dtype=int)
    kept, stride = thinned(Grading({"air": 2.0}), points, fluid, lambda x: np.zeros(len(x), dtype=int), [AIR], 1.0)
    assert kept.sum() == 9
    assert (stride == 2).all()


def waving(grading) -> tp.Simulation:
    """Half a wave of water with a free surface, at 0.02 m."""
    tank = tp.tank((1.0, 1.0), 0.02).fill(WATER, where=lambda x: x[:, 1] < 0.5 + 0.02 * np.cos(np.pi * x[:, 0]))
    return tp.Simulation(tp.Case(tank, [WATER], (0.0, -9.81), grading=grading, free_surface=True))


def test_a_wave_is_the_same_where_the_water_below_is_coarse():
    """Level at the wall and energies after more than a quarter of a period, with less than a third of the particles."""
    graded, even = runs = waving(Grading({"water": 0.08})), waving(None)
    assert len(graded.particles) < 0.3 * len(even.particles)
    rows = []
    for simulation in runs:
        start, volume = simulation.particles.position[simulation.mesh.surface.front, 1].max(), simulation.state.volume
        assert start == pytest.approx(0.52)  # contacts on dry walls, which are coarse, too, are where they were
        simulation.run(0.3, progress=False)
        np.testing.assert_allclose(simulation.state.volume, volume, rtol=1e-12)
        front = simulation.particles.position[simulation.mesh.surface.front]
        row = simulation.history[-1]
        above = row["potential_energy"] - 0.5 * 998.0 * 9.81 * 0.25
        rows.append((front[front[:, 0] < 1e-9, 1].max() - 0.5, row["kinetic_energy"], above))
    np.testing.assert_allclose(rows[0], rows[1], rtol=0.02, atol=2e-3)


@pytest.mark.parametrize("options", [{}, {"free_surface": True}])
def test_water_at_rest_stays_where_it_is_coarse_below(options):
    tank = tp.tank((1.0, 0.8), 0.02).fill(WATER, box=((0, 0), (1, 0.4)))
    tank = tank if options else tank.fill(AIR, box=((0, 0.4), (1, 0.8)))
    fluids = [WATER] if options else [WATER, AIR]
    grading = Grading({fluid.name: 0.08 for fluid in fluids})
    simulation = tp.Simulation(tp.Case(tank, fluids, (0.0, -9.81), grading=grading, **options))
    simulation.step()
    cells = simulation.mesh.cells
    simulation.run(0.1, progress=False)
    np.testing.assert_array_equal(simulation.mesh.cells, cells)
    assert np.abs(simulation.particles.velocity).max() < 1e-9


@pytest.mark.parametrize(("largest", "part"), [(None, 0.98), (0.04, 0.97), (0.16, 0.94)])
def test_a_drop_in_a_coarse_place_has_its_volume(largest, part):
    """Particles come where its outline will be; without them 8 % were missing at 0.04 m, and 0.08 m ended the run."""
    tank = tp.tank((1.0, 1.0), 0.02).fill(AIR).fill(WATER, box=((0, 0), (1, 0.3)))
    grading = None if largest is None else Grading({"air": largest})
    simulation = tp.Simulation(tp.Case(tank, [WATER, AIR], (0.0, -9.81), grading=grading))
    simulation.step()
    volume = simulation.state.volume[0]
    simulation.steer(tp.Drop(at=(0.5, 0.65), radius=0.1, fluid="water"))
    simulation.run(0.03, progress=False)
    assert part * np.pi * 0.01 < simulation.state.volume[0] - volume < np.pi * 0.01


def turned(x, angle):
    """Positions after a vortex that leaves the square's walls where they are."""
    s = np.sin(np.pi * x)
    c = np.cos(np.pi * x)
    return x + angle * np.stack([s[:, 0] ** 2 * s[:, 1] * c[:, 1], -(s[:, 1] ** 2) * s[:, 0] * c[:, 0]], axis=1)


def test_particles_follow_the_targets_and_no_fluid_loses_volume(monkeypatch):
    """Stirred for 80 steps: numbers change, volumes and corners stay, all edges are near their targets."""
    case = column()
    remesher = FittedRemesher(case.fluids, FittedRule(), walls_have_fluids=True, keep=True, grading=GRADING)
    state = first_state(remesher, case.particles.copy())
    particles, mesh = state.particles, state.mesh
    repairs = []

    def remembered(*arguments, **options):
        repairs.append(repair(*arguments, **options))
        return repairs[-1]

    monkeypatch.setattr(repairing, "repair", remembered)
    volume = np.bincount(mesh.fluid, weights=mesh.measure)
    reference, tracked, numbers = particles.position[0].copy(), 0, set()
    for _ in range(80):
        moved = particles.copy(position=turned(particles.position, 0.006))
        state = remesher.remesh(moved_to(state, moved))
        particles, mesh, relocated, renumbered = state.particles, state.mesh, state.relocated, repairs[-1].renumbered
        if renumbered is not None:
            assert len(renumbered) == len(moved)
            tracked = renumbered[tracked]
            kept = renumbered >= 0
            stays = kept & ~np.isin(renumbered, np.flatnonzero(relocated))
            # Those that were not set elsewhere are where they were, but for what gives volumes back.
            shift = particles.position[renumbered[stays]] - moved.position[stays]
            assert np.abs(shift).max() < 0.4 * 0.02
        numbers.add(len(particles))
        np.testing.assert_allclose(np.bincount(mesh.fluid, weights=mesh.measure), volume, rtol=1e-9)
        np.testing.assert_array_equal(particles.position[tracked], reference)
        assert state.reference == tracked
        assert state.fixed[tracked]
        assert state.fixed.sum() == 4
        assert len(np.unique(mesh.cells)) == len(particles)
        assert (mesh.measure > 0).all()
    assert len(numbers) > 10
    corner = mesh.cells[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    length = np.linalg.norm(particles.position[corner[:, 0]] - particles.position[corner[:, 1]], axis=1)
    relative = length / particles.target[corner].mean(axis=1)
    assert relative.max() < 2.5
    assert np.quantile(relative, 0.99) < 1.7
    assert np.quantile(relative, 0.01) > 0.5
    assert particles.target.min() == 0.02
    assert particles.target.max() > 0.1


@pytest.mark.parametrize("factor", [0.5, 1.0, 2.2])
def test_a_repair_creates_and_removes_by_the_targets(factor):
    """Targets that change at once: numbers go where they should, and a linear pressure stays, off the interface."""
    case = column(None)
    remesher = FittedRemesher(case.fluids, FittedRule(), walls_have_fluids=True, keep=True)
    start = first_state(remesher, case.particles.copy())
    particles, mesh = start.particles, start.mesh
    x = particles.position
    particles.pressure = 3.0 - 2.0 * x[:, 0] + x[:, 1]
    count = len(particles)
    for _ in range(6):
        particles = particles.shallow_copy(target=np.full(len(particles), 0.02 * factor))
        particles, mesh, *_ = repair(
            particles, mesh, np.array([998.0, 1.2]), hull_corners(mesh), FittedRule(), graded=True
        )
        particles.fluid[:] = 0
    if factor == 1.0:
        assert 0.95 * count < len(particles) < 1.05 * count
    else:
        assert 0.6 < len(particles) * factor**2 / count < 1.7
    x = particles.position
    inner = mesh.components.mark & ON_INTERFACE == 0
    error = np.abs(particles.pressure - (3.0 - 2.0 * x[:, 0] + x[:, 1]))[inner]
    # What was set between two particles of the interface, which keeps its area but not its nodes, has their error.
    assert (error < 1e-9).mean() > 0.99
    assert error.max() < 0.02


def test_a_chain_is_its_edge():
    """Eliminating the links of the grid's operator leaves the matrix: tested by what it does to linear functions.

    On a mesh three to five times as coarse as the grid, x^T A x of the grid's operator with any linear function is that
    of the mesh, and constants cost nothing.
    """
    rng = np.random.default_rng(3)
    x = np.stack(np.meshgrid(np.linspace(0, 1, 7), np.linspace(0, 1, 7), indexing="ij"), axis=-1).reshape(-1, 2)
    inside = (x > 0).all(axis=1) & (x < 1).all(axis=1)
    x[inside] += rng.uniform(-0.03, 0.03, (inside.sum(), 2))
    mesh = triangulate(x, ~inside, 1 / 6)
    corner = x[mesh.cells]
    edge = np.roll(corner, -1, axis=1) - np.roll(corner, -2, axis=1)
    local = np.einsum("eak,ebk->eab", edge, edge) / (4 * mesh.measure[:, None, None])
    rows, columns = np.repeat(mesh.cells, 3, axis=1), np.tile(mesh.cells, (1, 3))
    matrix = sparse.csr_matrix((local.ravel(), (rows.ravel(), columns.ravel())), shape=(len(x), len(x)))
    grid = hierarchy(x, matrix, 1 / 24)
    operator = level_matrix(grid, 0)
    shape = tuple(int(n) for n in grid.shapes[0])
    nodes = np.stack(np.unravel_index(np.arange(np.prod(shape)), shape), axis=1) / 24
    np.testing.assert_allclose(operator, operator.T, atol=1e-12)
    np.testing.assert_allclose(operator @ np.ones(len(nodes)), 0, atol=1e-12)
    for slope in ((1.0, 0.0), (0.3, -2.0)):
        of_mesh, of_grid = x @ slope, nodes @ slope
        np.testing.assert_allclose(of_grid @ operator @ of_grid, of_mesh @ matrix @ of_mesh, rtol=1e-10)
    assert np.linalg.eigvalsh(operator).min() > -1e-10


def test_a_graded_column_collapses_as_an_even_one_does():
    """After 20 steps front and energies agree, with a third of the particles and no more Krylov iterations."""
    runs = []
    for grading in (None, GRADING):
        simulation = tp.Simulation(column(grading), time_step=4e-3)
        for _ in range(20):
            simulation.step()
        runs.append(simulation)
    even, coarse = runs
    assert coarse.history[-1]["particles"] < 0.5 * even.history[-1]["particles"]
    assert abs(coarse.time - even.time) < 0.01
    water = [s.particles.position[s.particles.fluid == 0] for s in runs]
    np.testing.assert_allclose(water[1][:, 0].max(), water[0][:, 0].max(), atol=0.03)
    for name in ("kinetic_energy", "potential_energy"):
        np.testing.assert_allclose(coarse.history[-1][name], even.history[-1][name], rtol=0.05)
    np.testing.assert_allclose(coarse.history[-1]["volume_water"], even.history[-1]["volume_water"], rtol=1e-9)
    krylov = [sum(r["krylov_iterations"] for r in s.history) for s in runs]
    assert krylov[1] < 1.2 * krylov[0]


def test_moving_and_slipping_walls_stay_with_their_particles():
    """A lid that slides, a floor that slips: their particles come and go and keep their velocities."""
    tank = tp.tank((1.0, 1.0), 0.04).fill(AIR).fill(WATER, box=((0, 0), (1.0, 0.3)))
    tank.wall("top", velocity=(1.0, 0.0)).wall("bottom", slip=True)
    case = tp.Case(tank, [WATER, AIR], (0.0, -9.81), grading=Grading({"air": 0.2}))
    simulation = tp.Simulation(case, time_step=0.01)
    for _ in range(15):
        simulation.step()
    particles = simulation.particles
    x = particles.position
    lid = (x[:, 1] == 1.0) & (x[:, 0] > 0) & (x[:, 0] < 1)
    np.testing.assert_allclose(particles.velocity[lid], [[1.0, 0.0]] * lid.sum(), atol=1e-12)
    np.testing.assert_array_equal(particles.velocity[x[:, 1] == 0.0, 1], 0.0)
    assert len({row["particles"] for row in simulation.history}) > 1
    np.testing.assert_allclose(simulation.volume("water"), 0.3, rtol=1e-9)


def test_meshes_of_particles_know_no_fluids_of_their_own():
    """Targets need a mesh with fluids: what the sharp interface's is."""
    case = column()
    assert isinstance(case.particles.target, np.ndarray)
    assert Mesh(case.particles.position, np.zeros((0, 3), dtype=np.int32)).fluid is None


def test_a_function_alone_says_what_targets_are():
    """Without a fluid's name nothing but `where` limits the targets; where it says inf, the tank does."""
    limit = lambda x: np.where(x[:, 1] > 0.5, 0.08, np.inf)  # noqa: E731
    simulation = tp.Simulation(column(Grading(where=limit)), time_step=1e-3)
    target, y = simulation.particles.target, simulation.particles.position[:, 1]
    assert target[y > 0.9].max() == pytest.approx(0.08)
    assert len(target) < 0.25 * 2601
    simulation.step()
    assert np.isfinite(simulation.particles.target).all()


@pytest.mark.parametrize("far", [0.03, 0.05, 0.12])
def test_a_tank_starts_near_its_targets(far):
    """Far from the interface, lines stand at 0.66 to 1.06 targets."""
    particles = column(Grading({"air": far}, growth=0.5)).particles
    distance, _ = cKDTree(particles.position).query(particles.position, k=2)
    off = (particles.position > 0.75).all(axis=1) & (particles.position < 0.95).all(axis=1)
    assert 0.66 < np.median(distance[off, 1]) / far < 1.07


def test_a_function_that_raises_gives_one_error():
    tank = tp.tank((1.0, 1.0), 0.1).fill(WATER)
    with pytest.raises(ValueError, match=r"^Grading: where raised IndexError for positions of shape \(\d+, 2\)"):
        tp.Case(tank, [WATER], (0, -9.81), grading=Grading(where=lambda x: x[:, 2]))
