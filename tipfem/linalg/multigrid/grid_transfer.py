"""Device functions of the multigrid cycle on the background grids: smoothing, residual, transfers.

They take the nodes from ``first`` to ``last`` - 1 of a line: a processor's threads all of a line, a GPU's one node.
Grids are laid out as in `grid_hierarchy`. Where no other thread writes, ``a[i] = a[i] + b`` is used instead of
``a[i] += b``, which Taichi makes an atomic operation, many times slower.
"""

import taichi as ti

from tipfem.backend.array_types import Ints2, Reals1, Template
from tipfem.backend.launch import kernel
from tipfem.linalg.multigrid.grid_hierarchy import (
    DIAGONAL,
    LAST_PERIOD,
    LEVELS,
    NEXT,
    PERIOD,
    REACH,
    RESIDUAL,
    RHS,
    SHAPE,
    SIZE,
    SOLUTION,
    STENCIL_WIDTH,
    STRIDE,
    WEIGHTS,
    axis_stride,
    fine_start,
    length,
    line_at,
    line_shift,
    line_start,
    lines,
    node_count,
    pitch,
    row_shift,
    stencils_at,
    wrap_line,
)

LANES = 64  # grid nodes that `residual_line` processes together
COARSEST_SWEEPS = 20  # of Gauss-Seidel's method


@ti.func
def copy_to_image(levels: Template, grid: Template, level, first, last, dim: Template):
    """Copy the solution on a level's first line to its image beyond the last, where the mesh's nodes read it."""
    start = grid[level, SOLUTION] + line_start(grid, level, 0, dim)
    image = start + grid[level, PERIOD] * grid[level, STRIDE + 1]
    for j in range(first, last):
        levels[image + j] = levels[start + j]
    if first == 0 and grid[level, LAST_PERIOD] > 0:
        levels[image + grid[level, LAST_PERIOD]] = levels[start]


@ti.func
def smooth_line(
    levels: Template, grid: Template, level, line, first, last, rhs: Template, from_zero: Template, dim: Template
):
    """Part of a line of x += D r, damped Jacobi's, r in column ``rhs`` of ``grid``; x = 0 before if ``from_zero``."""
    inside = line_start(grid, level, line, dim)
    x, r, diagonal = grid[level, SOLUTION] + inside, grid[level, rhs] + inside, grid[level, DIAGONAL] + inside
    for j in range(first, last):
        levels[x + j] = (0.0 if ti.static(from_zero) else levels[x + j]) + levels[diagonal + j] * levels[r + j]
    wrap_line(levels, grid, level, x, first, last)
    if grid[level, PERIOD] > 0 and line == 0:
        copy_to_image(levels, grid, level, first, last, dim)


@ti.func
def equations(levels: Template, grid: Template, level, first, width, dim: Template):
    """The range of ``width`` nodes that have equations: where no fluid is, stencils, from entry ``first`` on, are 0."""
    middle = first + ti.static(STENCIL_WIDTH**dim // 2) * pitch(grid, level)
    low, high = 0, width
    while low < high and levels[middle + low] == 0.0:
        low += 1
    while low < high and levels[middle + high - 1] == 0.0:
        high -= 1
    return low, high


@ti.func
def residual_line(levels: Template, grid: Template, level, line, dim: Template):
    """A line of the residual r = b - A x."""
    n = grid[level, SHAPE + 2]
    inside, across = line_start(grid, level, line, dim), line % grid[level, SHAPE + 1]
    # Block by block in local memory: loops that write to arrays are not vectorised. The loop over the stencil is not
    # unrolled: that saves a third of the time, but costs half a second of compilation at every start.
    for block in range((n + LANES - 1) // LANES):
        entry = inside + block * LANES
        width = ti.min(LANES, n - block * LANES)
        x = grid[level, SOLUTION] + entry
        total = ti.Vector.zero(float, LANES)
        stencils = stencils_at(grid, level, inside, dim) + block * LANES
        low, high = equations(levels, grid, level, stencils, width, dim)
        for offset in range(ti.static(STENCIL_WIDTH**dim)):
            entries = stencils + offset * pitch(grid, level)
            shift = row_shift(grid, level, across, offset // STENCIL_WIDTH, dim, True)
            near = x + shift + offset % STENCIL_WIDTH - REACH
            for j in range(low, high):
                total[j] = total[j] + levels[entries + j] * levels[near + j]
        b, r = grid[level, RHS] + entry, grid[level, RESIDUAL] + entry
        for j in range(width):
            levels[r + j] = levels[b + j] - total[j]
    wrap_line(levels, grid, level, grid[level, RESIDUAL] + inside, 0, n)


@ti.func
def residual_node(levels: Template, grid: Template, level, line, j, dim: Template):
    """Node ``j`` of `residual_line`."""
    inside, across = line_start(grid, level, line, dim), line % grid[level, SHAPE + 1]
    entries, x = stencils_at(grid, level, inside, dim) + j, grid[level, SOLUTION] + inside + j
    total = 0.0
    for row in range(ti.static(STENCIL_WIDTH ** (dim - 1))):
        near = x + row_shift(grid, level, across, row, dim, True) - REACH
        for k in ti.static(range(STENCIL_WIDTH)):
            total += levels[entries + (row * STENCIL_WIDTH + k) * pitch(grid, level)] * levels[near + k]
    r = grid[level, RESIDUAL] + inside
    levels[r + j] = levels[grid[level, RHS] + inside + j] - total
    wrap_line(levels, grid, level, r, j, j + 1)


@ti.func
def restrict_line(levels: Template, grid: Template, fine, coarse, line, first, last, axis: Template, dim: Template):
    """Part of a line of b = P^T r on the grid coarser along an axis; r is a level's residual, or right-hand side."""
    source = ti.static(RESIDUAL if axis == dim - 1 else RHS)
    inside = fine_start(grid, fine, coarse, line, axis, dim)
    to = grid[coarse, RHS] + line_start(grid, coarse, line, dim)
    r, weights = grid[fine, source] + inside, grid[fine, WEIGHTS] + inside
    step = ti.static(2 if axis == dim - 1 else 1)
    stride = axis_stride(grid, fine, axis, dim)
    to_lower, to_upper = -stride, stride
    if ti.static(axis == dim - 2):
        two = 2 * (line % grid[coarse, SHAPE + 1])
        to_lower, to_upper = line_shift(grid, fine, two, -1), line_shift(grid, fine, two, 1)
    for j in range(first, last):
        own = step * j
        lower, upper = own + to_lower, own + to_upper
        levels[to + j] = (
            levels[r + own]
            + (1.0 - levels[weights + lower]) * levels[r + lower]
            + levels[weights + upper] * levels[r + upper]
        )


@ti.func
def prolong_line(levels: Template, grid: Template, fine, coarse, line, first, last, axis: Template, dim: Template):
    """Part of a line of P x of the grid that is coarser along an axis; on a level it is added to the solution there."""
    inside = line_start(grid, fine, line, dim)
    to, weights = grid[fine, SOLUTION] + inside, grid[fine, WEIGHTS] + inside
    across = grid[fine, SHAPE + 1]
    one, two = line // across, line % across
    if ti.static(axis == dim - 1):  # the last axis leads to a level
        x = grid[coarse, SOLUTION] + line_at(grid, coarse, one, two, dim)
        for j in range((first + 1) // 2, (last + 1) // 2):
            levels[to + 2 * j] = levels[to + 2 * j] + levels[x + j]
        for j in range(first // 2, last // 2):
            f = 2 * j + 1
            w = levels[weights + f]
            levels[to + f] = levels[to + f] + w * levels[x + j] + (1.0 - w) * levels[x + j + 1]
    else:
        odd = two % 2
        if ti.static(axis == dim - 2):
            two = two // 2
        if ti.static(axis == dim - 3):
            odd = one % 2
            one = one // 2
        x = grid[coarse, SOLUTION] + line_at(grid, coarse, one, two, dim)
        upper = x + axis_stride(grid, coarse, axis, dim)
        if ti.static(axis == dim - 2):
            upper = x + line_shift(grid, coarse, two, 1)
        if odd == 1:
            for j in range(first, last):
                w = levels[weights + j]
                levels[to + j] = w * levels[x + j] + (1.0 - w) * levels[upper + j]
        else:
            for j in range(first, last):
                levels[to + j] = levels[x + j]
    wrap_line(levels, grid, fine, to, first, last)


@ti.func
def _sweep_coarsest(levels: Template, grid: Template, wraps: Template, dim: Template):
    """`COARSEST_SWEEPS` symmetric sweeps of Gauss-Seidel's method on the coarsest level, periodic if ``wraps``."""
    last = grid[0, LEVELS] - 1
    x, b, diagonal = grid[last, SOLUTION], grid[last, RHS], grid[last, DIAGONAL]
    size, n, width = pitch(grid, last), lines(grid, last), grid[last, SHAPE + 2]
    for step in range(COARSEST_SWEEPS * n * width):
        g = step % (n * width)
        if step // (n * width) % 2 == 1:
            g = n * width - 1 - g
        inside = line_start(grid, last, g // width, dim) + g % width
        residual = levels[b + inside]
        for row in range(ti.static(STENCIL_WIDTH ** (dim - 1))):
            # The two are compiled apart, so that sums on levels that are not periodic are as they would be alone.
            shift = row_shift(grid, last, g // width, row, dim, wraps)
            near = x + inside + shift - REACH
            entries = stencils_at(grid, last, inside - g % width, dim) + row * STENCIL_WIDTH * size + g % width
            for k in ti.static(range(STENCIL_WIDTH)):
                residual -= levels[entries + k * size] * levels[near + k]
        levels[x + inside] = levels[x + inside] + levels[diagonal + inside] * residual
        if ti.static(wraps):
            wrap_line(levels, grid, last, x + inside - g % width, 0, width)


@ti.func
def solve_coarsest(levels: Template, grid: Template, dim: Template):
    """The coarsest level's equations by symmetric Gauss-Seidel sweeps."""
    last = grid[0, LEVELS] - 1
    for t in range(grid[last, SIZE]):
        levels[grid[last, SOLUTION] + t] = 0.0
    if grid[last, PERIOD] > 0:
        _sweep_coarsest(levels, grid, True, dim)
        copy_to_image(levels, grid, last, 0, length(grid, last), dim)
    else:
        _sweep_coarsest(levels, grid, False, dim)


@kernel
def invert_coarsest(levels: Reals1, grid: Ints2, inverse: Reals1, scratch: Reals1, dim: Template):
    """Compute `solve_coarsest` as a matrix (n, n) for `apply_inverse`; ``scratch`` has room for n vectors."""
    for c in range(node_count(grid, grid[0, LEVELS] - 1)):
        last = grid[0, LEVELS] - 1
        size, n, width = grid[last, SIZE], node_count(grid, last), length(grid, last)
        for t in range(size):
            scratch[c * size + t] = 0.0
        for step in range(COARSEST_SWEEPS * n):
            g = step % n if step // n % 2 == 0 else n - 1 - step % n
            inside = line_start(grid, last, g // width, dim) + g % width
            residual = ti.select(g == c, 1.0, 0.0)
            for row in range(ti.static(STENCIL_WIDTH ** (dim - 1))):
                near = c * size + inside + row_shift(grid, last, g // width, row, dim, True) - REACH
                first = stencils_at(grid, last, inside - g % width, dim) + g % width
                entries = first + row * STENCIL_WIDTH * pitch(grid, last)
                for k in ti.static(range(STENCIL_WIDTH)):
                    residual -= levels[entries + k * pitch(grid, last)] * scratch[near + k]
            at = c * size + inside
            scratch[at] = scratch[at] + levels[grid[last, DIAGONAL] + inside] * residual
            wrap_line(scratch, grid, last, at - g % width, g % width, g % width + 1)
        for g in range(n):
            inverse[g * n + c] = scratch[c * size + line_start(grid, last, g // width, dim) + g % width]


@ti.func
def apply_inverse(levels: Template, grid: Template, inverse: Template, g, dim: Template):
    """The solution of the coarsest level's equations at its node ``g``."""
    last = grid[0, LEVELS] - 1
    n, width, total = node_count(grid, last), length(grid, last), 0.0
    for c in range(n):
        total += inverse[g * n + c] * levels[grid[last, RHS] + line_start(grid, last, c // width, dim) + c % width]
    x, j = grid[last, SOLUTION] + line_start(grid, last, g // width, dim), g % width
    levels[x + j] = total
    wrap_line(levels, grid, last, x, j, j + 1)
    if grid[last, PERIOD] > 0 and g // width == 0:
        copy_to_image(levels, grid, last, j, j + 1, dim)


@ti.func
def partly_coarsened(grid: Template, level, axis: Template, dim: Template):
    """Number of the grid that is coarser than a level along all axes after ``axis``; axis -1 gives the next level."""
    number = level
    for _ in ti.static(range(dim - 1 - axis)):
        number = grid[number, NEXT]
    return number


@ti.func
def restrict_stage(levels: Template, grid: Template, level, line, first, last, axis: Template, dim: Template):
    """Restriction from a level along an axis, for part of a line of `partly_coarsened`; pre-smooth after the first."""
    fine = partly_coarsened(grid, level, axis, dim)
    coarse = grid[fine, NEXT]
    restrict_line(levels, grid, fine, coarse, line, first, last, axis, dim)
    if ti.static(axis == 0):
        smooth_line(levels, grid, coarse, line, first, last, RHS, True, dim)


@ti.func
def prolong_stage(levels: Template, grid: Template, level, line, first, last, axis: Template, dim: Template):
    """Prolongation to a level along one axis, for part of a line of `partly_coarsened` ``axis``."""
    fine = partly_coarsened(grid, level, axis, dim)
    prolong_line(levels, grid, fine, grid[fine, NEXT], line, first, last, axis, dim)
