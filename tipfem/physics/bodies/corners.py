"""Corners of bodies: the convex ones slide, see `tipfem.physics.walls.corners`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tipfem.case.body import Body
from tipfem.case.particles import Particles
from tipfem.mesh.mesh import Mesh
from tipfem.physics.bodies.motion import BodyStates, body_pose, rigid_rates
from tipfem.physics.walls import corners as corners_of_solids
from tipfem.physics.walls.corners import THIN, Corners, corners_among
from tipfem.typing import Array


def with_corners(
    bodies: Sequence[Body],
    states: BodyStates,
    slips: Array,
    brinks: Array,
    shut: Array | None,
    mesh: Mesh,
    target: Array,
) -> BodyStates:
    """The bodies, with directions in which particles in corners slide; those of closed gaps are held.

    Along bodies of the mask ``slips`` fluids slide, those of ``brinks`` have such; ``shut`` (N,) masks particles in
    gaps that touch somewhere, which are no brinks, ``target`` (N,) are spacings [m].
    """
    label, (_, _, one, other) = states.label, mesh.hull
    i = np.flatnonzero((label >= 0) & (slips | brinks)[label] & ~states.along.any(axis=1))
    if states.in_gaps is not None:
        i = i[~states.in_gaps[i]]
    over = brinks[label[i]]
    if shut is not None:
        over &= ~shut[i]
    thin = THIN * target[i]
    found = corners_among(i, (label[one] == label[other]) & (label[one] >= 0), slips[label[i]], over, mesh, thin)
    if found is None:
        return replace(states, corners=None)
    i, directions, x = found.particles, states.along.copy(), mesh.position
    directions[i] = found.along
    off = [np.linalg.norm(_corners(bodies, states, b) - x[k], axis=1) for k, b in zip(i, label[i], strict=True)]
    corners = np.stack([i, found.before, found.after, [each.argmin() for each in off]], axis=1)
    return replace(states, along=directions, corners=corners)


def put_back(bodies: Sequence[Body], states: BodyStates, particles: Particles) -> tuple[BodyStates, Particles]:
    """The particles at the end of a step, those of corners in these again."""
    assert states.corners is not None
    corner, before, after, number = states.corners.T
    of, directions = states.label[corner], states.along.copy()
    place = np.array([_corners(bodies, states, b)[k] for b, k in zip(of, number, strict=True)])

    def rates(x: Array) -> tuple[Array, Array]:
        return rigid_rates(x - states.position[of, :2], states.velocity[of], states.acceleration[of])

    corners = Corners(corner, before, after, directions[corner], np.zeros(len(corner), dtype=bool))
    back = corners_of_solids.put_back(corners, place, directions, rates, particles)
    directions[corner] = 0.0
    return replace(states, along=directions, corners=None), back


def _corners(bodies: Sequence[Body], states: BodyStates, number: int) -> Array:
    """(K, 2) of the outline of a body [m]."""
    return body_pose(bodies[number], states, number).place(bodies[number].corners)
