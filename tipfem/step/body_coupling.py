"""Device functions and kernels of the linear systems with bodies that float: products and the preconditioner.

See `tipfem.step.body_rows` for the method. Vectors of unknowns are laid out as in `tipfem.fem.residual`; behind the
entries of the nodes, from ``base`` on, are three for each body: its increments in x, in y, and in the angle times a
length of the body, all in metres. A vector may begin at ``start`` in its array. ``bodies`` and ``data`` are laid out as
in `tipfem.step.body_layout`.
"""

import taichi as ti

from tipfem.backend.array_types import Ints1, Reals1, Template
from tipfem.backend.launch import kernel
from tipfem.linalg.multigrid.grid_hierarchy import RHS, SOLUTION
from tipfem.step.body_layout import (
    BODIES,
    END,
    FIRST,
    INVERSE,
    LENGTH,
    MATRIX,
    MIDDLE,
    MOBILITY,
    NODES,
    PAIRS,
    REACTION,
    RESPONSE,
    RING,
    RING_NODES,
    RING_STARTS,
    SWEPT,
    SWEPT_STARTS,
    TERMS,
    WEIGHTS,
    arm,
    constant,
    moment,
    node_on_body,
    numbers_on,
    own,
    unscaled,
)


@ti.func
def add_rotation(bodies: Template, data: Template, scale: Template, v: Template, v_at, out: Template, at, n, base):
    """Add to out = K v at node ``n`` of the ring what rotations change beyond displacements, see `rotation_terms`."""
    i = bodies[bodies[RING_NODES] + n]
    for e in range(bodies[bodies[RING_STARTS] + n], bodies[bodies[RING_STARTS] + n + 1]):
        turn = v[v_at + base + 3 * bodies[bodies[PAIRS] + e] + 2]
        for k in ti.static(range(3)):
            term = data[bodies[TERMS] + 3 * e + k] * turn
            out[at + 3 * i + k] = out[at + 3 * i + k] + scale[3 * i + k] * term


@ti.func
def force_on_body(bodies: Template, data: Template, scale: Template, x: Template, at, b):
    """The sum of the rows of momentum of the particles of body ``b`` in x: the force, and the moment by `LENGTH`."""
    total = ti.Vector.zero(float, 3)
    first, last = numbers_on(bodies, b)
    for s in range(first, last):
        i = node_on_body(bodies, s)
        f = unscaled(x, at + 3 * i, scale, 3 * i)
        total += ti.Vector([f[0], f[1], moment(arm(bodies, data, s, MIDDLE), f)])
    total[2] /= constant(bodies, data, b, LENGTH)
    return total


@ti.func
def collect_body(bodies: Template, data: Template, scale: Template, v: Template, v_at, out: Template, at, b, base):
    """The rows of body ``b`` of out = K v, from those of its particles, which become zero."""
    total = force_on_body(bodies, data, scale, out, at, b)
    first, last = numbers_on(bodies, b)
    for s in range(first, last):
        i = node_on_body(bodies, s)
        out[at + 3 * i], out[at + 3 * i + 1] = 0.0, 0.0
    for k in ti.static(range(3)):
        value = total[k]
        for m in ti.static(range(3)):
            value += data[own(bodies, b, MATRIX + 3 * k + m)] * v[v_at + base + 3 * b + m]
        out[at + base + 3 * b + k] = scale[base + 3 * b + k] * value


@ti.func
def displace(bodies: Template, data: Template, x: Template, at, b, q):
    """Displace the particles of body ``b`` by the increments q (3,) of the body."""
    turn = q[2] / constant(bodies, data, b, LENGTH)
    first, last = numbers_on(bodies, b)
    for s in range(first, last):
        i, r = node_on_body(bodies, s), arm(bodies, data, s, END)
        x[at + 3 * i] = q[0] - turn * r[1]
        x[at + 3 * i + 1] = q[1] + turn * r[0]


@ti.func
def begin_body(bodies: Template, data: Template, scale: Template, r: Template, at, b, base):
    """The increments B^-1 r of body ``b``, with its own matrix B, for `end_body`; its particles' in r."""
    q = ti.Vector.zero(float, 3)
    for k in ti.static(range(3)):
        for m in ti.static(range(3)):
            row = base + 3 * b + m
            if scale[row] > 0.0:
                q[k] += data[bodies[INVERSE] + 9 * b + 3 * k + m] * r[at + row] / scale[row]
        data[bodies[FIRST] + 3 * b + k] = q[k]
    displace(bodies, data, r, at, b, q)


@ti.func
def clear_body_node(bodies: Template, r: Template, at, s):
    """Zero the displacement of node number ``s`` on bodies."""
    i = node_on_body(bodies, s)
    r[at + 3 * i], r[at + 3 * i + 1] = 0.0, 0.0


@ti.func
def sum_pressure(bodies: Template, data: Template, vectors: Template, b, nodes):
    """W^T p of body ``b``: what the pressure in ``vectors`` does on the volumes that the body's motions sweep."""
    total = ti.Vector.zero(float, 3)
    for s in range(bodies[bodies[SWEPT_STARTS] + b], bodies[bodies[SWEPT_STARTS] + b + 1]):
        p = vectors[SOLUTION * nodes + bodies[bodies[SWEPT] + s]]
        for k in ti.static(range(3)):
            total[k] += data[bodies[WEIGHTS] + 3 * s + k] * p
    return total


@ti.func
def set_reaction(bodies: Template, data: Template, vectors: Template, b, nodes):
    """Put the `sum_pressure` of body ``b`` where `respond` finds it."""
    total = sum_pressure(bodies, data, vectors, b, nodes)
    for k in ti.static(range(3)):
        data[bodies[REACTION] + 3 * b + k] = total[k]


@ti.func
def respond(bodies: Template, data: Template, k):
    """Entry ``k`` of (B + W^T Y)^-1 W^T p, after `set_reaction` of all bodies; Y = S^-1 W."""
    width, value = 3 * bodies[BODIES], 0.0
    for m in range(width):
        value += data[bodies[MOBILITY] + k * width + m] * data[bodies[REACTION] + m]
    data[bodies[REACTION] + width + k] = value


@ti.func
def correct_pressure_at(bodies: Template, data: Template, vectors: Template, i, nodes):
    """p -= Y (B + W^T Y)^-1 W^T p at node ``i``, after `respond`."""
    width, change = 3 * bodies[BODIES], 0.0
    for k in range(width):
        change += data[bodies[RESPONSE] + k * nodes + i] * data[bodies[REACTION] + width + k]
    vectors[SOLUTION * nodes + i] = vectors[SOLUTION * nodes + i] - change


@ti.func
def end_body(bodies: Template, data: Template, scale: Template, z: Template, at, b, base):
    """The increments of body ``b`` in z by the forces that the pressure exerts on its particles, which then follow."""
    total, q = force_on_body(bodies, data, scale, z, at, b), ti.Vector.zero(float, 3)
    for k in ti.static(range(3)):
        q[k] = data[bodies[FIRST] + 3 * b + k]
        for m in ti.static(range(3)):
            q[k] += data[bodies[INVERSE] + 9 * b + 3 * k + m] * total[m]
        z[at + base + 3 * b + k] = q[k]
    displace(bodies, data, z, at, b, q)


@kernel
def add_rotations(bodies: Ints1, data: Reals1, scale: Reals1, v: Reals1, out: Reals1, base: ti.i32):
    """`add_rotation` at all nodes of the ring."""
    for n in range(bodies[RING]):
        add_rotation(bodies, data, scale, v, 0, out, 0, n, base)


@kernel
def collect_product(bodies: Ints1, data: Reals1, scale: Reals1, v: Reals1, out: Reals1, base: ti.i32):
    """`collect_body` of all bodies."""
    for b in range(bodies[BODIES]):
        collect_body(bodies, data, scale, v, 0, out, 0, b, base)


@kernel
def begin_precondition(bodies: Ints1, data: Reals1, scale: Reals1, r: Reals1, base: ti.i32):
    """`begin_body` of all bodies."""
    for b in range(bodies[BODIES]):
        begin_body(bodies, data, scale, r, 0, b, base)


@kernel
def clear(bodies: Ints1, r: Reals1):
    """`clear_body_node` of all nodes on bodies."""
    for s in range(bodies[NODES]):
        clear_body_node(bodies, r, 0, s)


@kernel
def add_mobility(bodies: Ints1, data: Reals1, vectors: Reals1, nodes: ti.i32):
    """Correct the pressure in ``vectors`` for the bodies' motion, by the Woodbury identity."""
    for b in range(bodies[BODIES]):
        set_reaction(bodies, data, vectors, b, nodes)
    for k in range(3 * bodies[BODIES]):
        respond(bodies, data, k)
    for i in range(nodes):
        correct_pressure_at(bodies, data, vectors, i, nodes)


@kernel
def end_precondition(bodies: Ints1, data: Reals1, scale: Reals1, z: Reals1, base: ti.i32):
    """`end_body` of all bodies."""
    for b in range(bodies[BODIES]):
        end_body(bodies, data, scale, z, 0, b, base)


@kernel
def set_swept_volume(bodies: Ints1, data: Reals1, vectors: Reals1, k: ti.i32, nodes: ti.i32):
    """Column ``k`` of W as the right-hand side in ``vectors``."""
    for i in range(nodes):
        vectors[RHS * nodes + i] = 0.0
    for s in range(bodies[bodies[SWEPT_STARTS] + k // 3], bodies[bodies[SWEPT_STARTS] + k // 3 + 1]):
        vectors[RHS * nodes + bodies[bodies[SWEPT] + s]] = data[bodies[WEIGHTS] + 3 * s + k % 3]


@kernel
def store_response(bodies: Ints1, data: Reals1, vectors: Reals1, k: ti.i32, solved: ti.i32, nodes: ti.i32):
    """Column ``k`` of Y from the solution in ``vectors``, and of W^T Y; zeros if it has not been ``solved`` for."""
    for i in range(nodes):
        data[bodies[RESPONSE] + k * nodes + i] = ti.select(solved == 1, vectors[SOLUTION * nodes + i], 0.0)
    for b in range(bodies[BODIES]):
        total = sum_pressure(bodies, data, vectors, b, nodes)
        for m in ti.static(range(3)):
            at = bodies[MOBILITY] + (3 * b + m) * 3 * bodies[BODIES] + k
            data[at] = ti.select(solved == 1, total[m], 0.0)
