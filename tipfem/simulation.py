"""Simulation: the time step, and runs of it."""

from __future__ import annotations

import dataclasses
import math
import time as clock
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager, nullcontext, suppress
from pathlib import Path
from typing import Any

import numpy as np

from tipfem.arguments import is_number
from tipfem.backend import runtime
from tipfem.case.boundary import Boundary
from tipfem.case.case import Case
from tipfem.case.particles import Particles
from tipfem.errors import SimulationError, StepRefused
from tipfem.fem.time_integration import StepControl, smallest_jacobian
from tipfem.mesh import probes
from tipfem.mesh.delaunay import TriangulationError
from tipfem.mesh.mesh import Mesh
from tipfem.output import ResultsFolder, fill_columns, own_columns
from tipfem.progress import RunProgress
from tipfem.remesh.remeshers import remesher_for
from tipfem.state import Solved, State
from tipfem.step.budget import Budget
from tipfem.step.solve import StepSolver
from tipfem.step.volume_source import VolumeControl
from tipfem.timers import Timings, timer
from tipfem.walls.motion import set_off

Probe = Callable[["Simulation"], float]
# The pressure of the initial fields is that after a step of this part of the first one's length.
FIRST_STEP = 0.1


class Simulation:
    """A case in motion.

    Args:
        case: what is simulated.
        out: folder for the results, or None to write none.
        time_step: largest time step [s]; by default 0.05 sqrt(h / |b|) with the largest acceleration b
            by gravity and body force at the start, or 1e-3 s without any.
        output_interval: time between fields written to disk by `run` [s]; steps are shortened to end at
            these times. By default only the first and the last state of a run.
        columns: further columns of the history, by name: functions of the simulation.

    Attributes:
        state: the present state, frozen; `particles`, `mesh`, `boundary`, `time` and `step_number` are parts of it.
        control: of the length of the time step.
        volume_control: of the source that gives the fluids back their volumes.
        history: one dict a step, as in history.csv.
        timings: wall-clock seconds by part of a step; see `tipfem.timers`.

    The attributes named in `CHANGES` are all that a step changes and that a later one depends on: a simulation of the
    same case that is given another's goes on as that one does.

    Raises:
        ValueError: an argument is out of range, or ``out`` cannot be written to.
    """

    CHANGES = ("state", "control", "volume_control", "history")

    def __init__(
        self,
        case: Case,
        out: str | Path | None = None,
        *,
        time_step: float | None = None,
        output_interval: float | None = None,
        columns: Mapping[str, Probe] | None = None,
    ) -> None:
        for name, value in (("time step", time_step), ("output_interval", output_interval)):
            if value is not None and not (is_number(value) and value > 0):
                raise ValueError(f"Simulation: {name} is {value!r} s; it must be > 0")
        if not isinstance(case, Case):
            raise ValueError(f"Simulation: case is a {type(case).__name__}; it must be a Case")
        if output_interval is not None and time_step is not None and output_interval < 0.1 * time_step:
            raise ValueError(
                f"Simulation: output_interval is {output_interval:g} s, far below the time step of {time_step:g} s; "
                "every output shortens steps to end at it"
            )
        runtime.require_init()
        self.case = case
        self.output_interval = output_interval
        self.history: list[dict[str, float]] = []
        self.timings = Timings()
        frequency = case.natural_frequency()
        largest = time_step or (0.05 / frequency if frequency else 1e-3)
        self.control = StepControl(largest, target=case.numerics.largest_move)
        self.solver = StepSolver(case, self.control.reach)
        self.remesher, self.budget = remesher_for(case), Budget(case)
        self.columns = own_columns(columns or {}, self.budget.columns)
        self._started = clock.perf_counter()
        try:
            initial = set_off(case.boundary, case.particles.copy(), 0.25 * self.control.largest)
            self.state = self.remesher.start(initial, case.boundary, case.pressure_reference())
        except TriangulationError as error:
            raise ValueError(f"Simulation: the initial particles cannot be meshed: {error}") from error
        rate = 0.0 if self.remesher.keeps_volumes else case.numerics.volume_correction * frequency
        self.volume_control = VolumeControl(self.state.volume, rate, balanced=case.closed)
        # Last of all: it removes what an earlier run left, which a refused simulation must not do.
        self.results = ResultsFolder(out) if out is not None else None
        if self.results:
            with _writing(0.0):
                self.results.write_case(case)

    @property
    def time(self) -> float:
        """Of the present state [s]."""
        return self.state.time

    @property
    def step_number(self) -> int:
        """How many steps have been taken."""
        return self.state.step

    @property
    def particles(self) -> Particles:
        """The present particles; position, velocity, pressure, fluid, wall are NumPy arrays."""
        return self.state.particles

    @property
    def mesh(self) -> Mesh:
        """Simplices on the present positions."""
        return self.state.mesh

    @property
    def boundary(self) -> Boundary:
        """Which of the present particles lie on which walls."""
        return self.state.boundary

    def step(self, until: float = math.inf) -> None:
        """Advance by one accepted time step: solve, remesh, account, record.

        Args:
            until: time that must not be stepped over [s].

        Raises:
            ValueError: ``until`` is no number, or not later than the present time.
            SimulationError: even the smallest time step was refused; or the step was accepted, but a
                function in ``columns`` failed, and its value in the history is NaN.
        """
        self._require_later("step", until)
        with self.timings.active(), timer("step"):
            refused = 0
            while True:
                dt = self._step_length(until)
                try:
                    solved = self.solve(self.state, dt, until)
                    state = self.remesher.remesh(solved)
                    break
                except (StepRefused, TriangulationError, FloatingPointError) as reason:
                    self._refuse(dt, reason)
                    refused += 1
            balance = self.budget.account(solved, state)
            self.control.accept(dt)
            self.volume_control.observe(state.volume, dt)
            self.state = state
            self.record(solved, balance, refused)

    def solve(self, state: State, dt: float, until: float = math.inf) -> Solved:
        """Solve a step of length ``dt`` [s] from a state, without taking it.

        Args:
            state: to start from.
            dt: length of the step [s].
            until: time at which the step ends where it comes there but for round-off [s].

        Raises:
            StepRefused: the step is too long.
        """
        end = until if abs(until - state.time - dt) < 1e-9 * dt else state.time + dt
        return self.solver.solve(state, dt, self.volume_control.source(state, dt), end)

    def _step_length(self, until: float) -> float:
        """Length of the next step [s], which does not go beyond a time [s]."""
        state, control = self.state, self.control
        speed = state.boundary.speed_over_spacing(state.particles, state.time, control.current)
        return control.length(speed, until - state.time, lambda dt: smallest_jacobian(state.mesh, state.particles, dt))

    def _require_later(self, method: str, until: object) -> None:
        """Raises ValueError unless ``until`` is a time after the present one."""
        if until != math.inf and not is_number(until):
            raise ValueError(f"{method}: until is {until!r}; it must be a number, the time in s")
        if not until > self.time:  # type: ignore[operator]
            raise ValueError(f"{method}: until is {until!r} s; it must be later than the present {self.time:g} s")

    def _refuse(self, dt: float, reason: Exception) -> None:
        """Halve the time step that was refused.

        Raises:
            SimulationError: it would fall below the smallest.
        """
        if not self.control.refuse(dt):
            raise SimulationError(
                f"the run stops at t = {self.time:.6g} s, step {self.step_number}: {reason}; "
                f"halving the time step down to {dt:.3g} s did not help"
            ) from reason

    def run(self, until: float, *, progress: bool = True) -> None:
        """Step until a time, writing history and fields on the way; the present fields first, unless they are there.

        Args:
            until: [s].
            progress: show a progress bar when the error output is a terminal.

        Raises:
            ValueError: ``until`` is no number, or the time has passed already.
            SimulationError: the run cannot go on, or its results cannot be written; all up to there is on disk.
        """
        self._require_later("run", until)
        bar = RunProgress(self.time, until, enabled=progress)
        status = "stopped"
        try:
            with bar, closing(self.results) if self.results else nullcontext():
                if self.results and not self.results.has_fields(self.step_number):
                    self._write_fields()
                while self.time < until:
                    due = min(until, self._next_output())
                    while self.time < due:
                        self.step(due)
                        bar.update(self.time, self.history[-1])
                    self._write_fields()
            status = "complete"
        except KeyboardInterrupt:
            status = "interrupted"
            raise
        except SimulationError as error:
            status = str(error)
            raise
        except OSError as error:
            status = f"the results cannot be written: {error}"
            raise SimulationError(f"the results cannot be written at t = {self.time:.6g} s: {error}") from error
        finally:
            # On a disk that is full neither can be written; what stopped the run is the better message.
            with _writing(self.time) if status == "complete" else suppress(OSError):
                if status != "complete":
                    self._write_fields()
                self.write_summary({"status": status})

    def volume(self, name: str) -> float:
        """Volume of a fluid [m^2 in 2-D, m^3 in 3-D], spray included; see `Case.fluid_index` for errors."""
        return float(self.state.volume[self.case.fluid_index(name)])

    def energy(self) -> probes.Energy:
        """Kinetic and potential energy [J, per metre of depth in 2-D]."""
        totals = self.budget.totals(self.state)
        return probes.Energy(totals.kinetic, totals.potential)

    def write_summary(self, content: Mapping[str, Any] | None = None) -> None:
        """Write summary.json with the run's settings and ``content``; nothing without a results folder."""
        if not self.results:
            return
        self.results.write_summary(
            {
                "time": self.time,
                "steps": self.step_number,
                "wall_seconds": clock.perf_counter() - self._started,
                "particles": len(self.particles),
                "spacing": self.particles.spacing,
                "grading": self.case.grading.summary() if self.case.grading else None,
                "largest_time_step": self.control.largest,
                **runtime.settings(),
                "interface": self.case.interface,
                "numerics": dataclasses.asdict(self.case.numerics),
                "fluids": [vars(f) for f in self.case.fluids],
                **(content or {}),
            }
        )

    @timer("history")
    def record(self, solved: Solved, balance: Mapping[str, float], refused: int) -> None:
        """Add the step that led to the present state to the history, in memory and on disk.

        Args:
            solved: the step's solve.
            balance: columns of `Budget.account`.
            refused: how many longer steps were refused before.

        Raises:
            SimulationError: a function in ``columns`` failed; the row is there, with NaN for its value.
        """
        row: dict[str, float] = {
            "step": self.step_number,
            "time": self.time,
            "time_step": solved.dt,
            "particles": len(self.particles),
            "newton_iterations": solved.newton_iterations,
            "krylov_iterations": solved.krylov_iterations,
            "newton_residual": solved.residual,
            "refused_steps": refused,
            "relocated": self.state.relocations,
            "rebuilt": self.state.rebuilt,
            "max_speed": self.particles.max_speed,
            **balance,
        }
        row.update(dict.fromkeys(self.columns, math.nan), wall_seconds=clock.perf_counter() - self._started)
        try:
            failure = fill_columns(row, self.columns, self)
        finally:  # also when interrupted: an accepted step has its row
            self.history.append(row)
            if self.results:
                self.results.append_history(row)
        if failure:
            raise SimulationError(f"t = {self.time:.6g} s, step {self.step_number}: {failure}") from failure.__cause__

    def _next_output(self) -> float:
        """The next time at which fields are to be written [s]."""
        interval = self.output_interval
        return math.inf if interval is None else (math.floor(self.time / interval + 1e-9) + 1) * interval

    def _write_fields(self) -> None:
        """Write the present fields to disk."""
        if not self.results:
            return
        with self.timings.active(), timer("output"):
            particles = self._with_first_pressure() if self.step_number == 0 else self.particles
            density = np.array([f.density for f in self.case.fluids])[particles.fluid]
            self.results.write_fields(self.step_number, self.time, self.mesh, particles, density)

    def _with_first_pressure(self) -> Particles:
        """The initial particles; with the pressure after a short step, where none was given.

        Pressure has no history, so that the first step needs none. The state stays as it is.
        """
        particles = self.particles
        if particles.pressure.any():
            return particles
        try:
            solved = self.solve(self.state, FIRST_STEP * self._step_length(math.inf))
        except (StepRefused, FloatingPointError, SimulationError):  # the first step will say why
            return particles
        return particles.shallow_copy(pressure=solved.particles.pressure)


@contextmanager
def _writing(time: float) -> Iterator[None]:
    """Turn what keeps results from being written at a time [s] into a SimulationError."""
    try:
        yield
    except OSError as error:
        raise SimulationError(f"the results cannot be written at t = {time:.6g} s: {error}") from error
