"""Fluids: incompressible and Newtonian, with density and viscosity."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tipfem.arguments import is_number
from tipfem.typing import Array


@dataclass(frozen=True)
class Fluid:
    """An incompressible Newtonian fluid.

    Attributes:
        name: of the fluid in results and pictures; unique within a case.
        density: mass density [kg/m^3], > 0.
        viscosity: dynamic viscosity [Pa s], >= 0.

    Raises:
        ValueError: the name is empty or not a string, or a property is out of range or not a finite number.
    """

    name: str
    density: float
    viscosity: float

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not self.name:
            raise ValueError(f"Fluid: name is {self.name!r}; it must be a non-empty string")
        for name in ("density", "viscosity"):
            if isinstance(value := getattr(self, name), str):
                raise ValueError(
                    f"Fluid {self.name!r}: {name} is {value!r}, a text; it must be a number, without quotes"
                )
        if not (is_number(self.density) and self.density > 0):
            raise ValueError(f"Fluid {self.name!r}: density is {self.density!r} kg/m^3; it must be > 0")
        if not (is_number(self.viscosity) and self.viscosity >= 0):
            raise ValueError(f"Fluid {self.name!r}: viscosity is {self.viscosity!r} Pa s; it must be >= 0")


def ranks(fluids: Sequence[Fluid]) -> Array:
    """Rank (F,) of each fluid from the lightest, 0, to the heaviest, whatever the order they are listed in.

    Of two fluids of equal density, the more viscous is the heavier one; of two that are equal in this too, the one
    whose name comes later.
    """
    order = sorted(range(len(fluids)), key=lambda i: (fluids[i].density, fluids[i].viscosity, fluids[i].name))
    result = np.empty(len(fluids), dtype=np.int32)
    result[order] = np.arange(len(fluids))
    return result
