"""Account of the energy and the momentum of each fluid that each kind of repair adds in a step's remeshing."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tipfem.backend.arrays import partials
from tipfem.backend.launch import launch
from tipfem.case.case import Case
from tipfem.case.particles import Particles
from tipfem.fem.mass import lumped_part
from tipfem.mesh.mesh import Mesh, simplex_measure
from tipfem.physics.state import InterpolatedMaterial, Material, Solved
from tipfem.remesh.energy_kernels import cell_sums
from tipfem.remesh.triangles.edge_operations import ACCELERATION, VELOCITY
from tipfem.remesh.triangles.triangulation import Triangulation
from tipfem.timers import timer
from tipfem.typing import Array

# Kinds of repair in their order, by what remeshes; docs/theory/energy-of-remeshing.md says what each is.
SHARP = ("areas", "flips", "contacts", "films", "slivers", "collapses", "splits", "volumes", "walls", "balance")
CAVITIES = (
    *("areas", "landing", "swaps", "collapses", "splits", "cures", "smoothing", "films", "wetting"),
    *("volumes", "momentum", "walls"),
)
INTERPOLATED = ("areas", "triangulation", "volumes", "transfer", "walls")
AXES = "xyz"


class NoAccount:
    """A `RepairAccount` of nothing, with no ``columns`` of `row`."""

    columns: tuple[str, ...] = ()

    def start(self, solved: Solved) -> None:
        """See `RepairAccount.start`."""

    def add(self, kind: str, particles: Particles, mesh: Mesh, material: Material) -> None:
        """See `RepairAccount.add`."""

    def add_mesh(self, kind: str, mesh: Mesh, velocity: Array) -> None:
        """See `RepairAccount.add_mesh`."""

    def observe(self, t: Triangulation) -> None:
        """See `RepairAccount.observe`."""

    def flies(self, particles: Particles, loose: Array, volume: Array) -> None:
        """See `RepairAccount.flies`."""

    def row(self) -> dict[str, float]:
        """See `RepairAccount.row`."""
        return {}


class RepairAccount(NoAccount):
    """Sums of energy and momentum before and after each repair of a step: a diagnostic, on which no step depends.

    What all kinds add is what remeshing adds in the `tipfem.step.budget.Budget` of the step, to round-off; but for two
    liquids that slide along each other, whose slip the budget counts and these sums do not. `row` has ``columns``.
    """

    def __init__(self, case: Case, kinds: Sequence[str]) -> None:
        self._gravity, self._mass = case.potential_gravity, case.numerics.mass
        self._density, self._d = np.array([f.density for f in case.fluids]), len(self._gravity)
        self._number = {kind: number for number, kind in enumerate(kinds)}
        self._quantities = ("kinetic_energy", "potential_energy", *(f"momentum_{axis}" for axis in AXES[: self._d]))
        self.columns = tuple(
            f"remeshing_{kind}_{quantity}_{f.name}"
            for kind in kinds
            for f in case.fluids
            for quantity in self._quantities
        )
        self._added = np.zeros((len(kinds), len(case.fluids), len(self._quantities)))
        self._last = self._spray = np.zeros(self._added.shape[1:])

    @timer("repair account")
    def start(self, solved: Solved) -> None:
        """Begin with a solved step, whose cells have the masses it was solved with.

        ``areas`` is then what it adds that these become their areas at the new positions, times density.
        """
        state = solved.before
        self._added[:] = 0.0
        self.flies(solved.particles, state.mesh.surface.loose, state.mesh.surface.volume)
        self._last = self._of_state(solved.particles, state.mesh, state.material, state.mesh.measure)
        self._add("areas", self._of_state(solved.particles, state.mesh, state.material, solved.mesh.measure))

    @timer("repair account")
    def add(self, kind: str, particles: Particles, mesh: Mesh, material: Material) -> None:
        """Add to a kind what has changed since the last call, up to a mesh and its material."""
        self._add(kind, self._of_state(particles, mesh, material, mesh.measure))

    def flies(self, particles: Particles, loose: Array, volume: Array) -> None:
        """Count the ``loose`` particles, a mask (N,), with volumes (N,) [m^d], to meshes that do not have them."""
        self._spray = self._of_spray(particles, loose, volume)

    def observe(self, t: Triangulation) -> None:
        """Observe the repairs of a triangulation."""
        t.observer = self._add_triangulation

    @timer("repair account")
    def add_mesh(self, kind: str, mesh: Mesh, velocity: Array) -> None:
        """The same up to a mesh whose cells have fluids, with velocities (N, d) of its particles."""
        assert mesh.fluid is not None
        self._add(kind, self._of_cells(mesh.position, velocity, mesh.cells, mesh.fluid, mesh.measure))

    def row(self) -> dict[str, float]:
        """Columns of the history: what each kind has added in the last remeshing [J; N s; in 2-D per metre]."""
        return dict(zip(self.columns, self._added.ravel().tolist(), strict=True))

    @timer("repair account")
    def _add_triangulation(self, kind: str, t: Triangulation) -> None:
        """Add to a kind what has changed since the last call, up to a triangulation."""
        there = np.flatnonzero(t.fluid >= 0)
        cells, fluid = t.cells.take(there, axis=0), t.fluid.take(there)
        position, velocity = np.ascontiguousarray(t.state[:, :VELOCITY]), t.state[:, VELOCITY:ACCELERATION]
        self._add(kind, self._of_cells(position, velocity, cells, fluid, simplex_measure(position, cells, t.period)))

    def _add(self, kind: str, now: Array) -> None:
        self._added[self._number[kind]] += now - self._last
        self._last = now

    def _of_cells(self, position: Array, velocity: Array, cells: Array, fluid: Array, measure: Array) -> Array:
        """Sums (F, 2 + d), as of `cell_sums`, of cells of one fluid, not empty space, and of particles in none."""
        there = np.flatnonzero(fluid < len(self._density))
        cells, fluid, measure = cells[there], fluid[there], measure[there]
        mass = np.zeros((len(cells), len(self._density)))
        mass[np.arange(len(cells)), fluid] = self._density[fluid] * measure
        return self._spray + self._sums(position, velocity, cells, mass)

    def _of_spray(self, particles: Particles, flies: Array, volume: Array) -> Array:
        """The same of the particles in no cell."""
        loose, sums = np.flatnonzero(flies), np.zeros(self._last.shape)
        fluid = particles.fluid[loose]
        m, v = self._density[fluid] * volume[loose], particles.velocity[loose]
        own = np.column_stack([0.5 * (v**2).sum(axis=1), -particles.position[loose] @ self._gravity, v])
        np.add.at(sums, fluid, m[:, None] * own)
        return sums

    def _of_state(self, particles: Particles, mesh: Mesh, material: Material, measure: Array) -> Array:
        """The same of cells of ``measure`` (M,) with their material, and of the particles in none."""
        part = material.fraction
        if isinstance(material, InterpolatedMaterial):  # the density of a cell is the mean of its particles'
            at_corner = particles.fluid[mesh.cells]
            part = np.stack([(at_corner == f).mean(axis=1) for f in range(len(self._density))], axis=1)
        mass = part * self._density * measure[:, None]
        sums = self._sums(particles.position, particles.velocity, mesh.cells, mass)
        return np.asarray(sums + self._of_spray(particles, mesh.surface.loose, mesh.surface.volume))

    def _sums(self, position: Array, velocity: Array, cells: Array, mass: Array) -> Array:
        sums, lumping = np.zeros(self._last.size), lumped_part(self._mass, cells, mass, len(position))
        launch(
            cell_sums,
            *map(np.ascontiguousarray, (position, velocity, cells, mass, lumping)),
            self._gravity,
            partials(len(sums)),
            sums,
            self._d,
        )
        return np.asarray(sums.reshape(self._last.shape))
