"""A progress bar for runs, shown on a terminal and in notebooks."""

from __future__ import annotations

import sys
import time as clock
from collections.abc import Mapping
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from tipfem.notebook import NotebookProgress, in_notebook

_REDRAWN = 0.2  # wall-clock time between pictures of the bar in a notebook [s]


class RunProgress:
    """Shows time, step length, Newton and Krylov iterations and the time left.

    Args:
        start: time at which the bar is empty [s].
        end: time at which it is full [s].
        enabled: show the bar; without effect unless the error output is a terminal or the
            process is the kernel of a notebook.
    """

    def __init__(self, start: float, end: float, *, enabled: bool = True) -> None:
        self._progress: Progress | None = None
        self._notebook = NotebookProgress() if enabled and in_notebook() else None
        self._start, self._end, self._drawn = start, end, -float("inf")
        if enabled and not self._notebook and _on_terminal():
            self._progress = Progress(
                TextColumn("t = {task.fields[time]:.4f} s"),
                BarColumn(),
                TextColumn("{task.percentage:3.0f} %"),
                TextColumn("dt {task.fields[dt]:.1e} s"),
                TextColumn("Newton {task.fields[newton]}  Krylov {task.fields[krylov]}"),
                TimeRemainingColumn(),
                TextColumn("left"),
                console=Console(stderr=True),
            )
            self._task = self._progress.add_task("run", total=end - start, time=start, dt=0.0, newton=0, krylov=0)

    def __enter__(self) -> RunProgress:
        if self._progress:
            self._progress.start()
        return self

    def __exit__(self, *_: Any) -> None:
        if self._progress:
            self._progress.stop()

    def say(self, text: str) -> None:
        """Print a line where the bar is shown; nothing where it is not."""
        if self._progress:
            self._progress.console.print(text, highlight=False, markup=False)

    def update(self, time: float, row: Mapping[str, float]) -> None:
        """Show the state after a step: its time [s] and its row of the history."""
        if self._notebook and (time >= self._end or clock.monotonic() - self._drawn >= _REDRAWN):
            self._drawn = clock.monotonic()
            self._notebook.show(
                (time - self._start) / (self._end - self._start),
                f"t = {time:.4f} of {self._end:g} s, step {row['step']:.0f}, dt {row['time_step']:.1e} s, "
                f"Newton {row['newton_iterations']:.0f}, Krylov {row['krylov_iterations']:.0f}",
            )
        if self._progress:
            self._progress.update(
                self._task,
                completed=time - self._start,
                time=time,
                dt=row["time_step"],
                newton=row["newton_iterations"],
                krylov=row["krylov_iterations"],
            )


def _on_terminal() -> bool:
    """Whether the error output is a terminal; it may also be closed, or missing."""
    try:
        return sys.stderr.isatty()
    except (AttributeError, ValueError, OSError):
        return False
