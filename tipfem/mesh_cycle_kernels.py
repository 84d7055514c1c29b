"""Kernels of the multigrid cycle on the mesh: smoothing there, and transfers to and from the finest grid.

Grids are laid out as in `tipfem.background_grid`. ``relax`` is the damped inverse diagonal of an operator.
"""

import taichi as ti

from tipfem.background_grid import (
    PLACES,
    SHAPE,
    SIZE,
    START,
    STENCIL,
    cell_at,
    corners,
    entry,
    line_start,
    lines,
    weight,
)
from tipfem.device import part_of

OMEGA = 0.8  # damping of Jacobi's method


@ti.func
def _row_product(row_offsets: ti.template(), columns: ti.template(), values: ti.template(), x: ti.template(), i):
    total = 0.0
    for s in range(row_offsets[i], row_offsets[i + 1]):
        total += values[s] * x[columns[s]]
    return total


@ti.kernel
def damped_inverse_diagonals(
    row_offsets: ti.types.ndarray(), columns: ti.types.ndarray(), values: ti.types.ndarray(),
    relax: ti.types.ndarray(), stencil: ti.types.ndarray(), grid_relax: ti.types.ndarray(), grid: ti.types.ndarray(),
    nodes: ti.i32, levels: ti.i32, dim: ti.template(), alone: ti.template(),
):  # fmt: skip
    """relax (N,) = OMEGA / a_ii of a matrix in CSR, and the same for all grids; 0 where there is no equation."""
    ti.loop_config(serialize=alone)
    for i in range(nodes):
        relax[i] = 0.0
        for s in range(row_offsets[i], row_offsets[i + 1]):
            if columns[s] == i and values[s] > 0.0:
                relax[i] = OMEGA / values[s]
    ti.loop_config(serialize=alone)
    for t in range(grid[0, START], grid[levels - 1, START] + grid[levels - 1, SIZE]):
        level = 0
        while t >= grid[level, START] + grid[level, SIZE]:
            level += 1
        middle = ti.static(PLACES**dim // 2)
        diagonal = stencil[grid[level, STENCIL] + middle * grid[level, SIZE] + t - grid[level, START]]
        grid_relax[t] = ti.select(diagonal > 0.0, OMEGA / diagonal, 0.0)


@ti.kernel
def down_mesh(
    b: ti.types.ndarray(), x: ti.types.ndarray(), residual: ti.types.ndarray(), relax: ti.types.ndarray(),
    row_offsets: ti.types.ndarray(), columns: ti.types.ndarray(), values: ti.types.ndarray(),
    fraction: ti.types.ndarray(), order: ti.types.ndarray(), start: ti.types.ndarray(),
    grid_b: ti.types.ndarray(), grid: ti.types.ndarray(), nodes: ti.i32, parts: ti.i32, spread: ti.template(),
    alone: ti.template(), dim: ti.template(),
):  # fmt: skip
    """One sweep from zero on the mesh, and what is left restricted to the finest grid."""
    ti.loop_config(serialize=alone)
    for i in range(nodes):
        x[i] = relax[i] * b[i]
        total = b[i]
        for s in range(row_offsets[i], row_offsets[i + 1]):
            j = columns[s]
            total -= values[s] * relax[j] * b[j]
        residual[i] = total
    ti.loop_config(serialize=alone)
    for t in range(parts * spread):
        first, last = part_of(t, parts, spread, lines(grid, 0))
        for line in range(first, last):
            to = grid[0, START] + line_start(grid, 0, line, dim)
            for j in range(grid[0, SHAPE + 2]):
                total = 0.0
                for corner in ti.static(corners(dim)):
                    c = cell_at(grid, line, j, corner, dim)
                    if c >= 0:
                        for m in range(start[c], start[c + 1]):
                            total += weight(fraction, order[m], corner, dim) * residual[order[m]]
                grid_b[to + j] = total


@ti.kernel
def up_mesh(
    b: ti.types.ndarray(), x: ti.types.ndarray(), corrected: ti.types.ndarray(), relax: ti.types.ndarray(),
    row_offsets: ti.types.ndarray(), columns: ti.types.ndarray(), values: ti.types.ndarray(),
    cell: ti.types.ndarray(), fraction: ti.types.ndarray(), grid_x: ti.types.ndarray(),
    grid: ti.types.ndarray(), nodes: ti.i32, dim: ti.template(), alone: ti.template(),
):  # fmt: skip
    """The finest grid's correction interpolated to the nodes, and one sweep on the mesh; 0 where is no equation."""
    ti.loop_config(serialize=alone)
    for i in range(nodes):
        at = ti.Vector([cell[i, k] for k in ti.static(range(dim))])
        total = x[i]
        for corner in ti.static(corners(dim)):
            near = grid[0, START] + entry(grid, 0, at + ti.Vector(corner), dim)
            total += weight(fraction, i, corner, dim) * grid_x[near]
        corrected[i] = total
    ti.loop_config(serialize=alone)
    for i in range(nodes):
        rest = b[i] - _row_product(row_offsets, columns, values, corrected, i)
        x[i] = ti.select(relax[i] > 0.0, corrected[i] + relax[i] * rest, 0.0)
