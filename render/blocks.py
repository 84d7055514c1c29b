"""Blocks in tanks in three dimensions: boxes at t = 0, and where they are when the tank has moved."""

from collections.abc import Mapping
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from tipfem.results.fields.walls import moved

from .arrays import Array

RING = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
CORNERS = np.concatenate([RING, RING + [0, 0, 1]])  # of a box, along its axes
_LOOP = [0, 1, 2, 3, 0]
EDGES = [*pairwise(_LOOP), *((a + 4, b + 4) for a, b in pairwise(_LOOP)), *((k, k + 4) for k in range(4))]


class Blocks(NamedTuple):
    """A box with boxes in it as they stand at t = 0."""

    size: Array  # (3,) of the tank, from the origin [m]
    boxes: Array  # (B, 2, 3) lower and upper corners [m]
    reference: Array  # (3,) the point that the pose of the tank places [m]

    @classmethod
    def of(cls, facts: Mapping[str, Any] | None) -> "Blocks | None":
        """Blocks of a case, see `tipfem.case.outline.tank_blocks`."""
        if facts is None:
            return None
        boxes = np.array(list(facts["boxes"].values()), float)
        return cls(np.array(facts["size"], float), boxes, np.array(facts["reference"], float))

    def placed(self, pose: Array) -> Array:
        """Corners (B, 8, 3) of the boxes in the order of `CORNERS` in a tank with a pose (6,), see `POSES` [m]."""
        low, high = np.maximum(self.boxes[:, 0], 0.0), np.minimum(self.boxes[:, 1], self.size)
        return moved(np.where(CORNERS == 1, high[:, None], low[:, None]), self.reference, pose)

    def walls(self, pose: Array) -> Array:
        """Corners (8, 3) of the tank, as those of the boxes."""
        return moved(CORNERS * self.size, self.reference, pose)


def section(corners: Array, axis: int, value: float) -> list[Array]:
    """Convex polygons (K, 3) in which a plane across an axis cuts boxes with corners (B, 8, 3) [m]."""
    found = []
    for box in corners:
        a, b = (box[[edge[k] for edge in EDGES]] for k in (0, 1))
        off, beyond = a[:, axis] - value, b[:, axis] - value
        cut = (off < 0) != (beyond < 0)
        if cut.any():
            share = (off[cut] / (off[cut] - beyond[cut]))[:, None]
            points = a[cut] + share * (b[cut] - a[cut])
            try:
                found.append(points[ConvexHull(np.delete(points, axis, axis=1)).vertices])
            except QhullError:  # no more than an edge of it
                continue
    return found
