"""The V(1,1)-cycle of `v_cycle` in one launch, by CPU threads that wait for each other at barriers."""

import taichi as ti

from tipfem.backend.array_types import Ints1, Template
from tipfem.backend.barrier import share, synchronise
from tipfem.backend.launch import kernel
from tipfem.linalg.multigrid.grid_hierarchy import LEVELS, RESIDUAL, SOLUTION, GridArrays, length, lines
from tipfem.linalg.multigrid.grid_transfer import (
    partly_coarsened,
    prolong_stage,
    residual_line,
    restrict_stage,
    smooth_line,
    solve_coarsest,
)
from tipfem.linalg.multigrid.mesh_transfer import (
    correct_node,
    post_smooth_node,
    pre_smooth_node,
    residual_row,
    restrict_to_line,
    smooth_ties,
)
from tipfem.linalg.sparsity import Csr

CYCLE = 300.0  # nanoseconds of one thread for a mesh node in `cycle_from_zero`


@ti.func
def _visit(levels: Template, grid: Template, level, down, barrier: Template, thread, threads, dim: Template):
    """Item 2 of the cycle on a level if ``down``, else item 4; in one function the product is compiled once."""
    if not down:
        for axis in ti.static(range(dim)):
            fine = partly_coarsened(grid, level, axis, dim)
            first, last = share(thread, threads, lines(grid, fine))
            for line in range(first, last):
                prolong_stage(levels, grid, level, line, 0, length(grid, fine), axis, dim)
            synchronise(barrier, threads)
    first, last = share(thread, threads, lines(grid, level))
    for line in range(first, last):
        residual_line(levels, grid, level, line, dim)
    synchronise(barrier, threads)
    if down:
        for axis in ti.static(range(dim - 1, -1, -1)):
            coarse = partly_coarsened(grid, level, axis - 1, dim)
            begin, end = share(thread, threads, lines(grid, coarse))
            for line in range(begin, end):
                restrict_stage(levels, grid, level, line, 0, length(grid, coarse), axis, dim)
            synchronise(barrier, threads)
    else:
        for line in range(first, last):
            smooth_line(levels, grid, level, line, 0, length(grid, level), RESIDUAL, False, dim)
        synchronise(barrier, threads)


@ti.func
def cycle(matrix: Template, grids: Template, barrier: Template, nodes, thread, threads, dim: Template):
    """One V(1,1)-cycle; Jacobi's method has been applied on the mesh at all nodes."""
    vectors, levels, grid = ti.static((grids.vectors, grids.levels, grids.grid))
    mine, end = share(thread, threads, nodes)
    if grids.ties[0] > 0:
        if thread == 0:
            smooth_ties(matrix, vectors, grids.ties, nodes)
        synchronise(barrier, threads)
    for i in range(mine, end):
        vectors[RESIDUAL * nodes + i] = residual_row(matrix, vectors, SOLUTION, i, nodes)
    synchronise(barrier, threads)
    # Lines are distributed cyclically, because one block of adjacent lines may hold most of the particles.
    for k in range((lines(grid, 0) - thread + threads - 1) // threads):
        line = k * threads + thread
        restrict_to_line(
            vectors, grids.coordinates, grids.cell_lists, levels, grid, line, 0, length(grid, 0), nodes, dim
        )
    synchronise(barrier, threads)
    coarsest = grid[0, LEVELS] - 1
    for visit in range(2 * coarsest + 1):
        if visit == coarsest:
            if thread == 0:
                solve_coarsest(levels, grid, dim)
            synchronise(barrier, threads)
        else:
            down = visit < coarsest
            level = visit if down else 2 * coarsest - visit
            _visit(levels, grid, level, down, barrier, thread, threads, dim)
    for i in range(mine, end):
        correct_node(vectors, grids.coordinates, levels, grid, i, nodes, dim)
    synchronise(barrier, threads)
    for i in range(mine, end):
        post_smooth_node(matrix, vectors, i, nodes)
    synchronise(barrier, threads)
    if grids.ties[0] > 0:
        if thread == 0:
            smooth_ties(matrix, vectors, grids.ties, nodes)
        synchronise(barrier, threads)


@kernel
def cycle_from_zero(
    matrix: Csr,
    grids: GridArrays,
    nodes: ti.i32,
    dim: Template,
    stride: Template,
    serial: Template,
    threads: ti.i32,
    barrier: Ints1,
):
    """One V(1,1)-cycle from a zero guess."""
    ti.loop_config(serialize=serial)
    for t in range(threads * stride):
        if t % stride == 0:
            thread = t // stride
            first, last = share(thread, threads, nodes)
            for i in range(first, last):
                pre_smooth_node(grids.vectors, i, nodes)
            synchronise(barrier, threads)
            cycle(matrix, grids, barrier, nodes, thread, threads, dim)
