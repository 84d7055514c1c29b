"""tipfem: immiscible incompressible fluids by the position-based Particle Finite Element Method.

Names are imported when they are first used: reading a case file or a command's help needs no Taichi, whose import
takes most of a second.
"""

from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tipfem.backend.runtime import init
    from tipfem.case.beaches import Beach
    from tipfem.case.body import Body
    from tipfem.case.case import Case
    from tipfem.case.fluid import Fluid
    from tipfem.case.grading import Grading
    from tipfem.case.mesh_file import read_mesh
    from tipfem.case.numerics import FittedRule, Numerics, RelocationRule, SurfaceRule
    from tipfem.case.openings import Inlet, Outlet, Vent
    from tipfem.case.particles import Particles
    from tipfem.case.rheology import Bingham, Carreau, Granular, HerschelBulkley, PowerLaw, Smagorinsky
    from tipfem.case.tank import Tank, tank
    from tipfem.case.walls import Motion, Wall
    from tipfem.case.waves import IrregularWaves, WavePiston
    from tipfem.casefile.describing import describe, write_case
    from tipfem.casefile.problems import CaseFileError
    from tipfem.errors import CheckpointError, SimulationError
    from tipfem.geometry import shapes
    from tipfem.geometry.drawings import read_drawing
    from tipfem.logs import log_json
    from tipfem.probes import (
        DropProbe,
        EnergyProbe,
        FilmProbe,
        FrontProbe,
        LineProbe,
        OpeningProbe,
        PointProbe,
        Probe,
        VolumeProbe,
        WallForce,
        WallPressure,
        WaveGauge,
        WaveProbe,
    )
    from tipfem.render.viewer.widget import View
    from tipfem.results.fields import FieldOutput, FieldState
    from tipfem.results.reader import RunResults, read_results, to_vtkhdf
    from tipfem.results.tables import Table
    from tipfem.run.case_file import CaseFile, load_case
    from tipfem.run.live import live
    from tipfem.run.simulation import Simulation
    from tipfem.run.steering import Discharge, Drop, Gravity, MoveWall, Poke, Release, SurfaceTension, Valve, Viscosity

__version__ = "0.2.0"

__all__ = [
    "Beach",
    "Bingham",
    "Body",
    "Carreau",
    "Case",
    "CaseFile",
    "CaseFileError",
    "CheckpointError",
    "Discharge",
    "Drop",
    "DropProbe",
    "EnergyProbe",
    "FieldOutput",
    "FieldState",
    "FilmProbe",
    "FittedRule",
    "Fluid",
    "FrontProbe",
    "Grading",
    "Granular",
    "Gravity",
    "HerschelBulkley",
    "Inlet",
    "IrregularWaves",
    "LineProbe",
    "Motion",
    "MoveWall",
    "Numerics",
    "OpeningProbe",
    "Outlet",
    "Particles",
    "PointProbe",
    "Poke",
    "PowerLaw",
    "Probe",
    "Release",
    "RelocationRule",
    "RunResults",
    "Simulation",
    "SimulationError",
    "Smagorinsky",
    "SurfaceRule",
    "SurfaceTension",
    "Table",
    "Tank",
    "Valve",
    "Vent",
    "View",
    "Viscosity",
    "VolumeProbe",
    "Wall",
    "WallForce",
    "WallPressure",
    "WaveGauge",
    "WavePiston",
    "WaveProbe",
    "describe",
    "init",
    "live",
    "load_case",
    "log_json",
    "read_drawing",
    "read_mesh",
    "read_results",
    "shapes",
    "tank",
    "to_vtkhdf",
    "write_case",
]

_MODULES = {
    "Body": "case.body",
    "Case": "case.case",
    "CaseFile": "run.case_file",
    "CaseFileError": "casefile.problems",
    "CheckpointError": "errors",
    "Drop": "run.steering",
    "DropProbe": "probes",
    "FilmProbe": "probes",
    "EnergyProbe": "probes",
    "FieldOutput": "results.fields",
    "FieldState": "results.fields",
    "FittedRule": "case.numerics",
    "Bingham": "case.rheology",
    "Carreau": "case.rheology",
    "Granular": "case.rheology",
    "HerschelBulkley": "case.rheology",
    "PowerLaw": "case.rheology",
    "Smagorinsky": "case.rheology",
    "Fluid": "case.fluid",
    "FrontProbe": "probes",
    "Grading": "case.grading",
    "Gravity": "run.steering",
    "Inlet": "case.openings",
    "LineProbe": "probes",
    "Motion": "case.walls",
    "Numerics": "case.numerics",
    "Outlet": "case.openings",
    "Particles": "case.particles",
    "PointProbe": "probes",
    "Probe": "probes",
    "Poke": "run.steering",
    "Release": "run.steering",
    "RelocationRule": "case.numerics",
    "RunResults": "results.reader",
    "Simulation": "run.simulation",
    "SimulationError": "errors",
    "SurfaceRule": "case.numerics",
    "SurfaceTension": "run.steering",
    "Discharge": "run.steering",
    "Valve": "run.steering",
    "Viscosity": "run.steering",
    "Table": "results.tables",
    "Tank": "case.tank",
    "Vent": "case.openings",
    "View": "render.viewer.widget",
    "OpeningProbe": "probes",
    "VolumeProbe": "probes",
    "Wall": "case.walls",
    "WallForce": "probes",
    "WallPressure": "probes",
    "MoveWall": "run.steering",
    "WaveGauge": "probes",
    "IrregularWaves": "case.waves",
    "WavePiston": "case.waves",
    "Beach": "case.beaches",
    "WaveProbe": "probes",
    "describe": "casefile.describing",
    "init": "backend.runtime",
    "live": "run.live",
    "load_case": "run.case_file",
    "log_json": "logs",
    "read_drawing": "geometry.drawings",
    "read_mesh": "case.mesh_file",
    "read_results": "results.reader",
    "shapes": "geometry.shapes",
    "tank": "case.tank",
    "to_vtkhdf": "results.reader",
    "write_case": "casefile.describing",
}


# In a source tree render/ and demos/ stand beside this folder. Where a command is run from the tree of a tipfem that is
# installed elsewhere, Python imports this folder and would not find them.
if find_spec("tipfem.render") is None:
    __path__.append(str(Path(__file__).resolve().parents[1]))


def __getattr__(name: str) -> Any:
    """A public name, imported now and kept."""
    if name not in _MODULES:
        raise AttributeError(f"module 'tipfem' has no attribute {name!r}")
    module = import_module(f"tipfem.{_MODULES[name]}")
    value = globals()[name] = module if name == "shapes" else getattr(module, name)
    return value


def __dir__() -> list[str]:
    """The public names, imported or not."""
    return sorted({*globals(), *__all__})
