"""Drawings for all back ends: coloured triangles in painter's order, in pixels.

Pixels are those of the finished picture: x to the right, y down, (0, 0) the corner of the top left pixel.
Lines and dots are triangles too, so that they are the same in all back ends.
"""

import numpy as np
from numpy.typing import ArrayLike

from .arrays import Array
from .shapes import TRIANGLES_A_LINE, dot_triangles, line_triangles, triangles_in_dot


class Drawing:
    """Triangles added in painter's order: later ones cover earlier ones."""

    def __init__(self) -> None:
        self._vertices: list[Array] = []
        self._colours: list[Array] = []

    def triangles(self, vertices: ArrayLike, colours: ArrayLike) -> None:
        """Add triangles (T, 3, 2) [px] of colours (3,) for all, (T, 3) for each, or (T, 3, 3) for each vertex."""
        self._vertices.append(np.asarray(vertices, np.float32))
        colours = np.asarray(colours, np.float32)
        self._colours.append(np.broadcast_to(colours, (len(self._vertices[-1]), 3)) if colours.ndim == 1 else colours)

    def lines(self, segments: ArrayLike, width: float, colour: ArrayLike, cap: float = 0.0) -> None:
        """Add line segments (S, 2, 2) of a width and caps at both ends [px], of a colour (3,) or (S, 3)."""
        colour = np.asarray(colour, np.float32)
        if colour.ndim == 2:
            colour = np.repeat(colour, TRIANGLES_A_LINE, axis=0)
        self.triangles(line_triangles(segments, width, cap), colour)

    def dots(self, centres: ArrayLike, radius: float, colours: ArrayLike) -> None:
        """Add dots (N, 2) of a radius [px], of colours (3,) for all, or (N, 3)."""
        colours = np.asarray(colours, np.float32)
        if colours.ndim == 2:
            colours = np.repeat(colours, triangles_in_dot(radius), axis=0)
        self.triangles(dot_triangles(centres, radius), colours)

    def arrays(self) -> tuple[Array, Array]:
        """All triangles: vertices (T, 3, 2) [px] and colours (T, 3, 3), float32, in painter's order."""
        if not self._vertices:
            return np.empty((0, 3, 2), np.float32), np.empty((0, 3, 3), np.float32)
        colours = [
            np.broadcast_to(given[:, None, :] if given.ndim == 2 else given, (len(vertices), 3, 3))
            for vertices, given in zip(self._vertices, self._colours, strict=True)
        ]
        return np.concatenate(self._vertices), np.concatenate(colours)

    def compact(self) -> tuple[Array, Array, Array, Array]:
        """All triangles in painter's order, with the colours of vertices only where they differ.

        vertices (T, 3, 2) [px]; flat (T, 3) colours of the triangles of one colour; slot (T,) int32, the row of a
        triangle's colours in graded, or -1 for one colour; graded (G, 3, 3) colours of vertices, of one unused row at
        least.
        """
        count = sum(map(len, self._vertices))
        vertices, flat = np.empty((count, 3, 2), np.float32), np.empty((count, 3), np.float32)
        slot, graded, at, row = np.empty(count, np.int32), [np.zeros((1, 3, 3), np.float32)], 0, 1
        for corners, colours in zip(self._vertices, self._colours, strict=True):
            part = slice(at, at + len(corners))
            vertices[part] = corners
            if colours.ndim == 3:
                slot[part] = np.arange(row, row + len(corners))
                graded.append(colours)
                row += len(corners)
            else:
                flat[part], slot[part] = colours, -1
            at += len(corners)
        return vertices, flat, slot, np.concatenate(graded)
