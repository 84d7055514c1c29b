"""Places where solids may touch in a step: corners of one over edges of another, in two dimensions.

A pose of S solids is (S, 3): reference point and angle, those of the tank first, zero for a tank at rest.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tipfem.geometry.plane.domain import Domain
from tipfem.geometry.plane.touching import corners_over
from tipfem.geometry.plane.vectors import turned
from tipfem.typing import Array

REACH = 1.0  # gap up to which they may touch in a step [spacings]
BEHIND = 0.25  # gap below 0 from which on a corner is in front of another edge [spacings]


def _at(pose: Array, solid: Array, r: Array) -> Array:
    """Vectors (K, 2) of the solids (K,) turned as these are."""
    c, s = np.cos(pose[solid, 2])[:, None], np.sin(pose[solid, 2])[:, None]
    return np.asarray(c * r + s * turned(r))


@dataclass(frozen=True)
class Candidates:
    """Corners over edges, C pairs; vectors relative to the solids' reference points, without their rotations."""

    # one, other: (C,) the solids with the corner and with the edge
    one: Array
    other: Array
    corner: Array  # (C, 2) of one [m]
    edge: Array  # (C, 2) where the edge of the other one begins [m]
    normal: Array  # (C, 2) of the edge, towards the corner
    key: Array  # (C, 4) both solids, and the numbers of corner and edge

    def __len__(self) -> int:
        return len(self.one)

    def gaps(self, pose: Array) -> Array:
        """(C,) from the edges' lines to the corners, with the solids at ``pose`` [m]."""
        x = pose[self.one, :2] + _at(pose, self.one, self.corner)
        start = pose[self.other, :2] + _at(pose, self.other, self.edge)
        return np.asarray(((x - start) * _at(pose, self.other, self.normal)).sum(axis=1))

    def rows(self, pose: Array) -> tuple[Array, Array]:
        """Derivatives (C, 3 S) of gaps, and of slips along the edges, by the pose."""
        if not len(self):
            return np.zeros((0, pose.size)), np.zeros((0, pose.size))
        x, n = _at(pose, self.one, self.corner), _at(pose, self.other, self.normal)
        arms = x, x + pose[self.one, :2] - pose[self.other, :2]
        across = np.arange(len(self))
        rows = []
        for along in (n, turned(n)):
            row = np.zeros((len(self), len(pose), 3))
            for solid, arm, sign in zip((self.one, self.other), arms, (1.0, -1.0), strict=True):
                row[across, solid, :2] += sign * along
                row[across, solid, 2] += sign * (along * turned(arm)).sum(axis=1)
            rows.append(row.reshape(len(self), 3 * len(pose)))
        return rows[0], rows[1]


def candidates(outlines: Sequence[Domain], pose: Array, may: Array, spacing: float) -> Candidates:
    """The places where the S solids, the tank first, at poses (S, 3), may touch in a step, of pairs ``may`` (S, S)."""
    parts: list[tuple[Array, ...]] = []
    low, high = (np.array([of(outline.start, axis=0) for outline in outlines]) for of in (np.min, np.max))
    near = (low[:, None] < high + REACH * spacing).all(axis=2)
    for one, other in zip(*np.nonzero(may & near & near.T), strict=True):
        over = corners_over(outlines[one], outlines[other], REACH * spacing, tanks=(one == 0, other == 0))
        front = over.gap > -BEHIND * spacing
        corner, edge, count = over.corner[front], over.edge[front], int(front.sum())
        if count:
            solids = np.full(count, one), np.full(count, other)
            parts.append(
                (
                    *solids,
                    _at(-pose, solids[0], outlines[one].start[corner] - pose[one, :2]),
                    _at(-pose, solids[1], outlines[other].start[edge] - pose[other, :2]),
                    _at(-pose, solids[1], over.normal[front]),
                    np.stack([*solids, corner, edge], axis=1),
                )
            )
    if not parts:
        none, plane = np.zeros(0, dtype=int), np.zeros((0, 2))
        return Candidates(none, none, plane, plane, plane, np.zeros((0, 4), dtype=int))
    return Candidates(*(np.concatenate(column) for column in zip(*parts, strict=True)))
