"""What a run leaves to go on from, its checkpoints and its case, and the way back from them."""

from __future__ import annotations

import logging
import math
import time as clock
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol, TypeVar

from tipfem.backend import runtime
from tipfem.case.case import Case
from tipfem.case.particles import Particles
from tipfem.checkpoint import (
    FOLDER,
    CheckpointFolder,
    case_from,
    case_record,
    differences,
    environment,
    file_name,
    python_functions,
    rows_of,
    table_of,
    what_changed,
)
from tipfem.errors import SimulationError
from tipfem.fem.time_integration import StepControl
from tipfem.fields import FieldOutput
from tipfem.logs import log
from tipfem.output import CASE_FILE, ResultsFolder
from tipfem.probes import Probe, ProbeRecorder, probe_record
from tipfem.resume_changes import Rewritten, probes_to_go_on, take_over_samples
from tipfem.run import writing
from tipfem.state import State
from tipfem.steering import Steering
from tipfem.steering.steering import Steerable
from tipfem.step.solve import first_not_finite
from tipfem.timers import timer


class Resumable(Steerable, Protocol):
    """What going on needs of a simulation; see `tipfem.Simulation`."""

    output_interval: float | None
    control: StepControl
    columns: dict[str, Callable[[Any], float]]
    until: float
    notes: list[str]
    probes: ProbeRecorder
    steering: Steering
    checkpoints: RunCheckpoints
    started: float

    def __init__(self, case: Case, **options: Any) -> None:
        """See `Simulation`."""

    @property
    def particles(self) -> Particles:
        """The present particles."""


Run = TypeVar("Run", bound=Resumable)


class RunCheckpoints:
    """The checkpoints of one run: when the next is due, and what is in them.

    Args:
        interval: in simulated time [s], or None.
        wall_interval: in wall-clock time [s], or None.
    """

    def __init__(self, interval: float | None, wall_interval: float | None) -> None:
        self.interval, self.wall_interval = interval, wall_interval
        self._wall, self._next = clock.monotonic(), 0.0
        self._last: tuple[State | None, float] = (None, math.nan)
        self._common: dict[str, Any] = {}  # what all of them have in common

    def forget(self) -> None:
        """What the last one holds has changed, although the state has not."""
        self._last = (None, math.nan)

    def due(self, time: float) -> bool:
        """Whether one is due at a simulated time [s]."""
        if self.interval is not None and time >= self._next * (1 - 1e-12):
            return True
        return self.wall_interval is not None and clock.monotonic() - self._wall >= self.wall_interval

    def written(self, time: float, state: State | None = None, until: float = math.nan) -> None:
        """A checkpoint of a simulated time [s] has been written, of a state in a run to a time [s]."""
        self._last = (state, until)
        self._wall = clock.monotonic()
        interval = self.interval
        self._next = math.inf if interval is None else (math.floor(time / interval + 1e-9) + 1) * interval

    def write(self, simulation: Resumable, until: float) -> None:
        """See `Simulation.write_checkpoint`."""
        results, (last, end) = simulation.results, self._last
        if not results or (last is simulation.state and end == until):
            return
        if wrong := first_not_finite(simulation.particles, "in the present state"):
            raise SimulationError(f"t = {simulation.time:.6g} s: no checkpoint is written, for {wrong}")
        with timer("checkpoint"):
            self._common = self._common or self._of_the_run(simulation)
            content = {
                **self._common,
                "until": until,
                "state": simulation.state,
                "control": vars(simulation.control),
                "missing": simulation.volume_control.missing,
                "steering": simulation.steering.content(simulation),
                "history": table_of(simulation.history),
                "probes": simulation.probes.content(),
                "results": results.content(),
                "wall_seconds": clock.perf_counter() - simulation.started,
            }
            results.list_file(f"{FOLDER}/{file_name(simulation.step_number)}")
            CheckpointFolder(results.path).write(simulation.step_number, content)
            self.written(simulation.time, simulation.state, until)
            log(logging.DEBUG, "checkpoint", f"checkpoint at t = {simulation.time:.6g} s", {"t": simulation.time})

    def _of_the_run(self, simulation: Resumable) -> dict[str, Any]:
        """What all checkpoints of a run have in common."""
        settings = {
            "time_step": simulation.control.largest,
            "output_interval": simulation.output_interval,
            "checkpoint_interval": self.interval,
            "checkpoint_wall_interval": self.wall_interval,
            "columns": list(simulation.columns),
            "probes": {name: probe_record(probe) for name, probe in simulation.probes.probes.items()},
        }
        where = {**environment(), **runtime.settings()}
        return {"case": case_record(simulation.case), "environment": where, "settings": settings}


def keep_case(simulation: Resumable, until: float) -> None:
    """Write the whole case into the results folder, as a case file, unless there is one or the run has no end.

    Parts that no file keeps, functions of Python's, are named in it.

    Args:
        simulation: about to run.
        until: time that it is to reach [s].

    Raises:
        SimulationError: the file cannot be written.
    """
    results, names = simulation.results, (CASE_FILE, "case.npz")
    if results is None or until == math.inf:
        return
    if any((results.path / name).exists() for name in names):  # of this run, or the user's own
        return
    from tipfem.casefile.describing import write_case  # here, for its import takes a while

    with writing(simulation.time):
        for name in names:
            results.list_file(name)
        write_case(results.path / CASE_FILE, simulation.case, until, folder=str(results.path), **_settings(simulation))


def keep_changes(simulation: Resumable) -> None:
    """Write the case file of a run that goes on anew, unless it says already what the run has from now on.

    Args:
        simulation: about to go on.

    Raises:
        SimulationError: the file cannot be written.
    """
    from tipfem.casefile.describing import write_case  # here, for their import takes a while
    from tipfem.casefile.loading import left_case

    assert simulation.results is not None
    out, settings = simulation.results.path, _settings(simulation)
    file = left_case(out)
    if file and {**file.settings(), "largest_step": settings["largest_step"]} == settings:
        return
    with writing(simulation.time):
        write_case(
            out / CASE_FILE, simulation.case, file.end if file else simulation.until, folder=str(out), **settings
        )


def _settings(simulation: Resumable) -> dict[str, Any]:
    """What `tipfem.describe` takes beside the case and its end."""
    assert simulation.results is not None
    return {
        "largest_step": simulation.control.largest,
        "interval": simulation.output_interval,
        "fields": simulation.results.fields,
        "checkpoint_interval": simulation.checkpoints.interval,
        "checkpoint_wall_interval": simulation.checkpoints.wall_interval,
        "probes": list(simulation.probes.probes.values()),
    }


def kept_case(out: Path, record: Mapping[str, Any]) -> Case:
    """The case of a run: that of a checkpoint, or where it has forms and tables of a case file, that of the file.

    Args:
        out: the results folder.
        record: of the case, in the checkpoint.

    Raises:
        CheckpointError: a part of it is a function of Python's, which no file keeps.
        CaseFileError: the case file has been damaged.
    """
    if python_functions(record):
        from tipfem.casefile.loading import left_case

        if file := left_case(out):
            return file.case()
    return case_from(record)


def edited(simulation: Resumable) -> list[str]:
    """A note if the case file in the folder of a run that goes on has been edited, which only `tipfem resume` reads.

    Args:
        simulation: about to go on, from the newest checkpoint.
    """
    from tipfem.casefile.loading import left_case

    assert simulation.results is not None
    path = simulation.results.path / CASE_FILE
    newest = CheckpointFolder(path.parent).files()[0]
    if not path.exists() or path.stat().st_mtime_ns <= newest.stat().st_mtime_ns:
        return []
    note = f"{path}: Simulation.resume does not read it; `tipfem resume` does, and arguments change what is written"
    try:
        file = left_case(path.parent)
        if file is None:
            return []
        settings = _settings(simulation)
        if {**file.settings(), "largest_step": settings["largest_step"]} != settings:
            return [note]
        return [note] if differences(case_record(simulation.case), case_record(file.case())) else []
    except ValueError:  # it has mistakes
        return [note]


def resumed(
    made: type[Run],
    out: Path,
    case: Case | None,
    columns: Mapping[str, Callable[[Any], float]],
    probes: Sequence[Probe] | None,
    rewritten: Rewritten,
    *,
    allow_changes: bool,
) -> Run:
    """See `Simulation.resume`; ``made`` is that class, and ``rewritten`` what is written otherwise than before."""
    folder = CheckpointFolder(out)
    notes: list[str] = []
    newest, given = folder.newest(), case is not None
    case = kept_case(out, newest["case"]) if case is None else case
    if not runtime.settings():
        runtime.init(newest["environment"]["arch"], newest["environment"]["precision"])
    content = folder.read(case, notes.append)
    present = {**environment(), **runtime.settings()}
    notes += what_changed(content, case, list(columns), present, out, allow_changes=allow_changes)
    settings = content["settings"]
    probes, changes = probes_to_go_on(settings["probes"], probes, out)
    intervals, more = rewritten.intervals(settings)
    fields, last = rewritten.field_output(FieldOutput(**content["results"].get("fields", {})))
    notes += [*changes, *more, *last]
    simulation = made(case, columns=columns, probes=probes, time_step=settings["time_step"], **intervals)
    simulation.state = content["state"]
    vars(simulation.control).update(content["control"])
    simulation.volume_control.missing = content["missing"]
    simulation.steering.go_on(simulation, content.get("steering"), out)
    simulation.history = rows_of(content["history"])
    simulation.until, simulation.notes = content["until"], notes
    simulation.started = clock.perf_counter() - content["wall_seconds"]
    simulation.results = ResultsFolder.continued(out, content["results"], simulation.history, simulation.step_number)
    simulation.results.fields = fields
    take_over_samples(simulation.probes, settings["probes"], content["probes"], simulation.time)
    simulation.probes.write_to(simulation.results)
    simulation.checkpoints.written(simulation.time)
    if not given:
        notes += edited(simulation)
    if changes or more or last:
        keep_changes(simulation)
    return simulation
