"""Walls as thick lines that meet in corners."""

import numpy as np

from .arrays import Array
from .drawing import Drawing

_LONGEST = 2.5  # of a mitre, in halves of the wall's width; sharper corners are round


def draw_walls(drawing: Drawing, pixels: Array, pairs: Array, half: float, colour: Array) -> None:
    """Add walls along edges (W, 2) of points (N, 2) [px]: mitred where two meet, else round; ``half`` as wide."""
    drawing.lines(pixels[pairs], 2 * half, colour)
    triangles, rounds = joints(pixels, pairs, half)
    drawing.triangles(triangles, colour)
    drawing.dots(rounds, half, colour)


def joints(pixels: Array, pairs: Array, half: float) -> tuple[Array, Array]:
    """Fillings of the gaps between strokes of a width along edges (W, 2) of points (N, 2) [px].

    Triangles (T, 3, 2) of mitres, and centres (D, 2) of discs of the strokes' width [px].
    """
    if len(pairs) == 0:
        return np.empty((0, 3, 2)), np.empty((0, 2))
    start, end = np.concatenate([pairs, pairs[:, ::-1]]).T
    order = np.argsort(start, kind="stable")
    start, end = start[order], end[order]
    points, first, count = np.unique(start, return_index=True, return_counts=True)
    two = count == 2
    at = pixels[points[two]]
    u, v = (_unit(pixels[end[first[two] + k]] - at) for k in (0, 1))
    between = u + v  # along the bisector, twice the cosine of half the angle long
    length = np.linalg.norm(between, axis=1)
    sine = np.sqrt(np.maximum(1 - (length / 2) ** 2, 0.0))  # of half the angle
    bent, sharp = length > 1e-3, sine * _LONGEST < 1
    mitred = bent & ~sharp
    at, u, v, tip = at[mitred], u[mitred], v[mitred], (between / np.maximum(length, 1e-12)[:, None])[mitred]
    tip = at - half / sine[mitred][:, None] * tip
    triangles = [np.stack([at, at + half * _outward(w, other), tip], axis=1) for w, other in ((u, v), (v, u))]
    rounds = np.concatenate([points[~two], points[two][bent & sharp]])
    return np.concatenate(triangles), pixels[rounds]


def _unit(vectors: Array) -> Array:
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-12))


def _outward(along: Array, other: Array) -> Array:
    """Unit vectors (P, 2) across a direction, away from another one."""
    across = np.stack([-along[:, 1], along[:, 0]], axis=1)
    return np.where((across * other).sum(axis=1, keepdims=True) > 0, -across, across)
