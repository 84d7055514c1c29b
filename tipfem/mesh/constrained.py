"""Constrained Delaunay triangulation: the edges that bound a domain are recovered, and cells beyond them dropped."""

from __future__ import annotations

from collections import deque

import numpy as np

from tipfem.errors import TriangulationError
from tipfem.typing import Array


def cells_inside(position: Array, cells: Array, neighbours: Array, boundary: Array, flat: Array) -> Array:
    """Numbers (K,) of the cells of a Delaunay triangulation that are inside a boundary (E, 2), on its left.

    Edges of the boundary that are missing are recovered by flips (Sloan, "A fast algorithm for generating constrained
    Delaunay triangulations", 1993), which change ``cells`` and ``neighbours`` (M, 3) in place. Cells of the mask
    ``flat``, without area except by round-off, are none of those inside. `TriangulationError` if an edge cannot be
    recovered, because a particle is on it or another edge crosses it.
    """
    n = len(position)
    one, other = boundary.T.astype(np.int64)
    key = one * n + other
    beside = _cells_left_of(cells, n, key, flat)
    if (beside < 0).any() and flat.any():
        _flip_flat(position, cells, neighbours, flat)
        beside = _cells_left_of(cells, n, key, flat)
    missing = np.flatnonzero(beside < 0)
    if len(missing):
        held = {*zip(one.tolist(), other.tolist(), strict=True), *zip(other.tolist(), one.tolist(), strict=True)}
        for k in missing:
            _recover(position, cells, neighbours, int(one[k]), int(other[k]), held)
        beside = _cells_left_of(cells, n, key, flat)
        if (beside < 0).any():
            a, b = boundary[np.argmax(beside < 0)]
            raise _lost(position, int(a), int(b))
    start, end = _edge_keys(cells, n)  # opposite each corner; of the boundary in one direction or the other
    bounds = (np.isin(start * n + end, key) | np.isin(end * n + start, key)).reshape(cells.shape)
    bounds |= (neighbours >= 0) & flat[neighbours]
    inside = np.zeros(len(cells), dtype=bool)
    front = np.unique(beside)
    while len(front):
        inside[front] = True
        following = neighbours[front]
        following = np.unique(following[(following >= 0) & ~bounds[front]])
        front = following[~inside[following]]
    return np.flatnonzero(inside)


def without_crossings(position: Array, cells: Array, neighbours: Array, part: Array) -> Array:
    """Triangles (M, 3) with flips of edges across a face between parts (N,), -1 on it, from which one new end is."""
    cells, neighbours = cells.copy(), neighbours.copy()
    crossing = deque(_crossing(cells, part))
    trials = 4 * len(crossing) + 16
    while crossing and trials:
        trials -= 1
        c, d = crossing.popleft()
        t, i = _find(cells, c, d)
        o = int(neighbours[t, i])
        if o < 0:
            continue
        j, p, q, c, d, convex = _around(position, cells, neighbours, t, i, o)
        if convex and min(part[p], part[q]) < 0:
            _flip(cells, neighbours, t, i, o, j)
        else:
            crossing.append((c, d))
    return cells


def _crossing(cells: Array, part: Array) -> list[tuple[int, int]]:
    """The edges between two parts; see `without_crossings`."""
    pairs = np.unique(np.sort(cells[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)
    one, other = part[pairs].T
    return [(c, d) for c, d in pairs[(one != other) & (one >= 0) & (other >= 0)].tolist()]


def _edge_keys(cells: Array, n: int) -> tuple[Array, Array]:
    """Start and end (3 M,) of the edges opposite each corner, as the cell passes them."""
    return cells[:, [1, 2, 0]].ravel().astype(np.int64), cells[:, [2, 0, 1]].ravel().astype(np.int64)


def _cells_left_of(cells: Array, n: int, key: Array, flat: Array) -> Array:
    """(E,) the cell on the left of each edge ``key`` (E,), start * n + end; -1 for none, or one that is flat (M,)."""
    start, end = _edge_keys(cells, n)
    has = np.where(np.repeat(flat, 3), -1, start * n + end)
    order = np.argsort(has)
    found = order[np.minimum(np.searchsorted(has, key, sorter=order), len(order) - 1)]
    return np.where(has[found] == key, found // 3, -1)


def _flip_flat(position: Array, cells: Array, neighbours: Array, flat: Array) -> None:
    """Flip the longest edge of flat cells, where that gives two cells with an area; updates ``flat`` (M,), too."""
    for t in np.flatnonzero(flat).tolist():
        corner = position[cells[t]]
        i = int(np.argmax(((np.roll(corner, -1, axis=0) - np.roll(corner, 1, axis=0)) ** 2).sum(axis=1)))
        o = int(neighbours[t, i])
        if o < 0 or flat[o]:
            continue
        j = int(np.flatnonzero(neighbours[o] == t)[0])
        p, q = int(cells[t, i]), int(cells[o, j])
        c, d = int(cells[o, (j + 2) % 3]), int(cells[o, (j + 1) % 3])
        if _cross(position, p, c, q) > 0 and _cross(position, p, q, d) > 0:
            if (int(cells[t, (i + 1) % 3]), int(cells[t, (i + 2) % 3])) != (c, d):
                continue  # oriented the other way, so it is on the other side of its long edge
            _flip(cells, neighbours, t, i, o, j)
            flat[[t, o]] = False


def _lost(position: Array, a: int, b: int) -> TriangulationError:
    return TriangulationError(
        f"the edge of the wall between the particles {a} and {b}, from {position[a].tolist()} to "
        f"{position[b].tolist()}, cannot be an edge of the mesh: a particle is on it, or another wall crosses it"
    )


def _cross(position: Array, a: int, b: int, c: int) -> float:
    """Twice the area of the triangle a, b, c; > 0 if it is positively oriented."""
    p, q, r = position[a], position[b], position[c]
    return float((q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0]))


def _recover(position: Array, cells: Array, neighbours: Array, a: int, b: int, held: set[tuple[int, int]]) -> None:
    """Flip edges until a-b is one; see `cells_inside`."""
    crossing = deque(_crossed(position, cells, neighbours, a, b))
    created: list[tuple[int, int]] = []
    trials = 50 * (len(crossing) + 1) ** 2
    while crossing:
        trials -= 1
        c, d = crossing.popleft()
        if trials < 0 or (c, d) in held:
            raise _lost(position, a, b)
        t, i = _find(cells, c, d)
        o = int(neighbours[t, i])
        j, p, q, c, d, convex = _around(position, cells, neighbours, t, i, o)
        if not convex:
            crossing.append((c, d))
            continue
        _flip(cells, neighbours, t, i, o, j)
        if {p, q} != {a, b} and p not in (a, b) and q not in (a, b):
            if _cross(position, a, b, p) * _cross(position, a, b, q) < 0:
                crossing.append((p, q))
                continue
        created.append((p, q))
    # The new edges besides a-b are made Delaunay again.
    for _ in range(len(created)):
        swapped = False
        for k, (c, d) in enumerate(created):
            if {c, d} == {a, b} or (c, d) in held:
                continue
            t, i = _find(cells, c, d)
            o = int(neighbours[t, i])
            if o < 0:
                continue
            j, p, q, c, d, convex = _around(position, cells, neighbours, t, i, o)
            if convex and _in_circle(position, p, c, d, q):
                _flip(cells, neighbours, t, i, o, j)
                created[k] = (p, q)
                swapped = True
        if not swapped:
            break


def _around(
    position: Array, cells: Array, neighbours: Array, t: int, i: int, o: int
) -> tuple[int, int, int, int, int, bool]:
    """Corner j of cell o off its edge with t, particles p and q off and c and d on it, and if p, c, q, d is convex."""
    j = int(np.flatnonzero(neighbours[o] == t)[0])
    p, q = int(cells[t, i]), int(cells[o, j])
    c, d = int(cells[t, (i + 1) % 3]), int(cells[t, (i + 2) % 3])
    return j, p, q, c, d, _cross(position, p, c, q) > 0 and _cross(position, p, q, d) > 0


def _in_circle(position: Array, a: int, b: int, c: int, d: int) -> bool:
    """Whether d is inside the circle through a, b and c, which are positively oriented."""
    rows = position[[a, b, c]] - position[d]
    square = (rows**2).sum(axis=1)
    return float(np.linalg.det(np.column_stack([rows, square]))) > 1e-12 * float(square.max()) ** 2


def _find(cells: Array, c: int, d: int) -> tuple[int, int]:
    """A cell with the edge c-d, and the corner opposite to it."""
    rows = np.flatnonzero((cells == c).any(axis=1) & (cells == d).any(axis=1))
    t = int(rows[0])
    return t, int(np.flatnonzero((cells[t] != c) & (cells[t] != d))[0])


def _crossed(position: Array, cells: Array, neighbours: Array, a: int, b: int) -> list[tuple[int, int]]:
    """The edges that a-b crosses, from a to b; raises TriangulationError where a particle is on it."""
    t = i = -1
    for cell in np.flatnonzero((cells == a).any(axis=1)):
        k = int(np.flatnonzero(cells[cell] == a)[0])
        c, d = int(cells[cell, (k + 1) % 3]), int(cells[cell, (k + 2) % 3])
        if _cross(position, a, b, c) < 0 < _cross(position, a, b, d) and _cross(position, c, d, b) < 0:
            t, i = int(cell), k
            break
    if t < 0:
        raise _lost(position, a, b)
    edges = []
    while True:
        c, d = int(cells[t, (i + 1) % 3]), int(cells[t, (i + 2) % 3])
        edges.append((c, d))
        o = int(neighbours[t, i])
        if o < 0:
            raise _lost(position, a, b)
        j = int(np.flatnonzero(neighbours[o] == t)[0])
        q = int(cells[o, j])
        if q == b:
            return edges
        where = _cross(position, a, b, q)
        if where == 0.0:
            raise _lost(position, a, b)
        # Across the edge from q to the end of the last one on the other side of a-b.
        t, i = o, int(np.flatnonzero(cells[o] == (c if where < 0 else d))[0])


def _flip(cells: Array, neighbours: Array, t: int, i: int, o: int, j: int) -> None:
    """Replace the edge opposite corner i of cell t and corner j of cell o by that between these two corners."""
    p, c, d, q = cells[t, i], cells[t, (i + 1) % 3], cells[t, (i + 2) % 3], cells[o, j]
    over_dp, over_pc = neighbours[t, (i + 1) % 3], neighbours[t, (i + 2) % 3]
    over_cq, over_qd = neighbours[o, (j + 1) % 3], neighbours[o, (j + 2) % 3]
    cells[t], neighbours[t] = (p, c, q), (over_cq, o, over_pc)
    cells[o], neighbours[o] = (p, q, d), (over_qd, over_dp, t)
    for cell, old, new in ((over_cq, o, t), (over_dp, t, o)):
        if cell >= 0:
            neighbours[cell, np.flatnonzero(neighbours[cell] == old)[0]] = new
