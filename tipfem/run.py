"""A run of a simulation to a time: fields, checkpoints, progress, and an orderly end whatever stops it."""

from __future__ import annotations

import logging
import math
from collections.abc import Iterator
from contextlib import closing, contextmanager, nullcontext, suppress
from typing import Any, Protocol

from tipfem.arguments import is_number
from tipfem.case.case import Case
from tipfem.errors import SimulationError
from tipfem.fem.time_integration import StepControl
from tipfem.logs import log
from tipfem.output import ResultsFolder
from tipfem.progress import RunProgress
from tipfem.state import State
from tipfem.steering import Command, RunControl
from tipfem.step.numerical_error import summary_line
from tipfem.stop_request import StopRequest

COMPLETE, STOPPED = "complete", "stopped by a command"  # status in the summary


class Runnable(Protocol):
    """What a run needs of a simulation; see `tipfem.Simulation`."""

    case: Case
    results: ResultsFolder | None
    history: list[dict[str, float]]
    control: StepControl
    state: State

    @property
    def time(self) -> float:
        """Of the present state [s]."""

    @property
    def step_number(self) -> int:
        """How many steps have been taken."""

    def step(self, until: float) -> None:
        """Advance by one time step."""

    def steer(self, command: Command) -> None:
        """Give a command that changes the physics."""

    def next_output(self) -> float:
        """The next time at which fields are to be written [s]."""

    def write_fields(self) -> None:
        """Write the present fields."""

    def checkpoint_is_due(self) -> bool:
        """Whether a checkpoint is to be written now."""

    def write_checkpoint(self, until: float) -> None:
        """Write a checkpoint of a run to a time."""

    def numerical_error(self) -> dict[str, float]:
        """What numerics took from the run so far, relative to the flow's own."""

    def write_summary(self, content: dict[str, Any]) -> None:
        """Write the summary."""


def run(simulation: Runnable, until: float, *, progress: bool, control: RunControl | None = None) -> None:
    """See `Simulation.run`."""
    results, bar = simulation.results, RunProgress(simulation.time, until, enabled=progress)
    status, level, said = "stopped", logging.ERROR, ""
    where = {"out": str(results.path) if results else None, "until": until}
    begun = f"run from t = {simulation.time:g} s, step {simulation.step_number}, to t = {until:g} s"
    bar.announce(f"{_described(simulation)}: {begun}")
    log(logging.INFO, "begin", begun, {"t": simulation.time, "step": simulation.step_number, **where})
    try:
        with StopRequest() as stop, bar, closing(results) if results else nullcontext():
            if results and not results.has_fields(simulation.step_number):
                simulation.write_fields()
            simulation.write_checkpoint(until)
            due = min(until, simulation.next_output())
            while simulation.time < until:
                if control and not control.before_step(simulation, stop.came):
                    break
                simulation.step(due)
                bar.update(simulation.history[-1], until, simulation.control.limit, simulation.state.volume_error)
                if control:
                    control.after_step(simulation)
                if simulation.time >= due:  # before the checkpoint, which lists the fields that have been written
                    simulation.write_fields()
                    due = min(until, simulation.next_output())
                if simulation.checkpoint_is_due():
                    simulation.write_checkpoint(until)
                stop.obey()
            stop.obey()
            if simulation.time < until:
                simulation.write_fields()
            simulation.write_checkpoint(until)
        path = f"; results: {results.path}" if results else ""
        bar.announce(f"{simulation.step_number} steps to t = {simulation.time:.6g} s{path}")
        status, level = COMPLETE if simulation.time >= until else STOPPED, logging.INFO
        errors = simulation.numerical_error()
        line = summary_line(errors)
        bar.say(line)
        log(logging.WARNING if line.startswith("warning") else logging.INFO, "numerical_error", line, errors)
    except KeyboardInterrupt:
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
    except OSError as error:
        status = f"the results cannot be written: {error}"
        raise SimulationError(f"the results cannot be written at t = {simulation.time:.6g} s: {error}") from error
    finally:
        if control:
            control.finished(simulation, status)
        log(
            level,
            "end",
            f"t = {simulation.time:.6g} s, step {simulation.step_number}: {said or status}",
            {"status": status, "t": simulation.time, "step": simulation.step_number, **where},
        )
        # On a disk that is full none can be written; what stopped the run is the better message.
        with writing(simulation.time) if status in (COMPLETE, STOPPED) else suppress(OSError, SimulationError):
            if status not in (COMPLETE, STOPPED):
                # The state at which it stopped comes after the checkpoint, which does not list it: a run that goes on
                # removes it, unless it was due.
                with suppress(OSError, SimulationError):
                    simulation.write_checkpoint(until)
                simulation.write_fields()
            simulation.write_summary({"status": status})


def _described(simulation: Runnable) -> str:
    """The particles, fluids and walls of a run in a line."""
    case = simulation.case
    laws = {"slip" if wall.slip else wall.law or "no-slip" for wall in case.walls} or {"no-slip"}
    fluids = ", ".join(fluid.name for fluid in case.fluids)
    return f"{len(simulation.state.particles)} particles of {fluids}; walls: {', '.join(sorted(laws))}"


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


def require_intervals(
    time_step: float | None,
    output_interval: float | None,
    checkpoint_interval: float | None,
    checkpoint_wall_interval: float | None,
) -> None:
    """Check lengths of time of `Simulation`: numbers > 0 [s], or None.

    Raises:
        ValueError: one is not.
    """
    for name, value in (
        ("time step", time_step),
        ("output_interval", output_interval),
        ("checkpoint_interval", checkpoint_interval),
        ("checkpoint_wall_interval", checkpoint_wall_interval),
    ):
        if value is not None and not (is_number(value) and value > 0):
            raise ValueError(f"Simulation: {name} is {value!r} s; it must be > 0")


def require_outputs_apart(output_interval: float | None, time_step: float | None) -> None:
    """Check that outputs [s] are not much more frequent than the largest time steps [s].

    Raises:
        ValueError: they are.
    """
    if output_interval is not None and time_step is not None and output_interval < 0.1 * time_step:
        raise ValueError(
            f"Simulation: output_interval is {output_interval:g} s, far below the time step of {time_step:g} s; "
            "every output shortens steps to end at it"
        )


@contextmanager
def writing(time: float) -> Iterator[None]:
    """Turn what keeps results from being written at a time [s] into a SimulationError."""
    try:
        yield
    except OSError as error:
        raise SimulationError(f"the results cannot be written at t = {time:.6g} s: {error}") from error
