"""Rectilinear lattices on which the particles of a tank start, and their points on faces between fluids."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Collection, Iterable

import numpy as np

from tipfem.errors import Invalid
from tipfem.geometry.period import Period
from tipfem.typing import Array

# Function of positions (K, d) [m] to the number (K,) of the part of a tank that each is in, or to a mask.
Part = Callable[[Array], Array]
BISECTIONS = 52  # down to round-off
# Distance from a face at which the parts on its two sides are sampled [spacings].
BESIDE = 1e-4


def bisected(low: Array, high: Array, label: Callable[[Array], Array]) -> Array:
    """Places between pairs of places or points (K, ...) where the label (K,) changes from that of the first."""
    if not len(low):
        return low
    before = label(low)
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        same = (label(middle) == before).reshape(-1, *[1] * (low.ndim - 1))
        low, high = np.where(same, middle, low), np.where(same, high, middle)
    return np.asarray(0.5 * (low + high))


def crossings(start: Array, edge: Array, part: Part) -> Array:
    """At which part (K,) of edges (K, 2) from points (K, 2) [m] they leave the part of the tank that they begin in."""
    ends = np.zeros(len(start)), np.ones(len(start))
    fraction = bisected(*ends, lambda where: part(start + where[:, None] * edge))
    # Parts overlap by round-off. A face along a lattice line crosses an edge exactly at its end.
    return np.where(fraction < 1e-7, 0.0, np.where(fraction > 1 - 1e-7, 1.0, fraction))


def snap_to_faces(
    position: Array, shape: tuple[int, ...], size: Array, on_wall: Array, part: Part
) -> tuple[Array, Array]:
    """The lattice points (N, d) [m], some moved onto the faces between parts of a tank, and the mask (N,) of these.

    On every edge of the lattice, diagonals included, that joins two parts, the end that is closer to the face moves
    there along the edge; a point with several targets moves to the closest (Labelle & Shewchuk, "Isosurface stuffing",
    2007). Then no edge crosses a straight face except at walls. Points on a wall stay on it, and the corners of the
    tank do not move.

    Args:
        position: (N, d) lattice points [m], the last axis running fastest.
        shape: points along each axis.
        size: (d,) of the tank [m].
        on_wall: (N, d) mask of the coordinates that are those of walls.
        part: function of positions (K, d) [m] to the number (K,) of the part that each lies in.
    """
    index = np.arange(len(position)).reshape(shape)
    ways = [way for way in itertools.product((0, 1, -1), repeat=len(shape)) if way > (0,) * len(shape)]
    ways.sort(key=lambda way: (np.count_nonzero(way), [-step for step in way]))
    starts, ends = {0: np.s_[:], 1: np.s_[:-1], -1: np.s_[1:]}, {0: np.s_[:], 1: np.s_[1:], -1: np.s_[:-1]}
    one, other = (
        np.concatenate([index[tuple(side[step] for step in way)].ravel() for way in ways]) for side in (starts, ends)
    )
    label = part(position)
    mixed = label[one] != label[other]
    one, other = one[mixed], other[mixed]
    start, edge = position[one], position[other] - position[one]
    fraction = crossings(start, edge, part)
    crossing = start + fraction[:, None] * edge
    mover = np.where(fraction <= 0.5, one, other)
    crossing = np.where(on_wall[mover] & (on_wall[one] & on_wall[other]), position[mover], crossing)
    leaves = (on_wall[mover] & (crossing != position[mover])).any(axis=1)
    mover, crossing = mover[~leaves], crossing[~leaves]
    distance = np.linalg.norm(crossing - position[mover], axis=1)
    order = np.lexsort((distance, mover))
    mover, first = np.unique(mover[order], return_index=True)
    crossing = crossing[order][first]
    # The two diagonals of a square may cross a face at the same point, their middle: only one point moves there.
    tolerance = np.abs(size).max() * 1e-9
    distinct = np.unique(np.round(crossing / tolerance).astype(np.int64), axis=0, return_index=True)[1]
    mover, crossing = mover[distinct], crossing[distinct]
    snapped = position.copy()
    snapped[mover] = crossing
    on_face = np.zeros(len(position), dtype=bool)
    on_face[mover] = True
    return snapped, on_face


def faces_of_part(
    faces: Iterable[float], axis: int, lower: Array, size: Array, spacing: float, part: Part
) -> set[float]:
    """The faces normal to an axis [m] at which ``part``, a mask of points of a tank from ``lower`` (d,) on, ends."""
    others = [np.arange(0.25 * spacing, length, 0.5 * spacing) for k, length in enumerate(size) if k != axis]
    grid = np.stack([x.ravel() for x in np.meshgrid(*others, indexing="ij")], axis=1)
    found = set()
    for face in faces:
        below, above = (np.insert(grid, axis, face + s * BESIDE * spacing, axis=1) for s in (-1, 1))
        if (part(lower + below) != part(lower + above)).any():
            found.add(face)
    return found


def heaviest_beside(
    position: Array, box: Array, spacing: float, fluid: Part, rank: Array, period: Period | None = None
) -> Array:
    """The heaviest fluid (K,) that touches each of the points (K, d) [m] on faces in a ``box`` (2, d) [m].

    ``fluid`` is a function of positions (K, d) to fluids (K,), ``rank`` that of each from the lightest to the heaviest.
    """
    best = fluid(position)
    for corner in itertools.product((-1, 1), repeat=position.shape[1]):
        near = position + BESIDE * spacing * np.array(corner)
        near = np.clip(period.wrapped(near) if period else near, *box)
        other = fluid(near)
        best = np.where(rank[other] > rank[best], other, best)
    return best


def shifted_on_faces(position: Array, by: Array, held: Array, spacing: float, part: Part) -> Array:
    """Points (K, d) on faces between parts, displaced by (K, d) [m] along these: back on the face by its normal.

    Those beside which no normal is found stay, as do coordinates of the mask ``held`` (K, d).
    """
    ways = np.array([way for way in itertools.product((-1, 0, 1), repeat=position.shape[1]) if any(way)], dtype=float)
    ways /= np.linalg.norm(ways, axis=1)[:, None]
    here = part(position + BESIDE * spacing)
    normal = sum((part(position + 0.3 * spacing * way) == here)[:, None] * way for way in ways)
    normal = np.where(held, 0.0, normal)
    size = np.linalg.norm(normal, axis=1, keepdims=True)
    normal = np.divide(normal, size, out=np.zeros_like(normal), where=size > 0)
    goal = position + np.where(held, 0.0, by)
    low, high = goal - 0.4 * spacing * normal, goal + 0.4 * spacing * normal
    crossed = part(low) != part(high)
    result = position.copy()
    result[crossed] = bisected(low[crossed], high[crossed], part)
    # Parts overlap by round-off.
    return np.where(np.abs(result - position) < 1e-7 * spacing, position, result)


# Least distance of lines [spacings]; relocation would move particles that are closer from the start.
CLOSEST = 0.6


def fitted_lines(axis: int, length: float, spacing: float, faces: Iterable[float]) -> Array:
    """Coordinates (n,) of the lines along one axis, with one on every face [m]; see `lines`."""
    # With two intervals or more, a layer has particles that are not on its faces.
    edges = _edges(axis, length, spacing, faces, lambda lower, upper: (2 * CLOSEST, "two lines"))
    pieces = [np.zeros(1)]
    for lower, upper in itertools.pairwise(edges):
        n = max(2, round((upper - lower) / spacing))
        pieces.append(np.linspace(lower, upper, n + 1)[1:])
    return np.concatenate(pieces)


def lines(axis: int, length: float, spacing: float, faces: Iterable[float], on_lines: Collection[float] = ()) -> Array:
    """Coordinates (n,) of lines along an axis [m], faces midway between two, or, of ``on_lines``, on one.

    `ValueError` if two faces are too close to each other.
    """
    h = spacing
    # A wall has a line of its own, from which the first line of the layer keeps its distance.
    edges = _edges(
        axis,
        length,
        h,
        faces,
        lambda lower, upper: (CLOSEST * (1.0 if lower > 0 and upper < length else 1.5), "one line"),
    )
    # Each layer separately: lines are on walls, and half a step from faces.
    layers = list(itertools.pairwise(edges))
    solid = {0.0, length, *on_lines}
    margins = [(0.0 if a in solid else 0.5) + (0.0 if b in solid else 0.5) for a, b in layers]
    counts = [max(int(m < 1), round((b - a) / h - m)) for (a, b), m in zip(layers, margins, strict=True)]
    steps = [(b - a) / (n + m) for (a, b), n, m in zip(layers, counts, margins, strict=True)]
    # Then both sides of a face have the same half gap, that of the smaller step.
    half = [0.0, *(0.5 * min(s) for s in itertools.pairwise(steps)), 0.0]
    for k, n in enumerate(counts):
        if n == 0:  # a single line is in the middle of its layer
            half[k] = half[k + 1] = 0.5 * steps[k]
    half = [0.0 if edge in solid else gap for edge, gap in zip(edges, half, strict=True)]
    pieces = []
    for k, (lower, upper) in enumerate(layers):
        first, last = lower + half[k], upper - half[k + 1]
        single = counts[k] == 0 and abs(last - first) < 1e-9 * h
        n = 0 if single else max(1, round((last - first) / h))
        if last - first < CLOSEST * n * h * (1 - 1e-9):
            why = f"its neighbours allow ({CLOSEST:g} spacings between lines)"
            raise _thin(axis, lower, upper, h, why)
        pieces.append(np.linspace(first, last, n + 1))
    result = np.concatenate(pieces)
    result = result[np.append(np.diff(result) > 1e-9 * length, True)]  # a line on a face is in two layers
    result[-1] = length
    return np.asarray(result)


def _edges(
    axis: int, length: float, spacing: float, faces: Iterable[float], limit: Callable[[float, float], tuple[float, str]]
) -> list[float]:
    """Coordinates of walls and faces along an axis [m]; ``limit`` has the least distance of two, and its purpose."""
    edges = [0.0]
    # A face on a wall, up to round-off, is not inside the tank.
    inner = {face for face in faces if 1e-9 * length < face < length - 1e-9 * length}
    for face in [*sorted(inner), length]:
        if face - edges[-1] < 1e-9 * length:
            continue
        least, purpose = limit(edges[-1], face)
        if face - edges[-1] < least * spacing * (1 - 1e-9):
            why = f"{least:g} spacings ({least * spacing:g} m), the least for {purpose}"
            raise _thin(axis, edges[-1], face, spacing, why)
        edges.append(face)
    return edges


def _thin(axis: int, lower: float, upper: float, spacing: float, limit: str) -> ValueError:
    return Invalid(
        "tank",
        f": along axis {axis}, the part between {lower:g} m and {upper:g} m is thinner than {limit}; "
        f"choose a smaller spacing than {spacing:g} m",
    )
