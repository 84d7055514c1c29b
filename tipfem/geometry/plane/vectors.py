"""Vectors in the plane."""

import numpy as np

from tipfem.typing import Array


def cross(a: Array, b: Array) -> Array:
    """Third components (...,) of the cross products of vectors (..., 2): > 0 where b is to the left of a."""
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])


def turned(r: Array) -> Array:
    """Vectors (..., 2) turned by a right angle, anticlockwise."""
    return np.stack([-r[..., 1], r[..., 0]], axis=-1)


def turning(angle: float) -> Array:
    """Matrix (2, 2) by which vectors in rows are turned anticlockwise by an angle [rad], from the right."""
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.array([[cosine, sine], [-sine, cosine]])


def angles(a: Array, b: Array) -> Array:
    """Angles (K,) from vectors a to b (K, 2) [rad]."""
    return np.asarray(np.arctan2(cross(a, b), (a * b).sum(axis=1)))
