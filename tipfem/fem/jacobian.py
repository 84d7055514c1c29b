"""Kernels for the Jacobian in rows: assembled once from the elements' linearisation, then applied to many vectors.

Row i couples particle i with the particles that share a cell with it, ``columns[row_offsets[i]:row_offsets[i + 1]]``,
itself first. Each coupling is a block of (d + 1) x (d + 1) numbers, scaled as the residual is: d rows of momentum and
one of continuity, by d columns of displacement and one of pressure. ``blocks`` (K (d + 1)^2,) holds them row by row; it
is flat because products with an array of two axes take Taichi a quarter longer. Vectors of unknowns and element
records are laid out as in `tipfem.fem.residual`.
"""

import taichi as ti

from tipfem.backend.array_types import Ints1, Ints2, Reals1, Reals2, Template
from tipfem.backend.launch import kernel
from tipfem.fem.element import gradient
from tipfem.fem.residual import linearisation

ROW = 30.0  # nanoseconds of one thread for a particle in `multiply`


@ti.func
def around(rows, own, other: Template):
    """Gradient of the shape function that follows ``own`` by ``other``, cyclically; see `gradient`."""
    dim = ti.static(rows.n)
    result = gradient(rows, other)
    for a in ti.static(range(1, dim + 1)):
        result = ti.select(own == a, gradient(rows, ti.static((a + other) % (dim + 1))), result)
    return result


@kernel
def gather_rows(
    cells: Ints2,
    offsets: Ints1,
    corners: Ints1,
    density: Reals1,
    lumping: Reals1,
    record: Reals2,
    scale: Reals1,
    row_offsets: Ints1,
    slots: Ints1,
    blocks: Reals1,
    cm: float,
    cv: float,
    cf: float,
    nodes: ti.i32,
    dim: Template,
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

    with the part lambda of the mass that is lumped, ``lumping`` (M,). ``slots`` as in `sparsity.find_neighbours`.
    """
    for i in range(nodes):
        first, last = row_offsets[i], row_offsets[i + 1]
        # The diagonal block is accumulated in registers. Gradients sum to zero, and so do the blocks of an element,
        # except for its mass, which sums to that of lumping, and the inertia in the stabilisation.
        own_uu, own_pp = ti.Matrix.zero(float, dim, dim), 0.0
        own_up, own_pu = ti.Vector.zero(float, dim), ti.Vector.zero(float, dim)
        scale_u, scale_p = ti.Vector.zero(float, dim), scale[i * (dim + 1) + dim]
        for k in ti.static(range(dim)):
            scale_u[k] = scale[i * (dim + 1) + k]
        for s in range(first, last):
            for t in range(ti.static((dim + 1) ** 2)):
                blocks[s * (dim + 1) ** 2 + t] = 0.0
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
            mass = density[e] * area / (dim + 1) * cm
            shared = mass * (1.0 - lumping[e]) / (dim + 1)
            for k in ti.static(range(dim)):
                own_uu[k, k] += scale_u[k] * mass  # of which the others' parts are subtracted below
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
                s = first + slots[c * dim + other - 1]
                for k in ti.static(range(dim)):
                    block[k, k] += shared
                for k in ti.static(range(dim)):
                    for m in ti.static(range(dim)):
                        entry = scale_u[k] * block[k, m]
                        own_uu[k, m] -= entry
                        blocks[s * (dim + 1) ** 2 + k * (dim + 1) + m] = (
                            blocks[s * (dim + 1) ** 2 + k * (dim + 1) + m] + entry
                        )
                    blocks[s * (dim + 1) ** 2 + k * (dim + 1) + dim] = (
                        blocks[s * (dim + 1) ** 2 + k * (dim + 1) + dim] + pressure[k]
                    )
                    blocks[s * (dim + 1) ** 2 + dim * (dim + 1) + k] = (
                        blocks[s * (dim + 1) ** 2 + dim * (dim + 1) + k] + growth[k]
                    )
                blocks[s * (dim + 1) ** 2 + dim * (dim + 2)] = blocks[s * (dim + 1) ** 2 + dim * (dim + 2)] + value
                own_pu -= growth
                own_pp -= value
        for k in ti.static(range(dim)):
            for m in ti.static(range(dim)):
                blocks[first * (dim + 1) ** 2 + k * (dim + 1) + m] = own_uu[k, m]
            blocks[first * (dim + 1) ** 2 + k * (dim + 1) + dim] = own_up[k]
            blocks[first * (dim + 1) ** 2 + dim * (dim + 1) + k] = own_pu[k]
        blocks[first * (dim + 1) ** 2 + dim * (dim + 2)] = own_pp


@ti.func
def row_product(
    row_offsets: Template,
    columns: Template,
    blocks: Template,
    x: Template,
    x_start,
    out: Template,
    out_start,
    i,
    dim: Template,
):
    """Particle i's rows of out = K x; x and out begin at ``x_start`` and ``out_start`` in their arrays."""
    force = ti.Vector.zero(float, dim)
    growth = 0.0
    for s in range(row_offsets[i], row_offsets[i + 1]):
        at = x_start + columns[s] * (dim + 1)
        p = x[at + dim]
        for m in ti.static(range(dim)):
            u = x[at + m]
            for k in ti.static(range(dim)):
                force[k] += blocks[s * (dim + 1) ** 2 + k * (dim + 1) + m] * u
            growth += blocks[s * (dim + 1) ** 2 + dim * (dim + 1) + m] * u
        for k in ti.static(range(dim)):
            force[k] += blocks[s * (dim + 1) ** 2 + k * (dim + 1) + dim] * p
        growth += blocks[s * (dim + 1) ** 2 + dim * (dim + 2)] * p
    at = out_start + i * (dim + 1)
    for k in ti.static(range(dim)):
        out[at + k] = force[k]
    out[at + dim] = growth


@kernel
def multiply(
    row_offsets: Ints1,
    columns: Ints1,
    blocks: Reals1,
    x: Reals1,
    out: Reals1,
    nodes: ti.i32,
    dim: Template,
    serial: Template,
):
    """out = K x."""
    ti.loop_config(serialize=serial)
    for i in range(nodes):
        row_product(row_offsets, columns, blocks, x, 0, out, 0, i, dim)
