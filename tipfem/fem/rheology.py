"""Viscosity by the laws of `tipfem.case.rheology`, as Taichi functions and on all cells.

Where fluids yield, their stress is nearly T / g, of the direction of the rates T = 2 D alone, times the yield stress.
Newton's method overshoots there: it takes the direction on the way for that at its start, and goes on by halves of
corrections, or fails. With the direction as an unknown P of its own,

    P = r(g) T,   r(g) = (1 - exp(-m g)) / g,   or T - P / r(g) = 0,

the equations are far more nearly linear. A correction dT gives P + dP = r (T + dT) + P (r' / r) dg, cut to |P| <= 1 as
in a solution, and in the next one r T changes by r dT + r' dg P / r, which is exact where P = r T: at the start, and at
the end. P costs no unknown, since its equation is one of each element alone (T. F. Chan, G. H. Golub and P. Mulet, SIAM
J. Sci. Comput. 20, 1999, for total variations; J. C. De los Reyes and S. Gonzalez Andrade, J. Comput. Appl. Math. 235,
2010, for Bingham fluids).
"""

import numpy as np
import taichi as ti

from tipfem.backend.array_types import Ints1, Ints2, Periods, Reals1, Reals2, Template
from tipfem.backend.launch import kernel, launch
from tipfem.backend.periodic import radius
from tipfem.backend.real_functions import cube_root, exponential, power
from tipfem.case.rheology import CARREAU, GRANULAR, HERSCHEL_BULKLEY, LEAST_RATE, SMAGORINSKY
from tipfem.fem.element import gradient, reference_gradients, row
from tipfem.mesh.mesh import Mesh
from tipfem.typing import Array

CELL = 30.0  # nanoseconds of one thread for a cell in `viscosities`


@ti.func
def shear_rate(velocity_gradient):
    """g = sqrt(2 D : D) of a velocity gradient."""
    d = 0.5 * (velocity_gradient + velocity_gradient.transpose())
    return ti.sqrt(2.0 * (d * d).sum())


@ti.func
def with_hoop(shear, hoop):
    """The shear rate of an axisymmetric flow, from that in the plane (r, z) and the hoop rate v_r / r."""
    return ti.sqrt(shear * shear + 2.0 * hoop * hoop)


@ti.func
def regularised(m, g):
    """(1 - exp(-m g)) / g and its derivative by g; by series where it would cancel."""
    z = m * g
    part = m * (1.0 - 0.5 * z + z * z / 6.0)
    slope = m * m * (-0.5 + z / 3.0 - z * z / 8.0)
    if z > 1e-3:
        e = exponential(-z)
        part = (1.0 - e) / g
        slope = (z * e - 1.0 + e) / (g * g)
    return part, slope


@ti.func
def viscosity_by_law(laws: Template, f, shear, pressure, measure, dim: Template):
    """mu, and its derivatives by the shear rate and by the pressure, of fluid ``f``, a row of ``laws``.

    Of the first derivative also the part by r' of what yields, and the time m, see above; 0 without.
    """
    mu, slope, by_pressure = laws[f, 1], 0.0, 0.0
    of_yield, m = 0.0, 0.0
    g = ti.max(shear, LEAST_RATE)
    if laws[f, 0] == ti.static(float(HERSCHEL_BULKLEY)):
        yield_stress, index, least = laws[f, 1], laws[f, 3], laws[f, 5]
        mu = laws[f, 2]
        if index != 1.0:
            square = g * g + least * least
            mu *= power(square, 0.5 * (index - 1.0))
            slope = mu * (index - 1.0) * g / square
        m = laws[f, 4]
        part, change = regularised(m, g)
        mu += yield_stress * part
        of_yield = yield_stress * change
        slope += of_yield
    elif laws[f, 0] == ti.static(float(CARREAU)):
        base = 1.0 + (laws[f, 3] * g) ** 2
        more = (laws[f, 1] - laws[f, 2]) * power(base, 0.5 * (laws[f, 4] - 1.0))
        mu = laws[f, 2] + more
        slope = more * (laws[f, 4] - 1.0) * laws[f, 3] ** 2 * g / base
    elif laws[f, 0] == ti.static(float(GRANULAR)):
        mu = laws[f, 6]
        if pressure > 0.0:
            change, slow, fast = laws[f, 2], laws[f, 3] * ti.sqrt(pressure), laws[f, 4] * g
            friction, both = laws[f, 1] + change * fast / (slow + fast), (slow + fast) ** 2
            m = laws[f, 5]
            part, falling = regularised(m, g)
            mu += friction * pressure * part
            of_yield = pressure * friction * falling
            slope = pressure * change * laws[f, 4] * slow / both * part + of_yield
            by_pressure = part * (friction - 0.5 * change * fast * slow / both)
    elif laws[f, 0] == ti.static(float(SMAGORINSKY)):
        size2 = measure
        if ti.static(dim == 3):
            size2 = cube_root(measure) ** 2
        slope = laws[f, 2] * size2
        mu += slope * g
    return mu, slope, by_pressure, of_yield, m


@ti.func
def stiffening(record: Template, e, at: Template, rates, slope, of_yield, m, base, entries: Template):
    """Direction in which stress rises with the shear rate, times mu' / g: the derivative of mu T by T is that of mu.

    Args:
        record: of elements, from column ``at`` on with T and P (2, 2 entries) of two iterates.
        e: the element.
        rates: T (entries,), see `strain_rates`.
        slope: mu' / g.
        of_yield: the part of it by r'.
        m: the time, see `viscosity_by_law`.
        base: place, 0 or 1, of the iterate from which the last correction started, -1 for none; the present iterate is
            stored in the other place.
    """
    result = slope * rates
    if m > 0.0:
        g = ti.max(ti.sqrt(0.5 * rates.dot(rates)), LEAST_RATE)
        part, _falling = regularised(m, g)
        dual = part * rates
        if base >= 0:
            before, of_before = ti.Vector.zero(float, entries), ti.Vector.zero(float, entries)
            for k in ti.static(range(entries)):
                before[k] = record[e, at + 2 * entries * base + k]
                of_before[k] = record[e, at + 2 * entries * base + entries + k]
            g_before = ti.max(ti.sqrt(0.5 * before.dot(before)), LEAST_RATE)
            part_before, falling = regularised(m, g_before)
            rise = 0.5 * before.dot(rates - before) / g_before
            dual = part_before * rates + falling / part_before * rise * of_before
            dual /= ti.max(1.0, ti.sqrt(0.5 * dual.dot(dual)))
        place = at
        if base == 0:
            place = at + 2 * entries
        for k in ti.static(range(entries)):
            record[e, place + k] = rates[k]
            record[e, place + entries + k] = dual[k]
        result += of_yield * (dual / part - rates)
    return result


@kernel
def viscosities(
    cells: Ints2,
    position: Reals2,
    period: Periods,
    velocity: Reals2,
    pressure: Reals1,
    fluid: Ints1,
    laws: Reals2,
    rate: Reals1,
    out: Reals1,
    dim: Template,
    serial: Template,
):
    """rate (M,), out (M,): shear rate and viscosity of each cell at velocities (N, d) and pressures (N,)."""
    ti.loop_config(serialize=serial)
    for e in range(cells.shape[0]):
        big_g, area = reference_gradients(cells, e, position, period, dim)
        l, p = ti.Matrix.zero(float, dim, dim), 0.0
        for a in ti.static(range(dim + 1)):
            l += row(velocity, cells[e, a], dim).outer_product(gradient(big_g, a))
            p += pressure[cells[e, a]] / (dim + 1)
        rate[e] = shear_rate(l)
        if ti.static(len(period.shape) == 3):
            radii, outwards = 0.0, 0.0
            for a in ti.static(range(dim + 1)):
                radii += radius(position, period, cells[e, a])
                outwards += velocity[cells[e, a], 0]
            rate[e] = with_hoop(rate[e], 2.0 * ti.math.pi * outwards / radii)
        mu, _slope, _by_pressure, _of_yield, _m = viscosity_by_law(laws, fluid[e], rate[e], p, area, dim)
        out[e] = mu


def cell_fluids(mesh: Mesh) -> Array:
    """Fluid (M,) of each cell, int32; the first where interfaces do not run along edges."""
    return np.zeros(len(mesh.cells), dtype=np.int32) if mesh.fluid is None else mesh.fluid


def rates_and_viscosities(
    mesh: Mesh, velocity: Array, pressure: Array, fluid: Array, laws: Array
) -> tuple[Array, Array]:
    """Shear rates (M,) [1/s] and viscosities (M,) [Pa s] of the cells of a mesh, of the fluids (M,)."""
    rate, out = np.empty(len(mesh.cells)), np.empty(len(mesh.cells))
    given = np.ascontiguousarray(mesh.cells), np.ascontiguousarray(mesh.position), mesh.period.array
    fields = np.ascontiguousarray(velocity), np.ascontiguousarray(pressure), np.ascontiguousarray(fluid, dtype=np.int32)
    launch(viscosities, *given, *fields, laws, rate, out, mesh.dimension, work=(len(out), CELL))
    return rate, out
