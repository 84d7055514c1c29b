"""Shapes of the plane, for tanks and for what they are filled with: outlines of straight edges and arcs, with holes."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tipfem.arguments import is_number, numbers
from tipfem.typing import Array

# An arc is kept in parts of at most this angle [rad], each on one side of its chord.
QUARTER = 0.5 * math.pi
AXES = np.array([[1, 0], [0, 1], [-1, 0], [0, -1]])
# Relative to the size of a shape: two points closer than this are the same.
SAME = 1e-12
# Positions farther from the origin than this, in sizes of what has them, keep too few digits.
FARTHEST = 1e8
# An arc's ends may differ in their distance from its centre by this part of it.
ROUND = 1e-6


@dataclass(frozen=True)
class Arc:
    """An arc between two corners of a polygon, instead of a straight edge; `arc` makes one."""

    centre: tuple[float, float]  # (x, y) [m]
    clockwise: bool = False  # whether it runs clockwise from the corner before it to that after it


@dataclass(frozen=True)
class Piece:
    """A piece of an outline: a straight edge, or a part of an arc of at most a right angle."""

    # start, end: (2,) [m]
    start: Array
    end: Array
    name: str  # of the side that it belongs to
    centre: Array | None = None  # (2,) of the arc [m]; None for a straight edge

    @property
    def radius(self) -> float:
        """Radius of the arc [m]; inf for a straight edge."""
        return math.inf if self.centre is None else float(np.linalg.norm(self.start - self.centre))

    @property
    def length(self) -> float:
        """[m]."""
        if self.centre is None:
            return float(np.linalg.norm(self.end - self.start))
        return abs(self.radius * self.angle)

    @property
    def angle(self) -> float:
        """Angle that an arc turns about its centre [rad], positive anticlockwise; 0 for a straight edge."""
        if self.centre is None:
            return 0.0
        a, b = self.start - self.centre, self.end - self.centre
        return math.atan2(a[0] * b[1] - a[1] * b[0], float(a @ b))

    def at(self, part: Array) -> Array:
        """Points (K, 2) [m] at parts (K,) of the piece's length, from 0 to 1; the ends are exact."""
        part = np.asarray(part, dtype=float)[:, None]
        if self.centre is None:
            points = self.start + part * (self.end - self.start)
        else:
            turn = self.angle * part
            a = self.start - self.centre
            points = self.centre + np.cos(turn) * a + np.sin(turn) * np.array([-a[1], a[0]])
        points = np.where(part == 0.0, self.start, points)
        return np.asarray(np.where(part == 1.0, self.end, points))

    def reversed(self) -> Piece:
        """The same piece from its end to its start."""
        return replace(self, start=self.end, end=self.start)


@dataclass(frozen=True)
class Shape:
    """A region of the plane within an outline, less holes; `polygon`, `rectangle` and `circle` make one.

    Attributes:
        loops: the pieces of the outline, anticlockwise, then those of the holes, clockwise: the region is on the left.
    """

    loops: tuple[tuple[Piece, ...], ...]

    @property
    def pieces(self) -> tuple[Piece, ...]:
        """All pieces, of the outline first."""
        return tuple(piece for loop in self.loops for piece in loop)

    @property
    def sides(self) -> tuple[str, ...]:
        """The names of the sides, in the order in which they first occur."""
        return tuple(dict.fromkeys(piece.name for piece in self.pieces))

    def with_axis(self, name: str) -> Shape:
        """The same, with another ``name`` of what its outline has of x = 0."""

        def named(piece: Piece) -> Piece:
            on = piece.centre is None and piece.start[0] == 0 and piece.end[0] == 0
            return replace(piece, name=name) if on else piece

        return Shape(tuple(tuple(map(named, loop)) for loop in self.loops))

    @property
    def box(self) -> Array:
        """(2, 2) lower and upper corner of the bounding box [m]."""
        extremes = [np.array([piece.start for piece in self.loops[0]])]
        for piece in self.loops[0]:
            if piece.centre is not None:
                a, b = piece.start - piece.centre, piece.end - piece.centre
                off, sign = piece.radius * AXES, math.copysign(1.0, piece.angle)
                after = sign * (a[0] * off[:, 1] - a[1] * off[:, 0]) >= 0
                before = sign * (off[:, 0] * b[1] - off[:, 1] * b[0]) >= 0
                extremes.append(piece.centre + off[after & before])
        points = np.concatenate(extremes)
        return np.array([points.min(axis=0), points.max(axis=0)])

    @property
    def area(self) -> float:
        """[m^2]."""
        total = 0.0
        for piece in self.pieces:
            a, b = piece.start, piece.end
            total += 0.5 * float(a[0] * b[1] - a[1] * b[0])
            if piece.centre is not None:
                total += 0.5 * piece.radius**2 * (piece.angle - math.sin(piece.angle))
        return total

    def contains(self, x: Array) -> Array:
        """Mask (K,) of the points (K, 2) [m] inside; on the outline either."""
        inside = np.zeros(len(x), dtype=bool)
        px, py = x[:, 0], x[:, 1]
        for piece in self.pieces:
            (ax, ay), (bx, by) = piece.start, piece.end
            cross = (bx - ax) * (py - ay) - (by - ay) * (px - ax)
            # A ray in the direction of x crosses the chord.
            inside ^= ((ay > py) != (by > py)) & ((cross > 0) == (by > ay))
            if piece.centre is not None:
                in_circle = (px - piece.centre[0]) ** 2 + (py - piece.centre[1]) ** 2 < piece.radius**2
                inside ^= in_circle & ((cross < 0) if piece.angle > 0 else (cross > 0))
        return inside

    def touches(self, x: Array, reach: float) -> Array:
        """Mask (K,) of the points (K, 2) [m] closer to the outline, or to that of a hole, than ``reach`` [m]."""
        near = np.zeros(len(x), dtype=bool)
        for piece in self.pieces:
            along, off = piece.end - piece.start, x - piece.start
            part = np.clip(off @ along / (along @ along), 0.0, 1.0)
            close = np.linalg.norm(off - part[:, None] * along, axis=1) < reach
            if piece.centre is not None:
                # On the arc's side of its chord; its ends are those of the chord.
                outside = math.copysign(1.0, piece.angle) * (along[0] * off[:, 1] - along[1] * off[:, 0]) <= 0
                on_circle = np.abs(np.linalg.norm(x - piece.centre, axis=1) - piece.radius) < reach
                close = on_circle & (outside | close)
            near |= close
        return near

    def moved(self, shift: Array) -> Shape:
        """The shape elsewhere, by (2,) [m]."""

        def there(piece: Piece) -> Piece:
            centre = None if piece.centre is None else piece.centre + shift
            return replace(piece, start=piece.start + shift, end=piece.end + shift, centre=centre)

        return replace(self, loops=tuple(tuple(there(piece) for piece in loop) for loop in self.loops))

    def named(self, names: Sequence[str] | str) -> Shape:
        """The same shape with other names of its sides, one for all or one for each."""
        sides = self.sides
        new = [names] * len(sides) if isinstance(names, str) else list(names)
        if len(new) != len(sides) or not all(isinstance(name, str) and name for name in new):
            raise ValueError(f"shape: names is {names!r}; it must be {len(sides)} names, one for each side")
        of = dict(zip(sides, new, strict=True))
        return Shape(tuple(tuple(replace(piece, name=of[piece.name]) for piece in loop) for loop in self.loops))

    @staticmethod
    def of(given: Any) -> Shape:
        """A shape from a `Shape`, a list of corners or a polygon of shapely; `ValueError` if it is none or invalid."""
        if isinstance(given, Shape):
            return given
        if hasattr(given, "exterior") and hasattr(given, "interiors"):
            if not len(given.exterior.coords):
                raise ValueError("shape: the polygon of shapely is empty")
            rings = [np.asarray(ring.coords, dtype=float)[:-1, :2] for ring in (given.exterior, *given.interiors)]
            return polygon(rings[0], holes=rings[1:])
        if hasattr(given, "geoms"):
            text = f"shape: it is a {type(given).__name__} of {len(given.geoms)} parts; it must be one polygon, "
            raise ValueError(f"{text}connected")
        if not isinstance(given, Iterable):
            raise ValueError(f"shape is {given!r}; it must be a Shape, a list of corners or a polygon of shapely")
        return polygon(given)


def arc(centre: Sequence[float], *, clockwise: bool = False) -> Arc:
    """An arc between the corner before it and that after it in a list of corners; see `polygon`.

    Args:
        centre: (x, y) [m], at the same distance from both corners.
        clockwise: whether it runs clockwise; anticlockwise by default.

    Raises:
        ValueError: the centre is not a point.
    """
    point = numbers(centre)
    if point.shape != (2,) or not np.isfinite(point).all():
        raise ValueError(f"arc: centre is {centre!r}; it must be a point (x, y) in m")
    return Arc((float(point[0]), float(point[1])), bool(clockwise))


def polygon(
    corners: Iterable[Any], *, names: Sequence[str] | None = None, holes: Sequence[Any] = (), round_off: float = SAME
) -> Shape:
    """A shape from its corners, joined by straight edges or arcs.

    Args:
        corners: (x, y) of each [m], in either direction, with an `arc` between two of them where the edge is round. The
            last is joined to the first.
        names: of the sides, one for each edge, in order; by default side0, side1 and so on.
        holes: shapes, lists of corners or polygons of shapely that are cut out; their sides are numbered on.
        round_off: two corners closer than this part of the shape's size are the same.

    Raises:
        ValueError: there are too few corners, two of them are the same, an arc does not fit them, edges cross each
            other, a hole is not inside, or names do not fit.
    """
    edges = _edges(list(corners))
    if names is None:
        names = [f"side{k}" for k in range(len(edges))]
    if len(names) != len(edges) or not all(isinstance(name, str) and name for name in names):
        raise ValueError(f"polygon: names is {names!r}; it must be {len(edges)} names, one for each edge")
    pieces: list[Piece] = []
    scale = max(float(np.abs(np.array([e[0] for e in edges])).max()), 1e-300)
    extent = float(np.ptp(np.array([e[0] for e in edges]), axis=0).max())
    if FARTHEST * extent < scale:
        text = f"polygon: its corners are {scale:.3g} m from the origin and {extent:.3g} m apart; numbers keep too few "
        raise ValueError(f"{text}digits there: it must be at most {FARTHEST:.0e} times its size from the origin")
    for (a, b, by), name in zip(edges, names, strict=True):
        if np.abs(b - a).max() <= round_off * scale and by is None:
            raise ValueError(f"polygon: the corner {a.tolist()} occurs twice in succession")
        pieces += pieces_between(a, b, by, name)
    return _with_holes(Shape((tuple(pieces),)), len(edges), holes)


def rectangle(
    lower: Sequence[float],
    upper: Sequence[float],
    *,
    names: Sequence[str] = ("bottom", "right", "top", "left"),
    holes: Sequence[Any] = (),
) -> Shape:
    """A rectangle with its sides along the axes.

    Args:
        lower: its lower left corner [m].
        upper: its upper right corner [m].
        names: of the bottom, right, top and left side.
        holes: shapes that are cut out, see `polygon`.

    Raises:
        ValueError: the corners do not span a rectangle, or names do not fit.
    """
    a, b = numbers(lower), numbers(upper)
    if a.shape != (2,) or b.shape != (2,) or not (a < b).all():
        raise ValueError(f"rectangle: lower is {lower!r}, upper is {upper!r}; they must be two corners, lower < upper")
    return polygon([a, (b[0], a[1]), b, (a[0], b[1])], names=names, holes=holes)


def flap(foot: Sequence[float], *, height: float, thickness: float) -> Shape:
    """A plate on a round foot, about whose centre it swings while the foot stays on the floor.

    The foot is a half circle of corners that turn by 30 degrees, at which fluid is held. Its centre is half the
    thickness above the floor: the pivot of a motion or the hinge of a body that floats.

    Args:
        foot: (x, y) of the point where it touches the floor [m].
        height: of the plate's upper end above it [m].
        thickness: of the plate, the foot's diameter; three spacings or more [m].

    Raises:
        ValueError: the numbers make no such plate.
    """
    point, radius = numbers(foot), 0.5 * thickness
    if point.shape != (2,) or not 0 < thickness < height:
        given = f"foot is {foot!r}, height is {height!r}, thickness is {thickness!r}"
        raise ValueError(f"flap: {given}; it needs the two coordinates of a point, and 0 < thickness < height")
    turns = np.linspace(math.pi, 2 * math.pi, 7)
    arc_of = point + (0.0, radius) + radius * np.stack([np.cos(turns), np.sin(turns)], axis=1)
    return polygon([*arc_of, point + (radius, height), point + (-radius, height)])


def circle(centre: Sequence[float], radius: float, *, name: str = "side0", holes: Sequence[Any] = ()) -> Shape:
    """A disc; in a tank its outline becomes a polygon of edges about one spacing long.

    Args:
        centre: (x, y) [m].
        radius: [m].
        name: of its side.
        holes: shapes that are cut out, see `polygon`.

    Raises:
        ValueError: the centre is not a point, or the radius is not > 0.
    """
    c = numbers(centre)
    if c.shape != (2,) or not np.isfinite(c).all():
        raise ValueError(f"circle: centre is {centre!r}; it must be a point (x, y) in m")
    if not (is_number(radius) and radius > 0):
        raise ValueError(f"circle: radius is {radius!r} m; it must be > 0")
    corners: list[Any] = []
    for x, y in ((1, 0), (0, 1), (-1, 0), (0, -1)):
        corners += [(c[0] + radius * x, c[1] + radius * y), Arc((float(c[0]), float(c[1])))]
    return _with_holes(polygon(corners, names=[name] * 4), 1, holes)


def of_loops(loops: Sequence[tuple[Piece, ...]]) -> Shape:
    """The shape in the largest of closed outlines, less the others; `ValueError` if they cross or one is outside."""
    return _oriented(sorted(loops, key=lambda loop: -abs(Shape((loop,)).area)))


def cut_out(shape: Shape, holes: Sequence[Shape]) -> Shape:
    """A shape less others without holes that are inside it, whose sides keep their names.

    Raises:
        ValueError: one crosses or touches an edge, is outside, or has the name of another side.
    """
    known = set(shape.sides)
    for hole in holes:
        if known & set(hole.sides):
            raise ValueError(f"shape: {sorted(known & set(hole.sides))} are names of two sides; choose others")
        known |= set(hole.sides)
    return _with_holes(shape, len(shape.sides), holes)


def _with_holes(shape: Shape, count: int, holes: Sequence[Any]) -> Shape:
    """A shape less holes, whose sides are numbered from ``count`` on if they have no names; see `polygon`."""
    loops, names = list(shape.loops), set(shape.sides)
    for given in holes:
        hole = Shape.of(given)
        if len(hole.loops) > 1:
            raise ValueError("polygon: a hole has holes itself; make what is inside a tank of its own")
        if not isinstance(given, Shape):
            hole = hole.named([f"side{count + int(name[4:])}" for name in hole.sides])
        elif names & set(hole.sides):
            hole = hole.named([f"side{count + k}" for k in range(len(hole.sides))])
        count += len(hole.sides)
        names |= set(hole.sides)
        loops.append(hole.loops[0])
    return _oriented(loops)


def _edges(items: list[Any]) -> list[tuple[Array, Array, Arc | None]]:
    """Start, end and arc of each edge of a list of corners and arcs."""
    corners: list[Array] = []
    by: list[Arc | None] = []
    for item in items:
        if isinstance(item, Arc):
            if not corners or by[-1] is not None:
                raise ValueError("polygon: an arc must stand between two corners; begin with a corner")
            by[-1] = item
            continue
        point = numbers(item)
        if point.shape != (2,) or not np.isfinite(point).all():
            raise ValueError(f"polygon: corner {len(corners)} is {item!r}; it must be a point (x, y) in m, or an arc")
        corners.append(point)
        by.append(None)
    if len(corners) > 1 and by[-1] is None and (corners[0] == corners[-1]).all():
        corners.pop()
        by.pop()
    least = 2 if any(by) else 3
    if len(corners) < least:
        raise ValueError(f"polygon: it has {len(corners)} corners; it needs {least} or more")
    following = corners[1:] + corners[:1]
    return list(zip(corners, following, by, strict=True))


def pieces_between(a: Array, b: Array, by: Arc | None, name: str) -> list[Piece]:
    """An edge as pieces; see `polygon` for errors."""
    if by is None:
        return [Piece(a, b, name)]
    centre = np.array(by.centre)
    radius, other = float(np.linalg.norm(a - centre)), float(np.linalg.norm(b - centre))
    if not radius > 0 or abs(radius - other) > ROUND * radius:
        text = f"polygon: the arc from {a.tolist()} to {b.tolist()} has its centre at {centre.tolist()}, {radius:g} m "
        raise ValueError(f"{text}from the one and {other:g} m from the other; it must be equally far from both")
    first = math.atan2(a[1] - centre[1], a[0] - centre[0])
    turn = (math.atan2(b[1] - centre[1], b[0] - centre[0]) - first) % (2 * math.pi)
    if by.clockwise:
        turn -= 2 * math.pi
    if abs(turn) < 1e-9:
        raise ValueError(f"polygon: the arc at {a.tolist()} has no length")
    count = max(1, math.ceil(abs(turn) / QUARTER - 1e-9))
    angles = first + turn * np.arange(1, count) / count
    points = [a, *(centre + radius * np.array([math.cos(t), math.sin(t)]) for t in angles), b]
    return [Piece(one, two, name, centre) for one, two in itertools.pairwise(points)]


def _oriented(loops: list[tuple[Piece, ...]]) -> Shape:
    """The shape with its outline anticlockwise and holes clockwise; see `polygon` for errors."""
    result = []
    for k, loop in enumerate(loops):
        area = Shape((loop,)).area
        if (area > 0) != (k == 0):
            loop = tuple(piece.reversed() for piece in reversed(loop))
        result.append(loop)
    shape = Shape(tuple(result))
    _check_crossings(shape)
    outline, *holes = (Shape((loop,)) for loop in shape.loops)
    for hole in holes:
        start = hole.pieces[0].start
        if not outline.contains(start[None])[0]:
            raise ValueError(f"polygon: the hole at {start.tolist()} is not inside the outline")
        if any(other.contains(start[None])[0] for other in holes if other is not hole):
            text = f"polygon: the hole at {start.tolist()} is inside another hole; holes must be beside each other"
            raise ValueError(text)
    return shape


def _check_crossings(shape: Shape) -> None:
    """Raise ValueError where edges cross or touch; arcs by chords of 90/16 degrees."""
    points: list[Array] = []
    following: list[Array] = []
    ends: list[Array] = []
    for loop in shape.loops:
        own = np.concatenate([p.at(np.arange(16) / 16 if p.centre is not None else np.zeros(1)) for p in loop])
        first = sum(len(other) for other in points)
        points.append(own)
        ends.append(np.roll(own, -1, axis=0))
        following.append(first + np.roll(np.arange(len(own)), -1))
    a, b, after = np.concatenate(points), np.concatenate(ends), np.concatenate(following)
    scale = float(np.abs(a - a.mean(axis=0)).max())

    def side(p: Array, q: Array, r: Array) -> Array:
        cross = (q[..., 0] - p[..., 0]) * (r[..., 1] - p[..., 1]) - (q[..., 1] - p[..., 1]) * (r[..., 0] - p[..., 0])
        return np.where(np.abs(cross) < 1e-14 * scale**2, 0.0, cross)

    for k in range(len(a)):
        others = np.arange(k + 1, len(a))
        others = others[(after[others] != k) & (others != after[k])]
        if not len(others):
            continue
        c, d = a[others], b[others]
        one, two = side(a[k], b[k], c), side(a[k], b[k], d)
        three, four = side(c, d, a[k]), side(c, d, b[k])
        cross = (one * two <= 0) & (three * four <= 0)
        # On one line: they touch if they overlap.
        low, high = np.minimum(a[k], b[k]), np.maximum(a[k], b[k])
        cross &= ((np.minimum(c, d) <= high) & (np.maximum(c, d) >= low)).all(axis=1)
        if cross.any():
            j = others[np.argmax(cross)]
            text = f"polygon: the edge from {a[k].tolist()} to {b[k].tolist()} crosses or touches that from "
            raise ValueError(f"{text}{a[j].tolist()} to {b[j].tolist()}")
