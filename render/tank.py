"""The walls of a tank: its outline and holes, drawn as they are rather than guessed from the particles."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from .arrays import Array
from .interface import solid_triangles
from .polygons import fill_loops


class Solids(NamedTuple):
    """Solid parts within the convex hull of a tank's walls, see `solid_triangles`."""

    triangles: Array  # (T, 3) of the points, whose middles are outside the tank
    radius: Array  # (T,) of each [m]: it is filled where it is drawn no larger than the walls are thick; 0 for always
    feet: Array  # (S, 2) edges of the hull that are no wall
    reach: Array  # (S,) the same of these [m]


@dataclass(frozen=True)
class PlacedTank:
    """A tank at one time."""

    points: Array  # (P, 2) along its walls [m]
    edges: Array  # (P, 2) pairs of points along the walls
    inside: Array  # (T, 3, 2) triangles that fill the tank [m]
    solids: Solids  # what is solid between its walls
    loops: tuple[Array, ...]  # numbers of the points of the outline, and of each hole
    turned: float  # the angle by which the tank has turned since t = 0 [rad]
    reference: Array  # (2,) where its reference point is [m]
    start: Array  # (2,) where that was at t = 0 [m]

    @property
    def moved(self) -> bool:
        """Whether it is elsewhere than at t = 0."""
        return bool(self.turned or (self.reference != self.start).any())


class TankOutline:
    """The walls of a tank as they are known at t = 0, to be drawn wherever they are later.

    ``facts`` has ``loops``, each with its ``corners`` (K, 2) [m], the outline first and then the holes; and the
    ``reference`` point (2,) [m], about which the tank turns. ``spacing`` is that of points along the walls [m].
    """

    def __init__(self, facts: Mapping[str, Any], spacing: float) -> None:
        self.reference = np.asarray(facts["reference"], float)
        corners = [np.asarray(loop["corners"], float) for loop in facts["loops"]]
        loops = [_with_points(loop, spacing) for loop in corners]
        self._points = np.concatenate(loops)
        first = np.cumsum([0, *map(len, loops)])
        self._loops = tuple(np.arange(a, b) for a, b in pairwise(first))
        self._edges = np.concatenate([np.stack([own, np.roll(own, -1)], axis=1) for own in self._loops])
        self._inside = fill_loops(corners)
        a, b, c = np.moveaxis(self._inside, 1, 0)
        area = 0.5 * abs((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]).sum()
        found, radius, feet, reach = solid_triangles(self._points, self._edges, float(area))
        solid = ~_within(self._points[found].mean(axis=1), self._inside)
        self._solids = Solids(found[solid], radius[solid], feet, reach)

    def placed(self, x: float, y: float, angle: float) -> PlacedTank:
        """The tank where its reference point is at (x, y) [m], turned by an angle [rad]."""
        turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
        points, inside = ((there - self.reference) @ turn + (x, y) for there in (self._points, self._inside))
        place = np.array([x, y])
        return PlacedTank(points, self._edges, inside, self._solids, self._loops, angle, place, self.reference)

    def at_start(self) -> PlacedTank:
        """The tank at t = 0."""
        return self.placed(float(self.reference[0]), float(self.reference[1]), 0.0)


def _within(places: Array, triangles: Array) -> Array:
    """Mask (K,) of the places (K, 2) that are in one of the triangles (T, 3, 2)."""
    found = np.zeros(len(places), bool)
    for corners in triangles:
        side = np.roll(corners, -1, axis=0) - corners
        off = places[:, None] - corners
        turn = side[:, 0] * off[..., 1] - side[:, 1] * off[..., 0]
        found |= (turn >= 0).all(axis=1) | (turn <= 0).all(axis=1)
    return found


def _with_points(corners: Array, spacing: float) -> Array:
    """A loop with points between its corners, at most a spacing apart (P, 2)."""
    parts: Sequence[Array] = [
        a + (b - a) * np.arange(count)[:, None] / count
        for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)
        for count in [max(1, int(np.ceil(np.linalg.norm(b - a) / spacing - 1e-9)))]
    ]
    return np.concatenate(parts)
