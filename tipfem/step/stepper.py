"""Stepper: a case, its present state, and the step to the next one."""

from __future__ import annotations

import dataclasses
import logging
import math
import warnings
from contextlib import ExitStack, suppress

from tipfem.arguments import is_number
from tipfem.backend import runtime
from tipfem.case.boundary.boundary import Boundary
from tipfem.case.case import Case
from tipfem.case.fluid import Fluid
from tipfem.case.forces import Forces
from tipfem.case.largest_step import step_limit, too_long
from tipfem.case.outline import tank_columns
from tipfem.case.particles import Particles
from tipfem.errors import CaseDoubt, SimulationError, StepRefused, TriangulationError
from tipfem.fem.time_integration import StepControl, require_felt, smallest_jacobian
from tipfem.logs import log
from tipfem.mesh.measures import Energy
from tipfem.mesh.mesh import Mesh
from tipfem.physics.carried import Carried, kept_where_sliding
from tipfem.physics.registry import default_step, step_frequency
from tipfem.physics.side_pressures.carried import PressureJump
from tipfem.physics.state import Solved, State
from tipfem.physics.volume_source import VolumeControl
from tipfem.physics.walls.motion import set_off
from tipfem.remesh.choice import remesher_for
from tipfem.results.history_columns import require_apart
from tipfem.results.output import STEP_COLUMNS
from tipfem.scratch import filled
from tipfem.step.budget import Budget
from tipfem.step.observer import Observer
from tipfem.step.solve import StepSolver, first_not_finite, steps_between_repairs
from tipfem.timers import Timings, timer
from tipfem.typing import Array

ROUND_OFF = 1e-14  # of a time, some units in its last place
Row = dict[str, float]  # of the history: a step's figures by their names


class Stepper:
    """A case, its state and its steps; `tipfem.Simulation` adds what is recorded and written of them.

    Args:
        time_step: largest time step [s]; by default 0.1 sqrt(h / |b|) with the largest acceleration b
            by gravity and body force at the start, at most the capillary time where interfaces have a
            tension, or 1e-3 s without any of these.

    Attributes:
        state: the present state, frozen; `particles`, `mesh`, `boundary`, `time` and `step_number` are parts of it.
        control: chooses the length of the time step.
        volume_control: the source term that restores the volumes of the fluids.
        solved: the solve that led to the present state; None before the first step.
        timings: wall-clock seconds by part of a step; see `tipfem.timers`.
        observers: are called before and after each step; after it all of them, even where one raises an error.

    Raises:
        ValueError: an argument is out of range, or the particles cannot be meshed.
    """

    # All that a step changes and a later step depends on.
    CHANGES: tuple[str, ...] = ("state", "control", "volume_control", "forces")

    def __init__(self, case: Case, time_step: float | None = None) -> None:
        if not isinstance(case, Case):
            raise ValueError(f"Simulation: case is a {type(case).__name__}; it must be a Case")
        runtime.require_init()
        for doubt in case.doubts():
            warnings.warn(doubt, CaseDoubt, stacklevel=3)
        self.case = case
        self.solved: Solved | None = None
        self.timings = Timings()
        self.observers: list[Observer] = []
        self._frequency = step_frequency(case)
        largest = time_step or default_step(case)
        gravity = case.gravity_frequency()
        require_felt(largest, gravity)
        if largest > step_limit(gravity):
            raise ValueError(f"Simulation: time step {too_long(largest, step_limit(gravity))}")
        self.control = StepControl(largest, **case.step_control)
        self.solver = StepSolver(case, self.control.reach)
        self.remesher, self.budget = remesher_for(case), Budget(case)
        require_apart(
            {
                "every history": (*STEP_COLUMNS, *self.budget.columns),
                "remeshing": self.remesher.account.columns,
                "the tank": tank_columns(case, 0.0),
                **{physics.name: physics.columns for physics in self.solver.physics},
            }
        )
        try:
            part_of_step = 0.25 * self.control.largest
            initial, parts = set_off(case.boundary, case.particles.copy(), part_of_step), dict[str, Carried]()
            for physics in self.solver.physics:
                part = physics.start(initial, part_of_step)
                if part is not None:
                    given = kept_where_sliding({physics.name: part}, case.particles, initial)
                    parts[physics.name], initial = part, part.imposed(given)
            self.state: State = self.remesher.start(initial, case.boundary, case.pressure_reference(), parts)
        except TriangulationError as error:
            raise ValueError(f"Simulation: the initial particles cannot be meshed: {error}") from error
        self.volume_control = VolumeControl(self.state.volume, self._restoring_rate(), balanced=not case.grounded)

    @property
    def time(self) -> float:
        """Time of the present state [s]."""
        return self.state.time

    @property
    def step_number(self) -> int:
        """Number of steps taken."""
        return self.state.step

    @property
    def instant(self) -> float:
        """Times that differ by no more are one: between them no step can be solved [s]."""
        return max(self.control.smallest, ROUND_OFF * abs(self.time))

    @property
    def particles(self) -> Particles:
        """The present particles; position, velocity, pressure, fluid, wall are NumPy arrays."""
        return self.state.particles

    @property
    def mesh(self) -> Mesh:
        """Simplices on the present positions."""
        return self.state.mesh

    @property
    def pressure_jump(self) -> Array | None:
        """(F, N) pressure of each fluid at each particle less that of the particle [Pa], 0 where the fluid is not.

        None before the first step, and where pressure is continuous.
        """
        part = self.state.part(PressureJump)
        return None if part is None else part.values

    @property
    def boundary(self) -> Boundary:
        """Walls of the present particles."""
        return self.state.boundary

    @property
    def forces(self) -> Forces:
        """Forces that accelerate the fluids: by default the case's gravity and body force."""
        return self.solver.forces

    @forces.setter
    def forces(self, forces: Forces) -> None:
        self.solver.forces = forces
        self.remesher.fluids = forces.fluids(self.case)

    @property
    def balance_columns(self) -> tuple[str, ...]:
        """Names of the columns that follow those of `_row` in a step's row."""
        of_physics = (name for physics in self.solver.physics for name in physics.columns)
        return (*self.budget.columns, *self.remesher.account.columns, *tank_columns(self.case, self.time), *of_physics)

    def volume(self, name: str | Fluid) -> float:
        """Volume of a fluid or of that of a name [m^2 in 2-D, m^3 in 3-D], spray included; see `Case.fluid_index`."""
        return float(self.state.volume[self.case.fluid_index(name)])

    def energy(self) -> Energy:
        """Kinetic and potential energy [J, per metre of depth in 2-D]."""
        totals = self.budget.totals(self.state)
        return Energy(totals.kinetic, totals.potential)

    def step(self, until: float = math.inf) -> None:
        """Advance by one accepted time step: solve, remesh, account, record.

        Args:
            until: time that must not be stepped over [s]. One within an `instant` is reached without a step.

        Raises:
            ValueError: ``until`` is no number, or not later than the present time.
            SimulationError: even the smallest time step was refused; a position is not finite; or the step was
                accepted, but a function in ``columns`` failed, and its value in the history is NaN.
        """
        require_later("step", until, self.time)
        if until - self.time <= self.instant:
            self.state = dataclasses.replace(self.state, time=float(until))
            return
        for observer in self.observers:
            observer.before_step(self)
        with ExitStack() as told, self.timings.active(), timer("step"):
            row = self._advance(until)
            for observer in reversed(self.observers):  # also when one is interrupted: a step has its row
                told.callback(observer.after_step, self, row)
            self.state = self._settled(self.state)

    def _advance(self, until: float) -> Row:
        """Take a step; returns its row of the history."""
        self._require_positions()
        self.volume_control.rate = self._restoring_rate()
        self.solved = None  # two states in memory are enough
        refused = 0
        while True:
            dt = self._step_length(until)
            try:
                start = self.state
                if start.step == 0:
                    start = self.solver.consistent(start, self._step_length(math.inf))
                solved = self.solve(start, dt, until)
                if not refused and self._keeps_cells(solved):
                    solved = dataclasses.replace(solved, keeps_cells=True)
                state = self.remesher.remesh(solved)
                break
            except (StepRefused, TriangulationError, FloatingPointError) as reason:
                self._refuse(dt, reason)
                refused += 1
        balance = self.budget.account(solved, state) | self.remesher.account.row()
        self.control.accept(dt, solved.error)
        self.volume_control.observe(state.volume, dt)
        self.state, self.solved = state, solved
        row = self._row(solved, refused) | balance | tank_columns(self.case, state.time)
        for physics in self.solver.physics:
            row |= physics.row(state.parts.get(physics.name), state.particles)
        return row

    def solve(self, state: State, dt: float, until: float = math.inf) -> Solved:
        """Solve a step of length ``dt`` [s] from a state, without taking it.

        Args:
            state: to start from.
            until: time that the step ends at exactly if it would differ from it by round-off only [s].

        Raises:
            StepRefused: the step is too long.
        """
        end = until if abs(until - state.time - dt) < 1e-9 * dt else state.time + dt
        growth = filled(0.0, "step.no_growth", len(state.mesh.cells))
        if self.volume_control.rate:
            growth = self.volume_control.source(state.mesh, state.material.fraction, dt)
        return self.solver.solve(state, dt, growth, end)

    def _settled(self, state: State) -> State:
        """A state after a step with the parts that the next one starts from, see `Physics.settled`."""
        changed, particles = dict[str, Carried](), state.particles
        for physics in self.solver.physics:
            before = state.parts.get(physics.name)
            part = physics.settled(before, state.particles, state.mesh, state.boundary, state.time)
            if part is not None and part is not before:
                changed[physics.name], particles = part, part.imposed(particles)
        if not changed:
            return state
        return dataclasses.replace(state, particles=particles, parts={**state.parts, **changed})

    def make_consistent(self) -> None:
        """Compute accelerations and pressures of the state at the start, see `StepSolver.consistent`."""
        if self.step_number == 0:
            with suppress(StepRefused, FloatingPointError, SimulationError):  # the first step will report it
                self.state = self.solver.consistent(self.state, self._step_length(math.inf))

    def _restoring_rate(self) -> float:
        """Part of the fluids' missing volumes that the source restores per time [1/s].

        It follows gravity and body force, and without these the fastest particle.
        """
        if self.remesher.keeps_volumes:
            return 0.0
        state = self.state
        rate = self._frequency
        if not rate:
            rate = state.speed_over_spacing(self.control.current)
        return self.case.numerics.volume_correction * rate

    def _step_length(self, until: float) -> float:
        """Length of the next step [s], which ends no later than ``until`` [s]."""
        state, control = self.state, self.control
        speed = state.speed_over_spacing(control.current)
        return control.length(speed, until - state.time, lambda dt: smallest_jacobian(state.mesh, state.particles, dt))

    def _keeps_cells(self, solved: Solved) -> bool:
        """Whether the cells need no repair after a step, because it is short, and so were those since the last one."""
        if self.control.limit in ("refusals", "minimum"):
            return False
        return (solved.before.step + 1) % steps_between_repairs(solved.before, solved.dt, self._frequency) > 0

    def _require_positions(self) -> None:
        """Check that all positions are finite: no grid covers others, and no shorter step mends them.

        Raises:
            SimulationError: a position is not finite.
        """
        particles = self.particles
        text = first_not_finite(particles, "before the step", {"position": particles.position})
        if text:
            raise SimulationError(f"the run stops at t = {self.time:.6g} s, step {self.step_number}: {text}")

    def _refuse(self, dt: float, reason: Exception) -> None:
        """Halve the time step that was refused.

        Raises:
            SimulationError: it would fall below the smallest one allowed.
        """
        text = f"t = {self.time:.6g} s: a step of {dt:.3g} s is refused: {reason}"
        log(logging.DEBUG, "refused", text, {"t": self.time, "step": self.step_number, "dt": dt})
        if not self.control.refuse(dt):
            raise SimulationError(
                f"the run stops at t = {self.time:.6g} s, step {self.step_number}: {reason}; "
                f"halving the time step down to {dt:.3g} s did not help"
            ) from reason

    def _row(self, solved: Solved, refused: int) -> Row:
        """The first columns of the history, `STEP_COLUMNS`, after a step in place of ``refused`` longer ones."""
        return {
            "step": self.step_number,
            "time": self.time,
            "time_step": solved.dt,
            "particles": len(self.particles),
            "newton_iterations": solved.newton_iterations,
            "krylov_iterations": solved.krylov_iterations,
            "newton_residual": solved.residual,
            "refused_steps": refused,
            "impact": int(solved.impact),
            "relocated": self.state.relocations,
            "rebuilt": self.state.rebuilt,
            "max_speed": self.particles.max_speed,
        }


def require_later(method: str, until: object, time: float) -> None:
    """Check the time that a method is to reach.

    Args:
        method: its name, for messages.
        until: what was given.
        time: the present time [s].

    Raises:
        ValueError: ``until`` is no number, or not a time after the present one.
    """
    if not (is_number(until) or (isinstance(until, float) and until == math.inf)):
        raise ValueError(f"{method}: until is {until!r}; it must be a number, the time in s")
    if not until > time:  # type: ignore[operator]
        raise ValueError(f"{method}: until is {until!r} s; it must be later than the present {time:g} s")
