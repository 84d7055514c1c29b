"""Multigrid on a background grid: the approximate inverse of the pressure Laplacian on the mesh.

The mesh changes every step, the grid does not. Particles interpolate (multi-)linearly to a uniform grid of about twice
their spacing; below it, grids coarsen by two. All coarse operators are Galerkin products, so they represent the jump of
density; their stencils reach two grid nodes in every direction. Sums are gathered, never scattered with atomic
operations: results are repeatable bit by bit.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from tipfem.backend.arrays import Buffers
from tipfem.backend.barrier import available
from tipfem.backend.launch import launch
from tipfem.backend.runtime import on_gpu
from tipfem.linalg.multigrid.fused_cycle import CYCLE, cycle_from_zero
from tipfem.linalg.multigrid.grid_assembly import (
    CHAINS,
    LOCATE,
    PRODUCT,
    assemble_by_nodes,
    assemble_finest,
    count_links,
    fill_lists,
    locate_nodes,
    multiply_rows,
    place_links,
)
from tipfem.linalg.multigrid.grid_hierarchy import (
    COLUMNS,
    GRID_NODE,
    LEVELS,
    NEXT,
    PERIOD,
    REACH,
    SHAPE,
    SIZE,
    STENCIL,
    STENCIL_WIDTH,
    STRIDE,
    VECTORS,
    GridArrays,
    TiedArrays,
    coarsen_all_levels,
    coarsen_axis,
)
from tipfem.linalg.multigrid.grid_transfer import invert_coarsest
from tipfem.linalg.multigrid.mesh_transfer import (
    MESH_ROW,
    count_earlier,
    damped_inverse_diagonals,
    list_earlier,
    order_ties,
)
from tipfem.linalg.multigrid.v_cycle import (
    SMALL,
    ascend,
    ascend_to_mesh,
    descend,
    descend_from_mesh,
    solve_coarsest_level,
    visit_small_levels,
)
from tipfem.linalg.queued_fgmres import HEAD, Pace
from tipfem.linalg.sparsity import Csr, running_sums
from tipfem.typing import Array

# The finest grid has no more nodes than so many a particle, or than the second number: where particles are far from
# each other along an axis in terms of their spacing, a finer grid would have no use, and could take any memory.
NODES_PER_PARTICLE, FEW_NODES = 16, 20_000


class BackgroundMultigrid:
    """Hierarchy of uniform grids over a box, for Laplacians on clouds of particles inside it.

    Args:
        lower, upper: (d,) corners of the box [m].
        spacing: of the finest grid [m]; about twice that of the particles.
        particles: about how many there are; with few, the grid is coarser along the longest axes. By default as many as
            the grid may have.
        periodic: the periodic axes, in 2-D: none, the first, or both. Along these the box is as wide as the period.

    Attributes:
        spacing: (d,) of the finest grid along the axes [m].
        shapes: (L, d) numbers of grid nodes of the levels along the axes.
        layout: (G, 16) memory layout of the grids; it and the arrays ``grid``, ``levels`` as in `grid_hierarchy`.
        pace: of the last solve on a GPU, see `tipfem.linalg.queued_fgmres`.
        fused: whether a cycle is one launch; it is on CPUs.
        vectors, coordinates, cell_lists, ties: device arrays of the mesh nodes, see `mesh_transfer`; set by `build`.
        tied: the ties in the order in which a GPU smooths at them, see `mesh_transfer.smooth_ties_with_group`.
    """

    def __init__(
        self,
        lower: Array,
        upper: Array,
        spacing: float,
        buffers: Buffers,
        particles: int | None = None,
        *,
        periodic: Sequence[int] = (),
    ) -> None:
        self.dimension = len(lower)
        self.lower = np.asarray(lower, dtype=float)
        self.buffers = buffers
        size = np.asarray(upper) - self.lower
        self.spacing, cells = grid_cells(size, float(spacing), particles)
        end = np.ones(self.dimension, dtype=int)  # 0 along a periodic axis, whose ends are one
        end[list(periodic)] = 0
        most = max(cells) if len(periodic) > 1 else cells[-1]
        for k in periodic:
            cells[k] = periodic_cells(int(cells[k]), int(most), int(end[-1]))
            self.spacing[k] = size[k] / cells[k]
        shapes = [cells + end]
        while shapes[-1].max() > 5 and not (shapes[-1][list(periodic)] % 2).any():
            shapes.append((shapes[-1] - end + 1) // 2 + end)
        self.shapes = np.array(shapes, dtype=np.int32)
        self._cells = int(self.shapes[0].prod())
        self.layout, self._passes, entries = _layout(self.shapes, periodic)
        self.grid = buffers.upload("multigrid.grid", self.layout)
        # Rims stay zero: no kernel writes there.
        self.levels = buffers.upload("multigrid.levels", np.zeros(entries))
        self._untied = self.ties = buffers.upload("multigrid.untied", np.zeros(1, dtype=np.int32))
        self._lower = buffers.upload("multigrid.lower", self.lower)
        self._spacing = buffers.upload("multigrid.spacing", self.spacing)
        self._nodes, self.fused = 0, available()
        small = SMALL if on_gpu() else 0
        self._large = min(int((self.shapes.prod(axis=1) > small).sum()), len(shapes) - 1)  # levels of a launch each
        self.pace = Pace()
        self.vectors: Any = None
        self.tied: TiedArrays | None = None
        self._inverse: Any = None
        self.coordinates: Any = None
        self.cell_lists: Any = None

    def build(self, position: Any, matrix: Csr, nodes: int, ties: tuple[Any, int] | None = None) -> None:
        """Set the Laplacian on the mesh of particles (N, d) [m], on the device, and form the coarse operators.

        Rows of the matrix sum to zero, except for Dirichlet conditions. ``ties`` are the groups of nodes at one place,
        see `mesh_transfer`, and the number of these nodes; None without any.
        """
        self.ties, self._tied = (self._untied, 0) if ties is None else ties
        self._nodes, self._matrix = nodes, matrix
        get, dim, cells = self.buffers.get, self.dimension, self._cells
        cursor = get("multigrid.cursor", cells, integer=True)
        lists = self._locate(position, nodes, nodes)
        links = get("multigrid.links", nodes + 1, integer=True)
        work = (nodes, CHAINS)
        launch(count_links, matrix, self.coordinates, self.grid, links, nodes, dim, work=work)
        count = nodes + running_sums(links, nodes, self.buffers)
        rows = get("multigrid.rows", count, 4**dim)
        self.vectors = get("multigrid.vectors", (VECTORS - 1) * nodes + count)
        if count > nodes:
            if count > min(self.coordinates.shape[0], lists.shape[0] - cells - 1):
                lists = self._locate(position, nodes, count)  # the larger arrays are new, and so empty
            of_links = self.coordinates, links, rows, self.vectors, lists, self.grid
            launch(place_links, matrix, *of_links, nodes, dim, work=work)
        running_sums(lists, cells, self.buffers, cursor, most=count)
        launch(fill_lists, self.coordinates, self.grid, lists, cursor, count, cells, dim)
        work = (nodes, PRODUCT)
        launch(multiply_rows, self.coordinates, matrix, rows, self.grid, nodes, dim, work=work)
        on_grid = self.coordinates, lists, rows, self.levels, self.grid, dim
        if on_gpu():
            launch(assemble_by_nodes, *on_grid)
        else:
            launch(assemble_finest, *on_grid, work=work)
        if self.fused:
            launch(coarsen_all_levels, self.levels, self.grid, dim, work=(int(self.layout[0, SIZE]), GRID_NODE))
        else:
            for fine, axis in self._passes:
                launch(coarsen_axis, self.levels, self.grid, fine, axis, dim)
        work = (nodes, MESH_ROW)
        launch(damped_inverse_diagonals, matrix, self.vectors, self.levels, self.grid, nodes, dim, work=work)
        if on_gpu():
            self.tied = self._list_ties()
            coarsest = int(self.shapes[-1].prod())
            self._inverse = get("multigrid.inverse", coarsest**2)
            scratch = get("multigrid.columns", coarsest * int(self.layout[len(self.shapes) - 1, SIZE]))
            launch(invert_coarsest, self.levels, self.grid, self._inverse, scratch, dim)

    def _list_ties(self) -> TiedArrays:
        """The nodes of all groups for `tipfem.linalg.multigrid.mesh_transfer.smooth_ties_with_group`."""
        get, n, (offsets, columns, _) = self.buffers.get, self._nodes, self._matrix
        place, order, starts = (get(f"multigrid.{k}", n + 1, integer=True) for k in ("place", "order", "starts"))
        count, entries = self._tied, 0
        if count:
            launch(order_ties, self.ties, place, order, n)
            launch(count_earlier, offsets, columns, place, order, starts, count)
            entries = running_sums(starts, count, self.buffers, most=columns.shape[0])
        earlier, weights = get("multigrid.earlier", entries, integer=True), get("multigrid.weights", entries)
        if count:
            launch(list_earlier, self._matrix, place, order, starts, earlier, weights, count)
        return TiedArrays(order, starts, earlier, weights, get("multigrid.steps", 2 * count + 3), count)

    def _locate(self, position: Any, nodes: int, count: int) -> Any:
        """Find the mesh nodes' grid cells, with room for ``count`` nodes and links; return the array ``cell_lists``."""
        get, dim = self.buffers.get, self.dimension
        self.coordinates = get("multigrid.coordinates", count, dim)
        self.cell_lists = get("multigrid.cell_lists", self._cells + 1 + count, integer=True)
        where = position, self._lower, self.grid, self.coordinates, self.cell_lists, self._spacing
        launch(locate_nodes, *where, nodes, self._cells, dim, work=(nodes, LOCATE))
        return self.cell_lists

    @property
    def arrays(self) -> GridArrays:
        """The arrays of a cycle."""
        return GridArrays(self.vectors, self.coordinates, self.cell_lists, self.levels, self.grid, self.ties)

    def cycle(self) -> None:
        """One V(1,1)-cycle from a zero guess, from the right-hand side to the solution in ``vectors``."""
        given = self._matrix, self.arrays, self._nodes, self.dimension
        if self.fused:
            launch(cycle_from_zero, *given, work=(self._nodes, CYCLE))
            return
        launch(descend_from_mesh, *given)
        self.visit_grids(self.buffers.filled("multigrid.always", HEAD, 1.0))
        launch(ascend_to_mesh, *given)

    def visit_grids(self, state: Any) -> None:
        """Items 2 to 4 of a cycle, where it is not one launch, see `tipfem.linalg.multigrid.v_cycle`.

        A GPU does nothing where the ``state`` of a `tipfem.linalg.queued_fgmres.QueuedSolve` has no more iterations.
        """
        levels, grid, dim = self.levels, self.grid, self.dimension
        for level in range(self._large):
            launch(descend, levels, grid, state, level, dim)
        if on_gpu():
            launch(visit_small_levels, levels, grid, self._inverse, state, self._large, dim)
        else:
            launch(solve_coarsest_level, levels, grid, dim)
        for level in range(self._large - 1, -1, -1):
            launch(ascend, levels, grid, state, level, dim)


def grid_cells(size: Array, spacing: float, particles: int | None) -> tuple[Array, Array]:
    """Sides (d,) of the finest cells in a box of ``size`` (d,) [m], and their numbers; larger for few ``particles``."""
    sides = np.full(len(size), spacing)
    most = np.inf if particles is None else max(NODES_PER_PARTICLE * particles, FEW_NODES)
    while True:
        cells = np.maximum(np.ceil(size / sides - 1e-9), 1.0)
        if np.prod(cells + 1 + 2 * REACH) <= most or cells.max() == 1:
            break
        sides[np.argmax(cells)] *= 2
    if len(size) > 2:
        # Where a tank ended early in the last cells, or cells were longer than two distances of its lattice, Krylov's
        # method took up to three times the iterations.
        fitting = np.maximum(np.ceil(size / sides - 0.25), 1.0)
        off = np.abs(size / sides - fitting) > 1e-9
        sides[off], cells[off] = (size / fitting)[off], fitting[off]
    return sides, cells.astype(int)


def periodic_cells(wanted: int, across: int, end: int = 1) -> int:
    """Number of cells along a periodic axis, about as many as ``wanted``, so that they can be halved often.

    ``across`` is the number of cells along the other axis, which are halved as often, and ``end`` that of grid nodes
    more: 1, or 0 if it is periodic, too.
    """
    halvings = 0
    while across + end > 5:
        across, halvings = (across + 1) // 2, halvings + 1
    found = [m << k for k in range(1, 24) for m in (2, 3, 5) if k >= halvings or m == 2]
    return min(found, key=lambda n: abs(np.log(n / wanted)))


def _layout(shapes: Array, periodic: Sequence[int] = ()) -> tuple[Array, list[tuple[int, int]], int]:
    """Memory layout of grids whose levels have ``shapes`` (L, d), see `grid_hierarchy`.

    The rows of ``grid`` (G, 16); the passes that coarsen the levels, as (grid, axis) from a grid to the one that is
    coarser along an axis; the number of entries of ``levels``.
    """
    count, dim = shapes.shape
    every, passes, after = [list(map(int, shape)) for shape in shapes], [], []
    for level in range(count - 1):
        fine, shape = level, list(every[level])
        for axis in reversed(range(dim)):
            shape[axis] = every[level + 1][axis]
            coarse = level + 1 if axis == 0 else len(every)
            if axis:
                every.append(list(shape))
            passes.append((fine, axis))
            after.append(coarse)
            fine = coarse
    grid = np.zeros((len(every), COLUMNS), dtype=np.int32)
    grid[:, LEVELS] = count
    # Loops may read, to no effect, a little beyond the rim, so also before the first grid and after the last.
    rim = np.full(dim, 2 * REACH)
    if dim - 1 in periodic:
        rim[-1] += 2  # so that lines share no images, see `wrap_line`
    margin = 3 * int(np.prod(shapes[0] + rim) // (shapes[0][0] + rim[0]) * 2 + 1)
    start, stencil = margin, 0
    for row, shape in zip(grid, every, strict=True):
        with_rim = [n + more for n, more in zip(shape, rim.tolist(), strict=True)]
        size = int(np.prod(with_rim))
        row[:VECTORS], row[SIZE], row[STENCIL] = start, size, stencil
        row[SHAPE : SHAPE + 3] = [1] * (3 - dim) + shape
        for k in periodic:
            row[PERIOD + k] = shape[k]
        row[STRIDE : STRIDE + 2] = [0] * (3 - dim) + [int(np.prod(with_rim[k + 1 :])) for k in range(dim - 1)]
        start += size
        stencil += size * STENCIL_WIDTH**dim
    entries = start + margin  # of one vector
    grid[:, :VECTORS] += np.arange(VECTORS, dtype=np.int32) * entries
    grid[:, STENCIL] += VECTORS * entries
    for (fine, _), coarse in zip(passes, after, strict=True):
        grid[fine, NEXT] = coarse
    return grid, passes, VECTORS * entries + stencil
