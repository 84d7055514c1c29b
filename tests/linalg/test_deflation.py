"""Bubbles: which particles are in them, and what they cost the pressure's solver."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from flow_problems import flow_problem
from grid_levels import set_vector, upload_csr
from mesh_twins import adjacency
from scipy import sparse
from scipy.sparse.csgraph import connected_components
from triangulations import component_labels

import tipfem as tp
from tipfem.backend.arrays import Buffers, download
from tipfem.fem.time_integration import GeneralizedAlpha
from tipfem.geometry.place import places
from tipfem.linalg.multigrid.deflation import SubdomainDeflation
from tipfem.linalg.multigrid.grid_hierarchy import RHS, SOLUTION, VECTORS
from tipfem.mesh.delaunay import triangulate
from tipfem.physics.term import ElementProperties
from tipfem.remesh.triangles.fitted import with_fluids
from tipfem.step.linear_system import Workspace

WATER = tp.Fluid("water", density=998.0, viscosity=1e-3)
AIR = tp.Fluid("air", density=1.2, viscosity=1.8e-5)
DENSITY = np.array([998.0, 1.2])


def bubbly(spacing: float, discs):
    """A square tank of water with bubbles of air under an air layer: particles, and a mesh that knows its fluids."""
    tank = tp.tank((1.0, 1.0), spacing, jitter=0.1, seed=2).fill(WATER).fill(AIR, box=((0, 0.85), (1, 1)))
    for centre, radius in discs:
        tank = tank.fill(AIR, disc=(centre, radius))
    particles = tank.sample([WATER, AIR])
    mesh = triangulate(particles.position, particles.wall, spacing)
    return particles, with_fluids(mesh, particles, DENSITY.argsort().argsort())


def grid_of_discs(count: int, radius: float):
    """``count`` discs in rows of six."""
    return [((0.12 + 0.15 * (k % 6), 0.1 + 0.15 * (k // 6)), radius) for k in range(count)]


def light_components(mesh, count):
    """Sets of particles connected by triangles of air."""
    cells = mesh.cells[mesh.fluid == 1]
    i, j = np.concatenate([cells[:, [0, 1]], cells[:, [1, 2]]]).T
    graph = sparse.coo_matrix((np.ones(len(i)), (i, j)), shape=(count, count))
    label = connected_components(graph, directed=False)[1]
    used = np.unique(cells)
    return [frozenset(used[label[used] == k].tolist()) for k in np.unique(label[used])]


@pytest.mark.parametrize("fluids", ["both", "water alone", "glycerin and water"])
def test_bubbles_are_the_smaller_components_of_the_light_fluid(fluids):
    particles, mesh = bubbly(0.02, grid_of_discs(9, 0.04))
    buffers, n = Buffers(), len(particles)
    density = {"both": DENSITY, "water alone": DENSITY[[0, 0]], "glycerin and water": np.array([1261.0, 998.0])}[fluids]
    density = density[mesh.fluid]
    offsets, columns = adjacency(mesh)
    found = SubdomainDeflation(
        mesh.cells,
        density,
        (density.min(), density.max()),
        (len(mesh.cells), n, 3),
        upload_csr(buffers, sparse.csr_matrix((np.ones(len(columns)), columns, offsets), shape=(n, n))),
        buffers.get("vectors", VECTORS * n),
        buffers,
        position=particles.position,
    )
    if fluids != "both":
        assert found.count == 0
        return
    expected = sorted(light_components(mesh, n), key=len)[:-1]
    starts = download(found.subdomains, found.count + 1)
    lists = download(found.subdomains, starts[-1])
    got = [frozenset(lists[first:last].tolist()) for first, last in pairwise(starts)]
    assert len(got) == 9
    assert set(got) == set(expected)
    first = [places(particles.position)[list(bubble)].min() for bubble in got]
    assert first == sorted(first)


def test_after_deflation_the_equations_of_each_bubble_hold_in_the_sum():
    particles, mesh = bubbly(0.02, grid_of_discs(6, 0.04))
    n, rng, buffers = len(particles), np.random.default_rng(5), Buffers()
    offsets, columns = adjacency(mesh)
    matrix = sparse.csr_matrix((rng.uniform(-1, 0, len(columns)), columns, offsets), shape=(n, n))
    matrix = (matrix + matrix.T + 14 * sparse.identity(n)).tocsr()
    matrix.sort_indices()
    density = DENSITY[mesh.fluid]
    vectors = buffers.get("vectors", VECTORS * n)
    found = SubdomainDeflation(
        mesh.cells,
        density,
        (1.2, 998.0),
        (len(mesh.cells), n, 3),
        upload_csr(buffers, matrix),
        vectors,
        buffers,
        position=particles.position,
    )
    b, x = rng.standard_normal((2, n))
    set_vector(vectors, RHS, b)
    set_vector(vectors, SOLUTION, x)
    found.correct()
    y = vectors.to_numpy()[SOLUTION * n : (SOLUTION + 1) * n]
    bubbles = sorted(light_components(mesh, n), key=min)
    largest = max(bubbles, key=len)
    outside = np.ones(n, dtype=bool)
    for bubble in (part for part in bubbles if part is not largest):
        inside = np.array(sorted(bubble))
        outside[inside] = False
        assert np.ptp(y[inside] - x[inside]) < 1e-12  # a constant
        assert abs(y[inside] - x[inside]).max() > 1e-6
        assert abs((b - matrix @ y)[inside].sum()) < 1e-9 * abs(b[inside]).sum()  # they do not touch each other
    np.testing.assert_array_equal(y[outside], x[outside])


@pytest.mark.parametrize("spacing", [1 / 60, 1 / 120])
def test_light_bubbles_cost_few_iterations(spacing):
    """26 bubbles of air three particles wide in water, first Newton system to 1e-6."""
    particles, mesh = bubbly(spacing, grid_of_discs(26, 1.6 * spacing))
    assert len(np.unique(component_labels(mesh.neighbours, mesh.fluid))) == 28
    nothing = np.zeros(len(mesh.cells))
    force = np.tile([0.0, -9.81], (len(particles), 1))
    problem = flow_problem(
        mesh,
        particles,
        ElementProperties(DENSITY[mesh.fluid], nothing + 1e-3, nothing),
        GeneralizedAlpha(0.0, 1e-3),
        force,
        0.25,
        Workspace(),
    )
    x = problem.predict()
    problem.residual(x)
    result = problem.correct(x, 1e-6)
    assert result.converged
    assert result.iterations <= 20
    assert problem.system.deflation.count == 26
