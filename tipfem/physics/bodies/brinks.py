"""Brinks of bodies: corners at which a fluid that slides along an outline leaves it into empty space.

As at those of walls, see `tipfem.physics.walls.brinks`, the corner's particle slides on in the step, as if the side
went on, and is put back after it. Were it held, the lip of a gate that is lifted would take the fluid up with it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tipfem.case.body import Body
from tipfem.case.particles import Particles
from tipfem.mesh.mesh import Mesh
from tipfem.physics.bodies.motion import BodyStates, body_pose
from tipfem.physics.walls.brinks import STRAIGHT
from tipfem.typing import Array


def with_brinks(bodies: Sequence[Body], states: BodyStates, slips: Array, mesh: Mesh) -> BodyStates:
    """The bodies, with directions in which particles of brinks slide.

    Args:
        bodies: of the case.
        states: of the bodies, with directions elsewhere.
        slips: (B,) mask of the bodies that have brinks.
        mesh: on the same particles.
    """
    label = states.label
    corner = (label >= 0) & slips[label] & ~states.along.any(axis=1)
    if states.in_gaps is not None:
        corner &= ~states.in_gaps
    start, end = mesh.hull[2:]
    before, after = np.full((2, len(label)), -1)
    before[end], after[start] = start, end
    corner &= (before >= 0) & (after >= 0) & (np.bincount(start, minlength=len(label)) == 1)
    i = np.flatnonzero(corner)
    wet = np.stack([label[before[i]] == label[i], label[after[i]] == label[i]])
    i, wet = i[wet[0] != wet[1]], wet[:, wet[0] != wet[1]]
    beside, beyond = np.where(wet[0], before[i], after[i]), np.where(wet[0], after[i], before[i])
    x = mesh.position
    along, way = (mesh.period.shortest(side) for side in (x[i] - x[beside], x[beyond] - x[i]))
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    leaves = (way * along).sum(axis=1) > STRAIGHT * np.linalg.norm(way, axis=1)
    if not leaves.any():
        return replace(states, brinks=None)
    i, beside, directions = i[leaves], beside[leaves], states.along.copy()
    directions[i] = along[leaves]
    numbers = [
        int(np.linalg.norm(_corners(bodies, states, b) - place, axis=1).argmin())
        for b, place in zip(label[i], x[i], strict=True)
    ]
    return replace(states, along=directions, brinks=np.stack([i, beside, numbers], axis=1))


def put_back(bodies: Sequence[Body], states: BodyStates, particles: Particles) -> tuple[BodyStates, Particles]:
    """The particles at the end of a step, those of brinks in their corners again, with the velocity that is there.

    Args:
        bodies: of the case.
        states: of the bodies at the end of the step.
        particles: at the end.
    """
    assert states.brinks is not None
    corner, beside, number = states.brinks.T
    place = np.array([_corners(bodies, states, b)[k] for b, k in zip(states.label[corner], number, strict=True)])
    along, moved = states.along[corner], particles.position
    off = -((moved[beside] - place) * along).sum(axis=1)
    reach = ((moved[corner] - moved[beside]) * along).sum(axis=1)
    part = np.clip(np.where(reach > 0, off / np.where(reach > 0, reach, 1.0), 1.0), 0.0, 1.0)[:, None]
    back, directions = particles.copy(), states.along.copy()
    for name in ("velocity", "acceleration"):
        old, values = getattr(particles, name), getattr(back, name)
        values[corner] = (1 - part) * old[beside] + part * old[corner]
    back.position[corner], directions[corner] = place, 0.0
    return replace(states, along=directions, brinks=None), back


def _corners(bodies: Sequence[Body], states: BodyStates, number: int) -> Array:
    """(K, 2) of the outline of a body [m]."""
    return body_pose(bodies[number], states, number).place(bodies[number].corners)
