"""Openings of case files: from their tables to `tipfem.Inlet`, `tipfem.Outlet` and `tipfem.Vent`, and back."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from tipfem.arguments import numbers
from tipfem.case.fluid import Fluid
from tipfem.case.openings import Inlet, Opening, Outlet, Vent
from tipfem.casefile.problems import listed, meant
from tipfem.casefile.source import Path

KINDS: dict[str, Callable[..., Opening]] = {"inlets": Inlet, "outlets": Outlet, "vents": Vent}
OF_TIME = ("discharge", "velocity", "level")


def read_openings(
    sections: Mapping[str, Any],
    fluids: Sequence[str],
    function: Callable[[Path, Any, int], Any],
    made: Callable[..., Any],
    report: Callable[[Path, str], None],
) -> list[Opening]:
    """The openings that tables describe; their mistakes are reported.

    Args:
        sections: of the case file.
        fluids: names of its fluids.
        function: checks a function of time at a path, whose values have a number of coordinates.
        made: makes an object at a path, or reports why it cannot be made.
        report: takes the path of a mistake and what is wrong.
    """
    found = []
    for kind, make in KINDS.items():
        for k, table in enumerate(sections.get(kind) or []):
            if table is None:
                continue
            path: Path = (kind, k)
            options, right = {key: getattr(table, key) for key in table.model_fields_set}, True
            for key in OF_TIME:
                if callable(options.get(key)):
                    options[key] = function((*path, key), options[key], 0)
                    right &= options[key] is not None
            name = options.get("fluid")
            if name is not None and name not in fluids:
                report((*path, "fluid"), f"is {name!r}; the fluids are {listed(fluids)}{meant(name, fluids)}")
                right = False
            opening = made(path, make, **options) if right else None
            if opening is not None:
                found.append(opening)
    return found


def opening_name(kind: str, table: Any) -> str:
    """Name of the opening that a table describes, by default of its wall; empty for tables of other kinds."""
    return "" if kind not in KINDS else table.name or (f"{kind[:-1]}_{table.wall}" if table.wall else kind[:-1])


def opening_content(
    opening: Opening, function: Callable[[str, Any], Any], lost: Callable[[str, str], str]
) -> dict[str, Any]:
    """The table of an opening; values that have their defaults are left out.

    Args:
        opening: of a case.
        function: makes a value of the file of a function of time, which has a name for messages.
        lost: makes a value of the file for a part that it cannot keep, for a reason.
    """
    content: dict[str, Any] = {}
    for field in dataclasses.fields(opening):
        value, part = getattr(opening, field.name), f"{opening.kind}s.{opening.name}.{field.name}"
        if value is None or value == field.default or (field.name == "fluid" and value == ""):
            continue
        if isinstance(value, Fluid):
            value = value.name
        elif callable(value) and field.name in OF_TIME:
            value = function(part, value)
        elif callable(value):
            value = lost(part, "a function of place")
        elif field.name == "between":
            value = np.asarray(numbers(value)).tolist()
        content[field.name] = value
    return content
