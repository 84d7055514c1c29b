"""Tables of named columns, as runs write them to CSV files."""

from __future__ import annotations

import csv
import html
import importlib
import io
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from tipfem.typing import Array

STUDY_TABLE = "study.csv"  # in the folder of a study: a row per run
SUMMARY_FIGURES = ("time", "steps", "wall_seconds", "particles")  # of the summary of a run, which are columns there
_SHOWN = 5  # rows that a notebook shows


class Table(Mapping[str, Array]):
    """Columns (K,) by name; a mapping, ``table["time"]``.

    Args:
        columns: NumPy arrays of one length.
        units: of columns, by their names; those without one are not in it.
        name: what the table is, for messages.
        of_step: names of the columns that have what happened in a step, so that the sum over the rows is of the run;
            the others have values at the end of the step.
    """

    def __init__(
        self,
        columns: Mapping[str, Array],
        units: Mapping[str, str] | None = None,
        name: str = "",
        of_step: Iterable[str] = (),
    ) -> None:
        self._columns = dict(columns)
        self.units, self.of_step = dict(units or {}), tuple(of_step)
        self.name = name

    @classmethod
    def read(cls, path: Path) -> Table:
        """The table in a CSV file; units stand in brackets behind names: ``force_x [N/m]``.

        A last line that is not whole, of a run that is writing it or was killed, is left out. A file that is not there
        is a table without columns.

        Raises:
            ValueError: the file cannot be read; the message names it.
        """
        try:
            text = path.read_bytes().decode("utf-8")
        except FileNotFoundError:
            return cls({}, name=path.name)
        except (OSError, UnicodeDecodeError) as error:
            raise ValueError(f"{path}: it cannot be read: {error}") from None
        text = text[: text.rfind("\n") + 1]
        header, *rows = list(csv.reader(io.StringIO(text, newline=""))) or [[]]
        names, units = [], {}
        for title in header:
            name, bracket, unit = title.partition(" [")
            names.append(name if bracket and unit.endswith("]") else title)
            if bracket and unit.endswith("]"):
                units[name] = unit[:-1]
        for number, row in enumerate(rows, start=1):
            if len(row) != len(header):
                text = f"{path}: row {number} has {len(row)} values; it must have {len(header)}, as the header"
                raise ValueError(text)
        columns = {}
        for place, name in enumerate(names):
            values = [row[place] for row in rows]
            try:
                columns[name] = np.array([int(value) for value in values], dtype=np.int64)
            except ValueError:
                try:
                    columns[name] = np.array([float(value) for value in values])
                except ValueError as error:
                    raise ValueError(f"{path}: column {name!r} has a value that is no number: {error}") from None
        return cls(columns, units, path.name)

    def __getitem__(self, name: str) -> Array:
        """A column (K,); `KeyError` if there is none of that name."""
        try:
            return self._columns[name]
        except KeyError:
            raise KeyError(f"{self.name} has no column {name!r}; it has {', '.join(self._columns) or 'none'}") from None

    def __iter__(self) -> Iterator[str]:
        return iter(self._columns)

    def __len__(self) -> int:
        return len(self._columns)

    @property
    def rows(self) -> int:
        """Number of rows."""
        return len(next(iter(self._columns.values()))) if self._columns else 0

    def to_pandas(self) -> Any:
        """The table as a `pandas.DataFrame`, ``units`` and ``of_step`` in ``attrs``; `ImportError` without pandas."""
        frame = package("pandas", "to_pandas").DataFrame(self._columns)
        frame.attrs |= {"units": self.units, "of_step": self.of_step}
        return frame

    def to_xarray(self) -> Any:
        """The table as an `xarray.Dataset` over time, units in variables' ``attrs``; `ImportError` without xarray."""
        xarray = package("xarray", "to_xarray")
        over = "time" if "time" in self._columns else "row"
        variables = {
            name: (over, values, {"units": self.units[name]} if name in self.units else {})
            for name, values in self._columns.items()
        }
        return xarray.Dataset(variables)

    def __repr__(self) -> str:
        return f"Table {self.name}: {self.rows} rows, columns {', '.join(self._columns) or 'none'}"

    def _repr_html_(self) -> str:
        """The last rows, for notebooks."""
        titles = [f"{name} [{self.units[name]}]" if name in self.units else name for name in self._columns]
        head = "".join(f"<th>{html.escape(title)}</th>" for title in titles)
        body = "".join(
            f"<tr>{''.join(f'<td>{column[row]:.6g}</td>' for column in self._columns.values())}</tr>"
            for row in range(max(0, self.rows - _SHOWN), self.rows)
        )
        count = f"{self.rows} rows" + (f", the last {_SHOWN}:" if self.rows > _SHOWN else "")
        return (
            f"<p>{html.escape(self.name)}: {count}</p>"
            f'<div style="overflow-x: auto"><table><tr>{head}</tr>{body}</table></div>'
        )


def last_row(path: Path) -> dict[str, str]:
    """The last row of a CSV file that is whole, by column; empty where there is none."""
    last: dict[str, str] = {}
    with suppress(OSError, ValueError, csv.Error), open(path, encoding="utf-8", newline="") as file:
        for row in csv.DictReader(file):
            if None not in row.values():
                last = row
    return last


def package(name: str, method: str) -> Any:
    """A package that a method needs and tipfem does not; `ImportError` if it is not installed."""
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise ImportError(f"{method} needs {name}, which is not installed: pip install {name}") from error
