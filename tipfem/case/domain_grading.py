"""Grading at the start of a tank of any shape: which points of its lattice and of its walls become particles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from tipfem.case.domain import Domain
from tipfem.case.fluid import Fluid
from tipfem.case.grading import ROUNDED, STRIDES, Grading, limit_gradation_at_points
from tipfem.typing import Array

# Between the corners of a straight wall, particles are this far apart or more [targets]; they keep half of it from the
# corner at its end, and so do those inside from walls.
ALONG_WALL = 0.85


@dataclass(frozen=True)
class Points:
    """The N points of a tank with a shape, as finely as the spacing, of which some become particles.

    Attributes:
        position: (N, 2) [m]; those on walls in the order of the domain's edges.
        line: (N, 2) numbers of the lattice's lines that each is on, from the nearer end; -1 off the lattice.
        wall: (N,) mask of those on walls.
        on_face: (N,) mask of those on faces between fluids.
        fluid: (N,) number of the fluid.
    """

    position: Array
    line: Array
    wall: Array
    on_face: Array
    fluid: Array


def thinned_in_domain(
    grading: Grading, points: Points, domain: Domain, fluids: Sequence[Fluid], spacing: float
) -> Array:
    """Select the points that become particles: every stride-th of the lattice along both axes, and fewer on walls.

    Corners of walls stay, and so do particles on faces between fluids; those on arcs are corners.

    Args:
        grading: the target spacings.
        points: to choose from.
        domain: of the tank.
        fluids: that the points' numbers index.
        spacing: of the lattice, the smallest target [m].

    Returns:
        (N,) mask.
    """
    x, wall = points.position, points.wall
    largest = grading.of_fluids([f.name for f in fluids], spacing)
    size = grading.sizing(x, points.fluid, points.on_face, largest, spacing)
    on_wall = np.flatnonzero(wall)
    corner = on_wall[cKDTree(x[on_wall]).query(domain.start)[1]]
    arc = (domain.curve >= 0) & (domain.curve[np.argsort(domain.following)] >= 0)
    size[corner[arc]] = np.minimum(size[corner[arc]], np.maximum(domain.length[arc], spacing))
    target = limit_gradation_at_points(x, size, grading.growth)
    stride = STRIDES[np.searchsorted(STRIDES, ROUNDED * target / spacing, side="right") - 1]
    kept = points.on_face | (points.line < 0).any(axis=1) | (points.line % stride[:, None] == 0).all(axis=1)
    near = np.flatnonzero(kept & ~wall & ~points.on_face & (stride > 1))
    reach = 0.5 * ALONG_WALL * target[near]
    kept[near[domain.depth(x[near], float(reach.max(initial=0.0))) < reach]] = False
    kept[on_wall] = points.on_face[on_wall]
    kept[corner] = True
    for edge in range(len(domain)):
        row = on_wall[(domain.distances(x[on_wall], np.array([edge]))[0][:, 0] < 1e-9 * spacing)]
        along = np.linalg.norm(x[row] - domain.start[edge], axis=1)
        row, along = row[np.argsort(along)], np.sort(along)
        stays = along[kept[row]]
        behind = 0.0
        for k, place in zip(row.tolist(), along.tolist(), strict=True):
            if kept[k]:
                behind = place
                continue
            ahead = float(stays[np.searchsorted(stays, place)])
            apart = ALONG_WALL * target[k]
            if place - behind >= apart and ahead - place >= 0.5 * apart:
                kept[k], behind = True, place
    return np.asarray(kept)
