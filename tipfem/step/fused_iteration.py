"""Iterations of flexible GMRES in one kernel, by CPU threads that wait for each other at barriers.

Up to round-off it computes the same as the separate kernels of `tipfem.step.block_preconditioner`,
`tipfem.fem.jacobian`, `tipfem.linalg.multigrid.v_cycle` and `tipfem.linalg.vector_kernels`, with 10 % of the
waiting.
"""

from typing import NamedTuple

import taichi as ti

from tipfem.backend.array_types import Ints1, Reals1, Reals2, Template
from tipfem.backend.barrier import share, synchronise
from tipfem.backend.launch import kernel
from tipfem.fem.jacobian import row_product
from tipfem.linalg.low_rank import correct_at, respond, set_sum
from tipfem.linalg.multigrid.deflation import deflate
from tipfem.linalg.multigrid.fused_cycle import cycle
from tipfem.linalg.multigrid.grid_hierarchy import RHS, SOLUTION, GridArrays
from tipfem.linalg.multigrid.mesh_transfer import pre_smooth_node
from tipfem.linalg.sparsity import Csr
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
from tipfem.step.momentum_polynomial import advance_row, begin_row, first_rho, next_rho
from tipfem.step.pressure_system import push, schur_row

ITERATION = 400.0  # nanoseconds of one thread for a particle in an iteration of `iterate`


class Corrections(NamedTuple):
    """Arrays of what follows a cycle: deflation, the corrections of low rank and of viscosity."""

    subdomains: "Ints1"
    lists: "Ints1"  # and values: those of `tipfem.linalg.low_rank`
    values: "Reals1"
    motion: "Reals1"  # (2 rows * d,) scratch of a reduced system, and of a polynomial
    viscous: "Reals1"  # (nodes,)
    weights: "Reals1"  # (rows * d,) of a polynomial, see `tipfem.step.momentum_polynomial`, its degree, 0 for none,
    degree: "int"
    lowest: "float"  # and the lowest eigenvalue that it is made for


class Arnoldi(NamedTuple):
    """Iterations ``begin`` to ``end`` - 1, and their vectors as in `tipfem.linalg.vector_kernels`."""

    krylov: "Reals1"
    partial: "Reals1"
    state: "Reals1"  # see `vector_kernels.record_column`
    hessenberg: "Reals2"
    begin: "int"
    end: "int"


class SystemSizes(NamedTuple):
    """Sizes of the system, and which it is."""

    viscous_nodes: "int"  # that have a viscous part: all, or none
    nodes: "int"  # with pressures, the first of the rows
    rows: "int"
    dim: "Template"
    corrected: "Template"  # whether by `tipfem.linalg.low_rank`
    reduced: "Template"  # whether to the pressures, see `tipfem.step.pressure_system`


@ti.func
def _precondition(
    matrix: Template,
    scale: Template,
    laplacian: Template,
    grids: Template,
    correction: Template,
    r: Template,
    r_start,
    z: Template,
    z_start,
    sizes: Template,
    barrier: Template,
    thread,
    threads,
):
    """z = M r, see `LinearSystem.precondition`; r and z begin at ``r_start`` and ``z_start`` in their arrays.

    If ``reduced``, they are pressures, and G z is left in ``motion``.
    """
    vectors = ti.static(grids.vectors)
    viscous_nodes, nodes, rows, dim, corrected, reduced = ti.static(sizes)
    first, last = share(thread, threads, nodes)
    for i in range(first, last):
        if ti.static(reduced):
            vectors[RHS * nodes + i] = unscaled(scale, r[r_start + i], i, dim)
        elif correction.degree > 0:
            vectors[RHS * nodes + i] = unscaled(scale, r[r_start + i * (dim + 1) + dim], i, dim)
        else:
            vectors[RHS * nodes + i] = schur_rhs_row(matrix, scale, r, r_start, i, rows, dim)
        pre_smooth_node(vectors, i, nodes)
    synchronise(barrier, threads)
    cycle(laplacian, grids, barrier, nodes, thread, threads, dim)
    if correction.subdomains[0] > 1:
        if thread == 0:
            deflate(laplacian, vectors, correction.subdomains, nodes)
        synchronise(barrier, threads)
    if ti.static(corrected):
        _correct(correction, vectors, nodes, barrier, thread, threads)
    if viscous_nodes > 0:
        low, high = share(thread, threads, viscous_nodes)
        for i in range(low, high):
            add_viscous_part(vectors, correction.viscous, i, nodes)
        synchronise(barrier, threads)
    begin, end = share(thread, threads, rows)
    for i in range(begin, end):
        if ti.static(reduced):
            z[z_start + i] = vectors[SOLUTION * nodes + i]
            push(matrix, vectors, correction.motion, i, nodes, dim)
        else:
            correct_row(matrix, vectors, r, r_start, z, z_start, i, nodes, rows, dim)
    if ti.static(not reduced):
        if correction.degree > 0:
            motion, weights = ti.static((correction.motion, correction.weights))
            lowest = correction.lowest
            for i in range(begin, end):
                begin_row(weights, z, z_start, motion, i, rows, lowest, dim)
            synchronise(barrier, threads)
            rho = first_rho(lowest)
            for k in range(1, correction.degree):
                new = next_rho(rho, lowest)
                alpha, beta, last = 4.0 * new / (1.0 - lowest), new * rho, k + 1 == correction.degree
                rho = new
                for i in range(begin, end):
                    advance_row(matrix, weights, z, z_start, motion, i, k, alpha, beta, last, rows, dim)
                synchronise(barrier, threads)


@ti.func
def _correct(correction: Template, vectors: Template, nodes, barrier: Template, thread, threads):
    """Correct the pressure in ``vectors``, see `tipfem.linalg.low_rank.correct`."""
    for k in range(correction.lists[0]):
        if k % threads == thread:
            set_sum(correction.lists, correction.values, vectors, k, nodes)
    synchronise(barrier, threads)
    if thread == 0:
        for k in range(correction.lists[0]):
            respond(correction.lists, correction.values, k)
    synchronise(barrier, threads)
    first, last = share(thread, threads, nodes)
    for i in range(first, last):
        correct_at(correction.lists, correction.values, vectors, i, nodes)
    synchronise(barrier, threads)


@kernel
def iterate(
    matrix: Csr,
    scale: Reals1,
    laplacian: Csr,
    grids: GridArrays,
    correction: Corrections,
    arnoldi: Arnoldi,
    sizes: SystemSizes,
    parts: ti.i32,
    stride: Template,
    serial: Template,
    threads: ti.i32,
    barrier: Ints1,
):
    """Iterations ``begin`` ... ``end`` - 1 of Arnoldi's method, or fewer if the residual is small enough before.

    Each is z_k = M v_k; w = K z_k; and one pass of Gram-Schmidt as by `vector_kernels.orthogonalise`, or two where the
    first cancels too much. K is the condensed ``matrix``, the preconditioner M is given by it and all from ``scale`` to
    ``correction``. If ``reduced``, K and the vectors are those of the pressures alone, and all rows are ``nodes``.
    """
    vectors = ti.static(grids.vectors)
    krylov, partial, state, hessenberg, begin, end = ti.static(arnoldi)
    nodes, rows, dim, reduced = ti.static((sizes.nodes, sizes.rows, sizes.dim, sizes.reduced))
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
                    matrix, scale, laplacian, grids, correction, krylov, v, krylov, z, sizes, barrier, thread, threads
                )
                synchronise(barrier, threads)
                for i in range(low_row, high_row):
                    if ti.static(reduced):
                        krylov[w + i] = schur_row(matrix, vectors, correction.motion, i, nodes, dim)
                    else:
                        row_product(matrix, krylov, z, krylov, w, i, rows, dim)
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
