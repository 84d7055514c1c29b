"""Particles that have passed a boundary, and are put back before it."""

from __future__ import annotations

import numpy as np

from tipfem.case.particles import Particles
from tipfem.case.walls import Pose
from tipfem.geometry.plane.domain import Domain
from tipfem.typing import Array

# Distance from a wall of a particle that has flown through it [spacings].
OFF_WALL = 0.05


def put_before(particles: Particles, index: Array, y: Array, domain: Domain, pose: Pose, side: float) -> Particles:
    """The particles, with those of ``index`` (K,) put back that passed a domain's boundary, to ``y`` (K, 2) [m].

    ``pose`` is that of the frame of the domain, a tank's or a body's, and of ``y``; ``side`` is 1 where particles
    belong inside it, else -1.
    """
    distance, part = domain.distances(y)
    edge = np.argmin(distance, axis=1)
    foot = domain.start[edge] + part[np.arange(len(y)), edge, None] * (domain.end - domain.start)[edge]
    normal = side * domain.normal[edge] @ pose.rotation.T
    position, velocity = particles.position.copy(), particles.velocity.copy()
    position[index] = pose.place(foot) + OFF_WALL * particles.spacing * normal
    relative = velocity[index] - pose.rigid_velocity(position[index])
    velocity[index] -= np.minimum((relative * normal).sum(axis=1), 0.0)[:, None] * normal
    return particles.shallow_copy(position=position, velocity=velocity)
