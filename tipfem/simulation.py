"""Simulation: the time step, and runs of it."""

from __future__ import annotations

import dataclasses
import logging
import math
import time as clock
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from tipfem.arguments import explained, path_of
from tipfem.backend import runtime
from tipfem.case.boundary import Boundary
from tipfem.case.case import Case
from tipfem.case.fluid import Fluid
from tipfem.case.forces import Forces
from tipfem.case.largest_step import DEFAULT, step_limit, too_long
from tipfem.case.motion_sweep import require_room
from tipfem.case.particles import Particles
from tipfem.errors import SimulationError, StepRefused, TriangulationError
from tipfem.fem.time_integration import StepControl, require_felt, smallest_jacobian
from tipfem.fields import FieldOutput
from tipfem.liveview.control import LiveControl
from tipfem.logs import log
from tipfem.mesh.measures import Energy
from tipfem.mesh.mesh import Mesh
from tipfem.notebook import facts
from tipfem.output import ResultsFolder, fill_columns, own_columns
from tipfem.probes import Probe, ProbeRecorder
from tipfem.remesh.remeshers import remesher_for
from tipfem.remeshing_table import Sums, remeshing_sums
from tipfem.resume_changes import KEPT, Kept, Rewritten
from tipfem.resuming import RunCheckpoints, keep_case, resumed
from tipfem.run import require_intervals, require_later, require_outputs_apart, writing
from tipfem.run import run as run_to
from tipfem.state import Solved, State, state_with_held_bodies
from tipfem.steering import Command, Record, RunControl, Steering
from tipfem.step.budget import Budget
from tipfem.step.numerical_error import numerical_error
from tipfem.step.solve import StepSolver, steps_between_repairs
from tipfem.step.volume_source import VolumeControl
from tipfem.timers import Timings, timer
from tipfem.typing import Array
from tipfem.walls.bodies import BodyStates, body_columns
from tipfem.walls.motion import set_off

Column = Callable[["Simulation"], float]


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
        probes: what is measured on the way, each in a file ``probes/NAME.csv``; see `tipfem.probes`.
        checkpoint_interval: simulated time between checkpoints of `run` [s]; None for none by simulated time.
        checkpoint_wall_interval: wall-clock time between them [s]; None for none by the clock. A run with a results
            folder writes one at its start and at its end, too; see `resume`.
        overwrite: whether an earlier run in ``out`` is replaced, or an error; by default a long one (10 min) is one.
        fields: the format of the fields, "vtu", "vtkhdf" or "both", or a `FieldOutput`.
        steering: a steering.jsonl of an earlier run, whose commands are repeated at their steps; see `steer`. Run to
            the same time, with the same settings on the same machine, the results are the same to the bit.

    Attributes:
        state: the present state, frozen; `particles`, `mesh`, `boundary`, `time` and `step_number` are parts of it.
        control: chooses the length of the time step.
        volume_control: the source term that restores the volumes of the fluids.
        history: one dict a step, as in history.csv.
        probes: what the probes have measured, by their names.
        steering: the commands given so far, and those still to be repeated.
        solved: the solve that led to the present state; None before the first step.
        timings: wall-clock seconds by part of a step; see `tipfem.timers`.

    The attributes named in `CHANGES` are all that a step changes and a later step depends on: a simulation of the
    same case that is given those of another continues exactly as the other does.

    Raises:
        ValueError: an argument is out of range, or ``out`` cannot be written to.
    """

    CHANGES = ("state", "control", "volume_control", "history", "forces")

    def __init__(
        self,
        case: Case,
        out: str | Path | None = None,
        *,
        time_step: float | None = None,
        output_interval: float | None = None,
        columns: Mapping[str, Column] | None = None,
        probes: Sequence[Probe] = (),
        checkpoint_interval: float | None = None,
        checkpoint_wall_interval: float | None = 60.0,
        overwrite: bool | None = None,
        fields: str | FieldOutput = "vtu",
        steering: str | Path | Sequence[Record] | None = None,
    ) -> None:
        require_intervals(time_step, output_interval, checkpoint_interval, checkpoint_wall_interval)
        if not isinstance(case, Case):
            raise ValueError(f"Simulation: case is a {type(case).__name__}; it must be a Case")
        field_output, self.steering = FieldOutput.of(fields), Steering(steering)
        runtime.require_init()
        self.case = case
        self.output_interval = output_interval
        self.history: list[dict[str, float]] = []
        self.solved: Solved | None = None
        self.timings = Timings()
        self._frequency = frequency = case.natural_frequency()
        largest = time_step or (DEFAULT / frequency if frequency else 1e-3)
        require_felt(largest, frequency)
        if largest > step_limit(frequency):
            raise ValueError(f"Simulation: time step {too_long(largest, step_limit(frequency))}")
        require_outputs_apart(output_interval, time_step)
        self.control = StepControl(largest, target=case.numerics.largest_move)
        self.solver = StepSolver(case, self.control.reach)
        self.remesher, self.budget = remesher_for(case), Budget(case)
        kept = (*self.budget.columns, *self.remesher.account.columns, *body_columns(case.bodies, None))
        self.columns = own_columns(columns or {}, kept)
        self.until, self.notes = math.nan, list[str]()
        self.started = clock.perf_counter()
        try:
            initial = set_off(case.boundary, case.particles.copy(), 0.25 * self.control.largest)
            bodies = None
            if case.bodies:
                bodies = BodyStates.start(case.bodies, initial, case.body_label, 0.25 * self.control.largest)
                initial = bodies.imposed(initial)
            self.state = self.remesher.start(initial, case.boundary, case.pressure_reference())
            self.state = dataclasses.replace(self.state, bodies=bodies)
        except TriangulationError as error:
            raise ValueError(f"Simulation: the initial particles cannot be meshed: {error}") from error
        self.volume_control = VolumeControl(self.state.volume, self._restoring_rate(), balanced=case.closed)
        self.probes = ProbeRecorder(probes, case)
        self.checkpoints = RunCheckpoints(checkpoint_interval, checkpoint_wall_interval)
        # Last, because it removes the results of an earlier run, which a refused simulation must not do.
        self.results = ResultsFolder(out, overwrite=overwrite, fields=field_output) if out is not None else None
        if self.results:
            self.probes.write_to(self.results)
            with writing(0.0):
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
    def pressure_jump(self) -> Array | None:
        """(F, N) pressure of each fluid at each particle less that of the particle [Pa]; see `tipfem.state.State`."""
        return self.state.pressure_jump

    @property
    def boundary(self) -> Boundary:
        """Which of the present particles lie on which walls."""
        return self.state.boundary

    @property
    def forces(self) -> Forces:
        """What accelerates the fluids: by default the case's gravity and body force."""
        return self.solver.forces

    @forces.setter
    def forces(self, forces: Forces) -> None:
        self.solver.forces = forces

    def steer(self, command: Command) -> None:
        """Give a command that changes the physics from the next step on; see `tipfem.steering` for them.

        It is written to steering.jsonl in the results folder, with the number of steps taken.

        Args:
            command: such as ``tp.Gravity((1.0, -9.7))``.

        Raises:
            ValueError: the command is refused, because a value is not possible; nothing has changed.
        """
        self.checkpoints.forget()
        self.steering.give(self, command)

    def step(self, until: float = math.inf) -> None:
        """Advance by one accepted time step: solve, remesh, account, record.

        Args:
            until: time that must not be stepped over [s].

        Raises:
            ValueError: ``until`` is no number, or not later than the present time.
            SimulationError: even the smallest time step was refused; or the step was accepted, but a
                function in ``columns`` failed, and its value in the history is NaN.
        """
        require_later("step", until, self.time)
        self.steering.repeat(self)
        with self.timings.active(), timer("step"):
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
            self.control.accept(dt)
            self.volume_control.observe(state.volume, dt)
            self.state, self.solved = state, solved
            self.record(solved, balance, refused)
            self.state = state_with_held_bodies(self.case.bodies, state)

    def solve(self, state: State, dt: float, until: float = math.inf) -> Solved:
        """Solve a step of length ``dt`` [s] from a state, without taking it.

        Args:
            state: to start from.
            dt: length of the step [s].
            until: time that the step ends at exactly if it would differ from it by round-off only [s].

        Raises:
            StepRefused: the step is too long.
        """
        end = until if abs(until - state.time - dt) < 1e-9 * dt else state.time + dt
        return self.solver.solve(state, dt, self.volume_control.source(state, dt), end)

    def _restoring_rate(self) -> float:
        """Part of the fluids' missing volumes that the source restores per time [1/s].

        It follows gravity and body force, and without these the fastest particle.
        """
        if self.remesher.keeps_volumes:
            return 0.0
        state = self.state
        rate = self._frequency
        if not rate:
            rate = state.boundary.speed_over_spacing(state.particles, state.time, self.control.current)
        return self.case.numerics.volume_correction * rate

    def _step_length(self, until: float) -> float:
        """Length of the next step [s], which ends no later than ``until`` [s]."""
        state, control = self.state, self.control
        speed = state.boundary.speed_over_spacing(state.particles, state.time, control.current)
        return control.length(speed, until - state.time, lambda dt: smallest_jacobian(state.mesh, state.particles, dt))

    def _keeps_cells(self, solved: Solved) -> bool:
        """Whether the cells need no repair after a step, because it is short, and so were those since the last one."""
        if self.control.limit in ("refusals", "minimum"):
            return False
        return (solved.before.step + 1) % steps_between_repairs(solved.before, solved.dt, self._frequency) > 0

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

    @explained("say run(until=0.4), with the time to run to in s")
    def run(
        self, until: float, *, progress: bool = True, control: RunControl | None = None, view: bool = False
    ) -> None:
        """Step until a time, writing the history and fields; the present fields first, unless they are written already.

        Args:
            until: [s].
            progress: show a progress bar when the error output is a terminal.
            control: lets the run pause, and end before its time; see `tipfem.steering`.
            view: show the run in a browser while it goes on, see `tipfem.live`, which has more options.

        Raises:
            ValueError: ``until`` is no number, or the time has passed already; or a prescribed motion takes a body or a
                wall to another before it, see `tipfem.case.motion_sweep`.
            SimulationError: the run cannot continue, or its results cannot be written; all earlier results are on disk.
        """
        require_later("run", until, self.time)
        require_room(self.case, self.time, until)
        keep_case(self, until)
        run_to(self, until, progress=progress, control=LiveControl(self) if view else control)

    def volume(self, name: str | Fluid) -> float:
        """Volume of a fluid or of that of a name [m^2 in 2-D, m^3 in 3-D], spray included; see `Case.fluid_index`."""
        return float(self.state.volume[self.case.fluid_index(name)])

    def energy(self) -> Energy:
        """Kinetic and potential energy [J, per metre of depth in 2-D]."""
        totals = self.budget.totals(self.state)
        return Energy(totals.kinetic, totals.potential)

    def numerical_error(self) -> dict[str, float]:
        """What numerics took from the run so far, relative to the flow's own; see `tipfem.step.numerical_error`."""
        return numerical_error(self.history, self.case.fluids, self.steering.wanted_volumes(self))

    def remeshing_sums(self) -> Sums:
        """What each kind of repair of the mesh added to energy and momentum so far: by fluid, kind and quantity.

        Empty without ``Numerics(budget="detailed")``; see docs/theory/energy.md.
        """
        names = self.remesher.account.columns
        return remeshing_sums({name: sum(row[name] for row in self.history) for name in names})

    def _repr_html_(self) -> str:
        """For notebooks."""
        return facts(
            f"Simulation: {self.case.title or 'without a title'}",
            {
                "time": f"{self.time:g} s",
                "steps": self.step_number,
                "particles": len(self.particles),
                "cells": len(self.mesh.cells),
                "volumes": ", ".join(f"{f.name} {self.volume(f.name):.4g}" for f in self.case.fluids),
                "results": self.results.path if self.results else "none are written",
            },
        )

    def write_summary(self, content: Mapping[str, Any] | None = None) -> None:
        """Write summary.json with the run's settings and ``content``; without a results folder, do nothing."""
        if not self.results:
            return
        self.results.write_summary(
            {
                "time": self.time,
                "steps": self.step_number,
                "wall_seconds": clock.perf_counter() - self.started,
                "particles": len(self.particles),
                "spacing": self.particles.spacing,
                "grading": self.case.grading.summary() if self.case.grading else None,
                "largest_time_step": self.control.largest,
                **runtime.settings(),
                "interface": self.case.interface,
                "numerics": dataclasses.asdict(self.case.numerics),
                "fluids": [vars(f) for f in self.case.fluids],
                "numerical_error": self.numerical_error(),
                **({"remeshing": self.remeshing_sums()} if self.remesher.account.columns else {}),
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
            "impact": int(solved.impact),
            "relocated": self.state.relocations,
            "rebuilt": self.state.rebuilt,
            "max_speed": self.particles.max_speed,
            **balance,
            **body_columns(self.case.bodies, self.state.bodies),
        }
        row.update(dict.fromkeys(self.columns, math.nan), wall_seconds=clock.perf_counter() - self.started)
        try:
            failure = fill_columns(row, self.columns, self)
        finally:  # also when interrupted: an accepted step has its row
            self.history.append(row)
            if self.results:
                self.results.append_history(row)
            self.probes.record(self, solved.scheme)
        if failure:
            raise SimulationError(f"t = {self.time:.6g} s, step {self.step_number}: {failure}") from failure.__cause__

    def checkpoint_is_due(self) -> bool:
        """Whether `run` is to write a checkpoint now."""
        return self.results is not None and self.checkpoints.due(self.time)

    def write_checkpoint(self, until: float) -> None:
        """Write a checkpoint of the present state into the results folder; nothing without one.

        Args:
            until: time that the run is to reach [s], which `resume` goes on to.

        Raises:
            OSError: it cannot be written.
            SimulationError: the state has values that are not finite; the checkpoints that were there are left.
        """
        with self.timings.active():
            self.checkpoints.write(self, until)

    @classmethod
    def resume(
        cls,
        out: str | Path,
        case: Case | None = None,
        *,
        columns: Mapping[str, Column] | None = None,
        probes: Sequence[Probe] | None = None,
        output_interval: float | Kept | None = KEPT,
        checkpoint_interval: float | Kept | None = KEPT,
        checkpoint_wall_interval: float | Kept | None = KEPT,
        fields: str | FieldOutput = KEPT,
        allow_changes: bool = False,
    ) -> Simulation:
        """The simulation that a run in a results folder was, at its newest checkpoint; `run` goes on from there.

        It goes on to the bit as the run would have that was not stopped, on the same processor with the same versions;
        what is written differs in wall-clock times alone. What the run wrote after the checkpoint is removed.

        The case, and what is written how often, are those of the checkpoint but for what is given here: unlike
        `tipfem resume`, this reads the folder's case.toml for motions and forces alone. If the file has been edited,
        ``notes`` says so; changes that are given are written into it.

        Args:
            out: the results folder.
            case: the case of the run; needed if it has functions of Python's, which no file keeps. Those that a case
                file describes, by forms and tables, are in the folder.
            columns: those of the run, functions which no file keeps either.
            probes: those of the run; needed if they are not all of tipfem's own kinds, which a checkpoint keeps. Their
                intervals may differ; further ones are measured from here on, and one that is left out no more.
            output_interval: see `Simulation`; "kept" leaves what the run had, as in the three that follow.
            checkpoint_interval: see `Simulation`.
            checkpoint_wall_interval: see `Simulation`.
            fields: see `Simulation`. The format stays that of the run; the precision of VTU files may differ.
            allow_changes: go on although numbers of the method (`Numerics`) have changed.

        Returns:
            The simulation. Its attribute ``until`` is the time [s] that the run was to reach; ``notes`` says in lines
            what may make it differ from a run that was not stopped: another processor, other versions, files that are
            damaged.

        Raises:
            CheckpointError: there is no checkpoint that can be read, the case has changed, or a part of it is missing;
                or what is written cannot be changed so.
            ValueError: the folder cannot be written to, or an interval is no length of time.
        """
        rewritten = Rewritten(output_interval, checkpoint_interval, checkpoint_wall_interval, fields)
        path = path_of("resume: out", out)
        return resumed(cls, path, case, columns or {}, probes, rewritten, allow_changes=allow_changes)

    def next_output(self) -> float:
        """The next time at which fields are to be written [s]."""
        interval = self.output_interval
        return math.inf if interval is None else (math.floor(self.time / interval + 1e-9) + 1) * interval

    def make_consistent(self) -> None:
        """Let the state at the start have its accelerations and pressures, see `StepSolver.consistent`."""
        if self.step_number == 0:
            with suppress(StepRefused, FloatingPointError, SimulationError):  # the first step will report it
                self.state = self.solver.consistent(self.state, self._step_length(math.inf))

    def write_fields(self) -> None:
        """Write the present fields to disk."""
        if not self.results:
            return
        with self.timings.active(), timer("output"):
            self.make_consistent()
            density = np.array([f.density for f in self.case.fluids])[self.particles.fluid]
            self.results.write_fields(self.step_number, self.time, self.mesh, self.particles, density)
