"""Layout of the two arrays with the data of bodies that float: ``bodies``, integers, and ``data``, reals.

Two arrays, because kernels take long to start with many. A section of either begins at the entry that ``bodies`` names
for it, and is a table row by row. The nodes on body b are number offsets[b] to offsets[b + 1] of those on bodies.
"""

import numpy as np
import taichi as ti

from tipfem.backend.array_types import Template
from tipfem.typing import Array

# Counts, at the beginning of ``bodies``: of bodies, of the nodes on them, and of the ring, the nodes that have elements
# with nodes on bodies.
BODIES, NODES, RING = 0, 1, 2
# Sections of ``bodies``: the nodes on bodies; offsets; the ring's nodes, and the first pair of a ring node and a body
# for each; the bodies of these pairs.
INDEX, OFFSETS, RING_NODES, RING_STARTS, PAIRS = range(3, 8)
# Sections of ``data``: OWN; BODY; F (B, 9), see `tipfem.physics.bodies.term`; scheme; ARM; body force at the nodes on
# bodies (., 2); rotation terms of the pairs (., 3).
OWN, BODY, ROWS, SCHEME, ARM, FORCE, TERMS = range(8, 15)
HEADER = 15

# Columns of BODY, the constants of a body in a step: mass, moment of inertia, length by which angles are multiplied; by
# freedom, velocity and acceleration at the start, the parts of v_alpha and a_alpha that do not depend on the increment,
# stiffness, force of the springs at the start, damping; the centre of mass relative to the reference point, and the
# acceleration by gravity; by freedom, the unknown for an increment of one metre (of the angle times the length).
MASS, INERTIA, LENGTH = 0, 1, 2
VELOCITY, ACCELERATION, V_HISTORY, A_HISTORY, STIFFNESS, SPRING, DAMPING = 3, 6, 9, 12, 15, 18, 21
CENTRE, GRAVITY, UNIT, BODY_WIDTH = 24, 26, 28, 31
# Columns of SCHEME, the time integration's coefficients; d v_{n+1} / d u; and 1 if it weighs rates, see `TimeScheme`.
CM, CV, CF, ALPHA_M, V_NEXT, WEIGHS = 0, 1, 2, 3, 4, 5
# Columns of OWN: the derivative of a body's own equations row by row, and what the angle's unknown adds to the
# derivatives of v_alpha and a_alpha along and across r.
MATRIX, DV_ALONG, DA_ALONG, DA_ACROSS, OWN_WIDTH = 0, 9, 10, 11, 12
# Columns of ARM: r of a node at the start of the step, at its end, turned with the body, and at the intermediate time.
# Of nodes that slide, 0 of others: direction along a straight side, without the body's rotation in the step; direction
# of the forces that do not act on the body; how far the node slides, as predicted; v_alpha and a_alpha at u = 0 of a
# free particle.
START, END, TURNED, MIDDLE, ALONG, ROW, SLID, V_FREE, A_FREE, ARM_WIDTH = range(0, 20, 2)


def pack(lists: dict[int, Array], tables: dict[int, Array], rooms: dict[int, int]) -> tuple[Array, Array, int]:
    """The arrays ``bodies`` and ``data``, up to the last of the ``tables``, from their sections; the size of ``data``.

    ``lists`` are sections of ``bodies``, ``tables`` of ``data``; ``rooms`` entries of sections without first values.
    """
    header = np.zeros(HEADER, dtype=np.int32)
    at = HEADER
    for section, values in sorted(lists.items()):
        header[section] = at
        at += len(values)
    end, filled = 0, np.zeros(0)
    for section in sorted(tables | rooms):
        header[section] = end
        if section in tables:
            filled = np.concatenate([filled, np.zeros(end - len(filled)), np.ravel(tables[section])])
            end = len(filled)
        else:
            end += rooms[section]
    header[[BODIES, NODES, RING]] = len(lists[OFFSETS]) - 1, len(lists[INDEX]), len(lists[RING_NODES])
    bodies = np.concatenate([header, *(values for _, values in sorted(lists.items()))]).astype(np.int32)
    return bodies, filled, end


@ti.func
def node_on_body(bodies: Template, s):
    """The node with number ``s`` among those on bodies."""
    return bodies[bodies[INDEX] + s]


@ti.func
def numbers_on(bodies: Template, b):
    """The numbers of the nodes on body ``b`` among those on bodies: first, and last + 1."""
    return bodies[bodies[OFFSETS] + b], bodies[bodies[OFFSETS] + b + 1]


@ti.func
def arm(bodies: Template, data: Template, s, when: Template):
    """r of node number ``s``; ``when`` is START, END or MIDDLE."""
    at = bodies[ARM] + ARM_WIDTH * s + when
    return ti.Vector([data[at], data[at + 1]])


@ti.func
def set_arm(bodies: Template, data: Template, s, when: Template, r):
    """Set what `arm` returns."""
    at = bodies[ARM] + ARM_WIDTH * s + when
    data[at], data[at + 1] = r[0], r[1]


@ti.func
def constant(bodies: Template, data: Template, b, column):
    """A constant of body ``b``, see `BODY`."""
    return data[bodies[BODY] + BODY_WIDTH * b + column]


@ti.func
def coefficient(bodies: Template, data: Template, column: Template):
    """A coefficient of the time integration, see `SCHEME`."""
    return data[bodies[SCHEME] + column]


@ti.func
def own(bodies: Template, b, column):
    """Index in ``data`` of an entry of `OWN`."""
    return bodies[OWN] + OWN_WIDTH * b + column


@ti.func
def moment(r, f):
    """r x f."""
    return r[0] * f[1] - r[1] * f[0]


@ti.func
def unknown(k: ti.template(), base, b):
    """Index of freedom ``k`` of body ``b`` in the unknowns: two nodes per body, motion and angle, from ``base``."""
    return base + 6 * b + (3 if ti.static(k == 2) else k)
