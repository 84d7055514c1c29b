"""StepSolver: the nonlinear problem of one time step, posed on a state and solved."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping

import numpy as np

from tipfem.backend import runtime
from tipfem.case.case import Case
from tipfem.case.fluid import law_table, ranks
from tipfem.case.forces import Forces
from tipfem.case.particles import Particles
from tipfem.errors import StepRefused
from tipfem.fem.mass import lumped_part
from tipfem.fem.rheology import cell_fluids, rates_and_viscosities
from tipfem.fem.time_integration import BackwardEuler, GeneralizedAlpha, TimeScheme
from tipfem.linalg.newton import newton
from tipfem.mesh.mesh import Mesh
from tipfem.physics.carried import Carried, kept_where_sliding, sliding
from tipfem.physics.physics import StepStart
from tipfem.physics.registry import physics_of, step_frequency
from tipfem.physics.state import Solved, State, lumped
from tipfem.physics.term import ElementProperties
from tipfem.physics.walls.motion import set_off
from tipfem.scratch import scratch
from tipfem.step.impacts import JUMP, UNCERTAIN, changes, struck_state, without_gain
from tipfem.step.linear_system import Workspace, grid_spacing
from tipfem.step.problem import FlowProblem
from tipfem.timers import timer
from tipfem.typing import Array


def first_not_finite(particles: Particles, when: str, fields: Mapping[str, Array] | None = None) -> str:
    """A text that names the first field and particle whose value is not finite; empty if all are.

    Args:
        when: the end of the text.
        fields: (N,) or (N, d) values by name; by default those of the particles.
    """
    position = particles.position
    if fields is None:
        fields = {name: getattr(particles, name) for name in ("position", "velocity", "acceleration", "pressure")}
    for name, values in fields.items():
        if np.isfinite(values, out=scratch("finite", values.shape, bool)).all():
            continue
        bad = ~np.isfinite(values.reshape(len(values), -1)).all(axis=1)
        i = int(np.argmax(bad))
        return f"{name} of particle {i} at {position[i].tolist()} is {values[i].tolist()} {when}"
    return ""


def _mean(mesh: Mesh, values: Array) -> float:
    """Mean over a mesh's volume of values (N,) at its particles."""
    volume = lumped(mesh, np.ones(len(mesh.cells)))
    return float(volume @ values / volume.sum())


SHORT = 1e-4  # steps that correct initial velocities, over the first step
LAWFUL = 2  # times as many iterations of Newton's method where viscosity follows a law
LEAST_CHANGE = 1e-6  # of the largest initial velocity: a smaller correction is round-off

# Parts of the times of gravity and of the flow in `flow_time`; default steps are longer, 0.1 sqrt(h / b) and 0.5 h / v.
OF_GRAVITY, OF_FLOW = 0.05, 0.35


def flow_time(case: Case, state: State, frequency: float | None = None) -> float:
    """The time T in tau = c dt T of the stabilisation [s]: the length of step that the flow itself asks for.

    It is the shortest of 0.05 sqrt(h / b) with the acceleration b by gravity and body force, of the capillary time
    where interfaces have a tension, and of 0.35 h / v with the speed v of the fastest
    particle relative to the tank. Steps that are shorter, for an output or because others were refused, and steps that
    are longer have the stabilisation of a step of that length: were tau to dt^2, there would be another problem in
    space for each dt, and no convergence in dt.

    `FlowProblem` takes at least half a step and at most 100 for T: outside, linear systems take many more iterations.
    For a T far above the step, the Laplacian of the preconditioner is too stiff for smooth pressures, on which the
    stabilisation does not act.

    Without gravity, body force and tension, T is no longer than the time v / a in which the flow's acceleration a would
    give it that speed. Where the flow's own inertia drives the pressure, a is about v^2 / L, and this is longer than h
    / v. Where walls set a fluid in motion from rest, it is the time since then; where viscosity stops it, the time of
    the decay. h / v alone would have no bound there.

    T is 0, for steps' own lengths, in a flow without forces at rest, and where an interpolated interface divides fluids
    that fill their tank: a stronger stabilisation moves more volume between them.

    Args:
        frequency: that of the case, see `tipfem.physics.registry.step_frequency` [1/s], if it is known already.
    """
    if case.interface == "interpolated" and not case.free_surface:
        return 0.0
    frequency = step_frequency(case) if frequency is None else frequency
    speed = _speed_over_spacing(state, frequency)
    times = [part / rate for part, rate in ((OF_GRAVITY, frequency), (OF_FLOW, speed)) if rate > 0]
    if not frequency and speed and state.mean_acceleration:
        times.append(speed * case.particles.spacing / state.mean_acceleration)
    return min(times, default=0.0)


def _speed_over_spacing(state: State, frequency: float) -> float:
    """Speed of the fastest particle relative to the tank, in its target spacings [1/s]."""
    return state.speed_over_spacing(1e-3 / max(frequency, 1e-3))


def steps_between_repairs(state: State, dt: float, frequency: float) -> int:
    """After how many steps the cells are repaired: 1, or if steps are short, the largest power of two in a time.

    This time is the shortest of 0.05 sqrt(h / b), the capillary time and 0.35 h / v, see `flow_time`. Each flip of an
    edge changes the discrete equations, by a part to h^2 and not to dt. Were cells repaired after each short step, a
    flip would be made when the first of them ends in which it is due, up to dt late, and solutions would be of first
    order in dt. In steps of half the length, the cells are repaired at the same times.

    Args:
        frequency: that of the case, see `tipfem.physics.registry.step_frequency` [1/s].
    """
    longest = OF_GRAVITY / frequency if frequency > 0 else math.inf
    if longest < 1.99 * dt:
        return 1
    speed = _speed_over_spacing(state, frequency)
    longest = min(longest, OF_FLOW / speed) if speed > 0 else longest
    return 2 ** max(0, math.floor(math.log2((1 + 1e-9) * longest / dt))) if math.isfinite(longest) else 1


class StepSolver:
    """Solves the time steps of a case.

    Args:
        case: fluids, forces and numerics.
        reach: largest displacement of a particle in a step [target spacings].

    Attributes:
        workspace: device arrays and the multigrid's hierarchy, which steps share.
        forces: what accelerates the fluids, by default the case's gravity and body force.
        physics: of the case.
    """

    def __init__(self, case: Case, reach: float) -> None:
        self.case, self.reach = case, reach
        self.workspace = Workspace(len(case.particles), grid_spacing(case))
        self.forces, self.physics = Forces(), physics_of(case)
        self._frequency, self._rank = step_frequency(case), ranks(case.fluids)
        self._laws, self._uniform = law_table(case.fluids), np.zeros((0, len(case.gravity)))

    @timer("solve")
    def solve(self, state: State, dt: float, growth: Array, end: float = math.nan) -> Solved:
        """Solve a step of length ``dt`` [s] from a state.

        With generalized-alpha, and then again with backward Euler's method if velocities jump in the step, or if the
        time integration adds energy that cannot be taken back; see `tipfem.step.impacts`.

        Args:
            growth: (M,) relative growth of the elements that is prescribed.
            end: time at the end of the step [s]; by default the state's plus ``dt``.

        Raises:
            StepRefused: Newton's method failed, an element would be inverted, or a particle would move too far.
            ValueError: a function of time of the case returns an invalid value.
            SimulationError: the walls' motions change the tank's volume.
        """
        scheme = GeneralizedAlpha(self.case.numerics.rho_inf, dt)
        solved = self._solve(scheme, state, growth, end)
        jump, error = changes(self.case, solved)
        struck = self._jumps(solved.parts)
        if jump <= JUMP and not struck and not self._jumps(state.parts):
            calm, whole = without_gain(self.case, solved)
            if whole or jump <= UNCERTAIN:
                return dataclasses.replace(calm, error=error)
        # The acceleration of a step is that of its end, unless it is that of an impact.
        euler = BackwardEuler(dt, renews=not struck and (state.impact or jump <= JUMP))
        again = self._solve(euler, struck_state(state, solved), growth, end, guess=solved)
        return dataclasses.replace(
            again,
            newton_iterations=solved.newton_iterations + again.newton_iterations,
            krylov_iterations=solved.krylov_iterations + again.krylov_iterations,
        )

    def _start(self, state: State, dt: float, growth: Array, *, inviscid: bool = False) -> Solved:
        """A step of generalized-alpha of length ``dt`` [s] that is not taken, whose stabilisation fades with ``dt``."""
        scheme = GeneralizedAlpha(self.case.numerics.rho_inf, dt)
        return self._solve(scheme, state, growth, fading=True, inviscid=inviscid)

    def _jumps(self, parts: Mapping[str, Carried]) -> bool:
        """Whether a physics says so of what it carries, see `Physics.jumps`."""
        return any(physics.jumps(parts.get(physics.name)) for physics in self.physics)

    def _solve(
        self,
        scheme: TimeScheme,
        state: State,
        growth: Array,
        end: float = math.nan,
        *,
        guess: Solved | None = None,
        **options: bool,
    ) -> Solved:
        """Solve a step with a time integration as often as its physics ask for; see `_solve_once`."""
        solved = self._solve_once(scheme, state, growth, end, guess=guess, **options)
        while True:
            starts, ends, done = dict(state.parts), dict(solved.parts), True
            for physics in self.physics:
                given, found = (of.get(physics.name) for of in (solved.before.parts, solved.parts))
                part, there = physics.again(given, found)
                if part is not None:
                    (ends if there else starts)[physics.name] = part
                done = done and there
            if done:
                return dataclasses.replace(solved, before=state, parts=ends)
            start = dataclasses.replace(state, parts=starts)
            again = self._solve_once(scheme, start, growth, end, guess=solved, **options)
            solved = dataclasses.replace(
                again,
                newton_iterations=solved.newton_iterations + again.newton_iterations,
                krylov_iterations=solved.krylov_iterations + again.krylov_iterations,
            )

    def _solve_once(
        self,
        scheme: TimeScheme,
        state: State,
        growth: Array,
        end: float = math.nan,
        *,
        fading: bool = False,
        inviscid: bool = False,
        guess: Solved | None = None,
    ) -> Solved:
        """Solve a step with a time integration; see `solve`.

        ``fading``: whether the stabilisation fades with the step's length, instead of keeping that of `flow_time`.
        ``guess``: the same step; with generalized-alpha, its pressures are those of twice the impulse that backward
        Euler's method has.
        """
        case, numerics, before, mesh, dt = self.case, self.case.numerics, state.particles, state.mesh, scheme.dt
        varies = self.forces.vary(case, state.time)
        position = (
            before.position + scheme.cf * scheme.predict(before.velocity, before.acceleration)
            if varies
            else before.position
        )
        # Of gravity alone one row is computed, and the rest is kept.
        where = position if varies else position[:1]
        force = self.forces.acceleration(case, where, state.time + scheme.cf * dt, state.time)
        if not varies:
            if len(self._uniform) != len(position) or (self._uniform[:1] != force).any():
                self._uniform = np.repeat(force, len(position), axis=0)
            force = self._uniform
        lumping = None
        if numerics.mass != "lumped":
            lumping = lumped_part(numerics.mass, mesh.cells, state.material.fraction, len(before))
        material = ElementProperties(state.material.density, state.material.viscosity, growth, lumping)
        laws = None if self._laws is None else law_table(self.forces.fluids(case))
        if inviscid and self._laws is not None:
            material = dataclasses.replace(material, viscosity=np.zeros_like(material.density))
        elif laws is not None:
            fluid = cell_fluids(mesh)
            velocity = before.velocity if guess is None else guess.displacement / dt
            _, viscosity = rates_and_viscosities(mesh, velocity, before.pressure, fluid, laws)
            material = dataclasses.replace(material, viscosity=viscosity, laws=laws, fluid=fluid)
        properties = material.density, self._rank, material.viscosity
        step = StepStart(before, mesh, state.boundary, *properties, scheme, state.time, state.parts, case.fluids)
        acting = [(p.name, term) for p in self.physics for term in p.terms(state.parts.get(p.name), step)]
        terms = [term for _, term in acting]
        time = flow_time(case, state, self._frequency)
        problem = FlowProblem(
            mesh,
            before,
            material,
            scheme,
            force,
            numerics.stabilisation,
            self.workspace,
            terms,
            stores_rows=numerics.jacobian == "rows",
            exact=state.step == 0,
            box=state.grid_box,
            flow_time=0.0 if fading else time,
        )
        tolerance = numerics.tolerance(
            force if varies else force[:1],
            state.mean_acceleration,
            scheme.cm,
            before.spacing,
            runtime.round_off(),
            min(1.0, dt / time) if time > 0 else 1.0,
            case.restoring_acceleration(),
            problem.equations.viscous_number,
        )
        if state.step == 0:  # an error of pressure left by the first step would excite sloshing
            tolerance = min(tolerance, 10 * runtime.round_off())
        if guess is None:
            first = problem.predict()
        else:
            pressure = guess.particles.pressure
            if type(guess.scheme) is not type(scheme):
                pressure = 0.5 * (before.pressure + pressure)
            first = problem.vector(guess.displacement.copy(), pressure)
        for term in terms:
            term.tolerance = tolerance
        result = newton(
            problem,
            first,
            tolerance=tolerance,
            max_iterations=numerics.newton_iterations * (LAWFUL if material.laws is not None else 1),
            noise=max([runtime.round_off(), *(term.noise for term in terms)]),
            search=material.laws is not None,
            unfinished=lambda: any(term.unfinished for term in terms),
        )
        limits = problem.last_limits(result.solution)
        problem.conclude(result.solution)
        displacement, pressure = problem.split(result.solution)
        problem.settle(result.solution)
        if not (limits.finite and math.isfinite(result.norm)):
            solution = {"displacement": displacement, "pressure": pressure}
            raise StepRefused(
                first_not_finite(before, "at the start of the step")
                or first_not_finite(before, "in the step", {"acceleration by gravity and body force": force})
                or first_not_finite(before, "in the solution", solution)
                or "the residual of the step is not finite"
            )
        result.require()
        limits.require(numerics.smallest_jacobian, self.reach)
        level = 0.0
        open_surface = mesh.surface.front.any() and not any(part.full for part in state.parts.values())
        if not (open_surface or any(term.grounds for term in terms)):
            level = float(pressure[state.reference] if state.reference >= 0 else _mean(mesh, pressure))
            pressure -= level
        particles = scheme.advance(before, displacement, pressure)
        for term in terms:
            particles = term.finish(displacement, particles)
        particles = particles.shallow_copy(position=mesh.period.wrapped(particles.position))
        found = ((name, term.carried(result.solution)) for name, term in acting)
        carried: dict[str, Carried] = {name: part for name, part in found if part is not None}
        return Solved(
            before=state,
            time=state.time + dt if math.isnan(end) else end,
            scheme=scheme,
            particles=particles,
            walls=step.walls,
            displacement=displacement,
            inertia=problem.acceleration(displacement),
            force=force,
            growth=problem.source,
            grid_box=problem.box,
            work=problem.work(result.solution, displacement),
            acting=tuple(name for name, _ in acting),
            newton_iterations=result.iterations,
            krylov_iterations=result.krylov_iterations,
            residual=result.norm,
            uniform=not varies,
            reactions=problem.reactions(result.solution),
            level=level,
            parts={**state.parts, **carried},
        )

    def divergence_free(self, state: State, dt: float) -> State:
        """A state whose velocities are free of divergence on its mesh, where walls and other fluids let them be.

        Velocities given as a function are so in space, but not between particles. The first step would correct them, by
        a pressure in proportion to 1 / dt: in a vortex with 20 spacings a side and steps of 1 ms, most of all there is.
        So the same correction is made before, by the displacement in a very short step, over its length; twice,
        because the stabilisation leaves a part of what is rough. Laws of viscosity are left out, for they would act
        on a jump at a no-slip wall. Two lengths tell it from what forces do meanwhile.

        Args:
            state: any; only one that moves off the walls is changed, where nothing floats or is moved.
            dt: length of the first step [s].

        Raises:
            StepRefused: see `solve`, for other errors too.
        """
        free = ~state.particles.wall
        if any(part.moves for part in state.parts.values()) or not state.particles.velocity[free].any():
            return state
        growth, length, given = np.zeros(len(state.mesh.cells)), SHORT * dt, state.particles.velocity
        for _ in range(2):
            whole, half = (self._start(state, part * length, growth, inviscid=True) for part in (1.0, 0.5))
            velocity = 2 * (half.displacement / (0.5 * length)) - whole.displacement / length
            if not state.boundary.active:
                velocity[~free] = given[~free]
            particles = state.particles.shallow_copy(velocity=velocity)
            state = dataclasses.replace(state, particles=set_off(whole.walls.loose, particles, 0.25 * dt))
        changed = np.abs(state.particles.velocity - given).max() > LEAST_CHANGE * np.abs(given).max()
        kept = state.particles.velocity if changed else given
        return dataclasses.replace(state, particles=state.particles.shallow_copy(velocity=kept))

    def consistent(self, state: State, dt: float) -> State:
        """An initial state with the accelerations and pressures that follow from its positions and velocities.

        The time integration starts from accelerations. With none, the first step counts only half of the forces, and
        all that follows lags by half a step. What a step of length dt finds consists of these accelerations and, where
        the velocities are not free of divergence or walls set off at once, of a part in proportion to 1 / dt, that a
        step takes to correct the velocities, see `divergence_free`, which is done first. Two steps of different
        lengths, which are not taken, tell them apart: a = 2 a(dt) - a(dt / 2). The second part is in proportion to
        1 / dt only if the stabilisation's tau is to dt^2.

        Args:
            state: any; only one before the first step whose free particles have no acceleration, or none of whose
                particles has a pressure, is changed. What the particles have is kept.
            dt: length of the first step [s].

        Raises:
            StepRefused: see `solve`, for other errors too.
        """
        if state.step > 0:
            return state
        particles = state.particles
        accelerated, pressed = particles.acceleration[~particles.wall].any(), particles.pressure.any()
        if accelerated and pressed:
            return state
        if not accelerated and not pressed:
            state = self.divergence_free(state, dt)
            particles = state.particles
        growth = np.zeros(len(state.mesh.cells))
        whole, half = (self._start(state, length, growth) for length in (dt, 0.5 * dt))
        if not pressed:
            pressure = 2 * whole.particles.pressure - half.particles.pressure
            particles = particles.shallow_copy(pressure=pressure)
        if not accelerated:
            acceleration = 2 * whole.acceleration - half.acceleration
            if not state.boundary.active:
                acceleration[particles.wall & ~sliding(state.parts, len(particles))] = 0.0
            given = particles.shallow_copy(acceleration=acceleration)
            particles = kept_where_sliding(state.parts, given, set_off(whole.walls.loose, given, 0.25 * dt))
        parts = dict(state.parts)
        for physics in self.physics:
            part = physics.consistent(*(of.parts.get(physics.name) for of in (state, whole, half)))
            if part is not None:
                parts[physics.name], particles = part, part.imposed(particles)
        return dataclasses.replace(state, particles=particles, parts=parts)
