"""Kernels of the background-grid multigrid: Galerkin products, transfers and smoothing.

Levels lie one behind the other in flat arrays; ``offset[level]`` is a level's first row and
``shape[level, k]`` its number of grid nodes along axis k. A row of ``stencil`` holds the operator's
entries to all grid nodes within `REACH`. Sums are gathered, never scattered with atomics.
"""

import itertools

import taichi as ti

REACH = 2  # a mesh edge joins nodes of neighbouring cells, whose corners are two grid nodes apart
OMEGA = 0.8  # damping of Jacobi's method


def _corners(dim: int) -> list[tuple[int, ...]]:
    return list(itertools.product((0, 1), repeat=dim))


def _children(dim: int) -> list[tuple[tuple[int, ...], float]]:
    """Fine nodes that a coarse one interpolates to: their shift on the fine grid, and the weight."""
    shifts = itertools.product((-1, 0, 1), repeat=dim)
    return [(shift, 0.5 ** sum(abs(k) for k in shift)) for shift in shifts]


@ti.func
def _grid_index(i, shape: ti.template(), level, dim: ti.template()):
    """Row-major number of grid node ``i`` (dim,) on its level; -1 outside."""
    number = 0
    inside = True
    for k in ti.static(range(dim)):
        inside = inside and i[k] >= 0 and i[k] < shape[level, k]
        number = number * shape[level, k] + i[k]
    return ti.select(inside, number, -1)


@ti.func
def _grid_node(number, shape: ti.template(), level, dim: ti.template()):
    """Indices (dim,) of a grid node from its row-major number."""
    i = ti.Vector.zero(ti.i32, dim)
    rest = number
    for k in ti.static(range(dim - 1, -1, -1)):
        i[k] = rest % shape[level, k]
        rest = rest // shape[level, k]
    return i


@ti.func
def _size(shape: ti.template(), level, dim: ti.template()):
    n = 1
    for k in ti.static(range(dim)):
        n *= shape[level, k]
    return n


@ti.func
def _weight(fraction: ti.template(), i, corner: ti.template(), dim: ti.template()):
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
    for g in range(_size(shape, 0, dim)):
        for s in range(stencil.shape[1]):
            stencil[g, s] = 0.0
        at = _grid_node(g, shape, 0, dim)
        for corner in ti.static(_corners(dim)):
            # The cell in which g is this corner.
            i_cell = at - ti.Vector(corner)
            c = _grid_index(i_cell, shape, 0, dim)
            if c >= 0:
                for m in range(start[c], start[c + 1]):
                    i = order[m]
                    w_i = _weight(fraction, i, corner, dim)
                    for s in range(row_offsets[i], row_offsets[i + 1]):
                        j = columns[s]
                        a = w_i * values[s]
                        shift = ti.Vector([cell[j, k] for k in ti.static(range(dim))]) - i_cell
                        if shift.max() > 1 or shift.min() < -1:
                            shift, j = 0 * shift, i
                        for other in ti.static(_corners(dim)):
                            place = 0
                            for k in ti.static(range(dim)):
                                place = place * (2 * REACH + 1) + shift[k] + other[k] - corner[k] + REACH
                            stencil[g, place] += a * _weight(fraction, j, other, dim)


@ti.kernel
def coarsen(
    stencil: ti.types.ndarray(), shape: ti.types.ndarray(), offset: ti.types.ndarray(),
    fine: ti.i32, dim: ti.template(),
):  # fmt: skip
    """Galerkin product from level ``fine`` to the next, with multilinear interpolation."""
    for g in range(_size(shape, fine + 1, dim)):
        target = offset[fine + 1] + g
        for s in range(stencil.shape[1]):
            stencil[target, s] = 0.0
        at = _grid_node(g, shape, fine + 1, dim)
        for near, w in ti.static(_children(dim)):
            f = _grid_index(2 * at + ti.Vector(near), shape, fine, dim)
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
                        for parent in ti.static(_corners(dim)):
                            share = a
                            place = 0
                            for k in ti.static(range(dim)):
                                odd = column[k] & 1
                                # An even column has one parent, an odd one two halves.
                                share *= ti.select(odd == 1, 0.5, 1.0 - parent[k])
                                place = place * (2 * REACH + 1) + (column[k] - odd) // 2 + odd * parent[k] + REACH
                            if share != 0.0:
                                stencil[target, place] += share


@ti.func
def _stencil_product(
    stencil: ti.template(), x: ti.template(), g, shape: ti.template(), start, level, dim: ti.template()
):  # fmt: skip
    """Row ``g`` of a level's operator times x, from the level's first row ``start``."""
    at = _grid_node(g, shape, level, dim)
    total = 0.0
    if ti.static(dim == 2):
        first = ti.max(at[1] - REACH, 0)
        last = ti.min(at[1] + REACH, shape[level, 1] - 1) + 1
        for i in range(ti.max(at[0] - REACH, 0), ti.min(at[0] + REACH, shape[level, 0] - 1) + 1):
            line = start + i * shape[level, 1]
            place = (i - at[0] + REACH) * (2 * REACH + 1) + REACH - at[1]
            for j in range(first, last):
                total += stencil[start + g, place + j] * x[line + j]
    else:
        for place in range((2 * REACH + 1) ** 3):
            shift = ti.Vector([place // 25, place // 5 % 5, place % 5]) - REACH
            j = _grid_index(at + shift, shape, level, dim)
            if j >= 0:
                total += stencil[start + g, place] * x[start + j]
    return total


@ti.func
def _row_product(row_offsets: ti.template(), columns: ti.template(), values: ti.template(), x: ti.template(), i):
    total = 0.0
    for s in range(row_offsets[i], row_offsets[i + 1]):
        total += values[s] * x[columns[s]]
    return total


@ti.func
def _diagonal(row_offsets: ti.template(), columns: ti.template(), values: ti.template(), i):
    result = 0.0
    for s in range(row_offsets[i], row_offsets[i + 1]):
        if columns[s] == i:
            result = values[s]
    return result


@ti.func
def _jacobi(residual, diagonal):
    """Damped correction; zero where a grid node has no equation."""
    return ti.select(diagonal > 0.0, OMEGA * residual / diagonal, 0.0)


@ti.kernel
def down_mesh(
    b: ti.types.ndarray(), x: ti.types.ndarray(), residual: ti.types.ndarray(),
    row_offsets: ti.types.ndarray(), columns: ti.types.ndarray(), values: ti.types.ndarray(),
    fraction: ti.types.ndarray(), order: ti.types.ndarray(), start: ti.types.ndarray(),
    grid_b: ti.types.ndarray(), shape: ti.types.ndarray(), nodes: ti.i32, dim: ti.template(),
):  # fmt: skip
    """One sweep from zero on the mesh, and what is left restricted to the finest grid."""
    for i in range(nodes):
        x[i] = _jacobi(b[i], _diagonal(row_offsets, columns, values, i))
    for i in range(nodes):
        residual[i] = b[i] - _row_product(row_offsets, columns, values, x, i)
    for g in range(_size(shape, 0, dim)):
        at = _grid_node(g, shape, 0, dim)
        total = 0.0
        for corner in ti.static(_corners(dim)):
            c = _grid_index(at - ti.Vector(corner), shape, 0, dim)
            if c >= 0:
                for m in range(start[c], start[c + 1]):
                    total += _weight(fraction, order[m], corner, dim) * residual[order[m]]
        grid_b[g] = total


@ti.kernel
def down_grid(
    stencil: ti.types.ndarray(), x: ti.types.ndarray(), b: ti.types.ndarray(), r: ti.types.ndarray(),
    shape: ti.types.ndarray(), offset: ti.types.ndarray(), level: ti.i32, dim: ti.template(),
):  # fmt: skip
    """One sweep from zero on a grid, and what is left restricted to the next coarser one."""
    center = ti.static(((2 * REACH + 1) ** dim) // 2)
    for g in range(_size(shape, level, dim)):
        row = offset[level] + g
        x[row] = _jacobi(b[row], stencil[row, center])
    for g in range(_size(shape, level, dim)):
        row = offset[level] + g
        r[row] = b[row] - _stencil_product(stencil, x, g, shape, offset[level], level, dim)
    for g in range(_size(shape, level + 1, dim)):
        at = _grid_node(g, shape, level + 1, dim)
        total = 0.0
        for near, w in ti.static(_children(dim)):
            f = _grid_index(2 * at + ti.Vector(near), shape, level, dim)
            if f >= 0:
                total += w * r[offset[level] + f]
        b[offset[level + 1] + g] = total


@ti.kernel
def solve_coarsest(
    stencil: ti.types.ndarray(), x: ti.types.ndarray(), b: ti.types.ndarray(),
    shape: ti.types.ndarray(), offset: ti.types.ndarray(), level: ti.i32, sweeps: ti.i32, dim: ti.template(),
):  # fmt: skip
    """Symmetric Gauss-Seidel sweeps on a handful of grid nodes."""
    center = ti.static(((2 * REACH + 1) ** dim) // 2)
    ti.loop_config(serialize=True)
    for _ in range(1):
        start, n = offset[level], _size(shape, level, dim)
        for g in range(n):
            x[start + g] = 0.0
        for step in range(sweeps * n):
            g = step % n
            if (step // n) % 2 == 1:
                g = n - 1 - g
            d = stencil[start + g, center]
            if d > 0.0:
                x[start + g] += (b[start + g] - _stencil_product(stencil, x, g, shape, start, level, dim)) / d


@ti.kernel
def up_grid(
    stencil: ti.types.ndarray(), x: ti.types.ndarray(), b: ti.types.ndarray(), r: ti.types.ndarray(),
    shape: ti.types.ndarray(), offset: ti.types.ndarray(), level: ti.i32, dim: ti.template(),
):  # fmt: skip
    """The coarser grid's correction added on ``level``, and one sweep."""
    center = ti.static(((2 * REACH + 1) ** dim) // 2)
    for f in range(_size(shape, level, dim)):
        at = _grid_node(f, shape, level, dim)
        total = 0.0
        for parent in ti.static(_corners(dim)):
            w = 1.0
            i = ti.Vector.zero(ti.i32, dim)
            for k in ti.static(range(dim)):
                odd = at[k] & 1
                i[k] = at[k] // 2 + odd * parent[k]
                w *= ti.select(odd == 1, 0.5, 1.0 - parent[k])
            if w > 0.0:
                total += w * x[offset[level + 1] + _grid_index(i, shape, level + 1, dim)]
        x[offset[level] + f] += total
    for g in range(_size(shape, level, dim)):
        row = offset[level] + g
        r[row] = b[row] - _stencil_product(stencil, x, g, shape, offset[level], level, dim)
    for g in range(_size(shape, level, dim)):
        row = offset[level] + g
        x[row] += _jacobi(r[row], stencil[row, center])


@ti.kernel
def up_mesh(
    b: ti.types.ndarray(), x: ti.types.ndarray(), residual: ti.types.ndarray(),
    row_offsets: ti.types.ndarray(), columns: ti.types.ndarray(), values: ti.types.ndarray(),
    cell: ti.types.ndarray(), fraction: ti.types.ndarray(), grid_x: ti.types.ndarray(),
    shape: ti.types.ndarray(), nodes: ti.i32, dim: ti.template(),
):  # fmt: skip
    """The finest grid's correction interpolated to the nodes, and one sweep on the mesh."""
    for i in range(nodes):
        at = ti.Vector([cell[i, k] for k in ti.static(range(dim))])
        for corner in ti.static(_corners(dim)):
            x[i] += _weight(fraction, i, corner, dim) * grid_x[_grid_index(at + ti.Vector(corner), shape, 0, dim)]
    for i in range(nodes):
        residual[i] = b[i] - _row_product(row_offsets, columns, values, x, i)
    for i in range(nodes):
        x[i] += _jacobi(residual[i], _diagonal(row_offsets, columns, values, i))
