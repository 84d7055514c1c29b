"""Multigrid on grids that are periodic along one axis or both."""

from __future__ import annotations

import numpy as np
import numpy_twin as twin
import pytest
from grid_levels import upload_csr, v_cycle
from scipy import sparse

from tipfem.backend.arrays import Buffers, download
from tipfem.geometry.period import Period
from tipfem.linalg.multigrid.grid_hierarchy import LAST_PERIOD, PERIOD, SIZE, STENCIL, STENCIL_WIDTH, STRIDE
from tipfem.linalg.multigrid.multigrid import BackgroundMultigrid, periodic_cells
from tipfem.mesh.delaunay import triangulate

BOTH, FIRST = [0, 1], [0]


def torus(size, spacing, axes, ratio=1.0):
    """Positions and pressure Laplacian of a jittered lattice; a disc is lighter by ``ratio``."""
    size = np.array(size)
    lines = [np.linspace(0, length, round(length / spacing) + 1) for length in size]
    for k in axes:
        lines[k] = lines[k][:-1]
    position = np.stack([x.ravel() for x in np.meshgrid(*lines, indexing="ij")], axis=1)
    period = Period(np.where(np.isin([0, 1], axes), size, 0.0))
    ends = [np.isin(position[:, k], [0.0, size[k]]) for k in (0, 1) if k not in axes]
    wall = np.any(ends, axis=0) if ends else np.zeros(len(position), dtype=bool)
    position += np.where(wall[:, None], 0.0, np.random.default_rng(2).uniform(-0.2, 0.2, position.shape) * spacing)
    position = period.wrapped(position)
    mesh = triangulate(position, wall, spacing, period=period)
    whole, node = mesh.unrolled
    middle = whole.position[whole.cells].mean(axis=1)
    inside = ((middle - [0.1 * size[0], 0.5 * size[1]]) ** 2).sum(axis=1) < (0.2 * size.min()) ** 2
    share = sparse.csr_matrix((np.ones(len(node)), (np.arange(len(node)), node)))
    local = sparse.csr_matrix(twin.laplacian(whole.position, whole.cells, np.where(inside, ratio, 1.0)))
    return position, (share.T @ local @ share).tocsr()


def hierarchy(position, matrix, size, axes, spacing):
    buffers = Buffers()
    grid = BackgroundMultigrid(np.zeros(2), np.array(size), spacing, buffers, periodic=axes)
    grid.build(buffers.upload("position", position), upload_csr(buffers, matrix), len(position))
    return grid


def stencils(grid, level):
    """(n, m, 5, 5) entries of the operator of a level that is periodic along both axes."""
    n, m = (int(k) for k in grid.shapes[level])
    size, start, stride = (int(grid.layout[level, k]) for k in (SIZE, STENCIL, STRIDE + 1))
    values = download(grid.levels, start + STENCIL_WIDTH**2 * size)[start:].reshape(-1, 5, 5, stride)
    return values[2 : 2 + n, ..., 2 : 2 + m].transpose(0, 3, 1, 2)


def matrix_of(entries):
    n, m = entries.shape[:2]
    result = np.zeros((n * m, n * m))
    i, j, a, b = np.indices(entries.shape)
    np.add.at(result, ((i * m + j).ravel(), ((i + a - 2) % n * m + (j + b - 2) % m).ravel()), entries.ravel())
    return result


def interpolation(entries, axis):
    """From every second node along a periodic axis, weighted as the operator's stencils couple the node."""
    shape = entries.shape[:2]
    lower, upper = (
        np.maximum(-np.delete(entries, keep, axis=2 + axis).sum(axis=(2, 3)), 0) for keep in ([2, 3, 4], [0, 1, 2])
    )
    part = np.where(lower + upper > 0, lower / np.maximum(lower + upper, 1e-300), 0.5)
    coarse = list(shape)
    coarse[axis] //= 2
    index = np.indices(shape)
    rows = np.arange(index[0].size)
    result = np.zeros((len(rows), int(np.prod(coarse))))
    odd = index[axis] % 2 == 1
    for beyond, w in ((0, np.where(odd, part, 1.0)), (1, np.where(odd, 1 - part, 0.0))):
        parent = index.copy()
        parent[axis] = (index[axis] // 2 + beyond) % coarse[axis]
        np.add.at(result, (rows, np.ravel_multi_index(tuple(k.ravel() for k in parent), coarse)), w.ravel())
    return result, coarse


def test_coarse_operators_are_galerkin_products_on_the_torus():
    size, h = (1.2, 0.8), 0.05
    position, matrix = torus(size, h, BOTH, ratio=100.0)
    grid = hierarchy(position, matrix, size, BOTH, 0.1)
    assert grid.shapes.tolist() == [[12, 8], [6, 4], [3, 2]]
    assert (grid.layout[:3, PERIOD] == [12, 6, 3]).all()
    assert (grid.layout[:3, LAST_PERIOD] == [8, 4, 2]).all()
    hats = sparse.csr_matrix(twin.hats(position / grid.spacing, (13, 9))).toarray().reshape(-1, 13, 9)
    hats[:, 0] += hats[:, 12]
    hats[:, :, 0] += hats[:, :, 8]
    p = hats[:, :12, :8].reshape(len(position), -1)
    expected = p.T @ (matrix @ p)
    entries = stencils(grid, 0)
    assert abs(matrix_of(entries) - expected).max() < 1e-12 * abs(expected).max()
    # The last axis is coarsened first. On 8 nodes two offsets of a stencil never mean the same node.
    first, shape = interpolation(entries, 1)
    between = first.T @ expected @ first
    spread = np.zeros((*shape, 5, 5))
    i, j, a, b = np.indices(spread.shape)
    number = np.arange(between.shape[0]).reshape(shape)
    near = between[number[i, j], number[(i + a - 2) % 12, (j + b - 2) % 4]]
    spread[...] = np.where((b == 0) | (b == 4), near / 2, near)  # both mean the node two away of four
    second, _ = interpolation(spread, 0)
    coarse = second.T @ between @ second
    assert abs(matrix_of(stencils(grid, 1)) - coarse).max() < 1e-12 * abs(coarse).max()


@pytest.mark.parametrize("axes", [FIRST, BOTH])
@pytest.mark.parametrize("size", [(1.0, 1.0), (0.4, 0.4), (3.0, 0.4), (0.4, 3.0), (0.7, 1.3)])
def test_a_cycle_in_conjugate_gradients_takes_few_iterations(size, axes):
    position, matrix = torus(size, 0.05, axes, ratio=50.0)
    grid = hierarchy(position, matrix, size, axes, 0.1)
    rng = np.random.default_rng(0)
    b = matrix @ rng.normal(size=len(position))
    x, r = np.zeros_like(b), b
    z = v_cycle(grid, r)
    p, count = z, 0
    while np.linalg.norm(r) > 1e-8 * np.linalg.norm(b):
        q, old = matrix @ p, r @ z
        x, r = x + old / (p @ q) * p, r - old / (p @ q) * q
        z = v_cycle(grid, r)
        p, count = z + (r @ z) / old * p, count + 1
        assert count < 15
    np.testing.assert_allclose(matrix @ x, b, atol=1e-7 * np.linalg.norm(b))


@pytest.mark.parametrize("axes", [FIRST, BOTH])
def test_staged_kernels_give_the_same_cycle_on_the_torus(axes):
    size = (1.2, 0.8)
    position, matrix = torus(size, 0.05, axes)
    b = matrix @ np.random.default_rng(1).normal(size=len(position))
    fused = v_cycle(hierarchy(position, matrix, size, axes, 0.1), b)
    staged = hierarchy(position, matrix, size, axes, 0.1)
    staged.fused = False
    np.testing.assert_allclose(v_cycle(staged, b), fused, rtol=0, atol=1e-12 * abs(fused).max())


def test_numbers_of_cells_can_be_halved_as_often_as_the_longer_axis():
    assert periodic_cells(20, 20, 0) == 20
    assert periodic_cells(19, 20, 0) == 20
    assert periodic_cells(4, 64, 0) == 4
    assert periodic_cells(64, 64, 0) == 64
