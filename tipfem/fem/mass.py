"""The mass matrix of the elements, lumped or consistent.

An element of density rho and measure A has the masses

    M_ab = rho A / (d + 1) (lambda delta_ab + (1 - lambda) / (d + 1))

with the part lambda that is lumped. With lambda = 1 each particle has an equal part of the element; with
lambda = 1 / (d + 2) the matrix is consistent, M_ab = int rho phi_a phi_b: rho A / 12 (1 + delta_ab) in 2-D and
rho V / 20 (1 + delta_ab) in 3-D (O. C. Zienkiewicz, R. L. Taylor, The Finite Element Method, volume 1, 5th ed., section
17.2). Rows sum to rho A / (d + 1) with any lambda, and so momentum, weight, and the force of gravity on each particle of
a fluid at rest are those of the lumped masses m. For other fields

    a^T M b = sum_i m_i a_i . b_i - sum_e (1 - lambda) rho A / (d + 1) sum_a (a_a - mean a) . (b_a - mean b).
"""

import taichi as ti

from tipfem.backend.array_types import Ints2, Reals1, Reals2, Template
from tipfem.backend.launch import kernel, part_of
from tipfem.fem.element import row

ELEMENT = 10.0  # nanoseconds of one thread for an element in `deviation`


def lumped_part(mass: str, dimension: int) -> float:
    """lambda for a kind of mass matrix, "lumped" or "consistent", see `tipfem.Numerics`."""
    return 1.0 if mass == "lumped" else 1 / (dimension + 2)


@kernel
def deviation(
    cells: Ints2,
    density: Reals1,
    measure: Reals1,
    a: Reals2,
    b: Reals2,
    partial: Reals2,
    result: Reals1,
    lumping: float,
    dim: Template,
    parts: ti.i32,
    stride: Template,
    serial: Template,
):
    """Add sum_i m_i a_i . b_i - a^T M b to result (1,), for fields a and b (N, d); see above.

    density, measure (M,); lumping is lambda.
    """
    ti.loop_config(serialize=serial)
    for t in range(parts * stride):
        total = 0.0
        first, last = part_of(t, parts, stride, cells.shape[0])
        for e in range(first, last):
            mean_a, mean_b = ti.Vector.zero(float, dim), ti.Vector.zero(float, dim)
            for k in ti.static(range(dim + 1)):
                mean_a += row(a, cells[e, k], dim) / (dim + 1)
                mean_b += row(b, cells[e, k], dim) / (dim + 1)
            product = 0.0
            for k in ti.static(range(dim + 1)):
                product += (row(a, cells[e, k], dim) - mean_a).dot(row(b, cells[e, k], dim) - mean_b)
            total += density[e] * measure[e] * product
        if t % stride == 0:
            partial[t // stride, 0] = total * (1.0 - lumping) / (dim + 1)
    ti.loop_config(serialize=True)
    for c in range(parts):
        result[0] = result[0] + partial[c, 0]
