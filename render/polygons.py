"""Areas within closed loops, as triangles."""

from collections.abc import Sequence

import numpy as np

from .arrays import Array


def fill_loops(loops: Sequence[Array]) -> Array:
    """Triangles (T, 3, 2) of the area within closed loops (K, 2), by the even-odd rule.

    Lines through all corners cut it into trapezoids. Loops that cross each other or themselves are cut wrongly between
    the two corners about a crossing only.
    """
    loops = [loop for loop in loops if len(loop) >= 3]
    if not loops:
        return np.empty((0, 3, 2))
    start, end = np.concatenate(loops), np.concatenate([np.roll(loop, -1, axis=0) for loop in loops])
    level = start[:, 1] != end[:, 1]
    start, end = start[level], end[level]
    swap = (start[:, 1] > end[:, 1])[:, None]
    low, high = np.where(swap, end, start), np.where(swap, start, end)
    levels = np.unique(np.concatenate([low[:, 1], high[:, 1]]))
    first, last = np.searchsorted(levels, low[:, 1]), np.searchsorted(levels, high[:, 1])
    count = last - first
    edge = np.repeat(np.arange(len(low)), count)
    band = np.arange(len(edge)) - np.repeat(np.cumsum(count) - count, count) + first[edge]
    slope = (high - low)[:, 0] / (high - low)[:, 1]
    bottom, top = (low[edge, 0] + slope[edge] * (levels[band + k] - low[edge, 1]) for k in (0, 1))
    order = np.lexsort((bottom + top, band))  # every band has an even number of edges
    left, right = order[::2], order[1::2]
    y0, y1 = levels[band[left]], levels[band[left] + 1]
    a, b = np.stack([bottom[left], y0], axis=1), np.stack([bottom[right], y0], axis=1)
    c, d = np.stack([top[right], y1], axis=1), np.stack([top[left], y1], axis=1)
    triangles = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    u, v = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    return np.asarray(triangles[u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0] != 0])
