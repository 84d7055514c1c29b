"""Kernels of the equations of bodies that float, in place of the displacements of their particles; see `body_rows`.

Vectors of unknowns are laid out as in `tipfem.fem.residual`; two nodes per body follow those of the fluids, its motion
and its angle, from entry ``base`` on. ``bodies`` and ``data`` are laid out as in `tipfem.physics.bodies.layout`.
"""

import taichi as ti

from tipfem.backend.array_types import Ints1, Reals1, Reals2, Template
from tipfem.backend.launch import kernel
from tipfem.backend.real_functions import sine
from tipfem.fem.element import gradient
from tipfem.fem.jacobian import block_entry
from tipfem.fem.residual import linearisation
from tipfem.linalg.sparsity import Csr, find_column
from tipfem.physics.bodies.layout import (
    A_FREE,
    A_HISTORY,
    ACCELERATION,
    ALONG,
    ALPHA_M,
    BODIES,
    CENTRE,
    CF,
    CM,
    CV,
    DA_ACROSS,
    DA_ALONG,
    DAMPING,
    DV_ALONG,
    END,
    FORCE,
    GRAVITY,
    INERTIA,
    LENGTH,
    MASS,
    MATRIX,
    MIDDLE,
    NODES,
    PAIRS,
    RING,
    RING_NODES,
    RING_STARTS,
    ROW,
    ROWS,
    SLID,
    SPRING,
    START,
    STIFFNESS,
    TERMS,
    TURNED,
    UNIT,
    V_FREE,
    V_HISTORY,
    V_NEXT,
    VELOCITY,
    WEIGHS,
    arm,
    coefficient,
    constant,
    moment,
    node_on_body,
    numbers_on,
    own,
    set_arm,
    unknown,
)


@ti.func
def increment(bodies: Template, data: Template, x: Template, b, k: Template, base):
    """Freedom ``k`` of body ``b`` in unknowns ``x`` [m], of the angle times its length."""
    return x[unknown(k, base, b)] / constant(bodies, data, b, UNIT + k)


@ti.func
def rotate(r, across, versed):
    """r turned by an angle with the sine ``across`` and 1 - cosine ``versed``."""
    return r - versed * r + across * ti.Vector([-r[1], r[0]])


@kernel
def put_increments(unknowns: Reals1, x: Reals1, base: ti.i32, bodies: ti.i32):
    """Set the bodies' unknowns (3 B,) in x."""
    for b in range(bodies):
        for k in ti.static(range(3)):
            x[base + 6 * b + k + k // 2] = unknowns[3 * b + k]


@kernel
def place(bodies: Ints1, data: Reals1, motion: Reals2, x: Reals1, base: ti.i32):
    """Displace the bodies' particles by the bodies' increments in x, and give them the bodies' velocities.

    Those that slide keep what x has along their directions, displacements and velocities.
    motion (P, 6) as in `tipfem.fem.residual.residual`: v_alpha - cv u and a_alpha - b - cm u, with the acceleration b
    by the body force.
    """
    for b in range(bodies[BODIES]):
        length = constant(bodies, data, b, LENGTH)
        ux, uy = increment(bodies, data, x, b, 0, base), increment(bodies, data, x, b, 1, base)
        angle = increment(bodies, data, x, b, 2, base) / length
        across, versed = sine(angle), 2.0 * sine(0.5 * angle) ** 2
        cm, cv = coefficient(bodies, data, CM), coefficient(bodies, data, CV)
        cf, alpha_m = coefficient(bodies, data, CF), coefficient(bodies, data, ALPHA_M)
        q = ti.Vector([ux, uy, angle])
        v_alpha, a_alpha = ti.Vector.zero(float, 3), ti.Vector.zero(float, 3)
        for k in ti.static(range(3)):
            v_alpha[k] = constant(bodies, data, b, V_HISTORY + k) + cv * q[k]
            a_alpha[k] = constant(bodies, data, b, A_HISTORY + k) + cm * q[k]
        old_w, old_a = constant(bodies, data, b, VELOCITY + 2), constant(bodies, data, b, ACCELERATION + 2)
        # The rates at the end of the step follow from those at the intermediate time.
        w = (v_alpha[2] - (1.0 - cf) * old_w) / cf
        turn = (a_alpha[2] - alpha_m * old_a) / (1.0 - alpha_m)
        # Where rates do not follow from displacements, a rotation changes them by more.
        weighs, v_next = coefficient(bodies, data, WEIGHS), coefficient(bodies, data, V_NEXT)
        data[own(bodies, b, DV_ALONG)] = -weighs * cf * w / length
        data[own(bodies, b, DA_ALONG)] = -weighs * (1.0 - alpha_m) * (turn + 2.0 * w * v_next) / length
        data[own(bodies, b, DA_ACROSS)] = -weighs * (1.0 - alpha_m) * w * w / length
        first, last = numbers_on(bodies, b)
        for s in range(first, last):
            i, r = node_on_body(bodies, s), arm(bodies, data, s, START)
            d = -versed * r + across * ti.Vector([-r[1], r[0]])
            set_arm(bodies, data, s, TURNED, r + d)
            set_arm(bodies, data, s, MIDDLE, r + cf * (d + arm(bodies, data, s, SLID)))
            t, row = rotate(arm(bodies, data, s, ALONG), across, versed), arm(bodies, data, s, ROW)
            if row.dot(row) > 0.0:
                slid = ti.Vector([x[3 * i] - ux, x[3 * i + 1] - uy]) - d
                if t.dot(t) > 0.0:  # on a straight side, not on a curve
                    slid = t * t.dot(slid)
                d += slid
            e = r + d
            set_arm(bodies, data, s, END, e)
            u = ti.Vector([ux, uy]) + d
            v = ti.Vector([v_alpha[0], v_alpha[1]]) + (1.0 - cf) * old_w * ti.Vector([-r[1], r[0]])
            v += cf * w * ti.Vector([-e[1], e[0]])
            a = ti.Vector([a_alpha[0], a_alpha[1]])
            a += alpha_m * (old_a * ti.Vector([-r[1], r[0]]) - old_w * old_w * r)
            a += (1.0 - alpha_m) * (turn * ti.Vector([-e[1], e[0]]) - w * w * e)
            v += row * row.dot(arm(bodies, data, s, V_FREE) + cv * u - v)
            a += row * row.dot(arm(bodies, data, s, A_FREE) + cm * u - a)
            for k in ti.static(range(2)):
                x[3 * i + k] = u[k]
                if weighs > 0.0:
                    motion[i, 2 + k] = v[k] - cv * u[k]
                    motion[i, 4 + k] = a[k] - data[bodies[FORCE] + 2 * s + k] - cm * u[k]


@kernel
def collect_residual(bodies: Ints1, data: Reals1, x: Reals1, r: Reals1, base: ti.i32):
    """The equations of the bodies, from the rows of momentum of their particles in r.

    These become zero, but along the outline where particles slide.

    M a_alpha + damping v_alpha + stiffness x_alpha - M g + (the force of the bodies on the fluids), and the same for
    moments about the reference points; and the derivative of what does not come from the fluids' rows.
    """
    for b in range(bodies[BODIES]):
        cm, cv = coefficient(bodies, data, CM), coefficient(bodies, data, CV)
        cf, length = coefficient(bodies, data, CF), constant(bodies, data, b, LENGTH)
        total, stretch = ti.Vector.zero(float, 3), 0.0
        own_force = ti.Vector.zero(float, 3)
        first, last = numbers_on(bodies, b)
        for s in range(first, last):
            i = node_on_body(bodies, s)
            f = ti.Vector([r[3 * i], r[3 * i + 1]])
            t = arm(bodies, data, s, ROW)
            along = t * t.dot(f)  # which moves the particle
            f -= along
            total += ti.Vector([f[0], f[1], moment(arm(bodies, data, s, MIDDLE), f)])
            stretch += arm(bodies, data, s, TURNED).dot(f)
            r[3 * i], r[3 * i + 1] = along[0], along[1]
        for k in ti.static(range(3)):
            for m in ti.static(range(3)):
                data[own(bodies, b, MATRIX + 3 * k + m)] = 0.0
        angle = increment(bodies, data, x, b, 2, base) / length
        across, versed = sine(angle), 2.0 * sine(0.5 * angle) ** 2
        p = ti.Vector([constant(bodies, data, b, CENTRE), constant(bodies, data, b, CENTRE + 1)])
        g = ti.Vector([constant(bodies, data, b, GRAVITY), constant(bodies, data, b, GRAVITY + 1)])
        d = -versed * p + across * ti.Vector([-p[1], p[0]])
        mass = constant(bodies, data, b, MASS)
        weight = mass * ti.Vector([g[0], g[1], moment(p + cf * d, g)])
        for k in ti.static(range(3)):
            inertia = constant(bodies, data, b, INERTIA) if ti.static(k == 2) else mass
            unit = 1.0 / length if ti.static(k == 2) else 1.0
            damping, stiffness = constant(bodies, data, b, DAMPING + k), constant(bodies, data, b, STIFFNESS + k)
            q = increment(bodies, data, x, b, k, base) * unit
            value = total[k] - weight[k] + inertia * (constant(bodies, data, b, A_HISTORY + k) + cm * q)
            value += damping * (constant(bodies, data, b, V_HISTORY + k) + cv * q)
            value += constant(bodies, data, b, SPRING + k) + stiffness * cf * q
            slope = inertia * cm + damping * cv + stiffness * cf
            if ti.static(k == 2):
                slope += cf * mass * (p + d).dot(g) - cf * stretch
            own_force[k] = unit * value
            data[own(bodies, b, MATRIX + 4 * k)] = unit * unit * slope
        for k in ti.static(range(3)):
            row = 0.0
            for m in ti.static(range(3)):
                row += data[bodies[ROWS] + 9 * b + 3 * k + m] * own_force[m]
            r[unknown(k, base, b)] = row


@kernel
def rotation_terms(
    bodies: Ints1,
    data: Reals1,
    spans: Ints1,
    corners: Ints1,
    body_corners: Ints1,
    slots: Ints1,
    density: Reals1,
    lumping: Reals1,
    record: Reals2,
    count: ti.i32,
):
    """Compute the part of the residual's derivative by the angles beyond that along the displacements.

    The velocities and accelerations of a rotating body are not those that generalized-alpha derives from its
    particles' displacements. Sets the section `TERMS` (E, 3): forces and continuity, without the rows' scale, at each
    pair of a node and a body that have elements in common. Pair e has ``spans[e]`` to ``spans[e + 1]`` of the lists of
    such elements: ``corners`` is 3 * element + the node's corner; the corners of the element with bit c in
    ``body_corners`` are on the body, at ``slots[3 * part + c]`` of the nodes on bodies.
    """
    for e in range(count):
        b = bodies[bodies[PAIRS] + e]
        force, growth = ti.Vector.zero(float, 2), 0.0
        dv_along, da_along = data[own(bodies, b, DV_ALONG)], data[own(bodies, b, DA_ALONG)]
        da_across = data[own(bodies, b, DA_ACROSS)]
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
                    r = arm(bodies, data, slots[3 * t + c], END)
                    along = arm(bodies, data, slots[3 * t + c], ROW)
                    a = da_along * r + da_across * ti.Vector([-r[1], r[0]])
                    a -= along * along.dot(a)
                    change += (dv_along * (r - along * along.dot(r))).outer_product(g)
                    mean += a / 3.0
                    if corner == c:
                        a_own = a
            acting = lumping[cell] * a_own + (1.0 - lumping[cell]) * mean
            force += tail[0] * tail[4] * ((change + change.transpose()) @ g_a) + density[cell] * tail[1] / 3.0 * acting
            growth += tail[2] * g_a.dot(mean)
        at = bodies[TERMS] + 3 * e
        data[at], data[at + 1], data[at + 2] = force[0], force[1], growth


@kernel
def set_scales(bodies: Ints1, scale: Reals1, base: ti.i32):
    """The scale 1 of the bodies' own rows, and of the rows of momentum of the nodes on them."""
    for b in range(bodies[BODIES]):
        for k in ti.static(range(3)):
            scale[unknown(k, base, b)] = 1.0
    for s in range(bodies[NODES]):
        i = node_on_body(bodies, s)
        scale[3 * i], scale[3 * i + 1] = 1.0, 1.0


@kernel
def add_rotations(bodies: Ints1, data: Reals1, scale: Reals1, matrix: Csr, nodes: ti.i32, rows: ti.i32):
    """Add the `rotation_terms` to the columns of the angles, whose nodes follow the ``nodes`` of the fluids."""
    for n in range(bodies[RING]):
        i, couplings = bodies[bodies[RING_NODES] + n], matrix.row_offsets[rows]
        for e in range(bodies[bodies[RING_STARTS] + n], bodies[bodies[RING_STARTS] + n + 1]):
            b = bodies[bodies[PAIRS] + e]
            s = find_column(matrix.columns, matrix.row_offsets[i], matrix.row_offsets[i + 1], nodes + 2 * b + 1)
            for k in ti.static(range(3)):
                term = data[bodies[TERMS] + 3 * e + k] / constant(bodies, data, b, UNIT + 2)
                at = block_entry(couplings, s, k, 0, 2)
                matrix.values[at] = matrix.values[at] + scale[3 * i + k] * term


@kernel
def add_own(bodies: Ints1, data: Reals1, matrix: Csr, nodes: ti.i32, rows: ti.i32):
    """Add the derivative of the bodies' own equations to their rows."""
    for b in range(bodies[BODIES]):
        couplings = matrix.row_offsets[rows]
        for k in ti.static(range(3)):
            i = nodes + 2 * b + ti.static(1 if k == 2 else 0)
            for m in ti.static(range(3)):
                value = 0.0
                for j in ti.static(range(3)):
                    value += data[bodies[ROWS] + 9 * b + 3 * k + j] * data[own(bodies, b, MATRIX + 3 * j + m)]
                j_node = nodes + 2 * b + ti.static(1 if m == 2 else 0)
                s = find_column(matrix.columns, matrix.row_offsets[i], matrix.row_offsets[i + 1], j_node)
                at = block_entry(couplings, s, ti.static(0 if k == 2 else k), ti.static(0 if m == 2 else m), 2)
                matrix.values[at] = matrix.values[at] + value / constant(bodies, data, b, UNIT + m)
