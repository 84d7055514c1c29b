"""Contacts of bodies with walls and with each other.

They are found in the mesh between them, or where a free surface leaves gaps without a mesh, by their outlines.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from tipfem.arguments import rounded
from tipfem.case.body import CONTACT, Body
from tipfem.case.boundary.boundary import Boundary
from tipfem.case.particles import Particles
from tipfem.errors import SimulationError
from tipfem.geometry.plane.vectors import cross
from tipfem.mesh.mesh import Mesh, corners_among
from tipfem.physics.bodies.motion import BodyStates, body_pose, outline_of
from tipfem.typing import Array


class Contact(NamedTuple):
    """The narrowest gap between a body and a wall, or two bodies."""

    body: int  # its number
    other: int  # number of the other body, -1 for a wall
    place: Array  # (2,) [m]
    gap: float  # [m]


def find_contacts(particles: Particles, mesh: Mesh, label: Array) -> list[Contact]:
    """The contacts of bodies, one for each pair; the mesh fills the gaps, and ``label`` (N,) is the body or -1."""
    owner = np.where(label >= 0, label + 1, np.where(particles.wall, 0, -1))  # 0 for walls, -1 inside a fluid
    rows = np.flatnonzero((corners_among(owner > 0, mesh.cells) > 0) & (corners_among(owner >= 0, mesh.cells) > 1))
    cells = mesh.cells[rows]
    of = owner[cells]
    x = particles.position
    limit = CONTACT * particles.spacing
    found: dict[tuple[int, int], Contact] = {}
    for corner in range(3):
        after, last = (corner + 1) % 3, (corner + 2) % 3
        apex, b, c = (x[cells[:, k]] for k in (corner, after, last))
        edge, side = c - b, apex - b
        length = np.linalg.norm(edge, axis=1)
        # A corner over an edge of another body or wall, and an edge from one of them to another.
        height = np.abs(cross(edge, side)) / length
        across = (of[:, after] == of[:, last]) & (of[:, after] >= 0) & (of[:, corner] >= 0)
        across &= of[:, corner] != of[:, after]
        between = (of[:, after] >= 0) & (of[:, last] >= 0) & (of[:, after] != of[:, last])
        for mask, gap, one, other, place in (
            (across, height, of[:, corner], of[:, after], apex),
            (between, length, of[:, after], of[:, last], 0.5 * (b + c)),
        ):
            for k in np.flatnonzero(mask & (gap < limit)):
                pair = (int(max(one[k], other[k])), int(min(one[k], other[k])))
                if pair not in found or gap[k] < found[pair].gap:
                    found[pair] = Contact(pair[0] - 1, pair[1] - 1, place[k], float(gap[k]))
    return [found[pair] for pair in sorted(found)]


def contacts_of_outlines(
    bodies: Sequence[Body], states: BodyStates, particles: Particles, boundary: Boundary, time: float
) -> list[Contact]:
    """The contacts of bodies, one for each pair, whether there is a mesh between them or not."""
    limit, tank, frame = CONTACT * particles.spacing, boundary.tank_at(time), boundary.pose(time, 1e-6)
    poses = [body_pose(body, states, b) for b, body in enumerate(bodies)]
    outlines = [outline_of(body) for body in bodies]
    corners = [pose.place(outline.start) for pose, outline in zip(poses, outlines, strict=True)]
    found = []
    for b in range(len(bodies)):
        for other in range(-1, b):
            if bodies[b].gap or (other >= 0 and bodies[other].gap):  # these may touch
                continue
            domain, pose, ends = (
                (tank, frame, frame.place(tank.start)) if other < 0 else (outlines[other], poses[other], corners[other])
            )
            # Corners of one over edges of the other.
            gaps = np.concatenate(
                [
                    domain.distances(pose.origin(corners[b]))[0].min(axis=1),
                    outlines[b].distances(poses[b].origin(ends))[0].min(axis=1),
                ]
            )
            nearest = int(np.argmin(gaps))
            if gaps[nearest] < limit:
                found.append(Contact(b, other, np.concatenate([corners[b], ends])[nearest], float(gaps[nearest])))
    return found


def hold_contacts(
    bodies: Sequence[Body], states: BodyStates, particles: Particles, mesh: Mesh, boundary: Boundary, time: float
) -> BodyStates:
    """The bodies, those in contact held where they are; `SimulationError` if one that stops the run is."""
    held = states.held.copy()
    contacts = (
        contacts_of_outlines(bodies, states, particles, boundary, time)
        if mesh.surface.exists or any(body.gap for body in bodies)
        else find_contacts(particles, mesh, states.label)
    )
    for body, other, place, gap in contacts:
        touching = [b for b in (body, other) if b >= 0]
        moving = [b for b in touching if not states.held[b] and (bodies[b].floats or bodies[b].motion is not None)]
        stops = [b for b in moving if bodies[b].contact == "stop"]
        if stops:
            against = f"body {bodies[other].name!r}" if other >= 0 else "a wall"
            raise SimulationError(
                f"t = {time:.6g} s: body {bodies[body].name!r} is in contact with {against} at {rounded(place)} m: the "
                f"gap of {gap:.3g} m is less than {CONTACT:g} spacings, which cannot be resolved. With contact='hold' "
                f"body {bodies[stops[0]].name!r} would stay where it is from then on"
            )
        held[moving] = True
    if (held == states.held).all():
        return states
    still = np.where((held & ~states.held)[:, None], 0.0, 1.0)
    return replace(states, held=held, velocity=still * states.velocity, acceleration=still * states.acceleration)
