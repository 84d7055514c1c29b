"""A cycle of multigrid in one kernel, by a team of threads."""

import taichi as ti

from tipfem.backend.barrier import share, synchronise
from tipfem.backend.launch import kernel
from tipfem.linalg.multigrid.grid_hierarchy import NEXT, lines
from tipfem.linalg.multigrid.mesh_transfer import interpolated, rest_of_row, restrict_to_line
from tipfem.linalg.multigrid.v_cycle import prolong, relax_line, restrict, solve_coarsest, subtract_product


@ti.func
def _visit(
    stencil: ti.template(),
    weights: ti.template(),
    relax: ti.template(),
    x: ti.template(),
    b: ti.template(),
    r: ti.template(),
    grid: ti.template(),
    level,
    down,
    barrier: ti.template(),
    thread,
    threads,
    dim: ti.template(),
):
    """On the way ``down``, what a sweep from zero on a level has left, restricted to the next coarser one, and a sweep
    from zero there; else the coarser grid's correction added on the level, and one sweep.

    One function for both ways, so that the product stands in the kernel once: machine code is made at every start.
    """
    one = grid[level, NEXT]
    two = grid[one, NEXT]
    first, last = share(thread, threads, lines(grid, level))
    if not down:
        if ti.static(dim == 3):
            begin, end = share(thread, threads, lines(grid, two))
            for line in range(begin, end):
                prolong(x, weights, grid, two, level + 1, line, 0, dim)
            synchronise(barrier, threads)
        begin, end = share(thread, threads, lines(grid, one))
        for line in range(begin, end):
            prolong(x, weights, grid, one, two, line, ti.static(dim - 2), dim)
        synchronise(barrier, threads)
        for line in range(first, last):
            prolong(x, weights, grid, level, one, line, ti.static(dim - 1), dim)
        synchronise(barrier, threads)
    for line in range(first, last):
        subtract_product(stencil, x, b, r, grid, level, line, dim)
    synchronise(barrier, threads)
    if down:
        fine = level
        for axis in ti.static(range(dim - 1, -1, -1)):
            coarse = grid[fine, NEXT]
            begin, end = share(thread, threads, lines(grid, coarse))
            for line in range(begin, end):
                if ti.static(axis == dim - 1):
                    restrict(r, b, weights, grid, fine, coarse, line, axis, dim)
                else:
                    restrict(b, b, weights, grid, fine, coarse, line, axis, dim)
                if ti.static(axis == 0):
                    relax_line(relax, b, x, grid, coarse, line, False, dim)
            synchronise(barrier, threads)
            fine = coarse
    else:
        for line in range(first, last):
            relax_line(relax, r, x, grid, level, line, True, dim)
        synchronise(barrier, threads)


@ti.func
def cycle(
    b: ti.template(),
    x: ti.template(),
    residual: ti.template(),
    relax: ti.template(),
    row_offsets: ti.template(),
    columns: ti.template(),
    values: ti.template(),
    cell: ti.template(),
    fraction: ti.template(),
    order: ti.template(),
    start: ti.template(),
    stencil: ti.template(),
    weights: ti.template(),
    grid_relax: ti.template(),
    grid_x: ti.template(),
    grid_b: ti.template(),
    grid_r: ti.template(),
    grid: ti.template(),
    barrier: ti.template(),
    nodes,
    levels,
    sweeps,
    thread,
    threads,
    dim: ti.template(),
):
    """One V(1,1)-cycle for x (N,), which is ``relax`` b already at all nodes."""
    mine, end = share(thread, threads, nodes)
    for i in range(mine, end):
        residual[i] = rest_of_row(row_offsets, columns, values, b, x, i)
    synchronise(barrier, threads)
    # By turns: of lines side by side, one thread's might hold most of the particles.
    for turn in range((lines(grid, 0) - thread + threads - 1) // threads):
        line = turn * threads + thread
        restrict_to_line(residual, fraction, order, start, grid_b, grid, line, dim)
        relax_line(grid_relax, grid_b, grid_x, grid, 0, line, False, dim)
    synchronise(barrier, threads)
    for turn in range(2 * levels - 1):
        if turn == levels - 1:
            if thread == 0:
                solve_coarsest(stencil, grid_relax, grid_x, grid_b, grid, levels - 1, sweeps, dim)
            synchronise(barrier, threads)
        else:
            down = turn < levels
            level = turn if down else 2 * levels - 2 - turn
            _visit(
                stencil, weights, grid_relax, grid_x, grid_b, grid_r, grid, level, down, barrier, thread, threads, dim
            )
    for i in range(mine, end):
        residual[i] = x[i] + interpolated(cell, fraction, grid_x, grid, i, dim)
    synchronise(barrier, threads)
    for i in range(mine, end):
        rest = rest_of_row(row_offsets, columns, values, b, residual, i)
        x[i] = ti.select(relax[i] > 0.0, residual[i] + relax[i] * rest, 0.0)
    synchronise(barrier, threads)


@kernel
def cycle_together(
    b: ti.types.ndarray(),
    x: ti.types.ndarray(),
    residual: ti.types.ndarray(),
    relax: ti.types.ndarray(),
    row_offsets: ti.types.ndarray(),
    columns: ti.types.ndarray(),
    values: ti.types.ndarray(),
    cell: ti.types.ndarray(),
    fraction: ti.types.ndarray(),
    order: ti.types.ndarray(),
    start: ti.types.ndarray(),
    stencil: ti.types.ndarray(),
    weights: ti.types.ndarray(),
    grid_relax: ti.types.ndarray(),
    grid_x: ti.types.ndarray(),
    grid_b: ti.types.ndarray(),
    grid_r: ti.types.ndarray(),
    grid: ti.types.ndarray(),
    nodes: ti.i32,
    levels: ti.i32,
    sweeps: ti.i32,
    dim: ti.template(),
    barrier: ti.types.ndarray(),
    threads: ti.i32,
    stride: ti.template(),
    serial: ti.template(),
):
    """One V(1,1)-cycle from zero."""
    ti.loop_config(serialize=serial)
    for t in range(threads * stride):
        if t % stride == 0:
            thread = t // stride
            first, last = share(thread, threads, nodes)
            for i in range(first, last):
                x[i] = relax[i] * b[i]
            synchronise(barrier, threads)
            cycle(
                b,
                x,
                residual,
                relax,
                row_offsets,
                columns,
                values,
                cell,
                fraction,
                order,
                start,
                stencil,
                weights,
                grid_relax,
                grid_x,
                grid_b,
                grid_r,
                grid,
                barrier,
                nodes,
                levels,
                sweeps,
                thread,
                threads,
                dim,
            )
