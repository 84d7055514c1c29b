"""Probes as plain values: what checkpoints and case files keep of them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from tipfem.case.declaration import plain
from tipfem.errors import CheckpointError
from tipfem.probes.drops import DropProbe, FilmProbe
from tipfem.probes.fluids import EnergyProbe, FrontProbe, VolumeProbe, WaveGauge, WaveProbe
from tipfem.probes.forces import WallForce
from tipfem.probes.openings import OpeningProbe
from tipfem.probes.points import LineProbe, PointProbe
from tipfem.probes.probe import Probe
from tipfem.probes.walls import WallPressure

# The kinds of probes, by what a case file calls them.
KINDS: dict[str, type[Probe]] = {
    "point": PointProbe,
    "line": LineProbe,
    "wall pressure": WallPressure,
    "wall force": WallForce,
    "wave gauge": WaveGauge,
    "wave": WaveProbe,
    "front": FrontProbe,
    "volume": VolumeProbe,
    "energy": EnergyProbe,
    "drops": DropProbe,
    "films": FilmProbe,
    "opening": OpeningProbe,
}
_NAMES = {kind: name for name, kind in KINDS.items()}


def probe_record(probe: Probe) -> dict[str, Any]:
    """Record of a probe as plain values; of one that is not of `KINDS`, its name and class alone."""
    kind = _NAMES.get(type(probe))
    if kind is None:
        return {"class": type(probe).__qualname__, "name": probe.name}
    return {"type": kind, **plain(probe)}


def probe_from(record: Mapping[str, Any]) -> Probe:
    """The probe that a record of `probe_record` describes; `CheckpointError` if it is not of `KINDS`."""
    values = dict(record)
    kind = values.pop("type", None)
    if kind not in KINDS:
        text = f"the run had the probe {values['name']!r} of the class {values.get('class', kind)}, which no file "
        raise CheckpointError(f"{text}keeps; give the probes to resume")
    return KINDS[kind](**values)
