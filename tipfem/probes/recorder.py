"""Sampling of probes during a run."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from tipfem.case.case import Case
from tipfem.probes.impulses import LoadProbe, means_of
from tipfem.probes.probe import Probe, Sampled
from tipfem.typing import Array

if TYPE_CHECKING:
    from tipfem.fem.time_integration import TimeScheme  # which starts Taichi


class Results(Protocol):
    """Where samples are written."""

    def append_rows(self, name: str, header: Sequence[str], rows: Sequence[Sequence[float]]) -> None:
        """Add rows to a table; a new one begins with its header."""

    def replace_rows(self, name: str, header: Sequence[str], rows: Sequence[Sequence[float]]) -> None:
        """Write a table anew."""


class ProbeRecorder:
    """Samples probes as a run goes on, keeps their values, and writes each to ``probes/NAME.csv`` of a results folder.

    Args:
        probes: what to measure.
        case: what they measure it of.

    Raises:
        ValueError: a probe does not fit the case, or two have the same name.
    """

    def __init__(self, probes: Sequence[Probe], case: Case) -> None:
        if isinstance(probes, Probe):
            raise ValueError(f"Simulation: probes is {probes}; it must be a list of probes, with one too")
        if not isinstance(probes, Sequence) or isinstance(probes, str):
            raise ValueError(f"Simulation: probes is {probes!r}; it must be a list of probes, as tp.PointProbe")
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
        self._means = {name: means for name, probe in self.probes.items() if (means := means_of(probe, case))}
        self._results: Results | None = None

    def __getitem__(self, name: str) -> dict[str, Array]:
        """The samples of a probe so far: arrays (K,) by column, ``time`` [s] first.

        Raises:
            KeyError: there is no probe of that name.
        """
        if name not in self.probes:
            raise KeyError(f"there is no probe {name!r}; there are {list(self.probes)}")
        columns = [column for column, _ in self.columns[name]]
        return dict(zip(columns, np.array(self.rows[name], dtype=float).reshape(-1, len(columns)).T, strict=True))

    def record(self, simulation: Sampled, scheme: TimeScheme) -> None:
        """Sample the probes that are due at the present time, and write their values; to be called after every step.

        Args:
            simulation: at the end of the step.
            scheme: time integration that the step was taken with.

        Raises:
            OSError: a file cannot be written.
        """
        for name, probe in self.probes.items():
            means = self._means.get(name)
            values = None
            if means is not None:
                values = probe.sample(simulation)
                means.add(simulation.time, values, scheme)
            if probe.interval is not None:
                count = _multiples(simulation.time, probe.interval)
                if count < self._due[name]:
                    continue
                self._due[name] = count + 1
            row = [simulation.time, *(probe.sample(simulation) if values is None else values)]
            if means is not None and isinstance(probe, LoadProbe):
                row += probe.averaged(means)
            self.rows[name].append(row)
            if self._results is not None:
                self._results.append_rows(_file(name), self._header(name), [row])

    def write_to(self, results: Results) -> None:
        """Write into a results folder from now on; what has been sampled so far replaces what its files hold.

        Raises:
            OSError: a file cannot be written.
        """
        self._results = results
        for name, rows in self.rows.items():
            if rows:
                results.replace_rows(_file(name), self._header(name), rows)

    def content(self) -> dict[str, Any]:
        """All samples so far, and what the next ones depend on, for a checkpoint."""
        content: dict[str, Any] = {}
        for name, rows in self.rows.items():
            content[name] = {"due": self._due[name], "rows": np.array(rows)}
            if name in self._means:
                content[name]["means"] = self._means[name].content()
        return content

    def go_on(self, content: Mapping[str, Any]) -> None:
        """Take over the samples of a checkpoint, see `content`."""
        for name, probe in content.items():
            self.rows[name], self._due[name] = probe["rows"].tolist(), probe["due"]
            if name in self._means:
                self._means[name].go_on(probe["means"])

    def begin(self, name: str, time: float, *, afresh: bool) -> None:
        """Let a probe of a run that goes on have an interval that it did not have, or be added to it.

        Args:
            name: of the probe.
            time: the present time [s]; the next multiple of the interval after it is the next that is sampled.
            afresh: whether it is added, so that its integrals over time begin now.
        """
        interval = self.probes[name].interval
        if interval is not None:
            self._due[name] = _multiples(time, interval) + 1
        if afresh and name in self._means:
            self._means[name].time = time

    def _header(self, name: str) -> list[str]:
        return [f"{column} [{unit}]" for column, unit in self.columns[name]]


def _multiples(time: float, interval: float) -> int:
    """How many whole intervals [s] a time has [s]."""
    return math.floor(time / interval * (1 + 1e-12) + 1e-9)


def _file(name: str) -> str:
    return f"probes/{name}.csv"
