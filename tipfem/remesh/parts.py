"""Carried parts of the physics, through a remeshing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from tipfem.case.particles import Particles
from tipfem.physics.carried import Carried, Remap
from tipfem.physics.physics import Physics


def carried(
    physics: Sequence[Physics[Any]], parts: Mapping[str, Carried], particles: Particles, remap: Remap
) -> tuple[dict[str, Carried], Particles]:
    """The parts of a state after a remeshing, and the particles with what they change of them."""
    result = {}
    for each in physics:
        part, particles = each.remeshed(parts.get(each.name), particles, remap)
        if part is not None:
            result[each.name] = part
    return result, particles


def imposed(parts: Mapping[str, Carried], particles: Particles) -> Particles:
    """The particles with the velocities and accelerations that the parts of a state prescribe."""
    for part in parts.values():
        particles = part.imposed(particles)
    return particles
