"""Sampling of probes during a run."""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tipfem.case.case import Case
from tipfem.probes.probe import Probe, Sampled
from tipfem.typing import Array


class ProbeRecorder:
    """Samples probes as a run goes on, keeps their values, and writes each to ``probes/NAME.csv``.

    Args:
        probes: what to measure.
        case: what they measure it of.
        folder: the results folder, or None to keep the values in memory only.

    Raises:
        ValueError: a probe does not fit the case, or two have the same name.
    """

    def __init__(self, probes: Sequence[Probe], case: Case, folder: Path | None = None) -> None:
        wrong = [probe for probe in probes if not isinstance(probe, Probe)]
        if wrong:
            raise ValueError(f"Simulation: probes holds {wrong[0]!r}; it must be a list of probes, as tp.PointProbe")
        names = [probe.name for probe in probes]
        if len(set(names)) < len(names):
            raise ValueError(f"Simulation: probes are named {names}; every probe needs a name of its own")
        self.probes = {probe.name: probe for probe in probes}
        self.columns = {probe.name: [("time", "s"), *probe.columns(case)] for probe in probes}
        self.rows: dict[str, list[list[float]]] = {name: [] for name in self.probes}
        self._due = dict.fromkeys(self.probes, 0)
        self._folder = folder

    def __getitem__(self, name: str) -> dict[str, Array]:
        """The samples of a probe so far: arrays (K,) by column, ``time`` [s] first.

        Raises:
            KeyError: there is no probe of that name.
        """
        if name not in self.probes:
            raise KeyError(f"there is no probe {name!r}; there are {list(self.probes)}")
        columns = [column for column, _ in self.columns[name]]
        return dict(zip(columns, np.array(self.rows[name], dtype=float).reshape(-1, len(columns)).T, strict=True))

    def record(self, simulation: Sampled) -> None:
        """Sample the probes that are due at the present time, and write their values.

        Raises:
            OSError: a file cannot be written.
        """
        for name, probe in self.probes.items():
            if probe.interval is not None:
                count = math.floor(simulation.time / probe.interval * (1 + 1e-12) + 1e-9)
                if count < self._due[name]:
                    continue
                self._due[name] = count + 1
            row = [simulation.time, *probe.sample(simulation)]
            self.rows[name].append(row)
            if self._folder is not None:
                self._write(name, row)

    def _write(self, name: str, row: list[float]) -> None:
        assert self._folder is not None
        path = self._folder / f"{name}.csv"
        first = len(self.rows[name]) == 1
        if first:
            self._folder.mkdir(parents=True, exist_ok=True)
        with open(path, "w" if first else "a", encoding="utf-8", newline="") as file:
            lines = csv.writer(file, lineterminator="\n")
            if first:
                lines.writerow([f"{column} [{unit}]" for column, unit in self.columns[name]])
            lines.writerow([repr(float(value)) for value in row])
