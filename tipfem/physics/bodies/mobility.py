"""The mobility of bodies that float in the preconditioner, see `tipfem.physics.bodies.term`.

``bodies`` and ``data`` are laid out as in `tipfem.physics.bodies.layout`.
"""

import taichi as ti

from tipfem.backend.array_types import Ints1, Reals1, Template
from tipfem.backend.launch import kernel
from tipfem.linalg.multigrid.grid_hierarchy import RHS, SOLUTION
from tipfem.physics.bodies.layout import BODIES, MOBILITY, REACTION, RESPONSE, SWEPT, SWEPT_STARTS, WEIGHTS


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
