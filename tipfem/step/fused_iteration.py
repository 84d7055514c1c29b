"""A whole iteration of flexible GMRES in one kernel, by CPU threads that wait for each other at barriers.

Up to round-off it computes the same as the separate kernels of `tipfem.step.block_preconditioner`,
`tipfem.fem.jacobian`, `tipfem.linalg.multigrid.v_cycle` and `tipfem.linalg.vector_kernels`, with a tenth of the
waiting.
"""

import taichi as ti

from tipfem.backend.array_types import Ints1, Ints2, Reals1, Reals2, Template
from tipfem.backend.barrier import share, synchronise
from tipfem.backend.launch import kernel
from tipfem.fem.jacobian import row_product
from tipfem.linalg.multigrid.deflation import deflate
from tipfem.linalg.multigrid.fused_cycle import cycle
from tipfem.linalg.multigrid.grid_hierarchy import RHS
from tipfem.linalg.multigrid.mesh_transfer import pre_smooth_node
from tipfem.linalg.vector_kernels import partial_dots, subtract_projections, sum_dots
from tipfem.step.block_preconditioner import correct_row, schur_rhs_row
from tipfem.step.body_coupling import (
    add_rotation,
    begin_body,
    clear_body_node,
    collect_body,
    correct_pressure_at,
    end_body,
    respond,
    set_reaction,
)
from tipfem.step.body_layout import BODIES, NODES, RING
from tipfem.step.tie_kernels import clear_tie, collect_tie, spread_tie
from tipfem.walls.constraint_kernels import COLUMNS, ROWS, project_node

ITERATION = 400.0  # nanoseconds of one thread for a particle in `iterate`


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
    sliding: Template,
    projector: Template,
    bodies: Template,
    data: Template,
    r: Template,
    r_start,
    z: Template,
    z_start,
    nodes,
    barrier: Template,
    thread,
    threads,
    dim: Template,
    floating: Template,
):
    """z = M r, see `LinearSystem.precondition`; r and z begin at ``r_start`` and ``z_start`` in their arrays."""
    if ti.static(floating):
        for b in range(bodies[BODIES]):
            if b % threads == thread:
                begin_body(bodies, data, scale, r, r_start, b, 3 * nodes)
        synchronise(barrier, threads)
    tied_from, tied_to = share(thread, threads, ties[0])
    if ties[0] > 0:
        for t in range(tied_from, tied_to):
            spread_tie(ties, t, r, r_start, dim)
        synchronise(barrier, threads)
    first, last = share(thread, threads, nodes)
    for i in range(first, last):
        vectors[RHS * nodes + i] = schur_rhs_row(row_offsets, columns, blocks, scale, r, r_start, i, nodes, dim)
        pre_smooth_node(vectors, i, nodes)
    synchronise(barrier, threads)
    for t in range(tied_from, tied_to):
        clear_tie(ties, t, r, r_start, dim)
    if ti.static(floating):
        begin, end = share(thread, threads, bodies[NODES])
        for s in range(begin, end):
            clear_body_node(bodies, r, r_start, s)
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
    if ti.static(floating):
        _add_mobility(bodies, data, vectors, nodes, barrier, thread, threads)
    for i in range(first, last):
        correct_row(row_offsets, columns, blocks, vectors, r, r_start, z, z_start, i, nodes, dim)
    if ties[0] > 0 or sliding[0] > 0 or ti.static(floating):
        synchronise(barrier, threads)
    for t in range(tied_from, tied_to):
        collect_tie(ties, t, z, z_start, dim)
    if sliding[0] > 0:
        synchronise(barrier, threads)
        begin, end = share(thread, threads, sliding[0])
        for s in range(begin, end):
            project_node(sliding, projector, s, COLUMNS, z, z_start, dim)
    if ti.static(floating):
        synchronise(barrier, threads)
        for b in range(bodies[BODIES]):
            if b % threads == thread:
                end_body(bodies, data, scale, z, z_start, b, 3 * nodes)
    if ties[0] > 0 and (sliding[0] > 0 or ti.static(floating)):
        synchronise(barrier, threads)
    for t in range(tied_from, tied_to):
        spread_tie(ties, t, z, z_start, dim)


@ti.func
def _add_mobility(bodies: Template, data: Template, vectors: Template, nodes, barrier: Template, thread, threads):
    """Correct the pressure in ``vectors`` for the bodies' motion, see `body_coupling.add_mobility`."""
    for b in range(bodies[BODIES]):
        if b % threads == thread:
            set_reaction(bodies, data, vectors, b, nodes)
    synchronise(barrier, threads)
    if thread == 0:
        for k in range(3 * bodies[BODIES]):
            respond(bodies, data, k)
    synchronise(barrier, threads)
    first, last = share(thread, threads, nodes)
    for i in range(first, last):
        correct_pressure_at(bodies, data, vectors, i, nodes)
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
    sliding: Ints1,
    projector: Reals2,
    bodies: Ints1,
    data: Reals1,
    krylov: Reals1,
    partial: Reals1,
    k: ti.i32,
    nodes: ti.i32,
    cancelled: float,
    dim: Template,
    floating: Template,
    parts: ti.i32,
    stride: Template,
    serial: Template,
    threads: ti.i32,
    barrier: Ints1,
):
    """z_k = M v_k; w = K z_k; one pass of Gram-Schmidt as by `vector_kernels.orthogonalise`.

    The matrix K is given by ``row_offsets``, ``columns`` and ``blocks``, the preconditioner M by these, ``scale`` and
    all from ``near_offsets`` to ``data``; ``sliding`` and ``projector`` as in `tipfem.walls.constraint_kernels`;
    ``bodies`` and ``data``, see `tipfem.step.body_layout`, are used if there are
    bodies that float. The pressure Laplacian is given by ``near_offsets``, ``near``, its columns,
    and ``laplacian``, its values. The Krylov vectors are laid out as in `tipfem.linalg.vector_kernels`.
    """
    ti.loop_config(serialize=serial)
    for t in range(threads * stride):
        if t % stride == 0:
            thread = t // stride
            size = nodes * (dim + 1)
            if ti.static(floating):
                size += 3 * bodies[BODIES]
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
                sliding,
                projector,
                bodies,
                data,
                krylov,
                v,
                krylov,
                z,
                nodes,
                barrier,
                thread,
                threads,
                dim,
                floating,
            )
            synchronise(barrier, threads)
            begin, end = share(thread, threads, nodes)
            for i in range(begin, end):
                row_product(row_offsets, columns, blocks, krylov, z, krylov, w, i, nodes, dim)
            synchronise(barrier, threads)
            if ti.static(floating):
                ring_from, ring_to = share(thread, threads, bodies[RING])
                for n in range(ring_from, ring_to):
                    add_rotation(bodies, data, scale, krylov, z, krylov, w, n, 3 * nodes)
                synchronise(barrier, threads)
            if ties[0] > 0:
                tied_from, tied_to = share(thread, threads, ties[0])
                for tie in range(tied_from, tied_to):
                    collect_tie(ties, tie, krylov, w, dim)
                synchronise(barrier, threads)
            if ti.static(floating):
                if sliding[0] > 0:  # of what rotations change
                    low, high = share(thread, threads, sliding[0])
                    for n in range(low, high):
                        project_node(sliding, projector, n, ROWS, krylov, w, dim)
                    synchronise(barrier, threads)
                for b in range(bodies[BODIES]):
                    if b % threads == thread:
                        collect_body(bodies, data, scale, krylov, z, krylov, w, b, 3 * nodes)
                synchronise(barrier, threads)
            first, last = share(thread, threads, parts)
            for part in range(first, last):
                low, high = share(part, parts, size)
                partial_dots(krylov, partial, part, k, size, low, high)
            synchronise(barrier, threads)
            if thread == 0:
                sum_dots(partial, k, parts, cancelled)
            synchronise(barrier, threads)
            for part in range(first, last):
                low, high = share(part, parts, size)
                subtract_projections(krylov, partial, k, size, low, high)
