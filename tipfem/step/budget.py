"""Budgets of energy, momentum and volume of a step.

The momentum equation of the step, tested with its displacements u, and the continuity equation, tested with its
pressures, give the energy balance (derived in docs/theory/energy.md):

    dKE + dPE + dE + viscous + friction + (time + geometry + stabilisation + source + Newton + remeshing)
        - external = residual

E is the energy that parts of the state have by the places of the particles, as surfaces with tension do.
What has unknowns of its own, as what floats, has a `Balance` that is included: its energy and what it
dissipates on the left, work from outside in the external work.

Every term is computed from its own definition, that of Newton from the equations' residual; what is left is round-off.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from tipfem.backend.arrays import partials
from tipfem.backend.launch import launch
from tipfem.case.case import Case
from tipfem.fem import mass as mass_kernels
from tipfem.fem import work as work_kernels
from tipfem.mesh.free_surface import spray_volumes
from tipfem.physics.physics import Balance, Entered
from tipfem.physics.registry import physics_of
from tipfem.physics.state import Solved, State
from tipfem.remesh.cavity.cavities import measures
from tipfem.remesh.volumes import areas
from tipfem.step.roughness import roughness
from tipfem.timers import timer
from tipfem.typing import Array

AXES = "xyz"


@dataclass(frozen=True)
class Totals:
    """Totals over all particles."""

    kinetic: float  # v^T M v / 2 with the mass matrix M [J, per metre of depth in 2-D, as all that follows]
    potential: float  # -sum m x . gravity [J].
    momentum: Array  # (d,) sum m v [N s]
    volume: Array  # (F,) of each fluid [m^3]
    # energies of parts of the state by the names of their physics, see `tipfem.physics.carried.Carried.energy` [J]
    stored: Mapping[str, float] = field(default_factory=dict)

    @property
    def energy(self) -> float:
        """Kinetic, potential and stored energy [J]."""
        return self.kinetic + self.potential + sum(self.stored.values())

    @staticmethod
    def of(state: State, gravity: Array, kind: str = "lumped") -> Totals:
        """Totals of a state, with ``gravity`` (d,) [m/s^2] and a kind of mass matrix, see `tipfem.Numerics`."""
        d, mass, particles = len(gravity), state.mass, state.particles
        sums = np.zeros(1 + 2 * d)
        launch(
            work_kernels.state_sums,
            mass,
            particles.position,
            particles.velocity,
            partials(len(sums)),
            sums,
            d,
            work=(len(mass), work_kernels.SUM),
        )
        sums[0] -= deviations(state, kind, [(particles.velocity, particles.velocity)])[0]
        v = particles.velocity
        for part in state.own_inertia:
            sums[0] += part.products(v, v, [lumping_of(state, kind)[part.cell]])[0]
            sums[1 + d :] += part.total(v)
        return Totals.summed(sums, gravity, state.volume, state.energies(particles.position))

    @staticmethod
    def summed(sums: Array, gravity: Array, volume: Array, stored: Mapping[str, float]) -> Totals:
        """From v^T M v, sum m x and sum m v (1 + 2 d,), the volumes (F,) of the fluids, and stored energies."""
        d = len(gravity)
        return Totals(0.5 * float(sums[0]), -float((sums[1 : 1 + d] * gravity).sum()), sums[1 + d :], volume, stored)


def lumping_of(state: State, kind: str) -> Array:
    """Part (M,) of the cells' mass matrix that is lumped, for a kind of it."""
    return mass_kernels.lumped_part(kind, state.mesh.cells, state.material.fraction, len(state.mesh.position))


def deviations(state: State, kind: str, fields: Sequence[tuple[Array, Array]]) -> Array:
    """sum_i m_i a_i . b_i - a^T M b for pairs of fields a and b (N, d), and the mass matrix M of a state's elements.

    Args:
        state: on whose mesh.
        kind: of the mass matrix, see `tipfem.Numerics`.
        fields: the pairs.
    """
    results = np.zeros((len(fields), 1))
    if kind == "lumped":
        return results[:, 0]
    mesh, material = state.mesh, state.material
    cells, lumping = np.ascontiguousarray(mesh.cells), lumping_of(state, kind)
    for result, (a, b) in zip(results, fields, strict=True):
        launch(
            mass_kernels.deviation,
            cells,
            np.ascontiguousarray(mesh.position),
            mesh.period.array,
            mass_kernels.Masses(material.density, mesh.measure, lumping),
            np.ascontiguousarray(a),
            np.ascontiguousarray(b),
            partials(1),
            result,
            mesh.dimension,
            work=(len(cells), mass_kernels.ELEMENT),
        )
    return results[:, 0]


@dataclass(frozen=True)
class SolveBalance:
    """Balance of a solved step before remeshing; all energies per step, losses positive [J]."""

    after: Totals  # totals at the end of the step, with the masses it was solved with
    viscous: float  # viscous dissipation, dt int 2 mu d : d
    friction: float  # dissipation by friction along walls that slip
    # of the time integration: work of inertia less the change of kinetic energy, work against the viscous stress and
    # against friction with u less that with dt v_alpha, and that of what is moved with dt v_alpha less that with u
    time: float
    geometry: float  # work of pressure on volume that changes between the intermediate and the last positions
    stabilisation: float  # of the stabilisation of pressure
    source: float  # of the volume source; a gain or a loss
    newton: float  # of what Newton's method has left, a gain or a loss
    external: float  # work of the body force (gravity excepted), the walls and openings; positive when energy is gained
    wall_force: Array  # (d,) of the walls on the fluids, at the intermediate time [N]
    # (d,) change of sum m (v + (1/2 - alpha_f) dt a) less the impulse of all forces [N s]; wall particles, whose state
    # is prescribed, contribute dt a_alpha
    momentum_residual: Array
    source_volume: Array  # (F,) volume that the volume source added [m^3]
    # of forces with a potential, by the names of their physics: their work less the change of the energy
    stored: Mapping[str, float] = field(default_factory=dict)
    own: Sequence[Balance] = ()  # balances of what has unknowns of its own
    openings: float = 0.0  # the part of ``external`` that is done at openings
    # (d,) on the fluids there, at the intermediate time [N]
    opening_force: Array = field(default_factory=lambda: np.zeros(3))


class Budget:
    """Accounts for the steps of a simulation: a diagnostic, on which no step depends.

    Attributes:
        columns: names of the columns of `account`.
    """

    def __init__(self, case: Case) -> None:
        self._names = [f.name for f in case.fluids]
        self._gravity = case.potential_gravity
        # Of an axisymmetric flow forces and momenta along r are not those of a body.
        self._axes = ("", "z") if case.period.axial else AXES
        self._kind = case.numerics.mass
        self._physics = physics_of(case)
        self._stored = {physics.name: physics.stored_columns for physics in self._physics if physics.stored_columns}
        zeros, none = np.zeros(len(self._gravity)), np.zeros(len(self._names))
        own = [name for physics in self._physics for name in physics.balance_columns]
        nothing = Totals(0.0, 0.0, zeros, none)
        balance = SolveBalance(nothing, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, zeros, zeros, none, opening_force=zeros)
        self._spray = case.free_surface
        self._meshed = case.interface == "sharp" and case.particles.dimension == 2
        rough = self._roughness_columns(none.tolist(), 0.0) if self._meshed else {}
        self._open = any(physics.open for physics in self._physics)
        self.columns = (*self._row(nothing, balance, {}, nothing, none, {}), *own, *rough)
        self._last: tuple[State, Totals] | None = None

    def totals(self, state: State) -> Totals:
        """Totals of a state; those of the last one are kept."""
        if self._last is None or self._last[0] is not state:
            self._last = state, Totals.of(state, self._gravity, self._kind)
        return self._last[1]

    @timer("budget")
    def account(self, solved: Solved, state: State) -> dict[str, float]:
        """Columns of the history for a step: energies [J], momenta [N s], forces [N], volumes [m^3].

        All per metre of depth in 2-D. What remeshing adds includes relocation and the transfer of momentum. With the
        sharp interface also `tipfem.step.roughness.roughness` of the next state.
        """
        before = self.totals(solved.before)
        spray = spray_volumes(state.mesh, state.particles.fluid, len(self._names))
        entered = {
            physics.name: each
            for physics in self._physics
            if (each := physics.entered(state.parts.get(physics.name))) is not None
        }
        lost = {name: part.lost for name, part in state.parts.items()}
        row = self._row(before, self._balance(solved, before), entered, self.totals(state), spray, lost)
        return row | self._roughness_columns(*roughness(state, len(self._names))) if self._meshed else row

    def _roughness_columns(self, parts: list[float], turning: float) -> dict[str, float]:
        names = [f"roughness_{name}" for name in self._names]
        return {**dict(zip(names, parts, strict=True)), "interface_turning": turning}

    def _balance(self, solved: Solved, before: Totals) -> SolveBalance:
        """The balance of a solve from a state with the totals ``before``."""
        start, end, scheme, work = solved.before, solved.particles, solved.scheme, solved.work
        old, mass = start.particles, start.mass
        # dt a_alpha is the change of v + (1/2 - alpha_f) dt a, except at walls, where the state is prescribed.
        shift = (0.5 - scheme.alpha_f) * scheme.dt
        d = old.dimension
        sums = np.zeros(3 + 4 * d)
        launch(
            work_kernels.step_sums,
            mass,
            work_kernels.Start(old.wall.view(np.int8), old.velocity, old.acceleration),
            work_kernels.End(end.position, end.velocity, end.acceleration, solved.displacement),
            work_kernels.Loads(solved.inertia, solved.force, self._gravity),
            partials(len(sums)),
            sums,
            shift,
            scheme.dt,
            d,
            work=(len(mass), work_kernels.SUM),
        )
        u = solved.displacement
        if self._kind != "lumped":
            fields = [(solved.acceleration, u), (solved.force - self._gravity, u), (end.velocity, end.velocity)]
            sums[[0, 1, 2 + 2 * d]] -= deviations(start, self._kind, fields)
        sums[0] += work.inertia
        sums[2 : 2 + d] += scheme.dt * work.force
        for part in start.own_inertia:
            lumping = lumping_of(start, self._kind)[part.cell]
            sums[1] += part.work(solved.force - self._gravity, u, lumping)
            sums[2 + 2 * d] += part.products(end.velocity, end.velocity, [lumping])[0]
            sums[3 + 2 * d : 3 + 3 * d] += part.total(u)
            sums[3 + 3 * d :] += part.total(end.velocity)
        count = len(self._names)
        measure = (
            areas(end.position, start.mesh, "budget.areas") if d == 2 else measures(end.position, start.mesh.cells)
        )
        volume = start.material.volumes(measure) + spray_volumes(start.mesh, old.fluid, count)
        after = Totals.summed(sums[2 + 2 * d :], self._gravity, volume, start.energies(end.position))
        inertia, external, change, weight = float(sums[0]), float(sums[1]), sums[2 : 2 + d], sums[2 + d : 2 + 2 * d]
        growth = solved.growth
        rest = work.viscous - work.viscous_dissipation + work.friction - work.friction_dissipation
        return SolveBalance(
            after=after,
            viscous=work.viscous_dissipation,
            friction=work.friction_dissipation,
            time=inertia - (after.kinetic - before.kinetic) + rest + work.lag,
            geometry=-work.geometry,
            stabilisation=work.stabilisation,
            source=-work.source,
            newton=-work.left,
            external=external + work.walls + work.friction + work.passing + work.lag,
            openings=work.passing,
            opening_force=np.zeros(d) + work.passing_force,
            wall_force=np.asarray(work.wall_force),
            momentum_residual=change - scheme.dt * (weight + work.wall_force + work.passing_force),
            source_volume=start.material.volumes(growth * start.mesh.measure) if growth.any() else np.zeros(count),
            stored={
                name: self._work_of(name, solved) - (after.stored[name] - was) for name, was in before.stored.items()
            },
            own=self._own(solved),
        )

    @staticmethod
    def _work_of(name: str, solved: Solved) -> float:
        """Work of a physics' terms against forces that have a potential [J]."""
        return sum(work for of, work in zip(solved.acting, solved.work.stored_by[1:], strict=True) if of == name)

    def _own(self, solved: Solved) -> list[Balance]:
        """The balances of what has unknowns of its own."""
        result = []
        for physics in self._physics:
            old, new = (parts.get(physics.name) for parts in (solved.before.parts, solved.parts))
            balance = physics.balance(old, new, solved.scheme, solved.force)
            result += [] if balance is None else [balance]
        return result

    def _row(
        self,
        before: Totals,
        step: SolveBalance,
        by_physics: Mapping[str, Entered],
        now: Totals,
        spray: Array,
        lost: Mapping[str, float],
    ) -> dict[str, float]:
        """Columns of the history: from totals before and after, the solve's balance, what entered and what was lost."""
        volume, momentum = np.zeros(len(self._names)), np.zeros(len(self._gravity))
        entered = Entered(
            sum((each.volume for each in by_physics.values()), volume),
            sum(each.energy for each in by_physics.values()),
            sum((each.momentum for each in by_physics.values()), momentum),
        )
        remeshing = step.after.energy + entered.energy - now.energy
        time = step.time + sum(own.numerical for own in step.own)
        solve = step.geometry + step.stabilisation + step.source + step.newton
        numerical = time + sum(step.stored.values()) + solve + remeshing
        external = step.external + sum(own.external for own in step.own)
        change = now.energy - before.energy + sum(own.change for own in step.own)
        dissipated = step.viscous + step.friction + sum(own.dissipated for own in step.own)
        row = {
            "kinetic_energy": now.kinetic,
            "potential_energy": now.potential,
            "viscous_dissipation": step.viscous,
            "friction_dissipation": step.friction,
            "numerical_dissipation": numerical,
            "time_dissipation": time,
            "geometry_dissipation": step.geometry,
            "stabilisation_dissipation": step.stabilisation,
            "source_dissipation": step.source,
            "newton_dissipation": step.newton,
            "remeshing_dissipation": remeshing,
            "remeshing_potential_energy": now.potential - step.after.potential,
            "external_work": external,
            "energy_residual": change + dissipated + numerical - external - entered.energy,
        }
        for name, names in self._stored.items():
            energies = [totals.stored.get(name, 0.0) for totals in (now, step.after)]
            if name in by_physics:
                energies[1] += by_physics[name].energy
            values = energies[0], energies[0] - energies[1], step.stored.get(name, 0.0), lost.get(name, 0.0)
            row.update(zip(names, values, strict=False))
        if self._open:
            row["opening_work"], row["opening_energy"] = step.openings, entered.energy
        for own in step.own:
            row.update(own.columns)
        for name, vector in (
            ("momentum", now.momentum),
            ("wall_force", step.wall_force),
            ("remeshing_momentum", now.momentum - step.after.momentum - entered.momentum),
            ("momentum_residual", step.momentum_residual),
            *([("opening_force", step.opening_force), ("opening_momentum", entered.momentum)] if self._open else []),
        ):
            row.update({f"{name}_{axis}": float(v) for axis, v in zip(self._axes, vector, strict=False) if axis})
        for name, volumes in (
            ("volume", now.volume),
            ("solve_volume", step.after.volume - before.volume),
            ("source_volume", step.source_volume),
            ("remeshing_volume", now.volume - step.after.volume - entered.volume),
            *([("opening_volume", entered.volume)] if self._open else []),
            *([("spray_volume", spray)] if self._spray else []),
        ):
            row.update({f"{name}_{fluid}": float(v) for fluid, v in zip(self._names, volumes, strict=True)})
        return row
