"""Kernels for the Jacobian in rows: gathered once from the elements' linearisation, then multiplied with many vectors.

Row i couples particle i with the particles that share a cell with it, ``columns[row_offsets[i]:row_offsets[i + 1]]``,
itself first. Its blocks stand in four arrays: ``uu`` (K, d * d) momentum by displacement, ``up`` (K, d) momentum by
pressure, ``pu`` (K, d) continuity by displacement, ``pp`` (K,) continuity by pressure, all flat and scaled as the
residual is. Vectors of unknowns and element records are laid out as in `tipfem.assembly`.
"""

import taichi as ti

from tipfem.assembly import get_matrix, get_vector, unknown
from tipfem.element import gradient


@ti.kernel
def gather_rows(
    cells: ti.types.ndarray(), offsets: ti.types.ndarray(), corners: ti.types.ndarray(),
    density: ti.types.ndarray(), record: ti.types.ndarray(), scale: ti.types.ndarray(),
    row_offsets: ti.types.ndarray(), places: ti.types.ndarray(),
    uu: ti.types.ndarray(), up: ti.types.ndarray(), pu: ti.types.ndarray(), pp: ti.types.ndarray(),
    cm: float, cv: float, cf: float, nodes: ti.i32, dim: ti.template(),
):  # fmt: skip
    """The derivative of the scaled residual, block by block; its sums are those of `assembly.jacobian_product`.

    With s_a = sigma g_a, M = cv I - cf l, f = J / rho grad p, and c_b = J_{n+1} grad_{n+1} phi_b, an element adds for
    its nodes a, b

    uu: w {mu [(g_a . g_b) M + g_b (x) M^T g_a] + cf [s_a (x) g_b - s_b (x) g_a]} + delta_ab rho A / (d + 1) cm I
    up: -w g_a / (d + 1)
    pu: A / (d + 1) c_b + A tau {cm / (d + 1) g_a + cf [(g_a . f) g_b - (g_a . g_b) f - (g_b . q) g_a]}
    pp: A tau J / rho g_a . g_b

    ``places`` as in `connectivity.list_neighbours`.
    """
    for i in range(nodes):
        first, last = row_offsets[i], row_offsets[i + 1]
        for s in range(first, last):
            for k in ti.static(range(dim * dim)):
                uu[s * dim * dim + k] = 0.0
            for k in ti.static(range(dim)):
                up[s * dim + k] = 0.0
                pu[s * dim + k] = 0.0
            pp[s] = 0.0
        for c in range(offsets[i], offsets[i + 1]):
            e = corners[c] // (dim + 1)
            own = corners[c] % (dim + 1)
            g_now = get_matrix(record, e, 0, dim)
            c_next = get_matrix(record, e, ti.static(dim * dim), dim)
            sigma = get_matrix(record, e, ti.static(2 * dim * dim), dim)
            l = get_matrix(record, e, ti.static(3 * dim * dim), dim)
            q = get_vector(record, e, ti.static(4 * dim * dim), dim)
            f = get_vector(record, e, ti.static(4 * dim * dim + dim), dim)
            tail = ti.static(4 * dim * dim + 2 * dim)
            w, area, stabilisation = record[e, tail], record[e, tail + 1], record[e, tail + 2]
            w_mu = w * record[e, tail + 4]
            big_m = cv * ti.Matrix.identity(float, dim) - cf * l
            g_a = ti.Vector.zero(float, dim)
            for a in ti.static(range(dim + 1)):
                if own == a:
                    g_a = gradient(g_now, a)
            s_a = sigma @ g_a
            m_a = big_m.transpose() @ g_a
            a_f = g_a.dot(f)
            for b in ti.static(range(dim + 1)):
                j = cells[e, b]
                g_b = gradient(g_now, b)
                both = g_a.dot(g_b)
                block = w_mu * (both * big_m + g_b.outer_product(m_a))
                block += w * cf * (s_a.outer_product(g_b) - (sigma @ g_b).outer_product(g_a))
                mass = density[e] * area / (dim + 1) * cm
                if j == i:
                    for k in ti.static(range(dim)):
                        block[k, k] += mass
                change = cm / (dim + 1) * g_a + cf * (a_f * g_b - both * f - g_b.dot(q) * g_a)
                growth = area / (dim + 1) * gradient(c_next, b) + stabilisation * change
                s = places[c * (dim + 1) + b]
                for k in ti.static(range(dim)):
                    for m in ti.static(range(dim)):
                        t = s * dim * dim + k * dim + m
                        uu[t] = uu[t] + block[k, m]
                    t = s * dim + k
                    up[t] = up[t] - w / (dim + 1) * g_a[k]
                    pu[t] = pu[t] + growth[k]
                pp[s] = pp[s] + stabilisation * record[e, tail + 3] * both
        for s in range(first, last):
            for k in ti.static(range(dim)):
                for m in ti.static(range(dim)):
                    t = s * dim * dim + k * dim + m
                    uu[t] = scale[i * (dim + 1) + k] * uu[t]
                up[s * dim + k] = scale[i * (dim + 1) + k] * up[s * dim + k]
                pu[s * dim + k] = scale[i * (dim + 1) + dim] * pu[s * dim + k]
            pp[s] = scale[i * (dim + 1) + dim] * pp[s]


@ti.kernel
def multiply(
    row_offsets: ti.types.ndarray(), columns: ti.types.ndarray(),
    uu: ti.types.ndarray(), up: ti.types.ndarray(), pu: ti.types.ndarray(), pp: ti.types.ndarray(),
    x: ti.types.ndarray(), out: ti.types.ndarray(), nodes: ti.i32, dim: ti.template(),
):  # fmt: skip
    """out = K x."""
    for i in range(nodes):
        force = ti.Vector.zero(float, dim)
        growth = 0.0
        for s in range(row_offsets[i], row_offsets[i + 1]):
            j = columns[s]
            u = unknown(x, j, dim)
            p = x[j * (dim + 1) + dim]
            for k in ti.static(range(dim)):
                for m in ti.static(range(dim)):
                    force[k] += uu[s * dim * dim + k * dim + m] * u[m]
                force[k] += up[s * dim + k] * p
                growth += pu[s * dim + k] * u[k]
            growth += pp[s] * p
        for k in ti.static(range(dim)):
            out[i * (dim + 1) + k] = force[k]
        out[i * (dim + 1) + dim] = growth


@ti.kernel
def schur_right_side(
    row_offsets: ti.types.ndarray(), columns: ti.types.ndarray(), pu: ti.types.ndarray(), scale: ti.types.ndarray(),
    r: ti.types.ndarray(), out: ti.types.ndarray(), nodes: ti.i32, dim: ti.template(),
):  # fmt: skip
    """out (N,) = r_p - D r_u without the scale of the rows, from a scaled residual ``r``."""
    for i in range(nodes):
        row = i * (dim + 1) + dim
        total = r[row]
        for s in range(row_offsets[i], row_offsets[i + 1]):
            u = unknown(r, columns[s], dim)
            for k in ti.static(range(dim)):
                total -= pu[s * dim + k] * u[k]
        # Not where pressure is prescribed.
        out[i] = ti.select(scale[row] > 0.0, total / ti.max(scale[row], 1e-300), 0.0)


@ti.kernel
def pressure_correction(
    row_offsets: ti.types.ndarray(), columns: ti.types.ndarray(), up: ti.types.ndarray(), scale: ti.types.ndarray(),
    r: ti.types.ndarray(), pressure: ti.types.ndarray(), out: ti.types.ndarray(), nodes: ti.i32, dim: ti.template(),
):  # fmt: skip
    """out = (r_u + G z_p, z_p) with z_p = ``pressure`` (N,), or 0 where it is prescribed and ``scale`` zero."""
    for i in range(nodes):
        u = unknown(r, i, dim)
        for s in range(row_offsets[i], row_offsets[i + 1]):
            j = columns[s]
            p = ti.select(scale[j * (dim + 1) + dim] > 0.0, pressure[j], 0.0)
            for k in ti.static(range(dim)):
                u[k] -= up[s * dim + k] * p
        for k in ti.static(range(dim)):
            out[i * (dim + 1) + k] = u[k]
        out[i * (dim + 1) + dim] = ti.select(scale[i * (dim + 1) + dim] > 0.0, pressure[i], 0.0)
