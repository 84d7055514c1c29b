"""Kernels for the Jacobian in rows: gathered once from the elements' linearisation, then multiplied with many vectors.

Row i couples particle i with the particles that share a cell with it, ``columns[row_offsets[i]:row_offsets[i + 1]]``,
itself first. Its blocks stand in four arrays: ``uu`` (K, d * d) momentum by displacement, ``up`` (K, d) momentum by
pressure, ``pu`` (K, d) continuity by displacement, ``pp`` (K,) continuity by pressure, all flat and scaled as the
residual is. Vectors of unknowns and element records are laid out as in `tipfem.fem.residual`.
"""

import taichi as ti

from tipfem.backend.launch import kernel
from tipfem.fem.element import gradient
from tipfem.fem.residual import displacement_of, linearisation


@ti.func
def around(rows, own, other: ti.template()):
    """Gradient of the shape function that comes ``other`` behind ``own``, round and round; see `gradient`."""
    dim = ti.static(rows.n)
    result = gradient(rows, other)
    for a in ti.static(range(1, dim + 1)):
        result = ti.select(own == a, gradient(rows, ti.static((a + other) % (dim + 1))), result)
    return result


@kernel
def gather_rows(
    cells: ti.types.ndarray(),
    offsets: ti.types.ndarray(),
    corners: ti.types.ndarray(),
    density: ti.types.ndarray(),
    record: ti.types.ndarray(),
    scale: ti.types.ndarray(),
    row_offsets: ti.types.ndarray(),
    places: ti.types.ndarray(),
    uu: ti.types.ndarray(),
    up: ti.types.ndarray(),
    pu: ti.types.ndarray(),
    pp: ti.types.ndarray(),
    cm: float,
    cv: float,
    cf: float,
    nodes: ti.i32,
    dim: ti.template(),
):
    """The derivative of the scaled residual, block by block; its sums are those of `matrix_free.jacobian_product`.

    With s_a = sigma g_a, M = cv I - cf l, f = J / rho grad p, and c_b = J_{n+1} grad_{n+1} phi_b, an element adds for
    its nodes a, b

    uu: w {mu [(g_a . g_b) M + g_b (x) M^T g_a] + cf [s_a (x) g_b - s_b (x) g_a]} + delta_ab rho A / (d + 1) cm I
    up: -w g_a / (d + 1)
    pu: A / (d + 1) c_b + A tau {cm / (d + 1) g_a + cf [(g_a . f) g_b - (g_a . g_b) f - (g_b . q) g_a]}
    pp: A tau J / rho g_a . g_b

    ``relocation`` as in `sparsity.find_neighbours`.
    """
    for i in range(nodes):
        first, last = row_offsets[i], row_offsets[i + 1]
        # The block on the diagonal is summed up here. Gradients add to zero: so do the blocks of an element, but for
        # its mass and the inertia in the stabilisation.
        own_uu, own_pp = ti.Matrix.zero(float, dim, dim), 0.0
        own_up, own_pu = ti.Vector.zero(float, dim), ti.Vector.zero(float, dim)
        scale_u, scale_p = ti.Vector.zero(float, dim), scale[i * (dim + 1) + dim]
        for k in ti.static(range(dim)):
            scale_u[k] = scale[i * (dim + 1) + k]
        for t in range(first * dim * dim, last * dim * dim):
            uu[t] = 0.0
        for t in range(first * dim, last * dim):
            up[t] = 0.0
            pu[t] = 0.0
        for t in range(first, last):
            pp[t] = 0.0
        for c in range(offsets[i], offsets[i + 1]):
            e = corners[c] // (dim + 1)
            own = corners[c] - e * (dim + 1)
            g_now, c_next, sigma, l, q, f, tail = linearisation(record, e, dim)
            w, area, stabilisation = tail[0], tail[1], tail[2]
            g_a = around(g_now, own, 0)
            cross = w * cf * sigma
            big_m = w * tail[4] * (cv * ti.Matrix.identity(float, dim) - cf * l)
            s_a, m_a = cross @ g_a, big_m.transpose() @ g_a
            f, q, by_pressure = stabilisation * cf * f, stabilisation * cf * q, stabilisation * tail[3]
            a_f, inertia = g_a.dot(f), stabilisation * cm / (dim + 1) * g_a
            pressure = -w / (dim + 1) * scale_u * g_a
            for k in ti.static(range(dim)):
                own_uu[k, k] += scale_u[k] * (density[e] * area / (dim + 1) * cm)
            own_up += pressure
            own_pu += (dim + 1) * scale_p * inertia
            for other in ti.static(range(1, dim + 1)):
                g_b = around(g_now, own, other)
                both = g_a.dot(g_b)
                block = both * big_m + g_b.outer_product(m_a)
                block += s_a.outer_product(g_b) - (cross @ g_b).outer_product(g_a)
                growth = area / (dim + 1) * around(c_next, own, other)
                growth = scale_p * (growth + inertia + a_f * g_b - both * f - g_b.dot(q) * g_a)
                value = scale_p * by_pressure * both
                s = first + places[c * dim + other - 1]
                for k in ti.static(range(dim)):
                    for m in ti.static(range(dim)):
                        entry = scale_u[k] * block[k, m]
                        own_uu[k, m] -= entry
                        uu[s * dim * dim + k * dim + m] = uu[s * dim * dim + k * dim + m] + entry
                    up[s * dim + k] = up[s * dim + k] + pressure[k]
                    pu[s * dim + k] = pu[s * dim + k] + growth[k]
                pp[s] = pp[s] + value
                own_pu -= growth
                own_pp -= value
        for k in ti.static(range(dim)):
            for m in ti.static(range(dim)):
                uu[first * dim * dim + k * dim + m] = own_uu[k, m]
            up[first * dim + k] = own_up[k]
            pu[first * dim + k] = own_pu[k]
        pp[first] = own_pp


@ti.func
def row_product(
    row_offsets: ti.template(),
    columns: ti.template(),
    uu: ti.template(),
    up: ti.template(),
    pu: ti.template(),
    pp: ti.template(),
    x: ti.template(),
    begin,
    out: ti.template(),
    i,
    dim: ti.template(),
):
    """Particle i's rows of out = K x, of an ``x`` that begins at the entry ``begin``."""
    force = ti.Vector.zero(float, dim)
    growth = 0.0
    for s in range(row_offsets[i], row_offsets[i + 1]):
        at = begin + columns[s] * (dim + 1)
        p = x[at + dim]
        for m in ti.static(range(dim)):
            u = x[at + m]
            for k in ti.static(range(dim)):
                force[k] += uu[s * dim * dim + k * dim + m] * u
            growth += pu[s * dim + m] * u
        for k in ti.static(range(dim)):
            force[k] += up[s * dim + k] * p
        growth += pp[s] * p
    for k in ti.static(range(dim)):
        out[i * (dim + 1) + k] = force[k]
    out[i * (dim + 1) + dim] = growth


@ti.func
def schur_row(
    row_offsets: ti.template(),
    columns: ti.template(),
    pu: ti.template(),
    scale: ti.template(),
    r: ti.template(),
    begin,
    i,
    dim: ti.template(),
):
    """r_p - D r_u at particle i without the scale of the rows, from a scaled residual r that begins at ``begin``."""
    row = i * (dim + 1) + dim
    total = r[begin + row]
    for s in range(row_offsets[i], row_offsets[i + 1]):
        at = begin + columns[s] * (dim + 1)
        for k in ti.static(range(dim)):
            total -= pu[s * dim + k] * r[at + k]
    # Not where pressure is prescribed.
    return ti.select(scale[row] > 0.0, total / ti.max(scale[row], 1e-300), 0.0)


@ti.func
def correction_row(
    row_offsets: ti.template(),
    columns: ti.template(),
    up: ti.template(),
    r: ti.template(),
    pressure: ti.template(),
    out: ti.template(),
    begin,
    i,
    dim: ti.template(),
):
    """Particle i's entries of (r_u + G z_p, z_p), z_p = ``pressure`` (N,); r and out begin at ``begin``."""
    u = displacement_of(r, begin // (dim + 1) + i, dim)
    for s in range(row_offsets[i], row_offsets[i + 1]):
        p = pressure[columns[s]]
        for k in ti.static(range(dim)):
            u[k] -= up[s * dim + k] * p
    at = begin + i * (dim + 1)
    for k in ti.static(range(dim)):
        out[at + k] = u[k]
    out[at + dim] = pressure[i]


@kernel
def multiply(
    row_offsets: ti.types.ndarray(),
    columns: ti.types.ndarray(),
    uu: ti.types.ndarray(),
    up: ti.types.ndarray(),
    pu: ti.types.ndarray(),
    pp: ti.types.ndarray(),
    x: ti.types.ndarray(),
    out: ti.types.ndarray(),
    nodes: ti.i32,
    dim: ti.template(),
    serial: ti.template(),
):
    """out = K x."""
    ti.loop_config(serialize=serial)
    for i in range(nodes):
        row_product(row_offsets, columns, uu, up, pu, pp, x, 0, out, i, dim)


@kernel
def schur_right_side(
    row_offsets: ti.types.ndarray(),
    columns: ti.types.ndarray(),
    pu: ti.types.ndarray(),
    scale: ti.types.ndarray(),
    r: ti.types.ndarray(),
    out: ti.types.ndarray(),
    nodes: ti.i32,
    dim: ti.template(),
):
    """out (N,) = r_p - D r_u without the scale of the rows, from a scaled residual ``r``."""
    for i in range(nodes):
        out[i] = schur_row(row_offsets, columns, pu, scale, r, 0, i, dim)


@kernel
def pressure_correction(
    row_offsets: ti.types.ndarray(),
    columns: ti.types.ndarray(),
    up: ti.types.ndarray(),
    r: ti.types.ndarray(),
    pressure: ti.types.ndarray(),
    out: ti.types.ndarray(),
    nodes: ti.i32,
    dim: ti.template(),
):
    """out = (r_u + G z_p, z_p) with z_p = ``pressure`` (N,), which is 0 where pressure is prescribed."""
    for i in range(nodes):
        correction_row(row_offsets, columns, up, r, pressure, out, 0, i, dim)
