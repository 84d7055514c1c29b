"""Differences of positions in kernels, where sides of the domain may be periodic, and radii of axisymmetric flows.

A kernel that reads the geometry of cells has a parameter ``period``, the array of `tipfem.geometry.period.Period`: of
two axes where a side is periodic, the widths and their inverses, each 0 along an axis that is not; of one axis, and not
read, where none is; of three, and not read, where the flow is axisymmetric. A kernel is compiled for each, so that
periodic sides and rings cost others nothing.
"""

import taichi as ti


@ti.func
def difference(x: ti.template(), period: ti.template(), a, b, k: ti.template()):  # type: ignore[no-untyped-def]
    """Component k of x[a] - x[b]; along a periodic axis that to the nearest image of b."""
    if ti.static(len(period.shape) == 2):
        d = x[a, k] - x[b, k]
        return d - period[0, k] * ti.floor(d * period[1, k] + 0.5)
    return x[a, k] - x[b, k]


@ti.func
def radius(x: ti.template(), period: ti.template(), i):  # type: ignore[no-untyped-def]
    """2 pi r [m] of row i where the flow is axisymmetric; 1 where it is planar."""
    if ti.static(len(period.shape) == 3):
        return 2.0 * ti.math.pi * x[i, 0]
    return 1.0


@ti.func
def middle(x: ti.template(), period: ti.template(), a, b, k: ti.template()):  # type: ignore[no-untyped-def]
    """Component k of the point midway between a and b, beside a where a side is periodic."""
    m = 0.5 * (x[a, k] + x[b, k])
    if ti.static(len(period.shape) == 2):
        m = x[a, k] + 0.5 * difference(x, period, b, a, k)
    return m
