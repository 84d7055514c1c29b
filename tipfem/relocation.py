"""Relocation: keep the cloud even by moving crowded particles to where it is thin, fluid by fluid.

The number of particles of each fluid never changes, as in Carvalho & Sanches: what is taken from
a crowded place is set into a long edge of the same fluid.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from tipfem.mesh import Mesh
from tipfem.particles import Array, Particles
from tipfem.places import Edges, apex_of, cells_on_walls, measured_edges, places_in, with_room
from tipfem.relocation_rule import RelocationRule


def relocate(particles: Particles, mesh: Mesh, rule: RelocationRule) -> tuple[Particles, Array]:
    """Move crowded particles into long edges of their own fluid.

    Args:
        particles: the state on N particles, after the step's motion.
        mesh: of the step; its simplices must not be inverted at the particles' positions.
        rule: the lengths that decide.

    Returns:
        The new state; and (K, 3) for each particle that was moved, itself and the two ends of the edge that it is on
        now. It takes velocity, acceleration and pressure from these two, by linear interpolation.
    """
    h = particles.spacing
    mesh = mesh.carried(particles.position)
    on_wall, height = cells_on_walls(mesh, particles.wall)
    edges = measured_edges(mesh, particles.wall, on_wall, height)
    long = edges[np.flatnonzero(edges.length > h)]
    gone, stuck = np.zeros(len(particles), dtype=bool), np.zeros(len(particles), dtype=bool)
    moved, moves = particles, np.zeros((0, 3), dtype=np.int64)
    # Of a close pair one is asked to move; if its fluid has no place for it, then the other.
    for _ in range(2):
        crowd = _crowding(mesh, edges, particles.wall, on_wall, height, gone, stuck, rule, h)
        crowded = np.isfinite(crowd)
        if not crowded.any():
            break
        moved, now = _move(particles, moved, crowd, gone, long, rule)
        moves = np.concatenate([moves, now])
        stuck |= crowded
        stuck[now[:, 0]] = False
        stuck[now[:, 1:]] = True
        gone[now[:, 0]] = True
    return moved, moves


def _move(
    particles: Particles, moved: Particles, crowd: Array, gone: Array, edges: Edges, rule: RelocationRule
) -> tuple[Particles, Array]:
    """Set crowded particles into places of their own fluid, the most crowded into the longest edges.

    Args:
        particles: the state before relocation.
        moved: the same with what was relocated already, (N,) ``gone``.
        crowd: (N,) finite for particles that are to move.
        edges: of the mesh before relocation, those longer than a spacing.
        rule: the lengths that decide.

    Returns:
        The new state, and (K, 3) what this call moved, as of `relocate`.
    """
    h = particles.spacing
    crowded = np.isfinite(crowd)
    moved, gone = moved.copy(), gone.copy()
    moves = [np.zeros((0, 3), dtype=np.int64)]
    tree = cKDTree(particles.position, compact_nodes=False, balanced_tree=False)  # for few questions
    for fluid in np.unique(particles.fluid[crowded]):
        own = np.flatnonzero(crowded & (particles.fluid == fluid))
        own = own[np.argsort(crowd[own], kind="stable")]
        # Ordinary particles need a long edge; urgent ones take what there is.
        urgent = crowd[own] < rule.urgent * h
        shortest = h if urgent.any() else rule.long_edge * h
        every = places_in(edges, particles, int(fluid), crowded | gone, shortest, rule)
        few = 8 * len(own) + 32
        while True:  # what is further down the list does not change what comes before
            places = with_room(every[np.arange(min(few, len(every.start)))], particles.position, tree,
                                moved.position[gone], rule, h)  # fmt: skip
            if len(places.start) >= len(own) or few >= len(every.start):
                break
            few *= 4
        k = min(len(own), len(places.start))
        keep = (places.length[:k] > rule.long_edge * h) | urgent[:k]
        own, places = own[:k][keep], places[np.flatnonzero(keep)]
        for name in ("position", "velocity", "acceleration", "pressure"):
            getattr(moved, name)[own] = places.interpolate(getattr(particles, name))
        gone[own] = True
        moves.append(np.stack([own, places.start, places.end], axis=1))
    return moved, np.concatenate(moves)


def _crowding(
    mesh: Mesh, edges: Edges, wall: Array, on_wall: Array, height: Array, gone: Array, stuck: Array,
    rule: RelocationRule, h: float,
) -> Array:  # fmt: skip
    """(N,) distance that makes a particle one to move [m]; inf for those that stay.

    Of two particles that are close to each other only one moves: not one that is ``stuck`` (N,) because its
    fluid has no place for it or another was set beside it, and none if one of them is ``gone`` (N,) already.
    """
    edges = edges[np.flatnonzero(edges.length < rule.too_close * h)]
    i, j, length = edges.i, edges.j, edges.length
    bound, front = wall | stuck, np.zeros(len(wall), dtype=bool) if mesh.surface is None else mesh.surface.front
    factor = np.array([1.0, rule.at_surface, rule.along_surface])
    close = (length < factor[front[i].astype(int) + front[j]] * rule.too_close * h) & ~(gone[i] | gone[j])
    close &= ~(bound[i] & bound[j])
    i, j, length = i[close], j[close], length[close]
    crowd = np.full(len(mesh.position), np.inf)
    # The surface keeps its shape when what is below it moves.
    np.minimum.at(crowd, np.where(bound[j] | (front[j] & ~front[i] & ~bound[i]), i, j), length)
    # Height over a wall counts on the scale of distances, so that both can be compared.
    apex = apex_of(mesh, wall, on_wall)
    low = (height < np.where(front, factor[2], 1.0)[apex] * rule.too_close_to_wall * h) & ~(gone | stuck)[apex]
    np.minimum.at(crowd, apex[low], height[low] * (rule.too_close / rule.too_close_to_wall))
    both = np.isfinite(crowd[i]) & np.isfinite(crowd[j])
    i, j = i[both], j[both]
    crowd[np.where(crowd[i] <= crowd[j], j, i)] = np.inf
    return crowd
