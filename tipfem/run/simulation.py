"""Simulation: a case in motion, and runs of it to a time."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import closing, nullcontext
from pathlib import Path
from typing import Any

from tipfem.arguments import explained, path_of
from tipfem.case.case import Case
from tipfem.case.motion_sweep import require_room
from tipfem.errors import StartWarning
from tipfem.probes import Probe
from tipfem.results.fields import FieldOutput
from tipfem.run import loop
from tipfem.run.liveview.control import LiveControl
from tipfem.run.recorded_flow import RecordedFlow, require_intervals, writing
from tipfem.run.resume import KEPT, Kept, continuation, leave_changes, note_on_edits
from tipfem.run.steering import RunControl
from tipfem.run.steering.stop_request import StopRequest
from tipfem.step.stepper import require_later

Column = Callable[["Simulation"], float]


class Simulation(RecordedFlow):
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
        recorded: the history of the steps; `history` is its rows, one dict per step, as in history.csv.
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
        return loop.steps(self, until, progress=progress, control=control, stop=stop)

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
        require_intervals(**given)
        if fields != KEPT:
            given["fields"] = FieldOutput.of(fields)
        if probes is not None:
            given["probes"] = probes
        path = path_of("resume: out", out)
        found = continuation(path, case, list(columns or ()), given, allow_changes=allow_changes)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", StartWarning)
            simulation = cls(found.case, columns=columns, **found.settings)
        simulation.restore(found.content, path)
        simulation.notes = found.notes
        if case is None:
            simulation.notes += note_on_edits(path, found.case, simulation.written_settings())
        if found.changes:
            with writing(simulation):
                leave_changes(path, found.case, simulation.until, simulation.written_settings())
        return simulation
