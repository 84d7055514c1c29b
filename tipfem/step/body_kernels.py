"""Kernels that put the freedoms of floating bodies in place of the displacements of their particles; see `body_rows`.

Vectors of unknowns are laid out as in `tipfem.fem.residual`; behind the entries of the nodes, from ``base`` on, are
three for each body: its increments in x, in y, and in the angle times a length of the body, all in metres. The nodes of
body b are ``index[offsets[b]:offsets[b + 1]]``.
"""

import taichi as ti

from tipfem.backend.array_types import Ints1, Reals1, Reals2
from tipfem.backend.launch import kernel
from tipfem.fem.element import gradient
from tipfem.fem.residual import linearisation
from tipfem.linalg.multigrid.grid_hierarchy import SOLUTION

# Columns of ``body``, the constants of the bodies in a step: mass, moment of inertia, length of the angle's unknown; by
# freedom, velocity and acceleration at the start, the parts of v_alpha and a_alpha that do not depend on the increment,
# stiffness, force of the springs at the start, damping; the centre of mass relative to the reference point, and the
# acceleration by gravity.
MASS, INERTIA, LENGTH = 0, 1, 2
VELOCITY, ACCELERATION, V_HISTORY, A_HISTORY, STIFFNESS, SPRING, DAMPING = 3, 6, 9, 12, 15, 18, 21
CENTRE, GRAVITY, BODY = 24, 26, 28
# Columns of ``scheme``, generalized-alpha's coefficients.
CM, CV, CF, ALPHA_M, V_NEXT, A_NEXT, SCHEME = 0, 1, 2, 3, 4, 5, 6
# Columns of ``own``: the force residual of the bodies, its derivative row by row, and what the angle's unknown adds to
# the derivatives of v_alpha and a_alpha along and across r.
FORCE, MATRIX, DV_ALONG, DA_ALONG, DA_ACROSS, OWN = 0, 3, 12, 13, 14, 15
# Columns of ``arm``: r at the start of the step, at its end, and at the intermediate time.
START, END, MIDDLE, ARM = 0, 2, 4, 6


@kernel
def place(
    index: Ints1,
    offsets: Ints1,
    body: Reals2,
    scheme: Reals1,
    force: Reals2,
    arm: Reals2,
    motion: Reals2,
    x: Reals1,
    own: Reals2,
    base: ti.i32,
    count: ti.i32,
):
    """Displace the bodies' particles by the bodies' increments in x, and give them the bodies' velocities.

    motion (P, 6) as in `tipfem.fem.residual.residual`: v_alpha - cv u and a_alpha - b - cm u, with the acceleration b
    in ``force`` (K, 2).
    """
    for b in range(count):
        length = body[b, LENGTH]
        ux, uy, angle = x[base + 3 * b], x[base + 3 * b + 1], x[base + 3 * b + 2] / length
        sine, versed = ti.sin(angle), 2.0 * ti.sin(0.5 * angle) * ti.sin(0.5 * angle)
        cm, cv, cf, alpha_m = scheme[CM], scheme[CV], scheme[CF], scheme[ALPHA_M]
        q = ti.Vector([ux, uy, angle])
        v_alpha, a_alpha = ti.Vector.zero(float, 3), ti.Vector.zero(float, 3)
        for k in ti.static(range(3)):
            v_alpha[k] = body[b, V_HISTORY + k] + cv * q[k]
            a_alpha[k] = body[b, A_HISTORY + k] + cm * q[k]
        old_w, old_a = body[b, VELOCITY + 2], body[b, ACCELERATION + 2]
        # The rates at the end of the step follow from those at the intermediate time.
        w = (v_alpha[2] - (1.0 - cf) * old_w) / cf
        turn = (a_alpha[2] - alpha_m * old_a) / (1.0 - alpha_m)
        own[b, DV_ALONG] = -cf * w / length
        own[b, DA_ALONG] = -(1.0 - alpha_m) * (turn + 2.0 * w * scheme[V_NEXT]) / length
        own[b, DA_ACROSS] = -(1.0 - alpha_m) * w * w / length
        for s in range(offsets[b], offsets[b + 1]):
            i = index[s]
            rx, ry = arm[s, START], arm[s, START + 1]
            dx, dy = -versed * rx - sine * ry, -versed * ry + sine * rx
            ex, ey = rx + dx, ry + dy
            arm[s, END], arm[s, END + 1] = ex, ey
            arm[s, MIDDLE], arm[s, MIDDLE + 1] = rx + cf * dx, ry + cf * dy
            u = ti.Vector([ux + dx, uy + dy])
            v = ti.Vector([v_alpha[0], v_alpha[1]]) + (1.0 - cf) * old_w * ti.Vector([-ry, rx])
            v += cf * w * ti.Vector([-ey, ex])
            a = ti.Vector([a_alpha[0], a_alpha[1]])
            a += alpha_m * (old_a * ti.Vector([-ry, rx]) - old_w * old_w * ti.Vector([rx, ry]))
            a += (1.0 - alpha_m) * (turn * ti.Vector([-ey, ex]) - w * w * ti.Vector([ex, ey]))
            for k in ti.static(range(2)):
                x[3 * i + k] = u[k]
                motion[i, 2 + k] = v[k] - cv * u[k]
                motion[i, 4 + k] = a[k] - force[s, k] - cm * u[k]


@kernel
def collect_residual(
    index: Ints1,
    offsets: Ints1,
    body: Reals2,
    scheme: Reals1,
    arm: Reals2,
    x: Reals1,
    scale: Reals1,
    r: Reals1,
    own: Reals2,
    base: ti.i32,
    count: ti.i32,
):
    """The equations of the bodies, from the rows of momentum of their particles in r, which become zero.

    M a_alpha + damping v_alpha + stiffness x_alpha - M g + (the force of the bodies on the fluids), and the same for
    moments about the reference points; and the derivative of what does not come from the fluids' rows.
    """
    for b in range(count):
        cm, cv, cf, length = scheme[CM], scheme[CV], scheme[CF], body[b, LENGTH]
        total, stretch = ti.Vector.zero(float, 3), 0.0
        for s in range(offsets[b], offsets[b + 1]):
            i = index[s]
            fx, fy = 0.0, 0.0
            if scale[3 * i] > 0.0:
                fx, fy = r[3 * i] / scale[3 * i], r[3 * i + 1] / scale[3 * i + 1]
            total += ti.Vector([fx, fy, arm[s, MIDDLE] * fy - arm[s, MIDDLE + 1] * fx])
            stretch += arm[s, END] * fx + arm[s, END + 1] * fy
            r[3 * i], r[3 * i + 1] = 0.0, 0.0
        for k in ti.static(range(3)):
            own[b, FORCE + k] = total[k]
            for m in ti.static(range(3)):
                own[b, MATRIX + 3 * k + m] = 0.0
        angle = x[base + 3 * b + 2] / length
        sine, versed = ti.sin(angle), 2.0 * ti.sin(0.5 * angle) * ti.sin(0.5 * angle)
        px, py = body[b, CENTRE], body[b, CENTRE + 1]
        dx, dy = -versed * px - sine * py, -versed * py + sine * px
        gx, gy = body[b, GRAVITY], body[b, GRAVITY + 1]
        mass = body[b, MASS]
        weight = ti.Vector([mass * gx, mass * gy, mass * ((px + cf * dx) * gy - (py + cf * dy) * gx)])
        for k in ti.static(range(3)):
            inertia = body[b, INERTIA] if ti.static(k == 2) else mass
            unit = 1.0 / length if ti.static(k == 2) else 1.0
            q = x[base + 3 * b + k] * unit
            value = total[k] - weight[k] + inertia * (body[b, A_HISTORY + k] + cm * q)
            value += body[b, DAMPING + k] * (body[b, V_HISTORY + k] + cv * q)
            value += body[b, SPRING + k] + body[b, STIFFNESS + k] * cf * q
            slope = inertia * cm + body[b, DAMPING + k] * cv + body[b, STIFFNESS + k] * cf
            if ti.static(k == 2):
                slope += cf * mass * ((px + dx) * gx + (py + dy) * gy) - cf * stretch
            r[base + 3 * b + k] = scale[base + 3 * b + k] * unit * value
            own[b, MATRIX + 4 * k] = unit * unit * slope


@kernel
def rotation_terms(
    pairs: Ints1,
    spans: Ints1,
    corners: Ints1,
    body_corners: Ints1,
    slots: Ints1,
    density: Reals1,
    lumping: Reals1,
    record: Reals2,
    arm: Reals2,
    own: Reals2,
    terms: Reals2,
    count: ti.i32,
):
    """What the derivative of the residual by the angles' unknowns has beyond that along the displacements.

    The velocities and accelerations of a rotating body are not those that generalized-alpha derives from its
    particles' displacements. terms (E, 3): forces and continuity, without the rows' scale, at each pair of a node and a
    body that have elements in common. Pair e has ``spans[e]`` to ``spans[e + 1]`` of the lists of such elements:
    ``corners`` is 3 * element + the node's corner; the corners of the element with bit c in ``body_corners`` are on the
    body, at ``slots[3 * part + c]`` of its nodes. ``pairs`` (E,) are the pairs' bodies.
    """
    for e in range(count):
        b = pairs[e]
        force, growth = ti.Vector.zero(float, 2), 0.0
        for t in range(spans[e], spans[e + 1]):
            cell = corners[t] // 3
            corner = corners[t] - 3 * cell
            g_now, _c_next, _sigma, _l, _q, _f, tail = linearisation(record, cell, 2)
            change, mean = ti.Matrix.zero(float, 2, 2), ti.Vector.zero(float, 2)
            g_a, a_own = ti.Vector.zero(float, 2), ti.Vector.zero(float, 2)
            for c in ti.static(range(3)):
                g = gradient(g_now, c)
                if corner == c:
                    g_a = g
                if (body_corners[t] >> c) & 1:
                    s = slots[3 * t + c]
                    r = ti.Vector([arm[s, END], arm[s, END + 1]])
                    a = own[b, DA_ALONG] * r + own[b, DA_ACROSS] * ti.Vector([-r[1], r[0]])
                    change += (own[b, DV_ALONG] * r).outer_product(g)
                    mean += a / 3.0
                    if corner == c:
                        a_own = a
            acting = lumping[cell] * a_own + (1.0 - lumping[cell]) * mean
            force += tail[0] * tail[4] * ((change + change.transpose()) @ g_a) + density[cell] * tail[1] / 3.0 * acting
            growth += tail[2] * g_a.dot(mean)
        terms[e, 0], terms[e, 1], terms[e, 2] = force[0], force[1], growth


@kernel
def collect_product(
    index: Ints1,
    offsets: Ints1,
    arm: Reals2,
    body: Reals2,
    own: Reals2,
    nodes: Ints1,
    starts: Ints1,
    pairs: Ints1,
    terms: Reals2,
    scale: Reals1,
    v: Reals1,
    out: Reals1,
    base: ti.i32,
    ring: ti.i32,
    count: ti.i32,
):
    """The rows of the bodies of out = K v, from those of their particles, which become zero.

    Adds the `rotation_terms` first: node nodes[n] of the ``ring`` has the pairs ``starts[n]`` to ``starts[n + 1]``.
    """
    for n in range(ring):
        i = nodes[n]
        for e in range(starts[n], starts[n + 1]):
            turn = v[base + 3 * pairs[e] + 2]
            for k in ti.static(range(3)):
                out[3 * i + k] = out[3 * i + k] + scale[3 * i + k] * terms[e, k] * turn
    for b in range(count):
        total = ti.Vector.zero(float, 3)
        for s in range(offsets[b], offsets[b + 1]):
            i = index[s]
            fx, fy = 0.0, 0.0
            if scale[3 * i] > 0.0:
                fx, fy = out[3 * i] / scale[3 * i], out[3 * i + 1] / scale[3 * i + 1]
            total += ti.Vector([fx, fy, (arm[s, MIDDLE] * fy - arm[s, MIDDLE + 1] * fx) / body[b, LENGTH]])
            out[3 * i], out[3 * i + 1] = 0.0, 0.0
        for k in ti.static(range(3)):
            value = total[k]
            for m in ti.static(range(3)):
                value += own[b, MATRIX + 3 * k + m] * v[base + 3 * b + m]
            out[base + 3 * b + k] = scale[base + 3 * b + k] * value


@kernel
def begin_precondition(
    index: Ints1,
    offsets: Ints1,
    arm: Reals2,
    body: Reals2,
    inverse: Reals2,
    scale: Reals1,
    r: Reals1,
    start: Reals1,
    base: ti.i32,
    count: ti.i32,
):
    """The bodies' increments B^-1 r, with the bodies' own matrices B, in ``start`` (3 B,); their particles' in r.

    inverse (B, 9) has B^-1, of equations without scale.
    """
    for b in range(count):
        for k in ti.static(range(3)):
            value = 0.0
            for m in ti.static(range(3)):
                if scale[base + 3 * b + m] > 0.0:
                    value += inverse[b, 3 * k + m] * r[base + 3 * b + m] / scale[base + 3 * b + m]
            start[3 * b + k] = value
        turn = start[3 * b + 2] / body[b, LENGTH]
        for s in range(offsets[b], offsets[b + 1]):
            i = index[s]
            r[3 * i] = start[3 * b] - turn * arm[s, END + 1]
            r[3 * i + 1] = start[3 * b + 1] + turn * arm[s, END]


@kernel
def clear(index: Ints1, r: Reals1, count: ti.i32):
    """Zero displacements of the bodies' ``count`` particles."""
    for s in range(count):
        r[3 * index[s]], r[3 * index[s] + 1] = 0.0, 0.0


@kernel
def add_bodies_mobility(
    starts: Ints1,
    nodes: Ints1,
    weights: Reals2,
    response: Reals1,
    mobility: Reals2,
    vectors: Reals1,
    reaction: Reals1,
    size: ti.i32,
    count: ti.i32,
):
    """Correct the pressure in ``vectors`` for the bodies' motion: p -= Y (B + W^T Y)^-1 W^T p.

    By the Woodbury identity, for the Schur complement L + W B^-1 W^T, where W are the volumes that the bodies' motions
    sweep, and Y = L^-1 W their pressure. Rows of body b: ``starts[b]`` to ``starts[b + 1]`` of nodes and
    weights (., 3); response (3 B N,) is Y, mobility (3 B, 3 B) the inverse, reaction (6 B,) scratch.
    """
    for b in range(count):
        total = ti.Vector.zero(float, 3)
        for s in range(starts[b], starts[b + 1]):
            p = vectors[SOLUTION * size + nodes[s]]
            for k in ti.static(range(3)):
                total[k] += weights[s, k] * p
        for k in ti.static(range(3)):
            reaction[3 * b + k] = total[k]
    for k in range(3 * count):
        value = 0.0
        for m in range(3 * count):
            value += mobility[k, m] * reaction[m]
        reaction[3 * count + k] = value
    for i in range(size):
        change = 0.0
        for k in range(3 * count):
            change += response[k * size + i] * reaction[3 * count + k]
        vectors[SOLUTION * size + i] = vectors[SOLUTION * size + i] - change


@kernel
def end_precondition(
    index: Ints1,
    offsets: Ints1,
    arm: Reals2,
    body: Reals2,
    inverse: Reals2,
    start: Reals1,
    scale: Reals1,
    z: Reals1,
    base: ti.i32,
    count: ti.i32,
):
    """The bodies' increments in z by the forces that the pressure exerts on their particles, which then follow."""
    for b in range(count):
        total, length = ti.Vector.zero(float, 3), body[b, LENGTH]
        for s in range(offsets[b], offsets[b + 1]):
            i = index[s]
            fx, fy = 0.0, 0.0
            if scale[3 * i] > 0.0:
                fx, fy = z[3 * i] / scale[3 * i], z[3 * i + 1] / scale[3 * i + 1]
            total += ti.Vector([fx, fy, (arm[s, MIDDLE] * fy - arm[s, MIDDLE + 1] * fx) / length])
        increment = ti.Vector.zero(float, 3)
        for k in ti.static(range(3)):
            value = start[3 * b + k]
            for m in ti.static(range(3)):
                value += inverse[b, 3 * k + m] * total[m]
            increment[k] = value
            z[base + 3 * b + k] = value
        for s in range(offsets[b], offsets[b + 1]):
            i = index[s]
            z[3 * i] = increment[0] - increment[2] / length * arm[s, END + 1]
            z[3 * i + 1] = increment[1] + increment[2] / length * arm[s, END]


@kernel
def particle_forces(index: Ints1, offsets: Ints1, corners: Ints1, local: Reals2, force: Reals2, count: ti.i32):
    """force (K, 2) [N per metre of depth] that holds each of ``count`` particles, from the last residual's elements."""
    for s in range(count):
        i = index[s]
        for k in ti.static(range(2)):
            total = 0.0
            for c in range(offsets[i], offsets[i + 1]):
                total += local[corners[c], k]
            force[s, k] = total


@kernel
def set_scales(
    index: Ints1, particle: Reals1, body: Reals1, scale: Reals1, base: ti.i32, count: ti.i32, unknowns: ti.i32
):
    """The scales of the rows of momentum of the bodies' particles, and of the bodies' own ``unknowns``."""
    for s in range(count):
        scale[3 * index[s]], scale[3 * index[s] + 1] = particle[s], particle[s]
    for k in range(unknowns):
        scale[base + k] = body[k]
