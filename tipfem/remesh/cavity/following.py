"""A mesh that follows its particles in 3-D: those relocated go in place, and swaps improve cells, without Qhull."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tipfem.mesh.mesh import Mesh, simplex_measure
from tipfem.remesh.cavity.cavities import QUALITY, Cavities
from tipfem.typing import Array

LEAST = 0.02  # quality of a cell below which a mesh is given up


def followed(mesh: Mesh, moved: Array, position: Array, moves: Array, wall: Array, spacing: float) -> Mesh | None:
    """The mesh of particles that moved with it, some of which were then relocated.

    Its cells are of a better quality rather than Delaunay; None where a cell was inverted, or a relocated particle
    cannot be taken out of the cells around it or put on its edge. ``moves`` (K, 3): these, each with the ends of its
    edge.
    """
    there = position.copy()
    there[moves[:, 0]] = moved[moves[:, 0]]
    if (simplex_measure(there, mesh.cells) <= 0).any():
        return None
    cavities = Cavities(mesh.moved(there), wall, spacing)
    if not cavities.relocate(moves, position[moves[:, 0]]):
        return None
    cavities.run(*QUALITY[3])
    new = cavities.mesh()
    found = Mesh(position, new.cells).with_(neighbours=new.neighbours)
    return found if qualities(found).min() > LEAST else None


def improved(mesh: Mesh, wall: Array, spacing: float) -> Mesh:
    """A mesh of the same particles with swaps that raise the quality of its cells in 3-D; the same one in 2-D."""
    if mesh.dimension == 2:
        return mesh
    cavities = Cavities(mesh, wall, spacing)
    cavities.run(*QUALITY[3])
    new = cavities.mesh()
    return replace(mesh, cells=new.cells).with_(neighbours=new.neighbours)


def qualities(mesh: Mesh) -> Array:
    """(M,) 6 sqrt(2) V / l^3 with the root mean square l of the edges of each tetrahedron: 1 for a regular one."""
    corner = mesh.position[mesh.cells]
    one, other = np.triu_indices(4, 1)
    square = ((corner[:, one] - corner[:, other]) ** 2).sum(axis=2).mean(axis=1)
    return np.asarray(6 * np.sqrt(2) * mesh.measure / (square * np.sqrt(square)))
