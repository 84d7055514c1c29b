"""Cameras that look at a tank in three dimensions, and the tank's walls and edges as they see them."""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import ConvexHull, QhullError

from .arrays import Array, Box

USUAL = (-25.0, 18.0)  # azimuth and elevation [degrees]
_AWAY = 2.2  # of the camera from the middle of the tank, in the tank's diagonals


@dataclass(frozen=True)
class Camera:
    """A camera that sees a whole tank."""

    eye: Array  # (3,) where it is [m]
    axes: Array  # (3, 3) rows: to the right, downwards and forwards in the picture
    focal: float  # its focal length [px]
    centre: Array  # (2,) where the line forwards meets the picture [px]

    @classmethod
    def around(cls, corners: Array, up: int, angles: tuple[float, float], box: Box) -> "Camera":
        """The camera for which corners (K, 3) [m] fill a box, left, top, right, bottom, of the picture [px].

        ``angles`` are azimuth and elevation [degrees]: from where the axis after the upward one, ``up``, points to the
        right, the camera goes round the tank, anticlockwise seen from above, and upwards.
        """
        azimuth, elevation = np.radians(angles)
        x, y, z = np.eye(3)
        frame = [(y, z, x), (x, -z, y), (x, y, z)][up]  # to the right, forwards and up
        right = np.cos(azimuth) * frame[0] + np.sin(azimuth) * frame[1]
        ahead = np.cos(azimuth) * frame[1] - np.sin(azimuth) * frame[0]
        forwards = np.cos(elevation) * ahead - np.sin(elevation) * frame[2]
        axes = np.stack([right, np.cross(forwards, right), forwards])
        low, high = corners.min(axis=0), corners.max(axis=0)
        eye = (low + high) / 2 - _AWAY * np.linalg.norm(high - low) * forwards
        seen = (corners - eye) @ axes.T
        seen = seen[:, :2] / seen[:, 2:]
        left, top, far, bottom = box
        low, high = seen.min(axis=0), seen.max(axis=0)
        focal = float(((far - left, bottom - top) / (high - low)).min())
        centre = np.array([left + far, top + bottom]) / 2 - focal * (low + high) / 2
        return cls(eye, axes, focal, centre)

    def seen(self, points: ArrayLike) -> Array:
        """Points (..., 3) [m] in the picture: x and y [px], y down, and distance forwards [m]."""
        at = (np.asarray(points) - self.eye) @ self.axes.T
        return np.concatenate([self.centre + self.focal * at[..., :2] / at[..., 2:], at[..., 2:]], axis=-1)


def checked_angles(angles: Iterable[float]) -> tuple[float, float]:
    """Azimuth and elevation of a camera as numbers [degrees]; `ValueError` unless finite, the second up to 90."""
    try:
        azimuth, elevation = (float(angle) for angle in angles)
    except (TypeError, ValueError):
        raise ValueError(f"camera {angles!r}: expected two numbers, azimuth and elevation [degrees]") from None
    if not (np.isfinite(azimuth) and -90 <= elevation <= 90):
        text = "expected an azimuth and an elevation from -90 to 90 degrees"
        raise ValueError(f"camera {azimuth:g}, {elevation:g}: {text}")
    return azimuth, elevation


class Room:
    """The convex space between a tank's walls, by points (K, 3) on them [m].

    Attributes:
        corners: (C, 3) [m].
        planes: (P, 4) normals outwards and distances from the origin: n . x <= d inside.
        bases: (P, 2, 3) directions in each plane, along edges of the tank.
        edges: (E, 2, 3) ends [m].
        beside: (E, 2) numbers of the planes at each edge.

    Raises:
        ValueError: they enclose no space.
    """

    def __init__(self, points: Array) -> None:
        try:
            hull = ConvexHull(points)
        except QhullError:
            raise ValueError("the particles on walls enclose no space") from None
        size = float(np.ptp(points, axis=0).max())
        facets = np.round(hull.equations / [1, 1, 1, size], 5) + 0.0
        _, first, plane = np.unique(facets, axis=0, return_index=True, return_inverse=True)
        plane = plane.reshape(-1)
        self.corners = points[hull.vertices]
        self.planes = hull.equations[first] * [1, 1, 1, -1]
        number = np.arange(len(plane))
        ends, beside = [], []
        for k in range(3):  # the side that is opposite to each corner
            other = hull.neighbors[:, k]
            apart = (plane != plane[other]) & (number < other)
            ends.append(points[hull.simplices[apart][:, [(k + 1) % 3, (k + 2) % 3]]])
            beside.append(np.stack([plane, plane[other]], axis=1)[apart])
        self.edges, self.beside = np.concatenate(ends), np.concatenate(beside)

    @cached_property
    def bases(self) -> Array:
        """Directions (P, 2, 3) in each plane, the first along its longest edge."""
        along = self.edges[:, 1] - self.edges[:, 0]
        found = []
        for number, plane in enumerate(self.planes):
            own = np.flatnonzero((self.beside == number).any(axis=1))
            side = along[own[np.linalg.norm(along[own], axis=1).argmax()]]
            side = side / np.linalg.norm(side)
            found.append([side, np.cross(plane[:3], side)])
        return np.array(found)

    @property
    def origin(self) -> Array:
        """The corner (3,) from which the lines on its walls are measured [m]."""
        return np.asarray(self.corners[self.corners.sum(axis=1).argmin()])

    def before(self, camera: Camera) -> Array:
        """Mask (E,) of the edges in front of what is in the tank: all that are not between two walls behind it."""
        front = self.planes[:, :3] @ camera.eye > self.planes[:, 3]
        return np.asarray(front[self.beside].any(axis=1))
