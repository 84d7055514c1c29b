"""Spray in 3-D: particles that carry fluid through empty space, out of pieces too small for cells, until they land.

And what stops these, and a surface, at walls: in empty space no pressure does.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from tipfem.case.particles import Particles
from tipfem.geometry.blocks import BlockedBox
from tipfem.mesh.mesh import Mesh
from tipfem.physics.state import lumped
from tipfem.physics.walls.step import WallsInStep
from tipfem.remesh.cavity.arrays import WALL
from tipfem.remesh.cavity.balance import Wanted
from tipfem.remesh.cavity.cavities import Cavities, highest, measures, touching
from tipfem.typing import Array

SMALL = 0.5  # volume of a component that becomes spray [spacings^3]
LEAST = 0.005  # volume that a particle may carry; less is given back to the fluid [spacings^3]
IN_FRONT = 0.05  # distance from a wall of what would have passed it in a step [spacings]
LEAST_WAY = 0.1  # what is left of a wall's normal along another wall, by which something can be put in front of it
NEAREST = 16  # cells, by their middles, in which a particle may be
LONGEST = 3.0  # edge of a cell, in targets, that particles may land in
PACE = 0.5  # distance of the places on its way beside which cells are looked at [spacings]


class Flight(NamedTuple):
    """Particles in free flight, N rows."""

    loose: Array  # mask of those that fly
    volume: Array  # that each carries [m^3]
    label: Array  # of the fluid that each carries

    def by_fluid(self, fluid: Array, count: int) -> Array:
        """(F,) volume that flies, of ``count`` fluids, by the fluid (N,) of the particles [m^3]."""
        return np.bincount(fluid[self.loose], self.volume[self.loose], minlength=count)


def stopped(
    particles: Particles, may: Array, walls: WallsInStep, planes: Array, blocks: BlockedBox | None = None
) -> Particles:
    """The particles, with those that have passed a wall in a step in front of it, without speed towards it.

    Args:
        particles: N at the end of a step, those of walls in their places.
        may: (N,) mask of those that are stopped; those that slide along a wall may meet another.
        walls: of the step.
        planes: (N, S) mask of the planes of a tank that particles are on.
        blocks: the box with its blocks; None of a convex tank.
    """
    x, free = particles.position, np.flatnonzero(may)
    if not len(free):
        return particles
    along = np.where(particles.wall[:, None, None], 0.0, np.eye(3))
    along[walls.sliding] = walls.columns.reshape(-1, 3, 3)
    middle, kept = x[particles.wall].mean(axis=0), particles
    passed = np.full(len(free), -1) if blocks is None else blocks.passed(walls.pose.origin(x[free]))
    for plane, on in enumerate(planes.T):
        inner = blocks is not None and not blocks.outer[plane]
        if np.count_nonzero(on) < 3 or (inner and not (passed == plane).any()):
            continue
        place = x[on].mean(axis=0)
        normal = np.linalg.eigh(np.cov((x[on] - place).T))[1][:, 0]
        if blocks is not None:
            normal = walls.pose.rotation @ blocks.normal[plane]
        normal = normal if inner or normal @ (middle - place) > 0 else -normal
        way = along[free] @ normal
        height = (kept.position[free] - place) @ normal
        there = (height < 0) & ~on[free] & (way @ normal > LEAST_WAY)
        there = np.flatnonzero(there & (passed == plane) if inner else there)
        if not len(there):
            continue
        if kept is particles:
            kept = particles.copy()
        gone, way = free[there], way[there] / (way[there] @ normal)[:, None]
        kept.position[gone] += (IN_FRONT * particles.spacing - height[there])[:, None] * way
        for values, of_walls in ((kept.velocity, particles.velocity), (kept.acceleration, particles.acceleration)):
            # Walls turn: what they have at right angles is linear in the place.
            known = np.column_stack([np.ones(len(x[on])), x[on] - place])
            found = np.linalg.lstsq(known, of_walls[on] @ normal, rcond=1e-6)[0]
            across = values[gone] @ normal - found[0] - (kept.position[gone] - place) @ found[1:]
            values[gone] -= np.minimum(across, 0.0)[:, None] * way
    return kept


def dissolved(cavities: Cavities, piece: Array) -> None:
    """Empty pieces that are too small and have no particles that could fly, as in a corner of the tank; in place.

    Restored volumes give theirs to a larger piece; one that is all of its fluid, or beside another fluid, stays.
    ``piece`` (M,): component of each cell, of empty space the last.
    """
    here, free, volume = _small(cavities, piece)
    across = cavities.across[here]
    label = np.where(across >= 0, cavities.label[across], 0)
    stays = free.any(axis=1) | ((label > 0) & (label != cavities.label[here, None])).any(axis=1)
    stays, used = np.bincount(piece[here], stays, len(volume)) > 0, piece >= 0
    larger = np.bincount(cavities.label[used], volume[piece[used]] >= _least(cavities)) > 0
    here = here[~stays[piece[here]] & larger[cavities.label[here]]]
    if len(here):
        cavities.label[here], piece[here] = 0, len(volume) - 1
        cavities.mark()


def released(cavities: Cavities, piece: Array, flight: Flight) -> Flight:
    """Release pieces that are too small for cells into flight, by their particles off walls and off other pieces.

    Their cells become empty, with nodes in place of these particles. ``piece`` as above.
    """
    here, free, volume = _small(cavities, piece)
    flies = np.bincount(piece[here], free.any(axis=1), len(volume)) > 0
    here, free = here[flies[piece[here]]], free[flies[piece[here]]]
    if not len(here):
        return flight
    cells, of = cavities.cells[here], piece[here]
    # By what the particles have of the cells: so a piece keeps its momentum, but for what was of walls.
    part = np.where(free, measures(cavities.x, cells)[:, None], 0.0)
    whole = np.bincount(of, part.sum(axis=1), len(volume))
    share = part * np.divide(volume, whole, out=np.zeros_like(volume), where=whole > 0)[of][:, None]
    torn = np.unique(cells[free])
    nodes, more = cavities.copied(torn), len(cavities.x) - len(flight.loose)
    flight = Flight(*(np.append(each, np.zeros(more, dtype=each.dtype)) for each in flight))
    flight.loose[torn] = True
    np.add.at(flight.volume, cells[free], share[free])
    flight.label[cells] = np.where(free, cavities.label[here, None], flight.label[cells])
    number = np.arange(len(cavities.x), dtype=np.int32)
    number[torn] = nodes
    around = cavities.around(flight.loose)
    cavities.cells[around] = number[cavities.cells[around]]
    cavities.label[here] = 0
    return flight


def _small(cavities: Cavities, piece: Array) -> tuple[Array, Array, Array]:
    """Cells (K,) of pieces that are too small, which of their corners (K, 4) may fly, and all pieces' volumes [m^3]."""
    wet, volume = cavities.label > 0, cavities.volumes(piece, int(piece.max()) + 1)
    small = np.append(volume < _least(cavities), False)[piece]  # the last one of rows that are not in use, -1
    here, stays, near = np.flatnonzero(small & wet), cavities.marks & WALL != 0, np.zeros(len(cavities.x), dtype=bool)
    near[cavities.cells[here]] = True
    beside = cavities.around(near)
    stays[cavities.cells[beside[wet[beside] & ~small[beside]]]] = True
    return here, ~stays[cavities.cells[here]], volume


def _least(cavities: Cavities) -> float:
    """Volume of a piece below which it becomes spray [m^3]."""
    return float(SMALL * cavities.spacing**3)


def landed(
    mesh: Mesh,
    particles: Particles,
    flight: Flight,
    old: Wanted,
    density: Array,
    way: Array,
) -> tuple[Particles, Flight, Wanted]:
    """Add volume and momentum of particles that have come into a cell of a fluid to this, the first on their way.

    The mesh has cells of fluids and, with the label 0, of empty space; ``old``: its components. Cells move, too, as far
    as their particles do on average; ``way`` (N, 3): of all in the step [m].
    """
    i = np.flatnonzero(flight.loose)
    if not len(i) or not (np.asarray(mesh.fluid) > 0).any():
        return particles, flight, old
    label, wanted = flight.label, old.volume.copy()
    hit, into = _met(mesh, particles, i, way)
    # What is too little to fly goes back to the largest piece of its fluid, without a place to land in.
    sizes = np.bincount(old.of, mesh.measure)
    largest = np.array([np.argmax(np.where(old.label == f, sizes, -1.0)) for f in range(len(density))])
    there = np.isin(label[i], old.label)
    few = ~hit & there & (flight.volume[i] < LEAST * particles.spacing**3)
    component = np.where(hit & (old.label[old.of[into]] == label[i]), old.of[into], largest[label[i]])
    done = (hit & there) | few
    np.add.at(wanted, component[done], flight.volume[i[done]])
    if (hit & there).any():
        k = hit & there
        particles = _joined(
            mesh, particles, i[k], mesh.cells[into[k]], density[label[i[k]]] * flight.volume[i[k]], density
        )
    loose, volume = flight.loose.copy(), flight.volume.copy()
    loose[i[done]], volume[i[done]] = False, 0.0
    return particles, Flight(loose, volume, label), old._replace(volume=wanted)


def _met(mesh: Mesh, particles: Particles, i: Array, way: Array) -> tuple[Array, Array]:
    """Mask of some particles (K,) that have come into a fluid, and the first cell (K,) on their way; see `landed`."""
    hit, into = np.zeros(len(i), dtype=bool), np.zeros(len(i), dtype=np.int64)
    x, wet = particles.position, np.asarray(mesh.fluid) > 0
    used = highest(mesh.cells, np.asarray(mesh.fluid), len(mesh.position)) > 0
    longest = float(np.linalg.norm(way[i], axis=1).max())
    back = np.linspace(0.0, 1.0, 1 + int(np.ceil(longest / (PACE * particles.spacing))))
    places = (x[i][:, None] - back[:, None] * way[i][:, None]).reshape(-1, 3)
    # A cell moves as far as a particle does at most, and no edge is longer than these targets.
    reach = LONGEST * float(particles.target[used[: len(x)]].max()) + float(np.linalg.norm(way, axis=1).max())
    cells = np.flatnonzero(touching(_beside(mesh.position, places, reach), mesh.cells) & wet)
    if not len(cells):
        return hit, into
    tree = cKDTree(np.asarray(sum(mesh.position[column] for column in mesh.cells[cells].T)) / 4)
    close = np.isfinite(tree.query(places, distance_upper_bound=reach)[0]).reshape(len(i), -1).any(axis=1)
    if not close.any():
        return hit, into
    at, places = i[close], places.reshape(len(i), -1, 3)[close].reshape(-1, 3)
    near, own = cells[tree.query(places, k=min(NEAREST, len(cells)))[1]].reshape(len(at), -1), way[at]
    corner = mesh.position[mesh.cells[near]]
    inverse = np.linalg.inv((corner[:, :, 1:] - corner[:, :, :1]).swapaxes(2, 3))
    moved = own[:, None] - way[mesh.cells[near]].mean(axis=2)
    weights, change = (
        np.einsum("knij,knj->kni", inverse, values) for values in (x[at][:, None] - corner[:, :, 0], moved)
    )
    weights = np.concatenate([weights, 1 - weights.sum(axis=2, keepdims=True)], axis=2)
    change = np.concatenate([change, -change.sum(axis=2, keepdims=True)], axis=2)
    # Part of the way back to where each weight is zero: it is positive before that if it grows on the way, else after.
    with np.errstate(divide="ignore", invalid="ignore"):
        zero = weights / change
    first = np.where(change > 0, zero, 1.0).min(axis=2)
    last = np.where(change < 0, zero, np.where((change == 0) & (weights < 0), np.inf, 0.0)).max(axis=2)
    inside = np.maximum(last, 0.0) <= np.minimum(first, 1.0)
    hit[close] = inside.any(axis=1)
    into[close] = near[np.arange(len(at)), np.where(inside, first, -1.0).argmax(axis=1)]
    return hit, into


def _beside(x: Array, places: Array, reach: float) -> Array:
    """(N,) mask of the points x (N, 3) in the cubes, of a side ``reach``, of places (K, 3), and in those around."""
    lowest = np.minimum(x.min(axis=0), places.min(axis=0))
    cube, of = (np.floor((each - lowest) / reach).astype(np.int64) + 1 for each in (x, places))
    marked = np.zeros(np.maximum(cube.max(axis=0), of.max(axis=0)) + 2, dtype=bool)
    for offset in np.ndindex(3, 3, 3):
        marked[tuple((of + offset - 1).T)] = True
    return np.asarray(marked[tuple(cube.T)])


def _joined(mesh: Mesh, particles: Particles, i: Array, around: Array, own: Array, density: Array) -> Particles:
    """The particles, with momenta of some (K,) of masses ``own`` (K,) given to those off walls (K, 4) around them."""
    mass = lumped(mesh, density[np.asarray(mesh.fluid)])
    weight = np.where(particles.wall[around], 0.0, mass[around])
    total = weight.sum(axis=1)
    new = particles.shallow_copy(velocity=particles.velocity.copy())
    v = particles.velocity
    mean = np.einsum("kc,kci->ki", weight, v[around]) / np.maximum(total, 1e-300)[:, None]
    change = (own / np.maximum(total + own, 1e-300))[:, None] * (v[i] - mean)
    row, corner = np.nonzero(weight)
    np.add.at(new.velocity, around[row, corner], change[row])
    return new
