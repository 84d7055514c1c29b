"""Changes of a case by commands to its run, by its steering.jsonl."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tipfem.case.fluid import Fluid, law_table
from tipfem.case.rheology import law_from
from tipfem.typing import Array

FILE = "steering.jsonl"


def commands_in(folder: Path, name: str) -> list[tuple[float, Mapping[str, Any]]]:
    """Commands of a name that a run was given: times [s] and values, in order; `ValueError` if it cannot be read."""
    path, found = folder / FILE, []
    try:
        lines = path.read_text(encoding="utf-8").splitlines() if path.is_file() else []
    except (OSError, UnicodeDecodeError) as error:
        raise ValueError(f"{path}: it cannot be read: {error}") from None
    for line in lines:
        try:
            record = json.loads(line)
            if record["command"] == name:
                found.append((float(record["time"]), record))
        except (KeyError, TypeError, ValueError, RecursionError) as error:
            raise ValueError(f"{path}: {line[:60]!r} is no command ({error})") from None
    return found


class Laws:
    """Laws of viscosity of the fluids of a run over time, by case.json and steering.jsonl, else `ValueError`."""

    def __init__(self, case: Mapping[str, Any], folder: Path) -> None:
        self._fluids = [dict(fluid) for fluid in case["fluids"]]
        self.any = any(isinstance(fluid.get("viscosity"), Mapping) for fluid in self._fluids)
        self._commands = commands_in(folder, "viscosity") if self.any else []

    def at(self, time: float) -> Array | None:
        """The table of `tipfem.case.fluid.law_table` at a time [s]; None where no fluid follows a law."""
        if not self.any:
            return None
        now = {fluid["name"]: fluid["viscosity"] for fluid in self._fluids}
        for when, record in self._commands:
            if when <= time:
                name, number, value = record["fluid"], record.get("number"), float(record["value"])
                now[name] = {**now[name], number: value} if number else value
        return law_table([Fluid(one["name"], one["density"], law_from(now[one["name"]])) for one in self._fluids])
