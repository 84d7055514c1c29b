"""A flow in steps, and what is recorded and written of it."""

from __future__ import annotations

import dataclasses
import math
import time as clock
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cached_property
from pathlib import Path
from typing import Any

from tipfem.arguments import is_number
from tipfem.backend import runtime
from tipfem.case.case import Case
from tipfem.case.fluid import fluid_record, law_table
from tipfem.casefile.record import case_facts, case_record
from tipfem.errors import SimulationError
from tipfem.notebook import facts
from tipfem.physics.state import State
from tipfem.probes import Probe, ProbeRecorder, probe_record
from tipfem.results.fields import FieldOutput
from tipfem.results.history_columns import contents_of, history_columns
from tipfem.results.output import ResultsFolder
from tipfem.results.remeshing_table import Sums, remeshing_sums
from tipfem.run.checkpoint import CheckpointFolder
from tipfem.run.observers import Checkpoints, Fields, History
from tipfem.run.resume import environment
from tipfem.run.steering import FILE, Command, Record, Steering
from tipfem.run.watch import Watch
from tipfem.step.numerical_error import numerical_error
from tipfem.step.stepper import Row, Stepper


class RecordedFlow(Stepper):
    """A case in motion, and what is recorded and written of it; see `Simulation`, which adds its runs."""

    CHANGES = (*Stepper.CHANGES, "history")

    def __init__(
        self,
        case: Case,
        out: str | Path | None = None,
        *,
        time_step: float | None = None,
        output_interval: float | None = None,
        columns: Mapping[str, Callable[[Any], float]] | None = None,
        probes: Sequence[Probe] = (),
        checkpoint_interval: float | None = None,
        checkpoint_wall_interval: float | None = 60.0,
        overwrite: bool | None = None,
        fields: str | FieldOutput = "vtu",
        steering: str | Path | Sequence[Record] | None = None,
    ) -> None:
        require_intervals(
            time_step=time_step,
            output_interval=output_interval,
            checkpoint_interval=checkpoint_interval,
            checkpoint_wall_interval=checkpoint_wall_interval,
        )
        self.field_output, self.steering = FieldOutput.of(fields), Steering(steering)
        self.field_output.require_laws(law_table(case.fluids))
        super().__init__(case, time_step)
        if output_interval is not None and time_step is not None and output_interval < 0.1 * time_step:
            text = f"Simulation: output_interval is {output_interval:g} s, far below the time step of {time_step:g} s; "
            raise ValueError(f"{text}steps then end at every output")
        self.recorded = History(columns or {}, self.balance_columns)
        self.probes = ProbeRecorder(probes, case)
        self.watch = Watch(case)
        self.observers = [self.steering, self.recorded, self.probes, self.watch]
        self.fields = Fields(output_interval)
        self.checkpoints = Checkpoints(checkpoint_interval, checkpoint_wall_interval, self._content)
        self.until, self.notes = math.nan, list[str]()
        self.results: ResultsFolder | None = None
        # Last, because it removes the results of an earlier run, which a refused simulation must not do.
        if out is not None:
            results = ResultsFolder(out, overwrite=overwrite, fields=self.field_output)
            self._write_to(results)
            with writing(self):
                results.write_case(case_facts(case))

    def _write_to(self, results: ResultsFolder) -> None:
        self.results = results
        for part in (self.recorded, self.fields, self.checkpoints, self.steering):
            part.results = results
        self.probes.write_to(results)

    @property
    def history(self) -> list[Row]:
        """One dict per step, as in history.csv."""
        return self.recorded.rows

    @history.setter
    def history(self, rows: list[Row]) -> None:
        self.recorded.rows = rows

    def steer(self, command: Command) -> None:
        """Apply a command that changes the physics from the next step on; see `tipfem.run.steering` for them.

        It is written to steering.jsonl in the results folder, with the number of steps taken.

        Args:
            command: such as ``tp.Gravity((1.0, -9.7))``.

        Raises:
            ValueError: the command is refused, because a value is not possible; nothing has changed.
        """
        self.steering.give(self, command)
        self.checkpoints.forget()

    def numerical_error(self) -> dict[str, float]:
        """Numerical errors of the run so far, relative to the flow's own values; see `tipfem.step.numerical_error`."""
        return numerical_error(self.history, self.case.fluids, self.steering.wanted_volumes(self, self.history))

    def sums(self) -> dict[str, float]:
        """Sums over the run so far of the columns of the history that are of a step, by their names.

        Of `time_dissipation` and `geometry_dissipation` the sum of both, ``time_and_geometry_dissipation``: by far the
        most of each cancels.
        """
        history, contents = self.history, contents_of(self.case.particles.dimension, self.case.coordinates)
        columns = history_columns(history[0] if history else (), contents, [fluid.name for fluid in self.case.fluids])
        result = {name: sum(row[name] for row in history) for name, column in columns.items() if column.of_step}
        if history:
            both = [result.pop(f"{what}_dissipation") for what in ("time", "geometry")]
            result["time_and_geometry_dissipation"] = sum(both)
        return result

    def remeshing_sums(self) -> Sums:
        """Sums of energy and momentum that each kind of repair of the mesh added so far: by fluid, kind and quantity.

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
                "fluids": [fluid_record(f) for f in self.case.fluids],
                "numerical_error": self.numerical_error(),
                "sums": self.sums(),
                **({"remeshing": self.remeshing_sums()} if self.remesher.account.columns else {}),
                **(content or {}),
            }
        )

    def write_checkpoint(self, until: float) -> None:
        """Write a checkpoint of the present state, from which `resume` goes on to ``until`` [s]; see `Checkpoints`."""
        self.checkpoints.finish(self, until)

    @cached_property
    def _identity(self) -> dict[str, Any]:
        """Common identity of all checkpoints of a run."""
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

    def written_settings(self) -> dict[str, Any]:
        """Settings for `tipfem.describe` beside the case and its end."""
        return {
            "largest_step": self.control.largest,
            "interval": self.fields.interval,
            "fields": self.field_output,
            "checkpoint_interval": self.checkpoints.interval,
            "checkpoint_wall_interval": self.checkpoints.wall_interval,
            "probes": list(self.probes.probes.values()),
        }

    def _present(self) -> dict[str, Any]:
        """State of the flow and of its records but the history and the commands; it shares the arrays."""
        return {
            "state": self.state,
            "forces": self.forces,
            "control": dict(vars(self.control)),
            "missing": self.volume_control.missing,
            "probes": self.probes.content(),
            "results": self.results.content() if self.results else {},
        }

    def _content(self) -> dict[str, Any]:
        """All that a checkpoint holds, but for the end of the run."""
        records = {"steering": self.steering.content(), "history": self.recorded.content()}
        return {**self._identity, **self._present(), **records}

    def kept(self) -> dict[str, Any]:
        """State that `go_back` needs to return to the present; it shares the arrays."""
        given = len(self.steering.applied), list(self.steering.pending)
        return {**self._present(), "steering": given, "rows": len(self.history)}

    def go_back(self, kept: Mapping[str, Any]) -> None:
        """Return to an earlier state ``kept`` of this run; what came after it is removed, in the results, too."""
        applied, self.steering.pending = kept["steering"][0], list(kept["steering"][1])
        del self.steering.applied[applied:]
        del self.history[kept["rows"] :]
        if self.results is not None:
            self.results.close()
        self._take_over(kept, kept["state"], self.results.path if self.results else None)
        self.fields.plan(self)
        if self.results is not None:
            self.results.replace_lines(FILE, [record.line() for record in self.steering.applied])
            CheckpointFolder(self.results.path).remove_after(self.step_number)

    def restore(self, content: Mapping[str, Any], out: Path) -> None:
        """Take over what a checkpoint in a results folder holds, and go on writing there; see `_content`."""
        self.until = content["until"]
        self.recorded.restore(content["history"])
        self._take_over(content, self.steering.restore(content["steering"], out, content["state"]), out)

    def _take_over(self, content: Mapping[str, Any], state: State, out: Path | None) -> None:
        """Take over a state with what `_present` had beside it, and go on writing into a results folder."""
        self.state, self.forces = state, content["forces"]
        vars(self.control).update(content["control"])
        self.volume_control.missing, self.volume_control.wanted = content["missing"], state.wanted_volume
        self.watch.look_back(self.history, self)
        self.probes.restore(content["probes"], self.time)
        if out is not None:
            results = ResultsFolder.continued(out, content["results"], self.history, self.step_number)
            results.fields = self.field_output
            self._write_to(results)


def require_intervals(**lengths: float | None) -> None:
    """Raise ValueError unless lengths of time of `Simulation` are numbers > 0 [s], or None."""
    for name, value in lengths.items():
        if value is not None and not (is_number(value) and value > 0):
            name = "time step" if name == "time_step" else name
            raise ValueError(f"Simulation: {name} is {value!r} s; it must be a number > 0")


@contextmanager
def writing(flow: Stepper) -> Iterator[None]:
    """Turn what keeps results from being written into a SimulationError."""
    try:
        yield
    except OSError as error:
        raise SimulationError(f"the results cannot be written at t = {flow.time:.6g} s: {error}") from error
