"""The command that compares a run with measured data."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
from cyclopts import Parameter

from tipfem.app.options import FilePath, Flag, printable, require_png
from tipfem.app.running import refusing
from tipfem.arguments import meant
from tipfem.typing import Array

if TYPE_CHECKING:
    from tipfem.results.comparison import Comparison
    from tipfem.results.reader import RunResults


@refusing
def compare(
    out: FilePath,
    /,
    *,
    data: Annotated[FilePath, Parameter(name="--with")],
    probe: str = "",
    column: str = "",
    fit_shift: Flag = False,
    picture: FilePath | None = None,
) -> None:
    """Compare what a run has computed over time with measured data: differences, and a figure.

    Args:
        out: The results folder.
        data: A CSV file of two columns in SI units, times and values; a line of names may stand first.
        probe: The probe whose values are compared; by default the columns of history.csv are.
        column: Which of its columns; it can be left out where there is one only.
        fit_shift: Shift the data in time to where it fits best.
        picture: A PNG file for a figure of both; it takes tipfem[plot].
    """
    from tipfem.casefile.forms import read_table
    from tipfem.results.comparison import compared
    from tipfem.results.reader import read_results

    require_png(picture, "compare.png")
    times, values = read_table(data, None)
    if isinstance(values[0], tuple):
        raise ValueError(f"{str(data)!r} has {len(values[0]) + 1} columns; give one with times and values alone")
    name, unit, time, computed = _history(read_results(out), probe, column)
    try:
        found = compared(time, computed, np.array(times), np.array(values), fit_shift=fit_shift)
    except ValueError as error:
        raise ValueError(f"{data}: {error}") from None
    for line in _lines(found, name, unit):
        print(printable(line))
    if picture is not None:
        _draw(picture, found, (time, computed), f"{name} [{unit}]" if unit else name)
        print(f"picture     {picture}")


def _history(results: RunResults, probe: str, column: str) -> tuple[str, str, Array, Array]:
    """Name, unit, times (N,) [s] and values (N,) of a column; see `compare` for errors."""
    where = "history.csv"
    table = results.history
    if probe:
        if probe not in results.probes:
            names = ", ".join(results.probes) or "none"
            raise ValueError(f"--probe is {probe!r}; the probes are: {names}{meant(probe, list(results.probes))}")
        table, where = results.probes[probe], f"probe {probe!r}"
    if not table.rows:
        raise ValueError(f"{where} of {results.folder} has no rows yet")
    columns = [name for name in table if name not in ("time", "step")]
    if not column and len(columns) == 1:
        column = columns[0]
    if column not in columns:
        what = f"has no column {column!r}" if column else "has several columns; say which with --column"
        raise ValueError(f"{where} {what}: {', '.join(columns)}{meant(column, columns) if column else ''}")
    there = np.isfinite(table[column])
    if there.sum() < 2:
        raise ValueError(f"column {column!r} of {where} has fewer than two values")
    return (
        column if probe in ("", column) else f"{probe} {column}",
        table.units.get(column, ""),
        table["time"][there],
        table[column][there],
    )


def _lines(found: Comparison, name: str, unit: str) -> list[str]:
    """Output of the command for a comparison."""
    difference, span = found.difference, float(np.ptp(found.measured))
    worst = int(np.argmax(np.abs(difference)))
    share = f", {100 * found.rms / span:.2g} % of the data's range" if span > 0 else ""
    lines = [
        f"compared    {name}, {len(found.time)} values from {found.time[0]:g} s to {found.time[-1]:g} s",
        f"rms         {found.rms:.4g} {unit}{share}",
        f"mean        {difference.mean():+.4g} {unit}, computed less measured",
        f"largest     {difference[worst]:+.4g} {unit} at {found.time[worst]:g} s",
        f"correlation {found.correlation:.4f}",
    ]
    return lines if found.shift == 0 else [*lines, f"shift       {found.shift:+.4g} s, added to the times of the data"]


def _draw(path: Path, found: Comparison, history: tuple[Array, Array], label: str) -> None:
    """Draw a history with the data; see `compare`."""
    from tipfem.demos.support.figures import BLUE, VERMILION, new_figure

    try:
        figure = new_figure(7.0, 4.2)
    except ImportError:
        raise ValueError("--picture takes Matplotlib: pip install 'tipfem[plot]'") from None
    axes = figure.add_subplot()
    axes.plot(*history, color=BLUE, label="computed")
    axes.plot(found.time, found.measured, "o", color=VERMILION, markersize=4, fillstyle="none", label="measured")
    axes.set_xlabel("time [s]")
    axes.set_ylabel(label)
    axes.grid(alpha=0.3)
    axes.legend()
    try:
        figure.savefig(path)
    except OSError as error:
        raise ValueError(f"the picture {str(path)!r} cannot be written ({error.strerror})") from error
