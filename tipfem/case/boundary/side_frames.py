"""The normals of the sides that a wall particle lies on, and their pseudo-inverses."""

from __future__ import annotations

import numpy as np

from tipfem.scratch import picked
from tipfem.typing import Array


def inverses(normal: Array) -> Array:
    """Pseudo-inverses (W, d, d) of the normals (W, d, d) of sides, of which unused rows are zero."""
    if normal.shape[1] == 3:
        return _inverses_in_3d(normal)
    (a, b), (c, d) = normal.transpose(1, 2, 0)
    two, result = (c != 0) | (d != 0), np.zeros_like(normal)
    square, cross = np.maximum(a * a + b * b, 1e-300), np.where(two, a * d - b * c, 1.0)
    result[:, 0, 0], result[:, 1, 0] = np.where(two, d / cross, a / square), np.where(two, -c / cross, b / square)
    result[:, 0, 1], result[:, 1, 1] = np.where(two, -b / cross, 0.0), np.where(two, a / cross, 0.0)
    return result


def frames(normals: Array, on_side: Array) -> tuple[Array, Array, Array]:
    """Normals (W, d, d) and numbers (W, d) of the first d independent sides of wall particles, and inverses."""
    bits = np.packbits(on_side, axis=1)
    words = np.ascontiguousarray(np.pad(bits, ((0, 0), (0, -bits.shape[1] % 8)))).view(np.uint64)
    one = words[:, 0] if words.shape[1] == 1 else words
    _, first, which = np.unique(one, axis=0, return_index=True, return_inverse=True)
    find = _frames_in_3d if normals.shape[1] == 3 else _frames_in_2d
    normal, side = find(normals, on_side[first])
    normal, side, inverse = (picked(each, which.ravel()) for each in (normal, side, inverses(normal)))
    return normal, side, inverse


def _frames_in_2d(normals: Array, on_side: Array) -> tuple[Array, Array]:
    """Normals and numbers of `frames` for sets of sides, given as masks (K, S)."""
    rows = np.arange(len(on_side))
    first = np.argmax(on_side, axis=1)
    cross = normals[first, 0][:, None] * normals[:, 1] - normals[first, 1][:, None] * normals[:, 0]
    others = on_side & (np.abs(cross) > 1e-6)
    others[rows, first] = False
    second = np.argmax(others, axis=1)
    side = np.stack([first, np.where(others.any(axis=1), second, 0)], axis=1)
    normal = normals[side]
    normal[~on_side.any(axis=1), 0] = 0.0
    normal[~others.any(axis=1), 1] = 0.0
    return normal, side


def _inverses_in_3d(normal: Array) -> Array:
    """`inverses` in 3-D: vectors (W, 3, 3), as columns, of which each has the product 1 with one normal alone."""
    a, b, c = normal.transpose(1, 0, 2)
    two, three = b.any(axis=1), c.any(axis=1)
    across = np.cross(a, b)
    c = np.where(three[:, None], c, across)
    b = np.where(two[:, None], b, 0.0)
    square = np.maximum((a * a).sum(axis=1), 1e-300)
    volume = np.where(two, (across * c).sum(axis=1), 1.0)
    result = np.zeros_like(normal)
    for k, (one, other) in enumerate(((b, c), (c, a), (a, b))):
        result[:, :, k] = np.cross(one, other) / volume[:, None]
    result[~two] = 0.0
    result[~two, :, 0] = a[~two] / square[~two, None]
    result[~three, :, 2] = 0.0
    return result


def _frames_in_3d(normals: Array, on_side: Array) -> tuple[Array, Array]:
    normal, side = np.zeros((len(on_side), 3, 3)), np.zeros((len(on_side), 3), dtype=np.int64)
    for w, mask in enumerate(on_side):
        span: list[Array] = []
        for k in np.flatnonzero(mask):
            rest = normals[k] - sum(each * each.dot(normals[k]) for each in span)
            size = np.sqrt(rest.dot(rest))
            if size > 1e-6:
                normal[w, len(span)], side[w, len(span)] = normals[k], k
                span.append(rest / size)
            if len(span) == 3:
                break
    return normal, side
