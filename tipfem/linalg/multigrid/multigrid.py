"""Multigrid on a background grid: the approximate inverse of the pressure Laplacian on the mesh.

The mesh changes every step, the grid never does. Nodes interpolate (multi-)linearly to a uniform
grid of about twice the spacing; below it, grids coarsen by two. All coarse operators are Galerkin
products, so they know the jump of the density; their stencils reach two grid nodes in every
direction. Sums are gathered, never scattered with atomics: results are repeatable bit by bit.
"""

from typing import Any

import numpy as np

from tipfem.backend import barrier
from tipfem.backend.arrays import Buffers
from tipfem.backend.launch import launch
from tipfem.linalg.multigrid.fused_cycle import cycle_together
from tipfem.linalg.multigrid.grid_assembly import assemble_first, count_links, find_cells, lay_links, sort_into_cells
from tipfem.linalg.multigrid.grid_hierarchy import NEXT, PLACES, REACH, SIZE, STENCIL, coarsen_axis, coarsen_together
from tipfem.linalg.multigrid.mesh_transfer import damped_inverse_diagonals, down_mesh, up_mesh
from tipfem.linalg.multigrid.v_cycle import coarsest_grid, down_grid, up_grid
from tipfem.linalg.sparsity import accumulate

COARSEST_SWEEPS = 20
ENTRIES = 40.0  # nanoseconds that a thread takes for a grid node in the product along an axis
FIND = 10.0  # for a particle's cell
ROW = 30.0  # for a particle's row in a sweep
PRODUCT = 60.0  # for a particle in the product on the finest grid
CYCLE = 300.0  # for a particle in a cycle


class BackgroundMultigrid:
    """Hierarchy of uniform grids over a box, for Laplacians on clouds inside it.

    Args:
        lower, upper: (d,) corners of the box [m].
        spacing: of the finest grid [m]; about twice the particles' distance.
        buffers: where the arrays live between steps.

    Attributes:
        together: whether threads do a cycle in one launch, waiting for each other; they do on processors.
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
        self._cells = int(sizes[0])
        self.grid, self._passes = _layout(self.shapes)
        self._grid = buffers.upload("mg.grid", self.grid)
        self._lower = buffers.upload("mg.lower", self.lower)
        # Rims are zero for good: no kernel writes there.
        total = int(self.grid[-1, :2].sum() + self.grid[0, 0])
        stencils = int((self.grid[:, STENCIL] + self.grid[:, 1] * PLACES**self.dimension).max())
        self._stencil = buffers.upload("mg.stencil", np.zeros(stencils))
        self._x, self._b, self._r, self._grid_relax, self._weights = (
            buffers.upload(f"mg.{name}", np.zeros(total)) for name in ("x", "b", "r", "grid_relax", "weights")
        )
        self._nodes, self.together = 0, barrier.available()

    def build(self, position: Any, row_offsets: Any, columns: Any, values: Any, nodes: int) -> None:
        """Take over a Laplacian in CSR on ``nodes`` nodes at ``position`` (N, d), and form the coarse operators.

        All arguments are device arrays: row_offsets (N + 1,), columns and values. Rows sum to zero, but
        for Dirichlet conditions.
        """
        self._nodes = nodes
        self._matrix = (row_offsets, columns, values)
        get, dim = self.buffers.get, self.dimension
        self._start = get("mg.start", self._cells + 1, integer=True)
        cursor = get("mg.cursor", max(self._cells, nodes), integer=True)

        def settle_nodes(room: int) -> None:
            self._cell, self._fraction = get("mg.cell", room, dim, integer=True), get("mg.fraction", room, dim)
            launch(
                find_cells,
                position,
                self._lower,
                self._grid,
                self._cell,
                self._fraction,
                self._start,
                self.spacing,
                nodes,
                self._cells,
                dim,
                work=(nodes, FIND),
            )

        settle_nodes(nodes)
        links = get("mg.links", nodes + 1, integer=True)
        launch(count_links, *self._matrix, self._cell, self._fraction, links, nodes, dim, work=(nodes, ROW))
        count = nodes + launch(accumulate, links, cursor, nodes)
        rows, self._residual = get("mg.rows", count, 4**dim), get("mg.residual", count)
        if count > nodes:
            if count > self._cell.shape[0]:  # a larger array is an empty one
                settle_nodes(count)
            launch(
                lay_links,
                *self._matrix,
                self._cell,
                self._fraction,
                links,
                rows,
                self._residual,
                self._start,
                self._grid,
                nodes,
                dim,
                work=(nodes, ROW),
            )
        self._order = get("mg.order", count, integer=True)
        launch(accumulate, self._start, cursor, self._cells)
        launch(sort_into_cells, self._cell, self._grid, self._start, cursor, self._order, count, self._cells, dim)
        launch(
            assemble_first,
            self._cell,
            self._fraction,
            self._order,
            self._start,
            *self._matrix,
            rows,
            self._stencil,
            self._grid,
            nodes,
            dim,
            work=(nodes, PRODUCT),
        )
        operators = (self._stencil, self._weights, self._grid)
        if self.together:
            launch(coarsen_together, *operators, self.levels, dim, work=(int(self.grid[0, SIZE]), ENTRIES))
        else:
            for fine, axis in self._passes:
                launch(coarsen_axis, *operators, fine, axis, dim)
        self._relax = get("mg.relax", nodes)
        launch(
            damped_inverse_diagonals,
            *self._matrix,
            self._relax,
            self._stencil,
            self._grid_relax,
            self._grid,
            nodes,
            self.levels,
            dim,
            work=(nodes, ROW),
        )

    def apply(self, b: Any, x: Any) -> None:
        """One V(1,1)-cycle from zero: x (N,) approximates the solution of the Laplacian for b (N,)."""
        dim = self.dimension
        if self.together:
            launch(
                cycle_together,
                b,
                x,
                self._residual,
                self._relax,
                *self._matrix,
                *self.grids,
                self._nodes,
                self.levels,
                COARSEST_SWEEPS,
                dim,
                work=(self._nodes, CYCLE),
            )
            return
        _, fraction, order, start, *levels = self.grids
        stencil, _weights, relax, x_grid, b_grid, _, grid = levels
        launch(
            down_mesh,
            b,
            x,
            self._residual,
            self._relax,
            *self._matrix,
            fraction,
            order,
            start,
            b_grid,
            grid,
            self._nodes,
            dim,
        )
        for level in range(self.levels - 1):
            launch(down_grid, *levels, level, dim)
        launch(coarsest_grid, stencil, relax, x_grid, b_grid, grid, self.levels, COARSEST_SWEEPS, dim)
        for level in range(self.levels - 2, -1, -1):
            launch(up_grid, *levels, level, dim)
        launch(
            up_mesh, b, x, self._residual, self._relax, *self._matrix, *self.grids[:2], x_grid, grid, self._nodes, dim
        )

    @property
    def mesh_arrays(self) -> tuple[Any, Any]:
        """Device arrays (N,): what a sweep leaves, and the damped inverse diagonal."""
        return self._residual, self._relax

    @property
    def grids(self) -> tuple[Any, ...]:
        """Device arrays: cell, fraction, order and start of `grid_assembly`, stencil, weights, relax, x, b and r of all
        levels, and what describes them."""
        return (
            self._cell,
            self._fraction,
            self._order,
            self._start,
            self._stencil,
            self._weights,
            self._grid_relax,
            self._x,
            self._b,
            self._r,
            self._grid,
        )


def _layout(shapes: np.ndarray) -> tuple[np.ndarray, list[tuple[int, int]]]:
    """Where levels of ``shapes`` (L, d) lie, see `grid_hierarchy`, and the passes that coarsen them.

    Behind the levels come those that stand between two of them, coarser along some axes only; they have stencils
    alone. A pass is (grid, axis): from a grid to the one that is coarser along an axis.
    """
    levels, dim = shapes.shape
    every, passes, after = [list(map(int, shape)) for shape in shapes], [], []
    for level in range(levels - 1):
        fine, shape = level, list(every[level])
        for axis in reversed(range(dim)):
            shape[axis] = every[level + 1][axis]
            coarse = level + 1 if axis == 0 else len(every)
            if axis:
                every.append(list(shape))
            passes.append((fine, axis))
            after.append(coarse)
            fine = coarse
    grid = np.zeros((len(every), 9), dtype=np.int32)
    # Loops may look, to no effect, a little beyond the rim; also before the first grid and behind the last one.
    margin = 3 * int(np.prod(shapes[0] + 2 * REACH) // (shapes[0][0] + 2 * REACH) * 2 + 1)
    start, stencil = margin, 0
    for row, shape in zip(grid, every, strict=True):
        rim = [n + 2 * REACH for n in shape]
        # Places of a stencil must not lie a multiple of 4 kB apart, or they fight for the same lines of the cache.
        size = int(np.prod(rim))
        size += (24 - size) % 512
        strides = [int(np.prod(rim[k + 1 :])) for k in range(dim - 1)]
        row[:] = [start, size, *[1] * (3 - dim), *shape, *[0] * (3 - dim), *strides, stencil, 0]
        start += size
        stencil += size * PLACES**dim
    for (fine, _), coarse in zip(passes, after, strict=True):
        grid[fine, NEXT] = coarse
    return grid, passes
