"""Fluids: incompressible, Newtonian, told apart by density and viscosity."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Fluid:
    """An incompressible Newtonian fluid.

    Attributes:
        name: what the fluid is called in results and pictures; unique within a case.
        density: mass density [kg/m^3], > 0.
        viscosity: dynamic viscosity [Pa s], >= 0.

    Raises:
        ValueError: the name is empty, or a property is out of range or not finite.
    """

    name: str
    density: float
    viscosity: float

    def __post_init__(self) -> None:
        if not self.name or not isinstance(self.name, str):
            raise ValueError(f"Fluid: name is {self.name!r}; it must be a non-empty string")
        if not (math.isfinite(self.density) and self.density > 0):
            raise ValueError(f"Fluid {self.name!r}: density is {self.density!r} kg/m^3; it must be > 0")
        if not (math.isfinite(self.viscosity) and self.viscosity >= 0):
            raise ValueError(f"Fluid {self.name!r}: viscosity is {self.viscosity!r} Pa s; it must be >= 0")
