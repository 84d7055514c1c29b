"""The background grid: how its levels lie in memory, and kernels that form its operators by Galerkin products.

Every level is a box of grid nodes with a rim of `REACH` more on all sides, on which all values are zero: so no loop
asks where the grid ends. Levels lie one behind the other in flat arrays. The last axis is contiguous; a line of
it is what the innermost loops run along, and what the processor's vector units work on. A level's stencil holds its
operator's entries to all grid nodes within `REACH`, place by place: each place is an array like the level.

From a level to the next coarser one it goes axis by axis, the last axis first; between two levels lie grids that are
coarser along some axes only. A fine node between two coarse ones takes its value from both, weighted by how
strongly the operator couples it to either side (J. E. Dendy, J. Comput. Phys. 48, 1982, for one axis): a bubble of a
light fluid stays a bubble on the coarse grid, whatever the lines between which it lies.

``grid`` (L, 9) describes grid by grid, the levels first: the first entry, the number of entries with the rim, the shape
(3) and the strides (2) of all axes but the last, axes that are missing in front being of length 1 and stride 0; the
stencil's first entry; and the number of the grid that is coarser along the next axis.
"""

import itertools

import taichi as ti

from tipfem.backend.barrier import share, synchronise
from tipfem.backend.launch import kernel, part_of

REACH = 2  # a mesh edge joins nodes of neighbouring cells, whose corners are two grid nodes apart
PLACES = 2 * REACH + 1  # of a stencil along an axis
START, SIZE, SHAPE, STRIDE, STENCIL, NEXT = 0, 1, 2, 5, 7, 8


def corners(dim: int) -> list[tuple[int, ...]]:
    """Corners of a cell, as shifts from its lowest one."""
    return list(itertools.product((0, 1), repeat=dim))


@ti.func
def lines(grid: ti.template(), level):
    """Number of a level's lines."""
    return grid[level, SHAPE] * grid[level, SHAPE + 1]


@ti.func
def line_start(grid: ti.template(), level, line, dim: ti.template()):
    """Where a line of a level begins, relative to the level's first entry."""
    n = grid[level, SHAPE + 1]
    return line_at(grid, level, line // n, line % n, dim)


@ti.func
def line_at(grid: ti.template(), level, i, j, dim: ti.template()):
    """The same for the line of numbers i, j along the axes before the last; i is 0 in 2-D. It may lie in the rim."""
    start = REACH + (j + REACH) * grid[level, STRIDE + 1]
    if ti.static(dim == 3):
        start += (i + REACH) * grid[level, STRIDE]
    return start


@ti.func
def row_shift(grid: ti.template(), level, row, dim: ti.template()):
    """How far away, in entries, row ``row`` of a stencil's places lies; a row has `PLACES` of them."""
    shift = (row - REACH) * grid[level, STRIDE + 1]
    if ti.static(dim == 3):
        shift = (row // PLACES - REACH) * grid[level, STRIDE] + (row % PLACES - REACH) * grid[level, STRIDE + 1]
    return shift


@ti.func
def entry(grid: ti.template(), level, i, dim: ti.template()):
    """Entry of grid node ``i`` (dim,), relative to the level's first one."""
    at = i[dim - 1] + REACH
    for k in ti.static(range(dim - 1)):
        at += (i[k] + REACH) * grid[level, STRIDE + 3 - dim + k]
    return at


@ti.func
def cell_number(cell: ti.template(), grid: ti.template(), i, dim: ti.template()):
    """Number of the cell of the finest level that mesh node ``i`` is in; as many as the level has grid nodes."""
    number = 0
    for k in ti.static(range(dim)):
        number = number * grid[0, SHAPE + 3 - dim + k] + cell[i, k]
    return number


@ti.func
def cell_at(grid: ti.template(), line, j, corner: ti.template(), dim: ti.template()):
    """Number of the finest level's cell of which entry ``j`` of a line is this corner; -1 if there is none."""
    across = grid[0, SHAPE + 1]
    at = ti.Vector([line // across, line % across, j])
    number = 0
    inside = True
    for k in ti.static(range(dim)):
        index = at[3 - dim + k] - ti.static(corner[k])
        inside = inside and index >= 0
        number = number * grid[0, SHAPE + 3 - dim + k] + index
    return ti.select(inside, number, -1)


@ti.func
def weight(fraction: ti.template(), i, corner: ti.template(), dim: ti.template()):
    """Multilinear weight of a corner of the node's grid cell."""
    w = 1.0
    for k in ti.static(range(dim)):
        w *= fraction[i, k] if ti.static(corner[k] == 1) else 1.0 - fraction[i, k]
    return w


@ti.func
def axis_stride(grid: ti.template(), level, axis, dim: ti.template()):
    """How far apart neighbours along an axis are, in entries."""
    stride = 1
    if axis < dim - 1:
        stride = grid[level, STRIDE + 3 - dim + axis]
    return stride


@ti.func
def places_apart(axis, dim: ti.template()):
    """How far apart neighbouring places of a stencil along an axis are."""
    apart = 1
    for k in ti.static(range(dim - 1)):
        if axis <= k:
            apart *= PLACES
    return apart


@ti.func
def fine_start(grid: ti.template(), fine, coarse, line, axis, dim: ti.template()):
    """Where the fine line begins that has twice the coarse one's number along the axis, relative to the first entry."""
    across = grid[coarse, SHAPE + 1]
    one, two = line // across, line % across
    if axis == dim - 2:
        two *= 2
    if axis == dim - 3:
        one *= 2
    return line_at(grid, fine, one, two, dim)


def parents(place: int) -> list[tuple[int, int, int, int]]:
    """Coarsening along one axis: which entries of the fine grid add to the entry ``place`` of the coarse one.

    Tuples of: shift to the fine row, of twice the coarse one's number; place in the fine stencil; shift to the fine
    column; and to which side its parent lies: -1 or 1 of an odd column, 0 of an even one.
    """
    found = []
    for near, fine_place in itertools.product((-1, 0, 1), range(PLACES)):
        column = near + fine_place - REACH
        for parent in {column // 2, -(-column // 2)}:
            if parent + REACH == place:
                found.append((near, fine_place, column, 2 * parent - column))
    return found


@ti.func
def _weigh_line(
    stencil: ti.template(), weights: ti.template(), grid: ti.template(), fine, line, axis, dim: ti.template()
):
    """Weights of a line of a grid, laid out as it is: the part of a node's value along an axis that comes from the
    lower side.
    """
    size, inside = grid[fine, SIZE], line_start(grid, fine, line, dim)
    entries = grid[fine, STENCIL] + inside
    apart = places_apart(axis, dim)
    for j in range(grid[fine, SHAPE + 2]):
        lower, upper = 0.0, 0.0
        for others in range(ti.static(PLACES ** (dim - 1))):
            base = others // apart * (apart * PLACES) + others % apart
            for k in ti.static(range(REACH)):
                lower -= stencil[entries + (base + k * apart) * size + j]
                upper -= stencil[entries + (base + (PLACES - 1 - k) * apart) * size + j]
        lower, upper = ti.max(lower, 0.0), ti.max(upper, 0.0)
        both = lower + upper
        weights[grid[fine, START] + inside + j] = ti.select(both > 0.0, lower / ti.max(both, 1e-300), 0.5)


@ti.func
def _coarsen_line(
    stencil: ti.template(), weights: ti.template(), grid: ti.template(), fine, coarse, line, axis, dim: ti.template()
):
    """A line of the Galerkin product along one axis with these weights; P^T A P takes one for each axis."""
    from_size, to_size = grid[fine, SIZE], grid[coarse, SIZE]
    to = grid[coarse, STENCIL] + line_start(grid, coarse, line, dim)
    inside = fine_start(grid, fine, coarse, line, axis, dim)
    at, points = grid[fine, STENCIL] + inside, grid[fine, START] + inside
    step = 2 if axis == dim - 1 else 1
    stride = axis_stride(grid, fine, axis, dim)
    apart = places_apart(axis, dim)
    for others in range(ti.static(PLACES ** (dim - 1))):
        # The place along the axis is zero here; all others are what ``others`` counts, and where its column is.
        base = others // apart * (apart * PLACES) + others % apart
        shift = 0
        rest = others
        for k in ti.static(range(dim - 1, -1, -1)):
            if k != axis:
                shift += (rest % PLACES - REACH) * axis_stride(grid, fine, k, dim)
                rest = rest // PLACES
        target, source = to + base * to_size, at + base * from_size
        for j in range(grid[coarse, SHAPE + 2]):
            for place in ti.static(range(PLACES)):
                total = 0.0
                for near, fine_place, column, side in ti.static(parents(place)):
                    row = near * stride + step * j
                    value = stencil[source + fine_place * apart * from_size + row]
                    if ti.static(near == -1):
                        value *= 1.0 - weights[points + row]
                    if ti.static(near == 1):
                        value *= weights[points + row]
                    if ti.static(side == -1):
                        value *= weights[points + shift + column * stride + step * j]
                    if ti.static(side == 1):
                        value *= 1.0 - weights[points + shift + column * stride + step * j]
                    total += value
                stencil[target + place * apart * to_size + j] = total


@kernel
def coarsen_axis(
    stencil: ti.types.ndarray(),
    weights: ti.types.ndarray(),
    grid: ti.types.ndarray(),
    fine: ti.i32,
    axis: ti.i32,
    dim: ti.template(),
    parts: ti.i32,
    stride: ti.template(),
):
    """Weights of a grid along an axis, and the Galerkin product on the one that is coarser along it."""
    for t in range(parts * stride):
        first, last = part_of(t, parts, stride, lines(grid, fine))
        for line in range(first, last):
            _weigh_line(stencil, weights, grid, fine, line, axis, dim)
    for t in range(parts * stride):
        coarse = grid[fine, NEXT]
        first, last = part_of(t, parts, stride, lines(grid, coarse))
        for line in range(first, last):
            _coarsen_line(stencil, weights, grid, fine, coarse, line, axis, dim)


@kernel
def coarsen_together(
    stencil: ti.types.ndarray(),
    weights: ti.types.ndarray(),
    grid: ti.types.ndarray(),
    levels: ti.i32,
    dim: ti.template(),
    barrier: ti.types.ndarray(),
    threads: ti.i32,
    stride: ti.template(),
    serial: ti.template(),
):
    """The same for all levels and axes, by a team of threads."""
    ti.loop_config(serialize=serial)
    for t in range(threads * stride):
        if t % stride == 0:
            thread = t // stride
            fine = 0
            for number in range((levels - 1) * dim):
                axis = dim - 1 - number % dim
                if axis == dim - 1:
                    fine = number // dim
                coarse = grid[fine, NEXT]
                first, last = share(thread, threads, lines(grid, fine))
                for line in range(first, last):
                    _weigh_line(stencil, weights, grid, fine, line, axis, dim)
                synchronise(barrier, threads)
                first, last = share(thread, threads, lines(grid, coarse))
                for line in range(first, last):
                    _coarsen_line(stencil, weights, grid, fine, coarse, line, axis, dim)
                synchronise(barrier, threads)
                fine = coarse
