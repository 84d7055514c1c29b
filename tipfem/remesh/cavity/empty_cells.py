"""Empty space beyond a free surface in 3-D, as cells of a fluid without density, with nodes that are no particles.

As between two fluids, cells there are swapped, collapsed and split, films of them break, and contacts slide along
walls. Nothing moves their nodes: they follow the particles around them. A step has no equations for them.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from tipfem.backend.launch import launch
from tipfem.errors import TriangulationError
from tipfem.geometry.polyhedron import Polyhedron
from tipfem.mesh.mesh import Mesh, simplex_measure
from tipfem.remesh.cavity import spreading
from tipfem.remesh.cavity.cavities import REPAIR, Cavities
from tipfem.typing import Array

APART, JITTER = 1.05, 0.15  # of the first nodes: least distance from particles, and off their lattice [spacings]
SWEEPS = 12  # in which the motion of particles spreads among the nodes
LEAST, KEPT = 1e-5, 0.1  # measure of a cell below which it has turned over [spacings^3], and part of what it was
SHORTEST = 2.0**-6  # part of a step in which its cells follow the motion at least


def first_nodes(position: Array, spacing: float, domain: Polyhedron) -> Array:
    """Nodes (K, 3) where no particle is near, in a domain, at the spacing of the ``position`` (N, 3) of particles."""
    lower, upper = position.min(axis=0), position.max(axis=0)
    count = np.maximum(np.rint((upper - lower) / spacing).astype(int), 1)
    axes = [np.linspace(a, b, n + 1)[1:-1] for a, b, n in zip(lower, upper, count, strict=True)]
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    nodes = nodes + np.random.default_rng(0).uniform(-JITTER, JITTER, nodes.shape) * spacing
    reach = APART * spacing
    inside = (nodes @ domain.normal.T - domain.offset > 0.5 * spacing).all(axis=1)
    return np.asarray(nodes[inside & np.isinf(cKDTree(position).query(nodes, distance_upper_bound=reach)[0])])


def extended(mesh: Mesh, values: Array, first: int) -> Array:
    """The values (N + K, C) of particles and nodes, with those of the nodes, from ``first`` on, as around these."""
    result, count = np.array(values), len(values) - first
    if not count:
        return result
    result[first:] = 0.0
    around, mean, width = mesh.incidence, np.empty((count, result.shape[1])), result.shape[1]
    for _ in range(SWEEPS):
        launch(spreading.spread, mesh.cells, *around, result, mean, first, count, width, work=(count, spreading.SPREAD))
        result[first:] = mean
    return result


def followed(cells: Array, nodes: Array, before: Array, after: Array, spacing: float) -> tuple[Array, Array]:
    """The cells (V, 4) of empty space and their nodes (K, 3) after a motion of the particles.

    Where cells would turn over they are repaired on the way; those that are returned are the same array if none were.

    Args:
        cells: before the motion; corners from N on are nodes.
        nodes: before it [m].
        before: (N, 3) particles before it [m].
        after: after it; particles move on straight lines [m].
        spacing: [m].

    Raises:
        TriangulationError: parts of the surface, or the surface and a wall, have passed through each other.
    """
    count, least = len(before), LEAST * spacing**3
    way, x, done, part = after - before, np.concatenate([before, nodes]), 0.0, 1.0
    while done < 1.0:
        part = min(part, 1.0 - done)
        shift = np.concatenate([part * way, np.zeros((len(x) - count, 3))])
        trial = x + extended(Mesh(x, cells), shift, count)
        volume = simplex_measure(trial, cells)
        if (volume > np.minimum(least, KEPT * simplex_measure(x, cells))).all():
            x, done = trial, done + part
            continue
        part *= 0.5
        if part < SHORTEST:
            where = x[cells[np.argmin(volume), 0]].round(6).tolist()
            raise TriangulationError(
                f"at {where} two parts of the free surface, or the surface and a wall, meet in the step"
            )
        x, cells = _repaired(x, cells, count, spacing)
    x[:count] = after
    return cells, x[count:]


def _repaired(x: Array, cells: Array, first: int, spacing: float) -> tuple[Array, Array]:
    """Places of particles and nodes, and better cells between them; nodes, from ``first`` on, come and go."""
    held = np.arange(len(x)) < first
    cavities = Cavities(Mesh(x, cells), held, spacing)
    cavities.run(*REPAIR[3])
    mesh = cavities.mesh()
    kept = np.flatnonzero(cavities.marks[first:]) + first
    number = np.full(len(cavities.x), -1, dtype=np.int32)
    number[:first], number[kept] = np.arange(first), first + np.arange(len(kept))
    return np.concatenate([x[:first], mesh.position[kept]]), number[mesh.cells]
