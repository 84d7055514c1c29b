"""An iteration of flexible GMRES for devices whose threads cannot wait for each other: the loops around a cycle.

Each loop ends before the next begins. There are two launches, before and after the grids' part of the cycle, which
compute, up to round-off, the same as `tipfem.step.fused_iteration.iterate`; arguments are as there.
"""

from typing import NamedTuple

import taichi as ti

from tipfem.backend.array_types import Reals1, Template
from tipfem.backend.barrier import GROUP
from tipfem.backend.launch import FEW_PARTS, kernel
from tipfem.fem.jacobian import row_product
from tipfem.linalg.low_rank import correct_at, respond, set_sum
from tipfem.linalg.multigrid.deflation import deflate_with_group
from tipfem.linalg.multigrid.grid_hierarchy import RESIDUAL, RHS, SOLUTION, GridArrays, TiedArrays, line_of, node_count
from tipfem.linalg.multigrid.mesh_transfer import (
    correct_node,
    post_smooth_node,
    pre_smooth_node,
    residual_row,
    restrict_to_line,
    smooth_ties_with_group,
)
from tipfem.linalg.queued_fgmres import goes_on, is_made, take_column
from tipfem.linalg.sparsity import Csr
from tipfem.linalg.vector_kernels import fold_dots, strided_dot, subtract_at, sum_folded
from tipfem.step.block_preconditioner import add_viscous_part, correct_row, schur_rhs_row
from tipfem.step.fused_iteration import Corrections, SystemSizes


class StagedArnoldi(NamedTuple):
    """Iteration ``k``, its vectors, and the state that says whether it is made, see `tipfem.linalg.queued_fgmres`."""

    krylov: "Reals1"
    partial: "Reals1"
    state: "Reals1"
    k: "int"


@kernel
def before_grids(
    matrix: Csr,
    scale: Reals1,
    laplacian: Csr,
    grids: GridArrays,
    tied: TiedArrays,
    krylov: Reals1,
    state: Reals1,
    k: ti.i32,
    nodes: ti.i32,
    rows: ti.i32,
    dim: Template,
):
    """The pressure's right-hand side from v_k, and item 1 of the cycle, see `tipfem.linalg.multigrid.v_cycle`."""
    vectors = ti.static(grids.vectors)
    live = goes_on(state)
    for i in range(live * nodes):
        v = 2 * k * rows * (dim + 1)
        vectors[RHS * nodes + i] = schur_rhs_row(matrix, scale, krylov, v, i, rows, dim)
        pre_smooth_node(vectors, i, nodes)
    ti.loop_config(block_dim=GROUP)
    for thread in range(GROUP):
        if live:
            smooth_ties_with_group(laplacian, vectors, tied, thread, nodes)
    for i in range(live * nodes):
        vectors[RESIDUAL * nodes + i] = residual_row(laplacian, vectors, SOLUTION, i, nodes)
    for node in range(live * node_count(grids.grid, 0)):
        line, j = line_of(grids.grid, 0, node)
        restrict_to_line(
            vectors, grids.coordinates, grids.cell_lists, grids.levels, grids.grid, line, j, j + 1, nodes, dim
        )


@kernel
def after_grids(
    matrix: Csr,
    laplacian: Csr,
    grids: GridArrays,
    correction: Corrections,
    scratch: Reals1,
    tied: TiedArrays,
    arnoldi: StagedArnoldi,
    sizes: SystemSizes,
    parts: ti.i32,
):
    """Item 5 of the cycle, deflation, z_k, the product with K, and one pass of Gram-Schmidt's method."""
    vectors = ti.static(grids.vectors)
    krylov, partial, state, k = ti.static(arnoldi)
    viscous_nodes, nodes, rows, dim, corrected, _reduced = ti.static(sizes)
    live = goes_on(state)
    for i in range(live * nodes):
        correct_node(vectors, grids.coordinates, grids.levels, grids.grid, i, nodes, dim)
    for i in range(live * nodes):
        post_smooth_node(laplacian, vectors, i, nodes)
    ti.loop_config(block_dim=GROUP)
    for thread in range(GROUP):
        if live:
            smooth_ties_with_group(laplacian, vectors, tied, thread, nodes)
    ti.loop_config(block_dim=GROUP)
    for thread in range(GROUP):
        if live:
            deflate_with_group(laplacian, vectors, correction.subdomains, scratch, thread, nodes)
    if ti.static(corrected):
        for column in range(live * correction.lists[0]):
            set_sum(correction.lists, correction.values, vectors, column, nodes)
        for column in range(live * correction.lists[0]):
            respond(correction.lists, correction.values, column)
        for i in range(live * nodes):
            correct_at(correction.lists, correction.values, vectors, i, nodes)
    for i in range(live * viscous_nodes):
        add_viscous_part(vectors, correction.viscous, i, nodes)
    for i in range(live * rows):
        v = 2 * k * rows * (dim + 1)
        z = v + rows * (dim + 1)
        correct_row(matrix, vectors, krylov, v, krylov, z, i, nodes, rows, dim)
    for i in range(live * rows):
        z = (2 * k + 1) * rows * (dim + 1)
        row_product(matrix, krylov, z, krylov, z + rows * (dim + 1), i, rows, dim)
    for t in range(live * (k + 2) * parts):
        strided_dot(krylov, partial, t, k, rows * (dim + 1), parts)
    for t in range(live * (k + 2) * FEW_PARTS):
        fold_dots(partial, t, k, parts)
    for j in range(live * (k + 2)):
        sum_folded(partial, j, k, parts)
    ti.loop_config(serialize=True)
    for _ in range(live):
        take_column(partial, state, k, 0)
    for i in range(is_made(state, k) * rows * (dim + 1)):
        subtract_at(krylov, partial, i, k, rows * (dim + 1))
