"""Simulation: a case in motion, what is recorded and written of it, and runs of it."""

from __future__ import annotations

import dataclasses
import logging
import math
import time as clock
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, nullcontext, suppress
from functools import cached_property
from pathlib import Path
from typing import Any

from tipfem.arguments import explained, is_number, path_of
from tipfem.backend import runtime
from tipfem.case.case import Case
from tipfem.case.motion_sweep import require_room
from tipfem.errors import SimulationError
from tipfem.logs import log
from tipfem.notebook import facts
from tipfem.results.fields import FieldOutput
from tipfem.results.history_columns import history_columns
from tipfem.results.output import ResultsFolder
from tipfem.results.remeshing_table import Sums, remeshing_sums
from tipfem.run.case_record import case_record
from tipfem.run.checkpoint import CheckpointFolder
from tipfem.run.liveview.control import LiveControl, WatchedControl
from tipfem.run.observers import Checkpoints, Fields, History
from tipfem.run.probes import Probe, ProbeRecorder, probe_record
from tipfem.run.progress import RunProgress
from tipfem.run.resume import KEPT, Kept, continuation, environment, leave_case, leave_changes, note_on_edits
from tipfem.run.steering import FILE, Command, Record, RunControl, Steering
from tipfem.run.steering.stop_request import StopRequest
from tipfem.step.numerical_error import numerical_error, summary_line
from tipfem.step.observer import Observer
from tipfem.step.stepper import Row, Stepper, require_later

COMPLETE, STOPPED = "complete", "stopped by a command"  # status in the summary

Column = Callable[["Simulation"], float]


class Simulation(Stepper):
    """A case in motion.

    Args:
        case: what is simulated.
        out: folder for the results, or None to write none.
        time_step: largest time step [s]; by default 0.1 sqrt(h / |b|) with the largest acceleration b
            by gravity and body force at the start, or 1e-3 s without any.
        output_interval: time between fields written to disk by `run` [s]; they are interpolated between the ends of
            the steps that pass these times, see `tipfem.run.observers.Fields`. By default only the first and the last
            state of a run.
        columns: further columns of the history, by name: functions of the simulation.
        probes: what is measured on the way, each in a file ``probes/NAME.csv``; see `tipfem.run.probes`.
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
        recorded: the history of the steps; `history` is its rows, one dict a step, as in history.csv.
        probes: what the probes have measured, by their names.
        steering: the commands given so far, and those still to be repeated.
        solved: the solve that led to the present state; None before the first step.
        results: the results folder, or None.
        timings: wall-clock seconds by part of a step; see `tipfem.timers`.

    The attributes named in `CHANGES` are all that a step changes and a later step depends on: a simulation of the
    same case that is given those of another continues exactly as the other does.

    Raises:
        ValueError: an argument is out of range, or ``out`` cannot be written to.
    """

    CHANGES = (*Stepper.CHANGES, "history")

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
        _require_intervals(
            time_step=time_step,
            output_interval=output_interval,
            checkpoint_interval=checkpoint_interval,
            checkpoint_wall_interval=checkpoint_wall_interval,
        )
        self.field_output, self.steering = FieldOutput.of(fields), Steering(steering)
        super().__init__(case, time_step)
        _require_outputs_apart(output_interval, time_step)
        self.recorded = History(columns or {}, self.balance_columns)
        self.probes = ProbeRecorder(probes, case)
        self.recorders = [self.recorded.record, self.probes.record]
        self.fields = Fields(output_interval)
        self.checkpoints = Checkpoints(checkpoint_interval, checkpoint_wall_interval, self._content)
        self.until, self.notes = math.nan, list[str]()
        self.results: ResultsFolder | None = None
        # Last, because it removes the results of an earlier run, which a refused simulation must not do.
        if out is not None:
            results = ResultsFolder(out, overwrite=overwrite, fields=self.field_output)
            self._write_to(results)
            with _writing(self):
                results.write_case(case)

    def _write_to(self, results: ResultsFolder) -> None:
        self.results = results
        for part in (self.recorded, self.fields, self.checkpoints, self.steering):
            part.results = results
        self.probes.write_to(results)

    @property
    def history(self) -> list[Row]:
        """One dict a step, as in history.csv."""
        return self.recorded.rows

    @history.setter
    def history(self, rows: list[Row]) -> None:
        self.recorded.rows = rows

    def step(self, until: float = math.inf) -> None:
        """Advance by one accepted time step: repeat commands, solve, remesh, account, record; see `Stepper.step`."""
        require_later("step", until, self.time)
        self.steering.repeat(self)
        super().step(until)

    def steer(self, command: Command) -> None:
        """Give a command that changes the physics from the next step on; see `tipfem.run.steering` for them.

        It is written to steering.jsonl in the results folder, with the number of steps taken.

        Args:
            command: such as ``tp.Gravity((1.0, -9.7))``.

        Raises:
            ValueError: the command is refused, because a value is not possible; nothing has changed.
        """
        self.checkpoints.forget()
        self.steering.give(self, command)

    @explained("say run(until=0.4), with the time to run to in s")
    def run(
        self, until: float, *, progress: bool = True, control: RunControl | None = None, view: bool = False
    ) -> None:
        """Step until a time, writing the history and fields; the present fields first, unless they are written already.

        Args:
            until: [s].
            progress: show a progress bar when the error output is a terminal.
            control: lets the run pause, and end before its time; see `tipfem.run.steering`.
            view: show the run in a browser while it goes on, see `tipfem.live`, which has more options.

        Raises:
            ValueError: ``until`` is no number, or the time has passed already; or a prescribed motion takes a body or a
                wall to another before it, see `tipfem.case.motion_sweep`.
            SimulationError: the run cannot continue, or its results cannot be written; all earlier results are on disk.
        """
        require_later("run", until, self.time)
        require_room(self.case, self.time, until, lambda: float(self.state.volume.sum()))
        with closing(LiveControl(self)) if view else nullcontext(control) as taken, StopRequest() as stop:
            for _ in self.steps(until, progress=progress, control=taken, stop=stop):
                pass

    def steps(
        self,
        until: float,
        *,
        progress: bool = False,
        control: RunControl | None = None,
        stop: StopRequest | None = None,
    ) -> Generator[None, None, None]:
        """Do the same as `run`, but return to the caller after every step, and from time to time during a pause.

        Args:
            until: [s].
            progress: see `run`.
            control: see `run`.
            stop: whether the process has been told to stop.
        """
        if control is None:
            control = WatchedControl(self) if self.case.particles.dimension == 2 else RunControl()
        stop = stop or StopRequest()
        bar = RunProgress(self.time, until, enabled=progress)
        observers: tuple[Observer, ...] = (bar, control, self.fields, self.checkpoints)
        status, said, level = "stopped", "", logging.ERROR
        where = {"out": str(self.results.path) if self.results else None, "until": until}
        begun = f"run from t = {self.time:g} s, step {self.step_number}, to t = {until:g} s"
        bar.announce(f"{self._described()}: {begun}")
        log(logging.INFO, "begin", begun, {"t": self.time, "step": self.step_number, **where})
        if self.results:
            with _writing(self):
                self.results.open()
        try:
            with _writing(self):
                if self.results:
                    leave_case(self.results, self.case, until, self._written())
                for observer in observers:
                    observer.begin(self, until)
                while self.time < until and not (control.stopped or stop.came()):
                    if control.ready(self, self.steer):
                        self.step(min(until, *(observer.next_time() for observer in observers)))
                        for observer in observers:
                            observer.after_step(self, self.history[-1])
                    yield
                stop.obey()
                for observer in observers:
                    observer.finish(self, until)
                status, level = (COMPLETE if self.time >= until else STOPPED), logging.INFO
                self._conclude(bar)
        except (KeyboardInterrupt, GeneratorExit):
            status, level = "interrupted", logging.WARNING
            raise
        except SystemExit as error:
            status = f"ended by signal {error.code - 128}" if isinstance(error.code, int) else "ended"
            level = logging.WARNING
            raise
        except SimulationError as error:
            # The error has the message, which is not to be printed twice.
            status, said = str(error), "the run stops with an error"
            raise
        finally:
            text = f"t = {self.time:.6g} s, step {self.step_number}: {said or status}"
            log(level, "end", text, {"status": status, "t": self.time, "step": self.step_number, **where})
            self._end(status, observers, until)

    def _conclude(self, bar: RunProgress) -> None:
        """Say how far a run came, and what numerics took."""
        path = f"; results: {self.results.path}" if self.results else ""
        when = [row["time"] for row in self.history for _ in range(int(row.get("broken_films", 0)))]
        films = f"; {len(when)} film{'s' * (len(when) > 1)} broke, the first at t = {when[0]:.6g} s" if when else ""
        bar.announce(f"{self.step_number} steps to t = {self.time:.6g} s{films}{path}")
        errors = self.numerical_error()
        if not errors:  # stopped before the first step
            return
        line = summary_line(errors)
        bar.say(line)
        log(logging.WARNING if line.startswith("warning") else logging.INFO, "numerical_error", line, errors)
        for text in self.case.came_back(self.history):
            bar.say(f"warning: {text}")
            log(logging.WARNING, "came_back", text)

    def _end(self, status: str, observers: Sequence[Observer], until: float) -> None:
        """Write what a run leaves; a SimulationError where the summary of one with a good end cannot be written."""
        good = status in (COMPLETE, STOPPED)
        try:
            # The fields of a state at which a run is stopped come after its checkpoint, which does not list them: a run
            # that goes on removes them, unless they were due. On a disk that is full none can be written; what stopped
            # the run is the better message.
            for observer in () if good else reversed(observers):
                with suppress(OSError, SimulationError):
                    observer.finish(self, until)
            with _writing(self) if good else suppress(OSError):
                self.write_summary({"status": status})
        finally:
            if self.results:
                self.results.close()

    def _described(self) -> str:
        """The particles, fluids and walls in a line."""
        case = self.case
        laws = {"slip" if wall.slip else wall.law or "no-slip" for wall in case.walls} or {"no-slip"}
        fluids = ", ".join(fluid.name for fluid in case.fluids)
        return f"{len(self.particles)} particles of {fluids}; walls: {', '.join(sorted(laws))}"

    def numerical_error(self) -> dict[str, float]:
        """What numerics took from the run so far, relative to the flow's own; see `tipfem.step.numerical_error`."""
        return numerical_error(self.history, self.case.fluids, self.steering.wanted_volumes(self, self.history))

    def sums(self) -> dict[str, float]:
        """Sums over the run so far of the columns of the history that are of a step, by their names.

        Of `time_dissipation` and `geometry_dissipation` the sum of both, ``time_and_geometry_dissipation``: by far the
        most of each cancels.
        """
        history, d = self.history, self.case.particles.dimension
        columns = history_columns(history[0] if history else (), d, [fluid.name for fluid in self.case.fluids])
        result = {name: sum(row[name] for row in history) for name, column in columns.items() if column.of_step}
        if history:
            result["time_and_geometry_dissipation"] = sum(
                result.pop(f"{what}_dissipation") for what in ("time", "geometry")
            )
        return result

    def remeshing_sums(self) -> Sums:
        """What each kind of repair of the mesh added to energy and momentum so far: by fluid, kind and quantity.

        Empty without ``Numerics(budget="detailed")``; see docs/theory/energy-of-remeshing.md.
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
                "wall_seconds": clock.perf_counter() - self.recorded.started,
                "particles": len(self.particles),
                "spacing": self.particles.spacing,
                "grading": self.case.grading.summary() if self.case.grading else None,
                "largest_time_step": self.control.largest,
                **runtime.settings(),
                "interface": self.case.interface,
                "numerics": dataclasses.asdict(self.case.numerics),
                "fluids": [vars(f) for f in self.case.fluids],
                "numerical_error": self.numerical_error(),
                "sums": self.sums(),
                **({"remeshing": self.remeshing_sums()} if self.remesher.account.columns else {}),
                **(content or {}),
            }
        )

    def write_checkpoint(self, until: float) -> None:
        """Write a checkpoint of the present state, from which `resume` goes on to ``until`` [s]; see `Checkpoints`."""
        self.checkpoints.finish(self, until)

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
        intervals = {
            "output_interval": output_interval,
            "checkpoint_interval": checkpoint_interval,
            "checkpoint_wall_interval": checkpoint_wall_interval,
        }
        given: dict[str, Any] = {name: value for name, value in intervals.items() if value != KEPT}
        _require_intervals(**given)
        if fields != KEPT:
            given["fields"] = FieldOutput.of(fields)
        if probes is not None:
            given["probes"] = probes
        path = path_of("resume: out", out)
        found = continuation(path, case, list(columns or ()), given, allow_changes=allow_changes)
        simulation = cls(found.case, columns=columns, **found.settings)
        simulation._restore(found.content, path)
        simulation.notes = found.notes
        if case is None:
            simulation.notes += note_on_edits(path, found.case, simulation._written())
        if found.changes:
            with _writing(simulation):
                leave_changes(path, found.case, simulation.until, simulation._written())
        return simulation

    @cached_property
    def _identity(self) -> dict[str, Any]:
        """What all checkpoints of a run have in common."""
        settings = {
            "time_step": self.control.largest,
            "output_interval": self.fields.interval,
            "checkpoint_interval": self.checkpoints.interval,
            "checkpoint_wall_interval": self.checkpoints.wall_interval,
            "fields": self.field_output,
            "columns": list(self.recorded.columns),
            "probes": {name: probe_record(probe) for name, probe in self.probes.probes.items()},
        }
        return {"case": case_record(self.case), "environment": environment(), "settings": settings}

    def _written(self) -> dict[str, Any]:
        """What `tipfem.describe` takes beside the case and its end."""
        return {
            "largest_step": self.control.largest,
            "interval": self.fields.interval,
            "fields": self.field_output,
            "checkpoint_interval": self.checkpoints.interval,
            "checkpoint_wall_interval": self.checkpoints.wall_interval,
            "probes": list(self.probes.probes.values()),
        }

    def _content(self) -> dict[str, Any]:
        """All that a checkpoint holds, but for the end of the run."""
        assert self.results is not None
        return {
            **self._identity,
            "state": self.state,
            "control": vars(self.control),
            "missing": self.volume_control.missing,
            "forces": self.forces,
            "steering": self.steering.content(),
            "history": self.recorded.content(),
            "probes": self.probes.content(),
            "results": self.results.content(),
        }

    def kept(self) -> dict[str, Any]:
        """What `go_back` needs to return to the present state; it shares the arrays."""
        return {
            "state": self.state,
            "forces": self.forces,
            "control": dict(vars(self.control)),
            "missing": self.volume_control.missing,
            "steering": (len(self.steering.applied), list(self.steering.pending)),
            "rows": len(self.history),
            "probes": self.probes.content(),
            "results": self.results.content() if self.results else {},
        }

    def go_back(self, kept: Mapping[str, Any]) -> None:
        """Return to an earlier state of this run; what came after it is removed, in the results folder, too.

        Args:
            kept: see `kept`.

        Raises:
            ValueError: the results folder cannot be written to.
        """
        self.state, self.forces = kept["state"], kept["forces"]
        vars(self.control).update(kept["control"])
        self.volume_control.missing, self.volume_control.wanted = kept["missing"], self.state.wanted_volume
        applied, self.steering.pending = kept["steering"][0], list(kept["steering"][1])
        del self.steering.applied[applied:]
        del self.history[kept["rows"] :]
        self.probes.restore(kept["probes"], self.time)
        self.fields.plan(self)
        if self.results is None:
            return
        self.results.close()
        results = ResultsFolder.continued(self.results.path, kept["results"], self.history, self.step_number)
        results.fields = self.field_output
        self._write_to(results)
        results.replace_lines(FILE, [record.line() for record in self.steering.applied])
        CheckpointFolder(results.path).remove_after(self.step_number)

    def _restore(self, content: Mapping[str, Any], out: Path) -> None:
        """Take over what a checkpoint in a results folder holds, and go on writing there; see `_content`."""
        self.state, self.forces, self.until = content["state"], content["forces"], content["until"]
        vars(self.control).update(content["control"])
        self.volume_control.missing, self.volume_control.wanted = content["missing"], self.state.wanted_volume
        self.state = self.steering.restore(content["steering"], out, self.state)
        self.recorded.restore(content["history"])
        results = ResultsFolder.continued(out, content["results"], self.history, self.step_number)
        results.fields = self.field_output
        self.probes.restore(content["probes"], self.time)
        self._write_to(results)


def _require_intervals(**lengths: float | None) -> None:
    """Raise ValueError unless lengths of time of `Simulation` are numbers > 0 [s], or None."""
    for name, value in lengths.items():
        if value is not None and not (is_number(value) and value > 0):
            name = "time step" if name == "time_step" else name
            raise ValueError(f"Simulation: {name} is {value!r} s; it must be a number > 0")


def _require_outputs_apart(output_interval: float | None, time_step: float | None) -> None:
    """Raise ValueError if outputs [s] are far more frequent than the largest steps [s]."""
    if output_interval is not None and time_step is not None and output_interval < 0.1 * time_step:
        text = f"Simulation: output_interval is {output_interval:g} s, far below the time step of {time_step:g} s; "
        raise ValueError(f"{text}steps then end at every output")


@contextmanager
def _writing(flow: Stepper) -> Iterator[None]:
    """Turn what keeps results from being written into a SimulationError."""
    try:
        yield
    except OSError as error:
        raise SimulationError(f"the results cannot be written at t = {flow.time:.6g} s: {error}") from error
