"""tipfem: two immiscible incompressible fluids by the position-based Particle Finite Element Method."""

from tipfem.alpha_shape import SurfaceRule
from tipfem.case import Case
from tipfem.device import init
from tipfem.fitting import FittedRule
from tipfem.fluid import Fluid
from tipfem.geometry import Tank, tank
from tipfem.grading import Grading
from tipfem.numerics import Numerics
from tipfem.particles import Particles
from tipfem.relocation_rule import RelocationRule
from tipfem.simulation import Simulation, SimulationError
from tipfem.walls import Motion, Wall

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
