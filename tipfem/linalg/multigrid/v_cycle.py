"""Kernels of the multigrid cycle on the background grid: transfers and smoothing.

Grids are laid out as in `grid_hierarchy`. ``relax`` is the damped inverse diagonal of an operator. Where no
other thread writes, ``a[i] = a[i] + b`` stands for ``a[i] += b``, which would be an atomic operation. As in
`mesh_transfer`, functions do a line, kernels are for devices whose threads cannot wait for each other.
"""

import taichi as ti

from tipfem.backend.launch import kernel, part_of
from tipfem.linalg.multigrid.grid_hierarchy import (
    NEXT,
    PLACES,
    REACH,
    SHAPE,
    SIZE,
    START,
    STENCIL,
    axis_stride,
    fine_start,
    line_at,
    line_start,
    lines,
    row_shift,
)
from tipfem.linalg.multigrid.mesh_transfer import OMEGA

LANES = 64  # grid nodes that `subtract_product` does at a time


@ti.func
def subtract_product(
    stencil: ti.template(),
    x: ti.template(),
    b: ti.template(),
    r: ti.template(),
    grid: ti.template(),
    level,
    line,
    dim: ti.template(),
):
    """r = b - A x along a line of a level."""
    size, n = grid[level, SIZE], grid[level, SHAPE + 2]
    inside = line_start(grid, level, line, dim)
    # Block by block in memory of our own: what writes to arrays is not turned into vector instructions. All places in
    # one loop: unrolled, they take a third of the time less, but half a second to be made at every start.
    for block in range((n + LANES - 1) // LANES):
        entry = inside + block * LANES
        width = ti.min(LANES, n - block * LANES)
        at = grid[level, START] + entry
        total = ti.Vector.zero(float, LANES)
        for place in range(ti.static(PLACES**dim)):
            entries = grid[level, STENCIL] + place * size + entry
            near = at + row_shift(grid, level, place // PLACES, dim) + place % PLACES - REACH
            for j in range(width):
                total[j] = total[j] + stencil[entries + j] * x[near + j]
        for j in range(width):
            r[at + j] = b[at + j] - total[j]


@ti.func
def restrict(
    r: ti.template(),
    b: ti.template(),
    weights: ti.template(),
    grid: ti.template(),
    fine,
    coarse,
    line,
    axis: ti.template(),
    dim: ti.template(),
):
    """A line of b = P^T r on the grid that is coarser along an axis."""
    to = grid[coarse, START] + line_start(grid, coarse, line, dim)
    at = grid[fine, START] + fine_start(grid, fine, coarse, line, axis, dim)
    step = ti.static(2 if axis == dim - 1 else 1)
    stride = axis_stride(grid, fine, axis, dim)
    for j in range(grid[coarse, SHAPE + 2]):
        f = at + step * j
        lower, upper = f - stride, f + stride
        b[to + j] = r[f] + (1.0 - weights[lower]) * r[lower] + weights[upper] * r[upper]


@ti.func
def prolong(
    x: ti.template(),
    weights: ti.template(),
    grid: ti.template(),
    fine,
    coarse,
    line,
    axis: ti.template(),
    dim: ti.template(),
):
    """A line of x on the fine grid: P x of the coarse one, added to what is there on a level."""
    inside = line_start(grid, fine, line, dim)
    to, n = grid[fine, START] + inside, grid[fine, SHAPE + 2]
    across = grid[fine, SHAPE + 1]
    one, two = line // across, line % across
    keep = ti.static(1.0 if axis == dim - 1 else 0.0)  # the last axis leads to a level
    if ti.static(axis == dim - 1):
        at = grid[coarse, START] + line_at(grid, coarse, one, two, dim)
        for j in range((n + 1) // 2):
            x[to + 2 * j] = keep * x[to + 2 * j] + x[at + j]
        for j in range(n // 2):
            f = to + 2 * j + 1
            x[f] = keep * x[f] + weights[f] * x[at + j] + (1.0 - weights[f]) * x[at + j + 1]
    else:
        odd = two % 2
        if ti.static(axis == dim - 2):
            two = two // 2
        if ti.static(axis == dim - 3):
            odd = one % 2
            one = one // 2
        at = grid[coarse, START] + line_at(grid, coarse, one, two, dim)
        beyond = at + axis_stride(grid, coarse, axis, dim)
        if odd == 1:
            for j in range(n):
                x[to + j] = weights[to + j] * x[at + j] + (1.0 - weights[to + j]) * x[beyond + j]
        else:
            for j in range(n):
                x[to + j] = x[at + j]


@ti.func
def relax_line(
    relax: ti.template(),
    right: ti.template(),
    x: ti.template(),
    grid: ti.template(),
    level,
    line,
    keep: ti.template(),
    dim: ti.template(),
):
    """A line of x = relax right, added to what is there if ``keep``."""
    at = grid[level, START] + line_start(grid, level, line, dim)
    for j in range(at, at + grid[level, SHAPE + 2]):
        x[j] = (x[j] if ti.static(keep) else 0.0) + relax[j] * right[j]


@ti.func
def solve_coarsest(
    stencil: ti.template(),
    relax: ti.template(),
    x: ti.template(),
    b: ti.template(),
    grid: ti.template(),
    last,
    sweeps,
    dim: ti.template(),
):
    """The coarsest level, number ``last``, by symmetric Gauss-Seidel sweeps."""
    at, size = grid[last, START], grid[last, SIZE]
    for t in range(at, at + size):
        x[t] = 0.0
    n, width = lines(grid, last), grid[last, SHAPE + 2]
    for step in range(sweeps * n * width):
        g = step % (n * width)
        if step // (n * width) % 2 == 1:
            g = n * width - 1 - g
        inside = line_start(grid, last, g // width, dim) + g % width
        total = b[at + inside]
        for row in range(ti.static(PLACES ** (dim - 1))):
            near = at + inside + row_shift(grid, last, row, dim) - REACH
            entries = grid[last, STENCIL] + row * PLACES * size + inside
            for k in ti.static(range(PLACES)):
                total -= stencil[entries + k * size] * x[near + k]
        x[at + inside] = x[at + inside] + relax[at + inside] / OMEGA * total


@kernel
def down_grid(
    stencil: ti.types.ndarray(),
    weights: ti.types.ndarray(),
    relax: ti.types.ndarray(),
    x: ti.types.ndarray(),
    b: ti.types.ndarray(),
    r: ti.types.ndarray(),
    grid: ti.types.ndarray(),
    level: ti.i32,
    dim: ti.template(),
    parts: ti.i32,
    stride: ti.template(),
):
    """One sweep from zero on a grid, and what is left restricted to the next coarser one."""
    for t in range(parts * stride):
        first, last = part_of(t, parts, stride, lines(grid, level))
        for line in range(first, last):
            relax_line(relax, b, x, grid, level, line, False, dim)
    for t in range(parts * stride):
        first, last = part_of(t, parts, stride, lines(grid, level))
        for line in range(first, last):
            subtract_product(stencil, x, b, r, grid, level, line, dim)
    one = grid[level, NEXT]
    for t in range(parts * stride):
        first, last = part_of(t, parts, stride, lines(grid, one))
        for line in range(first, last):
            restrict(r, b, weights, grid, level, one, line, ti.static(dim - 1), dim)
    two = grid[one, NEXT]
    for t in range(parts * stride):
        first, last = part_of(t, parts, stride, lines(grid, two))
        for line in range(first, last):
            restrict(b, b, weights, grid, one, two, line, ti.static(dim - 2), dim)
    if ti.static(dim == 3):
        for t in range(parts * stride):
            first, last = part_of(t, parts, stride, lines(grid, level + 1))
            for line in range(first, last):
                restrict(b, b, weights, grid, two, level + 1, line, 0, dim)


@kernel
def coarsest_grid(
    stencil: ti.types.ndarray(),
    relax: ti.types.ndarray(),
    x: ti.types.ndarray(),
    b: ti.types.ndarray(),
    grid: ti.types.ndarray(),
    levels: ti.i32,
    sweeps: ti.i32,
    dim: ti.template(),
):
    """The coarsest grid's equations solved, by one thread."""
    ti.loop_config(serialize=True)
    for _ in range(1):
        solve_coarsest(stencil, relax, x, b, grid, levels - 1, sweeps, dim)


@kernel
def up_grid(
    stencil: ti.types.ndarray(),
    weights: ti.types.ndarray(),
    relax: ti.types.ndarray(),
    x: ti.types.ndarray(),
    b: ti.types.ndarray(),
    r: ti.types.ndarray(),
    grid: ti.types.ndarray(),
    level: ti.i32,
    dim: ti.template(),
    parts: ti.i32,
    stride: ti.template(),
):
    """The coarser grid's correction added on ``level``, and one sweep."""
    one = grid[level, NEXT]
    two = grid[one, NEXT]
    if ti.static(dim == 3):
        for t in range(parts * stride):
            first, last = part_of(t, parts, stride, lines(grid, two))
            for line in range(first, last):
                prolong(x, weights, grid, two, level + 1, line, 0, dim)
    for t in range(parts * stride):
        first, last = part_of(t, parts, stride, lines(grid, one))
        for line in range(first, last):
            prolong(x, weights, grid, one, two, line, ti.static(dim - 2), dim)
    for t in range(parts * stride):
        first, last = part_of(t, parts, stride, lines(grid, level))
        for line in range(first, last):
            prolong(x, weights, grid, level, one, line, ti.static(dim - 1), dim)
    for t in range(parts * stride):
        first, last = part_of(t, parts, stride, lines(grid, level))
        for line in range(first, last):
            subtract_product(stencil, x, b, r, grid, level, line, dim)
    for t in range(parts * stride):
        first, last = part_of(t, parts, stride, lines(grid, level))
        for line in range(first, last):
            relax_line(relax, r, x, grid, level, line, True, dim)
