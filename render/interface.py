"""Cut the mesh where fluids meet.

Where the particles carry the fluid, a cell whose particles differ is cut at the mid-points of its edges:
the single particle keeps the corner triangle (a quarter of the area), the other two the quadrilateral.
With three fluids the cuts run from the mid-points to the centroid, a third of the area each. The line drawn
between two colours is thus the interface of the method itself, not a contour through it.
"""

from typing import NamedTuple

import numpy as np


class FluidRegions(NamedTuple):
    """Triangles (T, 3, 2) [m], the fluid of each (T,), and the interface segments (S, 2, 2) [m]."""

    triangles: np.ndarray
    fluid: np.ndarray
    segments: np.ndarray


def fluid_regions(position, cells, fluid, cell_fluid=None) -> FluidRegions:
    """Split the cells by fluid.

    position: (N, 2) [m]; cells: (M, 3); fluid: (N,); cell_fluid: (M,) or None.
    """
    if cell_fluid is not None:
        return FluidRegions(position[cells], cell_fluid, position[_edges_between(cells, cell_fluid)])
    a, b, c = fluid[cells].T
    pure = (a == b) & (b == c)
    three = (a != b) & (b != c) & (c != a)
    two = ~(pure | three)

    # Turn each two-fluid cell so that its single particle comes first; the orientation is kept.
    single = np.where(b == c, 0, np.where(a == c, 1, 2))[two]
    turned = np.take_along_axis(cells[two], (single[:, None] + np.arange(3)) % 3, axis=1)
    i, j, k = np.moveaxis(position[turned], 1, 0)
    ij, ik = (i + j) / 2, (i + k) / 2
    one, other = fluid[turned[:, 0]], fluid[turned[:, 1]]

    p, q, r = np.moveaxis(position[cells[three]], 1, 0)
    centre = (p + q + r) / 3
    pq, qr, rp = (p + q) / 2, (q + r) / 2, (r + p) / 2
    corners = [(p, pq, rp), (q, qr, pq), (r, rp, qr)]  # corner, next mid-point, previous mid-point

    triangles = [position[cells[pure]], _stack(i, ij, ik), _stack(ij, j, k), _stack(ij, k, ik)]
    owners = [a[pure], one, other, other]
    segments = [_stack(ij, ik)]
    for n, (corner, after, before) in enumerate(corners):
        triangles += [_stack(corner, after, centre), _stack(corner, centre, before)]
        owners += [fluid[cells[three][:, n]]] * 2
        segments += [_stack(after, centre)]
    return FluidRegions(np.concatenate(triangles), np.concatenate(owners), np.concatenate(segments))


def mesh_edges(cells) -> tuple[np.ndarray, np.ndarray]:
    """Every edge once, (E, 2), and whether it lies on the mesh's boundary, (E,) bool."""
    pairs, _, count = _unique_edges(cells)
    return pairs, count == 1


def _edges_between(cells, cell_fluid):
    """Edges (S, 2) whose two cells belong to different fluids."""
    pairs, inverse, _ = _unique_edges(cells)
    owner = np.tile(cell_fluid, 3)
    lowest = np.full(len(pairs), np.iinfo(np.int64).max)
    highest = np.full(len(pairs), -1)
    np.minimum.at(lowest, inverse, owner)
    np.maximum.at(highest, inverse, owner)
    return pairs[lowest != highest]


def _unique_edges(cells):
    halves = np.concatenate([cells[:, [0, 1]], cells[:, [1, 2]], cells[:, [2, 0]]])
    halves = np.sort(halves, axis=1)
    base = int(halves.max()) + 1 if len(halves) else 1
    keys, inverse, count = np.unique(halves @ [base, 1], return_inverse=True, return_counts=True)
    return np.stack([keys // base, keys % base], axis=1), inverse, count


def _stack(*points):
    return np.stack(points, axis=1)
