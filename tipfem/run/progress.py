"""The progress of a run: a bar on a terminal and in notebooks, and lines in the log everywhere."""

from __future__ import annotations

import logging
import math
import sys
import time as clock
from collections import deque
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from datetime import timedelta
from itertools import accumulate
from typing import TYPE_CHECKING

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn

from tipfem.logs import listened, log, logs
from tipfem.notebook import NotebookProgress, in_notebook
from tipfem.step.observer import Observer

if TYPE_CHECKING:
    from tipfem.step.stepper import Row, Stepper  # which starts Taichi

_BAR = 20  # characters of the bar on a terminal
_REDRAWN = 0.2  # wall-clock time between pictures of the bar in a notebook [s]
_LINES = 10.0  # wall-clock time between lines in the log [s]
_FIRST = 3  # steps in which kernels are compiled, so that the time left is not estimated from them
_WINDOW, _SAMPLES = 60.0, 0.5  # wall-clock time that the time left is estimated from, and between its samples [s]


@dataclass(frozen=True)
class StepReport:
    """Progress of a run after a step."""

    step: int  # number of the step
    t: float  # its time [s]
    until: float  # end of the run [s]
    dt: float  # length of the step [s]
    dt_limit: str  # what limited it, see `tipfem.fem.time_integration.StepControl`
    refused: int  # how many longer steps were refused before
    volume_error: float  # largest change of a fluid's volume since the start, relative
    newton: int  # iterations
    krylov: int  # iterations, of all of Newton's
    particles: int  # how many there are
    wall_seconds: float  # wall-clock time of the whole run so far [s]
    seconds_left: float  # estimate of the wall-clock time to the end [s]; NaN before there is one

    def parts(self) -> list[str]:
        """Parts of a line of progress."""
        refused = f", {self.refused} refused" if self.refused else ""
        return [
            f"t = {self.t:.6g} of {self.until:g} s",
            f"step {self.step}",
            f"dt {self.dt:.1e} s ({self.dt_limit}{refused})",
            f"volume error {self.volume_error:.0e}",
            f"Newton {self.newton}",
            f"Krylov {self.krylov}",
            f"{duration(self.seconds_left)} left",
        ]

    def brief(self, room: int) -> str:
        """The time left, and as many of the other parts as there is room for, in characters."""
        *others, left = self.parts()
        lines = accumulate([left, *others], "{}  {}".format)
        return [line for line in lines if len(line) <= room or line == left][-1]

    def __str__(self) -> str:
        return ", ".join(self.parts())


class RunProgress(Observer):
    """Shows how far a run is: time, step length and what limits it, volume error, iterations and the time left.

    All of it goes to the log, see `tipfem.logs`: every step at the level DEBUG, a line every 10 s at the level INFO.
    The bar, from the time ``start`` to ``end`` [s], is shown on terminals and in notebooks; without these and a log,
    there is a line at the start and at the end.
    """

    def __init__(self, start: float, end: float, *, enabled: bool = True) -> None:
        self._bar: Progress | None = None
        self._notebook = NotebookProgress() if enabled and in_notebook() else None
        self._start, self._end, self._enabled = start, end, enabled
        self._drawn, self._logged = -math.inf, clock.monotonic()
        self._steps = 0
        self._samples: deque[tuple[float, float]] = deque([(clock.monotonic(), start)])
        if enabled and not self._notebook and on_terminal():
            columns = BarColumn(_BAR), TextColumn("{task.percentage:3.0f} %  {task.fields[text]}")
            self._bar = Progress(*columns, console=Console(stderr=True))
            self._task = self._bar.add_task("run", total=end - start, text="")

    def begin(self, flow: Stepper, until: float) -> None:
        """Show the bar."""
        if self._bar:
            self._bar.start()

    def after_step(self, flow: Stepper, row: Row) -> None:
        """Show the state after a step, and log it."""
        self.update(row, self._end, flow.control.limit, flow.state.volume_error)

    def finish(self, flow: Stepper, until: float) -> None:
        """Leave the bar as it is."""
        if self._bar:
            self._bar.stop()

    def say(self, text: str) -> None:
        """Print a line where the bar is shown; nothing where it is not."""
        if self._bar:
            self._bar.console.print(text, highlight=False, markup=False)

    def announce(self, text: str) -> None:
        """Print a line where neither a bar is shown nor a log is printed: to the error output of a script."""
        if self._enabled and not (self._bar or self._notebook or listened()):
            print(text, file=sys.stderr, flush=True)

    def update(self, row: Mapping[str, float], until: float, dt_limit: str, volume_error: float) -> None:
        """Show the state after a step by its row, what limited its length, and the largest relative error of volume."""
        now, time = clock.monotonic(), float(row["time"])
        if until != self._end:  # it may change on the way
            self._end = until
            if self._bar:
                self._bar.update(self._task, total=until - self._start)
        self._steps += 1
        if self._steps <= _FIRST:
            self._samples = deque([(now, time)])
        elif now - self._samples[-1][0] >= _SAMPLES:
            self._samples.append((now, time))
            while now - self._samples[1][0] > _WINDOW:
                self._samples.popleft()
        line_due = now - self._logged >= _LINES and logs(logging.INFO)
        picture_due = self._notebook is not None and (time >= until or now - self._drawn >= _REDRAWN)
        if not (line_due or picture_due or self._bar or logs(logging.DEBUG)):
            return
        report = StepReport(
            step=int(row["step"]),
            t=time,
            until=until,
            dt=float(row["time_step"]),
            dt_limit=dt_limit,
            refused=int(row["refused_steps"]),
            volume_error=volume_error,
            newton=int(row["newton_iterations"]),
            krylov=int(row["krylov_iterations"]),
            particles=int(row["particles"]),
            wall_seconds=float(row["wall_seconds"]),
            seconds_left=self._left(now, time, until),
        )
        if line_due:
            self._logged = now
            log(logging.INFO, "progress", str(report), asdict(report))
        if logs(logging.DEBUG):
            log(logging.DEBUG, "step", str(report), asdict(report))
        if picture_due and self._notebook:
            self._drawn = now
            self._notebook.show((time - self._start) / (until - self._start), str(report))
        if self._bar:
            room = self._bar.console.width - _BAR - len(" 100 %  ")
            self._bar.update(self._task, completed=time - self._start, text=report.brief(room))

    def _left(self, now: float, time: float, until: float) -> float:
        """Estimate of the wall-clock time to the end [s], from the pace of the last minute; NaN without one."""
        begun, start = self._samples[0]
        return (until - time) * (now - begun) / (time - start) if time > start else math.nan


def duration(seconds: float) -> str:
    """Wall-clock time for people: 0:01:20; a question mark for NaN."""
    return str(timedelta(seconds=round(seconds))) if math.isfinite(seconds) else "?"


def on_terminal() -> bool:
    """Whether the error output is a terminal; it may also be closed, or missing."""
    try:
        return sys.stderr.isatty()
    except (AttributeError, ValueError, OSError):
        return False
