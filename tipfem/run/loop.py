"""A run: steps until a time, with all that looks at them."""

from __future__ import annotations

import logging
from collections.abc import Generator, Sequence
from contextlib import suppress

from tipfem.errors import SimulationError
from tipfem.logs import log
from tipfem.run.liveview.control import WatchedControl
from tipfem.run.progress import RunProgress
from tipfem.run.recorded_flow import RecordedFlow, writing
from tipfem.run.resume import leave_case
from tipfem.run.steering import RunControl
from tipfem.run.steering.stop_request import StopRequest
from tipfem.step.numerical_error import summary_line
from tipfem.step.observer import Observer

COMPLETE, STOPPED = "complete", "stopped by a command"  # status in the summary


def steps(
    flow: RecordedFlow,
    until: float,
    *,
    progress: bool = False,
    control: RunControl | None = None,
    stop: StopRequest | None = None,
) -> Generator[None, None, None]:
    """Step a flow until a time [s], and return to the caller after every step, and now and then during a pause.

    ``control`` lets the run pause, and end before its time; ``stop`` has whether the process has been told to stop.
    """
    if control is None:
        control = WatchedControl(flow)
    stop = stop or StopRequest()
    bar = RunProgress(flow.time, until, enabled=progress)
    observers: tuple[Observer, ...] = (bar, control, flow.fields, flow.checkpoints)
    status, said, level, flow.watch.say = "stopped", "", logging.ERROR, bar.say
    where = {"out": str(flow.results.path) if flow.results else None, "until": until}
    begun = f"run from t = {flow.time:g} s, step {flow.step_number}, to t = {until:g} s"
    bar.announce(f"{_described(flow)}: {begun}")
    log(logging.INFO, "begin", begun, {"t": flow.time, "step": flow.step_number, **where})
    if flow.results:
        with writing(flow):
            flow.results.open()
    try:
        with writing(flow):
            if flow.results:
                leave_case(flow.results, flow.case, until, flow.written_settings())
            for observer in observers:
                observer.begin(flow, until)
            flow.observers += observers
            while flow.time < until and not (control.stopped or stop.came()):
                if control.ready(flow, flow.steer):
                    due = min(observer.next_time() for observer in observers)
                    # No step is left between what is due and the end where these are one instant.
                    flow.step(due if due < until - flow.instant else until)
                yield
            stop.obey()
            for observer in observers:
                observer.finish(flow, until)
            status, level = (COMPLETE if flow.time >= until else STOPPED), logging.INFO
            _conclude(flow, bar)
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
        flow.observers = [observer for observer in flow.observers if observer not in observers]
        text = f"t = {flow.time:.6g} s, step {flow.step_number}: {said or status}"
        log(level, "end", text, {"status": status, "t": flow.time, "step": flow.step_number, **where})
        _end(flow, status, observers, until)


def _conclude(flow: RecordedFlow, bar: RunProgress) -> None:
    """Report the end of a run, and its numerical losses."""
    path = f"; results: {flow.results.path}" if flow.results else ""
    when = [row["time"] for row in flow.history for _ in range(int(row.get("broken_films", 0)))]
    films = f"; {len(when)} film{'s' * (len(when) > 1)} broke, the first at t = {when[0]:.6g} s" if when else ""
    bar.announce(f"{flow.step_number} steps to t = {flow.time:.6g} s{films}{path}")
    errors = flow.numerical_error()
    if not errors:  # stopped before the first step
        return
    line = summary_line(errors)
    bar.say(line)
    log(logging.WARNING if line.startswith("warning") else logging.INFO, "numerical_error", line, errors)


def _end(flow: RecordedFlow, status: str, observers: Sequence[Observer], until: float) -> None:
    """Write what a run leaves; a SimulationError where the summary of one with a good end cannot be written."""
    good = status in (COMPLETE, STOPPED)
    try:
        # The fields of a state at which a run is stopped come after its checkpoint, which does not list them: a run
        # that goes on removes them, unless they were due. On a disk that is full none can be written; what stopped
        # the run is the better message.
        for observer in () if good else reversed(observers):
            with suppress(OSError, SimulationError):
                observer.finish(flow, until)
        with writing(flow) if good else suppress(OSError):
            flow.write_summary({"status": status})
    finally:
        if flow.results:
            flow.results.close()


def _described(flow: RecordedFlow) -> str:
    """The particles, fluids and walls in a line."""
    case = flow.case
    laws = {"slip" if wall.slip else wall.law or "no-slip" for wall in case.walls} or {"no-slip"}
    fluids = ", ".join(fluid.name for fluid in case.fluids)
    return f"{len(flow.particles)} particles of {fluids}; walls: {', '.join(sorted(laws))}"
