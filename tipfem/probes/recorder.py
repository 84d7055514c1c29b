"""Sampling of probes during a run."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from tipfem.case.axisymmetric import refuses_probe
from tipfem.case.case import Case
from tipfem.errors import Invalid
from tipfem.probes.impulses import LoadProbe, means_of
from tipfem.probes.probe import Probe
from tipfem.step.observer import Observer
from tipfem.typing import Array

if TYPE_CHECKING:
    from tipfem.results.output import ResultsFolder
    from tipfem.step.stepper import Row, Stepper  # which starts Taichi


class ProbeRecorder(Observer, Mapping[str, dict[str, Array]]):
    """Samples probes as a run goes on, keeps their values, and writes each to ``probes/NAME.csv`` of the results."""

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
        for probe in probes:
            if refuses_probe(case, type(probe).__name__):
                raise Invalid(("probes", probe.name), ": it does not measure axisymmetric flows", str(probe))
        self.probes = {probe.name: probe for probe in probes}
        self.columns = {probe.name: [("time", "s"), *probe.columns(case)] for probe in probes}
        for name, columns in self.columns.items():
            twice = [column for column, count in Counter(column for column, _ in columns).items() if count > 1]
            if twice:
                text = f"would have two columns {twice[0]!r}; rename what they are named after"
                raise ValueError(f"Simulation: probe {name!r} {text}")
        self.rows: dict[str, list[list[float]]] = {name: [] for name in self.probes}
        self._due = dict.fromkeys(self.probes, 0)
        self._means = {name: means for name, probe in self.probes.items() if (means := means_of(probe, case))}
        self._results: ResultsFolder | None = None

    def __getitem__(self, name: str) -> dict[str, Array]:
        """The samples of a probe so far: arrays (K,) by column, ``time`` [s] first; `KeyError` if there is none."""
        if name not in self.probes:
            raise KeyError(f"there is no probe {name!r}; there are {list(self.probes)}")
        columns = [column for column, _ in self.columns[name]]
        return dict(zip(columns, np.array(self.rows[name], dtype=float).reshape(-1, len(columns)).T, strict=True))

    def __eq__(self, other: object) -> bool:
        return self is other

    __hash__ = Observer.__hash__

    def __iter__(self) -> Iterator[str]:
        """The names of the probes."""
        return iter(self.probes)

    def __len__(self) -> int:
        """Number of probes."""
        return len(self.probes)

    def after_step(self, flow: Stepper, row: Row) -> None:
        """Sample the probes that are due at the end of a step, and write them; `OSError` if that cannot be."""
        assert flow.solved is not None
        for name, probe in self.probes.items():
            means = self._means.get(name)
            values = None
            if means is not None:
                values = probe.sample(flow)
                means.add(flow.time, values, flow.solved.scheme)
            if probe.interval is not None:
                count = _multiples(flow.time, probe.interval)
                if count < self._due[name]:
                    continue
                self._due[name] = count + 1
            sampled = [[flow.time, *each] for each in (probe.rows(flow) if values is None else [values])]
            if means is not None and isinstance(probe, LoadProbe):
                sampled[0] += probe.averaged(means)
            width = len(self.columns[name]) - 1
            for line in sampled:
                if len(line) - 1 != width:
                    text = f"{probe} has measured {len(line) - 1} values for its {width} columns; "
                    raise ValueError(f"{text}one for each is needed")
            self.rows[name] += sampled
            if self._results is not None and sampled:
                self._results.append_rows(_file(name), self._header(name), sampled)

    def write_to(self, results: ResultsFolder) -> None:
        """Write into a results folder from now on, replacing what its files hold; `OSError` if that cannot be."""
        self._results = results
        for name, rows in self.rows.items():
            if rows:
                results.replace_rows(_file(name), self._header(name), rows)

    def content(self) -> dict[str, Any]:
        """All samples so far, and what the next ones depend on, for a checkpoint."""
        content: dict[str, Any] = {}
        for name, rows in self.rows.items():
            content[name] = {"due": self._due[name], "interval": self.probes[name].interval, "rows": np.array(rows)}
            if name in self._means:
                content[name]["means"] = self._means[name].content()
        return content

    def restore(self, content: Mapping[str, Any], time: float) -> None:
        """Take over the samples of a checkpoint, see `content`; a probe that it does not have begins now.

        Of an interval that has changed, its next multiple after ``time`` [s] is sampled.
        """
        for name, probe in self.probes.items():
            before, means = content.get(name), self._means.get(name)
            if before is not None:
                self.rows[name], self._due[name] = before["rows"].tolist(), before["due"]
                if means:
                    means.go_on(before["means"])
            elif means:
                means.time = time
            if probe.interval is not None and (before is None or before["interval"] != probe.interval):
                self._due[name] = _multiples(time, probe.interval) + 1

    def _header(self, name: str) -> list[str]:
        return [f"{column} [{unit}]" for column, unit in self.columns[name]]


def _multiples(time: float, interval: float) -> int:
    """Number of whole intervals [s] in a time [s]."""
    return math.floor(time / interval * (1 + 1e-12) + 1e-9)


def _file(name: str) -> str:
    return f"probes/{name}.csv"
