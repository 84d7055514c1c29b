"""Kernels that sum up what particles have, and what the forces of a step did.

`step_work` reads what the last residual left behind, each element's linearisation (``record``) and element vectors
(``local``), so that it must run before another residual or Jacobian-vector product does.
"""

import taichi as ti

from tipfem.backend.launch import kernel, part_of
from tipfem.fem.residual import gathered, linearisation, unknown

WORKS = 6  # sums of `step_work` before the force of the walls


@kernel
def step_work(
    cells: ti.types.ndarray(),
    offsets: ti.types.ndarray(),
    corners: ti.types.ndarray(),
    record: ti.types.ndarray(),
    source: ti.types.ndarray(),
    local: ti.types.ndarray(),
    wall: ti.types.ndarray(),
    x: ti.types.ndarray(),
    partial: ti.types.ndarray(),
    result: ti.types.ndarray(),
    cf: float,
    dt: float,
    elements: ti.i32,
    nodes: ti.i32,
    dim: ti.template(),
    parts: ti.i32,
    stride: ti.template(),
):
    """Work of the terms of the residual at ``x`` when it is tested with the displacements u and pressures p in ``x``.

    With L = sum_a u_a (x) g_a, H = sum_a u_a (x) G_a = (I - cf L)^-1 L, tau the viscous stress, and the
    invariants I2, I3 of H, result holds sums over the elements [J, per metre of depth in 2-D]:

    0: dt w tau : l, viscous dissipation;  1: w tau : L, work against the viscous stress
    2: A pbar ((2 cf - 1) I2 + (3 cf^2 - 1) I3) = pbar (w tr L - A (J_{n+1} - 1))  (without I3 in 2-D)
    3: A tau_s grad p . q, stabilisation;  4: A pbar s, volume source
    5: work of the walls, R . u of their particles;  6 ... 5 + d: the force of the walls, sum of R [N]
    """
    for t in range(parts * stride):
        works = ti.Vector.zero(float, WORKS)
        holding = ti.Vector.zero(float, dim)
        first, last = part_of(t, parts, stride, elements)
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
        first, last = part_of(t, parts, stride, nodes)
        for i in range(first, last):
            if wall[i] != 0:
                for k in ti.static(range(dim)):
                    force = gathered(local, corners, offsets[i], offsets[i + 1], k, dim + 1)
                    works[5] += force * x[i * (dim + 1) + k]
                    holding[k] += force
        if t % stride == 0:
            for k in ti.static(range(WORKS)):
                partial[t // stride, k] = works[k]
            for k in ti.static(range(dim)):
                partial[t // stride, WORKS + k] = holding[k]
    ti.loop_config(serialize=True)
    for c in range(parts):
        for k in range(ti.static(WORKS + dim)):
            result[k] += partial[c, k]


@kernel
def lump(
    cells: ti.types.ndarray(),
    measure: ti.types.ndarray(),
    density: ti.types.ndarray(),
    mass: ti.types.ndarray(),
    elements: ti.i32,
    dim: ti.template(),
):
    """Lumped mass [kg] (N,) of the particles, zero before; in the order of the elements."""
    ti.loop_config(serialize=True)
    for e in range(elements):
        m = density[e] * measure[e] / (dim + 1)
        for a in ti.static(range(dim + 1)):
            mass[cells[e, a]] = mass[cells[e, a]] + m


@ti.func
def vector_of(values: ti.template(), i, dim: ti.template()):
    """Row ``i`` of an array of vectors (N, dim)."""
    return ti.Vector([values[i, k] for k in ti.static(range(dim))])


@kernel
def state_sums(
    mass: ti.types.ndarray(),
    position: ti.types.ndarray(),
    velocity: ti.types.ndarray(),
    partial: ti.types.ndarray(),
    result: ti.types.ndarray(),
    nodes: ti.i32,
    dim: ti.template(),
    parts: ti.i32,
    stride: ti.template(),
    serial: ti.template(),
):
    """Sums over the particles, added to result (1 + 2 d,): m v . v, then m x and m v in each direction.

    ``serial``: by one thread.
    """
    ti.loop_config(serialize=serial)
    for t in range(parts * stride):
        energy, place, momentum = 0.0, ti.Vector.zero(float, dim), ti.Vector.zero(float, dim)
        first, last = part_of(t, parts, stride, nodes)
        for i in range(first, last):
            v = vector_of(velocity, i, dim)
            energy += mass[i] * v.dot(v)
            place += mass[i] * vector_of(position, i, dim)
            momentum += mass[i] * v
        if t % stride == 0:
            partial[t // stride, 0] = energy
            for k in ti.static(range(dim)):
                partial[t // stride, 1 + k], partial[t // stride, 1 + dim + k] = place[k], momentum[k]
    ti.loop_config(serialize=True)
    for c in range(parts):
        for k in range(ti.static(1 + 2 * dim)):
            result[k] = result[k] + partial[c, k]


@kernel
def step_sums(
    mass: ti.types.ndarray(),
    wall: ti.types.ndarray(),
    old_velocity: ti.types.ndarray(),
    old_acceleration: ti.types.ndarray(),
    position: ti.types.ndarray(),
    velocity: ti.types.ndarray(),
    acceleration: ti.types.ndarray(),
    relative: ti.types.ndarray(),
    force: ti.types.ndarray(),
    gravity: ti.types.ndarray(),
    u: ti.types.ndarray(),
    partial: ti.types.ndarray(),
    result: ti.types.ndarray(),
    shift: float,
    dt: float,
    nodes: ti.i32,
    dim: ti.template(),
    parts: ti.i32,
    stride: ti.template(),
    serial: ti.template(),
):
    """Sums over the particles of a step with displacements ``u``, added to result (3 + 4 d,).

    With a_alpha = relative + force: m a_alpha . u and m (force - gravity) . u, then in each direction m times the
    change of velocity + shift * acceleration (of wall particles dt a_alpha) and m force; then those of `state_sums`.
    ``serial``: by one thread.
    """
    ti.loop_config(serialize=serial)
    for t in range(parts * stride):
        inertia, external, energy = 0.0, 0.0, 0.0
        change, weight = ti.Vector.zero(float, dim), ti.Vector.zero(float, dim)
        place, momentum = ti.Vector.zero(float, dim), ti.Vector.zero(float, dim)
        first, last = part_of(t, parts, stride, nodes)
        for i in range(first, last):
            v = vector_of(velocity, i, dim)
            energy += mass[i] * v.dot(v)
            place += mass[i] * vector_of(position, i, dim)
            momentum += mass[i] * v
            b, way = vector_of(force, i, dim), vector_of(u, i, dim)
            a = vector_of(relative, i, dim) + b
            inertia += mass[i] * a.dot(way)
            weight += mass[i] * b
            for k in ti.static(range(dim)):
                external += mass[i] * (b[k] - gravity[k]) * way[k]
            if wall[i] != 0:
                change += mass[i] * dt * a
            else:
                turn = vector_of(acceleration, i, dim) - vector_of(old_acceleration, i, dim)
                change += mass[i] * (v - vector_of(old_velocity, i, dim) + shift * turn)
        if t % stride == 0:
            partial[t // stride, 0], partial[t // stride, 1] = inertia, external
            for k in ti.static(range(dim)):
                partial[t // stride, 2 + k], partial[t // stride, 2 + dim + k] = change[k], weight[k]
            partial[t // stride, 2 + 2 * dim] = energy
            for k in ti.static(range(dim)):
                partial[t // stride, 3 + 2 * dim + k] = place[k]
                partial[t // stride, 3 + 3 * dim + k] = momentum[k]
    ti.loop_config(serialize=True)
    for c in range(parts):
        for k in range(ti.static(3 + 4 * dim)):
            result[k] = result[k] + partial[c, k]
