"""SurfaceTension: surface tension of a case, in steps and through remeshing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from tipfem.case.boundary.boundary import Boundary
from tipfem.case.case import Case
from tipfem.case.particles import Particles
from tipfem.case.surface_tension import wall_energies
from tipfem.mesh.mesh import Mesh
from tipfem.mesh.relabelled import FILM, SideEnergies
from tipfem.physics.carried import Remap
from tipfem.physics.physics import Entered, Moved, Physics, StepStart
from tipfem.physics.surface_tension.edges import TensionEdges, find_edges, wetting, young_forces
from tipfem.physics.surface_tension.facet_term import FacetTensionTerm
from tipfem.physics.surface_tension.facets import TensionFacets, find_facets, young_forces_on_walls
from tipfem.physics.surface_tension.tension import Tension
from tipfem.physics.surface_tension.term import SurfaceTensionTerm
from tipfem.typing import Array

# Distance over which a contact that a wall holds can be drawn before it slides, in spacings.
STRETCH = 0.05
AREA = FILM.index("area")


def find_tension(mesh: Mesh, particles: Particles, table: Array) -> TensionEdges | TensionFacets:
    """Edges or facets of a mesh with a tension ``table`` (F + 1, F + 1) [N/m]; see `find_edges` and `find_facets`."""
    return find_facets(mesh, table) if mesh.dimension == 3 else find_edges(mesh, particles, table)


class SurfaceTension(Physics[Tension | None]):
    """See the module; the edges or facets are found anew on each mesh, with the tension that they had before.

    Args:
        table: (F + 1, F + 1) at the start, see `Tension` [N/m].
        cosines: of the contact angles on each wall, see `tipfem.case.surface_tension.TensionTable.cosines`.
    """

    name = "surface_tension"
    columns: tuple[str, ...] = ("broken_films", "broken_film_volume")
    stored_columns = ("surface_energy", "remeshing_surface_energy", "tension_dissipation", "breakup_energy")

    def __init__(
        self, table: Array, cosines: Sequence[Mapping[tuple[int, int], tuple[float, float]]] = (), spacing: float = 0.0
    ) -> None:
        self._table, self._cosines, self._stretch = table, cosines, STRETCH * spacing
        self._holds = any(half > 0 for wall in cosines for _, half in wall.values())

    @classmethod
    def of(cls, case: Case) -> SurfaceTension | None:
        """See `Physics.of`."""
        if not case.surface_tension:
            return None
        result = cls(case.surface_tension.sigma, case.contact_cosines, case.particles.spacing)
        if case.particles.dimension == 3:
            result.columns = ()  # films are not told there
        return result

    def terms(self, part: Tension | None, step: StepStart) -> tuple[SurfaceTensionTerm, ...]:
        """See `Physics.terms`."""
        if part is None:
            return ()
        if isinstance(part, TensionFacets):
            energies = [wall_energies(each, part.table) for each in self._cosines]
            pull = young_forces_on_walls(part, step.mesh, step.particles.wall, step.boundary, energies)
            return (FacetTensionTerm(part, pull, step.walls.sliding, step.walls.rows),)
        assert isinstance(part, TensionEdges)
        young, holding = (
            young_forces(part, step.mesh, step.particles, step.boundary, energies)
            for energies in ([wall_energies(each, part.table, "", k) for each in self._cosines] for k in range(2))
        )
        return (SurfaceTensionTerm(part, young, holding if self._holds else None, self._stretch, step.leaving),)

    def sides(self, part: Tension | None, count: int, boundary: Boundary) -> SideEnergies | None:
        """See `Physics.sides`."""
        if part is None:
            return None
        energies = [wall_energies(cosines, part.table) for cosines in self._cosines]
        none = [np.zeros(len(part.table))] if not energies else energies
        return SideEnergies(part.table, lambda *ends: wetting(ends, count, boundary, none))

    def before_repair(self, part: Tension | None, moved: Moved) -> tuple[Tension | None, Moved]:
        """See `Physics.before_repair`: the edges that are left of what has entered and left."""
        if part is None or moved.through is None:
            return part, moved
        solved, put_back = moved.through
        edges = find_tension(moved.mesh, moved.particles, part.table)
        entered = edges.energy(put_back) - part.energy(solved)
        return replace(edges, strain=part.strain, entered=entered), moved

    def entered(self, part: Tension | None) -> Entered | None:
        """See `Physics.entered`."""
        if part is None:
            return None
        return Entered(np.zeros(len(part.table) - 1), part.entered, np.zeros(part.dimension))

    def remeshed(self, part: Tension | None, particles: Particles, remap: Remap) -> tuple[Tension, Particles]:
        """See `Physics.remeshed`."""
        table, sides = self._table if part is None else part.table, remap.relabelled
        edges = find_tension(remap.mesh, particles, table)
        edges = replace(edges, entered=0.0 if part is None else part.entered)
        if sides is not None:
            there = [(pair[:, 0] != pair[:, 1]).astype(float) for pair in (sides.before, sides.now)]
            energy = table[tuple(sides.before.T)] - table[tuple(sides.now.T)]
            sums = (
                np.bincount(sides.patch, sides.length * each, len(sides.area)) for each in (there[0] - there[1], energy)
            )
            films = np.column_stack([sides.middle, sides.fluid, sides.area, *sums])
            edges = replace(edges, films=films)
        if self._holds:
            strain = np.zeros((len(particles), edges.dimension))
            if part is not None and part.strain is not None:
                number = np.arange(len(part.strain)) if remap.renumbered is None else remap.renumbered
                strain[number[number >= 0]] = part.strain[number >= 0]
                strain[remap.relocated] = 0.0
            edges = replace(edges, strain=strain)
        return edges, particles

    def row(self, part: Tension | None, particles: Particles) -> dict[str, float]:
        """See `Physics.row`: how many films have broken or merged in the step, and the area of their cells [m^2]."""
        if part is None or not self.columns:
            return {}
        return {"broken_films": len(part.films), "broken_film_volume": float(part.films[:, AREA].sum())}
