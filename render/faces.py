"""Faces of tetrahedra that belong to one cell alone."""

import numpy as np

from .arrays import Array
from .runtime import Ints1, Ints2, Longs1, Signs1, ensure_runtime, ti

SIDES = np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]])  # corners of a positive cell's faces, from outside


@ti.kernel
def _count(cells: Ints2, start: Ints1):
    """Add to ``start`` (N + 1,), behind each particle, the faces that have it as their lowest corner."""
    for m in range(cells.shape[0]):
        for k in ti.static(range(4)):
            a, b, c = cells[m, (k + 1) % 4], cells[m, (k + 2) % 4], cells[m, (k + 3) % 4]
            ti.atomic_add(start[ti.min(a, b, c) + 1], 1)


@ti.kernel
def _list(cells: Ints2, place: Ints1, listed: Ints1, others: Longs1):
    """List the faces of each lowest corner, and their other two corners, from ``place`` (N + 1,), changed, on."""
    for m in range(cells.shape[0]):
        for k in ti.static(range(4)):
            a, b, c = cells[m, (k + 1) % 4], cells[m, (k + 2) % 4], cells[m, (k + 3) % 4]
            low, high = ti.min(a, b, c), ti.max(a, b, c)
            at = ti.atomic_add(place[low], 1)
            listed[at] = k * cells.shape[0] + m
            others[at] = ti.i64(a + b + c - low - high) << 32 | ti.i64(high)


@ti.kernel
def _mark(start: Ints1, listed: Ints1, others: Longs1, single: Signs1):
    """Write 0 to ``single`` (4 M,), 1 at first, of faces that have the same corners as another one."""
    for n in range(start.shape[0] - 1):
        for i in range(start[n], start[n + 1]):
            key, j = others[i], i + 1
            while j < start[n + 1]:
                if others[j] == key:
                    single[listed[i]] = single[listed[j]] = 0
                    break
                j += 1


def outer_faces(cells: Array, position: Array) -> Array:
    """Faces (F, 3) of single tetrahedra (M, 4) of particles (N, 3), their corners anticlockwise from outside."""
    if not len(cells):
        return np.zeros((0, 3), cells.dtype)
    ensure_runtime()
    corners, count = np.ascontiguousarray(cells, np.int32), 4 * len(cells)
    start, single = np.zeros(len(position) + 1, np.int32), np.ones(count, np.int8)
    listed, others = np.empty(count, np.int32), np.empty(count, np.int64)
    _count(corners, start)
    start = np.cumsum(start, dtype=np.int32)
    _list(corners, start.copy(), listed, others)
    _mark(start, listed, others, single)
    side, cell = np.divmod(np.flatnonzero(single), len(cells))
    faces = np.take_along_axis(cells[cell], SIDES[side], axis=1)
    turned = negative(position, cells[cell])
    return np.where(turned[:, None], faces[:, [0, 2, 1]], faces)


def negative(position: Array, cells: Array) -> Array:
    """Mask (M,) of the cells whose corners are in the order that makes volumes negative."""
    a, b, c, d = np.moveaxis(position[cells], 1, 0)
    return np.asarray(np.einsum("ij,ij->i", np.cross(b - a, c - a), d - a) < 0)
