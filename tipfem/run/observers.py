"""Observers of a run: the history of its steps, the fields on disk, and the checkpoints."""

from __future__ import annotations

import logging
import math
import time as clock
from collections.abc import Callable, Collection, Mapping
from typing import Any

import numpy as np

from tipfem.case.fluid import law_table
from tipfem.errors import SimulationError
from tipfem.logs import log
from tipfem.physics.state import State
from tipfem.results.output import ResultsFolder, fill_columns, own_columns
from tipfem.run.checkpoint import FOLDER, CheckpointFolder, file_name
from tipfem.step.observer import Observer
from tipfem.step.solve import first_not_finite
from tipfem.step.stepper import Row, Stepper
from tipfem.timers import timer


class History(Observer):
    """The rows of all steps, in memory and in history.csv.

    Further ``columns`` are functions of the simulation by their names, which are not ``taken``, see `own_columns`.
    """

    def __init__(self, columns: Mapping[str, Callable[[Any], float]], taken: Collection[str]) -> None:
        self.columns = own_columns(columns, taken)
        self.rows: list[Row] = []  # one dict per step
        self.results: ResultsFolder | None = None  # where rows are written, or None
        self.started = clock.perf_counter()  # when the run began, by `time.perf_counter` [s]

    def after_step(self, flow: Stepper, row: Row) -> None:
        """Add the row of a step; `SimulationError` if a further column failed, with NaN for its value."""
        row.update(dict.fromkeys(self.columns, math.nan), wall_seconds=clock.perf_counter() - self.started)
        with flow.timings.active(), timer("history"):
            try:
                failure = fill_columns(row, self.columns, flow)
            finally:  # also when interrupted: an accepted step has its row
                self.rows.append(row)
                if self.results:
                    self.results.append_history(row)
        if failure:
            raise SimulationError(f"t = {flow.time:.6g} s, step {flow.step_number}: {failure}") from failure.__cause__

    def content(self) -> dict[str, Any]:
        """The rows as one array (K, C), the names of the columns and which are whole numbers, for a checkpoint."""
        names = list(self.rows[0]) if self.rows else []
        values = [[row[name] for name in names] for row in self.rows]
        return {
            "columns": names,
            "whole": [name for name in names if isinstance(self.rows[0][name], (int, np.integer))],
            "rows": np.array(values, dtype=float).reshape(len(self.rows), len(names)),
            "wall_seconds": clock.perf_counter() - self.started,
        }

    def restore(self, content: Mapping[str, Any]) -> None:
        """Take over the rows of a checkpoint, see `content`."""
        kinds = [(name, int if name in content["whole"] else float) for name in content["columns"]]
        self.rows = [
            {name: kind(value) for (name, kind), value in zip(kinds, row, strict=True)} for row in content["rows"]
        ]
        self.started = clock.perf_counter() - content["wall_seconds"]


class Fields(Observer):
    """Writes fields to ``results`` at the start and the end of a run and every ``interval`` [s] between, None for none.

    Steps pass these times: what is written there is interpolated between the ends of a step, see
    `tipfem.physics.state.Solved`. Where two of them may be in a step, or one beside the end of the run, steps end at
    them.
    """

    def __init__(self, interval: float | None) -> None:
        self.interval = interval
        self.results: ResultsFolder | None = None
        self._due = self._until = self._largest = self._instant = math.inf

    def begin(self, flow: Stepper, until: float) -> None:
        """Write the present fields, unless they are written already."""
        self._until = until
        if self.results and not self.results.has_fields(flow.step_number):
            self.write(flow)
        self.plan(flow)

    def next_time(self) -> float:
        """The next time that a step is to end at [s]."""
        following = min(self._due + (self.interval or math.inf), self._until)
        return self._due if following <= self._due + self._largest else math.inf

    def after_step(self, flow: Stepper, row: Row) -> None:
        """Write the fields if they are due."""
        if flow.time >= self._due - self._instant:
            self.write(flow, self._due)
            self.plan(flow)

    def finish(self, flow: Stepper, until: float) -> None:
        """Write the present fields if the run ends before its time, unless some of its last step are written."""
        if flow.time < until and self.results and not self.results.has_fields(flow.step_number):
            self.write(flow)

    def write(self, flow: Stepper, time: float | None = None) -> None:
        """Write fields, present or at a time in the last step [s]; `OSError` if they cannot be written."""
        if not self.results:
            return
        with flow.timings.active(), timer("output"):
            flow.make_consistent()
            particles, mesh = flow.particles, flow.mesh
            if time is None:
                time = flow.time
            elif time < flow.time - self._instant:
                assert flow.solved is not None
                particles, mesh = flow.solved.at(time)
            fluids = flow.forces.fluids(flow.case)
            density = np.array([fluid.density for fluid in fluids])[particles.fluid]
            self.results.write_fields(flow.step_number, time, mesh, particles, density, law_table(fluids))

    def plan(self, flow: Stepper) -> None:
        """Find the next time at which fields are written."""
        self._largest, self._instant = flow.control.largest, flow.instant
        self._due = min(self._until, _next_multiple(flow.time + self._instant, self.interval))


class Checkpoints(Observer):
    """Writes checkpoints of ``content`` at start and end, every ``interval`` [s], and by clock ``wall_interval``."""

    def __init__(
        self, interval: float | None, wall_interval: float | None, content: Callable[[], Mapping[str, Any]]
    ) -> None:
        self.interval, self.wall_interval, self._content = interval, wall_interval, content
        self.results: ResultsFolder | None = None
        self._wall, self._next, self._until = clock.monotonic(), 0.0, math.nan
        self._written: tuple[State | None, float] = (None, math.nan)

    def forget(self) -> None:
        """Forget the last one, so that the same state is written again: a command has changed the forces."""
        self._written = (None, math.nan)

    def begin(self, flow: Stepper, until: float) -> None:
        """Write one of the present state, unless it has been written."""
        self._until = until
        self.finish(flow, until)

    def after_step(self, flow: Stepper, row: Row) -> None:
        """Write one if it is due."""
        due = self.interval is not None and flow.time >= self._next * (1 - 1e-12)
        if due or (self.wall_interval is not None and clock.monotonic() - self._wall >= self.wall_interval):
            self.finish(flow, self._until)

    def finish(self, flow: Stepper, until: float) -> None:
        """Write one of the present state, unless it has been written.

        `OSError` if it cannot be; `SimulationError` if the state has values that are not finite: those that were there
        are left.
        """
        results, (state, end) = self.results, self._written
        if not results or (state is flow.state and end == until):
            return
        if wrong := first_not_finite(flow.particles, "in the present state"):
            raise SimulationError(f"t = {flow.time:.6g} s: no checkpoint is written, for {wrong}")
        with flow.timings.active(), timer("checkpoint"):
            results.list_file(f"{FOLDER}/{file_name(flow.step_number)}")
            CheckpointFolder(results.path).write(flow.step_number, {**self._content(), "until": until})
        self._written, self._wall = (flow.state, until), clock.monotonic()
        self._next = _next_multiple(flow.time, self.interval)
        log(logging.DEBUG, "checkpoint", f"checkpoint at t = {flow.time:.6g} s", {"t": flow.time})


def _next_multiple(time: float, interval: float | None) -> float:
    """The first multiple of an interval [s] after a time [s]; infinity without one."""
    return math.inf if interval is None else (math.floor(time / interval + 1e-9) + 1) * interval
