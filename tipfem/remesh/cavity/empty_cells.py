"""Empty space beyond a free surface in 3-D, as cells of a fluid without density, with nodes that are no particles.

As between two fluids, cells there are swapped, collapsed and split, films of them break, and contacts slide along
walls. Nothing moves their nodes: they follow the particles around them. A step has no equations for them.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from tipfem.backend.launch import launch
from tipfem.errors import TriangulationError
from tipfem.geometry.polyhedron import Polyhedron
from tipfem.mesh.mesh import Mesh
from tipfem.remesh.cavity import passes
from tipfem.remesh.cavity.arrays import SPLIT
from tipfem.remesh.cavity.cavities import REPAIR, Cavities, measures
from tipfem.typing import Array

NEAR = 4.0  # to fluids, where the first nodes are as close as particles [spacings]
APART, JITTER = 1.05, 0.15  # of the first nodes: least distance from particles, and off their lattice [spacings]
SWEEPS, NEXT = 12, 3  # in which the motion of particles spreads among the nodes, and what else they have
LEAST, KEPT = 1e-5, 0.1  # measure of a cell below which it has turned over [spacings^3], and part of what it was
SHORTEST = 2.0**-6  # part of a step in which its cells follow the motion at least


def first_nodes(position: Array, wet: Array, spacing: float, domain: Polyhedron) -> Array:
    """Nodes (K, 3) of a domain where no particle is near: every other one where no fluid is.

    Args:
        position: (N, 3) of the particles [m].
        wet: (N,) mask of those of fluids.
        domain: of the tank.
    """
    lower, upper = position.min(axis=0), position.max(axis=0)
    count = np.maximum(np.rint((upper - lower) / spacing).astype(int), 1)
    axes = [np.linspace(a, b, n + 1)[1:-1] for a, b, n in zip(lower, upper, count, strict=True)]
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    number = np.stack(np.meshgrid(*(np.arange(1, n) for n in count), indexing="ij"), axis=-1).reshape(-1, 3)
    nodes = nodes + np.random.default_rng(0).uniform(-JITTER, JITTER, nodes.shape) * spacing
    inside = domain.clear(nodes, 0.5 * spacing)
    alone = np.isinf(cKDTree(position).query(nodes, distance_upper_bound=APART * spacing)[0])
    near = np.isfinite(cKDTree(position[wet]).query(nodes, distance_upper_bound=NEAR * spacing)[0])
    return np.asarray(nodes[inside & alone & (near | (number % 2 == 0).all(axis=1))])


def extended(mesh: Mesh, values: Array, rows: Array, sweeps: int = SWEEPS, along: Array | None = None) -> Array:
    """The values (N + K, C) of particles and nodes, with those of some ``rows`` (R,) as around these.

    ``along`` (A, C, C): projectors on what the first A rows may take of those around; the rest stays.
    """
    result, held = np.array(values), 0 if along is None else len(along)
    if not len(rows):
        return result
    own = result[rows[:held]]
    result[rows[held:]] = 0.0
    cells, around, width, other = mesh.cells, mesh.incidence, result.shape[1], result.copy()
    sums = np.empty((len(cells), width))
    free = np.zeros((0, width**2)) if along is None else along.reshape(held, width**2)
    for _ in range(sweeps):
        launch(passes.sum_corners, cells, result, sums, len(cells), width, work=(len(cells), passes.SUM))
        given = *around, rows, sums, result, other, free, own, width
        launch(passes.spread, *given, work=(len(rows), passes.SPREAD))
        result, other = other, result
    return result


class Slipping(NamedTuple):
    """Particles of dry walls along which fluids slide: they give way to a contact line, as nodes do to a surface."""

    rows: Array  # (D,) their numbers
    along: Array  # (D, 3, 3) projectors on the directions in which they slide
    planes: Array  # (N, S) mask of the planes of the boundary that all particles are on
    kinds: Array  # (S,) see `Cavities`


def followed(
    cells: Array, nodes: Array, before: Array, after: Array, spacing: float, slipping: Slipping
) -> tuple[Array, Array]:
    """The cells (V, 4) of empty space and their corners (N + K, 3), particles and nodes, after a motion of the former.

    Where cells would turn over they are repaired on the way; those that are returned are the same array if none were.

    Args:
        cells: before the motion; corners from N on are nodes.
        nodes: before it [m].
        before: (N, 3) particles before it [m].
        after: after it; particles move on straight lines [m].
        slipping: particles of dry walls; their motion is that of the walls.

    Raises:
        TriangulationError: parts of the surface, or the surface and a wall, have passed through each other.
    """
    count, least, (dry, along, *_) = len(before), LEAST * spacing**3, slipping
    way, x, done, part = after - before, np.concatenate([before, nodes]), 0.0, 1.0
    mesh, start = Mesh(x, cells), measures(x, cells)
    while done < 1.0:
        part = min(part, 1.0 - done)
        shift = np.concatenate([part * way, np.zeros((len(x) - count, 3))])
        rows = np.concatenate([dry, np.arange(count, len(x))]).astype(np.int32)
        trial = x + extended(mesh, shift, rows, along=along)
        volume = measures(trial, cells)
        if (volume > np.minimum(least, KEPT * start)).all():
            x, done, start = trial, done + part, volume
            mesh = mesh.moved(x)
            continue
        part *= 0.5
        if part < SHORTEST:
            where = x[cells[np.argmin(volume), 0]].round(6).tolist()
            raise TriangulationError(
                f"at {where} two parts of the free surface, or the surface and a wall, meet in the step"
            )
        x, cells = _repaired(x, cells, count, spacing, slipping)
        mesh, start = Mesh(x, cells), measures(x, cells)
    stays = np.ones(count, dtype=bool)
    stays[dry] = False
    x[:count][stays] = after[stays]
    return cells, x


def joined(neighbours: Array, beside: Array, cells: Array) -> Array:
    """Neighbours (M + V, 4) of the cells of fluids and the empty ones behind them, as `Cavities.mesh` has them.

    Args:
        neighbours: (M, 4) of the former among themselves.
        beside: (V, 4) of the latter, of both kinds.
        cells: (M + V, 4) both.
    """
    count = len(neighbours)
    whole = np.concatenate([neighbours, beside])
    row, i = np.nonzero((beside >= 0) & (beside < count))
    face = cells[count + row[:, None], (i[:, None] + [1, 2, 3]) % 4]
    other = beside[row, i]
    opposite = np.argmin((cells[other][:, :, None] == face[:, None, :]).any(axis=2), axis=1)
    whole[other, opposite] = count + row
    return whole


def _repaired(x: Array, cells: Array, first: int, spacing: float, slipping: Slipping) -> tuple[Array, Array]:
    """Places of particles and nodes, and better cells between them; nodes, from ``first`` on, come and go.

    Particles of dry walls go where a contact line reaches them: then no cell has them.
    """
    there = np.arange(len(x)) < first
    held, planes = there.copy(), np.zeros((len(x), slipping.planes.shape[1]), dtype=bool)
    held[slipping.rows], planes[:first] = False, slipping.planes
    cavities = Cavities(Mesh(x, cells), held, spacing, wall=there, planes=planes, kinds=slipping.kinds)
    cavities.run(*(task for task in REPAIR[3] if task.kind != SPLIT))
    mesh = cavities.mesh()
    kept = np.flatnonzero(cavities.marks[first:]) + first
    number = np.full(len(cavities.x), -1, dtype=np.int32)
    number[:first], number[kept] = np.arange(first), first + np.arange(len(kept))
    return np.concatenate([mesh.position[:first], mesh.position[kept]]), number[mesh.cells]
