"""The normals of the sides that a wall particle lies on, and their pseudo-inverses."""

from __future__ import annotations

import numpy as np

from tipfem.typing import Array


def inverses(normal: Array) -> Array:
    """Pseudo-inverses (W, d, d) of the normals (W, d, d) of sides, of which unused rows are zero."""
    if normal.shape[1] == 3:
        return np.asarray(np.linalg.pinv(normal, rcond=1e-9))
    (a, b), (c, d) = normal.transpose(1, 2, 0)
    two, result = (c != 0) | (d != 0), np.zeros_like(normal)
    square, cross = np.maximum(a * a + b * b, 1e-300), np.where(two, a * d - b * c, 1.0)
    result[:, 0, 0], result[:, 1, 0] = np.where(two, d / cross, a / square), np.where(two, -c / cross, b / square)
    result[:, 0, 1], result[:, 1, 1] = np.where(two, -b / cross, 0.0), np.where(two, a / cross, 0.0)
    return result


def frames(normals: Array, on_side: Array) -> tuple[Array, Array]:
    """Normals (W, d, d) and numbers (W, d) of the first d sides of each wall particle that are independent."""
    if normals.shape[1] == 3:
        return _frames_in_3d(normals, on_side)
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


def _frames_in_3d(normals: Array, on_side: Array) -> tuple[Array, Array]:
    sets, which = np.unique(on_side, axis=0, return_inverse=True)
    normal, side = np.zeros((len(sets), 3, 3)), np.zeros((len(sets), 3), dtype=np.int64)
    for w, mask in enumerate(sets):
        rank = 0
        for k in np.flatnonzero(mask):
            normal[w, rank], side[w, rank] = normals[k], k
            if np.linalg.matrix_rank(normal[w], tol=1e-6) > rank:
                rank += 1
            else:
                normal[w, rank] = 0.0
            if rank == 3:
                break
    return normal[which.ravel()], side[which.ravel()]
