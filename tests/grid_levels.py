"""Multigrid levels as plain matrices, and its cycle on NumPy vectors, for tests."""

from __future__ import annotations

import itertools

import numpy as np

from tipfem.backend.arrays import Buffers, download
from tipfem.linalg.multigrid.grid_hierarchy import REACH, RHS, SIZE, SOLUTION, STENCIL, STENCIL_WIDTH
from tipfem.linalg.multigrid.multigrid import BackgroundMultigrid
from tipfem.linalg.sparsity import Csr


def upload_csr(buffers, matrix):
    """A SciPy matrix in CSR on the device."""
    matrix.sort_indices()
    return Csr(
        buffers.upload("rows", matrix.indptr.astype(np.int32)),
        buffers.upload("columns", matrix.indices.astype(np.int32)),
        buffers.upload("values", matrix.data),
    )


def hierarchy(position, matrix, grid_spacing, particles=None):
    """The multigrid of a SciPy matrix in CSR on its nodes."""
    buffers = Buffers()
    grid = BackgroundMultigrid(position.min(axis=0), position.max(axis=0), grid_spacing, buffers, particles)
    grid.build(buffers.upload("position", position), upload_csr(buffers, matrix), len(position))
    return grid


def set_vector(vectors, number, values):
    """Set one of the cycle's vectors (N,) on the mesh."""
    whole = vectors.to_numpy()
    whole[number * len(values) : (number + 1) * len(values)] = values
    vectors.from_numpy(whole)


def v_cycle(grid, rhs):
    """One V-cycle for a right-hand side (N,)."""
    set_vector(grid.vectors, RHS, rhs)
    grid.cycle()
    return grid.vectors.to_numpy()[SOLUTION * len(rhs) : (SOLUTION + 1) * len(rhs)]


def level_matrix(grid, level):
    """A level's operator as a dense matrix, from its stencils; entries that leave the grid must be zero."""
    shape = tuple(int(n) for n in grid.shapes[level])
    size, start = int(grid.layout[level, SIZE]), int(grid.layout[level, STENCIL])
    offsets = STENCIL_WIDTH ** len(shape)
    rim = [n + 2 * REACH for n in shape]
    stencil = download(grid.levels, start + offsets * size)[start:].reshape(*rim[:-1], offsets, rim[-1])
    stencil = np.moveaxis(stencil, -2, 0)
    inner = (slice(None), *[slice(REACH, -REACH)] * len(shape))
    assert np.count_nonzero(stencil) == np.count_nonzero(stencil[inner])  # the rim is zero
    stencil = stencil[inner].reshape(offsets, -1).T
    shifts = np.array(list(itertools.product(range(-REACH, REACH + 1), repeat=len(shape))))
    nodes = np.stack(np.unravel_index(np.arange(len(stencil)), shape), axis=1)
    target = nodes[:, None, :] + shifts
    inside = ((target >= 0) & (target < shape)).all(axis=2)
    assert (stencil[~inside] == 0).all()
    matrix = np.zeros((len(stencil), len(stencil)))
    row = np.repeat(np.arange(len(stencil))[:, None], len(shifts), axis=1)
    np.add.at(matrix, (row[inside], np.ravel_multi_index(tuple(target[inside].T), shape)), stencil[inside])
    return matrix
