"""tipfem: two immiscible incompressible fluids by the position-based Particle Finite Element Method."""

from tipfem.case import Case, Numerics
from tipfem.device import init
from tipfem.fluid import Fluid
from tipfem.geometry import Tank, tank
from tipfem.particles import Particles
from tipfem.relocation import RelocationRule
from tipfem.simulation import Simulation, SimulationError

__version__ = "0.1.0"

__all__ = [
    "Case",
    "Fluid",
    "Numerics",
    "Particles",
    "RelocationRule",
    "Simulation",
    "SimulationError",
    "Tank",
    "init",
    "tank",
]
