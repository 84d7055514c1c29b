"""Lines of the rectilinear lattices on which a tank's particles begin."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Collection, Iterable

import numpy as np

from tipfem.particles import Array

# Lines closer than this, in spacings, would be crowded from the start: relocation moves such particles.
CLOSEST = 0.6


def fitted_lines(axis: int, length: float, spacing: float, faces: Iterable[float]) -> Array:
    """Coordinates (n,) of the lines along one axis, with one on every face [m]; see `lines`."""
    # A layer of two lines has a particle inside; with one, all would be shared with its neighbours.
    edges = _edges(axis, length, spacing, faces, lambda lower, upper: (2 * CLOSEST, "two lines"))
    pieces = [np.zeros(1)]
    for lower, upper in itertools.pairwise(edges):
        n = max(2, round((upper - lower) / spacing))
        pieces.append(np.linspace(lower, upper, n + 1)[1:])
    return np.concatenate(pieces)


def lines(
    axis: int, length: float, spacing: float, faces: Iterable[float], on_lines: Collection[float] = ()
) -> Array:
    """Coordinates (n,) of the lines along one axis, with every face midway between two of them [m].

    Args:
        axis: for messages.
        length: of the tank along it [m].
        spacing: h [m].
        faces: where parts of the tank end [m].
        on_lines: those of the faces on which a line stands instead.

    Raises:
        ValueError: two faces are too close to each other.
    """
    h = spacing
    # On a wall stands a line of its own, which the layer's first must keep off.
    edges = _edges(
        axis, length, h, faces,
        lambda lower, upper: (CLOSEST * (1.0 if lower > 0 and upper < length else 1.5), "one line"),
    )  # fmt: skip
    # First every layer by itself: a wall's line stands on the wall, the others half a step off the faces.
    layers = list(itertools.pairwise(edges))
    solid = {0.0, length, *on_lines}
    margins = [(0.0 if a in solid else 0.5) + (0.0 if b in solid else 0.5) for a, b in layers]
    counts = [max(int(m < 1), round((b - a) / h - m)) for (a, b), m in zip(layers, margins, strict=True)]
    steps = [(b - a) / (n + m) for (a, b), n, m in zip(layers, counts, margins, strict=True)]
    # Both sides of a face then take the same half gap: that of the smaller step crowds neither.
    half = [0.0, *(0.5 * min(s) for s in itertools.pairwise(steps)), 0.0]
    for k, n in enumerate(counts):
        if n == 0:  # a line alone stands in the middle of its layer
            half[k] = half[k + 1] = 0.5 * steps[k]
    half = [0.0 if edge in solid else gap for edge, gap in zip(edges, half, strict=True)]
    pieces = []
    for k, (lower, upper) in enumerate(layers):
        first, last = lower + half[k], upper - half[k + 1]
        single = counts[k] == 0 and abs(last - first) < 1e-9 * h
        n = 0 if single else max(1, round((last - first) / h))
        if last - first < CLOSEST * n * h * (1 - 1e-9):
            why = f"its neighbours let it be ({CLOSEST:g} spacings between lines)"
            raise _thin(axis, lower, upper, h, why)
        pieces.append(np.linspace(first, last, n + 1))
    result = np.concatenate(pieces)
    result = result[np.append(np.diff(result) > 1e-9 * length, True)]  # a line on a face is in two layers
    result[-1] = length
    return result


def _edges(
    axis: int, length: float, spacing: float, faces: Iterable[float],
    limit: Callable[[float, float], tuple[float, str]],
) -> list[float]:  # fmt: skip
    """Coordinates of walls and faces along one axis, ascending [m].

    limit: from two of them that follow each other to the least distance, in spacings, and what it is for.
    """
    edges = [0.0]
    # A face that is on a wall but for round-off is no face inside the tank.
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
    return ValueError(
        f"tank: along axis {axis}, the part between {lower:g} m and {upper:g} m is thinner than {limit}; "
        f"choose a smaller spacing than {spacing:g} m"
    )
