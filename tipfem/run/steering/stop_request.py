"""An orderly end when the process is told to stop."""

from __future__ import annotations

import os
import signal
import threading
from types import FrameType

SIGNALS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))


class StopRequest:
    """Lets a step, or the start of a viewer, finish when the process is told to stop; told again, it stops at once.

    As a context it takes the signals SIGINT (Ctrl-C), SIGTERM and SIGHUP; in the main thread only, for Python gives
    them to no other. ``signal`` is the number of the one that has come, or None.
    """

    def __init__(self) -> None:
        self.signal: int | None = None
        self._before: dict[int, object] = {}

    def __enter__(self) -> StopRequest:
        if threading.current_thread() is threading.main_thread():
            for number in SIGNALS:
                if signal.getsignal(number) in (signal.SIG_DFL, signal.default_int_handler):
                    self._before[number] = signal.signal(number, self._take)
        return self

    def __exit__(self, *_: object) -> None:
        self._restore()

    def _restore(self) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)  # type: ignore[arg-type]
        self._before = {}

    def _take(self, number: int, _frame: FrameType | None) -> None:
        if self.signal is None:
            self.signal = number
        else:
            self._restore()
            os.kill(os.getpid(), number)

    def came(self) -> bool:
        """Whether a signal has come."""
        return self.signal is not None

    def obey(self) -> None:
        """End the run if a signal has come: `KeyboardInterrupt` for SIGINT, else `SystemExit` with 128 + its number."""
        if self.signal is None:
            return
        if self.signal == signal.SIGINT:
            raise KeyboardInterrupt
        raise SystemExit(128 + self.signal)
