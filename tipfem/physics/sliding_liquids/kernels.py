"""Kernels of the slips at interface particles, see `tipfem.physics.sliding_liquids.slip`; serial, as there are few."""

from typing import NamedTuple

import taichi as ti

from tipfem.backend.array_types import Ints1, Ints2, Reals1, Reals2, Template
from tipfem.backend.launch import kernel


class Sliding(NamedTuple):
    """The C slips, as `InterfaceSlip` has them."""

    owner: Ints1
    tangent: Reals2
    part: Reals1
    offsets: Ints1
    beside: Ints1
    weight: Reals1


class Around(NamedTuple):
    """The K cells around them."""

    nodes: Ints2  # (K, d + 1)
    corner: Ints2  # (K, (d + 1) (d - 1)) the slips of each corner, -1 for none
    share: Reals2  # (K, d + 1)
    mass: Reals1  # (K,) [kg]


@kernel
def find_slips(slip: Sliding, field: Reals2, slips: Reals1, dim: Template):
    """slips (C,): s of a field (N, d), of which more columns are not read."""
    ti.loop_config(serialize=True)
    for c in range(slips.shape[0]):
        total, p = 0.0, slip.owner[c]
        for k in ti.static(range(dim)):
            mean = 0.0
            for j in range(slip.offsets[c], slip.offsets[c + 1]):
                mean += slip.weight[j] * field[slip.beside[j], k]
            total += (mean - field[p, k]) * slip.tangent[c, k]
        slips[c] = slip.part[c] * total


@ti.func
def slid_at(tangent: Template, corner: Template, slips: Template, e, i, dim: Template):
    """Z s (d,) of slips (C,) at corner ``i`` of cell ``e``."""
    result = ti.Vector.zero(ti.f64, dim)
    for r in ti.static(range(dim - 1)):
        c = corner[e, i * (dim - 1) + r]
        if c >= 0:
            for k in ti.static(range(dim)):
                result[k] += slips[c] * tangent[c, k]
    return result


@kernel
def add_products(
    around: Around,
    tangent: Reals2,
    a: Reals2,
    b: Reals2,
    slips_a: Reals1,
    slips_b: Reals1,
    lumpings: Reals2,
    sums: Reals1,
    dim: Template,
):
    """Add to sums (L,) what the slips (C,) of fields a, b (N, d) contribute to a^T M b, of L parts ``lumpings`` (L, K).

    With Z s what slides: Z s_a M (b + Z s_b) + a M Z s_b.
    """
    ti.loop_config(serialize=True)
    for e in range(around.mass.shape[0]):
        own, mean = 0.0, ti.Matrix.zero(ti.f64, 4, dim)
        for i in ti.static(range(dim + 1)):
            p, share = around.nodes[e, i], around.share[e, i]
            slid = slid_at(tangent, around.corner, slips_a, e, i, dim)
            other = slid_at(tangent, around.corner, slips_b, e, i, dim)
            for k in ti.static(range(dim)):
                whole = b[p, k] + other[k]
                own += share * (slid[k] * whole + a[p, k] * other[k])
                mean[0, k] += share * slid[k]
                mean[1, k] += share * whole
                mean[2, k] += share * a[p, k]
                mean[3, k] += share * other[k]
        mixed = 0.0
        for k in ti.static(range(dim)):
            mixed += mean[0, k] * mean[1, k] + mean[2, k] * mean[3, k]
        for m in range(lumpings.shape[0]):
            part = lumpings[m, e]
            sums[m] = sums[m] + around.mass[e] * (part * own + (1.0 - part) * mixed)
