"""Spacing of the particles along straight walls that slip or slide, or whose length a moving wall changes."""

from __future__ import annotations

import numpy as np

from tipfem.case.particles import Particles
from tipfem.geometry.period import Period
from tipfem.mesh.mesh import Mesh
from tipfem.typing import Array

# A particle that slides is relocated when it is closer to a neighbour than CLOSE mean distances along its wall, or when
# another gap is wider than WIDE mean distances.
CLOSE, WIDE = 0.6, 1.6
CORNER = 0.1  # the least distance to a dry corner, in mean distances
FIELDS = ("position", "velocity", "acceleration", "pressure")


def space_sliding(particles: Particles, piece: Array, mesh: Mesh) -> int:
    """Relocate crowded particles of a wall that slips to its widest gaps, in place; returns how many.

    They take velocity, acceleration and pressure from the two ends of their gap, by linear interpolation. Those of a
    ``piece`` are along a straight line; the first, the last, and those on the surface of the mesh stay, and dry ones
    are spaced evenly.
    """
    dry = mesh.dry(particles.wall)
    if mesh.front.any() or dry.any():
        _even_out(particles, piece, dry)
    moves = crowded_moves(particles.position, piece, mesh.front)
    for i, left, right in moves:
        for name in FIELDS:
            values = getattr(particles, name)
            values[i] = 0.5 * (values[left] + values[right])
    return len(moves)


def space_endless(particles: Particles, row: Array, period: Period) -> int:
    """Do `space_sliding` for a whole side, its particles ``row`` (K,), along a periodic axis, the first."""
    count, order = len(particles), row[np.argsort(particles.position[row, 0])]
    # The first particle, which stays, and its image are the ends.
    position = np.concatenate([particles.position, particles.position[order[:1]] + period.width])
    moves = crowded_moves(position, np.append(order, count))
    for i, left, right in moves:
        position[i] = 0.5 * (position[left] + position[right])
        ends = [order[0] if end == count else end for end in (left, right)]
        for values in (particles.velocity, particles.acceleration, particles.pressure):
            values[i] = 0.5 * (values[ends[0]] + values[ends[1]])
    particles.position[order] = period.wrapped(position[order])
    return len(moves)


def space_back(particles: Particles, piece: Array, coordinates: Array) -> None:
    """Move the particles of a no-slip wall to coordinates (K,) between its ends, 0 and 1, in place.

    This loses no information: their velocity is the wall's, and pressure has no time derivative.
    """
    _, along = _along(particles.position, piece)
    for name in FIELDS:
        values = getattr(particles, name)
        rows = values[piece].reshape(len(piece), -1)
        new = np.stack([np.interp(coordinates, along, rows[:, k]) for k in range(rows.shape[1])], axis=1)
        values[piece[1:-1]] = new[1:-1].reshape(len(piece) - 2, *values.shape[1:])


def _even_out(particles: Particles, piece: Array, dry: Array) -> None:
    """Space dry particles of a piece evenly between others, in place; this alone stops wet ones at dry corners."""
    order, along = _along(particles.position, piece)
    inner = ~np.isin(order, piece[[0, -1]])
    order, along = np.concatenate([piece[:1], order[inner], piece[-1:]]), np.concatenate([[0.0], along[inner], [1.0]])
    count = len(order) - 1
    room = CORNER * np.arange(count + 1) / count
    kept = np.clip(along, room, 1.0 - room[::-1])
    stopped = order[kept != along]
    particles.velocity[stopped] = particles.acceleration[stopped] = 0.0
    knots = ~dry[order]
    knots[[0, -1]] = True
    row = np.arange(count + 1)
    even = np.interp(row, row[knots], kept[knots])
    moved = order[even != along]
    ends = particles.position[piece[[0, -1]]]
    particles.position[moved] = ends[0] + even[even != along, None] * (ends[1] - ends[0])


def crowded_moves(position: Array, piece: Array, held: Array | None = None) -> list[tuple[int, int, int]]:
    """Moves of crowded particles of a row to between two others, one after the other: particle, left, right.

    Distances are relative to their mean along the row, which a moving wall changes. The first and the last of the
    ``piece`` and those of the mask ``held`` stay.
    """
    order, along = _along(position, piece)
    row, coordinates = order.tolist(), along.tolist()
    mean = 1.0 / (len(row) - 1)
    moves: list[tuple[int, int, int]] = []
    while len(moves) < len(row):
        gap = np.diff(coordinates)
        near, merged = np.minimum(gap[:-1], gap[1:]), gap[:-1] + gap[1:]
        if held is not None:  # as if they were not crowded
            near, merged = (np.where(held[row[1:-1]], np.inf, values) for values in (near, merged))
        crowded = near < CLOSE * mean
        # Of those that are too close, or if none is, of all: the one whose removal leaves the smallest gap.
        k = int(np.argmin(np.where(crowded, merged, np.inf) if crowded.any() else merged))
        rest = np.delete(gap, k)
        rest[k] = merged[k]
        target = int(np.argmax(rest))
        # Each move must make the row more even: the particle gets more room, or the widest gap is closed.
        better = 0.5 * rest[target] > 1.05 * near[k] if crowded.any() else merged[k] < 0.95 * gap.max()
        if not (crowded.any() or gap.max() > WIDE * mean) or not better:
            break
        particle = row.pop(k + 1)
        coordinates.pop(k + 1)
        row.insert(target + 1, particle)
        coordinates.insert(target + 1, 0.5 * (coordinates[target] + coordinates[target + 1]))
        moves.append((particle, row[target], row[target + 2]))
    return moves


def _along(position: Array, piece: Array) -> tuple[Array, Array]:
    """The row in its order along the line, and the coordinates (K,) of its particles, from 0 to 1."""
    chord = position[piece[-1]] - position[piece[0]]
    along = (position[piece] - position[piece[0]]) @ chord / (chord @ chord)
    order = np.argsort(along, kind="stable")
    return piece[order], along[order]
