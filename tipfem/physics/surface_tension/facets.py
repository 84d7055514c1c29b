"""TensionFacets: the facets of a mesh that have surface tension, with their energy and its forces; 3-D.

    E = sum_f sigma_f A_f    over the facets f between two fluids, or between a fluid and empty space

As in 2-D the forces are dE / dx with the other sign, see `tipfem.physics.surface_tension.edges`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from tipfem.case.boundary.boundary import Boundary
from tipfem.mesh.measures import area_vectors, faces_at_empty_space, outward, wall_faces
from tipfem.mesh.mesh import Mesh
from tipfem.mesh.relabelled import FILM
from tipfem.physics.surface_tension.edges import wetting
from tipfem.physics.surface_tension.tension import Tension
from tipfem.typing import Array


@dataclass(frozen=True)
class TensionFacets(Tension):
    """The E facets that have tension, on N particles."""

    dimension = 3
    corners: Array  # (E, 3) their particles, in one order about the normals of the facets between each two fluids
    sigma: Array  # (E,) surface tension [N/m]
    pair: Array  # (E,) number of the two fluids that each is between
    table: Array
    films: Array = field(default_factory=lambda: np.zeros((0, len(FILM))))
    entered: float = 0.0
    strain: Array | None = None

    @property
    def tense(self) -> Array:  # type: ignore[override]
        """See `Carried.tense`: the corners of the facets."""
        return np.unique(self.corners)

    def energy(self, position: Array) -> float:
        """E at positions (N, 3) [J]."""
        return float(self.sigma @ np.linalg.norm(area_vectors(position, self.corners), axis=1))

    def gradient(self, position: Array) -> Array:
        """dE / dx (N, 3) at positions (N, 3) [N]."""
        return area_gradient(position, self.corners, self.sigma)


def area_gradient(position: Array, corners: Array, sigma: Array) -> Array:
    """Derivatives (N, 3) of the sum of sigma (E,) times the areas of triangles (E, 3) by positions (N, 3)."""
    vector, result = area_vectors(position, corners), np.zeros_like(position)
    normal = vector * (sigma / np.linalg.norm(vector, axis=1))[:, None]
    for k in range(3):
        side = position[corners[:, (k + 1) % 3]] - position[corners[:, (k + 2) % 3]]
        part = 0.5 * np.cross(side, normal)
        for axis in range(3):
            result[:, axis] += np.bincount(corners[:, k], part[:, axis], len(position))
    return result


def find_facets(mesh: Mesh, table: Array) -> TensionFacets:
    """The facets that have tension: those between fluids, or between a fluid and empty space."""
    fluid, empty = np.asarray(mesh.fluid), len(table) - 1
    across = np.append(fluid, -1).take(mesh.neighbours)
    cell, i = np.nonzero(fluid[:, None] < across)
    one, other = fluid[cell], across[cell, i]
    found = [(outward(mesh.cells, cell, i), one, other)]
    if table[-1].any():
        wet, k = faces_at_empty_space(mesh)
        found.append((outward(mesh.cells, wet, k), fluid[wet], np.full(len(wet), empty)))
    corners, one, other = (np.concatenate(parts) for parts in zip(*found, strict=True))
    sigma = table[one, other]
    there = np.flatnonzero(sigma)
    return TensionFacets(corners[there], sigma[there], (one * len(table) + other)[there], table)


def young_forces_on_walls(
    facets: TensionFacets, mesh: Mesh, wall: Array, boundary: Boundary, energies: Sequence[Array]
) -> Array:
    """Forces (N, 3) of the wetting of walls at contacts, 0 elsewhere; with the other sign [N].

    They are the derivatives of sum_f gamma_f A_f over the faces f of walls, by the places of contacts, which are
    particles of facets on walls; see `tipfem.physics.surface_tension.edges.young_forces`.
    """
    result = np.zeros_like(mesh.position)
    if not any(energy.any() for energy in energies):
        return result
    contact = np.zeros(len(result), dtype=bool)
    contact[facets.corners] = True
    contact &= wall
    corners, cell = wall_faces(mesh)
    fluid = np.asarray(mesh.fluid)[cell]
    there = contact[corners].any(axis=1)
    corners, fluid = corners[there], fluid[there]
    gamma = wetting(corners.T, len(result), boundary, energies)
    gamma = (gamma - gamma[:, -1:])[np.arange(len(fluid)), fluid]  # over that of a dry wall
    result = area_gradient(mesh.position, corners, gamma)
    result[~contact] = 0.0
    return result
