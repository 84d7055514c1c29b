"""Drawings for all back ends: coloured triangles in painter's order, in pixels.

Pixels are those of the finished picture: x to the right, y down, (0, 0) the corner of the top left pixel.
Lines and dots are triangles too, so that they are the same in all back ends.
"""

import numpy as np
from numpy.typing import ArrayLike

from .arrays import Array

# A hexagon as a fan of four triangles.
_ANGLES = np.deg2rad(60 * np.arange(6))
_HEXAGON = np.stack([np.cos(_ANGLES), np.sin(_ANGLES)], axis=1)
_FAN = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5]])


class Drawing:
    """Triangles added in painter's order: later ones cover earlier ones."""

    def __init__(self) -> None:
        self._vertices: list[Array] = []
        self._colours: list[Array] = []

    def triangles(self, vertices: ArrayLike, colours: ArrayLike) -> None:
        """Add triangles.

        Args:
            vertices: (T, 3, 2) [px].
            colours: (3,) for all, (T, 3) for each triangle, or (T, 3, 3) for each vertex.
        """
        vertices = np.asarray(vertices, np.float32)
        colours = np.asarray(colours, np.float32)
        if colours.ndim == 2:
            colours = colours[:, None, :]
        self._vertices.append(vertices)
        self._colours.append(np.broadcast_to(colours, (len(vertices), 3, 3)))

    def lines(self, segments: ArrayLike, width: float, colour: ArrayLike, cap: float = 0.0) -> None:
        """Add line segments.

        Args:
            segments: (S, 2, 2) ends [px].
            width: [px].
            colour: (3,) for all, or (S, 3) for each segment.
            cap: length added at both ends [px].
        """
        segments = np.asarray(segments, np.float64)
        start, end = segments[:, 0], segments[:, 1]
        along = end - start
        length = np.linalg.norm(along, axis=1, keepdims=True)
        along = along / np.maximum(length, 1e-12)
        aside = np.stack([-along[:, 1], along[:, 0]], axis=1) * (width / 2)
        start, end = start - cap * along, end + cap * along
        corners = np.stack([start - aside, end - aside, end + aside, start + aside], axis=1)
        colour = np.asarray(colour)
        if colour.ndim == 2:
            colour = np.repeat(colour, 2, axis=0)
        self.triangles(corners[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3, 2), colour)

    def dots(self, centres: ArrayLike, radius: float, colours: ArrayLike) -> None:
        """Add dots.

        Args:
            centres: (N, 2) [px].
            radius: [px].
            colours: (N, 3).
        """
        corners = np.asarray(centres)[:, None, :] + radius * _HEXAGON
        self.triangles(corners[:, _FAN].reshape(-1, 3, 2), np.repeat(colours, len(_FAN), axis=0))

    def arrays(self) -> tuple[Array, Array]:
        """All triangles: vertices (T, 3, 2) [px] and colours (T, 3, 3), float32, in painter's order."""
        if not self._vertices:
            return np.empty((0, 3, 2), np.float32), np.empty((0, 3, 3), np.float32)
        return np.concatenate(self._vertices), np.concatenate(self._colours)
