"""The linear system of a step reduced to its pressures, where momentum by displacement is almost diagonal.

The Jacobian K has the blocks A (momentum by displacement), -G (momentum by pressure), D (continuity by displacement)
and C (continuity by pressure), see `tipfem.step.block_preconditioner`. Inertia dominates A, and is lumped: where
viscosity moves momentum by far less than a spacing in a step, the rows of A - diag(A) are some thousandths of the
diagonal, and a few hundredths where pressure changes most. With diag(A) in place of A the displacements are eliminated,

    u = r_u + G p,    (C + D G) p = r_p - D r_u,

in rows scaled by 1 / diag(A). A Krylov iteration on the pressures takes two thirds of the time of one on all unknowns,
and A is not assembled. A correction leaves the residual (A - diag(A)) u, some thousandths of the first, which the next
one finds. So it serves where 1 % is good enough, as in the first correction of a step.
"""

import taichi as ti

from tipfem.backend.array_types import Reals1, Template
from tipfem.backend.launch import kernel
from tipfem.fem.jacobian import block_entry
from tipfem.fem.residual import displacement_of
from tipfem.linalg.multigrid.grid_hierarchy import SOLUTION
from tipfem.linalg.sparsity import Csr
from tipfem.step.block_preconditioner import pushed, reduced_row

ROW = 15.0  # nanoseconds of one thread for a particle in the kernels here


@ti.func
def push(matrix: Template, vectors: Template, motion: Template, i, nodes, dim: Template):
    """G p at node i, p the solution in ``vectors``, into ``motion`` (N d,)."""
    nothing = ti.Vector.zero(float, dim)
    u = pushed(nothing, matrix, vectors, SOLUTION * nodes, i, nodes, dim)
    for k in ti.static(range(dim)):
        motion[i * dim + k] = u[k]


@ti.func
def schur_row(matrix: Template, vectors: Template, motion: Template, i, nodes, dim: Template):
    """(C + D G) p at node i, p the solution in ``vectors``, with G p in ``motion``."""
    total, couplings = 0.0, matrix.row_offsets[nodes]
    for s in range(matrix.row_offsets[i], matrix.row_offsets[i + 1]):
        j = matrix.columns[s]
        total += matrix.values[block_entry(couplings, s, dim, dim, dim)] * vectors[SOLUTION * nodes + j]
        for k in ti.static(range(dim)):
            total += matrix.values[block_entry(couplings, s, dim, k, dim)] * motion[j * dim + k]
    return total


@kernel
def reduce(matrix: Csr, r: Reals1, out: Reals1, nodes: ti.i32, dim: Template, serial: Template):
    """out = r_p - D r_u (N,), from a scaled residual r of ``nodes``."""
    ti.loop_config(serialize=serial)
    for i in range(nodes):
        out[i] = reduced_row(matrix, r, 0, i, nodes, dim)


@kernel
def expand(matrix: Csr, p: Reals1, r: Reals1, out: Reals1, nodes: ti.i32, dim: Template, serial: Template):
    """out = (r_u + G p, p), from pressures p (N,) and a scaled residual r of ``nodes``."""
    ti.loop_config(serialize=serial)
    for i in range(nodes):
        nothing = ti.Vector.zero(float, dim)
        u = displacement_of(r, i, dim) + pushed(nothing, matrix, p, 0, i, nodes, dim)
        for k in ti.static(range(dim)):
            out[i * (dim + 1) + k] = u[k]
        out[i * (dim + 1) + dim] = p[i]
