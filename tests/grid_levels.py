"""Multigrid levels as plain matrices, for tests."""

from __future__ import annotations

import itertools

import numpy as np

from tipfem.backend.arrays import Buffers, download
from tipfem.linalg.multigrid.multigrid import BackgroundMultigrid


def hierarchy(position, matrix, grid_spacing):
    """The multigrid of a SciPy matrix in CSR on its nodes."""
    buffers = Buffers()
    matrix.sort_indices()
    grid = BackgroundMultigrid(position.min(axis=0), position.max(axis=0), grid_spacing, buffers)
    grid.build(
        buffers.upload("position", position),
        buffers.upload("rows", matrix.indptr.astype(np.int32)),
        buffers.upload("columns", matrix.indices.astype(np.int32)),
        buffers.upload("values", matrix.data),
        len(position),
    )
    return grid, buffers


def level_matrix(grid, level):
    """A level's operator as a dense matrix, from its stencils; entries that leave the grid must be zero."""
    shape = tuple(int(n) for n in grid.shapes[level])
    size, start = int(grid.grid[level, 1]), int(grid.grid[level, 7])
    places = 5 ** len(shape)
    rim = [n + 4 for n in shape]
    stencil = download(grid._stencil, start + places * size)[start:].reshape(places, size)
    assert not stencil[:, np.prod(rim) :].any()
    stencil = stencil[:, : np.prod(rim)].reshape(places, *rim)
    inner = (slice(None), *[slice(2, -2)] * len(shape))
    assert np.count_nonzero(stencil) == np.count_nonzero(stencil[inner])  # the rim is zero
    stencil = stencil[inner].reshape(places, -1).T
    shifts = np.array(list(itertools.product(range(-2, 3), repeat=len(shape))))
    nodes = np.stack(np.unravel_index(np.arange(len(stencil)), shape), axis=1)
    target = nodes[:, None, :] + shifts
    inside = ((target >= 0) & (target < shape)).all(axis=2)
    assert (stencil[~inside] == 0).all()
    matrix = np.zeros((len(stencil), len(stencil)))
    row = np.repeat(np.arange(len(stencil))[:, None], len(shifts), axis=1)
    np.add.at(matrix, (row[inside], np.ravel_multi_index(tuple(target[inside].T), shape)), stencil[inside])
    return matrix
