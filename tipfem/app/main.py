"""Entry point of the command `tipfem`: what it says when it is interrupted, or its output is closed or full."""

from __future__ import annotations

import io
import os
import signal
import sys
from collections.abc import Callable
from typing import Any

from tipfem.app.terminal import Terminal


def main() -> None:
    """Run the command; see `tipfem.app.commands.EXIT_CODES`."""
    try:
        code = _run()
    except KeyboardInterrupt:  # before a run has begun, or in a command that only looks at results
        print("interrupted", file=sys.stderr)
        code = 128 + signal.SIGINT
    sys.exit(code)


def _run() -> int:
    """Run the command with an output that may fail; return its exit code."""
    command = interruptible(_imported)
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:  # closed by whoever has started the process
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")  # names of files need be no UTF-8
    before = sys.stdout, sys.stderr
    output = Output(sys.stdout)
    for name, stream in (("stdout", output), ("stderr", sys.stderr)):
        setattr(sys, name, Terminal(stream) if stream.isatty() else stream)
    try:
        code: int = command()
        sys.stdout.flush()
    except BrokenPipeError:  # the reader of the output, such as head, has closed it
        _to_nowhere()
        code = 1
    finally:
        sys.stderr.flush()
        sys.stdout, sys.stderr = before
    if output.failed:
        print(f"error: the output cannot be written: {output.failed}", file=sys.stderr)
    return code or int(bool(output.failed))


def interruptible(work: Callable[[], Any]) -> Any:
    """Result of a function with many imports; at Ctrl-C meanwhile the process ends with one word."""
    if signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        return work()
    signal.signal(signal.SIGINT, _end)
    try:
        return work()
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def _end(*_: object) -> None:
    os.write(2, b"interrupted\n")
    os._exit(128 + signal.SIGINT)


def _imported() -> Callable[[], int]:
    from tipfem.app.application import command

    return command


def _to_nowhere() -> None:
    """Discard what is still to be written to the output."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)


class Output:
    """The standard output, to which a command writes on, as on a full disk; ``failed`` is why it cannot, or ""."""

    def __init__(self, stream: Any) -> None:
        self._stream, self.failed = stream, ""

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        """Write a text."""
        return self._tried(lambda: self._stream.write(text)) or 0

    def flush(self) -> None:
        """Write what is kept."""
        self._tried(self._stream.flush)

    def _tried(self, write: Callable[[], Any]) -> Any:
        try:
            return write()
        except BrokenPipeError:
            raise
        except OSError as error:
            self.failed = error.strerror or str(error)
            _to_nowhere()
            return None
