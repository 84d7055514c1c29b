"""A Delaunay triangulation by repair of the last one: edges are flipped, relocated particles removed and inserted."""

from __future__ import annotations

import numpy as np

from tipfem.backend.launch import launch
from tipfem.errors import TriangulationError
from tipfem.mesh.mesh import Mesh, simplex_measure
from tipfem.remesh.triangles.edge_operations import COLUMNS
from tipfem.remesh.triangles.insertion_kernels import SCRATCH, relocate_particles
from tipfem.remesh.triangles.triangulation import Triangulation
from tipfem.typing import Array

# Tolerance of the test whether a particle is in a circle, relative to its size: cocircular edges are not flipped.
TIES = 1e-13


def repaired(mesh: Mesh, moved: Array, position: Array, moves: Array) -> Mesh | None:
    """The Delaunay triangulation of particles that moved with a mesh, some of which were then relocated.

    Args:
        mesh: triangles on N particles; its hull is that of the new positions, too.
        moved: (N, 2) positions after the motion [m].
        position: (N, 2) positions after relocation [m].
        moves: (K, 3) the relocated particles, each with the two ends of the edge it was inserted into.

    Returns:
        The mesh; None where repair fails: a triangle was inverted, a relocated particle cannot be removed by collapsing
        an edge, one is not on an edge of the mesh, or flipping did not terminate.
    """
    expected = moved.copy()
    expected[moves[:, 0]] = position[moves[:, 0]]
    if (simplex_measure(moved, mesh.cells, mesh.period) <= 0).any() or not np.array_equal(expected, position):
        return None
    t = _triangulation(mesh, moved)
    if len(moves):
        done = launch(
            relocate_particles,
            t.state,
            t.cells,
            t.neighbours,
            t.fluid,
            t.period.array,
            t.corner,
            moves.astype(np.int32),
            np.ascontiguousarray(position[moves[:, 0]]),
            np.empty(SCRATCH, dtype=np.int32),
            0.0,
        )
        if done < len(moves):
            return None
    try:
        t.make_delaunay(TIES)
    except TriangulationError:
        return None
    new = Mesh(position, t.cells, period=mesh.period)
    if (new.measure <= 0).any():
        return None
    return new.with_(neighbours=t.neighbours)


def _triangulation(mesh: Mesh, moved: Array) -> Triangulation:
    """A copy of the mesh that can be changed, without masses, because these flips transfer no momentum."""
    count, cells = len(moved), mesh.cells.copy()
    state = np.zeros((count, COLUMNS))
    state[:, :2] = moved
    corner = np.full(count, -1, dtype=np.int32)
    corner[cells.ravel()] = np.arange(cells.size, dtype=np.int32) // 3
    nothing = np.zeros(len(cells), dtype=np.int32)
    return Triangulation(
        state, cells, mesh.neighbours.copy(), nothing, corner, np.zeros(count, dtype=np.int32), np.zeros(1), mesh.period
    )
