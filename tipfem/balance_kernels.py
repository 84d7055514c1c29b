"""Kernel that sums up what the forces of a step did: work, element by element, and the force of the walls.

It reads what the last residual left behind, each element's linearisation (``record``) and element vectors
(``local``), so that it must run before another residual or Jacobian-vector product does.
"""

import taichi as ti

from tipfem.assembly import gathered, linearisation, unknown
from tipfem.device import part_of

WORKS = 6  # sums of `step_work` before the force of the walls


@ti.kernel
def step_work(
    cells: ti.types.ndarray(), offsets: ti.types.ndarray(), corners: ti.types.ndarray(),
    record: ti.types.ndarray(), source: ti.types.ndarray(), local: ti.types.ndarray(),
    wall: ti.types.ndarray(), x: ti.types.ndarray(), partial: ti.types.ndarray(), result: ti.types.ndarray(),
    cf: float, dt: float, elements: ti.i32, nodes: ti.i32, parts: ti.i32, spread: ti.template(),
    dim: ti.template(),
):  # fmt: skip
    """Work of the terms of the residual at ``x`` when it is tested with the displacements u and pressures p in ``x``.

    With L = sum_a u_a (x) g_a, H = sum_a u_a (x) G_a = (I - cf L)^-1 L, tau the viscous stress, and the
    invariants I2, I3 of H, result holds sums over the elements [J, per metre of depth in 2-D]:

    0: dt w tau : l, viscous dissipation;  1: w tau : L, work against the viscous stress
    2: A pbar ((2 cf - 1) I2 + (3 cf^2 - 1) I3) = pbar (w tr L - A (J_{n+1} - 1))  (without I3 in 2-D)
    3: A tau_s grad p . q, stabilisation;  4: A pbar s, volume source
    5: work of the walls, R . u of their particles;  6 ... 5 + d: the force of the walls, sum of R [N]
    """
    for t in range(parts * spread):
        works = ti.Vector.zero(float, WORKS)
        holding = ti.Vector.zero(float, dim)
        first, last = part_of(t, parts, spread, elements)
        for e in range(first, last):
            g_now, _c_next, _sigma, l, q, pressure_force, tail = linearisation(record, e, dim)
            w, area = tail[0], tail[1]
            big_l = ti.Matrix.zero(float, dim, dim)
            mean_p = 0.0
            # grad phi_0 = -sum of the others
            for a in ti.static(range(1, dim + 1)):
                g = ti.Vector([g_now[ti.static(a - 1), k] for k in ti.static(range(dim))])
                big_l += (unknown(x, cells[e, a], dim) - unknown(x, cells[e, 0], dim)).outer_product(g)
            for a in ti.static(range(dim + 1)):
                mean_p += x[cells[e, a] * (dim + 1) + dim] / (dim + 1)
            stress = tail[4] * (l + l.transpose())
            h = (ti.Matrix.identity(float, dim) - cf * big_l).inverse() @ big_l
            second = 0.5 * (h.trace() * h.trace() - (h @ h).trace())
            growth = (2.0 * cf - 1.0) * second
            if ti.static(dim == 3):
                growth += (3.0 * cf * cf - 1.0) * h.determinant()
            works[0] += dt * w * (stress * l).sum()
            works[1] += w * (stress * big_l).sum()
            works[2] += area * mean_p * growth
            works[3] += tail[2] * pressure_force.dot(q) / tail[3]
            works[4] += area * mean_p * source[e]
        first, last = part_of(t, parts, spread, nodes)
        for i in range(first, last):
            if wall[i] != 0:
                for k in ti.static(range(dim)):
                    force = gathered(local, corners, offsets[i], offsets[i + 1], k, dim + 1)
                    works[5] += force * x[i * (dim + 1) + k]
                    holding[k] += force
        if t % spread == 0:
            for k in ti.static(range(WORKS)):
                partial[t // spread, k] = works[k]
            for k in ti.static(range(dim)):
                partial[t // spread, WORKS + k] = holding[k]
    ti.loop_config(serialize=True)
    for c in range(parts):
        for k in range(ti.static(WORKS + dim)):
            result[k] += partial[c, k]
