"""A study file: a base case, and the values that its runs have in place of those of the base.

case = "dam_break.toml"             # relative to the study file
folder = "out/viscosity"            # relative to where the command runs; by default out/ and the file's name

[set]                               # for all runs
time.end = 0.2

[grid]                              # every combination is a run
fluids.water.viscosity = [1e-3, 2e-3, 5e-3]
tank.spacing = [0.01, 0.02]

[[runs]]                            # further runs, one by one
name = "thick"
fluids.water.viscosity = 0.1
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from tipfem.arguments import meant
from tipfem.casefile.describing import toml_value
from tipfem.casefile.loading import CaseFile, load_case, source_of, text_of
from tipfem.casefile.problems import CaseFileError, Problem
from tipfem.casefile.schema import json_schema
from tipfem.casefile.source import BARE, Source

KEYS = ("case", "folder", "set", "grid", "runs")
TABLES = ("study.csv", "study.parquet")  # beside the folders of the runs
MOST_RUNS = 10_000
_FILE_NAME = re.compile(r"[A-Za-z0-9_=+,.-]{1,100}")


@dataclass(frozen=True)
class Run:
    """One run of a study."""

    name: str  # of the run, and of its folder
    # by dotted keys, what it has in place of the values of the base; without those that all runs have
    values: Mapping[str, Any]
    file: CaseFile  # its case file, checked


@dataclass(frozen=True)
class Study:
    """A study that has been read and checked."""

    folder: Path  # for the results; each run has a folder of its own there
    runs: tuple[Run, ...]  # all of them, in the order of the file


def load_study(path: Path) -> Study:
    """Read a study file and check it, and the case of each run as far as that goes without particles.

    Raises:
        CaseFileError: there are mistakes; it has all of them.
    """
    source = source_of(text_of(path, "a study"), str(path))
    problems: list[Problem] = []

    def report(place: tuple[str | int, ...], text: str) -> None:
        line = source.line(place)
        problems.append(Problem(f"{path}:{line}" if place else str(path), place, text, line))

    base = _checked_base(source, path, report)
    described = list(_values_of_runs(source, report))
    if problems or base is None:
        raise CaseFileError(problems)
    runs: list[Run] = []
    seen: set[tuple[tuple[str | int, ...], str]] = set()
    common = dict(_flat(source.data.get("set", {})))
    for name, values in described:
        overrides = [f"{key}={toml_value(value)}" for key, value in {**common, **values}.items()]
        try:
            runs.append(Run(name, values, load_case(base, overrides)))
        except CaseFileError as error:
            for found in error.problems:  # a mistake that several runs share is told once
                if (key := (found.path, found.text)) not in seen:
                    seen.add(key)
                    of_study = found.where.startswith("--set ")
                    problems.append(replace(found, where=f"{path}, run {name!r}") if of_study else found)
    if problems:
        raise CaseFileError(problems)
    return Study(Path(source.data.get("folder") or f"out/{path.stem}"), tuple(runs))


Report = Callable[[tuple[str | int, ...], str], None]


def _checked_base(source: Source, path: Path, report: Report) -> Path | None:
    """The base case; mistakes of the whole file are reported."""
    data = source.data
    for key in data:
        if key not in KEYS:
            report((key,), f"is not a known key{meant(key, KEYS) or ';'} the keys here are {', '.join(KEYS)}")
    for key, kind, words in (
        ("case", str, "the path of a case file"),
        ("folder", str, "a folder for the results"),
        ("set", dict, "a table of dotted keys and values"),
        ("grid", dict, "a table of dotted keys and lists of values"),
        ("runs", list, "a list of tables [[runs]]"),
    ):
        if key in data and (not isinstance(data[key], kind) or data[key] == ""):
            report((key,), f"is {data[key]!r}; it must be {words}")
    if "case" not in data:
        report((), "case is missing; give the path of a case file, relative to the study")
    elif isinstance(data["case"], str) and not (path.parent / data["case"]).is_file():
        beside = sorted(other.name for other in path.parent.glob("*.toml"))
        report(("case",), f"is {data['case']!r}, and there is no such file{meant(data['case'], beside)}")
    elif isinstance(data["case"], str):
        return path.parent / data["case"]
    return None


def _values_of_runs(source: Source, report: Report) -> Iterator[tuple[str, dict[str, Any]]]:
    """Name and values of each run: the grid first, then the runs of the list."""
    data = source.data
    grid = data.get("grid") if isinstance(data.get("grid"), dict) else None
    listed = data.get("runs") if isinstance(data.get("runs"), list) else None
    if not grid and not listed:
        report((), "has neither a grid nor runs; give a table [grid] or tables [[runs]]")
        return
    axes = list(_flat(grid or {}))
    for key, values in axes:
        if not isinstance(values, list) or not values:
            report(("grid",), f"{key} is {values!r}; it must be a list of values, not empty")
            return
    count = 1
    for _, values in axes:
        count *= len(values)
    if count > MOST_RUNS:
        report(("grid",), f"has {count} combinations; there must be at most {MOST_RUNS}")
        return
    found: list[tuple[str, dict[str, Any]]] = []
    if axes:
        for combination in itertools.product(*(values for _, values in axes)):
            found.append(("", dict(zip((key for key, _ in axes), combination, strict=True))))
    for k, table in enumerate(listed or []):
        if not isinstance(table, dict):
            report(("runs", k), f"is {table!r}; it must be a table")
            return
        name = table.get("name", "")
        if "name" in table and not (isinstance(name, str) and _FILE_NAME.fullmatch(name) and name[0] != "."):
            report(("runs", k, "name"), f"is {name!r}; it names a folder and must be letters, digits and - _ = + , .")
            return
        if name in TABLES:
            report(("runs", k, "name"), f"is {name!r}; that is the file with the table of the study")
            return
        found.append((name, dict(_flat({key: value for key, value in table.items() if key != "name"}))))
    names: dict[str, int] = {}
    short = _short_keys([values for _, values in found])
    for k, (given, values) in enumerate(found):
        name = given or ",".join(f"{short[key]}={_word(value)}" for key, value in values.items()) or f"run_{k:03d}"
        if not _FILE_NAME.fullmatch(name):
            name = f"run_{k:03d}"
        if name in names:
            place = ("runs", k - (len(found) - len(listed or []))) if given else ("grid",)
            report(place, f"has two runs {name!r}; every run needs values, or a name, of its own")
        names[name] = k
        yield name, values


def _short_keys(runs: list[dict[str, Any]]) -> dict[str, str]:
    """The last part of each dotted key; all of it for names, as of fluids, or where two have the same last part."""
    keys = {key for values in runs for key in values}
    last = {key: key.rpartition(".")[2].strip('"') for key in keys}
    known = {name for table in json_schema()["$defs"].values() for name in table.get("properties", ())}
    known.update(json_schema()["properties"])
    short = [word for word in last.values() if word in known and list(last.values()).count(word) == 1]
    return {key: word if word in short else key for key, word in last.items()}


def _word(value: Any) -> str:
    return value if isinstance(value, str) else toml_value(value).replace(" ", "").replace("[", "").replace("]", "")


def _flat(table: Any, prefix: str = "") -> Iterator[tuple[str, Any]]:
    """The leaves of nested tables by dotted keys; a quoted key that has dots is taken as it is."""
    if not isinstance(table, Mapping):
        return
    for key, value in table.items():
        name = key if BARE.fullmatch(key) or (not prefix and "." in key) else f'"{key}"'
        path = f"{prefix}.{name}" if prefix else name
        if isinstance(value, Mapping) and value:
            yield from _flat(value, path)
        else:
            yield path, value
