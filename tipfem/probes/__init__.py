"""Probes: what a run measures on its way, each in a file of its own.

A probe is given to `tipfem.Simulation` and sampled after the steps. Values between particles are those of the linear
shape functions, as in the solution; of a fluid at rest the pressure is exact.
"""

from tipfem.probes.drops import DropProbe, FilmProbe
from tipfem.probes.fluids import EnergyProbe, FrontProbe, VolumeProbe, WaveGauge, WaveProbe
from tipfem.probes.forces import WallForce
from tipfem.probes.impulses import LoadProbe
from tipfem.probes.openings import OpeningProbe
from tipfem.probes.points import LineProbe, PointProbe
from tipfem.probes.probe import KINDS, Probe, probe_from, probe_record
from tipfem.probes.recorder import ProbeRecorder
from tipfem.probes.walls import WallPressure

__all__ = [
    "KINDS",
    "DropProbe",
    "EnergyProbe",
    "FilmProbe",
    "FrontProbe",
    "LineProbe",
    "LoadProbe",
    "OpeningProbe",
    "PointProbe",
    "Probe",
    "ProbeRecorder",
    "VolumeProbe",
    "WallForce",
    "WallPressure",
    "WaveGauge",
    "WaveProbe",
    "probe_from",
    "probe_record",
]
