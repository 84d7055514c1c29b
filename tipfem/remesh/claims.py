"""Claims of particles, by which changes to a triangulation are made many at once, in rounds.

Each change has a group of particles around it, and two changes that share none of them touch nothing in common. In a
round every change that is wanted stakes a claim on its particles. The most urgent one has each; a change that has all
of its own is made, the others wait. Which these are depends on no order: the best of whole numbers is found by atomic
operations. So one thread, many, and a GPU do the same, bit by bit, and nothing depends on how particles are listed.

In a round all changes that are wanted go through each of its stages before the next: `release`; `stake`; those that
nowhere stand behind, `is_first`, `stake_tie`; and of these, those that have all of theirs, `holds_all`, are made. The
most urgent of all is among them.
"""

from typing import NamedTuple

import taichi as ti

from tipfem.backend.array_types import Longs1, Template
from tipfem.remesh.triangles.edge_operations import entry

# Bits of an urgency that are left out, so that round-off decides nothing (2e-10 of its value); and of a name.
ROUND_OFF_BITS, NAME_BITS = 20, 30


class Claims(NamedTuple):
    """Claims on N particles; 0 where none claims a particle."""

    urgency: "Longs1"  # (N,) that of the most urgent change at each particle
    tie: "Longs1"  # (N,) of those as urgent as the best at all of their particles, the largest place and name


@ti.func
def whole_urgency(urgency):
    """An urgency > 0 as a whole number that grows with it."""
    return ti.bit_cast(ti.cast(urgency, ti.f64), ti.i64) >> ROUND_OFF_BITS


@ti.func
def whole_place(place, name):
    """A place and a name below 2^`NAME_BITS`, in this order, as a whole number > 0 that grows with them."""
    bits = ti.bit_cast(ti.cast(place, ti.f64), ti.i64)
    if bits < 0:
        bits = bits ^ ti.i64(0x7FFFFFFFFFFFFFFF)  # without the sign: negative numbers' bits fall as they grow
    return ((bits >> (NAME_BITS + 1)) + (ti.i64(1) << (62 - NAME_BITS)) << NAME_BITS) + ti.i64(name) + 1


@ti.func
def raise_to(values: Template, p, value, alone: Template):
    """Raise entry p to ``value`` at least; ``alone``: one thread does all."""
    if ti.static(alone):
        values[p] = ti.max(values[p], value)
    else:
        ti.atomic_max(values[p], value)


@ti.func
def release(claims: Template, group: Template, count: Template):
    """Drop all claims on the first ``count`` particles of a `Segment`."""
    for k in ti.static(range(count)):
        claims.urgency[entry(group, k)] = ti.i64(0)
        claims.tie[entry(group, k)] = ti.i64(0)


@ti.func
def stake(claims: Template, group: Template, count: Template, urgency, alone: Template):
    """Claim the particles by the change's urgency."""
    for k in ti.static(range(count)):
        raise_to(claims.urgency, entry(group, k), whole_urgency(urgency), alone)


@ti.func
def is_first(claims: Template, group: Template, count: Template, urgency):
    """Whether no change that claims one of the particles is more urgent."""
    result = True
    for k in ti.static(range(count)):
        result = result and claims.urgency[entry(group, k)] == whole_urgency(urgency)
    return result


@ti.func
def stake_tie(claims: Template, group: Template, count: Template, tie, alone: Template):
    """Claim the particles among changes as urgent; ``tie``: see `whole_place`."""
    for k in ti.static(range(count)):
        raise_to(claims.tie, entry(group, k), tie, alone)


@ti.func
def holds_all(claims: Template, group: Template, count: Template, tie):
    """Whether a change that was `is_first` has all of its particles."""
    result = True
    for k in ti.static(range(count)):
        result = result and claims.tie[entry(group, k)] == tie
    return result
