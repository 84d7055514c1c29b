"""Kernels of the block preconditioner: the right-hand side of the pressure's Schur complement, and back substitution.

The Jacobian K of a step has the blocks A (momentum by displacement), -G (momentum by pressure) and D (continuity by
displacement), see `tipfem.fem.jacobian`. With diag(A) in place of A and S for the Schur complement, the block
factorisation is z_u = A^-1 r_u; z_p = S^-1 (r_p - D z_u); z_u += A^-1 G z_p; see M. Benzi, G. H. Golub, J. Liesen,
Numerical solution of saddle point problems, Acta Numerica 14, 2005, section 10. The rows of r and K are scaled by
1 / diag(A), so that r_u is A^-1 r_u already. S^-1 is the cycle of multigrid, and beside it a diagonal at the first
``viscous_nodes``: all nodes, or none. It is that of `tipfem.fem.schur.scale_and_laplacian` where viscosity matters,
and that of `ROUGH` pressures. Where viscosity matters more, `tipfem.step.momentum_polynomial` takes the
place of diag(A)^-1, and z_p = S^-1 r_p.
"""

import taichi as ti

from tipfem.backend.array_types import Reals1, Template
from tipfem.backend.launch import kernel
from tipfem.fem.jacobian import block_entry
from tipfem.fem.residual import displacement_of
from tipfem.linalg.multigrid.grid_hierarchy import DIAGONAL, RHS, SOLUTION
from tipfem.linalg.sparsity import Csr

# S is 1.2 to 2 of the Laplacian for smooth pressures in 3-D, and 0.14 to 0.35 of it for rough ones, least at slivers;
# at particles with few cells, as in spray, it is 1.2 of it. So much of Jacobi's method for S itself beside the cycle
# makes up for that, in 2-D and in 3-D: a quarter fewer iterations in one fluid; in several, which bear less, 20 % fewer
# in waves and columns, 5 % in spray. Of what a tolerance leaves, more is smooth then: where several are solved to
# round-off, as in the first step, what floats at rest would move twice as fast.
ROUGH, ROUGH_OF_SEVERAL = 1.0, 0.2
SCHUR_ROW = 20.0  # nanoseconds of one thread for a particle in `add_rough_parts_of_schur`
# The same of damped Jacobi's method for the Laplacian, in 3-D, where rows are not stored or there is a polynomial.
ROUGH_OF_LAPLACIAN = 3.75


@ti.func
def unscaled(scale: Template, value, i, dim: Template):
    """A scaled residual of continuity at node i without its scale; 0 where pressure is prescribed."""
    factor = scale[i * (dim + 1) + dim]
    return ti.select(factor > 0.0, value / ti.max(factor, 1e-300), 0.0)


@ti.func
def reduced_row(matrix: Template, r: Template, start, i, rows, dim: Template):
    """r_p - D r_u at node i, from a scaled residual r that begins at ``start``; the matrix has ``rows`` nodes."""
    total, couplings = r[start + i * (dim + 1) + dim], matrix.row_offsets[rows]
    for s in range(matrix.row_offsets[i], matrix.row_offsets[i + 1]):
        at = start + matrix.columns[s] * (dim + 1)
        for k in ti.static(range(dim)):
            total -= matrix.values[block_entry(couplings, s, dim, k, dim)] * r[at + k]
    return total


@ti.func
def schur_rhs_row(matrix: Template, scale: Template, r: Template, start, i, rows, dim: Template):
    """`reduced_row` without the scale of the rows."""
    return unscaled(scale, reduced_row(matrix, r, start, i, rows, dim), i, dim)


@ti.func
def schur_diagonal(matrix: Template, scale: Template, i, rows, dim: Template):
    """The diagonal of C + D diag(A)^-1 G at node i, without the scale of the rows, where G is near D^T; 0 if held."""
    couplings, own = matrix.row_offsets[rows], scale[i * (dim + 1) + dim]
    total = 0.0
    for s in range(matrix.row_offsets[i], matrix.row_offsets[i + 1]):
        j = matrix.columns[s]
        if j == i:
            total += matrix.values[block_entry(couplings, s, dim, dim, dim)]
        for k in ti.static(range(dim)):
            entry = matrix.values[block_entry(couplings, s, dim, k, dim)]
            total += entry * entry * scale[j * (dim + 1) + k] / ti.max(own, 1e-300)
    return ti.select(own > 0.0, total / ti.max(own, 1e-300), 0.0)


@ti.func
def pushed(given, matrix: Template, p: Template, start, i, rows, dim: Template):
    """The displacement ``given`` + G p at node i, of pressures that begin at ``start``."""
    u, couplings = given, matrix.row_offsets[rows]
    for s in range(matrix.row_offsets[i], matrix.row_offsets[i + 1]):
        pressure = p[start + matrix.columns[s]]
        for k in ti.static(range(dim)):
            u[k] -= matrix.values[block_entry(couplings, s, k, dim, dim)] * pressure
    return u


@ti.func
def add_viscous_part(vectors: Template, viscous: Template, i, nodes):
    """Add the viscous part of S^-1 at node i to the solution in ``vectors``; 0 where pressure is prescribed."""
    more = viscous[i] * vectors[RHS * nodes + i]
    vectors[SOLUTION * nodes + i] = vectors[SOLUTION * nodes + i] + more


@ti.func
def correct_row(
    matrix: Template, vectors: Template, r: Template, r_start, z: Template, z_start, i, nodes, rows, dim: Template
):
    """Node i's entries of z = (r_u + G z_p, z_p), z_p the solution in ``vectors`` at the first ``nodes``."""
    given = displacement_of(r, r_start // (dim + 1) + i, dim)
    u = pushed(given, matrix, vectors, SOLUTION * nodes, i, rows, dim)
    at = z_start + i * (dim + 1)
    for k in ti.static(range(dim)):
        z[at + k] = u[k]
    z[at + dim] = 0.0
    if i < nodes:
        z[at + dim] = vectors[SOLUTION * nodes + i]


@kernel
def schur_rhs(matrix: Csr, scale: Reals1, r: Reals1, vectors: Reals1, nodes: ti.i32, rows: ti.i32, dim: Template):
    """The right-hand side in ``vectors``, see `tipfem.linalg.multigrid.grid_hierarchy`, from a scaled residual r."""
    for i in range(nodes):
        vectors[RHS * nodes + i] = schur_rhs_row(matrix, scale, r, 0, i, rows, dim)


@kernel
def continuity_rhs(scale: Reals1, r: Reals1, vectors: Reals1, nodes: ti.i32, dim: Template):
    """r_p without the scale of the rows, the right-hand side of the triangular form, in ``vectors``."""
    for i in range(nodes):
        vectors[RHS * nodes + i] = unscaled(scale, r[i * (dim + 1) + dim], i, dim)


@kernel
def add_viscous_parts(vectors: Reals1, viscous: Reals1, viscous_nodes: ti.i32, nodes: ti.i32):
    """`add_viscous_part` at the first ``viscous_nodes``."""
    for i in range(viscous_nodes):
        add_viscous_part(vectors, viscous, i, nodes)


@kernel
def add_rough_parts(vectors: Reals1, viscous: Reals1, nodes: ti.i32):
    """Add those of `ROUGH_OF_LAPLACIAN` to the viscous parts of S^-1."""
    for i in range(nodes):
        viscous[i] = viscous[i] + ROUGH_OF_LAPLACIAN * vectors[DIAGONAL * nodes + i]


@kernel
def add_rough_parts_of_schur(
    matrix: Csr,
    scale: Reals1,
    viscous: Reals1,
    part: float,
    nodes: ti.i32,
    rows: ti.i32,
    dim: Template,
    serial: Template,
):
    """Add a ``part``, see `ROUGH`, of one over the diagonal of S to the viscous parts of S^-1."""
    ti.loop_config(serialize=serial)
    for i in range(nodes):
        diagonal = schur_diagonal(matrix, scale, i, rows, dim)
        viscous[i] = viscous[i] + ti.select(diagonal > 0.0, part / ti.max(diagonal, 1e-300), 0.0)


@kernel
def correct(matrix: Csr, vectors: Reals1, r: Reals1, z: Reals1, nodes: ti.i32, rows: ti.i32, dim: Template):
    """z = (r_u + G z_p, z_p), z_p the solution in ``vectors``, which is 0 where pressure is prescribed."""
    for i in range(rows):
        correct_row(matrix, vectors, r, 0, z, 0, i, nodes, rows, dim)
