"""Kernels of the matrix-free Newton-Krylov solve: products with the Jacobian, and with its blocks.

Vectors of unknowns and element records are laid out as in `tipfem.fem.residual`. With the blocks A, -G and D of the
Jacobian K (see `tipfem.fem.jacobian`), the continuity rows of K (r_u, 0) are D r_u, and the momentum rows of K (0, p)
are -G p: the preconditioner needs only products with K.
"""

import taichi as ti

from tipfem.backend.array_types import Reals1, Template
from tipfem.backend.launch import kernel
from tipfem.fem.bundles import Elements, Linearisation, Rates, Sizes, Topology
from tipfem.fem.element import cauchy_stress, gradient
from tipfem.fem.residual import displacement_of, gather_node, law_slopes, linearisation
from tipfem.linalg.multigrid.grid_hierarchy import RHS, SOLUTION

PARTICLE = 4.0  # nanoseconds of one thread for a particle in the kernels with ``serial``


@kernel
def jacobian_product(
    mesh: Topology,
    element: Elements,
    linear: Linearisation,
    scale: Reals1,
    x: Reals1,
    out: Reals1,
    rates: Rates,
    sizes: Sizes,
):
    """Exact derivative of the scaled residual along ``x``, from the elements' linearisation.

    With L = cf sum_b du_b (x) g_b:  d(w sigma g_a) = w (tr L sigma + dsigma - sigma L^T) g_a,
    dl = (cv / cf) L - l L,  d(g_a . q) = g_a . (dq - L q),  dJ_{n+1} = sum_b c_b . du_b.
    If ``lawful``, dmu = (mu_g / g) 2 D : dl + mu_p dp, the former along `tipfem.fem.rheology.stiffening`.
    """
    record, local = ti.static(linear)
    lawful = ti.static(element.lawful)
    cm, cv, cf = ti.static((rates.cm, rates.cv, rates.cf))
    elements, nodes, dim = ti.static(sizes)
    for e in range(elements):
        g_now, c_next, sigma, l, q, pressure_force, tail = linearisation(record, e, dim)
        w, area = tail[0], tail[1]
        h = ti.Matrix.zero(float, dim, dim)
        grad_p = ti.Vector.zero(float, dim)
        mean_u = ti.Vector.zero(float, dim)
        mean_p = 0.0
        growth = 0.0
        for a in ti.static(range(dim + 1)):
            i = mesh.cells[e, a]
            u = displacement_of(x, i, dim)
            p = x[i * (dim + 1) + dim]
            g = gradient(g_now, a)
            h += u.outer_product(g)
            grad_p += p * g
            mean_u += u / (dim + 1)
            mean_p += p / (dim + 1)
            growth += gradient(c_next, a).dot(u)
        big_l = cf * h
        rate = cv * h - l @ big_l
        stress = cauchy_stress(rate, mean_p, tail[4])
        if ti.static(lawful):
            stiffens, _of_hoop, by_pressure = law_slopes(record, e, dim, False)
            twice = l + l.transpose()
            stress += (twice * rate).sum() * stiffens + by_pressure * mean_p * twice
        stress += big_l.trace() * sigma - sigma @ big_l.transpose()
        dq = cm * mean_u + big_l.trace() * pressure_force + tail[3] * grad_p
        dq -= big_l.transpose() @ pressure_force + big_l @ q
        mass, lumped = element.density[e] * area / (dim + 1) * cm, element.lumping[e]
        for a in ti.static(range(dim + 1)):
            g = gradient(g_now, a)
            force = w * (stress @ g)
            force += mass * (lumped * displacement_of(x, mesh.cells[e, a], dim) + (1.0 - lumped) * mean_u)
            for k in ti.static(range(dim)):
                local[e * (dim + 1) + a, k] = force[k]
            local[e * (dim + 1) + a, dim] = area / (dim + 1) * growth + tail[2] * g.dot(dq)
    for i in range(nodes):
        gather_node(local, mesh.offsets, mesh.corners, scale, out, i, dim)


@kernel
def copy(x: Reals1, out: Reals1, size: ti.i32, serial: Template):
    """out = x."""
    ti.loop_config(serialize=serial)
    for k in range(size):
        out[k] = x[k]


@kernel
def copy_displacements(r: Reals1, out: Reals1, nodes: ti.i32, dim: Template, serial: Template):
    """out = (r_u, 0)."""
    ti.loop_config(serialize=serial)
    for i in range(nodes):
        for k in ti.static(range(dim)):
            out[i * (dim + 1) + k] = r[i * (dim + 1) + k]
        out[i * (dim + 1) + dim] = 0.0


@kernel
def copy_pressures(vectors: Reals1, out: Reals1, nodes: ti.i32, dim: Template, serial: Template):
    """out = (0, p), p the solution in ``vectors``, see `tipfem.linalg.multigrid.grid_hierarchy`."""
    ti.loop_config(serialize=serial)
    for i in range(nodes):
        for k in ti.static(range(dim)):
            out[i * (dim + 1) + k] = 0.0
        out[i * (dim + 1) + dim] = vectors[SOLUTION * nodes + i]


@kernel
def schur_rhs(
    r: Reals1, product: Reals1, scale: Reals1, vectors: Reals1, nodes: ti.i32, dim: Template, serial: Template
):
    """r_p - D r_u without the scale of the rows, with ``product`` = K (r_u, 0); 0 where pressure is pinned.

    It is the right-hand side in ``vectors``. `tipfem.step.block_preconditioner.schur_rhs` computes it from the rows.
    """
    ti.loop_config(serialize=serial)
    for i in range(nodes):
        row = i * (dim + 1) + dim
        vectors[RHS * nodes + i] = 0.0
        if scale[row] > 0.0:
            vectors[RHS * nodes + i] = (r[row] - product[row]) / scale[row]


@kernel
def block_correction(
    r: Reals1, product: Reals1, vectors: Reals1, out: Reals1, nodes: ti.i32, dim: Template, serial: Template
):
    """out = (r_u + G z_p, z_p) with z_p the solution in ``vectors`` and ``product`` = K (0, z_p)."""
    ti.loop_config(serialize=serial)
    for i in range(nodes):
        for k in ti.static(range(dim)):
            out[i * (dim + 1) + k] = r[i * (dim + 1) + k] - product[i * (dim + 1) + k]
        out[i * (dim + 1) + dim] = vectors[SOLUTION * nodes + i]
