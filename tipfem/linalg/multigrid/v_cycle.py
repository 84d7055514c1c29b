"""The V(1,1)-cycle, stage by stage, for devices whose threads cannot wait for each other.

With D the damped inverse diagonal of an operator A, b the right-hand side and r the residual, the cycle is

1. on the mesh: pre-smooth from a zero guess, x = D b, and at tied nodes by Gauss-Seidel; r = b - A x; restrict r to
   the finest level, b = P^T r; pre-smooth there;
2. on each level from the finest to the last but one: r = b - A x; restrict r axis by axis to the next level;
   pre-smooth there;
3. on the coarsest level: solve by Gauss-Seidel sweeps;
4. on each level back to the finest: prolong the correction axis by axis and add it, x = x + P e; r = b - A x;
   post-smooth, x = x + D r;
5. on the mesh: x = x + P e; post-smooth, at tied nodes by Gauss-Seidel after that.

See W. L. Briggs, V. E. Henson, S. F. McCormick, A Multigrid Tutorial (2000), chapter 3.

The operations on a node or a line are in `mesh_transfer` and `grid_transfer`. There are two drivers, because Taichi
shares only the outermost loops of a kernel among threads. Here each stage is such a loop: on every device, one ends
before the next begins. `tipfem.linalg.multigrid.fused_cycle` has one outermost loop, over threads that share the stages
and wait for each other at barriers: one launch and a tenth of the waiting, on CPUs only.
"""

import taichi as ti

from tipfem.backend.array_types import Ints1, Ints2, Reals1, Reals2, Template
from tipfem.backend.launch import kernel, part_of
from tipfem.linalg.multigrid.grid_hierarchy import RESIDUAL, SOLUTION, lines
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


@kernel
def descend_from_mesh(
    row_offsets: Ints1,
    columns: Ints1,
    values: Reals1,
    vectors: Reals1,
    coordinates: Reals2,
    cell_lists: Ints1,
    levels: Reals1,
    grid: Ints2,
    ties: Ints1,
    nodes: ti.i32,
    dim: Template,
    parts: ti.i32,
    stride: Template,
):
    """Item 1 of the cycle: pre-smooth on the mesh, restrict the residual to the finest level, pre-smooth there."""
    for i in range(nodes):
        pre_smooth_node(vectors, i, nodes)
    ti.loop_config(serialize=True)
    for _ in range(1):
        smooth_ties(row_offsets, columns, values, vectors, ties, nodes)
    for i in range(nodes):
        vectors[RESIDUAL * nodes + i] = residual_row(row_offsets, columns, values, vectors, SOLUTION, i, nodes)
    for t in range(parts * stride):
        first, last = part_of(t, parts, stride, lines(grid, 0))
        for line in range(first, last):
            restrict_to_line(vectors, coordinates, cell_lists, levels, grid, line, nodes, dim)


@kernel
def descend(levels: Reals1, grid: Ints2, level: ti.i32, dim: Template, parts: ti.i32, stride: Template):
    """Item 2: restrict the residual of a level to the next one; pre-smooth there."""
    for t in range(parts * stride):
        first, last = part_of(t, parts, stride, lines(grid, level))
        for line in range(first, last):
            residual_line(levels, grid, level, line, dim)
    for axis in ti.static(range(dim - 1, -1, -1)):
        for t in range(parts * stride):
            first, last = part_of(t, parts, stride, lines(grid, partly_coarsened(grid, level, axis - 1, dim)))
            for line in range(first, last):
                restrict_stage(levels, grid, level, line, axis, dim)


@kernel
def solve_coarsest_level(levels: Reals1, grid: Ints2, dim: Template):
    """Item 3, serially."""
    ti.loop_config(serialize=True)
    for _ in range(1):
        solve_coarsest(levels, grid, dim)


@kernel
def ascend(levels: Reals1, grid: Ints2, level: ti.i32, dim: Template, parts: ti.i32, stride: Template):
    """Item 4: add the next level's correction to a level's solution; post-smooth."""
    for axis in ti.static(range(dim)):
        for t in range(parts * stride):
            first, last = part_of(t, parts, stride, lines(grid, partly_coarsened(grid, level, axis, dim)))
            for line in range(first, last):
                prolong_stage(levels, grid, level, line, axis, dim)
    for t in range(parts * stride):
        first, last = part_of(t, parts, stride, lines(grid, level))
        for line in range(first, last):
            residual_line(levels, grid, level, line, dim)
    for t in range(parts * stride):
        first, last = part_of(t, parts, stride, lines(grid, level))
        for line in range(first, last):
            smooth_line(levels, grid, level, line, RESIDUAL, False, dim)


@kernel
def ascend_to_mesh(
    row_offsets: Ints1,
    columns: Ints1,
    values: Reals1,
    vectors: Reals1,
    coordinates: Reals2,
    levels: Reals1,
    grid: Ints2,
    ties: Ints1,
    nodes: ti.i32,
    dim: Template,
):
    """Item 5: add the finest level's correction on the mesh; post-smooth."""
    for i in range(nodes):
        correct_node(vectors, coordinates, levels, grid, i, nodes, dim)
    for i in range(nodes):
        post_smooth_node(row_offsets, columns, values, vectors, i, nodes)
    ti.loop_config(serialize=True)
    for _ in range(1):
        smooth_ties(row_offsets, columns, values, vectors, ties, nodes)
