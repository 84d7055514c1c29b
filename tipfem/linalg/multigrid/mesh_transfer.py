"""Kernels of the multigrid cycle on the mesh: smoothing there, and transfers to and from the finest grid.

Grids are laid out as in `grid_hierarchy`. ``relax`` is the damped inverse diagonal of an operator. What is done
for a node or a line stands in functions: `tipfem.step.fused_iteration` makes one kernel for a team of threads of them,
`down_mesh` and `up_mesh` are for devices whose threads cannot wait for each other.
"""

import taichi as ti

from tipfem.backend.launch import kernel, part_of
from tipfem.linalg.multigrid.grid_hierarchy import (
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

OMEGA = 0.8  # damping of Jacobi's method


@ti.func
def rest_of_row(
    row_offsets: ti.template(), columns: ti.template(), values: ti.template(), b: ti.template(), x: ti.template(), i
):
    """b - A x in row ``i`` of a matrix in CSR."""
    rest = b[i]
    for s in range(row_offsets[i], row_offsets[i + 1]):
        rest -= values[s] * x[columns[s]]
    return rest


@ti.func
def restrict_to_line(
    residual: ti.template(),
    fraction: ti.template(),
    order: ti.template(),
    start: ti.template(),
    grid_b: ti.template(),
    grid: ti.template(),
    line,
    dim: ti.template(),
):
    """A line of the finest grid's right side: what is left at the nodes in the cells around, weighted."""
    to = grid[0, START] + line_start(grid, 0, line, dim)
    for j in range(grid[0, SHAPE + 2]):
        total = 0.0
        for corner in ti.static(corners(dim)):
            c = cell_at(grid, line, j, corner, dim)
            if c >= 0:
                for m in range(start[c], start[c + 1]):
                    total += weight(fraction, order[m], corner, dim) * residual[order[m]]
        grid_b[to + j] = total


@ti.func
def interpolated(
    cell: ti.template(), fraction: ti.template(), grid_x: ti.template(), grid: ti.template(), i, dim: ti.template()
):
    """The finest grid's values at node ``i``."""
    at = ti.Vector([cell[i, k] for k in ti.static(range(dim))])
    total = 0.0
    for corner in ti.static(corners(dim)):
        near = grid[0, START] + entry(grid, 0, at + ti.Vector(corner), dim)
        total += weight(fraction, i, corner, dim) * grid_x[near]
    return total


@kernel
def damped_inverse_diagonals(
    row_offsets: ti.types.ndarray(),
    columns: ti.types.ndarray(),
    values: ti.types.ndarray(),
    relax: ti.types.ndarray(),
    stencil: ti.types.ndarray(),
    grid_relax: ti.types.ndarray(),
    grid: ti.types.ndarray(),
    nodes: ti.i32,
    levels: ti.i32,
    dim: ti.template(),
    serial: ti.template(),
):
    """relax (N,) = OMEGA / a_ii of a matrix in CSR, and the same for all grids; 0 where there is no equation."""
    ti.loop_config(serialize=serial)
    for i in range(nodes):
        relax[i] = 0.0
        for s in range(row_offsets[i], row_offsets[i + 1]):
            if columns[s] == i and values[s] > 0.0:
                relax[i] = OMEGA / values[s]
    ti.loop_config(serialize=serial)
    for t in range(grid[0, START], grid[levels - 1, START] + grid[levels - 1, SIZE]):
        level = 0
        while t >= grid[level, START] + grid[level, SIZE]:
            level += 1
        middle = ti.static(PLACES**dim // 2)
        diagonal = stencil[grid[level, STENCIL] + middle * grid[level, SIZE] + t - grid[level, START]]
        grid_relax[t] = ti.select(diagonal > 0.0, OMEGA / diagonal, 0.0)


@kernel
def down_mesh(
    b: ti.types.ndarray(),
    x: ti.types.ndarray(),
    residual: ti.types.ndarray(),
    relax: ti.types.ndarray(),
    row_offsets: ti.types.ndarray(),
    columns: ti.types.ndarray(),
    values: ti.types.ndarray(),
    fraction: ti.types.ndarray(),
    order: ti.types.ndarray(),
    start: ti.types.ndarray(),
    grid_b: ti.types.ndarray(),
    grid: ti.types.ndarray(),
    nodes: ti.i32,
    dim: ti.template(),
    parts: ti.i32,
    stride: ti.template(),
):
    """One sweep from zero on the mesh, and what is left restricted to the finest grid."""
    for i in range(nodes):
        x[i] = relax[i] * b[i]
    for i in range(nodes):
        residual[i] = rest_of_row(row_offsets, columns, values, b, x, i)
    for t in range(parts * stride):
        first, last = part_of(t, parts, stride, lines(grid, 0))
        for line in range(first, last):
            restrict_to_line(residual, fraction, order, start, grid_b, grid, line, dim)


@kernel
def up_mesh(
    b: ti.types.ndarray(),
    x: ti.types.ndarray(),
    corrected: ti.types.ndarray(),
    relax: ti.types.ndarray(),
    row_offsets: ti.types.ndarray(),
    columns: ti.types.ndarray(),
    values: ti.types.ndarray(),
    cell: ti.types.ndarray(),
    fraction: ti.types.ndarray(),
    grid_x: ti.types.ndarray(),
    grid: ti.types.ndarray(),
    nodes: ti.i32,
    dim: ti.template(),
):
    """The finest grid's correction interpolated to the nodes, and one sweep on the mesh; 0 where is no equation."""
    for i in range(nodes):
        corrected[i] = x[i] + interpolated(cell, fraction, grid_x, grid, i, dim)
    for i in range(nodes):
        rest = rest_of_row(row_offsets, columns, values, b, corrected, i)
        x[i] = ti.select(relax[i] > 0.0, corrected[i] + relax[i] * rest, 0.0)
