"""Domain: the polygon, with holes, that bounds the fluids of a case; its sides, and what lies inside."""

from __future__ import annotations

import copy
import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy.spatial import ConvexHull, cKDTree

from tipfem.arguments import rounded
from tipfem.errors import Invalid
from tipfem.geometry.lattice import bisected
from tipfem.geometry.period import Period, no_period
from tipfem.geometry.plane.shapes import Piece, Shape
from tipfem.geometry.plane.vectors import angles, cross, turned
from tipfem.typing import Array

# Edges of a whole circle, at least.
LEAST_EDGES = 16
# The least angle of a corner, inside the fluid [degrees]: the fluid in a sharper one could not be resolved.
LEAST_ANGLE = 30.0
# Half of the edges are at least as long [spacings], so that particles are about a spacing apart.
LEAST_EDGE = 0.2
# The least width of a gap between two walls [spacings].
LEAST_GAP = 3.0
# Two points of the boundary are across a gap if the way between them along the boundary is this many times as long.
ROUND_ABOUT = 4.0
# A face of a fill ends in a corner that is this close, and must not end closer beside one [spacings].
AT_CORNER, OFF_CORNER = 1e-9, 1e-4
# Fills reach 1e-9 of a tank's size beyond their faces, and farther along walls at an angle to these: 4 times as far
REACH = 4e-9  # at 15 degrees
# A particle is on the boundary if it is closer to it than this [spacings].
ON_BOUNDARY = 1e-6


class Domain:
    """A region bounded by straight edges, with the fluid on their left.

    Arcs of a shape are polylines here, with their corners on the arc.

    Args:
        loops: corners (K, 2) of the outline, anticlockwise, and of each hole, clockwise [m].
        names: of the side that the edge from each corner to the next belongs to, K for each loop.
        curves: number of the arc that each edge is a part of, K for each loop; -1 for straight sides.
        centres: (2,) of the arcs, by their numbers [m].
        convex: whether it is the convex hull of what fills it, as a box is; a mesh needs no given edges then.

    Attributes:
        start, end: (S, 2) of the edges [m], loop by loop.
        loop: (S,) number of the loop.
        sides: names of the sides.
        side: (S,) number of the side of each edge.
        curve: (S,) number of the arc of each edge, -1 for none.
        centre: (S, 2) of the arc of each edge, NaN for none [m].
        following: (S,) number of the edge that begins where this one ends.
    """

    def __init__(
        self,
        loops: Sequence[Array],
        names: Sequence[Sequence[str]],
        curves: Sequence[Sequence[int]],
        centres: Mapping[int, Array] | None = None,
        *,
        convex: bool = False,
    ) -> None:
        self.convex = convex
        self.start = np.concatenate(loops)
        self.end = np.concatenate([np.roll(corners, -1, axis=0) for corners in loops])
        count = [len(corners) for corners in loops]
        self.loop = np.repeat(np.arange(len(loops)), count)
        flat = [name for own in names for name in own]
        self.sides = list(dict.fromkeys(flat))
        self.side = np.array([self.sides.index(name) for name in flat])
        self.curve = np.array([number for own in curves for number in own])
        self.centre = np.full((len(self.start), 2), math.nan)
        for number, centre in (centres or {}).items():
            self.centre[self.curve == number] = centre
        first = np.cumsum([0, *count])
        self.following = np.concatenate([f + np.roll(np.arange(n), -1) for f, n in zip(first[:-1], count, strict=True)])

    def __len__(self) -> int:
        return len(self.start)

    @property
    def record(self) -> dict[str, Any]:
        """All of it as plain values and arrays, see `of`."""
        names = ("convex", "start", "end", "loop", "sides", "side", "curve", "centre", "following")
        return {name: getattr(self, name) for name in names}

    @staticmethod
    def of(record: Mapping[str, Any] | None) -> Domain | None:
        """The domain of a `record`; None for None."""
        if record is None:
            return None
        domain = Domain.__new__(Domain)
        vars(domain).update(record)
        return domain

    @cached_property
    def length(self) -> Array:
        """(S,) of the edges [m]."""
        return np.asarray(np.linalg.norm(self.end - self.start, axis=1))

    @cached_property
    def direction(self) -> Array:
        """(S, 2) of the edges, of unit length."""
        return np.asarray((self.end - self.start) / self.length[:, None])

    @cached_property
    def normal(self) -> Array:
        """(S, 2) of the edges, into the fluid, of unit length."""
        return turned(self.direction)

    @cached_property
    def offset(self) -> Array:
        """(S,) n . x of the edges' lines with these normals [m]."""
        return np.asarray((self.normal * self.start).sum(axis=1))

    @cached_property
    def turn(self) -> Array:
        """(S,) angle by which the boundary turns at each edge's end [rad]: > 0 at convex corners."""
        return angles(self.direction, self.direction[self.following])

    @property
    def sense(self) -> Array:
        """(S,) 1 where an edge runs anticlockwise about what its loop encloses, -1 where clockwise, as holes' do."""
        return np.where(self.loop == 0, 1.0, -1.0)

    def tangents(self, x: Array, edge: Array) -> Array:
        """Unit vectors (K, 2) along the edges ``edge`` (K,), or their arcs, at points (K, 2); fluid on the left."""
        direction = self.direction[edge]
        off = x - self.centre[edge]
        around = turned(off)
        around *= np.where((around * direction).sum(axis=1) < 0, -1.0, 1.0)[:, None]
        around /= np.linalg.norm(around, axis=1)[:, None]
        return np.where(np.isfinite(around), around, direction)

    def bends(self, edge: Array) -> tuple[Array, Array]:
        """Tangents (K, 2) and curvatures (K, 2) [1/m] where edges ``edge`` (K,) begin, as chords of one curve."""
        before = np.argsort(self.following)[edge]
        one, two = self.direction[before], self.direction[edge]
        tangent = (one + two) / np.linalg.norm(one + two, axis=1)[:, None]
        return tangent, 2 * (two - one) / (self.length[before] + self.length[edge])[:, None]

    @property
    def area(self) -> float:
        """[m^2]."""
        return enclosed(self.start, self.end, no_period(2))

    def measure(self, period: Period) -> float:
        """Its area [m^2], or the volume around the axis of an axisymmetric flow [m^3]."""
        return enclosed(self.start, self.end, period)

    def contains(self, x: Array) -> Array:
        """Mask (K,) of the points (K, 2) [m] inside; on the boundary either."""
        inside = np.zeros(len(x), dtype=bool)
        px, py = np.ascontiguousarray(x[:, 0]), np.ascontiguousarray(x[:, 1])
        for (ax, ay), (bx, by) in zip(self.start.tolist(), self.end.tolist(), strict=True):
            if ay == by:
                continue
            level = (ay > py) != (by > py)
            if level.any():
                k = np.flatnonzero(level)
                inside[k] ^= px[k] < ax + (bx - ax) * (py[k] - ay) / (by - ay)
        return inside

    def distances(self, x: Array, edges: Array | None = None) -> tuple[Array, Array]:
        """Distances (K, E) of points x (K, 2) to edges, by default all [m], and the nearest places on them, 0 to 1."""
        a, b = (self.start, self.end) if edges is None else (self.start[edges], self.end[edges])
        ex, ey = (b - a).T
        px, py = x[:, :1] - a[:, 0], x[:, 1:] - a[:, 1]
        part = np.clip((px * ex + py * ey) / (ex**2 + ey**2), 0.0, 1.0)
        return np.hypot(px - part * ex, py - part * ey), part

    def depth(self, x: Array, reach: float) -> Array:
        """Distance (K,) of points (K, 2) [m] to the boundary where it is less than ``reach`` [m], and inf elsewhere."""
        result = np.full(len(x), math.inf)
        for points in np.array_split(np.arange(len(x)), max(1, len(x) // 20000)):
            for edge in range(len(self)):
                low = np.minimum(self.start[edge], self.end[edge]) - reach
                high = np.maximum(self.start[edge], self.end[edge]) + reach
                near = points[((x[points] >= low) & (x[points] <= high)).all(axis=1)]
                if len(near):
                    found = self.distances(x[near], np.array([edge]))[0][:, 0]
                    result[near] = np.minimum(result[near], np.where(found < reach, found, math.inf))
        return result

    def on_edges(self, x: Array, tolerance: float) -> Array:
        """Mask (K, S) of the edges that the points (K, 2) [m] are on, ends included, up to ``tolerance`` [m]."""
        parts = np.array_split(x, max(1, len(x) * len(self) // 2_000_000))
        return np.concatenate([self.distances(part)[0] < tolerance for part in parts])

    def boundary_edges(self, x: Array, tolerance: float) -> tuple[Array, Array]:
        """The edges (E, 2) of a mesh along the boundary, fluid on the left, and the domain's edges (E,) they are on.

        ``x`` (K, 2) are points within ``tolerance`` of the boundary [m], all of its corners among them.
        """
        on = self.on_edges(x, tolerance)
        pairs, edges = [], []
        for k in range(len(self)):
            row = np.flatnonzero(on[:, k])
            row = row[np.argsort((x[row] - self.start[k]) @ self.direction[k])]
            pairs.append(np.stack([row[:-1], row[1:]], axis=1))
            edges.append(np.full(len(row) - 1, k))
        return np.concatenate(pairs), np.concatenate(edges)

    def first_loops(self, count: int) -> Domain:
        """The domain with its first ``count`` loops only."""
        kept = self.loop < count
        names = ("start", "end", "loop", "side", "curve", "centre", "following")
        return self._changed(**{name: getattr(self, name)[kept] for name in names})

    def with_corners(self, start: Array) -> Domain:
        """The domain with its corners elsewhere, (S, 2) [m]."""
        return self._changed(start=start, end=start[self.following])

    @property
    def straight_and_convex(self) -> bool:
        """Whether the domain is one convex polygon, without holes and arcs."""
        return bool((self.loop == 0).all() and (self.curve < 0).all() and (self.turn > -1e-9).all())

    def moved(self, displacement: Array) -> Domain:
        """The domain with its edges displaced along their normals by (S,) [m], those on one line by as much."""
        if not displacement.any():
            return self
        before = np.argsort(self.following)
        normal = np.stack([self.normal[before], self.normal], axis=1)
        by = np.stack([displacement[before], displacement], axis=1)
        return self.with_corners(self.start + np.einsum("sij,sj->si", np.linalg.pinv(normal, rcond=1e-9), by))

    def _changed(self, **arrays: Array) -> Domain:
        result = copy.copy(self)
        for name in ("length", "direction", "normal", "offset", "turn"):
            result.__dict__.pop(name, None)
        vars(result).update(arrays)
        return result

    def edges_of(self, x: Array, wall: Array, spacing: float) -> Array:
        """Wall particles along the boundary two and two (E, 2), fluid on the left; x (N, 2) [m], wall (N,) a mask."""
        index = np.flatnonzero(wall)
        return np.asarray(index[self.boundary_edges(x[index], ON_BOUNDARY * spacing)[0]])

    def require_surrounds(self, x: Array, wall: Array, spacing: float) -> None:
        """`ValueError` unless wall particles are on the boundary, one at every corner, and all others inside."""
        h = spacing
        on = self.on_edges(x[wall], ON_BOUNDARY * h)
        if not on.any(axis=1).all():
            i = int(np.flatnonzero(wall)[np.argmin(on.any(axis=1))])
            text = f": wall particle {i} at {x[i].tolist()} is not on the boundary of the domain"
            raise Invalid("particles", text, "Case")
        corner = cKDTree(x[wall]).query(self.start)[0] < ON_BOUNDARY * h
        if not corner.all():
            k = int(np.argmin(corner))
            text = f": the corner of the domain at {self.start[k].tolist()} has no wall particle"
            raise Invalid("particles", text, "Case")
        inside = self.contains(x) & (self.depth(x, 1e-6 * h) == np.inf)
        if (~inside & ~wall).any():
            i = int(np.argmax(~inside & ~wall))
            text = f": particle {i} at {x[i].tolist()} is not inside the domain, or is on its boundary"
            raise Invalid("particles", text, "Case")

    def require_resolved(self, spacing: float, touch: Array | None = None) -> None:
        """Raise `ValueError` if a corner is too sharp, or a gap too narrow, but of ``touch`` (L, L), for a spacing."""
        if np.median(self.length) < LEAST_EDGE * spacing:
            k = int(np.argmin(self.length))
            text = f": most of its {len(self)} corners are closer to the next than {LEAST_EDGE:g} spacings, as at "
            text += f"{self.start[k].tolist()}; there would be more of them than particles. Leave corners out, join "
            raise Invalid("tank", f"{text}them by arcs, or choose a smaller spacing than {spacing:g} m")
        sharp = math.pi - self.turn < math.radians(LEAST_ANGLE) * (1 - 1e-9)
        if sharp.any():
            k = int(np.argmax(sharp))
            text = f": the corner at {self.end[k].tolist()} has an angle of {180 - math.degrees(self.turn[k]):.3g} "
            raise Invalid("tank", f"{text}degrees inside; it must be at least {LEAST_ANGLE:g}")
        points, along, loop = self._samples(0.5 * spacing)
        reach = LEAST_GAP * spacing * (1 - 1e-6)
        pairs = cKDTree(points).query_pairs(1.02 * reach, output_type="ndarray")
        # The points are 0.5 h apart, so a gap of width w has two of them at most sqrt(w^2 + h^2 / 16) apart.
        i, j = pairs.T
        apart = np.linalg.norm(points[i] - points[j], axis=1)
        circumference = np.bincount(self.loop, weights=self.length)[loop[i]]
        way = np.abs(along[i] - along[j])
        way = np.where(loop[i] == loop[j], np.minimum(way, circumference - way), np.inf)
        across = way > ROUND_ABOUT * apart
        if touch is not None:
            across &= ~touch[loop[i], loop[j]]
        i, j, apart = i[across], j[across], apart[across]
        across = self._sees(points[i], points[j], ON_BOUNDARY * spacing)
        i, j, width = i[across], j[across], apart[across]
        if not len(i):
            return
        k = int(np.argmin(width))
        if width[k] < reach:
            place = (0.5 * (points[i[k]] + points[j[k]])).tolist()
            text = f": the gap between two walls at [{place[0]:.6g}, {place[1]:.6g}] is {width[k]:.4g} m wide, "
            text += f"{width[k] / spacing:.3g} spacings; it must be {LEAST_GAP:g} or more: choose a smaller spacing "
            raise Invalid("tank", f"{text}than {spacing:g} m")

    def _sees(self, one: Array, other: Array, off: float) -> Array:
        """Mask (K,) of the pairs of points (K, 2) on the boundary that see each other, ``off`` [m] off the walls."""
        way = other - one
        length = np.maximum(np.linalg.norm(way, axis=1), 1e-300)
        free = self.contains(0.5 * (one + other))
        for a, b in zip(self.start, self.end, strict=True):
            edge = b - a
            # Distances of the edge's ends from the way's line, and of the way's ends from that of the edge.
            sides = [(way[:, 0] * (p[1] - one[:, 1]) - way[:, 1] * (p[0] - one[:, 0])) / length for p in (a, b)]
            ends = [(edge[0] * (p[:, 1] - a[1]) - edge[1] * (p[:, 0] - a[0])) / math.hypot(*edge) for p in (one, other)]
            crossed = (np.minimum(*sides) < -off) & (np.maximum(*sides) > off)
            crossed &= (np.minimum(*ends) < -off) & (np.maximum(*ends) > off)
            free &= ~crossed & ~((np.abs(ends[0]) < off) & (np.abs(ends[1]) < off))
        return np.asarray(free)

    def _samples(self, spacing: float) -> tuple[Array, Array, Array]:
        """Points (K, 2) along the boundary [m], about ``spacing`` [m] apart; place along their loop, its number."""
        points, along, loops = [], [], []
        behind = np.zeros(self.loop.max() + 1)
        for k in range(len(self)):
            count = max(1, math.ceil(self.length[k] / spacing - 1e-9))
            part = np.arange(count) / count
            points.append(self.start[k] + part[:, None] * (self.end[k] - self.start[k]))
            along.append(behind[self.loop[k]] + part * self.length[k])
            loops.append(np.full(count, self.loop[k]))
            behind[self.loop[k]] += self.length[k]
        return np.concatenate(points), np.concatenate(along), np.concatenate(loops)


def domain_of(shape: Shape, spacing: float, part: Callable[[Array], Array] | None = None) -> Domain:
    """The domain of a shape, with edges of about a spacing for its arcs.

    Where an arc passes from one filled part into another, by the function ``part`` of positions (K, 2) [m] to numbers
    (K,), a corner is put.
    """
    loops, names, curves = [], [], []
    centres: dict[int, Array] = {}
    for loop in shape.loops:
        corners: list[Array] = []
        own: list[str] = []
        numbers: list[int] = []
        for run in _runs(loop):
            if run[0].centre is None:
                points, number = run[0].start[None], -1
            else:
                points = _arc_points(
                    run,
                    spacing,
                    part,
                    reach_of(np.array([p.start for own in shape.loops for p in own])),
                    whole=len(run) == len(loop),
                )
                number = len(centres)
                centres[number] = run[0].centre
            corners.append(points)
            own += [run[0].name] * len(points)
            numbers += [number] * len(points)
        loops.append(np.concatenate(corners))
        names.append(own)
        curves.append(numbers)
    return Domain(loops, names, curves, centres)


def gap_between(one: Domain, other: Domain, *, outside: bool) -> tuple[float, Array, int]:
    """The gap between two outlines [m], its place (2,) [m], and the number of the other's edge.

    It is 0 where corners of the first are not on the side of the other where they belong: ``outside`` of it, or inside.
    """
    there, _ = other.distances(one.start)
    back, _ = one.distances(other.start)
    wrong = other.contains(one.start) == outside
    if wrong.any():
        worst = int(np.argmax(np.where(wrong, there.min(axis=1), -1.0)))
        return 0.0, one.start[worst], int(np.argmin(there[worst]))
    k, edge = (int(i) for i in np.unravel_index(np.argmin(there), there.shape))
    corner = int(np.argmin(back.min(axis=1)))
    if back.min() < there.min():
        return float(back.min()), other.start[corner], corner
    return float(there.min()), one.start[k], edge


def enclosing(position: Array, spacing: float, period: Period) -> Domain:
    """The convex hull of particles (N, 2) [m]; along periodic axes it ends at the period's ends."""
    outline = _hull(position, spacing)
    if period:
        lower, upper = position.min(axis=0), np.where(period.width > 0, period.width, position.max(axis=0))
        outline = np.array([lower, [upper[0], lower[1]], upper, [lower[0], upper[1]]])
    return Domain([outline], [[f"side{k}" for k in range(len(outline))]], [[-1] * len(outline)], convex=True)


def _hull(position: Array, spacing: float) -> Array:
    """The corners (K, 2) of the convex hull of points (N, 2), anticlockwise, without those on straight sides [m]."""
    corners = position[ConvexHull((position - position.mean(axis=0)) / spacing).vertices]
    while True:
        before, after = np.roll(corners, 1, axis=0), np.roll(corners, -1, axis=0)
        side, off = after - before, corners - before
        height = np.abs(cross(side, off)) / np.linalg.norm(side, axis=1)
        flat = int(np.argmin(height))
        if len(corners) <= 3 or height[flat] > ON_BOUNDARY * spacing:
            return np.asarray(corners)
        corners = np.delete(corners, flat, axis=0)


def around_bodies(position: Array, spacing: float, bodies: Sequence[Array]) -> Domain:
    """The convex hull of particles (N, 2), less bodies with the corners (K, 2), anticlockwise."""
    outline = _hull(position, spacing)
    loops = [outline, *(corners[::-1] for corners in bodies)]
    names = [[f"side{k}" for k in range(len(outline))], *([f"body{b}"] * len(c) for b, c in enumerate(bodies))]
    return Domain(loops, names, [[-1] * len(loop) for loop in loops])


def _runs(loop: Sequence[Piece]) -> list[list[Piece]]:
    """The pieces of a loop, those of one arc together; a straight side in several pieces is one."""
    runs: list[list[Piece]] = []
    for piece in loop:
        before = runs[-1][-1] if runs else None
        if before is not None and before.name == piece.name:
            if piece.centre is not None and before.centre is not None and np.array_equal(before.centre, piece.centre):
                runs[-1].append(piece)
                continue
            if piece.centre is None and before.centre is None and _collinear(before, piece):
                runs[-1] = [replace(before, end=piece.end)]
                continue
        runs.append([piece])
    return runs


def _collinear(one: Piece, other: Piece) -> bool:
    a, b = one.end - one.start, other.end - other.start
    return bool(abs(a[0] * b[1] - a[1] * b[0]) < 1e-9 * np.linalg.norm(a) * np.linalg.norm(b) and a @ b > 0)


def _arc_points(
    run: Sequence[Piece], spacing: float, part: Callable[[Array], Array] | None, reach: float, *, whole: bool
) -> Array:
    """Corners (K, 2) along an arc of several pieces, its end excluded [m]; ``whole``: it is a circle."""
    angle = sum(abs(piece.angle) for piece in run)
    least = math.ceil(LEAST_EDGES * angle / (2 * math.pi) - 1e-9)
    count = max(1, least, round(sum(piece.length for piece in run) / spacing))

    def at(where: Array) -> Array:
        """Points at parts of the run's angle."""
        turned = np.asarray(where) % 1.0 if whole else np.asarray(where)
        bounds = np.cumsum([0.0, *(abs(piece.angle) / angle for piece in run)])
        bounds[-1] = 1.0
        number = np.clip(np.searchsorted(bounds, turned, side="right") - 1, 0, len(run) - 1)
        points = np.empty((len(turned), 2))
        for k, piece in enumerate(run):
            here = number == k
            points[here] = piece.at(np.clip((turned[here] - bounds[k]) / (bounds[k + 1] - bounds[k]), 0.0, 1.0))
        return points

    where = np.arange(count + 1) / count
    if part is not None:
        label = part(at(where))
        if whole:
            label[-1] = label[0]
        crossings = [_crossing(where[k], where[k + 1], part, at) for k in np.flatnonzero(label[1:] != label[:-1])]
        if not whole:
            unit = sum(piece.length for piece in run) / spacing
            start, end = run[0].start, run[-1].end
            crossings = [
                x
                for x in crossings
                if not is_at_corner(x * unit, start, spacing, reach)
                and not is_at_corner((1 - x) * unit, end, spacing, reach)
            ]
        if crossings:  # the others are evenly between: the first repair would take one that is crowded
            where = _with_points_at(sorted(crossings), count, whole=whole)
    return at(where[:-1])


def _crossing(low: float, high: float, part: Callable[[Array], Array], at: Callable[[Array], Array]) -> float:
    """The place between two on an arc where it passes from one part into another."""
    return float(bisected(np.array([low]), np.array([high]), lambda place: part(at(place)))[0])


def _with_points_at(crossings: Sequence[float], count: int, *, whole: bool) -> Array:
    """Places (K + 1,) on an arc, evenly between its ends 0 and 1 and ``crossings``; only these if ``whole``."""
    first = crossings[0] if whole else 0.0
    anchors = [first, *crossings[1 if whole else 0 :], first + 1.0]
    pieces = []
    for start, end in itertools.pairwise(anchors):
        number = max(1, round(end * count) - round(start * count))
        pieces.append(start + (end - start) * np.arange(number) / number)
    places = np.concatenate(pieces)
    if whole:
        places = np.sort(places - np.floor(places + 0.5 / count))
    return np.append(places, places[0] + 1.0)


def enclosed(start: Array, end: Array, period: Period) -> float:
    """Area inside closed lines of edges from ``start`` to ``end`` (S, 2) [m^2], or its volume around the axis [m^3]."""
    if not period.axial:
        return 0.5 * float(cross(start, end).sum())
    squares = start[:, 0] ** 2 + start[:, 0] * end[:, 0] + end[:, 0] ** 2
    return math.pi / 3 * float((squares * (end[:, 1] - start[:, 1])).sum())


def reach_of(corners: Array) -> float:
    """Distance [m] by which faces of fills may be off in a tank or body with corners (K, 2) [m]."""
    return REACH * float(np.ptp(corners, axis=0).max())


def is_at_corner(distance: float, corner: Array, spacing: float, reach: float) -> bool:
    """Whether a fill's face that meets a wall at a ``distance`` [spacings] from its ``corner`` (2,) [m] ends in it.

    Raises:
        ValueError: it ends beside the corner, but within ``reach``, closer than triangles can resolve, see `reach_of`.
    """
    most = max(AT_CORNER, reach / spacing)
    if most < distance < OFF_CORNER:
        text = f": what is filled in ends {distance * spacing:.3g} m beside the corner of the tank at {rounded(corner)}"
        text += f" m; it must end in the corner, or {OFF_CORNER * spacing:.3g} m or more ({OFF_CORNER:g} spacings)"
        raise Invalid("tank", f"{text} off it: move the level, or the corner")
    return distance <= most
