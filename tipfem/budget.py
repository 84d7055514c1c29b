"""Budgets of energy, momentum and volume: where each of them goes in a step.

The momentum equation of the step, tested with its displacements u, and the continuity equation, tested with its
pressures, say what became of the energy (docs/energy.md derives it):

    dKE + dPE + viscous + (time + geometry + stabilisation + source + remeshing) - external = residual

Every term is computed from its own definition; the residual is what Newton's method left.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tipfem.case import Case
from tipfem.flow import FlowProblem
from tipfem.free_surface import loose_volumes
from tipfem.mesh import Mesh
from tipfem.particles import Array, Particles
from tipfem.probes import nodal_mass

AXES = "xyz"


# By einsum, which no threads share: a sum by BLAS would depend on their number, and wait for them.


def summed(weight: Array, values: Array) -> Array:
    """Sum over K of weights (K,) times values (K, n): (n,)."""
    return np.einsum("k,kn->n", weight, values)


def product(weight: Array, one: Array, other: Array) -> float:
    """Sum over K of weights (K,) times the inner products of vectors (K, d)."""
    return float(np.einsum("k,kd,kd->", weight, one, other))


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
        v, place = particles.velocity, summed(mass, particles.position)
        return Totals(mass, 0.5 * product(mass, v, v), -float((place * gravity).sum()), summed(mass, v), volume)


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
        self._fraction = np.zeros((0, len(self._names)))
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
        mass, work, u = before.mass, problem.work(solution), displacement
        volume = summed(mesh.carried(moved.position).measure, self._fraction) + self._loose
        after = Totals.of(mass, moved, self._gravity, volume)
        inertia = problem.acceleration(u) + force
        # dt a_alpha is the change of v + (1/2 - alpha_f) dt a, but at walls, where the state is prescribed.
        old, shift = problem.particles, (0.5 - scheme.alpha_f) * scheme.dt
        change = moved.velocity - old.velocity + shift * (moved.acceleration - old.acceleration)
        change = np.where(old.wall[:, None], scheme.dt * inertia, change)
        self._step = SolveBalance(
            after=after,
            viscous=work.viscous_dissipation,
            time=product(mass, inertia, u) - (after.kinetic - before.kinetic) + work.viscous - work.viscous_dissipation,
            geometry=-work.geometry,
            stabilisation=work.stabilisation,
            source=-work.source,
            external=product(mass, force - self._gravity, u) + work.walls,
            wall_force=work.wall_force,
            momentum_residual=summed(mass, change) - scheme.dt * (summed(mass, force) + work.wall_force),
            source_volume=summed(problem.properties.source * mesh.measure, self._fraction),
        )

    def remeshed(self, mesh: Mesh, particles: Particles, density: Array, fraction: Array) -> None:
        """Take note of the state on a new mesh: M elements' densities (M,) and parts of the fluids (M, F).

        Loose particles, in no element, count with the volumes that they carry.
        """
        mass = nodal_mass(mesh, density)
        self._loose = loose_volumes(mesh, particles.fluid, len(self._names))
        if mesh.surface is not None:
            mass = mass + self._density[particles.fluid] * mesh.surface.volume
        now = Totals.of(mass, particles, self._gravity, summed(mesh.measure, fraction) + self._loose)
        self._before, self._present, self._fraction = self._present, now, fraction

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

