"""The background grids: memory layout of their levels, and kernels that form the operators by Galerkin products.

Every level is a box of grid nodes with a rim of `REACH` more on all sides, where all values are zero, so that no
loop needs a test for the boundary. The last axis is contiguous; the innermost, vectorised loops run over a line along
it. A level's stencil holds the operator's entries to all grid nodes within `REACH`, line by line and in each offset by
offset: so what a line needs is in one piece.

Coarsening goes axis by axis, the last axis first; between two levels there are grids that are coarser along some axes
only. A fine node between two coarse ones takes its value from both, weighted by how strongly the operator couples it to
either side (J. E. Dendy, J. Comput. Phys. 48, 1982, for one axis). So the
coarse grid represents a bubble of a light fluid wherever it is between the grid lines.

All grids share one flat array of reals, ``levels``: five vectors of all grids one after the other (right-hand side,
solution, damped inverse diagonal, interpolation weights, residual), then the stencils. The integers ``grid`` (G, 16)
locate the grids in it. The rows are the levels first, then the grids between them; the columns are:

- `RHS`, `SOLUTION`, `DIAGONAL`, `WEIGHTS`, `RESIDUAL`: first entry of the grid's part of each vector;
- `SIZE`: number of entries, with the rim;
- `SHAPE` (3 columns): number of grid nodes along each axis, 1 for a missing first axis in 2-D;
- `STRIDE` (2 columns): entries between neighbours along all axes but the last, 0 for a missing one;
- `STENCIL`: first entry of the stencil;
- `NEXT`: number of the grid that is coarser along the next axis;
- `LEVELS`: number of levels, the same in all rows;
- `PERIOD`: number of lines after which they repeat, where the first axis of a 2-D grid is periodic; else 0. Such a grid
  has no node on its upper end, which is its lower end, and an even number of lines on all levels but the coarsest.
  Of the rim only the image of the first line beyond the last is used, and only the solution there;
- `LAST_PERIOD`: number of nodes after which a line repeats, where the last axis of a 2-D grid is periodic, too; else 0.
  Then the rim holds images of the ends of every line, see `wrap_line`, and there are two more entries between lines.

The cycle's vectors on the N mesh nodes are in an array ``vectors`` of their own, in the same order; each begins at N
times its number. In place of weights it holds `ENERGY`, see `tipfem.linalg.multigrid.deflation`; the residual is
followed by that of the links, see `tipfem.linalg.multigrid.grid_assembly`.
"""

import itertools
from typing import NamedTuple

import taichi as ti

from tipfem.backend.array_types import Ints1, Ints2, Reals1, Reals2, Template
from tipfem.backend.barrier import share, synchronise
from tipfem.backend.launch import kernel

REACH = 2  # a mesh edge joins nodes of neighbouring cells, whose corners are two grid nodes apart
STENCIL_WIDTH = 2 * REACH + 1  # of a stencil along an axis
# Vectors on the mesh and on the grids, and the columns of ``grid``.
RHS, SOLUTION, DIAGONAL, WEIGHTS, RESIDUAL = range(5)
VECTORS = 5
ENERGY = WEIGHTS  # on the mesh, instead of weights
SIZE, SHAPE, STRIDE, STENCIL, NEXT, LEVELS, PERIOD, LAST_PERIOD = 5, 6, 9, 11, 12, 13, 14, 15
COLUMNS = 16
IMAGES = 3  # on either side of a line whose axis is periodic: as far as Galerkin products read weights

GRID_NODE = 40.0  # nanoseconds of one thread for a grid node of the finest level in `coarsen_all_levels`


class GridArrays(NamedTuple):
    """Arrays of a cycle between the mesh and the grids."""

    vectors: "Reals1"  # on the mesh
    coordinates: "Reals2"  # of its nodes in the finest grid
    cell_lists: "Ints1"  # its nodes by cell
    levels: "Reals1"  # vectors and stencils of the grids
    grid: "Ints2"  # their layout
    ties: "Ints1"  # groups of nodes, see `tipfem.linalg.multigrid.mesh_transfer`


class TiedArrays(NamedTuple):
    """The K nodes of all groups in the order in which they are smoothed, see `mesh_transfer.smooth_ties_with_group`."""

    order: "Ints1"
    starts: "Ints1"
    earlier: "Ints1"
    weights: "Reals1"
    steps: "Reals1"
    size: "int"  # K


def corners(dim: int) -> list[tuple[int, ...]]:
    """Corners of a cell, as shifts from its lowest one."""
    return list(itertools.product((0, 1), repeat=dim))


@ti.func
def lines(grid: Template, level):
    """Number of a level's lines."""
    return grid[level, SHAPE] * grid[level, SHAPE + 1]


@ti.func
def length(grid: Template, level):
    """Number of nodes of a level's line."""
    return grid[level, SHAPE + 2]


@ti.func
def node_count(grid: Template, level):
    """Number of a level's nodes."""
    return lines(grid, level) * length(grid, level)


@ti.func
def line_of(grid: Template, level, node):
    """The line of a level that a node is on, and its number there."""
    return node // length(grid, level), node % length(grid, level)


@ti.func
def line_start(grid: Template, level, line, dim: Template):
    """First entry of a line of a level, relative to the level's first entry."""
    n = grid[level, SHAPE + 1]
    return line_at(grid, level, line // n, line % n, dim)


@ti.func
def line_at(grid: Template, level, i, j, dim: Template):
    """The same for the line of numbers i, j along the axes before the last; i is 0 in 2-D. It may be in the rim."""
    start = REACH + (j + REACH) * grid[level, STRIDE + 1]
    if ti.static(dim == 3):
        start += (i + REACH) * grid[level, STRIDE]
    return start


@ti.func
def stencils_at(grid: Template, level, inside, dim: Template):
    """First entry of the stencils of a line, whose first entry is ``inside`` relative to the level's."""
    return grid[level, STENCIL] + REACH + (inside - REACH) * ti.static(STENCIL_WIDTH**dim)


@ti.func
def pitch(grid: Template, level):
    """Entries of a line with its rim, which are between those of two offsets of its stencils."""
    return grid[level, STRIDE + 1]


@ti.func
def line_shift(grid: Template, level, line, shift):
    """Distance in entries from a line to that ``shift`` lines further along the axis before the last."""
    to = line + shift
    if grid[level, PERIOD] > 0:
        to = (to + 4 * grid[level, PERIOD]) % grid[level, PERIOD]
    return (to - line) * grid[level, STRIDE + 1]


@ti.func
def wrap_line(values: Template, grid: Template, level, start, first, last):
    """Copy the ends of a line, from entry ``start`` on, to their images: nodes ``first`` to ``last`` - 1 of them."""
    n = grid[level, LAST_PERIOD]
    if n > 0:
        for k in range(IMAGES):
            lower, upper = k % n, (IMAGES * n - 1 - k) % n
            if first <= upper and upper < last:
                values[start - 1 - k] = values[start + upper]
            if first <= lower and lower < last:
                values[start + n + k] = values[start + lower]


@ti.func
def row_shift(grid: Template, level, line, row, dim: Template, wraps: Template):
    """Distance in entries from a line to row ``row`` of its stencils, `STENCIL_WIDTH` offsets; it may wrap."""
    shift = (row - REACH) * grid[level, STRIDE + 1]
    if ti.static(wraps and dim == 2):
        shift = line_shift(grid, level, line, row - REACH)
    if ti.static(dim == 3):
        shift = (row // STENCIL_WIDTH - REACH) * grid[level, STRIDE]
        shift += (row % STENCIL_WIDTH - REACH) * grid[level, STRIDE + 1]
    return shift


@ti.func
def entry(grid: Template, level, i, dim: Template):
    """Entry of grid node ``i`` (dim,), relative to the level's first one."""
    at = i[dim - 1] + REACH
    for k in ti.static(range(dim - 1)):
        at += (i[k] + REACH) * grid[level, STRIDE + 3 - dim + k]
    return at


@ti.func
def cell_index(coordinates: Template, grid: Template, i, axis: Template, dim: Template):
    """Index along an axis of the finest cell that mesh node ``i`` at ``coordinates`` (N, d) is in."""
    index = ti.cast(ti.floor(coordinates[i, axis]), ti.i32)
    return ti.max(ti.min(index, grid[0, SHAPE + 3 - dim + axis] - 2 + is_periodic(grid, axis, dim)), 0)


@ti.func
def is_periodic(grid: Template, axis: Template, dim: Template):
    """1 for an axis that is periodic, else 0."""
    result = 0
    if ti.static(axis == dim - 2):
        result = ti.min(grid[0, PERIOD], 1)
    if ti.static(axis == dim - 1):
        result = ti.min(grid[0, LAST_PERIOD], 1)
    return result


@ti.func
def nearest_image(grid: Template, shift, dim: Template):
    """The shift (dim,) between two nodes or cells of the finest level, or points, to the nearest image."""
    result = shift
    for k in ti.static(range(2)):
        n = grid[0, PERIOD + k]
        if n > 0:
            if 2 * shift[dim - 2 + k] > n:
                result[dim - 2 + k] = shift[dim - 2 + k] - n
            if 2 * shift[dim - 2 + k] < -n:
                result[dim - 2 + k] = shift[dim - 2 + k] + n
    return result


@ti.func
def cell_of(coordinates: Template, grid: Template, i, dim: Template):
    """Indices (dim,) of the finest level's cell that mesh node ``i`` is in."""
    cell = ti.Vector.zero(ti.i32, dim)
    for k in ti.static(range(dim)):
        cell[k] = cell_index(coordinates, grid, i, k, dim)
    return cell


@ti.func
def cell_number(coordinates: Template, grid: Template, i, dim: Template):
    """Number of the finest level's cell that mesh node ``i`` is in; there are as many numbers as grid nodes."""
    number = 0
    for k in ti.static(range(dim)):
        number = number * grid[0, SHAPE + 3 - dim + k] + cell_index(coordinates, grid, i, k, dim)
    return number


@ti.func
def weight(coordinates: Template, cell: Template, i, corner: Template, dim: Template):
    """Multilinear weight of a corner of ``cell`` (dim,), in which mesh node ``i`` is."""
    w = 1.0
    for k in ti.static(range(dim)):
        fraction = coordinates[i, k] - cell[k]
        w *= fraction if ti.static(corner[k] == 1) else 1.0 - fraction
    return w


@ti.func
def axis_stride(grid: Template, level, axis, dim: Template):
    """Distance of neighbours along an axis, in entries."""
    stride = 1
    if axis < dim - 1:
        stride = grid[level, STRIDE + 3 - dim + axis]
    return stride


@ti.func
def offset_stride(axis, dim: Template):
    """Distance, in arrays, of the arrays for neighbouring offsets of a stencil along an axis."""
    apart = 1
    for k in ti.static(range(dim - 1)):
        if axis <= k:
            apart *= STENCIL_WIDTH
    return apart


@ti.func
def fine_start(grid: Template, fine, coarse, line, axis, dim: Template):
    """First entry, relative to the grid's, of the fine line of twice the coarse one's number along the axis."""
    across = grid[coarse, SHAPE + 1]
    one, two = line // across, line % across
    if axis == dim - 2:
        two *= 2
    if axis == dim - 3:
        one *= 2
    return line_at(grid, fine, one, two, dim)


def parents(offset: int) -> list[tuple[int, int, int, int]]:
    """Coarsening along one axis: the entries of the fine stencil that contribute to entry ``offset`` of the coarse.

    Tuples of: shift to the fine row, of twice the coarse one's number; offset in the fine stencil; shift to the fine
    column; and on which side its parent is: -1 or 1 for an odd column, 0 for an even one.
    """
    found = []
    for near, fine_offset in itertools.product((-1, 0, 1), range(STENCIL_WIDTH)):
        column = near + fine_offset - REACH
        for parent in {column // 2, -(-column // 2)}:
            if parent + REACH == offset:
                found.append((near, fine_offset, column, 2 * parent - column))
    return found


@ti.func
def _compute_weights(levels: Template, grid: Template, fine, line, first, last, axis, dim: Template):
    """Interpolation weights along an axis, the value's part from the lower side: nodes ``first`` to ``last`` - 1."""
    size, inside = pitch(grid, fine), line_start(grid, fine, line, dim)
    entries = stencils_at(grid, fine, inside, dim)
    weights = grid[fine, WEIGHTS] + inside
    apart = offset_stride(axis, dim)
    for j in range(first, last):
        lower, upper = 0.0, 0.0
        for others in range(ti.static(STENCIL_WIDTH ** (dim - 1))):
            base = others // apart * (apart * STENCIL_WIDTH) + others % apart
            for k in ti.static(range(REACH)):
                lower -= levels[entries + (base + k * apart) * size + j]
                upper -= levels[entries + (base + (STENCIL_WIDTH - 1 - k) * apart) * size + j]
        lower, upper = ti.max(lower, 0.0), ti.max(upper, 0.0)
        both = lower + upper
        levels[weights + j] = ti.select(both > 0.0, lower / ti.max(both, 1e-300), 0.5)
    wrap_line(levels, grid, fine, weights, first, last)
    if axis == dim - 1 and grid[fine, LAST_PERIOD] > 0:  # the product reads the stencils of rows beyond the ends
        for offset in range(ti.static(STENCIL_WIDTH**dim)):
            wrap_line(levels, grid, fine, entries + offset * size, first, last)


@ti.func
def _galerkin_product(levels: Template, grid: Template, fine, coarse, line, first, last, axis, dim: Template):
    """Galerkin product P^T A P along one axis, of ``dim``, for the nodes from ``first`` to ``last`` - 1 of a line."""
    from_size, to_size = pitch(grid, fine), pitch(grid, coarse)
    to = stencils_at(grid, coarse, line_start(grid, coarse, line, dim), dim)
    inside = fine_start(grid, fine, coarse, line, axis, dim)
    at, weights = stencils_at(grid, fine, inside, dim), grid[fine, WEIGHTS] + inside
    step = 2 if axis == dim - 1 else 1
    stride = axis_stride(grid, fine, axis, dim)
    apart = offset_stride(axis, dim)
    two = line % grid[coarse, SHAPE + 1] * (2 if axis == dim - 2 else 1)
    # Distances in entries to the rows and columns up to three away along the axis.
    moves, spread = ti.Vector.zero(ti.i32, 7), 1 if axis == dim - 1 else ti.static(STENCIL_WIDTH**dim)
    for k in ti.static(range(7)):
        moves[k] = line_shift(grid, fine, two, k - 3) if axis == dim - 2 else (k - 3) * stride
    # Where no fluid is, all entries are zero.
    low, high, middle = last, first, at + ti.static(STENCIL_WIDTH**dim // 2) * from_size
    for j in range(first, last):
        there = False
        for k in ti.static(range(2, 5)):
            there = there or levels[middle + moves[k] * spread + step * j] != 0.0
        if there:
            low, high = ti.min(low, j), j + 1
    for others in range(ti.static(STENCIL_WIDTH ** (dim - 1))):
        # ``others`` counts the offsets along the other axes; that along the axis is zero here.
        base = others // apart * (apart * STENCIL_WIDTH) + others % apart
        shift = 0
        remainder = others
        for k in ti.static(range(dim - 1, -1, -1)):
            if k != axis:
                away = remainder % STENCIL_WIDTH - REACH
                if ti.static(k == dim - 2):
                    shift += line_shift(grid, fine, two, away)
                else:
                    shift += away * axis_stride(grid, fine, k, dim)
                remainder = remainder // STENCIL_WIDTH
        target, source = to + base * to_size, at + base * from_size
        for j in range(first, last):
            if j < low or j >= high:
                for offset in ti.static(range(STENCIL_WIDTH)):
                    levels[target + offset * apart * to_size + j] = 0.0
        for j in range(low, high):
            for offset in ti.static(range(STENCIL_WIDTH)):
                total = 0.0
                for near, fine_offset, column, side in ti.static(parents(offset)):
                    row = moves[ti.static(near + 3)] + step * j
                    at_row = moves[ti.static(near + 3)] * spread + step * j
                    value = levels[source + fine_offset * apart * from_size + at_row]
                    if ti.static(near == -1):
                        value *= 1.0 - levels[weights + row]
                    if ti.static(near == 1):
                        value *= levels[weights + row]
                    if ti.static(side == -1):
                        value *= levels[weights + shift + moves[ti.static(column + 3)] + step * j]
                    if ti.static(side == 1):
                        value *= 1.0 - levels[weights + shift + moves[ti.static(column + 3)] + step * j]
                    total += value
                levels[target + offset * apart * to_size + j] = total


@kernel
def coarsen_axis(levels: Reals1, grid: Ints2, fine: ti.i32, axis: ti.i32, dim: Template):
    """Weights and Galerkin product along an axis, where threads cannot wait; else `coarsen_all_levels` does all."""
    for node in range(node_count(grid, fine)):
        line, j = line_of(grid, fine, node)
        _compute_weights(levels, grid, fine, line, j, j + 1, axis, dim)
    for node in range(node_count(grid, grid[fine, NEXT])):
        coarse = grid[fine, NEXT]
        line, j = line_of(grid, coarse, node)
        _galerkin_product(levels, grid, fine, coarse, line, j, j + 1, axis, dim)


@kernel
def coarsen_all_levels(
    levels: Reals1, grid: Ints2, dim: Template, stride: Template, serial: Template, threads: ti.i32, barrier: Ints1
):
    """Weights and Galerkin products of all levels and axes."""
    ti.loop_config(serialize=serial)
    for t in range(threads * stride):
        if t % stride == 0:
            thread = t // stride
            fine = 0
            for number in range((grid[0, LEVELS] - 1) * dim):
                axis = dim - 1 - number % dim
                if axis == dim - 1:
                    fine = number // dim
                coarse = grid[fine, NEXT]
                first, last = share(thread, threads, lines(grid, fine))
                for line in range(first, last):
                    _compute_weights(levels, grid, fine, line, 0, length(grid, fine), axis, dim)
                synchronise(barrier, threads)
                first, last = share(thread, threads, lines(grid, coarse))
                for line in range(first, last):
                    _galerkin_product(levels, grid, fine, coarse, line, 0, length(grid, coarse), axis, dim)
                synchronise(barrier, threads)
                fine = coarse
