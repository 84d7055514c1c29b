"""The table of a study: a row a run, with its values and figures."""

from __future__ import annotations

import csv
import json
from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from tipfem.arguments import is_number
from tipfem.results.tables import STUDY_TABLE, SUMMARY_FIGURES, last_row
from tipfem.results.whole_file import replaced


def status_of(folder: Path, end: float) -> str:
    """Progress of a run to ``end`` [s]: "complete", "not started", "stopped", or the end in its summary."""
    summary = _json(folder / "summary.json")
    time = summary.get("time")
    if summary.get("status") == "complete" and is_number(time) and float(time or 0.0) >= end:
        return "complete"
    if summary.get("status") not in (None, "complete"):
        return str(summary["status"])
    return "stopped" if (folder / "history.csv").exists() else "not started"


def figures_of(folder: Path) -> dict[str, Any]:
    """Figures of a run: of its summary, the last row of its history, and the last values of its probes."""
    summary = _json(folder / "summary.json")
    figures = {key: summary[key] for key in SUMMARY_FIGURES if key in summary}
    validation = summary.get("validation")
    if isinstance(validation, Mapping):
        figures.update({f"figure.{key}": value for key, value in validation.items()})
    last = last_row(folder / "history.csv")
    figures.update({f"last.{key}": value for key, value in last.items() if key not in ("time", "wall_seconds")})
    for path in sorted((folder / "probes").glob("*.csv")):
        figures.update({f"probe.{path.stem}.{key}": value for key, value in last_row(path).items()})
    return figures


def write_table(folder: Path, rows: Sequence[Mapping[str, Any]]) -> list[Path]:
    """Write study.csv, a row per run, and study.parquet where pandas and pyarrow are installed; returns both paths."""
    columns = list(dict.fromkeys(key for row in rows for key in row))
    path = folder / STUDY_TABLE
    with replaced(path) as temporary, open(temporary, "w", encoding="utf-8", newline="") as file:
        lines = csv.DictWriter(file, columns, lineterminator="\n")
        lines.writeheader()
        lines.writerows(rows)
    if find_spec("pandas") is None or find_spec("pyarrow") is None:
        return [path]
    import pandas as pd

    parquet = path.with_suffix(".parquet")
    with replaced(parquet) as temporary:
        pd.read_csv(path).to_parquet(temporary, engine="pyarrow")
    return [path, parquet]


def _json(path: Path) -> dict[str, Any]:
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return {}
    return content if isinstance(content, dict) else {}
