"""tipfem: two immiscible incompressible fluids by the position-based Particle Finite Element Method."""

from tipfem.backend.runtime import init
from tipfem.case.case import Case
from tipfem.case.fluid import Fluid
from tipfem.case.grading import Grading
from tipfem.case.numerics import FittedRule, Numerics, RelocationRule, SurfaceRule
from tipfem.case.particles import Particles
from tipfem.case.tank import Tank, tank
from tipfem.case.walls import Motion, Wall
from tipfem.simulation import Simulation, SimulationError

__version__ = "0.1.0"

__all__ = [
    "Case",
    "FittedRule",
    "Fluid",
    "Grading",
    "Motion",
    "Numerics",
    "Particles",
    "RelocationRule",
    "Simulation",
    "SimulationError",
    "SurfaceRule",
    "Tank",
    "Wall",
    "init",
    "tank",
]
