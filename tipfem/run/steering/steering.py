"""Steering: carries out commands that change the physics, keeps a record of them, and repeats those of a file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tipfem.errors import SimulationError
from tipfem.physics.state import State
from tipfem.results.output import ResultsFolder
from tipfem.run.steering.commands import Command
from tipfem.run.steering.record import FILE, Record, read_records
from tipfem.step.observer import Observer
from tipfem.step.stepper import Row, Stepper
from tipfem.typing import Array


class Steering(Observer):
    """The commands of a run that change its physics, ``applied`` at their steps.

    ``pending`` are still to be repeated, of the file or the records ``source``, see `read_records` for errors; they are
    written to ``results``.
    """

    def __init__(self, source: str | Path | Sequence[Record] | None = None) -> None:
        if source is None:
            source = []
        if not isinstance(source, str | Path) and not (
            isinstance(source, Sequence) and all(isinstance(record, Record) for record in source)
        ):
            raise ValueError(f"steering is {source!r}; it must be the path of a steering.jsonl, or a list of records")
        self.pending = read_records(source) if isinstance(source, str | Path) else list(source)
        self.applied: list[Record] = []
        self.results: ResultsFolder | None = None
        self._written: list[Record] = []  # those of pending that the results folder's file has already

    def before_step(self, flow: Stepper) -> None:
        """Carry out the commands that are due before the next step; `SimulationError` if one is refused."""
        while self.pending and self.pending[0].step <= flow.step_number:
            record = self.pending.pop(0)
            try:
                self._carry_out(flow, record.command)
            except ValueError as error:
                text = f"t = {flow.time:.6g} s, step {flow.step_number}: the command that is repeated from "
                raise SimulationError(f"{text}step {record.step} is refused: {error}") from error

    def give(self, simulation: Stepper, command: Command) -> Record:
        """Carry out a command before the next step, and record it; `ValueError` if refused, without any change."""
        if not isinstance(command, Command):
            raise ValueError(f"steer: the command is {command!r}; it must be one such as tp.Gravity((0.0, -9.81))")
        if not command.physical:
            raise ValueError(f"{command.name} is no command to the physics; give it to the run's control")
        return self._carry_out(simulation, command)

    def _carry_out(self, simulation: Stepper, command: Command) -> Record:
        command.require(simulation.case)
        simulation.make_consistent()  # with the forces so far, as a run that writes fields has done
        record = Record(simulation.step_number, command, simulation.time, command.apply(simulation))
        self.applied.append(record)
        if self._written and self._written[0] == record:
            self._written.pop(0)
        elif self.results:
            if self._written:
                lines = [each.line() for each in sorted([*self.applied, *self._written], key=lambda r: r.step)]
                self.results.replace_lines(FILE, lines)
            else:
                self.results.append_line(FILE, record.line())
        return record

    def wanted_volumes(self, simulation: Stepper, history: Sequence[Row]) -> Array:
        """Volumes (K, F) that fluids should have had in the K rows of a history, with drops and what entered."""
        step = np.array([row["step"] for row in history], dtype=np.int64)
        wanted, fluids = np.tile(simulation.state.wanted_volume, (len(step), 1)), simulation.case.fluids
        for record in self.applied:
            if record.effect and f"volume_{fluids[0].name}" in record.effect:
                added = [float(record.effect[f"volume_{fluid.name}"]) for fluid in fluids]
                wanted[step <= record.step] -= added
        for column, fluid in zip(wanted.T, fluids, strict=True):
            entered = np.cumsum([row.get(f"opening_volume_{fluid.name}", 0.0) for row in history])
            column -= entered[-1:].sum() - entered
        return wanted

    def content(self) -> dict[str, Any]:
        """All of it, for a checkpoint."""
        both = {"applied": self.applied, "pending": self.pending}
        return {name: [record.line() for record in records] for name, records in both.items()}

    def restore(self, content: Mapping[str, Any], results: Path, state: State) -> State:
        """The checkpoint's state with walls changed by its commands, see `content`; those after it are repeated."""
        self.applied = [Record.parse(line) for line in content["applied"]]
        pending = [Record.parse(line) for line in content["pending"]]
        path = results / FILE
        later = read_records(path)[len(self.applied) :] if path.exists() else []
        self._written = list(later)
        for record in later:
            if record in pending:
                pending.remove(record)
        self.pending = sorted([*later, *pending], key=lambda record: record.step)
        for record in self.applied:
            state = record.command.restored(state, record.time)
        return state
