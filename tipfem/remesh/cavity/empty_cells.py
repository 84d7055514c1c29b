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
from tipfem.mesh.mesh import Mesh, beyond_faces
from tipfem.remesh.cavity import passes
from tipfem.remesh.cavity.arrays import SPLIT
from tipfem.remesh.cavity.cavities import REPAIR, Cavities, measures, touching
from tipfem.typing import Array

# Distances from fluids from which on every other and every fourth one of the first nodes suffices [spacings].
STRIDES = ((4.5, 2), (9.5, 4))
APART, JITTER = 1.05, 0.15  # of the first nodes: least distance from particles, and off their lattice [spacings]
SWEEPS, NEXT = 12, 3  # in which the motion of particles spreads among the nodes, and what else they have
LEAST, KEPT = 1e-5, 0.1  # measure of a cell below which it has turned over [spacings^3], and part of what it was
SHORTEST = 2.0**-6  # part of a step in which its cells follow the motion at least
HELD = 2 / 3  # part of a step after which particles that meet stay there
RINGS = 3  # of cells around those that would turn over, which are repaired


def first_nodes(position: Array, wet: Array, spacing: float, domain: Polyhedron) -> Array:
    """Nodes (K, 3) of a domain where no particle is near: fewer where no fluid is.

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
    stride = _strides(nodes, position[wet], spacing)
    return np.asarray(nodes[inside & alone & (number % stride[:, None] == 0).all(axis=1)])


def first_on_walls(position: Array, wet: Array, on: Array, spacing: float, domain: Polyhedron) -> Array:
    """The particles (K,) that the first mesh has: fewer on dry walls along the axes, where no fluid is.

    ``on`` (N, S): the walls along which fluids slide that particles are on; those of two stay. Others as `first_nodes`.
    """
    lower, upper = position.min(axis=0), position.max(axis=0)
    number = np.rint((position - lower) / (upper - lower) * np.rint((upper - lower) / spacing)).astype(int)
    kept, stride = np.ones(len(position), dtype=bool), _strides(position, position[wet], spacing)
    for plane, normal in zip(on.T, np.abs(domain.normal), strict=True):
        if normal.max() == 1.0:
            i = np.flatnonzero(plane & (on.sum(axis=1) == 1))
            kept[i] = ((number[i] % stride[i, None] == 0) | (normal == 1.0)).all(axis=1)
    return np.flatnonzero(kept)


def _strides(places: Array, wet: Array, spacing: float) -> Array:
    """Strides (K,) on a lattice of places (K, 3) by their distances from ``wet`` particles."""
    stride = np.ones(len(places), dtype=int)
    off, _ = cKDTree(wet).query(places, distance_upper_bound=STRIDES[-1][0] * spacing)
    for distance, of in STRIDES:
        stride[off > distance * spacing] = of
    return stride


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
        launch(passes.sum_corners, cells, result, sums, 3, width, work=(len(cells), passes.SUM))
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


def followed(mesh: Mesh, after: Array, spacing: float, slipping: Slipping) -> Mesh:
    """The mesh (V, 4) of empty space and its corners (N + K, 3), particles and nodes, after a motion of the former.

    Where cells would turn over they are repaired on the way; the cells are the same array if none were. Corners may be
    left that no cell has.

    Args:
        mesh: before the motion; corners from N on are nodes.
        after: (N, 3) particles after it; they move on straight lines [m].
        spacing: of the particles [m].
        slipping: particles of dry walls; their motion is that of the walls.

    Raises:
        TriangulationError: parts of the surface, or the surface and a wall, have passed through each other.
    """
    count, least, (dry, along, *_) = len(after), LEAST * spacing**3, slipping
    done, part, start = 0.0, 1.0, measures(mesh.position, mesh.cells)
    rows = np.concatenate([dry, np.arange(count, len(mesh.position))]).astype(np.int32)
    own = after - mesh.position[:count]
    way = extended(mesh, np.concatenate([own, np.zeros((len(mesh.position) - count, 3))]), rows, along=along)
    held = np.isin(np.arange(len(mesh.position)), dry)
    while done < 1.0:
        part, x = min(part, 1.0 - done), mesh.position
        trial = x + part * way
        volume = measures(trial, mesh.cells)
        spoilt = volume <= np.minimum(least, KEPT * start)
        if not spoilt.any():
            mesh, done, start = mesh.moved(trial), done + part, volume
            continue
        part *= 0.5
        met = mesh.cells[spoilt]
        if part < SHORTEST and done > HELD and way[met].any():
            way[met], held[met], part = 0.0, True, 1.0
            continue
        if part < SHORTEST:
            where = x[mesh.cells[np.argmin(volume), 0]].round(6).tolist()
            raise TriangulationError(
                f"at {where} two parts of the free surface, or the surface and a wall, meet in the step"
            )
        mesh = _repaired(mesh, count, spacing, slipping, spoilt)
        start = measures(mesh.position, mesh.cells)
    x, stays = mesh.position.copy(), ~held[:count]
    x[:count][stays] = after[stays]
    return mesh.moved(x)


def _repaired(mesh: Mesh, first: int, spacing: float, slipping: Slipping, spoilt: Array) -> Mesh:
    """The mesh with better cells around some (V,), at places as they are; nodes, from ``first`` on, go.

    Particles of dry walls go where a contact line reaches them: then no cell has them.
    """
    near = np.zeros(len(mesh.position), dtype=bool)
    for _ in range(RINGS):
        near[mesh.cells[spoilt]] = True
        spoilt = touching(near, mesh.cells)
    at = np.flatnonzero(spoilt)
    corner, cells = np.unique(mesh.cells[at], return_inverse=True)
    number = np.full(len(spoilt) + 1, -1, dtype=np.int32)
    number[at] = np.arange(len(at))
    cells, beside = cells.reshape(-1, 4).astype(np.int32), mesh.neighbours[at]
    patch = Mesh(mesh.position[corner], cells).with_(neighbours=number[beside])
    # What is beside other cells stays, with its faces.
    edge = np.zeros(len(corner), dtype=bool)
    cell, i = np.nonzero((beside >= 0) & (patch.neighbours < 0))
    for k in (1, 2, 3):
        edge[cells[cell, (i + k) % 4]] = True
    there, slips = corner < first, np.isin(corner, slipping.rows)
    planes = np.where(there[:, None], slipping.planes[np.minimum(corner, first - 1)], False)
    held = (there & ~slips) | edge
    cavities = Cavities(patch, held, spacing, wall=there | edge, planes=planes, kinds=slipping.kinds)
    cavities.run(*(task for task in REPAIR[3] if task.kind != SPLIT))
    found, rest = cavities.mesh(), np.flatnonzero(~spoilt)
    place = mesh.position.copy()
    place[corner] = found.position[: len(corner)]
    number[at] = -1
    number[rest] = np.arange(len(rest))
    kept = number[mesh.neighbours[rest]]
    new = np.where(found.neighbours < 0, np.int32(-1), found.neighbours + np.int32(len(rest)))
    cells = np.concatenate([mesh.cells[rest], corner[found.cells].astype(np.int32)])
    among = beyond_faces(cells, np.concatenate([kept, new]), len(place))
    return Mesh(place, cells).with_(neighbours=among)
