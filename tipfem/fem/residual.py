"""The kernel that assembles the residual, and linearises it on the elements.

It writes element vectors to a buffer and then gathers them per particle by the CSR lists of its
cells, so that results are repeatable bit by bit and no atomics are needed. Vectors of unknowns
are flat and interleaved: entry ``i * (d + 1) + k`` is displacement component k of particle i for
k < d, and its pressure for k = d. ``scale`` multiplies the rows; it is zero for fixed unknowns.
"""

import numpy as np
import taichi as ti

from tipfem.backend.array_types import Ints1, Periods, Reals1, Reals2, Template
from tipfem.backend.launch import kernel
from tipfem.backend.periodic import radius
from tipfem.case.rheology import LEAST_RATE
from tipfem.fem.bundles import Elements, Iterate, Linearisation, Rates, Sizes, Topology
from tipfem.fem.element import (
    cauchy_stress,
    cofactor,
    gradient,
    mean_with,
    reference_gradients,
    stabilisation_time,
    volume_change,
)
from tipfem.fem.rheology import shear_rate, stiffening, viscosity_by_law, with_hoop

# Nanoseconds of one thread for a node in `place_motion`, `join_unknowns` and `split_unknowns`, and for an element in
# `residual`.
UNKNOWN, ELEMENT = 4.0, 60.0
# First entries of the record of an axisymmetric flow after those of others: 2 pi r of the corners at the intermediate
# positions; means with their shape functions of 2 pi r at the end of the step, of 2 pi r at its start over its mean,
# and of the pressure; the hoop rate v_r / r, J of the cross-section, and its area. `AXIAL` is their number.
RADII, ENDS, SHARES, PRESSURES, HOOP, AXIAL = 0, 3, 6, 9, 12, 15


def record_width(dim: int, *, lawful: bool = False, axial: bool = False) -> int:
    """Entries of an element's linearisation, see `residual`; those of a ``lawful`` viscosity are the last ones."""
    return 4 * dim * dim + 2 * dim + 5 + (1 + 5 * (dim * dim + 1) if lawful else 0) + (AXIAL if axial else 0)


@ti.func
def law_slopes(record: ti.template(), e, dim: ti.template(), axial: ti.template()):
    """Slopes of an element's viscosity: `stiffening` (dim, dim) and that of the hoop, and mu's by the pressure."""
    at = ti.static(record_width(dim, axial=axial))
    return get_matrix(record, e, ti.static(at + 1), dim), record[e, at + 1 + dim * dim], record[e, at]


@ti.func
def displacement_of(x: ti.template(), i, dim: ti.template()):
    """Displacement (dim,) of particle ``i`` in a vector of unknowns."""
    return ti.Vector([x[i * (dim + 1) + k] for k in ti.static(range(dim))])


@ti.func
def put_matrix(record: ti.template(), e, start: ti.template(), a):
    """Write a matrix into an element's record."""
    for i in ti.static(range(a.n)):
        for j in ti.static(range(a.n)):
            record[e, start + i * a.n + j] = a[i, j]


@ti.func
def get_matrix(record: ti.template(), e, start: ti.template(), dim: ti.template()):
    """Read a matrix (dim, dim) from an element's record."""
    a = ti.Matrix.zero(float, dim, dim)
    for i in ti.static(range(dim)):
        for j in ti.static(range(dim)):
            a[i, j] = record[e, start + i * dim + j]
    return a


@ti.func
def get_vector(record: ti.template(), e, start: ti.template(), dim: ti.template()):
    """Read a vector (dim,) from a row of an array, an element's record for instance."""
    return ti.Vector([record[e, start + k] for k in ti.static(range(dim))])


@ti.func
def strain_rates(l, hoop, dim: ti.template()):
    """T = l + l^T (dim^2 + 1,) and last the same in the hoop's direction, of which half the square is g^2."""
    result = ti.Vector.zero(float, dim * dim + 1)
    for i in ti.static(range(dim)):
        for j in ti.static(range(dim)):
            result[i * dim + j] = l[i, j] + l[j, i]
    result[dim * dim] = 2.0 * hoop
    return result


@ti.func
def linearisation(record: ti.template(), e, dim: ti.template()):
    """An element's linearisation, see `residual`.

    Gradients g_1 ... g_d and c_1 ... c_d, sigma, l, q, J / rho grad p, and the vector of w, A, A tau, J / rho and the
    viscosity.
    """
    return (
        get_matrix(record, e, 0, dim),
        get_matrix(record, e, ti.static(dim * dim), dim),
        get_matrix(record, e, ti.static(2 * dim * dim), dim),
        get_matrix(record, e, ti.static(3 * dim * dim), dim),
        get_vector(record, e, ti.static(4 * dim * dim), dim),
        get_vector(record, e, ti.static(4 * dim * dim + dim), dim),
        get_vector(record, e, ti.static(4 * dim * dim + 2 * dim), 5),
    )


@ti.func
def gather_node(
    local: ti.template(),
    offsets: ti.template(),
    corners: ti.template(),
    scale: ti.template(),
    out: ti.template(),
    i,
    dim: ti.template(),
):
    """The entries of particle ``i`` in ``out``: sums of the element vectors at its corners, scaled."""
    total = ti.Vector.zero(float, dim + 1)
    for c in range(offsets[i], offsets[i + 1]):
        at = corners[c]
        for k in ti.static(range(dim + 1)):
            total[k] += local[at, k]
    for k in ti.static(range(dim + 1)):
        out[i * (dim + 1) + k] = scale[i * (dim + 1) + k] * total[k]


@ti.func
def gathered(local: ti.template(), corners: ti.template(), first, last, k, width: ti.template()):
    """Sum of component ``k`` of the element vectors at the corners ``first`` to ``last``."""
    total = 0.0
    for c in range(first, last):
        total += local[corners[c], k]
    return total


@kernel
def place_motion(
    position: Reals2,
    velocity: Reals2,
    acceleration: Reals2,
    owner: Ints1,
    motion: Reals2,
    dim: Template,
    serial: Template,
):
    """motion (P, 3 d): position, velocity and acceleration of the particle to which each of P nodes belongs."""
    ti.loop_config(serialize=serial)
    for i in range(owner.shape[0]):
        for k in ti.static(range(dim)):
            motion[i, k] = position[owner[i], k]
            motion[i, dim + k] = velocity[owner[i], k]
            motion[i, 2 * dim + k] = acceleration[owner[i], k]


@kernel
def join_unknowns(displacement: Reals2, pressure: Reals1, owner: Ints1, x: Reals2, dim: Template, serial: Template):
    """Rows of x (R, d + 1) of the P nodes: displacements (N, d) and pressures (N,) of their particles; others zero."""
    ti.loop_config(serialize=serial)
    for i in range(x.shape[0]):
        for k in ti.static(range(dim + 1)):
            x[i, k] = 0.0
        if i < owner.shape[0]:
            for k in ti.static(range(dim)):
                x[i, k] = displacement[owner[i], k]
            x[i, dim] = pressure[owner[i]]


@kernel
def split_unknowns(x: Reals2, displacement: Reals2, pressure: Reals1, dim: Template, serial: Template):
    """Displacements (N, d) and pressures (N,) of the particles, the first of the nodes with unknowns x (P, d + 1)."""
    ti.loop_config(serialize=serial)
    for i in range(pressure.shape[0]):
        for k in ti.static(range(dim)):
            displacement[i, k] = x[i, k]
        pressure[i] = x[i, dim]


@kernel
def residual(
    mesh: Topology,
    period: Periods,
    motion: Reals2,
    element: Elements,
    iterate: Iterate,
    scale: Reals1,
    linear: Linearisation,
    out: Reals1,
    rates: Rates,
    factor: float,
    sizes: Sizes,
    serial: Template,
):
    """Momentum and continuity residual at ``x``, scaled, and each element's linearisation.

    motion (N, 3 d): positions at the start, and the parts of v_alpha and of a_alpha - b that do not depend on the
    step's displacement u; v_alpha = cv u + motion[:, d : 2 d], a_alpha - b = cm u + motion[:, 2 d :].

    Momentum, node a:   w sigma g_a + rho A / (d + 1) (lambda (a_alpha,a - b_a) + (1 - lambda) mean(a_alpha - b)),
                        w = A J at the intermediate positions
    Continuity, node a: A (J_{n+1} - 1 - s) / (d + 1) + A tau g_a . q,  q = mean(a_alpha - b) + J / rho grad p
    (Carvalho & Sanches, eqs. 5 and 6; in eq. 6 both terms must carry the same sign.)

    In an axisymmetric flow with rho = 2 pi r, c = 2 pi, <f> the exact mean of f over the element, R = <rho>, the hoop
    rate k = c <v_r> / R and S = mu R (l + l^T) - <p rho> I:
    Momentum:   w (S g_a + c e_r (2 mu k / 3 - <p phi_a>)) + rho A <rho_n phi_a> (lambda (a_alpha,a - b_a)
                + (1 - lambda) sum_b omega_b (a_alpha,b - b_b)),   omega_b = <rho_n phi_b> / R_n
    Continuity: A (J_{n+1} <rho_{n+1} phi_a> - (1 + s) <rho_n phi_a>) + A R_n tau g_a . q
    With the same means of all terms, hydrostatic pressures balance gravity to round-off on any mesh. A law's shear
    rate has the hoop rate: g^2 = 2 D : D + 2 k^2.
    """
    record, local = ti.static(linear)
    x, base = ti.static(iterate)
    lawful = ti.static(element.lawful)
    cm, cv, cf, dt = ti.static(rates)
    elements, nodes, dim = ti.static(sizes)
    ti.loop_config(serialize=serial)
    for e in range(elements):
        axial = ti.static(len(period.shape) == 3)
        turn = ti.static(2.0 * np.pi)
        # 2 pi r of the corners at the start of the step, at the intermediate positions, and at the end.
        r_start, r_now, r_end = (
            ti.Vector.zero(float, dim + 1),
            ti.Vector.zero(float, dim + 1),
            ti.Vector.zero(float, dim + 1),
        )
        pressures = ti.Vector.zero(float, dim + 1)
        outwards, spread = 0.0, 0.0  # means of v_r and of u_r
        if ti.static(axial):
            for a in ti.static(range(dim + 1)):
                r_start[a] = radius(motion, period, mesh.cells[e, a])
        big_g, area = reference_gradients(mesh.cells, e, motion, period, dim)
        h = ti.Matrix.zero(float, dim, dim)
        l_ref = ti.Matrix.zero(float, dim, dim)
        grad_p = ti.Vector.zero(float, dim)
        inertia = ti.Vector.zero(float, dim)
        mean_p = 0.0
        # Everything is read before anything is written: the compiler would read again after a write.
        accelerations = ti.Matrix.zero(float, dim + 1, dim)
        for a in ti.static(range(dim + 1)):
            i = mesh.cells[e, a]
            u = displacement_of(x, i, dim)
            g = gradient(big_g, a)
            p = x[i * (dim + 1) + dim]
            h += u.outer_product(g)
            l_ref += (cv * u + get_vector(motion, i, dim, dim)).outer_product(g)
            acting = cm * u + get_vector(motion, i, ti.static(2 * dim), dim)
            for k in ti.static(range(dim)):
                accelerations[a, k] = acting[k]
            if ti.static(axial):
                r_now[a], r_end[a] = r_start[a] + turn * cf * u[0], r_start[a] + turn * u[0]
                outwards += (cv * u[0] + motion[i, dim]) / (dim + 1)
                spread += u[0] / (dim + 1)
                pressures[a] = p
                inertia += (r_start[a] / r_start.sum() + 1.0) / 4.0 * acting
            else:
                inertia += acting / (dim + 1)
            grad_p += p * g
            mean_p += p / (dim + 1)
        mu, rho, prescribed, lumped = element.viscosity[e], element.density[e], element.source[e], element.lumping[e]
        unit = ti.Matrix.identity(float, dim)
        f_inverse = (unit + cf * h).inverse()
        jacobian = 1.0 + volume_change(cf * h)
        w = area * jacobian
        g_now = big_g @ f_inverse
        l = l_ref @ f_inverse
        hoop, mean_start, mean_now = 0.0, 1.0, 1.0
        if ti.static(axial):
            mean_start, mean_now = r_start.sum() / 3.0, r_now.sum() / 3.0
            hoop = turn * outwards / mean_now
        at_start, by_pressure = mu, 0.0
        stiffens = ti.Vector.zero(float, dim * dim + 1)
        if ti.static(lawful):
            shear = shear_rate(l)
            if ti.static(axial):
                shear = with_hoop(shear, hoop)
            mu, slope, by_pressure, of_yield, m = viscosity_by_law(
                element.laws, element.fluid[e], shear, mean_p, area, dim
            )
            shear = ti.max(shear, LEAST_RATE)
            at, entries = ti.static(record_width(dim, axial=axial) + 2 + dim * dim, dim * dim + 1)
            turning = strain_rates(l, hoop, dim)
            stiffens = stiffening(record, e, at, turning, slope / shear, of_yield / shear, m, base, entries)
        grad_p = f_inverse.transpose() @ grad_p
        # In an axisymmetric flow: times R, with the hoop stress over R; the ratios of volumes are those of rings.
        ring, turned, pushed, stressed = area, jacobian, mean_p, mu
        if ti.static(axial):
            ring, turned = area * mean_start, jacobian * mean_now / mean_start
            pushed = (pressures.dot(r_now) + pressures.sum() * r_now.sum()) / 12.0
            stressed = mu * mean_now
        sigma = cauchy_stress(l, pushed, stressed)
        tau = stabilisation_time(area, rho, at_start, dt, factor, dim)
        pressure_force = turned / rho * grad_p
        q = inertia + pressure_force
        mass = rho * area / (dim + 1)
        grown = volume_change(h)
        growth = area * (grown - prescribed) / (dim + 1)
        for a in ti.static(range(dim + 1)):
            g = gradient(g_now, a)
            force = w * (sigma @ g)
            if ti.static(axial):
                share = mean_with(r_start, a)
                mass = rho * area * share
                force[0] += w * turn * (2.0 * mu * hoop / 3.0 - (pressures[a] + pressures.sum()) / 12.0)
                # The difference of two volumes, without cancellation.
                wider = turn * (x[mesh.cells[e, a] * (dim + 1)] + 3.0 * spread) / 12.0
                growth = area * (share * (grown - prescribed) + (grown + 1.0) * wider)
            for k in ti.static(range(dim)):
                acting = lumped * accelerations[a, k] + (1.0 - lumped) * inertia[k]
                local[e * (dim + 1) + a, k] = force[k] + mass * acting
            local[e * (dim + 1) + a, dim] = growth + ring * tau * g.dot(q)
        # (M^T with rows c_b = J_{n+1} grad_{n+1} phi_b)
        put_matrix(record, e, 0, g_now)
        put_matrix(record, e, ti.static(dim * dim), big_g @ cofactor(unit + h).transpose())
        put_matrix(record, e, ti.static(2 * dim * dim), sigma)
        put_matrix(record, e, ti.static(3 * dim * dim), l)
        for k in ti.static(range(dim)):
            record[e, 4 * dim * dim + k] = q[k]
            record[e, 4 * dim * dim + dim + k] = pressure_force[k]
        tail = ti.static(4 * dim * dim + 2 * dim)
        record[e, tail] = w
        record[e, tail + 1] = ring
        record[e, tail + 2] = ring * tau
        record[e, tail + 3] = turned / rho
        record[e, tail + 4] = mu
        if ti.static(lawful):
            at = ti.static(record_width(dim, axial=axial))
            record[e, at] = by_pressure
            for k in ti.static(range(dim * dim + 1)):
                record[e, at + 1 + k] = stiffens[k]
        if ti.static(axial):
            more = ti.static(4 * dim * dim + 2 * dim + 5)
            for a in ti.static(range(dim + 1)):
                record[e, more + RADII + a] = r_now[a]
                record[e, more + ENDS + a] = mean_with(r_end, a)
                record[e, more + SHARES + a] = mean_with(r_start, a) / mean_start
                record[e, more + PRESSURES + a] = (pressures[a] + pressures.sum()) / 12.0
            record[e, more + HOOP] = hoop
            record[e, more + HOOP + 1] = grown + 1.0
            record[e, more + HOOP + 2] = area
    ti.loop_config(serialize=serial)
    for i in range(nodes):
        gather_node(local, mesh.offsets, mesh.corners, scale, out, i, dim)
