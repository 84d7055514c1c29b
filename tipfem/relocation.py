"""Relocation: keep the cloud even by moving crowded particles to where it is thin, fluid by fluid.

The number of particles of each fluid never changes, as in Carvalho & Sanches: what is taken from
a crowded place is set into a long edge of the same fluid.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tipfem.mesh import Mesh
from tipfem.particles import Array, Particles


@dataclass(frozen=True)
class RelocationRule:
    """When a particle is moved, and where to. All lengths in target spacings h.

    Attributes:
        too_close: a particle closer than this to another is moved.
        too_close_to_wall: a particle closer than this to a face of the wall is moved.
        long_edge: edges within a fluid longer than this take a particle at their middle.
        long_mixed_edge: edges between two fluids longer than this take a particle at a third of
            their length, so that no gap opens between the fluids.
        urgent: a particle closer than this to another is moved into any edge longer than h.

    Raises:
        ValueError: a length is not positive, or a rule would undo itself.
    """

    too_close: float = 0.6
    too_close_to_wall: float = 0.4
    long_edge: float = 1.2
    long_mixed_edge: float = 1.8
    urgent: float = 0.35

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not value > 0:
                raise ValueError(f"RelocationRule: {name} is {value!r}; it must be > 0 (in spacings)")
        if self.long_edge < 2 * self.too_close - 1e-12:
            raise ValueError(
                f"RelocationRule: long_edge {self.long_edge:g} is below twice too_close {self.too_close:g}; "
                "a particle set into such an edge would be moved again at once"
            )


@dataclass(frozen=True)
class _Targets:
    """Places that can take a particle: between ``start`` and ``end``, at ``weight`` from the start."""

    start: Array
    end: Array
    weight: Array
    length: Array


def relocate(particles: Particles, cells: Array, rule: RelocationRule) -> tuple[Particles, int]:
    """Move crowded particles into long edges of their own fluid.

    Args:
        particles: the state on N particles, after the step's motion.
        cells: (M, d + 1) simplices of the step, none inverted.
        rule: the lengths that decide.

    Returns:
        The new state and how many particles were moved. A moved particle takes velocity,
        acceleration and pressure from the two ends of its edge, by linear interpolation.
    """
    h = particles.spacing
    mesh = Mesh(particles.position, cells)
    height = _height_over_wall(mesh, particles.wall)
    crowd = _crowding(mesh, particles.wall, height, rule, h)
    crowded = np.flatnonzero(np.isfinite(crowd))
    if not len(crowded):
        return particles, 0
    moved = particles.copy()
    count = 0
    room = _room_at_edges(mesh, particles.wall, height, rule, h)
    for fluid in np.unique(particles.fluid[crowded]):
        own = crowded[particles.fluid[crowded] == fluid]
        own = own[np.argsort(crowd[own], kind="stable")]
        targets = _targets(mesh, particles, crowd, int(fluid), room, rule, h)
        k = min(len(own), len(targets.start))
        keep = (targets.length[:k] > rule.long_edge * h) | (crowd[own[:k]] < rule.urgent * h)
        own, start, end = own[:k][keep], targets.start[:k][keep], targets.end[:k][keep]
        weight = targets.weight[:k][keep]
        for name in ("position", "velocity", "acceleration", "pressure"):
            old, new = getattr(particles, name), getattr(moved, name)
            w = weight.reshape((-1,) + (1,) * (old.ndim - 1))
            new[own] = (1 - w) * old[start] + w * old[end]
        count += len(own)
    return (moved, count) if count else (particles, 0)


def _height_over_wall(mesh: Mesh, wall: Array) -> Array:
    """(M,) height of the one fluid particle over the wall face of its simplex; inf in others."""
    d = mesh.dimension
    at_wall = wall[mesh.cells]
    height = np.full(len(mesh.cells), np.inf)
    on_face = np.flatnonzero(at_wall.sum(axis=1) == d)
    if len(on_face):
        # Put the fluid particle first; the others make the face.
        order = np.argsort(at_wall[on_face], axis=1, kind="stable")
        corner = mesh.position[np.take_along_axis(mesh.cells[on_face], order, axis=1)]
        side = corner[:, 2:] - corner[:, 1:2]
        area = np.linalg.norm(side[:, 0], axis=1) if d == 2 else 0.5 * np.linalg.norm(
            np.cross(side[:, 0], side[:, 1]), axis=1
        )
        height[on_face] = d * mesh.measure[on_face] / area
    return height


def _crowding(mesh: Mesh, wall: Array, height: Array, rule: RelocationRule, h: float) -> Array:
    """(N,) distance that makes a particle one to move [m]; inf for those that stay.

    Of two particles that are close to each other only one moves.
    """
    i, j = mesh.edges.T
    length = np.linalg.norm(mesh.position[i] - mesh.position[j], axis=1)
    close = (length < rule.too_close * h) & ~(wall[i] & wall[j])
    i, j, length = i[close], j[close], length[close]
    crowd = np.full(len(mesh.position), np.inf)
    np.minimum.at(crowd, np.where(wall[j], i, j), length)
    # Height over a wall counts on the scale of distances, so that both can be compared.
    low = np.flatnonzero(height < rule.too_close_to_wall * h)
    apex = mesh.cells[low][np.arange(len(low)), np.argmin(wall[mesh.cells[low]], axis=1)]
    np.minimum.at(crowd, apex, height[low] * (rule.too_close / rule.too_close_to_wall))
    both = np.isfinite(crowd[i]) & np.isfinite(crowd[j])
    i, j = i[both], j[both]
    crowd[np.where(crowd[i] <= crowd[j], j, i)] = np.inf
    return crowd


def _room_at_edges(mesh: Mesh, wall: Array, height: Array, rule: RelocationRule, h: float) -> Array:
    """(E,) whether the middle of each edge is free to take a particle.

    It is free when no opposite particle is too close to it and it is high enough over the wall.
    """
    corners = mesh.cells.shape[1]
    number = mesh.edges[:, 0].astype(np.int64) * len(mesh.position) + mesh.edges[:, 1]
    room = np.ones(len(mesh.edges), dtype=bool)
    for a in range(corners):
        for b in range(a + 1, corners):
            pair = np.sort(mesh.cells[:, [a, b]], axis=1).astype(np.int64)
            edge = np.searchsorted(number, pair[:, 0] * len(mesh.position) + pair[:, 1])
            middle = 0.5 * (mesh.position[pair[:, 0]] + mesh.position[pair[:, 1]])
            blocked = 0.5 * height < rule.too_close_to_wall * h
            blocked &= wall[pair].any(axis=1)
            for c in set(range(corners)) - {a, b}:
                opposite = mesh.position[mesh.cells[:, c]]
                blocked |= ((middle - opposite) ** 2).sum(axis=1) < (rule.too_close * h) ** 2
            room[edge[blocked]] = False
    return room


def _targets(
    mesh: Mesh, particles: Particles, crowd: Array, fluid: int, room: Array, rule: RelocationRule, h: float
) -> _Targets:
    """Edges that can take a particle of a fluid, the longest first; no two share an end."""
    i, j = mesh.edges.T
    length = np.linalg.norm(mesh.position[i] - mesh.position[j], axis=1)
    own_i, own_j = particles.fluid[i] == fluid, particles.fluid[j] == fluid
    long_enough = np.where(own_i & own_j, length > h, length > rule.long_mixed_edge * h)
    free = room & long_enough & (own_i | own_j) & ~(particles.wall[i] & particles.wall[j])
    free &= ~np.isfinite(crowd[i]) & ~np.isfinite(crowd[j])
    edge = np.flatnonzero(free)
    chosen: list[Array] = []
    taken = np.zeros(len(particles), dtype=bool)
    while len(edge):
        best = np.zeros(len(particles))
        np.maximum.at(best, i[edge], length[edge])
        np.maximum.at(best, j[edge], length[edge])
        longest = edge[(length[edge] == best[i[edge]]) & (length[edge] == best[j[edge]])]
        # Edges of exactly the same length can still share an end; the first one keeps it.
        first = np.full(len(particles), len(length))
        np.minimum.at(first, i[longest], longest)
        np.minimum.at(first, j[longest], longest)
        longest = longest[(first[i[longest]] == longest) & (first[j[longest]] == longest)]
        chosen.append(longest)
        taken[i[longest]] = taken[j[longest]] = True
        edge = edge[~(taken[i[edge]] | taken[j[edge]])]
    pick = np.concatenate(chosen) if chosen else edge
    pick = pick[np.argsort(-length[pick], kind="stable")]
    mixed = ~(own_i & own_j)[pick]
    start = np.where(own_i[pick], i[pick], j[pick])
    end = np.where(own_i[pick], j[pick], i[pick])
    return _Targets(start, end, np.where(mixed, 1 / 3, 0.5), length[pick])
