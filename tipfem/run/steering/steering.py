"""Steering: carries out commands that change the physics, keeps a record of them, and repeats those of a file."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tipfem.case.forces import PokeForce
from tipfem.case.surface_tension import spreading
from tipfem.errors import SimulationError
from tipfem.physics.openings.lines import OpeningLines
from tipfem.physics.openings.passed import Passed
from tipfem.physics.state import State
from tipfem.physics.surface_tension.physics import find_tension
from tipfem.physics.surface_tension.tension import Tension
from tipfem.results.output import ResultsFolder
from tipfem.run.steering.commands import (
    Command,
    Discharge,
    Drop,
    Gravity,
    MoveWall,
    Poke,
    Release,
    SurfaceTension,
    Valve,
    Viscosity,
)
from tipfem.run.steering.record import FILE, Record, read_records
from tipfem.step.budget import AXES
from tipfem.step.observer import Observer
from tipfem.step.stepper import Row, Stepper
from tipfem.typing import Array


class Steering(Observer):
    """The commands of a run that change its physics, ``applied`` at their steps.

    ``pending`` are still to be repeated, of the file or the records ``source``; they are written to ``results``.

    Raises:
        ValueError: the file cannot be read, or has a mistake.
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
        effect = _apply(simulation, command)
        record = Record(simulation.step_number, command, simulation.time, effect)
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
        """The checkpoint's state with walls changed by its commands, see `content`; those that followed are repeated.

        Raises:
            ValueError: the results folder's steering file has a mistake.
        """
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
            if isinstance(record.command, MoveWall):
                state = with_wall_moved(state, record.command, record.time)
        return state


def _gravity(simulation: Stepper, command: Gravity) -> None:
    simulation.forces = dataclasses.replace(simulation.forces, gravity=command.value)


def _poke(simulation: Stepper, command: Poke) -> None:
    end = math.inf if command.duration is None else simulation.time + command.duration
    force = PokeForce(command.at, command.acceleration, command.radius, end)
    simulation.forces = dataclasses.replace(simulation.forces, poke=force)


def _release(simulation: Stepper, command: Release) -> None:
    simulation.forces = dataclasses.replace(simulation.forces, poke=None)


def _drop(simulation: Stepper, command: Drop) -> dict[str, Any]:
    """Add a drop; returns what it changed of the totals."""
    case, before = simulation.case, simulation.state
    at = np.array(command.at)
    force = simulation.forces.acceleration(case, at[None], before.time, before.time)[0]
    state = simulation.remesher.with_drop(before, at, command.radius, case.fluid_index(command.fluid), force)
    old, new = simulation.budget.totals(before), simulation.budget.totals(state)
    simulation.state = state
    simulation.volume_control.wanted = state.wanted_volume
    momentum = (new.momentum - old.momentum).tolist()
    return {
        **{
            f"volume_{fluid.name}": float(change)
            for fluid, change in zip(case.fluids, state.volume - before.volume, strict=True)
        },
        "kinetic_energy": new.kinetic - old.kinetic,
        "potential_energy": new.potential - old.potential,
        **{f"momentum_{axis}": value for axis, value in zip(AXES, momentum, strict=False)},
    }


def _surface_tension(simulation: Stepper, command: SurfaceTension) -> dict[str, Any]:
    """Change an interface's tension, and return its change of energy; `ValueError` if a fluid would spread."""
    case, state = simulation.case, simulation.state
    edges = state.part(Tension)
    assert edges is not None
    one, other = [*(case.fluid_index(name) for name in command.between), len(case.fluids)][:2]
    table = edges.table.copy()
    table[one, other] = table[other, one] = command.value
    if text := spreading(table, [fluid.name for fluid in case.fluids]):
        raise ValueError(f"surface_tension: that {text}")
    parts = {**state.parts, "surface_tension": find_tension(state.mesh, state.particles, table)}
    simulation.state = new = dataclasses.replace(state, parts=parts)
    position = state.particles.position
    return {"surface_energy": new.stored(position) - state.stored(position)}


def _viscosity(simulation: Stepper, command: Viscosity) -> None:
    """Change the viscosity of a fluid, in the present elements and in those to come."""
    case, state = simulation.case, simulation.state
    values = [fluid.viscosity for fluid in simulation.forces.fluids(case)]
    changed = case.fluid_index(command.fluid)
    values[changed] = command.of(values[changed])
    simulation.forces = dataclasses.replace(simulation.forces, viscosity=tuple(values))
    remesher = simulation.remesher
    _, viscosity = remesher.interface.element_properties(state.mesh, state.particles.fluid, remesher.fluids)
    simulation.state = dataclasses.replace(state, material=dataclasses.replace(state.material, viscosity=viscosity))


def _opening(simulation: Stepper, command: Discharge | Valve) -> None:
    """Set the discharge or the valve of an opening."""
    state, number = simulation.state, [o.name for o in simulation.case.openings].index(command.opening)
    part = state.part(Passed)
    assert part is not None
    key = "discharge" if isinstance(command, Discharge) else "valve"
    values = getattr(part, key).copy()
    values[number] = command.value if isinstance(command, Discharge) else command.open
    changed = dataclasses.replace(part, **{key: values})
    if text := OpeningLines(simulation.case).setting(changed, state.time).unbalanced(state.time):
        raise ValueError(f"{command.name}: {text}")
    simulation.state = dataclasses.replace(state, parts={**state.parts, "openings": changed})


def _wall(simulation: Stepper, command: MoveWall) -> None:
    simulation.state = with_wall_moved(simulation.state, command, simulation.time)


def with_wall_moved(state: State, command: MoveWall, time: float) -> State:
    """The state whose wall goes over to a command's value from a time [s] on."""
    boundary = state.boundary.going_over(command.wall, time, command.value, command.ramp)
    return dataclasses.replace(state, boundary=boundary)


_APPLIED: dict[type[Command], Callable[[Stepper, Any], dict[str, Any] | None]] = {
    Gravity: _gravity,
    Poke: _poke,
    Release: _release,
    Drop: _drop,
    SurfaceTension: _surface_tension,
    Viscosity: _viscosity,
    Discharge: _opening,
    Valve: _opening,
    MoveWall: _wall,
}


def _apply(simulation: Stepper, command: Command) -> dict[str, Any] | None:
    """Carry out a command; returns what it changed at once, None for nothing."""
    return _APPLIED[type(command)](simulation, command)
