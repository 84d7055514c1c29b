"""Even points on curved faces between the parts of a tank.

Points of a lattice that are moved onto a face lie on it unevenly. With surface tension that is felt: the shape of
least length with given points is a regular polygon, so a drop at rest would creep until its points are even.
"""

from __future__ import annotations

import itertools
import math

import numpy as np
from scipy.spatial import Delaunay, cKDTree

from tipfem.geometry.lattice import Part, bisected
from tipfem.geometry.plane.domain import Domain
from tipfem.geometry.plane.shape_points import triangles_inside
from tipfem.typing import Array

CORNER = math.radians(40)  # sharper turns of a face are corners, which stay
STRAIGHT = 1e-6  # greatest distance of the points of a straight face from its chord [spacings]
SWEEPS = 20  # each makes the differences of the distances on a circle at least ten times smaller
REACH = 0.5  # along the normal, within which a face is looked for [spacings]
OFF_FACE = 0.62  # of other points [spacings]; from 0.5 on the edges along the face are in every Delaunay mesh
SAMPLES = 8  # of an edge, from which distances to it are measured


def evened(
    position: Array, wall: Array, on_face: Array, spacing: float, part: Part, domain: Domain | None
) -> tuple[Array, Array]:
    """The mask (N,) of the points that stay, and points (K, 2) to be added [m], even along each curved piece of a face.

    Of the points of a tank ``wall`` (N,) masks those on walls, which stay, and ``on_face`` those on faces; ``part`` has
    the number of the part that positions lie in, ``domain`` is None for a box.
    """
    stays, added, edges = np.ones(len(position), dtype=bool), [np.zeros((0, 2))], [np.zeros((0, 2, 2))]
    if on_face.any():
        for chain in _pieces(position, wall, spacing, part, domain):
            points = _even(position[chain], chain[0] == chain[-1], spacing, part)
            if points is not None and on_face[chain[1:-1]].all():
                stays[chain[1:-1]] = False
                added.append(points[1:-1])
                if chain[0] == chain[-1]:
                    stays[chain[0]] = False
                    added.append(points[:1])
                edges.append(np.stack([points[:-1], points[1:]], axis=1))
    new, sides = np.concatenate(added), np.concatenate(edges)
    if len(new):
        along = np.linspace(0, 1, SAMPLES, endpoint=False)[:, None, None]
        tree = cKDTree((sides[:, 0] + along * (sides[:, 1] - sides[:, 0])).reshape(-1, 2))
        others = stays & ~wall & ~on_face
        stays[others] = tree.query(position[others])[0] > OFF_FACE * spacing
    return stays, new


def _pieces(position: Array, wall: Array, spacing: float, part: Part, domain: Domain | None) -> list[Array]:
    """The points of each piece of a face in turn; the first one again at the end of those that go around."""
    cells = Delaunay(position / spacing).simplices if domain is None else triangles_inside(position, domain)
    label = part(position[cells].mean(axis=1))
    pairs = np.sort(cells[:, [1, 2, 2, 0, 0, 1]].reshape(-1, 2), axis=1)
    order = np.lexsort(pairs.T)
    pairs, label = pairs[order], np.repeat(label, 3)[order]
    face = (pairs[1:] == pairs[:-1]).all(axis=1) & (label[1:] != label[:-1])
    one, other = pairs[1:][face].T
    beside: dict[int, list[int]] = {}
    for a, b in zip(one.tolist(), other.tolist(), strict=True):
        beside.setdefault(a, []).append(b)
        beside.setdefault(b, []).append(a)
    ends = {i for i, near in beside.items() if len(near) != 2 or wall[i] or _turn(position[[near[0], i, near[-1]]])}
    result, left = [], {(a, b) for a, near in beside.items() for b in near}
    for first in [*sorted(ends), *sorted(set(beside) - ends)]:
        for second in beside[first]:
            if (first, second) not in left:
                continue
            chain = [first, second]
            while chain[-1] not in ends and chain[-1] != first:
                near = beside[chain[-1]]
                chain.append(near[1] if near[0] == chain[-2] else near[0])
            left.difference_update(itertools.pairwise(chain), itertools.pairwise(chain[::-1]))
            result.append(np.array(chain))
    return result


def _turn(x: Array) -> bool:
    """Whether the way through three points (3, 2) has a corner."""
    (ax, ay), (bx, by) = np.diff(x, axis=0).tolist()
    return abs(math.atan2(ax * by - ay * bx, ax * bx + ay * by)) > CORNER


def _even(x: Array, around: bool, spacing: float, part: Part) -> Array | None:
    """Points (n + 1, 2) at equal distances on a face through points (K, 2), its ends too; None where straight."""
    chord = x[-1] - x[0]
    size = math.hypot(*chord)
    if len(x) < 3:
        return None
    if not around and np.abs((x - x[0]) @ [-chord[1], chord[0]]).max() < STRAIGHT * spacing * size:
        return None
    for _ in range(SWEEPS):
        length = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(x, axis=0), axis=1)))
        count = max(round(length[-1] / spacing), 3 if around else 1)
        wanted = np.linspace(0, length[-1], count + 1)
        x = np.stack([np.interp(wanted, length, each) for each in x.T], axis=1)
        if around:
            x[-1] = x[0]
        before, after = (x[:-2], x[2:])
        normal = np.stack([before[:, 1] - after[:, 1], after[:, 0] - before[:, 0]], axis=1)
        normal *= REACH * spacing / np.linalg.norm(normal, axis=1)[:, None]
        low, high = x[1:-1] - normal, x[1:-1] + normal
        if (part(low) == part(high)).any():
            return None
        x[1:-1] = bisected(low, high, part)
    return x
