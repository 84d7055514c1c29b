"""Convex corners of bodies along which fluids slide round: their particles slide, too, and are put back after the step.

Held, a corner's particle would stop the flow that is fastest there. In the step it slides along the bisector of the
sides' directions; the volume beside the corner that this opens is taken from continuity, see
`tipfem.physics.walls.chords`. So nothing passes the corner in the mesh, and the fluid does. A brink, where the fluid
leaves the body into empty space, is a corner with one side: as at those of walls, see `tipfem.physics.walls.brinks`,
its particle slides on as if this side went on.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tipfem.case.body import Body
from tipfem.case.particles import Particles
from tipfem.mesh.mesh import Mesh
from tipfem.physics.bodies.motion import BodyStates, body_pose, rigid_rates
from tipfem.physics.walls.brinks import BEFORE, STRAIGHT
from tipfem.typing import Array


def with_corners(
    bodies: Sequence[Body], states: BodyStates, slips: Array, brinks: Array, shut: Array | None, mesh: Mesh
) -> BodyStates:
    """The bodies, with directions in which particles in corners slide.

    Those at contacts with interfaces and surfaces, or beside them, are held, and those of closed gaps.

    Args:
        bodies: of the case.
        states: of the bodies, with directions elsewhere.
        slips: (B,) mask of the bodies along which fluids slide,
        brinks: (B,) and of those that have brinks.
        shut: (N,) mask of particles in gaps that touch somewhere, which are no brinks; None for none.
        mesh: on the same particles.
    """
    label, (cell, _, after_of, before_of) = states.label, mesh.hull
    i = np.flatnonzero((label >= 0) & (slips | brinks)[label] & ~states.along.any(axis=1))
    if states.in_gaps is not None:
        i = i[~states.in_gaps[i]]
    # Along outlines, with the bodies on their left.
    before, after, arrives, leaves = np.full((4, len(label)), -1)
    before[after_of], after[before_of], arrives[after_of], leaves[before_of] = before_of, after_of, cell, cell
    i = i[(before[i] >= 0) & (after[i] >= 0) & (np.bincount(before_of, minlength=len(label))[i] == 1)]
    beside = np.stack([before[i], after[i]])
    x = mesh.position
    one, other = (mesh.period.shortest(way) for way in (x[i] - x[beside[0]], x[beside[1]] - x[i]))
    one, other = (way / np.linalg.norm(way, axis=1, keepdims=True) for way in (one, other))
    wet = label[beside] == label[i]
    fluid = np.zeros(len(mesh.cells)) if mesh.fluid is None else np.asarray(mesh.fluid)
    inside = (label[before] == label) & (label[after] == label) & (fluid[arrives] == fluid[leaves])
    both = slips[label[i]] & inside[i] & inside[beside].all(axis=0)
    both &= one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0] > 0
    lone = brinks[label[i]] & (wet[0] != wet[1]) & ((one * other).sum(axis=1) > STRAIGHT)
    if shut is not None:
        lone &= ~shut[i]
    along = np.where(both[:, None], one + other, np.where(wet[0][:, None], one, other))
    here = both | lone
    if not here.any():
        return replace(states, corners=None)
    i, along, directions = i[here], along[here], states.along.copy()
    directions[i] = along / np.linalg.norm(along, axis=1, keepdims=True)
    off = [np.linalg.norm(_corners(bodies, states, b) - x[k], axis=1) for k, b in zip(i, label[i], strict=True)]
    ends = np.where(wet, beside, -1)[:, here]
    return replace(states, along=directions, corners=np.stack([i, *ends, [each.argmin() for each in off]], axis=1))


def put_back(bodies: Sequence[Body], states: BodyStates, particles: Particles) -> tuple[BodyStates, Particles]:
    """The particles at the end of a step, those of corners in these again, with the velocity that is there.

    That relative to the body is linear between the corner's particle and the one that it has slid away from; which
    keeps off the corner.

    Args:
        bodies: of the case.
        states: of the bodies at the end of the step.
        particles: at the end.
    """
    assert states.corners is not None
    corner, before, after, number = states.corners.T
    of, back, directions = states.label[corner], particles.copy(), states.along.copy()
    place = np.array([_corners(bodies, states, b)[k] for b, k in zip(of, number, strict=True)])
    slid = ((particles.position[corner] - place) * directions[corner]).sum(axis=1)
    beside = np.where(slid > 0, before, after)
    moves = (slid != 0) & (beside >= 0)
    beside = np.where(moves, beside, corner)
    slides = directions[beside].any(axis=1)
    ways = np.where(slides[:, None], directions[beside], directions[corner])
    towards = np.where(slid > 0, 1.0, -1.0)[:, None] * ways
    off = ((place - particles.position[beside]) * towards).sum(axis=1)
    reach = np.maximum(off, 0.0)
    part = np.where(moves, reach / np.where(moves, reach + np.abs(slid), 1.0), 1.0)
    here, there = (
        rigid_rates(r - states.position[of, :2], states.velocity[of], states.acceleration[of])
        for r in (particles.position[corner], particles.position[beside])
    )
    at_place = rigid_rates(place - states.position[of, :2], states.velocity[of], states.acceleration[of])
    for name, *own in zip(("velocity", "acceleration"), here, there, at_place, strict=True):
        old, values = getattr(particles, name), getattr(back, name)
        one = ((old[corner] - own[0]) * directions[corner]).sum(axis=1)
        other = ((old[beside] - own[1]) * ways).sum(axis=1)
        values[corner] = own[2] + (part * one + (1 - part) * other)[:, None] * directions[corner]
    back.position[corner] = place
    least = BEFORE * particles.target[beside]
    near = np.flatnonzero(moves & slides & (off < least) & ~np.isin(beside, corner))
    back.position[beside[near]] = place[near] - least[near, None] * towards[near]
    directions[corner] = 0.0
    return replace(states, along=directions, corners=None), back


def _corners(bodies: Sequence[Body], states: BodyStates, number: int) -> Array:
    """(K, 2) of the outline of a body [m]."""
    return body_pose(bodies[number], states, number).place(bodies[number].corners)
