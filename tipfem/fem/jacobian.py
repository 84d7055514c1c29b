"""Kernels for the Jacobian in rows: assembled once from the elements' linearisation, then applied to many vectors.

Row i couples particle i with the particles that share a cell with it, ``columns[row_offsets[i]:row_offsets[i + 1]]``,
itself first. Each of these K couplings is a block of (d + 1) x (d + 1) numbers, scaled as the residual is: d rows of
momentum and one of continuity, by d columns of displacement and one of pressure. ``blocks`` (K (d + 1)^2,) holds
momentum by displacement of all couplings first, then momentum by pressure, continuity by displacement, and continuity
by pressure, see `block_entry`: the preconditioner needs the second and the third alone, and would otherwise read all of
the memory twice more. It is flat because products with an array of two axes take Taichi a quarter longer. Vectors of
unknowns and element records are laid out as in `tipfem.fem.residual`.
"""

import numpy as np
import taichi as ti

from tipfem.backend.array_types import Ints1, Periods, Reals1, Reals2, Template
from tipfem.backend.launch import kernel
from tipfem.fem.bundles import Elements, Rates, Sizes, Topology
from tipfem.fem.element import gradient
from tipfem.fem.residual import ENDS, HOOP, PRESSURES, RADII, SHARES, law_slopes, linearisation
from tipfem.linalg.sparsity import Csr

ROW, GATHERED_ROW = 30.0, 200.0  # nanoseconds of one thread for a particle in `multiply` and in `gather_rows`


@ti.func
def block_entry(couplings, s, k: Template, m: Template, dim: Template):
    """Index of row ``k`` and column ``m`` of block ``s`` in ``blocks``, of so many ``couplings``."""
    at = s * dim * dim + k * dim + m
    if ti.static(k < dim and m == dim):
        at = couplings * dim * dim + s * dim + k
    elif ti.static(k == dim and m < dim):
        at = couplings * dim * (dim + 1) + s * dim + m
    elif ti.static(k == dim):
        at = couplings * dim * (dim + 2) + s
    return at


@ti.func
def around(rows, own, other: Template):
    """Gradient of the shape function that follows ``own`` by ``other``, cyclically; see `gradient`."""
    dim = ti.static(rows.n)
    result = gradient(rows, other)
    for a in ti.static(range(1, dim + 1)):
        result = ti.select(own == a, gradient(rows, ti.static((a + other) % (dim + 1))), result)
    return result


@ti.func
def clear_row(row_offsets: Template, blocks: Template, i, rows, dim: Template, full: Template):
    """Zeros in row ``i`` of ``rows``, in the blocks of momentum by displacement only if ``full``."""
    for s in range(row_offsets[i], row_offsets[i + 1]):
        for k in ti.static(range(dim + 1)):
            for m in ti.static(range(dim + 1)):
                if ti.static(full or k == dim or m == dim):
                    blocks[block_entry(row_offsets[rows], s, k, m, dim)] = 0.0


@kernel
def gather_rows(
    mesh: Topology,
    period: Periods,
    element: Elements,
    record: Reals2,
    scale: Reals1,
    matrix: Csr,
    slots: Ints1,
    rates: Rates,
    sizes: Sizes,
    rows: ti.i32,
    full: Template,
    serial: Template,
):
    """The derivative of the scaled residual, block by block; its sums are those of `matrix_free.jacobian_product`.

    With s_a = sigma g_a, M = cv I - cf l, f = J / rho grad p, and c_b = J_{n+1} grad_{n+1} phi_b, an element
    contributes for its nodes a, b

    momentum by displacement: w {mu [(g_a . g_b) M + g_b (x) M^T g_a] + cf [s_a (x) g_b - s_b (x) g_a]}
        + rho A / (d + 1) cm (lambda delta_ab + (1 - lambda) / (d + 1)) I
    momentum by pressure: -w g_a / (d + 1)
    continuity by displacement: A / (d + 1) c_b
        + A tau {cm / (d + 1) g_a + cf [(g_a . f) g_b - (g_a . g_b) f - (g_b . q) g_a]}
    continuity by pressure: A tau J / rho g_a . g_b

    If ``lawful``, the viscosity mu(g, p) with the shear rate g adds, with D = sym l, to momentum by displacement
    4 w mu_g / g (D g_a) (x) (M^T D g_b), and to momentum by pressure 2 w mu_p / (d + 1) D g_a.

    In an axisymmetric flow, with the means that `residual` takes, mu becomes mu R, A / (d + 1) c_b A <rho_{n+1} phi_a>
    c_b, A becomes A R_n, cm / (d + 1) cm omega_b, and there is more:

    momentum by displacement: w {cf c e_r h_a (x) g_b + cf c [mu / 3 (l + l^T) - <p phi_b>] g_a (x) e_r
        + 2/9 mu c^2 (cv - cf k) / R e_r (x) e_r},   h_a = 2 mu k / 3 - <p phi_a>;
        of a law, D g_a becomes R D g_a + c k / 3 e_r, and M^T D g_b has c k (cv - cf k) / (3 R) e_r in addition
    momentum by pressure: -w {(rho_b + 3 R) / 12 g_a + c (1 + delta_ab) / 12 e_r} in all
    continuity by displacement: A J_{n+1} c (1 + delta_ab) / 12 e_r + A R_n tau cf c / (3 R) (g_a . f) e_r

    with the part lambda of the mass that is lumped, ``lumping`` (M,). ``slots`` as in `sparsity.find_neighbours`. The
    matrix may have more ``rows`` than there are ``nodes``; these are zero. Momentum by displacement is left out unless
    ``full``.
    """
    lawful = ti.static(element.lawful)
    blocks = ti.static(matrix.values)
    cm, cv, cf = ti.static((rates.cm, rates.cv, rates.cf))
    nodes, dim = ti.static((sizes.nodes, sizes.dim))
    ti.loop_config(serialize=serial)
    for i in range(nodes, rows):
        clear_row(matrix.row_offsets, blocks, i, rows, dim, full)
    ti.loop_config(serialize=serial)
    for i in range(nodes):
        first, couplings = matrix.row_offsets[i], matrix.row_offsets[rows]
        # The diagonal block is accumulated in registers. Gradients sum to zero, and so do the blocks of an element,
        # except for its mass, which sums to that of lumping, the inertia in the stabilisation, and derivatives by the
        # radii of an axisymmetric flow.
        own_uu, own_pp = ti.Matrix.zero(float, dim, dim), 0.0
        own_up, own_pu = ti.Vector.zero(float, dim), ti.Vector.zero(float, dim)
        scale_u, scale_p = ti.Vector.zero(float, dim), scale[i * (dim + 1) + dim]
        for k in ti.static(range(dim)):
            scale_u[k] = scale[i * (dim + 1) + k]
        clear_row(matrix.row_offsets, blocks, i, rows, dim, full)
        for c in range(mesh.offsets[i], mesh.offsets[i + 1]):
            e = mesh.corners[c] // (dim + 1)
            own = mesh.corners[c] - e * (dim + 1)
            g_now, c_next, sigma, l, q, f, tail = linearisation(record, e, dim)
            w, area, stabilisation = tail[0], tail[1], tail[2]
            g_a = around(g_now, own, 0)
            more = ti.static(4 * dim * dim + 2 * dim + 5)
            axial = ti.static(len(period.shape) == 3)
            turn = ti.static(2.0 * np.pi)
            mean_r, viscous = 1.0, tail[4]
            if ti.static(axial):
                mean_r = (record[e, more + RADII] + record[e, more + RADII + 1] + record[e, more + RADII + 2]) / 3.0
                viscous = tail[4] * mean_r
            # Momentum by displacement, if it is wanted.
            cross = w * cf * sigma
            big_m = w * viscous * (cv * ti.Matrix.identity(float, dim) - cf * l)
            s_a, m_a = cross @ g_a, big_m.transpose() @ g_a
            f, q, by_pressure = stabilisation * cf * f, stabilisation * cf * q, stabilisation * tail[3]
            a_f, inertia = g_a.dot(f), stabilisation * cm / (dim + 1) * g_a
            pressure = -w / (dim + 1) * scale_u * g_a
            strain, stiffened = ti.Matrix.zero(float, dim, dim), ti.Vector.zero(float, dim)
            by_mean = ti.Vector.zero(float, dim)
            if ti.static(lawful):
                stiffens, of_hoops, by_law = law_slopes(record, e, dim, axial)
                strain = 0.5 * (l + l.transpose())
                strained, stiffened = 2.0 * w * (strain @ g_a), w * (stiffens @ g_a)
                if ti.static(axial):
                    strained, stiffened = mean_r * strained, mean_r * stiffened
                    strained[0] += w * turn * 2.0 * record[e, more + HOOP] / 3.0
                    stiffened[0] += w * turn * of_hoops / 3.0
                by_mean = by_law / (dim + 1) * scale_u * strained
                pressure += by_mean
            mass = element.density[e] * area / (dim + 1) * cm
            end = area / (dim + 1)
            # In an axisymmetric flow, what does not sum to zero: derivatives by the radii of the corners.
            of_hoop, stretched, hoop, widened, rounder = 0.0, 0.0, 0.0, 0.0, 0.0
            by_radius = ti.Vector.zero(float, dim)
            if ti.static(axial):
                of_hoop = w * turn * (2.0 * tail[4] * record[e, more + HOOP] / 3.0 - record[e, more + PRESSURES + own])
                stretched = record[e, more + HOOP + 1] * record[e, more + HOOP + 2] * turn / 12.0
                widened = turn / (3.0 * mean_r) * a_f
                hoop = w * turn * turn * 2.0 * tail[4] / 9.0 * (cv - cf * record[e, more + HOOP]) / mean_r
                by_radius = tail[4] / 3.0 * (l + l.transpose()) @ g_a * (w * cf * turn)
                end = record[e, more + ENDS + own] * record[e, more + HOOP + 2]
                mass = element.density[e] * area * record[e, more + SHARES + own] * cm
                pressed = 0.0
                for b in ti.static(range(dim + 1)):
                    pressed += record[e, more + PRESSURES + b]
                for k in ti.static(range(dim)):
                    own_uu[k, 0] += scale_u[k] * (3.0 * by_radius[k] - w * cf * turn * pressed * g_a[k])
                own_uu[0, 0] += scale_u[0] * 3.0 * hoop
                own_pu[0] += scale_p * (4.0 * stretched + 3.0 * widened)
                pressure = by_mean - w * (record[e, more + RADII + own] + 3.0 * mean_r) / 12.0 * scale_u * g_a
                pressure[0] -= w * turn / 6.0 * scale_u[0]
                if ti.static(lawful):
                    rounder = turn * record[e, more + HOOP] * (cv - cf * record[e, more + HOOP]) / (3.0 * mean_r)
                    for k in ti.static(range(dim)):
                        own_uu[k, 0] += scale_u[k] * 6.0 * stiffened[k] * rounder
            shared = mass * (1.0 - element.lumping[e]) / (dim + 1)
            for k in ti.static(range(dim)):
                own_uu[k, k] += scale_u[k] * mass  # of which the others' parts are subtracted below
            own_up += pressure
            own_pu += (dim + 1) * scale_p * inertia
            for other in ti.static(range(1, dim + 1)):
                g_b = around(g_now, own, other)
                both = g_a.dot(g_b)
                growth = end * around(c_next, own, other)
                # In variables of their own: on Vulkan, vectors that were set anew here were mixed up.
                pressure_b, inertia_b = pressure, inertia
                if ti.static(axial):
                    b = (own + other) % (dim + 1)
                    share = record[e, more + SHARES + b]
                    inertia_b = stabilisation * cm * share * g_a
                    growth[0] += stretched + widened
                    shared = mass * (1.0 - element.lumping[e]) * share
                    pressure_b = by_mean - w * (record[e, more + RADII + b] + 3.0 * mean_r) / 12.0 * scale_u * g_a
                    pressure_b[0] -= w * turn / 12.0 * scale_u[0]
                growth = scale_p * (growth + inertia_b + a_f * g_b - both * f - g_b.dot(q) * g_a)
                value = scale_p * by_pressure * both
                s = first + slots[c * dim + other - 1]
                if ti.static(full):
                    block = both * big_m + g_b.outer_product(m_a)
                    block += s_a.outer_product(g_b) - (cross @ g_b).outer_product(g_a)
                    if ti.static(lawful):
                        of_b = strain @ g_b
                        of_b = cv * of_b - cf * l.transpose() @ of_b
                        if ti.static(axial):
                            of_b[0] += rounder
                        block += 2.0 * stiffened.outer_product(of_b)
                    if ti.static(axial):
                        of_p = w * cf * turn * record[e, more + PRESSURES + (own + other) % (dim + 1)]
                        for k in ti.static(range(dim)):
                            block[0, k] += cf * of_hoop * g_b[k]
                            block[k, 0] += by_radius[k] - of_p * g_a[k]
                        block[0, 0] += hoop
                    for k in ti.static(range(dim)):
                        block[k, k] += shared
                    for k in ti.static(range(dim)):
                        for m in ti.static(range(dim)):
                            entry = scale_u[k] * block[k, m]
                            own_uu[k, m] -= entry
                            at = block_entry(couplings, s, k, m, dim)
                            blocks[at] = blocks[at] + entry
                for k in ti.static(range(dim)):
                    up, pu = block_entry(couplings, s, k, dim, dim), block_entry(couplings, s, dim, k, dim)
                    blocks[up] = blocks[up] + pressure_b[k]
                    blocks[pu] = blocks[pu] + growth[k]
                pp = block_entry(couplings, s, dim, dim, dim)
                blocks[pp] = blocks[pp] + value
                own_pu -= growth
                own_pp -= value
        for k in ti.static(range(dim)):
            if ti.static(full):
                for m in ti.static(range(dim)):
                    blocks[block_entry(couplings, first, k, m, dim)] = own_uu[k, m]
            blocks[block_entry(couplings, first, k, dim, dim)] = own_up[k]
            blocks[block_entry(couplings, first, dim, k, dim)] = own_pu[k]
        blocks[block_entry(couplings, first, dim, dim, dim)] = own_pp


@ti.func
def row_product(matrix: Template, x: Template, x_start, out: Template, out_start, i, nodes, dim: Template):
    """Node i's rows of out = K x, of ``nodes``; x and out begin at ``x_start`` and ``out_start`` in their arrays."""
    force = ti.Vector.zero(float, dim)
    growth = 0.0
    couplings = matrix.row_offsets[nodes]
    for s in range(matrix.row_offsets[i], matrix.row_offsets[i + 1]):
        at = x_start + matrix.columns[s] * (dim + 1)
        p = x[at + dim]
        for m in ti.static(range(dim)):
            u = x[at + m]
            for k in ti.static(range(dim)):
                force[k] += matrix.values[block_entry(couplings, s, k, m, dim)] * u
            growth += matrix.values[block_entry(couplings, s, dim, m, dim)] * u
        for k in ti.static(range(dim)):
            force[k] += matrix.values[block_entry(couplings, s, k, dim, dim)] * p
        growth += matrix.values[block_entry(couplings, s, dim, dim, dim)] * p
    at = out_start + i * (dim + 1)
    for k in ti.static(range(dim)):
        out[at + k] = force[k]
    out[at + dim] = growth


@kernel
def multiply(matrix: Csr, x: Reals1, out: Reals1, nodes: ti.i32, dim: Template, serial: Template):
    """out = K x."""
    ti.loop_config(serialize=serial)
    for i in range(nodes):
        row_product(matrix, x, 0, out, 0, i, nodes, dim)


@kernel
def add_product(matrix: Csr, x: Reals1, out: Reals1, nodes: ti.i32, dim: Template, serial: Template):
    """out += K x, of a matrix most of whose rows are empty."""
    ti.loop_config(serialize=serial)
    for i in range(nodes):
        couplings = matrix.row_offsets[nodes]
        for s in range(matrix.row_offsets[i], matrix.row_offsets[i + 1]):
            for k in ti.static(range(dim + 1)):
                total = 0.0
                for m in ti.static(range(dim + 1)):
                    total += matrix.values[block_entry(couplings, s, k, m, dim)] * x[matrix.columns[s] * (dim + 1) + m]
                out[i * (dim + 1) + k] = out[i * (dim + 1) + k] + total


@kernel
def clear_rows(row_offsets: Ints1, blocks: Reals1, nodes: ti.i32, rows: ti.i32, dim: Template):
    """Zeros in the rows from ``nodes`` to ``rows``."""
    for i in range(nodes, rows):
        clear_row(row_offsets, blocks, i, rows, dim, True)
