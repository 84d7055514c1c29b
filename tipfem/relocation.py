"""Relocation: keep the cloud even by moving crowded particles to where it is thin, fluid by fluid.

The number of particles of each fluid never changes, as in Carvalho & Sanches: what is taken from
a crowded place is set into a long edge of the same fluid.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

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
        at_surface: factor on these distances where one of two particles is on a free surface, and
        along_surface: where both are, and for heights of particles on the surface over a wall.

    Raises:
        ValueError: a length is not positive, or a rule would undo itself.
    """

    too_close: float = 0.6
    too_close_to_wall: float = 0.4
    long_edge: float = 1.2
    long_mixed_edge: float = 1.8
    urgent: float = 0.35
    at_surface: float = 0.75
    along_surface: float = 0.5

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not value > 0:
                raise ValueError(f"RelocationRule: {name} is {value!r}; it must be > 0 (in spacings)")
        if self.long_edge < 2 * self.too_close - 1e-12:
            raise ValueError(
                f"RelocationRule: long_edge {self.long_edge:g} is below twice too_close {self.too_close:g}; "
                "a particle set into such an edge would be moved again at once"
            )
        if self.long_mixed_edge < 3 * self.too_close - 1e-12:
            raise ValueError(
                f"RelocationRule: long_mixed_edge {self.long_mixed_edge:g} is below three times too_close "
                f"{self.too_close:g}; a particle set at a third of such an edge would be moved again at once"
            )


@dataclass(frozen=True)
class _Places:
    """Places that can take a particle: between ``start`` and ``end``, at ``weight`` from the start."""

    start: Array
    end: Array
    weight: Array
    length: Array

    def interpolate(self, values: Array) -> Array:
        """Values of the particles (N, ...), linearly interpolated at the places (K, ...)."""
        w = self.weight.reshape((-1,) + (1,) * (values.ndim - 1))
        return (1 - w) * values[self.start] + w * values[self.end]

    def __getitem__(self, index: Array) -> _Places:
        return _Places(self.start[index], self.end[index], self.weight[index], self.length[index])


def relocate(particles: Particles, mesh: Mesh, rule: RelocationRule) -> tuple[Particles, int]:
    """Move crowded particles into long edges of their own fluid.

    Args:
        particles: the state on N particles, after the step's motion.
        mesh: of the step; its simplices must not be inverted at the particles' positions.
        rule: the lengths that decide.

    Returns:
        The new state and how many particles were moved. A moved particle takes velocity,
        acceleration and pressure from the two ends of its edge, by linear interpolation.
    """
    h = particles.spacing
    mesh = mesh.moved(particles.position)
    on_wall, height = _cells_on_walls(mesh, particles.wall)
    wall_height = _height_of_edges(mesh, particles.wall, on_wall, height)
    moved, gone, stuck = particles, np.zeros(len(particles), dtype=bool), np.zeros(len(particles), dtype=bool)
    # Of a close pair one is asked to move; if its fluid has no place for it, then the other.
    for _ in range(2):
        crowd = _crowding(mesh, particles.wall, on_wall, height, gone, stuck, rule, h)
        crowded = np.isfinite(crowd)
        if not crowded.any():
            break
        moved, now_gone, ends = _move(particles, moved, mesh, crowd, gone, wall_height, rule)
        gone |= now_gone
        stuck |= (crowded & ~now_gone) | ends
    return (moved, int(gone.sum())) if gone.any() else (particles, 0)


def _move(
    particles: Particles, moved: Particles, mesh: Mesh, crowd: Array, gone: Array, wall_height: Array,
    rule: RelocationRule,
) -> tuple[Particles, Array, Array]:
    """Set crowded particles into places of their own fluid, the most crowded into the longest edges.

    Args:
        particles: the state before relocation.
        moved: the same with what was relocated already, (N,) ``gone``.
        mesh: of the state before relocation.
        crowd: (N,) finite for particles that are to move.
        wall_height: (E,) see `_height_of_edges`.
        rule: the lengths that decide.

    Returns:
        The new state, which particles (N,) this call moved, and which are the ends of the edges they are in.
    """
    h = particles.spacing
    crowded = np.isfinite(crowd)
    moved = moved.copy()
    now_gone, ends = np.zeros(len(particles), dtype=bool), np.zeros(len(particles), dtype=bool)
    tree = cKDTree(particles.position)
    for fluid in np.unique(particles.fluid[crowded]):
        own = np.flatnonzero(crowded & (particles.fluid == fluid))
        own = own[np.argsort(crowd[own], kind="stable")]
        # Ordinary particles need a long edge; urgent ones take what there is.
        urgent = crowd[own] < rule.urgent * h
        shortest = h if urgent.any() else rule.long_edge * h
        places = _places(mesh, particles, int(fluid), crowded | gone, wall_height, shortest, rule)
        places = _with_room(places, particles.position, tree, moved.position[gone | now_gone], rule, h)
        k = min(len(own), len(places.start))
        keep = (places.length[:k] > rule.long_edge * h) | urgent[:k]
        own, places = own[:k][keep], places[np.flatnonzero(keep)]
        for name in ("position", "velocity", "acceleration", "pressure"):
            getattr(moved, name)[own] = places.interpolate(getattr(particles, name))
        now_gone[own] = ends[places.start] = ends[places.end] = True
    return moved, now_gone, ends


def _cells_on_walls(mesh: Mesh, wall: Array) -> tuple[Array, Array]:
    """Cells (K,) of one fluid particle over a face of the wall, and the particle's height (K,) over it [m].

    A face of wall particles that two cells share runs across the fluid (in a corner) and is no wall.
    """
    d = mesh.dimension
    near = np.flatnonzero(wall[mesh.cells].sum(axis=1) >= d)
    if not len(near):
        return near, np.zeros(0)
    corners = mesh.cells[near]
    facet = np.concatenate([np.sort(np.delete(corners, c, axis=1), axis=1) for c in range(d + 1)])
    opposite = np.concatenate([corners[:, c] for c in range(d + 1)])
    cell = np.tile(near, d + 1)
    of_wall = wall[facet].all(axis=1)
    facet, opposite, cell = facet[of_wall], opposite[of_wall], cell[of_wall]
    _, number, count = np.unique(facet, axis=0, return_inverse=True, return_counts=True)
    face = (count[number.ravel()] == 1) & ~wall[opposite]
    facet, cell = mesh.position[facet[face]], cell[face]
    side = facet[:, 1:] - facet[:, :1]
    if d == 2:
        area = np.linalg.norm(side[:, 0], axis=1)
    else:
        area = 0.5 * np.linalg.norm(np.cross(side[:, 0], side[:, 1]), axis=1)
    return cell, d * mesh.measure[cell] / area


def _crowding(
    mesh: Mesh, wall: Array, on_wall: Array, height: Array, gone: Array, stuck: Array, rule: RelocationRule, h: float
) -> Array:
    """(N,) distance that makes a particle one to move [m]; inf for those that stay.

    Of two particles that are close to each other only one moves: not one that is ``stuck`` (N,) because its
    fluid has no place for it or another was set beside it, and none if one of them is ``gone`` (N,) already.
    """
    i, j = mesh.edges.T
    length = np.linalg.norm(mesh.position[i] - mesh.position[j], axis=1)
    bound, front = wall | stuck, np.zeros(len(wall), dtype=bool) if mesh.surface is None else mesh.surface.front
    factor = np.array([1.0, rule.at_surface, rule.along_surface])
    close = (length < factor[front[i].astype(int) + front[j]] * rule.too_close * h) & ~(gone[i] | gone[j])
    close &= ~(bound[i] & bound[j])
    i, j, length = i[close], j[close], length[close]
    crowd = np.full(len(mesh.position), np.inf)
    # The surface keeps its shape when what is below it moves.
    np.minimum.at(crowd, np.where(bound[j] | (front[j] & ~front[i] & ~bound[i]), i, j), length)
    # Height over a wall counts on the scale of distances, so that both can be compared.
    apex = _apex(mesh, wall, on_wall)
    low = (height < np.where(front, factor[2], 1.0)[apex] * rule.too_close_to_wall * h) & ~(gone | stuck)[apex]
    np.minimum.at(crowd, apex[low], height[low] * (rule.too_close / rule.too_close_to_wall))
    both = np.isfinite(crowd[i]) & np.isfinite(crowd[j])
    i, j = i[both], j[both]
    crowd[np.where(crowd[i] <= crowd[j], j, i)] = np.inf
    return crowd


def _apex(mesh: Mesh, wall: Array, cells: Array) -> Array:
    """The one particle (K,) of each of the cells (K,) that is no wall particle."""
    corners = mesh.cells[cells]
    return corners[np.arange(len(cells)), np.argmin(wall[corners], axis=1)]


def _height_of_edges(mesh: Mesh, wall: Array, on_wall: Array, height: Array) -> Array:
    """(E,) height of the fluid's end of an edge over the wall that its other end is in [m]; inf for others."""
    n = len(mesh.position)
    number = mesh.edges[:, 0].astype(np.int64) * n + mesh.edges[:, 1]
    result = np.full(len(number), np.inf)
    apex = _apex(mesh, wall, on_wall).astype(np.int64)
    for c in range(mesh.dimension + 1):
        foot = mesh.cells[on_wall, c].astype(np.int64)
        joined = foot != apex
        key = np.minimum(foot, apex)[joined] * n + np.maximum(foot, apex)[joined]
        np.minimum.at(result, np.searchsorted(number, key), height[joined])
    return result


def _places(
    mesh: Mesh, particles: Particles, fluid: int, crowded: Array, wall_height: Array, shortest: float,
    rule: RelocationRule,
) -> _Places:  # fmt: skip
    """Places for particles of a fluid in edges, high enough over the walls; the longest edges first.

    Edges within the fluid that are not longer than ``shortest`` [m] take none, nor do those of crowded particles
    (N,): they may be gone the next moment.
    """
    i, j = mesh.edges.T
    length = np.linalg.norm(mesh.position[i] - mesh.position[j], axis=1)
    own_i, own_j = particles.fluid[i] == fluid, particles.fluid[j] == fluid
    mixed = own_i != own_j
    long_enough = length > np.where(mixed, rule.long_mixed_edge * particles.spacing, shortest)
    stays = ~(crowded[i] | crowded[j]) & ~(particles.wall[i] & particles.wall[j])
    edge = np.flatnonzero(long_enough & (own_i | own_j) & stays)
    edge = edge[np.argsort(-length[edge], kind="stable")]
    start, end = np.where(own_i, i, j)[edge], np.where(own_i, j, i)[edge]
    weight = np.where(mixed[edge], 1 / 3, 0.5)
    over_wall = np.where(particles.wall[start], weight, 1 - weight) * wall_height[edge]
    high = over_wall >= rule.too_close_to_wall * particles.spacing
    return _Places(start, end, weight, length[edge])[np.flatnonzero(high)]


def _with_room(
    places: _Places, position: Array, tree: cKDTree, taken: Array, rule: RelocationRule, h: float
) -> _Places:
    """Those of the places that are far enough from all particles, from ``taken`` (K, d), and from each other.

    Of two that are too close to each other the first stays, the one in the longer edge.
    """
    if not len(places.start):
        return places
    point = places.interpolate(position)
    # An urgent particle may stand half a spacing from the ends of its edge; that is what its edge decides.
    reach = np.minimum(rule.too_close * h, np.minimum(places.weight, 1 - places.weight) * places.length)
    free = tree.query(point)[0] >= (1 - 1e-9) * reach
    if len(taken):
        free &= cKDTree(taken).query(point)[0] >= rule.too_close * h
    places, point = places[np.flatnonzero(free)], point[free]
    if not len(point):
        return places
    first, second = np.sort(cKDTree(point).query_pairs(rule.too_close * h, output_type="ndarray"), axis=1).T
    undecided, chosen = np.ones(len(point), dtype=bool), np.zeros(len(point), dtype=bool)
    while undecided.any():
        # A place is chosen when no undecided one before it is too close; then those too close to it are out.
        live = undecided[first] & undecided[second]
        winner = undecided.copy()
        winner[second[live]] = False
        chosen |= winner
        undecided &= ~winner
        undecided[second[winner[first]]] = False
    return places[np.flatnonzero(chosen)]
