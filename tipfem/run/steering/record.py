"""steering.jsonl: the commands that changed the physics of a run, one JSON object a line, in the order of steps.

    {"step": 120, "time": 0.31, "command": "gravity", "value": [1.7, -9.66]}

``step`` is the number of steps that were taken before the command; the next one is the first with it. ``time`` [s] and
``effect``, what a drop changed, are for readers; a replay does not use them.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tipfem.arguments import brief, is_number
from tipfem.run.steering.commands import Command, command_from

FILE = "steering.jsonl"


@dataclass(frozen=True)
class Record:
    """A command at its step."""

    step: int  # number of steps taken before it
    command: Command  # the command
    time: float = field(default=float("nan"), compare=False)  # simulated time [s]; NaN where a file does not say it
    # what it changed at once: volumes, energy, momentum
    effect: Mapping[str, Any] | None = field(default=None, compare=False)

    def line(self) -> str:
        """The record as a line of the file."""
        content: dict[str, Any] = {"step": self.step}
        if self.time == self.time:
            content["time"] = self.time
        content |= {"command": self.command.name, **self.command.values()}
        if self.effect:
            content["effect"] = dict(self.effect)
        return json.dumps(content)

    @staticmethod
    def parse(line: str) -> Record:
        """The record of a line; `ValueError` if it is none."""
        try:
            content = json.loads(line)
        except (ValueError, RecursionError):
            raise ValueError(f"{line[:60]!r} is not JSON") from None
        if not isinstance(content, dict):
            raise ValueError(f"{line[:60]!r} is no JSON object")
        step, name = content.pop("step", None), content.pop("command", None)
        time, effect = content.pop("time", None), content.pop("effect", None)
        if not isinstance(step, int) or isinstance(step, bool) or step < 0:
            raise ValueError(f"step is {brief(step)}; it must be a whole number, 0 or more")
        if time is not None and not is_number(time):
            raise ValueError(f"time is {brief(time)}; it must be a number, in s")
        if not isinstance(name, str):
            raise ValueError(f"command is {brief(name)}; it must be the name of a command")
        command = command_from(name, content)
        if not command.physical:
            raise ValueError(f"command is {brief(name)}, which does not change the physics; it cannot be repeated")
        return Record(step, command, math.nan if time is None else float(time), effect)


def read_records(path: str | Path) -> list[Record]:
    """The commands of a steering file, without a last line that has no end, of a run that was killed.

    `ValueError`, with the number of the line, if it cannot be read, or a line is no record.
    """
    try:
        text = Path(path).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "it is no text"
        raise ValueError(f"steering: {str(path)!r} cannot be read ({reason})") from error
    lines = text.split("\n")
    records: list[Record] = []
    for number, line in enumerate(lines, start=1):
        if not line.strip():
            continue
        try:
            record = Record.parse(line)
        except ValueError as error:
            if number == len(lines):
                break
            raise ValueError(f"{path}, line {number}: {error}") from None
        if records and record.step < records[-1].step:
            raise ValueError(f"{path}, line {number}: step is {record.step}, before the {records[-1].step} above it")
        records.append(record)
    return records
