"""Polyhedra: convex regions bounded by planes, for walls in 3-D; in 2-D see `tipfem.geometry.plane.domain`."""

from __future__ import annotations

import numpy as np
from scipy.spatial import ConvexHull

from tipfem.typing import Array


class Polyhedron:
    """The convex hull of points in 3-D.

    Args:
        points: (N, 3) [m].
        reach: a point is on a plane if it is closer to it than this [m].

    Attributes:
        convex: True, see `tipfem.geometry.plane.domain.Domain`.
        normal: (S, 3) of the planes, inwards, of unit length.
        offset: (S,) n . x of the planes [m].
        direction: (S, 3) zero: walls slide along an edge in 2-D only.
        sense: (S,) one, see `tipfem.geometry.plane.domain.Domain`.
        whole: volume of the hull [m^3].
    """

    convex = True

    def __init__(self, points: Array, reach: float) -> None:
        centre, size = points.mean(axis=0), np.ptp(points, axis=0).max()
        hull = ConvexHull((points - centre) / size)
        self.whole = float(hull.volume * size**3)
        facets = hull.equations[np.unique(hull.equations.round(9), axis=0, return_index=True)[1]]
        corners = points[hull.vertices]
        normals: list[Array] = []
        offsets: list[float] = []
        for facet in facets:
            n = np.where(np.abs(facet[:-1]) < 1e-12, 0.0, -facet[:-1])
            on = corners[np.abs((corners - centre) @ n - facet[-1] * size) < reach]
            known = [
                n @ m > 1 - 1e-10 and (abs(on @ m - c) < reach).any() for m, c in zip(normals, offsets, strict=True)
            ]
            if len(on) and not any(known):
                normals.append(n)
                offsets.append(float(np.median(on @ n)))  # exact for walls along an axis
        self.normal, self.offset = np.array(normals), np.array(offsets)
        self.direction, self.sense = np.zeros_like(self.normal), np.ones(len(normals))

    def __len__(self) -> int:
        return len(self.normal)

    @property
    def kinds(self) -> Array:
        """(S,) numbers of the planes' directions."""
        return np.arange(len(self))

    def clear(self, x: Array, reach: float) -> Array:
        """Mask (K,) of the points (K, 3) [m] inside that are farther than ``reach`` [m] from all planes."""
        return np.asarray((x @ self.normal.T - self.offset > reach).all(axis=1))

    def on_edges(self, x: Array, tolerance: float) -> Array:
        """Mask (K, S) of the planes that the points (K, 3) [m] are on, up to ``tolerance`` [m]."""
        return np.asarray(np.abs(x @ self.normal.T - self.offset) < tolerance)
