"""A polynomial of momentum by displacement, for steps in which viscosity moves momentum far.

There the block A of the Jacobian (`tipfem.step.block_preconditioner`) is far from its diagonal, and Krylov's method
would need as many iterations as momentum moves by spacings. With A^-1 in place of diag(A)^-1 the preconditioner needs
three or four, also in its triangular form z_p = S^-1 r_p; z_u = A^-1 (r_u + G z_p). In place of A^-1 there is the
polynomial of Chebyshev on A for eigenvalues between `lowest` and 1, where each row is divided by the sum of its
absolute values: then no eigenvalue is above 1 (A. H. Baker, R. D. Falgout, T. V. Kolev & U. M. Yang, Multigrid
smoothers for ultraparallel computing, SIAM Journal on Scientific Computing 33, 2011). With x_1 = W b / theta,

    x_{k+1} = x_k + alpha_k W (b - A x_k) + beta_k (x_k - x_{k-1})

(Y. Saad, Iterative Methods for Sparse Linear Systems, 2003, section 12.3).
"""

import math
from collections.abc import Iterator
from typing import NamedTuple

import taichi as ti

from tipfem.backend.array_types import Reals1, Template
from tipfem.backend.launch import kernel
from tipfem.fem.jacobian import block_entry
from tipfem.linalg.sparsity import Csr

ROW = 30.0  # nanoseconds of one thread for a particle in the kernels here
# The viscous number nu dt / h^2 from which on the polynomial pays; by how much the largest eigenvalue of A exceeds the
# least, over that number; the largest ratio that a polynomial is made for, and its degree over the ratio's square root.
FROM, RATIO, MOST, DEGREES = 0.5, 13.0, 100.0, 1.2
# One over the sum of absolute values in a row of A where the rows are not stored, less than which it is seldom.
LIKELY = 1.0 / 3.0


class Polynomial(NamedTuple):
    """Degree, 0 for none, and the lowest eigenvalue it is made for."""

    degree: "int"
    lowest: "float"


def polynomial(viscous_number: float) -> Polynomial:
    """The polynomial for a viscous number."""
    if viscous_number < FROM:
        return Polynomial(0, 1.0)
    ratio = min(1.0 + RATIO * viscous_number, MOST)
    return Polynomial(math.ceil(DEGREES * math.sqrt(ratio)), 1.0 / ratio)


def factors(given: Polynomial) -> Iterator[tuple[float, float]]:
    """alpha_k and beta_k for k = 1, ..., up to the degree."""
    rho, lowest = (1.0 - given.lowest) / (1.0 + given.lowest), given.lowest
    for _ in range(1, given.degree):
        new = 1.0 / (2.0 * (1.0 + lowest) / (1.0 - lowest) - rho)
        yield 4.0 * new / (1.0 - lowest), new * rho
        rho = new


@ti.func
def first_factor(lowest):
    """1 / theta."""
    return 2.0 / (1.0 + lowest)


@ti.func
def first_rho(lowest):
    """delta / theta, from which `next_rho` goes on."""
    return (1.0 - lowest) / (1.0 + lowest)


@ti.func
def next_rho(rho, lowest):
    """rho_{k+1} from rho_k; alpha_k = 4 rho_{k+1} / (1 - lowest), beta_k = rho_{k+1} rho_k."""
    return 1.0 / (2.0 * (1.0 + lowest) / (1.0 - lowest) - rho)


@ti.func
def begin_row(weights: Template, z: Template, z_start, motion: Template, i, rows, lowest, dim: Template):
    """x_1 and x_0 = 0 at node i into ``motion`` (2 R d,), b being the displacements in z."""
    for m in ti.static(range(dim)):
        at = i * dim + m
        motion[at] = first_factor(lowest) * weights[at] * z[z_start + i * (dim + 1) + m]
        motion[rows * dim + at] = 0.0


@ti.func
def advance_row(
    matrix: Template,
    weights: Template,
    z: Template,
    z_start,
    motion: Template,
    i,
    k,
    alpha,
    beta,
    last,
    rows,
    dim: Template,
):
    """x_{k+1} at node i in place of x_{k-1} in ``motion``, or, if it is the ``last``, in place of b in z."""
    couplings = matrix.row_offsets[rows]
    now, other = ((k + 1) % 2) * rows * dim, (k % 2) * rows * dim
    left = ti.Vector.zero(float, dim)
    for s in range(matrix.row_offsets[i], matrix.row_offsets[i + 1]):
        for m in ti.static(range(dim)):
            u = motion[now + matrix.columns[s] * dim + m]
            for c in ti.static(range(dim)):
                left[c] -= matrix.values[block_entry(couplings, s, c, m, dim)] * u
    for m in ti.static(range(dim)):
        at, row = i * dim + m, z_start + i * (dim + 1) + m
        x = motion[now + at]
        x += alpha * weights[at] * (z[row] + left[m]) + beta * (x - motion[other + at])
        if last:
            z[row] = x
        else:
            motion[other + at] = x


@kernel
def weigh(matrix: Csr, weights: Reals1, rows: ti.i32, dim: Template, serial: Template):
    """W (R d,): one over the sums of absolute values of the rows of A; 0 of rows that are empty."""
    ti.loop_config(serialize=serial)
    for i in range(rows):
        couplings = matrix.row_offsets[rows]
        total = ti.Vector.zero(float, dim)
        for s in range(matrix.row_offsets[i], matrix.row_offsets[i + 1]):
            for c in ti.static(range(dim)):
                for m in ti.static(range(dim)):
                    total[c] += ti.abs(matrix.values[block_entry(couplings, s, c, m, dim)])
        for c in ti.static(range(dim)):
            weights[i * dim + c] = ti.select(total[c] > 0.0, 1.0 / ti.max(total[c], 1e-300), 0.0)


@kernel
def begin(
    weights: Reals1,
    z: Reals1,
    now: Reals1,
    before: Reals1,
    rows: ti.i32,
    lowest: float,
    dim: Template,
    serial: Template,
):
    """x_1 into ``now``, x_0 = 0 into ``before``, both with pressures 0, b being the displacements in z."""
    ti.loop_config(serialize=serial)
    for i in range(rows):
        for m in ti.static(range(dim + 1)):
            at = i * (dim + 1) + m
            now[at], before[at] = 0.0, 0.0
            if ti.static(m < dim):
                now[at] = first_factor(lowest) * weights[i * dim + m] * z[at]


@kernel
def advance(
    product: Reals1,
    weights: Reals1,
    z: Reals1,
    now: Reals1,
    before: Reals1,
    alpha: float,
    beta: float,
    rows: ti.i32,
    dim: Template,
    serial: Template,
):
    """x_{k+1} in place of x_{k-1} in ``before``, from ``product`` = K (x_k, 0) with x_k ``now``."""
    ti.loop_config(serialize=serial)
    for i in range(rows):
        for m in ti.static(range(dim)):
            at = i * (dim + 1) + m
            x = now[at]
            before[at] = x + alpha * weights[i * dim + m] * (z[at] - product[at]) + beta * (x - before[at])


@kernel
def conclude(x: Reals1, z: Reals1, rows: ti.i32, dim: Template, serial: Template):
    """The displacements of x in place of those of z."""
    ti.loop_config(serialize=serial)
    for i in range(rows):
        for m in ti.static(range(dim)):
            z[i * (dim + 1) + m] = x[i * (dim + 1) + m]
