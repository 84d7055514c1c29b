"""Curves: the smooth parts of a domain's boundary along which fluids slip, and the arcs of walls that turn.

Along a straight wall a particle slides on the wall's line. Along a curve the boundary of the fluid is the polyline of
the particles themselves, which slide on the given arc or polyline. So that this conserves the volume inside, a
particle slides at right angles to n_i, the boundary integral of its shape function times the normal: parallel to the
line from the particle before it to the one after it (Engelman, Sani & Gresho, Int. J. Numer. Methods Fluids 2, 1982).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tipfem.geometry.period import Period
from tipfem.geometry.plane.domain import Domain, enclosed
from tipfem.geometry.plane.vectors import angles, cross, turned
from tipfem.typing import Array

# Corners of the boundary that turn by more than this are fixed; particles slide past all others [degrees].
SMOOTH = 20.0 + 1e-6  # a circle of 18 edges is smooth, whatever its round-off
ROUNDS = 3  # of Newton's method for the volume inside


@dataclass(frozen=True)
class Curve:
    """A smooth part of the boundary along which fluid slips, of two edges or more."""

    wall: int  # number of the wall
    edges: Array  # (E,) numbers of the domain's edges, in order
    start: Array  # (E, 2) of the edges [m]
    end: Array  # (E, 2) of the edges [m]
    centre: Array  # (E, 2) of the arcs that they are a part of, NaN for straight edges [m]
    closed: bool  # whether its end is its beginning

    def nearest(self, y: Array) -> tuple[Array, Array]:
        """Distance of points (K, 2) to the polyline (K,) [m], and the number (K,) of the nearest edge in `edges`."""
        (u, v), square = (self.end - self.start).T, ((self.end - self.start) ** 2).sum(axis=1)
        a, b = (y[:, k, None] - self.start[:, k] for k in range(2))
        part = np.minimum(np.maximum((a * u + b * v) / square, 0.0), 1.0)
        a -= part * u
        b -= part * v
        distance = a * a + b * b
        edge = np.argmin(distance, axis=1)
        return np.sqrt(distance[np.arange(len(y)), edge]), edge

    def _foot(self, y: Array) -> tuple[Array, Array]:
        """The nearest edge (K,) of points (K, 2), and the part (K,) of its length where it is nearest."""
        _, edge = self.nearest(y)
        start, side = self.start[edge], (self.end - self.start)[edge]
        return edge, np.clip(((y - start) * side).sum(axis=1) / (side**2).sum(axis=1), 0.0, 1.0)

    def at_ends(self, y: Array, slack: float) -> Array:
        """Mask (K,) of the points (K, 2) [m] at its two ends, up to ``slack`` [m]; a closed curve has none."""
        if self.closed:
            return np.zeros(len(y), dtype=bool)
        first, last = (np.hypot(*(y - end).T) <= slack for end in (self.start[0], self.end[-1]))
        return np.asarray(first | last)

    def project(self, y: Array) -> Array:
        """The points (K, 2) of the curve nearest to points (K, 2) near it [m]: on the arc where an edge has one."""
        edge, part = self._foot(y)
        start = self.start[edge]
        straight = start + part[:, None] * (self.end - self.start)[edge]
        centre = self.centre[edge]
        off = y - centre
        radius = np.linalg.norm(start - centre, axis=1)
        length = np.linalg.norm(off, axis=1)
        with np.errstate(invalid="ignore", divide="ignore"):
            on_arc = centre + off * (radius / length)[:, None]
        return np.asarray(np.where(np.isfinite(on_arc), on_arc, straight))

    def along(self, y: Array) -> Array:
        """Places (K,) of points (K, 2) along the curve, in edges."""
        edge, part = self._foot(y)
        return np.asarray(edge + part)

    def swept(self, y: Array) -> Array:
        """Twice the areas (K,) that a line from the origin sweeps from the curve's start to points (K, 2) of it [m^2].

        What an arc encloses beyond the chord of an edge is taken off along this edge, in proportion to the angle.
        """
        edge, _ = self._foot(y)
        before = np.append(0.0, np.cumsum(cross(self.start, self.end)))[edge]
        start, centre = self.start[edge], self.centre[edge]
        from_start = cross(start, y)
        a, b, end = start - centre, y - centre, self.end[edge] - centre
        angle, whole = angles(a, b), angles(a, end)
        square = (a**2).sum(axis=1)
        # Sectors less triangles, of the arc to the point and of the whole one.
        with np.errstate(invalid="ignore"):
            beyond = square * angle - cross(a, b) - angle / whole * (square * whole - cross(a, end))
        return np.asarray(before + from_start + np.where(np.isfinite(beyond), beyond, 0.0))

    def tangent(self, y: Array, edge: Array | None = None) -> Array:
        """Unit vectors (K, 2) along the curve at points y (K, 2) [m], in the direction of its (nearest) edges (K,)."""
        edge = self.nearest(y)[1] if edge is None else edge
        side = (self.end - self.start)[edge]
        off = y - self.centre[edge]
        around = turned(off)
        around *= np.sign((around * side).sum(axis=1))[:, None]
        tangent = np.where(np.isfinite(around), around, side)
        return np.asarray(tangent / np.linalg.norm(tangent, axis=1)[:, None])


def runs_of(domain: Domain, side: int) -> list[Array]:
    """The edges of a side of a domain, by its number, in runs; see `runs_alike`."""
    return runs_alike(domain, np.where(domain.side == side, 0, -1))


def runs_alike(domain: Domain, kind: Array) -> list[Array]:
    """Numbers (E,) of edges in runs of one kind (S,), -1 for none, between corners that turn by more than `SMOOTH`."""
    mine = np.flatnonzero(kind >= 0)
    smooth = np.abs(domain.turn[mine]) <= math.radians(SMOOTH)
    goes_on = smooth & (kind[domain.following[mine]] == kind[mine])
    after = dict(zip(mine[goes_on].tolist(), domain.following[mine[goes_on]].tolist(), strict=True))
    left = dict.fromkeys(mine.tolist())
    firsts = [k for k in left if k not in set(after.values())]
    runs = []
    for first in [*firsts, *mine.tolist()]:  # the others are on closed curves
        if first not in left:
            continue
        run, k = [], first
        while k in left:
            del left[k]
            run.append(k)
            if k not in after:
                break
            k = after[k]
        runs.append(np.array(run))
    return runs


def has_curve(domain: Domain | None, side: str) -> bool:
    """Whether a side of a domain, by its name, is a curve, or a part of it is; see `Curve`."""
    return domain is not None and any(len(run) > 1 for run in runs_of(domain, domain.sides.index(side)))


def curve_of(domain: Domain, wall: int, run: Array) -> Curve:
    """The curve of a run of edges of a domain, see `runs_of`; ``wall`` is its number."""
    closed = bool(domain.following[run[-1]] == run[0]) and abs(domain.turn[run[-1]]) <= math.radians(SMOOTH)
    return Curve(wall, run, domain.start[run], domain.end[run], domain.centre[run], closed)


def outward_normals(position: Array, pairs: Array, period: Period) -> Array:
    """n_i (N, 2), the derivatives of `enclosed` by the positions (N, 2) [m]."""
    a, b = pairs.T
    p, q = position[a], position[b]
    outwards, r, s = 0.5 * turned(p - q), period.radius(p)[:, None], period.radius(q)[:, None]
    parts, ends = np.concatenate([outwards * ((2 * r + s) / 3), outwards * ((r + 2 * s) / 3)]), np.append(a, b)
    return np.stack([np.bincount(ends, part, len(position)) for part in parts.T], axis=1)


def restored(position: Array, pairs: Array, moves: Array, area: float, period: Period) -> Array:
    """Positions [m] with those on curves moved along their n_i, all by as much, so that the boundary encloses an area.

    ``pairs`` (E, 2) are the particles along the boundary, with the fluid on their left, ``moves`` (N,) masks those on
    curves; the area is a volume in an axisymmetric flow, see `enclosed`.
    """
    on, chain = np.unique(pairs, return_inverse=True)  # what is along the boundary alone
    pairs, x, stays = chain.reshape(pairs.shape), position[on], ~moves[on]
    for _ in range(ROUNDS):
        p, q = x[pairs.T]
        missing, normal = area - enclosed(p, q, period), outward_normals(x, pairs, period)
        normal[stays] = 0.0
        length = np.linalg.norm(normal, axis=1)
        if abs(missing) <= 1e-15 * area or not length.any():
            break
        # dA = n_i . dx_i, with dx_i = s n_i / |n_i|
        unit = np.divide(normal, length[:, None], out=np.zeros_like(x), where=length[:, None] > 0)
        x += (missing / length.sum()) * unit
    result = position.copy()
    result[on] = x
    return np.asarray(result)


def spread(position: Array, pairs: Array, curve: Curve, moves: Array) -> Array:
    """Positions (N, 2) [m] of a curve's particles, moved across it so that their polyline has its area beside it.

    A chord twice as long has four times the area between it and the arc: where particles are farther apart than the
    corners of `Curve.edges`, they stand outside of the arc, and inside where they are closer to each other. ``pairs``
    (E, 2) are the particles along the curve, with the fluid on their left; ``moves`` (N,) masks those that may be
    moved.
    """
    x = position.copy()
    (a, b), p, q = pairs.T, x[pairs[:, 0]], x[pairs[:, 1]]
    swept = curve.swept(q) - curve.swept(p)
    if (curve.start[0] == curve.end[-1]).all():  # closed, or a loop with one corner
        swept += np.where(curve.along(q) < curve.along(p), cross(curve.start, curve.end).sum(), 0.0)
    ends = moves[pairs].sum(axis=1)
    missing = np.where(ends > 0, 0.5 * (swept - cross(p, q)) / np.maximum(ends, 1), 0.0)
    outwards = 0.5 * np.stack([q[:, 1] - p[:, 1], p[:, 0] - q[:, 0]], axis=1)
    normal, share = np.zeros_like(x), np.zeros(len(x))
    for end in (a, b):
        np.add.at(normal, end, outwards)
        np.add.at(share, end, missing)
    square = (normal**2).sum(axis=1)
    some = moves & (square > 0)
    x[some] += (share[some] / square[some])[:, None] * normal[some]
    return np.asarray(x)


def old_ends(pairs: Array, is_new: Array) -> tuple[Array, Array]:
    """New particles (K,) along a boundary of ``pairs`` (E, 2), and the ones before and after each that are not new."""
    new, step = pairs[is_new[pairs[:, 0]], 0], np.tile(np.arange(len(is_new)), (2, 1))
    step[0, pairs[:, 1]], step[1, pairs[:, 0]] = pairs.T
    before, after = step[:, new]
    for _ in range(len(new)):  # several may follow each other
        if not (is_new[before].any() or is_new[after].any()):
            break
        before = np.where(is_new[before], step[0, before], before)
        after = np.where(is_new[after], step[1, after], after)
    return new, np.stack([before, after], axis=1)


def chain_tangents(position: Array, pairs: Array, particles: Sequence[int] | Array, period: Period) -> Array:
    """Unit vectors (K, 2) from the particle before to that after each of ``particles`` (K,) along the boundary.

    In an axisymmetric flow they are at right angles to n_i, too, where both faces count by their radii.
    """
    before, after = np.full(len(position), -1), np.full(len(position), -1)
    after[pairs[:, 0]], before[pairs[:, 1]] = pairs[:, 1], pairs[:, 0]
    along = position[after[particles]] - position[before[particles]]
    if period.axial:
        ends, own = (after[particles], before[particles]), 2 * position[particles, 0]
        one, other = ((own + position[end, 0])[:, None] * (position[end] - position[particles]) for end in ends)
        along = one - other
    return np.asarray(along / np.linalg.norm(along, axis=1)[:, None])
