"""Brinks: corners of walls that slip, over which a fluid runs into empty space.

A particle in a corner where two walls meet is held by both. Where the fluid wets but one of them, and leaves it at the
corner, it would slide on: its particle does so in the step, as if its wall went on, and is put back into the corner
after it. Were it held, the lowest spacing of the flow would stand still there, and the jet would leave too high.
"""

from __future__ import annotations

import copy
from typing import NamedTuple

import numpy as np

from tipfem.case.boundary.boundary import Boundary
from tipfem.case.particles import Particles
from tipfem.geometry.domain import Domain
from tipfem.mesh.mesh import Mesh
from tipfem.typing import Array

# Cosine of the angle between the wall and the surface beyond the corner, at least. Where a jet bends more within a
# spacing, as over a sharp crest, what is put back is no small part of it, and the depth before it comes out worse.
STRAIGHT = 0.8
BEFORE = 0.05  # distance from the corner of a particle of the wall that has slid over it [targets]


class Brinks(NamedTuple):
    """K corners over which a fluid runs in a step.

    Attributes:
        row: (K,) their particles, as positions in `Boundary.index`.
        along: (K, 2) unit vectors along the wet wall, beyond the corner.
        beside: (K,) the next particle on that wall.
        place: (K, 2) of the corners [m].
    """

    row: Array
    along: Array
    beside: Array
    place: Array

    def loosened(self, boundary: Boundary) -> Boundary:
        """A boundary on which the particles of the corners slide along the walls that are wet."""
        new = copy.copy(boundary)
        new.free = boundary.free.copy()
        new.free[self.row] = self.along[:, :, None] * self.along[:, None, :]
        new.slides = np.union1d(boundary.slides, self.row)
        return new

    def put_back(self, particles: Particles, index: Array) -> Particles:
        """The particles at the end of a step, with those of the corners there again, with the velocity that is there.

        Args:
            particles: at the end of the step.
            index: (W,) the wall particles.
        """
        back, corner, place = particles.copy(), index[self.row], self.place
        moved, beside = particles.position[corner], particles.position[self.beside]
        off = np.einsum("kc,kc->k", beside - place, self.along)
        reach = np.einsum("kc,kc->k", moved - beside, self.along)
        part = np.clip(np.where(reach > 0, -off / np.where(reach > 0, reach, 1.0), 1.0), 0.0, 1.0)[:, None]
        for name in ("velocity", "acceleration"):
            old, values = getattr(particles, name), getattr(back, name)
            values[corner] = (1 - part) * old[self.beside] + part * old[corner]
        back.position[corner] = place
        over = np.flatnonzero(off > -BEFORE * particles.target[self.beside])
        least = BEFORE * particles.target[self.beside[over]]
        back.position[self.beside[over]] = place[over] - least[:, None] * self.along[over]
        return back

    def imposed(self, given: Particles, done: Particles) -> Particles:
        """Particles ``done`` with what walls prescribe, but in the corners, where they are as ``given``."""
        at = np.linalg.norm(given.position[:, None] - self.place, axis=2).argmin(axis=0)
        result = done.copy()
        for name in ("velocity", "acceleration"):
            getattr(result, name)[at] = getattr(given, name)[at]
        return result


def brinks_of(boundary: Boundary, mesh: Mesh) -> Brinks | None:
    """The brinks of walls at rest at the start of a step; None without any.

    Args:
        boundary: which particles lie on which walls.
        mesh: of the step.
    """
    if boundary.dimension != 2 or not boundary.room or not boundary.at_rest or boundary.curves:
        return None
    rows = np.flatnonzero(boundary.normal[:, 1].any(axis=1))
    slippery = np.zeros(boundary.on_side.shape[1], dtype=bool)
    for number, side, _ in boundary.members:
        slippery[side] |= boundary.walls[number].slips
    if not len(rows) or not slippery.any():
        return None
    domain = boundary.domain
    assert isinstance(domain, Domain)
    direction, on_side = domain.direction, np.zeros((len(mesh.position), len(slippery)), dtype=bool)
    on_side[boundary.index] = boundary.on_side
    start, end = mesh.hull[2:]
    found = []
    for row in rows.tolist():
        corner, sides = boundary.index[row], np.flatnonzero(boundary.on_side[row])
        before, after = start[end == corner], end[start == corner]
        if len(sides) != 2 or not slippery[sides].all() or len(before) != 1 or len(after) != 1:
            continue
        ends = np.linalg.norm(domain.end[sides] - mesh.position[corner], axis=1)
        arrives, leaves = sides[np.argsort(ends)]
        one, other = direction[arrives], direction[leaves]
        wet = on_side[before[0], arrives], on_side[after[0], leaves]
        if one[0] * other[1] - one[1] * other[0] >= 0 or wet[0] == wet[1]:
            continue
        along, beside, beyond = (one, before[0], after[0]) if wet[0] else (-other, after[0], before[0])
        if boundary.passages is not None and boundary.passages.open[beyond]:
            continue
        way = mesh.position[beyond] - mesh.position[corner]
        if way @ along > STRAIGHT * np.linalg.norm(way):
            found.append((row, *along, beside))
    if not found:
        return None
    table = np.array(found)
    return Brinks(
        table[:, 0].astype(int),
        table[:, 1:3],
        table[:, 3].astype(int),
        mesh.position[boundary.index[table[:, 0].astype(int)]],
    )
