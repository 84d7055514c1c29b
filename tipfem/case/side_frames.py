"""The normals of the sides that a wall particle lies on, and their pseudo-inverses."""

from __future__ import annotations

import numpy as np

from tipfem.typing import Array


def inverses(normal: Array, side: Array) -> Array:
    """Pseudo-inverses (W, d, d) of the normals (W, d, d) of the sides (W, d), in 2-D once for the same normals."""
    if normal.shape[1] == 3:
        return np.asarray(np.linalg.pinv(normal, rcond=1e-9))
    key = (side[:, 0] * (side.max(initial=0) + 1) + side[:, 1]) * 4
    key += 2 * normal[:, 0].any(axis=1) + normal[:, 1].any(axis=1)
    _, first, number = np.unique(key, return_index=True, return_inverse=True)
    return np.asarray(np.linalg.pinv(normal[first], rcond=1e-9)[number])


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
    normal, side = np.zeros((len(on_side), 3, 3)), np.zeros((len(on_side), 3), dtype=np.int64)
    for w, mask in enumerate(on_side):
        rank = 0
        for k in np.flatnonzero(mask):
            normal[w, rank], side[w, rank] = normals[k], k
            if np.linalg.matrix_rank(normal[w], tol=1e-6) > rank:
                rank += 1
            else:
                normal[w, rank] = 0.0
            if rank == 3:
                break
    return normal, side
