"""Iterations of flexible GMRES in one kernel, by CPU threads that wait for each other at barriers.

Up to round-off it computes the same as the separate kernels of `tipfem.step.block_preconditioner`,
`tipfem.fem.jacobian`, `tipfem.linalg.multigrid.v_cycle` and `tipfem.linalg.vector_kernels`, with 10 % of the
waiting.
"""

import taichi as ti

from tipfem.backend.array_types import Ints1, Ints2, Reals1, Reals2, Template
from tipfem.backend.barrier import share, synchronise
from tipfem.backend.launch import kernel
from tipfem.fem.jacobian import row_product
from tipfem.linalg.low_rank import correct_at, respond, set_sum
from tipfem.linalg.multigrid.deflation import deflate
from tipfem.linalg.multigrid.fused_cycle import cycle
from tipfem.linalg.multigrid.grid_hierarchy import RHS, SOLUTION
from tipfem.linalg.multigrid.mesh_transfer import pre_smooth_node
from tipfem.linalg.vector_kernels import (
    CANCELLED,
    LEFT,
    TOLERANCE,
    least_left,
    partial_dots,
    record_column,
    subtract_projections,
    sum_dots,
)
from tipfem.step.block_preconditioner import add_viscous_part, correct_row, schur_rhs_row, unscaled
from tipfem.step.pressure_system import push, schur_row

ITERATION = 400.0  # nanoseconds of one thread for a particle in an iteration of `iterate`


@ti.func
def _precondition(
    row_offsets: Template,
    columns: Template,
    blocks: Template,
    scale: Template,
    near_offsets: Template,
    near: Template,
    laplacian: Template,
    vectors: Template,
    coordinates: Template,
    cell_lists: Template,
    levels: Template,
    grid: Template,
    subdomains: Template,
    ties: Template,
    lists: Template,
    values: Template,
    r: Template,
    r_start,
    z: Template,
    z_start,
    motion: Template,
    viscous: Template,
    viscous_nodes,
    nodes,
    rows,
    barrier: Template,
    thread,
    threads,
    dim: Template,
    corrected: Template,
    reduced: Template,
):
    """z = M r, see `LinearSystem.precondition`; r and z begin at ``r_start`` and ``z_start`` in their arrays.

    If ``reduced``, they are pressures, and G z is left in ``motion``.
    """
    first, last = share(thread, threads, nodes)
    for i in range(first, last):
        if ti.static(reduced):
            vectors[RHS * nodes + i] = unscaled(scale, r[r_start + i], i, dim)
        else:
            vectors[RHS * nodes + i] = schur_rhs_row(row_offsets, columns, blocks, scale, r, r_start, i, rows, dim)
        pre_smooth_node(vectors, i, nodes)
    synchronise(barrier, threads)
    cycle(
        near_offsets,
        near,
        laplacian,
        vectors,
        coordinates,
        cell_lists,
        levels,
        grid,
        ties,
        barrier,
        nodes,
        thread,
        threads,
        dim,
    )
    if subdomains[0] > 1:
        if thread == 0:
            deflate(near_offsets, near, laplacian, vectors, subdomains, nodes)
        synchronise(barrier, threads)
    if ti.static(corrected):
        _correct(lists, values, vectors, nodes, barrier, thread, threads)
    if viscous_nodes > 0:
        low, high = share(thread, threads, viscous_nodes)
        for i in range(low, high):
            add_viscous_part(vectors, viscous, i, nodes)
        synchronise(barrier, threads)
    begin, end = share(thread, threads, rows)
    for i in range(begin, end):
        if ti.static(reduced):
            z[z_start + i] = vectors[SOLUTION * nodes + i]
            push(row_offsets, columns, blocks, vectors, motion, i, nodes, dim)
        else:
            correct_row(row_offsets, columns, blocks, vectors, r, r_start, z, z_start, i, nodes, rows, dim)


@ti.func
def _correct(lists: Template, values: Template, vectors: Template, nodes, barrier: Template, thread, threads):
    """Correct the pressure in ``vectors``, see `tipfem.linalg.low_rank.correct`."""
    for k in range(lists[0]):
        if k % threads == thread:
            set_sum(lists, values, vectors, k, nodes)
    synchronise(barrier, threads)
    if thread == 0:
        for k in range(lists[0]):
            respond(lists, values, k)
    synchronise(barrier, threads)
    first, last = share(thread, threads, nodes)
    for i in range(first, last):
        correct_at(lists, values, vectors, i, nodes)
    synchronise(barrier, threads)


@kernel
def iterate(
    row_offsets: Ints1,
    columns: Ints1,
    blocks: Reals1,
    scale: Reals1,
    near_offsets: Ints1,
    near: Ints1,
    laplacian: Reals1,
    vectors: Reals1,
    coordinates: Reals2,
    cell_lists: Ints1,
    levels: Reals1,
    grid: Ints2,
    subdomains: Ints1,
    ties: Ints1,
    lists: Ints1,
    values: Reals1,
    motion: Reals1,
    viscous: Reals1,
    krylov: Reals1,
    partial: Reals1,
    state: Reals1,
    hessenberg: Reals2,
    begin: ti.i32,
    end: ti.i32,
    viscous_nodes: ti.i32,
    nodes: ti.i32,
    rows: ti.i32,
    dim: Template,
    corrected: Template,
    reduced: Template,
    parts: ti.i32,
    stride: Template,
    serial: Template,
    threads: ti.i32,
    barrier: Ints1,
):
    """Iterations ``begin`` ... ``end`` - 1 of Arnoldi's method, or fewer if the residual is small enough before.

    Each is z_k = M v_k; w = K z_k; and one pass of Gram-Schmidt as by `vector_kernels.orthogonalise`, or two where the
    first cancels too much; see `vector_kernels.record_column` for ``state`` and ``hessenberg``.

    The condensed matrix K of ``rows`` nodes, of which the first ``nodes`` have pressures, is given by ``row_offsets``,
    ``columns`` and ``blocks``, the preconditioner M by these, ``scale``, all from ``near_offsets`` to ``values``, and
    ``viscous``; ``lists`` and ``values`` are those of `tipfem.linalg.low_rank`, if it is ``corrected`` so. The pressure
    Laplacian is given by ``near_offsets``, ``near``, its columns, and ``laplacian``, its values. The Krylov vectors are
    laid out as in `tipfem.linalg.vector_kernels`. If ``reduced``, they and K are those of the pressures alone, see
    `tipfem.step.pressure_system`, all rows are ``nodes``, and ``motion`` (nodes * dim,) is scratch.
    """
    ti.loop_config(serialize=serial)
    for t in range(threads * stride):
        if t % stride == 0:
            thread = t // stride
            size = rows * (1 if ti.static(reduced) else dim + 1)
            first, last = share(thread, threads, parts)
            low_row, high_row = share(thread, threads, rows)
            k, going = begin, True
            while going and k < end:
                v = 2 * k * size
                z, w = v + size, v + 2 * size
                _precondition(
                    row_offsets,
                    columns,
                    blocks,
                    scale,
                    near_offsets,
                    near,
                    laplacian,
                    vectors,
                    coordinates,
                    cell_lists,
                    levels,
                    grid,
                    subdomains,
                    ties,
                    lists,
                    values,
                    krylov,
                    v,
                    krylov,
                    z,
                    motion,
                    viscous,
                    viscous_nodes,
                    nodes,
                    rows,
                    barrier,
                    thread,
                    threads,
                    dim,
                    corrected,
                    reduced,
                )
                synchronise(barrier, threads)
                for i in range(low_row, high_row):
                    if ti.static(reduced):
                        krylov[w + i] = schur_row(row_offsets, columns, blocks, vectors, motion, i, nodes, dim)
                    else:
                        row_product(row_offsets, columns, blocks, krylov, z, krylov, w, i, rows, dim)
                synchronise(barrier, threads)
                left, passes, least = least_left(state), 1, 0.0
                done = 0
                while done < passes:
                    least = ti.select(done == 0, left, CANCELLED)
                    for part in range(first, last):
                        low, high = share(part, parts, size)
                        partial_dots(krylov, partial, part, k, size, low, high)
                    synchronise(barrier, threads)
                    if thread == 0:
                        sum_dots(partial, k, parts, least)
                        record_column(partial, hessenberg, state, k, done > 0)
                    synchronise(barrier, threads)
                    if done == 0 and partial[k + 3] < least * partial[k + 2]:
                        passes = 2
                    for part in range(first, last):
                        low, high = share(part, parts, size)
                        subtract_projections(krylov, partial, k, size, low, high)
                    synchronise(barrier, threads)
                    done += 1
                k += 1
                # False for values that are not finite, too.
                going = state[LEFT] * state[TOLERANCE] * state[TOLERANCE] < 1.0
