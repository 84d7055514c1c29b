"""Particles that belong to a wall given by its two ends, or by particles, and the side that it is on."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from tipfem.arguments import numbers
from tipfem.case.particles import Particles
from tipfem.case.walls import Wall
from tipfem.errors import Invalid
from tipfem.geometry.plane.domain import Domain
from tipfem.typing import Array

ON_LINE = 1e-6  # a wall particle lies on a straight side if it is closer to it than this [spacings]
CHORDS = math.radians(37.0)  # largest angle between two straight sides of a wall that are chords of a curve


def members_of(wall: Wall, particles: Particles, y: Array, on_side: Array, normal: Array) -> tuple[int, Array]:
    """The side that a wall is on, and the rows of its particles, in order along the wall in 2-D.

    Of the W particles on walls ``y`` (W, d) are positions [m], ``on_side`` (W, S) masks the sides that they are on,
    with the normals (S, d) inwards. `Invalid` if the wall has too few particles, others than those of walls, or ones
    that are not on one side.
    """
    d, slack = particles.dimension, ON_LINE * particles.spacing

    def invalid(text: str, *key: str) -> Invalid:
        return Invalid(("walls", wall.name, *key), text, f"Case: wall {wall.name!r}")

    if wall.between is not None:
        if d != 2:
            raise invalid("is for 2-D; give its particles by index or mask", "between")
        a, b = numbers(wall.between)
        length = np.linalg.norm(b - a)
        along = (y - a) @ (b - a) / ((b - a) @ (b - a))
        off = np.linalg.norm(y - a - along[:, None] * (b - a), axis=1)
        found = np.flatnonzero((off < slack) & (along > -slack / length) & (along < 1 + slack / length))
    else:
        found = np.searchsorted(np.flatnonzero(particles.wall), np.unique(_given(wall, particles, invalid)))
    if len(found) < d + 1:
        raise invalid(f": only {len(found)} wall particles belong to it; it needs {d + 1} or more")
    common = on_side[found].all(axis=0)
    if not common.any():
        k = int(np.argmax(on_side[found].sum(axis=0)))
        stray = found[np.argmin(on_side[found, k])]
        text = f": particle {np.flatnonzero(particles.wall)[stray]} at {y[stray].tolist()} is not on one straight side "
        text += "of the tank with the others; slip, velocity and motion are for straight walls, and for the sides of "
        raise invalid(f"{text}shapes")
    side = int(np.argmax(common))
    if d == 2:
        found = found[np.argsort(y[found] @ np.array([-normal[side, 1], normal[side, 0]]))]
    count = on_side[:, side].sum()
    if (d == 3 or wall.motion is not None) and len(found) < count:
        text = f": it is {len(found)} of the {count} particles of its side; a wall with a motion, and any in 3-D, must"
        raise invalid(f"{text} be the whole side")
    return side, found


def _given(wall: Wall, particles: Particles, invalid: Callable[..., Invalid]) -> Array:
    """The particles of a wall by their numbers, given as these or as a mask."""
    given = np.asarray(wall.particles)
    given = np.flatnonzero(given) if given.dtype == bool and given.shape == particles.wall.shape else given
    if given.ndim != 1 or given.dtype.kind not in "iu" or (given < 0).any() or (given >= len(particles)).any():
        raise invalid(f"must be indices from 0 to {len(particles) - 1}, or a mask of all", "particles")
    if not particles.wall[given].all():
        i = int(given[np.argmin(particles.wall[given])])
        raise invalid(f": particle {i} at {particles.position[i].tolist()} is not a wall particle")
    return given


def smooth_joints(domain: Domain, on_side: Array, wall: Array) -> Array:
    """Mask (W, S) of the particles at corners where an edge of an arc, or of a ``wall`` (S,) of chords, goes on."""
    before = np.argsort(domain.following)  # the edge that ends where each begins
    arc = (domain.curve >= 0) & (domain.curve == domain.curve[before])
    chords = (wall >= 0) & (wall == wall[before]) & (np.abs(domain.turn[before]) < CHORDS) & (domain.curve < 0)
    return np.asarray(on_side & on_side[:, before] & (arc | chords))
