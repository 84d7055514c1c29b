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
shares only the outermost loops of a kernel among threads. Here each stage is such a loop, over nodes: on every device,
one ends before the next begins. A GPU's threads wait for each other only within a group; one group takes all levels
that are small, in one launch. `tipfem.linalg.multigrid.fused_cycle` has one outermost loop, over threads that share the
stages, line by line, and wait for each other at barriers: one launch and 10 % of the waiting, on CPUs only.
"""

import taichi as ti

from tipfem.backend.array_types import Ints2, Reals1, Template
from tipfem.backend.barrier import GROUP, rounds
from tipfem.backend.launch import kernel
from tipfem.linalg.multigrid.grid_hierarchy import LEVELS, RESIDUAL, SOLUTION, GridArrays, line_of, node_count
from tipfem.linalg.multigrid.grid_transfer import (
    apply_inverse,
    partly_coarsened,
    prolong_stage,
    residual_node,
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
from tipfem.linalg.queued_fgmres import goes_on
from tipfem.linalg.sparsity import Csr

SMALL = 4096  # nodes of a level that one group takes


@ti.func
def restrict_node(levels: Template, grid: Template, level, node, axis: Template, dim: Template):
    """`restrict_stage` for a node of `partly_coarsened` ``axis`` - 1."""
    line, j = line_of(grid, partly_coarsened(grid, level, axis - 1, dim), node)
    restrict_stage(levels, grid, level, line, j, j + 1, axis, dim)


@ti.func
def prolong_node(levels: Template, grid: Template, level, node, axis: Template, dim: Template):
    """`prolong_stage` for a node of `partly_coarsened` ``axis``."""
    line, j = line_of(grid, partly_coarsened(grid, level, axis, dim), node)
    prolong_stage(levels, grid, level, line, j, j + 1, axis, dim)


@ti.func
def residual_at(levels: Template, grid: Template, level, node, dim: Template):
    """The residual at a node of a level."""
    line, j = line_of(grid, level, node)
    residual_node(levels, grid, level, line, j, dim)


@ti.func
def smooth_node(levels: Template, grid: Template, level, node, dim: Template):
    """Damped Jacobi's method at a node of a level."""
    line, j = line_of(grid, level, node)
    smooth_line(levels, grid, level, line, j, j + 1, RESIDUAL, False, dim)


@kernel
def descend_from_mesh(matrix: Csr, grids: GridArrays, nodes: ti.i32, dim: Template):
    """Item 1 of the cycle: pre-smooth on the mesh, restrict the residual to the finest level, pre-smooth there."""
    for i in range(nodes):
        pre_smooth_node(grids.vectors, i, nodes)
    ti.loop_config(serialize=True)
    for _ in range(1):
        smooth_ties(matrix, grids.vectors, grids.ties, nodes)
    for i in range(nodes):
        grids.vectors[RESIDUAL * nodes + i] = residual_row(matrix, grids.vectors, SOLUTION, i, nodes)
    for node in range(node_count(grids.grid, 0)):
        line, j = line_of(grids.grid, 0, node)
        restrict_to_line(
            grids.vectors, grids.coordinates, grids.cell_lists, grids.levels, grids.grid, line, j, j + 1, nodes, dim
        )


@kernel
def descend(levels: Reals1, grid: Ints2, state: Reals1, level: ti.i32, dim: Template):
    """Item 2: restrict the residual of a level to the next one; pre-smooth there; unless ``state`` says no."""
    for node in range(goes_on(state) * node_count(grid, level)):
        residual_at(levels, grid, level, node, dim)
    for axis in ti.static(range(dim - 1, -1, -1)):
        for node in range(goes_on(state) * node_count(grid, partly_coarsened(grid, level, axis - 1, dim))):
            restrict_node(levels, grid, level, node, axis, dim)


@kernel
def solve_coarsest_level(levels: Reals1, grid: Ints2, dim: Template):
    """Item 3, serially."""
    ti.loop_config(serialize=True)
    for _ in range(1):
        solve_coarsest(levels, grid, dim)


@kernel
def ascend(levels: Reals1, grid: Ints2, state: Reals1, level: ti.i32, dim: Template):
    """Item 4: add the next level's correction to a level's solution; post-smooth; unless ``state`` says no."""
    for axis in ti.static(range(dim)):
        for node in range(goes_on(state) * node_count(grid, partly_coarsened(grid, level, axis, dim))):
            prolong_node(levels, grid, level, node, axis, dim)
    for node in range(goes_on(state) * node_count(grid, level)):
        residual_at(levels, grid, level, node, dim)
    for node in range(goes_on(state) * node_count(grid, level)):
        smooth_node(levels, grid, level, node, dim)


@kernel
def visit_small_levels(levels: Reals1, grid: Ints2, inverse: Reals1, state: Reals1, top: ti.i32, dim: Template):
    """Items 2 to 4 from the level ``top`` on, by a group of a GPU's threads; ``inverse`` as from `invert_coarsest`."""
    ti.loop_config(block_dim=GROUP)
    for thread in range(GROUP):
        last = grid[0, LEVELS] - 1
        for visit in range(goes_on(state) * (2 * (last - top) + 1)):
            down = visit < last - top
            level = top + visit if down else 2 * last - top - visit
            if level == last:
                for k in range(rounds(node_count(grid, level), thread)):
                    apply_inverse(levels, grid, inverse, k * GROUP + thread, dim)
                ti.simt.block.sync()
            else:
                if not down:
                    for axis in ti.static(range(dim)):
                        for k in range(rounds(node_count(grid, partly_coarsened(grid, level, axis, dim)), thread)):
                            prolong_node(levels, grid, level, k * GROUP + thread, axis, dim)
                        ti.simt.block.sync()
                for k in range(rounds(node_count(grid, level), thread)):
                    residual_at(levels, grid, level, k * GROUP + thread, dim)
                ti.simt.block.sync()
                if down:
                    for axis in ti.static(range(dim - 1, -1, -1)):
                        for k in range(rounds(node_count(grid, partly_coarsened(grid, level, axis - 1, dim)), thread)):
                            restrict_node(levels, grid, level, k * GROUP + thread, axis, dim)
                        ti.simt.block.sync()
                else:
                    for k in range(rounds(node_count(grid, level), thread)):
                        smooth_node(levels, grid, level, k * GROUP + thread, dim)
                    ti.simt.block.sync()


@kernel
def ascend_to_mesh(matrix: Csr, grids: GridArrays, nodes: ti.i32, dim: Template):
    """Item 5: add the finest level's correction on the mesh; post-smooth."""
    for i in range(nodes):
        correct_node(grids.vectors, grids.coordinates, grids.levels, grids.grid, i, nodes, dim)
    for i in range(nodes):
        post_smooth_node(matrix, grids.vectors, i, nodes)
    ti.loop_config(serialize=True)
    for _ in range(1):
        smooth_ties(matrix, grids.vectors, grids.ties, nodes)
