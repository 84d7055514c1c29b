"""Probes: what a run measures on its way, each in a file of its own.

A probe is given to `tipfem.Simulation` and sampled after the steps. Values between particles are those of the linear
shape functions, as in the solution; of a fluid at rest the pressure is exact.
"""

from tipfem.run.probes.drops import DropProbe, FilmProbe
from tipfem.run.probes.fluids import EnergyProbe, FrontProbe, VolumeProbe, WaveGauge, WaveProbe
from tipfem.run.probes.forces import WallForce
from tipfem.run.probes.impulses import LoadProbe
from tipfem.run.probes.openings import OpeningProbe
from tipfem.run.probes.points import LineProbe, PointProbe
from tipfem.run.probes.probe import Probe
from tipfem.run.probes.recorder import ProbeRecorder
from tipfem.run.probes.records import KINDS, probe_from, probe_record
from tipfem.run.probes.walls import WallPressure

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
