"""Relocation: keep the density of particles even by moving crowded ones into long edges of their own fluid.

The number of particles of each fluid never changes, as in Carvalho & Sanches.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from tipfem.case.numerics import RelocationRule
from tipfem.case.particles import Particles
from tipfem.geometry.period import Period
from tipfem.geometry.place import places
from tipfem.mesh.mesh import Mesh, corners_among, simplex_measure
from tipfem.typing import Array


@dataclass(frozen=True)
class Edges:
    """Ends ``i``, ``j`` and length [m] of edges, all (E,), and their particles' heights over walls.

    ``height`` (E,): of the fluid's end of an edge over the wall that its other end is in [m]; inf for others.
    """

    i: Array
    j: Array
    length: Array
    height: Array

    def __getitem__(self, index: Array) -> Edges:
        return Edges(self.i[index], self.j[index], self.length[index], self.height[index])


@dataclass(frozen=True)
class InsertionSites:
    """Points on edges where a particle can be inserted; all arrays are (K,)."""

    # start, end: particles at the ends of the edge; ``start`` is of the fluid
    start: Array
    end: Array
    weight: Array  # part of the edge between the start and the site
    length: Array  # of the edge [m]

    def interpolate(self, values: Array) -> Array:
        """Values of the particles (N, ...), linearly interpolated at the sites (K, ...)."""
        w = self.weight.reshape((-1,) + (1,) * (values.ndim - 1))
        return np.asarray((1 - w) * values[self.start] + w * values[self.end])

    def points(self, position: Array, period: Period) -> Array:
        """The sites (K, d) [m], of particles at ``position`` (N, d) [m]."""
        if not period:
            return self.interpolate(position)
        edge = period.shortest(position[self.end] - position[self.start])
        return period.wrapped(position[self.start] + self.weight[:, None] * edge)

    def __getitem__(self, index: Array) -> InsertionSites:
        return InsertionSites(self.start[index], self.end[index], self.weight[index], self.length[index])


def cells_on_walls(mesh: Mesh, wall: Array) -> tuple[Array, Array]:
    """Cells (K,) of one fluid particle over a face of the wall, and the particle's height (K,) over it [m].

    A face of wall particles that two cells share is inside the fluid (in a corner) and not part of a wall.
    """
    d = mesh.dimension
    near = np.flatnonzero(corners_among(wall, mesh.cells) >= d)
    if not len(near):
        return near, np.zeros(0)
    corners = mesh.cells[near]
    facet = np.concatenate([np.sort(np.delete(corners, c, axis=1), axis=1) for c in range(d + 1)])
    opposite = np.concatenate([corners[:, c] for c in range(d + 1)])
    cell = np.tile(near, d + 1)
    of_wall = wall[facet].all(axis=1)
    facet, opposite, cell = facet[of_wall], opposite[of_wall], cell[of_wall]
    number = facet[:, 0].astype(np.int64)
    for column in facet.T[1:]:
        number = np.unique(number * len(wall) + column, return_inverse=True)[1].ravel()
    face = (np.bincount(number)[number] == 1) & ~wall[opposite]
    facet, cell = mesh.position[facet[face]], cell[face]
    side = mesh.period.shortest(facet[:, 1:] - facet[:, :1])
    if d == 2:
        area = np.linalg.norm(side[:, 0], axis=1)
    else:
        area = 0.5 * np.linalg.norm(np.cross(side[:, 0], side[:, 1]), axis=1)
    return cell, d * simplex_measure(mesh.position, mesh.cells[cell], mesh.period.planar) / area


def apex_of(mesh: Mesh, wall: Array, cells: Array) -> Array:
    """The particle (K,) of each of the cells (K,) that is not a wall particle."""
    corners = mesh.cells[cells]
    return np.asarray(corners[np.arange(len(cells)), np.argmin(wall[corners], axis=1)])


def measured_edges(mesh: Mesh, wall: Array, on_wall: Array, height: Array) -> Edges:
    """The edges of a mesh; cells ``on_wall`` (K,) and their ``height`` (K,) are those of `cells_on_walls`."""
    i, j = np.ascontiguousarray(mesh.edges.T)
    square = np.zeros(len(i))
    for k, axis in enumerate(mesh.position.T):
        x = np.ascontiguousarray(axis)
        square += mesh.period.shortest(x[i] - x[j], k) ** 2
    result = np.full(len(i), np.inf)
    joins = np.flatnonzero(wall[i] != wall[j])
    n, apex = len(mesh.position), apex_of(mesh, wall, on_wall).astype(np.int64)
    number = i[joins].astype(np.int64) * n + j[joins]
    order = np.argsort(number)
    joins, number = joins[order], number[order]
    for c in range(mesh.dimension + 1):
        foot = mesh.cells[on_wall, c].astype(np.int64)
        joined = foot != apex
        key = np.minimum(foot, apex)[joined] * n + np.maximum(foot, apex)[joined]
        np.minimum.at(result, joins[np.searchsorted(number, key)], height[joined])
    return Edges(i, j, np.sqrt(square), result)


def insertion_sites(
    edges: Edges, particles: Particles, fluid: int, crowded: Array, shortest: float, rule: RelocationRule
) -> InsertionSites:
    """Sites for particles of a fluid in edges, high enough over the walls; the longest edges first.

    There are none on edges within the fluid that are not longer than ``shortest`` [m], nor on those of ``crowded``
    particles (N,), which may be relocated themselves.
    """
    i, j, length = edges.i, edges.j, edges.length
    own_i, own_j = particles.fluid[i] == fluid, particles.fluid[j] == fluid
    mixed = own_i != own_j
    long_enough = length > np.where(mixed, rule.long_mixed_edge * particles.spacing, shortest)
    stays = ~(crowded[i] | crowded[j]) & ~(particles.wall[i] & particles.wall[j])
    edge = np.flatnonzero(long_enough & (own_i | own_j) & stays)
    edge = edge[np.argsort(-length[edge], kind="stable")]
    start, end = np.where(own_i, i, j)[edge], np.where(own_i, j, i)[edge]
    weight = np.where(mixed[edge], 1 / 3, 0.5)
    over_wall = np.where(particles.wall[start], weight, 1 - weight) * edges.height[edge]
    high = over_wall >= rule.too_close_to_wall * particles.spacing
    return InsertionSites(start, end, weight, length[edge])[np.flatnonzero(high)]


def sites_with_room(
    sites: InsertionSites, position: Array, tree: cKDTree, taken: Array, rule: RelocationRule, h: float, period: Period
) -> InsertionSites:
    """Sites that are far enough from all particles, from ``taken`` positions (K, d), and from each other.

    Of two that are too close to each other the first stays, the one in the longer edge.
    """
    if not len(sites.start):
        return sites
    point = sites.points(position, period)
    # An urgent particle may be inserted half a spacing from the ends of its edge, which its edge determines.
    reach = np.minimum(rule.too_close * h, np.minimum(sites.weight, 1 - sites.weight) * sites.length)
    free = tree.query(point)[0] >= (1 - 1e-9) * reach
    if len(taken):
        free &= cKDTree(taken, boxsize=period.tree_box).query(point)[0] >= rule.too_close * h
    sites, point = sites[np.flatnonzero(free)], point[free]
    if not len(point):
        return sites
    first, second = np.sort(
        cKDTree(point, boxsize=period.tree_box).query_pairs(rule.too_close * h, output_type="ndarray"), axis=1
    ).T
    undecided, chosen = np.ones(len(point), dtype=bool), np.zeros(len(point), dtype=bool)
    while undecided.any():
        # A site is chosen when no undecided site before it is too close; then those too close to it are rejected.
        live = undecided[first] & undecided[second]
        winner = undecided.copy()
        winner[second[live]] = False
        chosen |= winner
        undecided &= ~winner
        undecided[second[winner[first]]] = False
    return sites[np.flatnonzero(chosen)]


def relocate(particles: Particles, mesh: Mesh, rule: RelocationRule) -> tuple[Particles, Array]:
    """Move crowded particles into long edges of their own fluid, after the step's motion.

    Beside the state, (K, 3) has for each relocated particle itself and the two ends of the edge into which it was
    inserted, from which velocity, acceleration and pressure are interpolated. No cell may be inverted.
    """
    h = particles.spacing
    mesh = mesh.moved(particles.position)
    on_wall, height = cells_on_walls(mesh, particles.wall)
    edges = measured_edges(mesh, particles.wall, on_wall, height)
    long = edges[np.flatnonzero(edges.length > h)]
    relocated, stuck = np.zeros(len(particles), dtype=bool), np.zeros(len(particles), dtype=bool)
    moved, moves = particles, np.zeros((0, 3), dtype=np.int64)
    # Of a close pair one is to move; if there is no site for it in its fluid, the other.
    for _ in range(2):
        crowd = _crowding(mesh, edges, particles.wall, on_wall, height, relocated, stuck, rule, h)
        crowded = np.isfinite(crowd)
        if not crowded.any():
            break
        moved, now = _move(particles, moved, crowd, relocated, long, rule, mesh.period)
        moves = np.concatenate([moves, now])
        stuck |= crowded
        stuck[now[:, 0]] = False
        stuck[now[:, 1:]] = True
        relocated[now[:, 0]] = True
    return moved, moves


def _move(
    particles: Particles,
    moved: Particles,
    crowd: Array,
    relocated: Array,
    edges: Edges,
    rule: RelocationRule,
    period: Period,
) -> tuple[Particles, Array]:
    """Move particles of finite ``crowd`` (N,) to sites of their own fluid, the most crowded into the longest ``edges``.

    Returns the new state, and the moves of this call (K, 3), as for `relocate`.
    """
    h = particles.spacing
    crowded = np.isfinite(crowd)
    moved, relocated = moved.copy(), relocated.copy()
    moves = [np.zeros((0, 3), dtype=np.int64)]
    tree = cKDTree(  # for few queries
        particles.position, compact_nodes=False, balanced_tree=False, boxsize=period.tree_box
    )
    for fluid in np.unique(particles.fluid[crowded]):
        own = np.flatnonzero(crowded & (particles.fluid == fluid))
        own = own[np.argsort(crowd[own], kind="stable")]
        # Urgent particles may go into any edge, others only into long edges.
        urgent = crowd[own] < rule.urgent * h
        shortest = h if urgent.any() else rule.long_edge * h
        every = insertion_sites(edges, particles, int(fluid), crowded | relocated, shortest, rule)
        few = 8 * len(own) + 32
        while True:  # sites further down the list do not change those before
            sites = sites_with_room(
                every[np.arange(min(few, len(every.start)))],
                particles.position,
                tree,
                moved.position[relocated],
                rule,
                h,
                period,
            )
            if len(sites.start) >= len(own) or few >= len(every.start):
                break
            few *= 4
        k = min(len(own), len(sites.start))
        keep = (sites.length[:k] > rule.long_edge * h) | urgent[:k]
        own, sites = own[:k][keep], sites[np.flatnonzero(keep)]
        moved.position[own] = sites.points(particles.position, period)
        for name in ("velocity", "acceleration", "pressure"):
            getattr(moved, name)[own] = sites.interpolate(getattr(particles, name))
        relocated[own] = True
        moves.append(np.stack([own, sites.start, sites.end], axis=1))
    return moved, np.concatenate(moves)


def _crowding(
    mesh: Mesh,
    edges: Edges,
    wall: Array,
    on_wall: Array,
    height: Array,
    relocated: Array,
    stuck: Array,
    rule: RelocationRule,
    h: float,
) -> Array:
    """(N,) distance for which a particle is to move [m]; inf for those that stay.

    Of two particles that are close to each other only one moves: not one that is ``stuck`` (N,) because its fluid has
    no site for it or another was inserted beside it, and none if one of them is ``relocated`` (N,) already.
    """
    edges = edges[np.flatnonzero(edges.length < rule.too_close * h)]
    i, j, length = edges.i, edges.j, edges.length
    bound, front = wall | stuck, mesh.surface.front
    factor = np.array([1.0, rule.at_surface, rule.along_surface])
    close = (length < factor[front[i].astype(int) + front[j]] * rule.too_close * h) & ~(relocated[i] | relocated[j])
    close &= ~(bound[i] & bound[j])
    i, j, length = i[close], j[close], length[close]
    crowd = np.full(len(mesh.position), np.inf)
    # Particles below the surface move rather than those on it, which give it its shape. Otherwise their places decide,
    # which do not depend on their numbers.
    one_moves = np.where(front[i] == front[j], places(mesh.position[i]) > places(mesh.position[j]), front[j])
    one_moves = np.where(bound[i] | bound[j], bound[j], one_moves)
    np.minimum.at(crowd, np.where(one_moves, i, j), length)
    # Heights over walls are scaled so that they can be compared with distances.
    apex = apex_of(mesh, wall, on_wall)
    low = (height < np.where(front, factor[2], 1.0)[apex] * rule.too_close_to_wall * h) & ~(relocated | stuck)[apex]
    np.minimum.at(crowd, apex[low], height[low] * (rule.too_close / rule.too_close_to_wall))
    both = np.isfinite(crowd[i]) & np.isfinite(crowd[j])
    i, j = i[both], j[both]
    crowd[np.where(crowd[i] <= crowd[j], j, i)] = np.inf
    return crowd
