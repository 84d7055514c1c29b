"""Vectors in the plane, and what those along closed loops of points tell of these."""

import numpy as np

from tipfem.typing import Array


def cross(a: Array, b: Array) -> Array:
    """Third components (...,) of the cross products of vectors (..., 2): > 0 where b is to the left of a."""
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])


def turned(r: Array) -> Array:
    """Vectors (..., 2) turned by a right angle, anticlockwise."""
    return np.stack([-r[..., 1], r[..., 0]], axis=-1)


def directions(r: Array) -> Array:
    """Vectors (K, 2) made of unit length, but for those that are no longer than 1e-12."""
    return np.asarray(r / np.maximum(np.linalg.norm(r, axis=1, keepdims=True), 1e-12))


def turning(angle: float) -> Array:
    """Matrix (2, 2) by which vectors in rows are turned anticlockwise by an angle [rad], from the right."""
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.array([[cosine, sine], [-sine, cosine]])


def angles(a: Array, b: Array) -> Array:
    """Angles (K,) from vectors a to b (K, 2) [rad]."""
    return np.asarray(np.arctan2(cross(a, b), (a * b).sum(axis=1)))


def bends(loop: Array, least: float) -> Array:
    """Mask (K,) of the points of a loop (K, 2) at which the sine of its angle is more than ``least``."""
    before, after = loop - np.roll(loop, 1, axis=0), np.roll(loop, -1, axis=0) - loop
    sizes = np.linalg.norm(before, axis=1) * np.linalg.norm(after, axis=1)
    return np.asarray(abs(cross(before, after)) > least * sizes)


def polygon_moments(corners: Array) -> tuple[float, Array, float]:
    """Area [m^2], centre (2,) [m] and polar second moment about it [m^4] of a polygon (K, 2), anticlockwise."""
    origin = corners.mean(axis=0)
    a = corners - origin
    b = np.roll(a, -1, axis=0)
    double = cross(a, b)
    area = 0.5 * float(double.sum())
    middle = ((a + b) * double[:, None]).sum(axis=0) / (6 * area)
    second = float((double * (a * a + a * b + b * b).sum(axis=1)).sum()) / 12 - area * float(middle @ middle)
    return area, origin + middle, second
