"""Multigrid on a background grid: the approximate inverse of the pressure Laplacian on the mesh.

The mesh changes every step, the grid never does. Nodes interpolate (multi-)linearly to a uniform
grid of about twice the spacing; below it, grids coarsen by two. All coarse operators are Galerkin
products, so they know the jump of the density; their stencils reach two grid nodes in every
direction. Sums are gathered, never scattered with atomics: results are repeatable bit by bit.
"""

from typing import Any

import numpy as np

from tipfem.background_grid import REACH, assemble_first, coarsen
from tipfem.cycle_kernels import (
    coarse_cycle,
    damped_inverse_diagonal,
    down_grid,
    down_mesh,
    up_grid,
    up_mesh,
)
from tipfem.device import Buffers, settings

COARSEST_SWEEPS = 20
# On the CPU, levels of at most this many grid nodes are handled together by one thread in one launch.
SERIAL_SIZE = 600


class BackgroundMultigrid:
    """Hierarchy of uniform grids over a box, for Laplacians on clouds inside it.

    Args:
        lower, upper: (d,) corners of the box [m].
        spacing: of the finest grid [m]; about twice the particles' distance.
        buffers: where the arrays live between steps.
    """

    def __init__(self, lower: np.ndarray, upper: np.ndarray, spacing: float, buffers: Buffers) -> None:
        self.dimension = len(lower)
        self.lower = np.asarray(lower, dtype=float)
        self.spacing = float(spacing)
        self.buffers = buffers
        cells = np.maximum(np.ceil((np.asarray(upper) - self.lower) / spacing - 1e-9).astype(int), 1)
        shapes = [cells + 1]
        while shapes[-1].max() > 5:
            shapes.append((shapes[-1] - 1 + 1) // 2 + 1)
        self.levels = len(shapes)
        self.shapes = np.array(shapes, dtype=np.int32)
        sizes = self.shapes.prod(axis=1)
        self.offsets = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int32)
        total = int(self.offsets[-1])
        self._shape = buffers.upload("mg.shape", self.shapes)
        self._offset = buffers.upload("mg.offset", self.offsets)
        self._stencil = buffers.get("mg.stencil", total, (2 * REACH + 1) ** self.dimension)
        self._x = buffers.get("mg.x", total)
        self._b = buffers.get("mg.b", total)
        self._r = buffers.get("mg.r", total)
        self._nodes = 0
        small = np.flatnonzero(sizes <= (SERIAL_SIZE if settings().get("arch") == "cpu" else 0))
        self._serial_from = int(small[0]) if len(small) else self.levels - 1

    def build(self, position: np.ndarray, row_offsets: Any, columns: Any, values: Any) -> None:
        """Take over a Laplacian in CSR on the nodes ``position`` (N, d), and form the coarse operators.

        row_offsets (N + 1,), columns and values are device arrays. Their rows sum to zero, but
        for Dirichlet conditions.
        """
        self._nodes = n = len(position)
        self._matrix = (row_offsets, columns, values)
        shape = self.shapes[0]
        scaled = (position - self.lower) / self.spacing
        cell = np.clip(np.floor(scaled).astype(np.int32), 0, shape - 2)
        number = np.ravel_multi_index(tuple(cell.T), tuple(shape))
        order = np.argsort(number, kind="stable").astype(np.int32)
        start = np.zeros(int(shape.prod()) + 1, dtype=np.int32)
        np.cumsum(np.bincount(number, minlength=int(shape.prod())), out=start[1:])
        put = self.buffers.upload
        self._cell, self._order, self._start = put("mg.cell", cell), put("mg.order", order), put("mg.start", start)
        self._fraction = put("mg.fraction", scaled - cell)
        self._residual = self.buffers.get("mg.residual", n)
        self._relax = self.buffers.get("mg.relax", n)
        damped_inverse_diagonal(*self._matrix, self._relax, n)
        assemble_first(
            self._cell, self._fraction, self._order, self._start, *self._matrix, self._stencil, self._shape,
            self.dimension,
        )  # fmt: skip
        for level in range(self.levels - 1):
            coarsen(self._stencil, self._shape, self._offset, level, self.dimension)

    def apply(self, b: Any, x: Any) -> None:
        """One V(1,1)-cycle from zero: x (N,) approximates the solution of the Laplacian for b (N,)."""
        matrix, grid, dim = self._matrix, (self._shape, self._offset), self.dimension
        levels = (self._stencil, self._x, self._b, self._r)
        down_mesh(
            b, x, self._residual, self._relax, *matrix, self._fraction, self._order, self._start, self._b,
            self._shape, self._nodes, dim,
        )  # fmt: skip
        for level in range(self._serial_from):
            down_grid(*levels, *grid, level, dim)
        coarse_cycle(*levels, *grid, self._serial_from, self.levels, COARSEST_SWEEPS, dim)
        for level in range(self._serial_from - 1, -1, -1):
            up_grid(*levels, *grid, level, dim)
        up_mesh(
            b, x, self._residual, self._relax, *matrix, self._cell, self._fraction, self._x, self._shape,
            self._nodes, dim,
        )  # fmt: skip
