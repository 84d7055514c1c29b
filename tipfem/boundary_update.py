"""The boundary of particles that have changed places: which of them are wall particles now, and where."""

from __future__ import annotations

import copy

import numpy as np

from tipfem.boundary import Boundary
from tipfem.particles import Array, Particles
from tipfem.walls import Pose

# A wall particle this close to a side's line is on it [spacings]: splits and slides are right to round-off.
ON_SIDE = 1e-5


def reassigned(boundary: Boundary, particles: Particles, pose: Pose, displacement: Array) -> Boundary:
    """The same walls on other particles, in 2-D; a particle of a wall is one that stands on its line.

    Args:
        boundary: of the particles as they were; a wall keeps the ends that it has there.
        particles: as they are.
        pose: where the tank is.
        displacement: (S,) of the sides along their normals [m].
    """
    new = copy.copy(boundary)
    new.index = np.flatnonzero(particles.wall)
    new._y = pose.origin(particles.position[new.index])
    heights = new._y @ boundary.side_normal.T - (boundary.offset + displacement)
    new.on_side = np.abs(heights) < ON_SIDE * particles.spacing
    new.normal, new.side = _frames(boundary.side_normal, new.on_side)
    new.inverse = np.linalg.pinv(new.normal, rcond=1e-9)
    new.members = []
    for side, old in boundary.members:
        along = new._y @ boundary._tangent(side)
        found = np.flatnonzero(new.on_side[:, side])
        if len(old) < boundary.on_side[:, side].sum():  # a part of its side
            ends = boundary._y[old[[0, -1]]] @ boundary._tangent(side)
            slack = ON_SIDE * particles.spacing
            found = found[(along[found] > ends[0] - slack) & (along[found] < ends[1] + slack)]
        new.members.append((side, found[np.argsort(along[found])]))
    new.pieces = []
    new.still, new.stays = particles.wall.copy(), particles.wall.copy()
    new._assign()
    return new


def _frames(normals: Array, on_side: Array) -> tuple[Array, Array]:
    """Normals (W, 2, 2) and numbers (W, 2) of the first two sides that each wall particle is on, not parallel."""
    rows = np.arange(len(on_side))
    first = np.argmax(on_side, axis=1)
    cross = normals[first, 0][:, None] * normals[:, 1] - normals[first, 1][:, None] * normals[:, 0]
    others = on_side & (np.abs(cross) > 1e-6)
    others[rows, first] = False
    second = np.argmax(others, axis=1)
    side = np.stack([first, np.where(others.any(axis=1), second, 0)], axis=1)
    normal = normals[side]
    normal[~on_side.any(axis=1), 0] = 0.0
    normal[~others.any(axis=1), 1] = 0.0
    return normal, side
