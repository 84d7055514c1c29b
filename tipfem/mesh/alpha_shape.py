"""Geometry for alpha-shapes: radii and heights of simplices, points covered by a mesh, drops held by suction."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from tipfem.mesh.mesh import Mesh
from tipfem.typing import Array


@dataclass(frozen=True)
class Shapes:
    """Shapes of K simplices, lengths in spacings."""

    radius: Array  # (K,) of the circumscribed circle or ball
    height: Array  # (K, d + 1) of each corner over the facet opposite to it
    gradient: Array  # (K, d + 1, d) of the barycentric coordinates

    @staticmethod
    def of(position: Array, cells: Array, spacing: float) -> Shapes:
        """Shapes of simplices (K, d + 1) on particles (N, d) [m], none of them flat; lengths in ``spacing`` [m]."""
        corner = position[cells] / spacing
        side = corner[:, 1:] - corner[:, :1]
        inverse = np.linalg.inv(side)
        centre = 0.5 * np.einsum("kij,kj->ki", inverse, (side**2).sum(axis=2))
        gradient = inverse.transpose(0, 2, 1)
        gradient = np.concatenate([-gradient.sum(axis=1, keepdims=True), gradient], axis=1)
        length = np.sqrt((gradient**2).sum(axis=2))
        return Shapes(np.sqrt((centre**2).sum(axis=1)), 1.0 / length, gradient)

    def foot(self, apex: Array) -> Array:
        """Barycentric coordinates (K, d + 1) of the foot of the perpendicular from corner number ``apex`` (K,)."""
        rows = np.arange(len(apex))
        g = self.gradient[rows, apex]
        along = np.einsum("kai,ki->ka", self.gradient, g) * self.height[rows, apex][:, None] ** 2
        along[rows, apex] = 0.0
        return np.asarray(-along)

    def __getitem__(self, k: Array) -> Shapes:
        """The shapes of some of the simplices, by index or mask."""
        return Shapes(self.radius[k], self.height[k], self.gradient[k])


def covered(points: Array, near: Array, before: Mesh) -> Array:
    """Mask (K,) of points (K, d) [m] in a simplex of the mesh ``before`` around their ``near`` particles (K, n)."""
    offsets, corners = before.incidence
    count = np.diff(offsets)[near]
    total = count.sum(axis=1)
    point = np.repeat(np.arange(len(points)), total)
    # Ranges of the simplices around all particles of a point, concatenated.
    first, number = offsets[near].ravel(), count.ravel()
    entry = np.arange(int(number.sum())) - np.repeat(np.cumsum(number) - number, number) + np.repeat(first, number)
    cell = corners[entry] // before.cells.shape[1]
    good = np.abs(before.measure[cell]) > 0
    point, cell = point[good], cell[good]
    corner = before.position[before.cells[cell]]
    side = corner[:, 1:] - corner[:, :1]
    inside = np.zeros(len(points), dtype=bool)
    if len(cell):
        part = np.linalg.solve(side.transpose(0, 2, 1), (points[point] - corner[:, 0])[..., None])[..., 0]
        hit = (part > -1e-9).all(axis=1) & (part.sum(axis=1) < 1 + 1e-9)
        inside[point[hit]] = True
    return inside


def hanging(mesh: Mesh, pressure: Array, below: Array) -> Array:
    """(N,) mask of the particles of drops that only suction holds at a wall; such drops are released.

    A connected component with a particle of the mask ``below`` the surface is not a drop.
    """
    i, j = mesh.edges.T
    graph = sparse.csr_matrix((np.ones(len(i), dtype=np.int8), (i, j)), shape=(len(below),) * 2)
    count, component = connected_components(graph, directed=False)
    total, deep = (np.bincount(component, weights=values, minlength=count) for values in (pressure, below))
    return np.asarray(((total < 0) & (deep == 0))[component])
