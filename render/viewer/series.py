"""Numbers over time beside the picture: those that probes have recorded, and some of the run's history."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np

from tipfem.results.history_columns import contents_of, history_columns
from tipfem.results.tables import Table

MOST_SAMPLES = 300  # of a number
MOST_BYTES = 50_000_000  # of a file, which is read at once
# Columns of the history that are plotted, and what they are called; "front" is one of the demos' own.
PLOTTED = {
    "kinetic_energy": "kinetic energy",
    "wall_force_x": "force of the walls, x",
    "wall_force_y": "force of the walls, y",
    "wall_force_z": "force of the walls, z",
    "front": "front [m]",
}


def series_of(folder: Path, most: int = MOST_SAMPLES) -> list[dict[str, Any]]:
    """Time series that a run, maybe unfinished, has recorded: name, times [s] and at most so many values each."""
    found, contents = [], contents_in(folder)
    for path in [folder / "history.csv", *sorted((folder / "probes").glob("*.csv"))]:
        try:
            table = Table.read(path) if path.stat().st_size <= MOST_BYTES else Table({})
        except (OSError, ValueError, csv.Error):  # it is no text of ours
            continue
        if table.rows < 2 or "time" not in table:
            continue
        kept = np.unique(np.linspace(0, table.rows - 1, min(table.rows, most)).round().astype(int))
        times, own = [float(f"{time:.5g}") for time in table["time"][kept]], path.stem != "history"
        for name in table:
            if name in ("time", "step") or not (own or name in PLOTTED):
                continue
            values = [float(f"{value:.4g}") if np.isfinite(value) else None for value in table[name][kept]]
            title = f"{name} [{table.units[name]}]" if name in table.units else name
            shown = f"{path.stem}: {title}" if own else title_of(name, contents)
            found.append({"name": shown, "times": times, "values": values})
    return found


def title_of(name: str, contents: int) -> str:
    """Name and unit of one of the columns in `PLOTTED`, in runs of these contents, see `contents_of`."""
    known = history_columns([name], contents, ())
    return f"{PLOTTED[name]} [{known[name].unit}]" if name in known else PLOTTED[name]


def contents_in(folder: Path) -> int:
    """See `contents_of`; of the plane where there is no case.json."""
    try:
        case = json.loads((folder / "case.json").read_text("utf-8"))
    except (OSError, ValueError):
        case = {}
    return contents_of(int(case.get("dimension", 2)), case.get("coordinates", "planar"))
