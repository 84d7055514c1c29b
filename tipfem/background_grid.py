"""The background grid: its numbering, and kernels that form its operators by Galerkin products.

Levels lie one behind the other in flat arrays; ``offset[level]`` is a level's first row and
``shape[level, k]`` its number of grid nodes along axis k. A row of ``stencil`` holds the operator's
entries to all grid nodes within `REACH`. Sums are gathered, never scattered with atomics.
"""

import itertools

import taichi as ti

REACH = 2  # a mesh edge joins nodes of neighbouring cells, whose corners are two grid nodes apart


def corners(dim: int) -> list[tuple[int, ...]]:
    """Corners of a cell, as shifts from its lowest one."""
    return list(itertools.product((0, 1), repeat=dim))


def children(dim: int) -> list[tuple[tuple[int, ...], float]]:
    """Fine nodes that a coarse one interpolates to: their shift on the fine grid, and the weight."""
    shifts = itertools.product((-1, 0, 1), repeat=dim)
    return [(shift, 0.5 ** sum(abs(k) for k in shift)) for shift in shifts]


@ti.func
def grid_index(i, shape: ti.template(), level, dim: ti.template()):
    """Row-major number of grid node ``i`` (dim,) on its level; -1 outside."""
    number = 0
    inside = True
    for k in ti.static(range(dim)):
        inside = inside and i[k] >= 0 and i[k] < shape[level, k]
        number = number * shape[level, k] + i[k]
    return ti.select(inside, number, -1)


@ti.func
def grid_node(number, shape: ti.template(), level, dim: ti.template()):
    """Indices (dim,) of a grid node from its row-major number."""
    i = ti.Vector.zero(ti.i32, dim)
    rest = number
    for k in ti.static(range(dim - 1, -1, -1)):
        i[k] = rest % shape[level, k]
        rest = rest // shape[level, k]
    return i


@ti.func
def level_size(shape: ti.template(), level, dim: ti.template()):
    """Number of grid nodes of a level."""
    n = 1
    for k in ti.static(range(dim)):
        n *= shape[level, k]
    return n


@ti.func
def weight(fraction: ti.template(), i, corner: ti.template(), dim: ti.template()):
    """Multilinear weight of a corner of the node's grid cell."""
    w = 1.0
    for k in ti.static(range(dim)):
        w *= fraction[i, k] if ti.static(corner[k] == 1) else 1.0 - fraction[i, k]
    return w


@ti.kernel
def assemble_first(
    cell: ti.types.ndarray(), fraction: ti.types.ndarray(), order: ti.types.ndarray(), start: ti.types.ndarray(),
    row_offsets: ti.types.ndarray(), columns: ti.types.ndarray(), values: ti.types.ndarray(),
    stencil: ti.types.ndarray(), shape: ti.types.ndarray(), dim: ti.template(),
):  # fmt: skip
    """Galerkin product P^T A P on the finest grid; each grid node gathers from its 2^d cells.

    A connection that spans more than the stencil's reach is left out, with its part of the
    diagonal, so that rows still sum to zero.
    """
    for g in range(level_size(shape, 0, dim)):
        for s in range(stencil.shape[1]):
            stencil[g, s] = 0.0
        at = grid_node(g, shape, 0, dim)
        for corner in ti.static(corners(dim)):
            # The cell in which g is this corner.
            i_cell = at - ti.Vector(corner)
            c = grid_index(i_cell, shape, 0, dim)
            if c >= 0:
                for m in range(start[c], start[c + 1]):
                    i = order[m]
                    w_i = weight(fraction, i, corner, dim)
                    for s in range(row_offsets[i], row_offsets[i + 1]):
                        j = columns[s]
                        a = w_i * values[s]
                        shift = ti.Vector([cell[j, k] for k in ti.static(range(dim))]) - i_cell
                        if shift.max() > 1 or shift.min() < -1:
                            shift, j = 0 * shift, i
                        for other in ti.static(corners(dim)):
                            place = 0
                            for k in ti.static(range(dim)):
                                place = place * (2 * REACH + 1) + shift[k] + other[k] - corner[k] + REACH
                            stencil[g, place] += a * weight(fraction, j, other, dim)


@ti.kernel
def coarsen(
    stencil: ti.types.ndarray(), shape: ti.types.ndarray(), offset: ti.types.ndarray(),
    fine: ti.i32, dim: ti.template(),
):  # fmt: skip
    """Galerkin product from level ``fine`` to the next, with multilinear interpolation."""
    for g in range(level_size(shape, fine + 1, dim)):
        target = offset[fine + 1] + g
        for s in range(stencil.shape[1]):
            stencil[target, s] = 0.0
        at = grid_node(g, shape, fine + 1, dim)
        for near, w in ti.static(children(dim)):
            f = grid_index(2 * at + ti.Vector(near), shape, fine, dim)
            if f >= 0:
                for s in range(stencil.shape[1]):
                    a = w * stencil[offset[fine] + f, s]
                    if a != 0.0:
                        # Where the column stands, relative to the coarse node, on the fine grid.
                        column = ti.Vector.zero(ti.i32, dim)
                        rest = s
                        for k in ti.static(range(dim - 1, -1, -1)):
                            column[k] = near[k] + rest % (2 * REACH + 1) - REACH
                            rest = rest // (2 * REACH + 1)
                        for parent in ti.static(corners(dim)):
                            share = a
                            place = 0
                            for k in ti.static(range(dim)):
                                odd = column[k] & 1
                                # An even column has one parent, an odd one two halves.
                                share *= ti.select(odd == 1, 0.5, 1.0 - parent[k])
                                place = place * (2 * REACH + 1) + (column[k] - odd) // 2 + odd * parent[k] + REACH
                            if share != 0.0:
                                stencil[target, place] += share
