"""The runs of a study, as its table has them."""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass
from pathlib import Path

from tipfem.render.viewer.series import PLOTTED, contents_in, title_of

from tipfem.results.tables import STUDY_TABLE, SUMMARY_FIGURES

MOST_RUNS = 50  # in a page
_OTHERS = ("run", "status", *SUMMARY_FIGURES)  # columns that are no values of runs
_GROUPS = ("figure.", "probe.", "last.")
_SHOWN = {"steps": "steps", "wall_seconds": "wall-clock time [s]"}


@dataclass(frozen=True)
class StudyRun:
    """One run of a study that has results."""

    folder: Path  # with the results
    values: dict[str, float | str]  # what it has in place of the values of the case, by their keys in the case file
    figures: dict[str, float]  # numbers at its end that differ from run to run, by what plots call them


def study_runs(folder: Path) -> list[StudyRun]:
    """The runs of a study that have results; none where the folder is not that of a study.

    Raises:
        ValueError: the table cannot be read, no run has results, or there are too many.
    """
    path = folder / STUDY_TABLE
    if not path.is_file():
        return []
    try:
        with open(path, encoding="utf-8", newline="") as file:
            rows = list(csv.DictReader(file))
    except (OSError, ValueError, csv.Error) as error:
        raise ValueError(f"{path}: it cannot be read: {error}") from None
    there = [row for row in rows if row.get("run") and (folder / row["run"] / "case.json").is_file()]
    if not there:
        raise ValueError(f"{path}: none of its {len(rows)} runs has results yet")
    if len(there) > MOST_RUNS:
        raise ValueError(f"{path}: {len(there)} runs have results; a page holds at most {MOST_RUNS}")
    keys = [key for key in rows[0] if key not in _OTHERS and not key.startswith(_GROUPS)]
    columns = sorted(rows[0], key=_SHOWN.__contains__)  # what the run took comes last
    contents = contents_in(folder / there[0]["run"])
    figures = {column: label for column in columns if (label := _label(column, contents)) and _differs(there, column)}
    return [
        StudyRun(
            folder / row["run"],
            {key: _value(row[key]) for key in keys if row[key]},
            {label: number for column, label in figures.items() if (number := _number(row[column])) is not None},
        )
        for row in there
    ]


def _label(column: str, contents: int) -> str | None:
    """Name of a column in plots; None for one that is not plotted."""
    group, _, name = column.partition(".")
    if group == "last" and name in PLOTTED:
        return str(title_of(name, contents))
    if group == "probe" and name.rpartition(".")[2].split(" [")[0] not in ("time", "step"):
        return name.replace(".", ": ", 1)
    return name if group == "figure" else _SHOWN.get(column)


def _differs(rows: list[dict[str, str]], column: str) -> bool:
    numbers = [number for row in rows if (number := _number(row[column])) is not None]
    return len(numbers) > 1 and min(numbers) < max(numbers)


def _value(text: str) -> float | str:
    number = _number(text)
    return text if number is None else number


def _number(text: str) -> float | None:
    try:
        number = float(text)
    except ValueError:
        return None
    return number if math.isfinite(number) else None
