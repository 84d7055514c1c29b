"""The log of tipfem: Python's logger "tipfem", which prints nothing unless a program lets it.

Records of runs carry an event and figures besides their message, so that programs can read them: `log_json` writes all
of it, one JSON object a line. The levels are:

- DEBUG: every step, every step that was refused and why, every file of fields and checkpoint.
- INFO: begin, progress and end of a run.
- WARNING: what may make results worse or was not as expected, but did not stop the run.
- ERROR: the run has stopped.
"""

from __future__ import annotations

import json
import logging
import math
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from datetime import datetime, timezone
from pathlib import Path
from typing import Any, Literal

LogLevel = Literal["debug", "info", "warning", "error"]
LOGGER = logging.getLogger("tipfem")
LOGGER.addHandler(logging.NullHandler())
LEVELS = {logging.DEBUG: "debug", logging.INFO: "info", logging.WARNING: "warning", logging.ERROR: "error"}


def log(level: int, event: str, message: str, figures: Mapping[str, Any] | None = None) -> None:
    """Log an event: a level of `logging`, a word for programs as "step", a line for people, and figures in SI units."""
    LOGGER.log(level, "%s", message, extra={"event": event, "figures": figures or {}})


def logs(level: int) -> bool:
    """Whether anything listens to records of a level."""
    return LOGGER.isEnabledFor(level)


def listened() -> bool:
    """Whether a program has chosen what becomes of the log."""
    return logs(logging.INFO) or any(not isinstance(handler, logging.NullHandler) for handler in LOGGER.handlers)


class JsonLines(logging.Handler):
    """Writes records as lines of JSON: timestamp (ISO 8601, UTC), level, event, message, and the event's figures.

    A file that is there is continued; `OSError` if it cannot be opened.
    """

    def __init__(self, path: str | Path) -> None:
        super().__init__()
        self._file = open(path, "a", encoding="utf-8")

    def emit(self, record: logging.LogRecord) -> None:
        """Write a record, and flush it."""
        try:
            content = {
                "timestamp": datetime.fromtimestamp(record.created, timezone.utc).isoformat(timespec="milliseconds"),
                "level": LEVELS.get(record.levelno, record.levelname.lower()),
                "event": getattr(record, "event", "message"),
                "message": record.getMessage(),
                **{name: _plain(value) for name, value in getattr(record, "figures", {}).items()},
            }
            self._file.write(json.dumps(content) + "\n")
            self._file.flush()
        except Exception:  # a full disk must not stop the run, as with all handlers of logging
            self.handleError(record)

    def close(self) -> None:
        """Close the file."""
        self._file.close()
        super().close()


@contextmanager
def log_json(path: str | Path, level: LogLevel = "debug") -> Iterator[None]:
    """Write the log of what is done in the block to a file, one JSON object a line; see `JsonLines`.

    Args:
        path: of the file, which is continued if it is there.
        level: lowest level that is written; by default every step has a line.

    Raises:
        ValueError: the file cannot be written, or there is no such level.
    """
    number = _number(level)
    try:
        handler = JsonLines(path)
    except OSError as error:
        raise ValueError(f"log_json: {str(path)!r} cannot be written ({error.strerror}); name another file") from error
    with _listening(handler, number):
        yield


@contextmanager
def log_lines(level: LogLevel = "info") -> Iterator[None]:
    """Print the log of the block to the error output, from a level on; `ValueError` if there is no such one."""
    number = _number(level)
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(logging.Formatter("%(message)s"))
    with _listening(handler, number):
        yield


def _number(level: str) -> int:
    """The number of a level by its name."""
    numbers = {name: number for number, name in LEVELS.items()}
    if level not in numbers:
        raise ValueError(f"log: level is {level!r}; it must be one of {list(numbers)}")
    return numbers[level]


@contextmanager
def _listening(handler: logging.Handler, level: int) -> Iterator[None]:
    before = LOGGER.level
    handler.setLevel(level)
    LOGGER.addHandler(handler)
    LOGGER.setLevel(min(level, LOGGER.getEffectiveLevel()))
    try:
        yield
    finally:
        LOGGER.setLevel(before)
        LOGGER.removeHandler(handler)
        handler.close()


def _plain(value: Any) -> Any:
    """A value that JSON has: no NumPy types, and null for what is not finite."""
    if hasattr(value, "item"):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value
