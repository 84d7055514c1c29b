"""A whole iteration of Krylov's method in one kernel, by a team of threads.

It does with `tipfem.backend.barrier` what staged kernels do loop by loop elsewhere, the same but for rounding.
"""

import taichi as ti

from tipfem.backend.barrier import share, synchronise
from tipfem.backend.launch import kernel
from tipfem.fem.jacobian import correction_row, row_product, schur_row
from tipfem.linalg.multigrid.deflation_kernels import lift
from tipfem.linalg.multigrid.fused_cycle import cycle
from tipfem.linalg.vector_kernels import dots, subtract, sum_dots


@kernel
def iterate(
    row_offsets: ti.types.ndarray(),
    columns: ti.types.ndarray(),
    uu: ti.types.ndarray(),
    up: ti.types.ndarray(),
    pu: ti.types.ndarray(),
    pp: ti.types.ndarray(),
    scale: ti.types.ndarray(),
    b: ti.types.ndarray(),
    x: ti.types.ndarray(),
    residual: ti.types.ndarray(),
    relax: ti.types.ndarray(),
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
    offsets: ti.types.ndarray(),
    inside: ti.types.ndarray(),
    energy: ti.types.ndarray(),
    basis: ti.types.ndarray(),
    directions: ti.types.ndarray(),
    w: ti.types.ndarray(),
    partial: ti.types.ndarray(),
    out: ti.types.ndarray(),
    k: ti.i32,
    nodes: ti.i32,
    levels: ti.i32,
    sweeps: ti.i32,
    bubbles: ti.i32,
    cancelled: float,
    again: ti.i32,
    whole: ti.template(),
    dim: ti.template(),
    barrier: ti.types.ndarray(),
    threads: ti.i32,
    parts: ti.i32,
    stride: ti.template(),
    serial: ti.template(),
):
    """z_k = M v_k, the preconditioner M as in `linear_system.LinearSystem.precondition`, in ``directions``; if
    ``whole``, also w = K z_k and what `vector_kernels.orthogonalise` makes of it, w itself becoming v_{k+1}; ``again``
    leaves it at the latter.

    b and x (N,) are the right side and the solution of the cycle; ``offsets``, ``inside`` and ``energy`` describe the
    bubbles, see `tipfem.linalg.multigrid.deflation_kernels`.
    """
    ti.loop_config(serialize=serial)
    for t in range(threads * stride):
        if t % stride == 0:
            thread = t // stride
            size = nodes * (dim + 1)
            begin = k * size
            if not again:
                mine, end = share(thread, threads, nodes)
                for i in range(mine, end):
                    b[i] = schur_row(row_offsets, columns, pu, scale, basis, begin, i, dim)
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
                if bubbles > 0:
                    if thread == 0:
                        lift(b, x, row_offsets, columns, values, offsets, inside, energy, bubbles)
                    synchronise(barrier, threads)
                for i in range(mine, end):
                    correction_row(row_offsets, columns, up, basis, x, directions, begin, i, dim)
                if ti.static(whole):
                    synchronise(barrier, threads)
                    for i in range(mine, end):
                        row_product(row_offsets, columns, uu, up, pu, pp, directions, begin, w, i, dim)
                    synchronise(barrier, threads)
            if ti.static(whole):
                first, last = share(thread, threads, parts)
                for part in range(first, last):
                    low, high = share(part, parts, size)
                    dots(basis, w, partial, part, k, size, low, high)
                synchronise(barrier, threads)
                if thread == 0:
                    sum_dots(partial, out, k, parts, cancelled)
                synchronise(barrier, threads)
                for part in range(first, last):
                    low, high = share(part, parts, size)
                    subtract(basis, w, partial, k, size, low, high)
