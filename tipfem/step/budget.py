"""Budgets of energy, momentum and volume: where each of them goes in a step.

The momentum equation of the step, tested with its displacements u, and the continuity equation, tested with its
pressures, say what became of the energy (docs/theory/energy.md derives it):

    dKE + dPE + viscous + (time + geometry + stabilisation + source + remeshing) - external = residual

Every term is computed from its own definition; the residual is what Newton's method left.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tipfem.backend.arrays import partials
from tipfem.backend.launch import launch
from tipfem.case.case import Case
from tipfem.case.particles import Particles
from tipfem.fem import work as balance_kernels
from tipfem.mesh.free_surface import loose_volumes
from tipfem.mesh.mesh import Mesh
from tipfem.step.flow import FlowProblem
from tipfem.typing import Array

AXES = "xyz"
NO_FLUID = np.zeros(1, dtype=np.int32)


SUM = 5.0  # nanoseconds that a thread takes for the sums of a particle, or the area of a triangle


def lumped(mesh: Mesh, density: Array) -> Array:
    """Lumped mass (N,) [kg] from the elements' densities (M,)."""
    mass = np.zeros(len(mesh.position))
    launch(
        balance_kernels.lump,
        np.ascontiguousarray(mesh.cells),
        mesh.measure,
        density,
        mass,
        len(mesh.cells),
        mesh.dimension,
    )
    return mass


@dataclass(frozen=True)
class Totals:
    """What all particles together have.

    Attributes:
        mass: (N,) lumped mass of each particle [kg, per metre of depth in 2-D, as all that follows].
        kinetic: sum m v^2 / 2 [J].
        potential: -sum m x . gravity [J].
        momentum: (d,) sum m v [N s].
        volume: (F,) of each fluid [m^3].
    """

    mass: Array
    kinetic: float
    potential: float
    momentum: Array
    volume: Array

    @property
    def energy(self) -> float:
        """Kinetic and potential energy [J]."""
        return self.kinetic + self.potential

    @staticmethod
    def of(mass: Array, particles: Particles, gravity: Array, volume: Array) -> Totals:
        """Sums over the particles with masses (N,) and volumes of the fluids (F,)."""
        d = particles.dimension
        sums = np.zeros(1 + 2 * d)
        launch(
            balance_kernels.state_sums,
            mass,
            particles.position,
            particles.velocity,
            partials(len(sums)),
            sums,
            len(mass),
            d,
            work=(len(mass), SUM),
        )
        return Totals.summed(mass, sums, gravity, volume)

    @staticmethod
    def summed(mass: Array, sums: Array, gravity: Array, volume: Array) -> Totals:
        """From the sums (1 + 2 d,) of `work.state_sums`."""
        d = len(gravity)
        return Totals(mass, 0.5 * float(sums[0]), -float((sums[1 : 1 + d] * gravity).sum()), sums[1 + d :], volume)


@dataclass(frozen=True)
class SolveBalance:
    """A solved step before the particles are meshed anew; all energies per step, losses positive [J].

    Attributes:
        after: totals at the end of the step, with the masses it was solved with.
        viscous: viscous dissipation, dt int 2 mu d : d.
        time: of the time integration: work of inertia less the change of kinetic energy, and work against the
            viscous stress with u less that with dt v_alpha.
        geometry: work of pressure on volume that changes between the intermediate and the last positions.
        stabilisation: of the stabilisation of pressure.
        source: of the volume source; usually a gain or a loss by turns.
        external: work of the body force (gravity excepted) and of the walls; positive when energy is gained.
        wall_force: (d,) of the walls on the fluids, at the intermediate time [N].
        momentum_residual: (d,) change of sum m (v + (1/2 - alpha_f) dt a) that no force accounts for [N s]; wall
            particles, whose state is prescribed, enter with dt a_alpha.
        source_volume: (F,) growth that the volume source prescribed [m^3].
    """

    after: Totals
    viscous: float
    time: float
    geometry: float
    stabilisation: float
    source: float
    external: float
    wall_force: Array
    momentum_residual: Array
    source_volume: Array


class Budget:
    """Keeps account of the steps of a simulation; `row` has the columns of the history.

    Args:
        case: names of the fluids, and gravity.
    """

    def __init__(self, case: Case) -> None:
        self._names = [f.name for f in case.fluids]
        self._density = np.array([f.density for f in case.fluids])
        self._gravity = np.asarray(case.gravity)
        self._loose = np.zeros(len(self._names))
        self._fraction: Array | None = None
        self._before = self._present = Totals(np.zeros(0), 0.0, 0.0, np.zeros(0), np.zeros(0))
        self._step: SolveBalance | None = None

    def solved(
        self, problem: FlowProblem, solution: object, displacement: Array, moved: Particles, force: Array
    ) -> None:
        """Take note of a solved step; a step that is refused later is replaced by the next one.

        Args:
            problem: at ``solution``: that is where its last residual was evaluated.
            solution: device vector of unknowns.
            displacement: (N, d) of it [m].
            moved: the state at the end of the step, on the mesh of its beginning.
            force: (N, d) gravity and body force [m/s^2].
        """
        before, scheme, mesh = self._present, problem.scheme, problem.mesh
        mass, work, u, source = before.mass, problem.work(solution), displacement, problem.properties.source
        # dt a_alpha is the change of v + (1/2 - alpha_f) dt a, but at walls, where the state is prescribed.
        old, shift = problem.particles, (0.5 - scheme.alpha_f) * scheme.dt
        d = mesh.dimension
        sums, carried, here = np.zeros(3 + 4 * d), mesh.moved(moved.position), self._fraction is None
        fluid, measure = (np.asarray(mesh.fluid), np.empty(len(mesh.cells))) if here else (NO_FLUID, carried.measure)
        volume = np.zeros(len(self._names))
        launch(
            balance_kernels.step_sums,
            mass,
            old.wall.view(np.int8),
            old.velocity,
            old.acceleration,
            moved.position,
            moved.velocity,
            moved.acceleration,
            problem.acceleration(u),
            force,
            self._gravity,
            u,
            np.ascontiguousarray(mesh.cells),
            fluid,
            measure,
            volume,
            partials(len(sums)),
            sums,
            shift,
            scheme.dt,
            len(mass),
            len(mesh.cells) if here else 0,
            d,
            work=(len(mass), SUM),
        )
        if here:
            mesh.moved(moved.position, measure)  # kept for what follows in the step
        else:
            volume = self._volumes(mesh, measure)
        after = Totals.summed(mass, sums[2 + 2 * d :], self._gravity, volume + self._loose)
        inertia, external, change, weight = float(sums[0]), float(sums[1]), sums[2 : 2 + d], sums[2 + d : 2 + 2 * d]
        self._step = SolveBalance(
            after=after,
            viscous=work.viscous_dissipation,
            time=inertia - (after.kinetic - before.kinetic) + work.viscous - work.viscous_dissipation,
            geometry=-work.geometry,
            stabilisation=work.stabilisation,
            source=-work.source,
            external=external + work.walls,
            wall_force=work.wall_force,
            momentum_residual=change - scheme.dt * (weight + work.wall_force),
            source_volume=self._volumes(mesh, source * mesh.measure) if source.any() else np.zeros(len(volume)),
        )

    def _volumes(self, mesh: Mesh, measure: Array) -> Array:
        """Volumes (F,) of the fluids when the elements of the present mesh, at any positions, have ``measure`` (M,)."""
        if self._fraction is None:
            return np.bincount(np.asarray(mesh.fluid), weights=measure, minlength=len(self._names))
        # By einsum, which no threads share: a sum by BLAS would depend on their number, and wait for them.
        return np.einsum("k,kn->n", measure, self._fraction)

    def remeshed(self, mesh: Mesh, particles: Particles, mass: Array, fraction: Array | None) -> None:
        """Take note of the state on a new mesh of M elements.

        Args:
            mesh: the mesh.
            particles: the state.
            mass: (N,) lumped masses; loose particles, in no element, count with the volumes that they carry, too.
            fraction: (M, F) parts of the fluids; None where every element is of the one that the mesh knows.
        """
        self._fraction = fraction
        self._loose = loose_volumes(mesh, particles.fluid, len(self._names))
        if mesh.surface is not None:
            mass = mass + self._density[particles.fluid] * mesh.surface.volume
        now = Totals.of(mass, particles, self._gravity, self._volumes(mesh, mesh.measure) + self._loose)
        self._before, self._present = self._present, now

    def totals(self) -> Totals:
        """Of the present state."""
        return self._present

    def row(self) -> dict[str, float]:
        """Columns of the history for the last step: energies [J], momenta [N s], forces [N], volumes [m^3].

        All per metre of depth in 2-D. What remeshing adds includes relocation and the transfer of momentum.

        Raises:
            ValueError: there has been no step.
        """
        before, now, step = self._before, self._present, self._step
        if step is None:
            raise ValueError("Budget: there has been no step to give account of")
        remeshing = step.after.energy - now.energy
        numerical = step.time + step.geometry + step.stabilisation + step.source + remeshing
        row = {
            "kinetic_energy": now.kinetic,
            "potential_energy": now.potential,
            "viscous_dissipation": step.viscous,
            "numerical_dissipation": numerical,
            "time_dissipation": step.time,
            "geometry_dissipation": step.geometry,
            "stabilisation_dissipation": step.stabilisation,
            "source_dissipation": step.source,
            "remeshing_dissipation": remeshing,
            "remeshing_potential_energy": now.potential - step.after.potential,
            "external_work": step.external,
            "energy_residual": now.energy - before.energy + step.viscous + numerical - step.external,
        }
        for name, vector in (
            ("momentum", now.momentum),
            ("wall_force", step.wall_force),
            ("remeshing_momentum", now.momentum - step.after.momentum),
            ("momentum_residual", step.momentum_residual),
        ):
            row.update({f"{name}_{axis}": float(value) for axis, value in zip(AXES, vector, strict=False)})
        for name, volumes in (
            ("volume", now.volume),
            ("solve_volume", step.after.volume - before.volume),
            ("source_volume", step.source_volume),
            ("remeshing_volume", now.volume - step.after.volume),
        ):
            row.update({f"{name}_{fluid}": float(v) for fluid, v in zip(self._names, volumes, strict=True)})
        return row
