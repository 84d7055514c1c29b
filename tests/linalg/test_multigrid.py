"""Multigrid on the background grid, and the preconditioner made with it."""

from __future__ import annotations

import math

import numpy as np
import numpy_twin as twin
import pytest
from flow_problems import flow_problem
from grid_levels import hierarchy, level_matrix, v_cycle
from residuals import residual_vector
from scipy import sparse

import tipfem as tp
from tipfem.backend import launch
from tipfem.backend.arrays import download
from tipfem.fem.schur import SCHUR_SCALE
from tipfem.fem.time_integration import GeneralizedAlpha
from tipfem.linalg import fgmres
from tipfem.linalg.multigrid import multigrid
from tipfem.linalg.multigrid.grid_hierarchy import DIAGONAL
from tipfem.linalg.multigrid.mesh_transfer import OMEGA
from tipfem.mesh.delaunay import triangulate
from tipfem.physics.term import ElementProperties
from tipfem.step.linear_system import GRID_SPACING, Workspace, grid_spacing

WATER = tp.Fluid("water", density=998.0, viscosity=1e-3)
AIR = tp.Fluid("air", density=1.2, viscosity=1.8e-5)


def two_fluids(size, spacing):
    """Particles, mesh, element densities: a column of water 998 in air 1.2, nodes shaken by 0.2 spacings."""
    upper = np.array(size) * 0.5
    filled = tp.tank(size, spacing, jitter=0.2, seed=1).fill(AIR).fill(WATER, box=(np.zeros(len(size)), upper))
    particles = filled.sample([WATER, AIR])
    mesh = triangulate(particles.position, particles.wall, spacing)
    density = np.array([998.0, 1.2])[particles.fluid][mesh.cells].mean(axis=1)
    return particles, mesh, density


def along_axis(matrix, shape, axis):
    """Interpolation to a grid's nodes from every second one along an axis, weighted as the operator couples them."""
    index = np.indices(shape).reshape(len(shape), -1)
    coarse = list(shape)
    coarse[axis] = shape[axis] // 2 + 1
    entries = matrix.tocoo()
    shift = index[axis][entries.col] - index[axis][entries.row]
    lower, upper = (
        np.maximum(np.bincount(entries.row[side], -entries.data[side], index.shape[1]), 0)
        for side in (shift < 0, shift > 0)
    )
    both = lower + upper
    part = np.divide(lower, both, out=np.full(len(both), 0.5), where=both > 0)
    part[index[axis] % 2 == 0] = 1.0
    rows, columns = [], []
    for beyond in (0, 1):
        parent = index.copy()
        parent[axis] = np.minimum(index[axis] // 2 + beyond, coarse[axis] - 1)
        rows.append(np.arange(index.shape[1]))
        columns.append(np.ravel_multi_index(tuple(parent), coarse))
    values = np.concatenate([part, 1 - part])
    shape = (index.shape[1], int(np.prod(coarse)))
    return sparse.csr_matrix((values, (np.concatenate(rows), np.concatenate(columns))), shape=shape), coarse


CLOUDS = pytest.mark.parametrize(
    ("size", "spacing", "grid_spacing"),
    [((1.0, 0.7), 0.05, 0.1), ((1.3, 0.9), 0.06, 0.09), ((0.3, 2.0), 0.05, 0.1), ((1.0, 0.9, 0.8), 0.2, 0.4)],
    ids=["even", "coarser by 1.5", "narrow", "3-D"],
)


@CLOUDS
def test_coarse_operators_are_galerkin_products(size, spacing, grid_spacing):
    """P^T A P from the mesh to the finest grid with hat functions, from grid to grid with the operator's weights."""
    particles, mesh, density = two_fluids(size, spacing)
    matrix = twin.laplacian(mesh.position, mesh.cells, 1 / density)
    grid = hierarchy(particles.position, matrix, grid_spacing)
    points = (particles.position - particles.position.min(axis=0)) / grid.spacing
    p = sparse.csr_matrix(twin.hats(points, tuple(int(n) for n in grid.shapes[0])))
    np.testing.assert_allclose(p.sum(axis=1), 1.0, rtol=1e-12)
    expected = p.T @ sparse.csr_matrix(matrix) @ p
    for level in range(len(grid.shapes)):
        if level:
            shape = [int(n) for n in grid.shapes[level - 1]]
            for axis in reversed(range(len(size))):
                p, shape = along_axis(expected, shape, axis)
                expected = p.T @ expected @ p
            assert shape == grid.shapes[level].tolist()
        got = level_matrix(grid, level)
        largest_entry = abs(expected).max()
        assert abs(got - expected).max() < 1e-12 * largest_entry
        assert abs(got.sum(axis=1)).max() < 1e-12 * largest_entry
    assert grid.shapes[-1].max() <= 5
    if max(size) / grid_spacing > 5:
        assert len(grid.shapes) > 1


def test_cells_have_sides_of_their_own_where_there_are_few_particles(monkeypatch):
    """The Galerkin product on a grid that is coarser along its longest axis."""
    monkeypatch.setattr(multigrid, "FEW_NODES", 150)
    monkeypatch.setattr(multigrid, "NODES_PER_PARTICLE", 0)
    particles, mesh, density = two_fluids((2.0, 0.3), 0.05)
    matrix = twin.laplacian(mesh.position, mesh.cells, 1 / density)
    grid = hierarchy(particles.position, matrix, 0.1, particles=len(particles.position))
    assert grid.spacing.tolist() == [0.2, 0.1]
    points = (particles.position - particles.position.min(axis=0)) / grid.spacing
    p = sparse.csr_matrix(twin.hats(points, tuple(int(n) for n in grid.shapes[0])))
    expected = p.T @ sparse.csr_matrix(matrix) @ p
    assert abs(level_matrix(grid, 0) - expected).max() < 1e-12 * abs(expected).max()


@pytest.mark.parametrize(
    ("size", "particles", "sides"),
    [
        ((1.0, 1.0), 40_000, (0.01, 0.01)),
        ((100.0, 0.01), 60_000, (0.01, 0.01)),  # a thin tank that is full of particles
        ((14.0, 14.0), 441, (0.16, 0.08)),  # a thin one across the box: 2 million nodes of 0.01
        ((1000.0, 0.01), 441, (0.32, 0.01)),
        ((14.0, 14.0, 14.0), 441, (7 / 11,) * 3),  # cells end with the box
    ],
)
def test_few_particles_do_not_take_a_large_grid(size, particles, sides):
    found, cells = multigrid.grid_cells(np.array(size), 0.01, particles)
    np.testing.assert_allclose(found, sides)
    assert np.prod(cells + 5.0) <= max(16 * particles, 20_000)
    assert (cells * found >= np.array(size) - 1e-9).all()
    assert multigrid.grid_cells(np.array(size), 0.01, None)[0].tolist() == [0.01] * len(size)


def test_edges_beyond_the_stencil_keep_rows_at_zero_and_symmetry():
    """A grid finer than the mesh: long edges are left out, and rows still sum to zero on every level."""
    particles, mesh, density = two_fluids((1.0, 0.7), 0.1)
    matrix = twin.laplacian(mesh.position, mesh.cells, 1 / density)
    grid = hierarchy(particles.position, matrix, 0.08)
    p = twin.hats((particles.position - particles.position.min(axis=0)) / 0.08, grid.shapes[0])
    whole = p.T @ matrix @ p
    assert abs(level_matrix(grid, 0) - whole).max() > 1e-3 * abs(whole).max()  # some are left out
    for level in range(len(grid.shapes)):
        got = level_matrix(grid, level)
        assert abs(got).max() > 0.1 * abs(whole).max()
        assert abs(got.sum(axis=1)).max() < 1e-12 * abs(got).max()
        assert abs(got - got.T).max() < 1e-12 * abs(got).max()
        assert np.linalg.eigvalsh(got).min() > -1e-12 * abs(got).max()


def cg_iterations(matrix, b, apply, limit=60):
    """Iterations of preconditioned conjugate gradients to a residual of 1e-8."""
    x, r = np.zeros_like(b), b.copy()
    z = apply(r)
    p, rz = z, r @ z
    for k in range(1, limit + 1):
        q = matrix @ p
        step = rz / (p @ q)
        x, r = x + step * p, r - step * q
        if np.linalg.norm(r) <= 1e-8 * np.linalg.norm(b):
            assert np.linalg.norm(matrix @ x - b) < 2e-8 * np.linalg.norm(b)
            return k
        z = apply(r)
        p, rz = z + r @ z / rz * p, r @ z
    return math.inf


@pytest.mark.parametrize(
    ("steps", "most"),
    [((60, 120), 14), ((58, 118), 20)],
    ids=["interface on grid lines", "interface between grid lines"],
)
def test_a_cycle_in_conjugate_gradients_takes_few_iterations_on_any_mesh(steps, most):
    """Pressure Laplacian of water and air, 998 : 1.2, to 1e-8: hardly more iterations on finer meshes.

    A jump of the density that no coarse grid line follows costs iterations, whatever the mesh.
    """
    counts = []
    for n in steps:
        particles, mesh, density = two_fluids((1.0, 1.0), 1 / n)
        matrix = twin.laplacian(mesh.position, mesh.cells, 1 / density)
        grid = hierarchy(particles.position, matrix, 1.5 / n)
        b = np.random.default_rng(0).standard_normal(len(particles))
        counts.append(cg_iterations(matrix, b - b.mean(), lambda r, grid=grid: v_cycle(grid, r)))
    assert len(particles) > 13_500
    assert max(counts) <= most
    assert counts[1] <= counts[0] + 3


def test_a_cycle_is_linear_and_repeatable():
    particles, mesh, density = two_fluids((1.0, 0.7), 0.05)
    matrix = twin.laplacian(mesh.position, mesh.cells, 1 / density)
    grid = hierarchy(particles.position, matrix, 0.1)
    apply = lambda r: v_cycle(grid, r)  # noqa: E731
    a, b = np.random.default_rng(1).standard_normal((2, len(particles)))
    combined = apply(2 * a - 3 * b)
    np.testing.assert_allclose(combined, 2 * apply(a) - 3 * apply(b), atol=1e-11 * abs(combined).max())
    np.testing.assert_array_equal(apply(a), apply(a))


@pytest.mark.parametrize("size", [(1.0, 0.8), (1.0, 1.0, 0.75)], ids=["2-D", "3-D"])
def test_the_pressure_laplacian_is_the_stiffness_matrix(size):
    particles, mesh, density = two_fluids(size, 0.1 if len(size) == 2 else 0.25)
    scheme = GeneralizedAlpha(0.5, 2e-3)
    nothing = np.zeros(len(mesh.cells))
    problem = flow_problem(
        mesh,
        particles,
        ElementProperties(density, nothing, nothing),
        scheme,
        np.zeros_like(mesh.position),
        0.25,
        Workspace(),
    )
    offsets = download(problem.buffers.get("row_offsets", 0, integer=True), len(particles) + 1)
    columns = download(problem.buffers.get("columns", 0, integer=True), offsets[-1])
    values = download(problem.buffers.get("laplacian", 0), offsets[-1])
    got = sparse.csr_matrix((values, columns, offsets))
    cm = SCHUR_SCALE * (1 - scheme.alpha_m) / (scheme.beta * scheme.dt**2)
    expected = twin.laplacian(mesh.position, mesh.cells, 1 / (density * cm))
    assert abs(got - expected).max() < 1e-12 * abs(expected).max()
    assert abs(np.asarray(got.sum(axis=1))).max() < 1e-12 * abs(expected).max()


@pytest.mark.parametrize("size", [(1.0, 0.8), (1.0, 1.0, 0.75)], ids=["2-D", "3-D"])
def test_one_thread_and_all_set_up_the_same_system(size, monkeypatch):
    """Bit by bit; the grid is finer than the mesh in places, so that there are links."""
    particles, mesh, density = two_fluids(size, 0.05 if len(size) == 2 else 0.2)
    nothing = np.zeros(len(mesh.cells))
    found = []
    for single in (True, False):
        monkeypatch.setattr(launch, "is_serial", lambda count, cost, single=single: single)
        monkeypatch.setattr(launch, "few_threads", lambda single=single: single)
        problem = flow_problem(
            mesh,
            particles,
            ElementProperties(density, nothing + 1e-3, nothing),
            GeneralizedAlpha(0.5, 2e-3),
            np.zeros_like(mesh.position),
            0.25,
            Workspace(spacing=0.8),
        )
        laplacian, grid = problem.system.laplacian(), problem.system.multigrid
        links = download(grid.buffers.get("multigrid.links", 0, integer=True), problem.nodes + 1)[-1]
        assert links > 0
        found.append(
            [
                *(download(a, len(mesh.cells) * len(mesh.cells[0])) for a in (problem.equations.topology.corners,)),
                laplacian.indptr,
                laplacian.indices,
                laplacian.data,
                download(problem.equations.scale, problem.size),
                download(grid.coordinates, problem.nodes + links),
                download(grid.cell_lists, grid._cells + 1 + problem.nodes + links),
                download(grid.levels, grid.levels.shape[0]),
            ]
        )
    for one, all_of_them in zip(*found, strict=True):
        np.testing.assert_array_equal(one, all_of_them)


@pytest.mark.parametrize("size", [(1.0, 0.8), (1.0, 1.0, 0.75)], ids=["2-D", "3-D"])
def test_the_preconditioner_is_made_of_the_blocks_of_the_derivative(size):
    """z_p = S (r_p - D r_u) with S one cycle and a diagonal, z_u = r_u + G z_p, rows scaled by diag(A)^-1; D and -G
    from K's product.

    At rest without forces, where the parts of D that the preconditioner leaves out vanish.
    """
    particles, mesh, density = two_fluids(size, 0.1 if len(size) == 2 else 0.25)
    nothing, still = np.zeros(len(mesh.cells)), np.zeros_like(mesh.position)
    problem = flow_problem(
        mesh,
        particles,
        ElementProperties(density, nothing + 1e-3, nothing),
        GeneralizedAlpha(0.5, 1e-3),
        still,
        0.25,
        Workspace(),
        exact=False,
    )
    n, width = len(particles), len(size) + 1
    problem.residual(problem.vector(still, np.zeros(n)))
    problem.linearise()
    r = np.random.default_rng(3).uniform(-1, 1, (n, width))
    r[particles.wall, :-1] = 0.0
    out = problem.buffers.get("test.out", problem.size)

    def product(values):
        problem.product(problem.buffers.upload("test.in", values.ravel()), out)
        return download(out, problem.size).reshape(n, width)

    problem.precondition(problem.buffers.upload("test.r", r.ravel()), out)
    z = download(out, problem.size).reshape(n, width)
    only_u, only_p = r.copy(), z.copy()
    only_u[:, -1] = 0.0
    only_p[:, :-1] = 0.0
    coupling = product(only_p)[:, :-1]
    assert abs(coupling).max() > 1e-3 * abs(r).max()
    np.testing.assert_allclose(z[:, :-1], r[:, :-1] - coupling, atol=1e-12 * abs(z[:, :-1]).max())
    volume = np.bincount(mesh.cells.ravel(), np.repeat(mesh.measure / width, width), n)
    schur = (r - product(only_u))[:, -1] * volume / particles.spacing
    rough = download(problem.system._viscous, n) * schur
    assert abs(rough).max() > 1e-3 * abs(z[:, -1]).max()
    pressure = v_cycle(problem.system.multigrid, schur) + rough
    np.testing.assert_allclose(z[:, -1], pressure, atol=1e-11 * abs(z[:, -1]).max())


@pytest.mark.parametrize(
    "size",
    [pytest.param((1.0, 0.8), id="2-D"), pytest.param((1.0, 1.0, 0.75), marks=pytest.mark.slow, id="3-D")],
)
def test_all_threads_one_thread_and_staged_kernels_solve_alike(size, monkeypatch):
    """With a bubble, and more iterations than the basis first has room for. Bits do not depend on the number of
    threads; staged kernels are compiled in other surroundings, so that their sums may be rounded otherwise."""
    water, air = tp.Fluid("water", density=998.0, viscosity=1e-3), tp.Fluid("air", density=1.2, viscosity=1.8e-5)
    spacing, ball = (0.04, 0.15) if len(size) == 2 else (0.125, 0.1)
    tank = tp.tank(size, spacing, jitter=0.1, seed=2).fill(water)
    tank = tank.fill(air, box=((0.0,) * (len(size) - 1) + (0.8 * size[-1],), size))
    tank = tank.fill(air, disc=((0.5, 0.35, 0.2)[: len(size)], ball))
    particles = tank.sample([water, air])
    mesh = triangulate(particles.position, particles.wall, spacing)
    fluid = particles.fluid[mesh.cells].max(axis=1) == 1
    density, nothing = np.where(fluid, 1.2, 998.0), np.zeros(len(mesh.cells))
    body_force = np.tile([0.0, -9.81, 0.0][: len(size)], (len(particles), 1))
    found = []
    for single, fused in ((False, True), (True, True), (False, False)):
        monkeypatch.setattr(launch, "is_serial", lambda count, cost, single=single: single)
        problem = flow_problem(
            mesh,
            particles,
            ElementProperties(density, nothing + 1e-3, nothing),
            GeneralizedAlpha(0.0, 1e-3),
            body_force,
            0.25,
            Workspace(),
        )
        problem.system.multigrid.fused = fused
        assert (problem.system.iterations is not None) is fused
        x = problem.predict()
        problem.residual(x)
        problem.linearise()
        out = problem.buffers.get("test.z", problem.size)
        problem.precondition(problem._r, out)
        preconditioned = download(out, problem.size)
        result = problem.correct(x, 1e-13)
        assert result.iterations > fgmres.ROOM
        assert problem.system.deflation.count == 1
        found.append([preconditioned, download(x, problem.size), np.array([result.iterations])])
    for all_threads, one, staged in zip(*found, strict=True):
        np.testing.assert_array_equal(all_threads, one)
        np.testing.assert_allclose(all_threads, staged, atol=1e-11 * abs(staged).max())


@pytest.mark.parametrize(("size", "most"), [((1.0, 0.8), 20), ((1.0, 1.0, 0.75), 45)], ids=["2-D", "3-D"])
def test_a_correction_solves_the_linearised_step(size, most):
    """K dx = -r to the tolerance asked for; flat tetrahedra cost iterations in 3-D."""
    particles, mesh, density = two_fluids(size, 0.1 if len(size) == 2 else 0.25)
    nothing = np.zeros(len(mesh.cells))
    body_force = np.tile([0.0, -9.81, 0.0][: len(size)], (len(particles), 1))
    problem = flow_problem(
        mesh,
        particles,
        ElementProperties(density, nothing + 1e-3, nothing),
        GeneralizedAlpha(0.0, 1e-3),
        body_force,
        0.25,
        Workspace(),
    )
    x = problem.predict()
    before = problem.residual(x)
    r = residual_vector(problem).ravel()
    old = download(x, problem.size)
    result = problem.correct(x, 1e-8)
    assert result.converged
    assert result.iterations <= most
    out = problem.buffers.get("test.product", problem.size)
    problem.product(problem.buffers.upload("test.dx", download(x, problem.size) - old), out)
    assert np.linalg.norm(download(out, problem.size) + r) <= 1.01e-8 * np.linalg.norm(r)
    assert problem.residual(x) < 1e-3 * before


def jittered_lattice():
    """Positions and cells of a lattice in 3-D whose points are displaced a little: most cells are slivers."""
    particles = tp.tank((1, 1, 1), 0.2, jitter=0.05, seed=3).fill(WATER).sample([WATER])
    mesh = triangulate(particles.position, particles.wall, 0.2)
    return mesh.position, mesh.cells


def slivers_in_2d():
    """Positions and cells of a strip of squares cut into flat triangles."""
    x = np.linspace(0, 1, 21)
    position = np.concatenate([np.stack([x, np.full_like(x, y)], axis=1) for y in (0.0, 0.002, 0.004)])
    position[21:42, 0] += 0.02
    cells = [
        cell for row in (0, 21) for i in range(row, row + 20) for cell in ([i, i + 1, i + 22], [i, i + 22, i + 21])
    ]
    return position, np.array(cells, dtype=np.int32)


@pytest.mark.parametrize(("mesh", "undamped"), [(jittered_lattice, 2.5), (slivers_in_2d, 2.0)])
def test_the_smoother_converges_on_slivers(mesh, undamped):
    """No eigenvalue of D^-1 L is above 2, so Jacobi's method with 0.8 cannot diverge; with diag(L) one may be above."""
    position, cells = mesh()
    matrix = sparse.csr_matrix(twin.laplacian(position, cells, np.ones(len(cells))))
    grid = hierarchy(position, matrix, 0.4)
    inverse = grid.vectors.to_numpy()[DIAGONAL * len(position) : (DIAGONAL + 1) * len(position)] / OMEGA
    largest, plain = (
        np.linalg.eigvalsh(np.sqrt(d)[:, None] * matrix.toarray() * np.sqrt(d)).max()
        for d in (inverse, 1 / matrix.diagonal())
    )
    assert largest <= 2 + 1e-9
    assert plain > undamped
    assert OMEGA * largest < 2


@pytest.mark.parametrize(("dimension", "undamped"), [(2, 3.0), (3, 5.0)])
def test_smoothing_converges_on_grids_where_few_particles_are_in_a_cell(dimension, undamped):
    """Single cells far from each other, as of spray: no eigenvalue of D^-1 A of a grid is above 2, of a cycle above 1.

    With diag(A) one is nearly the number of a grid cell's corners, and a cycle would raise some errors fiftyfold.
    """
    rng = np.random.default_rng(2)
    drop = np.concatenate([np.zeros((1, dimension)), np.eye(dimension)]) * 0.1
    places = np.stack(np.meshgrid(*[np.arange(5) * 0.9] * dimension, indexing="ij"), axis=-1).reshape(-1, dimension)
    position = (places[:, None] + 0.3 * rng.random((len(places), 1, dimension)) + drop).reshape(-1, dimension)
    cells = np.arange(len(position), dtype=np.int32).reshape(-1, dimension + 1)
    fixed = np.arange(len(position)) % (dimension + 1) == 0  # the pressure at a surface
    matrix = twin.laplacian(position, cells, np.ones(len(cells)))
    free = sparse.diags((~fixed).astype(float))
    matrix = sparse.csr_matrix(free @ matrix @ free)
    matrix.eliminate_zeros()
    grid = hierarchy(position, matrix, 0.4)
    of_grid = level_matrix(grid, 0)
    there = np.flatnonzero(np.diag(of_grid) > 1e-12)
    of_grid = of_grid[np.ix_(there, there)]
    largest, plain = (
        np.linalg.eigvalsh(of_grid / np.sqrt(np.outer(d, d))).max()
        for d in (np.maximum(np.diag(of_grid), 0.5 * abs(of_grid).sum(axis=1)), np.diag(of_grid))
    )
    assert OMEGA * largest < 2 < OMEGA * plain
    assert plain > undamped
    error = np.where(fixed, 0.0, rng.standard_normal(len(position)))
    start = np.sqrt(error @ (matrix @ error))
    for _ in range(10):
        error -= v_cycle(grid, matrix @ error)
        assert np.sqrt(error @ (matrix @ error)) < start
    assert np.sqrt(error @ (matrix @ error)) < 1e-2 * start


def test_graded_meshes_have_a_grid_of_about_as_many_cells_as_uniform_ones():
    def case(**options):
        tank = tp.tank((1.0, 1.0), 0.01).fill(AIR).fill(WATER, box=((0, 0), (0.2, 0.4)))
        return tp.Case(tank, [WATER, AIR], gravity=(0, -9.81), **options)

    assert grid_spacing(case()) == GRID_SPACING == 2.0
    cube = tp.tank((0.4, 0.4, 0.4), 0.1, jitter=0.2).fill(WATER)
    assert grid_spacing(tp.Case(cube, [WATER], gravity=(0, 0, -9.81))) == 3.0
    both = tp.tank((0.4, 0.4, 0.4), 0.1, jitter=0.2).fill(AIR).fill(WATER, box=((0, 0, 0), (0.4, 0.4, 0.2)))
    assert grid_spacing(tp.Case(both, [WATER, AIR], gravity=(0, 0, -9.81))) == 2.0
    graded = case(grading=tp.Grading({"air": 0.04}))
    side = grid_spacing(graded)
    cells = 1.0 / (side * 0.01) ** 2
    assert 2 < side < 4
    assert 2 < len(graded.particles) / cells < 3.5
    assert grid_spacing(case(grading=tp.Grading({"air": 0.2}, growth=0.5))) <= 4.0
    assert grid_spacing(case(grading=tp.Grading({"air": 0.01}))) == 2.0


@pytest.mark.parametrize(("size", "cells"), [(0.4, 18), (0.8, 37), (0.41, 19), (0.396, 18), (0.004, 1)])
def test_cells_in_three_dimensions_end_with_the_box(size, cells):
    """A remainder of less than a quarter of a cell makes all a little longer."""
    sides, found = multigrid.grid_cells(np.array([1.6, size, size]), 0.022, None)
    assert found.tolist() == [73, cells, cells]
    np.testing.assert_allclose(sides * found, [1.6, size, size], rtol=1e-14)
