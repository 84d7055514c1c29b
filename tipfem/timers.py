"""Named timers: where the wall-clock time of a simulation goes.

    timings = Timings()
    with timings.active():
        with timer("remeshing"):
            with timer("volumes"):
                ...
    timings.seconds  # {"remeshing": 0.012, "remeshing/volumes": 0.004}

A `timer` adds to the timings that are active where it runs, and costs next to nothing where none are. So the code that
is timed needs no reference to a simulation, and the timings of two simulations in one process stay apart.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import ContextDecorator, contextmanager
from contextvars import ContextVar
from types import TracebackType


class Timings:
    """Wall-clock ``seconds`` and ``calls`` by name of timer; a nested one has the path of all those around it, by "/".

    ``synchronise`` is called before a timer is read, or None: on a device that works asynchronously (a GPU), time is
    otherwise counted where the result is waited for.
    """

    def __init__(self, synchronise: Callable[[], None] | None = None) -> None:
        self.seconds: dict[str, float] = {}
        self.calls: dict[str, int] = {}
        self.synchronise = synchronise
        self._running: list[tuple[str, float]] = []

    @contextmanager
    def active(self) -> Iterator[Timings]:
        """Collect the timers of what runs inside this context."""
        token = _active.set(self)
        try:
            yield self
        finally:
            _active.reset(token)

    def reset(self) -> None:
        """Discard the measurements; timers that are running go on, and count from their own start."""
        self.seconds.clear()
        self.calls.clear()

    def start(self, name: str) -> None:
        """Enter the timer of that name, inside those that are running."""
        if self.synchronise is not None:
            self.synchronise()
        path = f"{self._running[-1][0]}/{name}" if self._running else name
        self._running.append((path, time.perf_counter()))

    def stop(self) -> None:
        """Leave the timer that was entered last."""
        if self.synchronise is not None:
            self.synchronise()
        path, started = self._running.pop()
        self.seconds[path] = self.seconds.get(path, 0.0) + time.perf_counter() - started
        self.calls[path] = self.calls.get(path, 0) + 1


_active: ContextVar[Timings | None] = ContextVar("active timings", default=None)


class timer(ContextDecorator):
    """Context manager, and decorator of functions, that counts the time inside under a name, without "/"."""

    def __init__(self, name: str) -> None:
        self.name = name

    def __enter__(self) -> timer:
        timings = _active.get()
        if timings is not None:
            timings.start(self.name)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        timings = _active.get()
        if timings is not None:
            timings.stop()
