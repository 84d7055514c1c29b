"""The mass matrix of the elements, lumped or consistent.

An element of density rho and measure A has the masses

    M_ab = rho A / (d + 1) (lambda delta_ab + (1 - lambda) / (d + 1))

with the part lambda that is lumped. With lambda = 1 each particle has an equal part of the element; with
lambda = 1 / (d + 2) the matrix is consistent, M_ab = int rho phi_a phi_b: rho A / 12 (1 + delta_ab) in 2-D and
rho V / 20 (1 + delta_ab) in 3-D (O. C. Zienkiewicz, R. L. Taylor, The Finite Element Method, volume 1, 5th ed., 2000,
section 17.2). Rows sum to rho A / (d + 1) with any lambda, and so momentum, weight, and the force of gravity on each
particle of a fluid at rest are those of the lumped masses m. For other fields

    a^T M b = sum_i m_i a_i . b_i - sum_e (1 - lambda) rho A / (d + 1) sum_a (a_a - mean a) . (b_a - mean b).

In an axisymmetric flow M_ab = rho A (lambda omega_a delta_ab + (1 - lambda) omega_a omega_b) with the volume A of the
ring and the means omega_a of 2 pi r phi_a over that of 2 pi r, and omega_a are the weights of means and sums, too.
"""

from typing import NamedTuple

import numpy as np
import taichi as ti

from tipfem.backend.array_types import Ints2, Periods, Reals1, Reals2, Template
from tipfem.backend.arrays import partials
from tipfem.backend.launch import add_parts, kernel, launch, part_of
from tipfem.fem.element import parts_of, row
from tipfem.typing import Array

ELEMENT = 10.0  # nanoseconds of one thread for an element in `deviation`
PARTICLE = 2.0  # and for a particle in `add_products`


class Masses(NamedTuple):
    """Properties (M,) of elements; ``lumping`` is lambda."""

    density: "Reals1"
    measure: "Reals1"
    lumping: "Reals1"


def consistent_part(dimension: int) -> float:
    """lambda of a consistent mass matrix: the part of it that is lumped."""
    return 1 / (dimension + 2)


def lumped_part(kind: str, cells: Array, fraction: Array, count: int) -> Array:
    """lambda (M,) of the elements for a kind of mass matrix, see `tipfem.Numerics`; fluids have a fraction (M, F)."""
    consistent = consistent_part(cells.shape[1] - 1)
    if kind != "interfaces":
        return np.full(len(cells), 1.0 if kind == "lumped" else consistent)
    fluids = np.zeros(count, dtype=np.int8)
    for part in fraction.T:
        there = np.zeros(count, dtype=bool)
        there[cells[part > 0]] = True
        fluids += there
    return np.where((fluids > 1)[cells].any(axis=1), consistent, 1.0)


def product(mass: Array, a: Array, b: Array) -> float:
    """sum_i m_i a_i . b_i with lumped masses (N,), for fields a and b (N, d)."""
    result = np.zeros(1)
    fields = map(np.ascontiguousarray, (mass, a, b))
    launch(add_products, *fields, partials(1), result, work=(len(mass), PARTICLE))
    return float(result[0])


@kernel
def add_products(
    mass: Reals1,
    a: Reals2,
    b: Reals2,
    partial: Reals2,
    result: Reals1,
    parts: ti.i32,
    stride: Template,
    serial: Template,
):
    """Add sum_i m_i a_i . b_i to result (1,); see `product`."""
    ti.loop_config(serialize=serial)
    for t in range(parts * stride):
        total = 0.0
        first, last = part_of(t, parts, stride, mass.shape[0])
        for i in range(first, last):
            for k in range(a.shape[1]):
                total += mass[i] * a[i, k] * b[i, k]
        if t % stride == 0:
            partial[t // stride, 0] = total
    ti.loop_config(serialize=True)
    for k in range(1):
        add_parts(result, partial, k, parts)


@kernel
def deviation(
    cells: Ints2,
    position: Reals2,
    period: Periods,
    of: Masses,
    a: Reals2,
    b: Reals2,
    partial: Reals2,
    result: Reals1,
    dim: Template,
    parts: ti.i32,
    stride: Template,
    serial: Template,
):
    """Add sum_i m_i a_i . b_i - a^T M b to result (1,), for fields a and b (N, d); see above."""
    ti.loop_config(serialize=serial)
    for t in range(parts * stride):
        total = 0.0
        first, last = part_of(t, parts, stride, cells.shape[0])
        for e in range(first, last):
            mean_a, mean_b, product = ti.Vector.zero(float, dim), ti.Vector.zero(float, dim), 0.0
            if ti.static(len(period.shape) == 3):
                shares = parts_of(1.0, position, cells, period, e)
                for k in ti.static(range(dim + 1)):
                    mean_a += shares[k] * row(a, cells[e, k], dim)
                    mean_b += shares[k] * row(b, cells[e, k], dim)
                for k in ti.static(range(dim + 1)):
                    product += shares[k] * (row(a, cells[e, k], dim) - mean_a).dot(row(b, cells[e, k], dim) - mean_b)
                total += (1.0 - of.lumping[e]) * of.density[e] * of.measure[e] * product
                continue
            for k in ti.static(range(dim + 1)):
                mean_a += row(a, cells[e, k], dim) / (dim + 1)
                mean_b += row(b, cells[e, k], dim) / (dim + 1)
            for k in ti.static(range(dim + 1)):
                product += (row(a, cells[e, k], dim) - mean_a).dot(row(b, cells[e, k], dim) - mean_b)
            total += (1.0 - of.lumping[e]) * of.density[e] * of.measure[e] / (dim + 1) * product
        if t % stride == 0:
            partial[t // stride, 0] = total
    ti.loop_config(serialize=True)
    for k in range(1):
        add_parts(result, partial, k, parts)
