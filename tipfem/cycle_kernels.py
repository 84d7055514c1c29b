"""Kernels of the multigrid cycle on the mesh and on the background grid: transfers and smoothing.

Arrays are laid out as in `tipfem.background_grid`. ``relax`` (N,) is the damped inverse diagonal of the
mesh's operator.
"""

import taichi as ti

from tipfem.background_grid import REACH, children, corners, grid_index, grid_node, level_size, weight

OMEGA = 0.8  # damping of Jacobi's method


@ti.func
def _stencil_product(
    stencil: ti.template(), x: ti.template(), g, shape: ti.template(), start, level, dim: ti.template()
):  # fmt: skip
    """Row ``g`` of a level's operator times x, from the level's first row ``start``."""
    at = grid_node(g, shape, level, dim)
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
            j = grid_index(at + shift, shape, level, dim)
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
def _jacobi(residual, diagonal):
    """Damped correction; zero where a grid node has no equation."""
    return ti.select(diagonal > 0.0, OMEGA * residual / diagonal, 0.0)


@ti.func
def _defect(stencil: ti.template(), x: ti.template(), b: ti.template(), g, shape: ti.template(), start, level,
            dim: ti.template()):  # fmt: skip
    """b - A x at a grid node."""
    return b[start + g] - _stencil_product(stencil, x, g, shape, start, level, dim)


@ti.func
def _restricted(r: ti.template(), g, shape: ti.template(), start, level, dim: ti.template()):
    """Entry ``g`` of P^T r on the level below ``level``, whose first row is ``start``."""
    at = grid_node(g, shape, level + 1, dim)
    total = 0.0
    for near, w in ti.static(children(dim)):
        f = grid_index(2 * at + ti.Vector(near), shape, level, dim)
        if f >= 0:
            total += w * r[start + f]
    return total


@ti.func
def _prolonged(x: ti.template(), f, shape: ti.template(), start, level, dim: ti.template()):
    """Entry ``f`` of P x on ``level``; ``start`` is the first row of the level below it."""
    at = grid_node(f, shape, level, dim)
    total = 0.0
    for parent in ti.static(corners(dim)):
        w = 1.0
        i = ti.Vector.zero(ti.i32, dim)
        for k in ti.static(range(dim)):
            odd = at[k] & 1
            i[k] = at[k] // 2 + odd * parent[k]
            w *= ti.select(odd == 1, 0.5, 1.0 - parent[k])
        if w > 0.0:
            total += w * x[start + grid_index(i, shape, level + 1, dim)]
    return total


@ti.kernel
def damped_inverse_diagonal(
    row_offsets: ti.types.ndarray(), columns: ti.types.ndarray(), values: ti.types.ndarray(),
    relax: ti.types.ndarray(), nodes: ti.i32,
):  # fmt: skip
    """relax (N,) = OMEGA / a_ii of a matrix in CSR; zero where a row is empty."""
    for i in range(nodes):
        relax[i] = 0.0
        for s in range(row_offsets[i], row_offsets[i + 1]):
            if columns[s] == i and values[s] > 0.0:
                relax[i] = OMEGA / values[s]


@ti.kernel
def down_mesh(
    b: ti.types.ndarray(), x: ti.types.ndarray(), residual: ti.types.ndarray(), relax: ti.types.ndarray(),
    row_offsets: ti.types.ndarray(), columns: ti.types.ndarray(), values: ti.types.ndarray(),
    fraction: ti.types.ndarray(), order: ti.types.ndarray(), start: ti.types.ndarray(),
    grid_b: ti.types.ndarray(), shape: ti.types.ndarray(), nodes: ti.i32, dim: ti.template(),
):  # fmt: skip
    """One sweep from zero on the mesh, and what is left restricted to the finest grid."""
    for i in range(nodes):
        x[i] = relax[i] * b[i]
    for i in range(nodes):
        residual[i] = b[i] - _row_product(row_offsets, columns, values, x, i)
    for g in range(level_size(shape, 0, dim)):
        at = grid_node(g, shape, 0, dim)
        total = 0.0
        for corner in ti.static(corners(dim)):
            c = grid_index(at - ti.Vector(corner), shape, 0, dim)
            if c >= 0:
                for m in range(start[c], start[c + 1]):
                    total += weight(fraction, order[m], corner, dim) * residual[order[m]]
        grid_b[g] = total


@ti.kernel
def down_grid(
    stencil: ti.types.ndarray(), x: ti.types.ndarray(), b: ti.types.ndarray(), r: ti.types.ndarray(),
    shape: ti.types.ndarray(), offset: ti.types.ndarray(), level: ti.i32, dim: ti.template(),
):  # fmt: skip
    """One sweep from zero on a grid, and what is left restricted to the next coarser one."""
    center = ti.static(((2 * REACH + 1) ** dim) // 2)
    for g in range(level_size(shape, level, dim)):
        row = offset[level] + g
        x[row] = _jacobi(b[row], stencil[row, center])
    for g in range(level_size(shape, level, dim)):
        r[offset[level] + g] = _defect(stencil, x, b, g, shape, offset[level], level, dim)
    for g in range(level_size(shape, level + 1, dim)):
        b[offset[level + 1] + g] = _restricted(r, g, shape, offset[level], level, dim)


@ti.kernel
def coarse_cycle(
    stencil: ti.types.ndarray(), x: ti.types.ndarray(), b: ti.types.ndarray(), r: ti.types.ndarray(),
    shape: ti.types.ndarray(), offset: ti.types.ndarray(),
    first: ti.i32, levels: ti.i32, sweeps: ti.i32, dim: ti.template(),
):  # fmt: skip
    """The cycle from level ``first`` down, in one thread: on small grids launches cost more than work.

    The coarsest level is solved by symmetric Gauss-Seidel sweeps.
    """
    center = ti.static(((2 * REACH + 1) ** dim) // 2)
    ti.loop_config(serialize=True)
    for _ in range(1):
        for level in range(first, levels - 1):
            start = offset[level]
            for g in range(level_size(shape, level, dim)):
                x[start + g] = _jacobi(b[start + g], stencil[start + g, center])
            for g in range(level_size(shape, level, dim)):
                r[start + g] = _defect(stencil, x, b, g, shape, start, level, dim)
            for g in range(level_size(shape, level + 1, dim)):
                b[offset[level + 1] + g] = _restricted(r, g, shape, start, level, dim)
        last = levels - 1
        n = level_size(shape, last, dim)
        for g in range(n):
            x[offset[last] + g] = 0.0
        for step in range(sweeps * n):
            g = step % n
            if (step // n) % 2 == 1:
                g = n - 1 - g
            d = stencil[offset[last] + g, center]
            if d > 0.0:
                x[offset[last] + g] += _defect(stencil, x, b, g, shape, offset[last], last, dim) / d
        for up in range(levels - 1 - first):
            level = levels - 2 - up
            start = offset[level]
            for f in range(level_size(shape, level, dim)):
                x[start + f] += _prolonged(x, f, shape, offset[level + 1], level, dim)
            for g in range(level_size(shape, level, dim)):
                r[start + g] = _defect(stencil, x, b, g, shape, start, level, dim)
            for g in range(level_size(shape, level, dim)):
                x[start + g] += _jacobi(r[start + g], stencil[start + g, center])


@ti.kernel
def up_grid(
    stencil: ti.types.ndarray(), x: ti.types.ndarray(), b: ti.types.ndarray(), r: ti.types.ndarray(),
    shape: ti.types.ndarray(), offset: ti.types.ndarray(), level: ti.i32, dim: ti.template(),
):  # fmt: skip
    """The coarser grid's correction added on ``level``, and one sweep."""
    center = ti.static(((2 * REACH + 1) ** dim) // 2)
    for f in range(level_size(shape, level, dim)):
        x[offset[level] + f] += _prolonged(x, f, shape, offset[level + 1], level, dim)
    for g in range(level_size(shape, level, dim)):
        r[offset[level] + g] = _defect(stencil, x, b, g, shape, offset[level], level, dim)
    for g in range(level_size(shape, level, dim)):
        row = offset[level] + g
        x[row] += _jacobi(r[row], stencil[row, center])


@ti.kernel
def up_mesh(
    b: ti.types.ndarray(), x: ti.types.ndarray(), residual: ti.types.ndarray(), relax: ti.types.ndarray(),
    row_offsets: ti.types.ndarray(), columns: ti.types.ndarray(), values: ti.types.ndarray(),
    cell: ti.types.ndarray(), fraction: ti.types.ndarray(), grid_x: ti.types.ndarray(),
    shape: ti.types.ndarray(), nodes: ti.i32, dim: ti.template(),
):  # fmt: skip
    """The finest grid's correction interpolated to the nodes, and one sweep on the mesh."""
    for i in range(nodes):
        at = ti.Vector([cell[i, k] for k in ti.static(range(dim))])
        for corner in ti.static(corners(dim)):
            x[i] += weight(fraction, i, corner, dim) * grid_x[grid_index(at + ti.Vector(corner), shape, 0, dim)]
    for i in range(nodes):
        residual[i] = b[i] - _row_product(row_offsets, columns, values, x, i)
    for i in range(nodes):
        x[i] += relax[i] * residual[i]
