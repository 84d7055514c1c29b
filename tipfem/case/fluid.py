"""Fluids: incompressible and Newtonian, with density and viscosity."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from annotated_types import Ge, Gt

from tipfem.case.declaration import Unit, require
from tipfem.typing import Array


@dataclass(frozen=True)
class Fluid:
    """An incompressible Newtonian fluid.

    Attributes:
        name: of the fluid in results and pictures; unique within a case.
        density: mass density [kg/m^3].
        viscosity: dynamic viscosity [Pa s].

    Raises:
        ValueError: the name is empty or not a string, or a property is out of range or not a finite number.
    """

    name: str
    density: Annotated[float, Gt(0), Unit("kg/m^3")]
    viscosity: Annotated[float, Ge(0), Unit("Pa s")]

    def __post_init__(self) -> None:
        require(self, names=("name",))
        require(self, ("fluids", self.name), f"Fluid {self.name!r}")


def ranks(fluids: Sequence[Fluid]) -> Array:
    """Rank (F,) of each fluid from the lightest, 0, to the heaviest, whatever the order they are listed in.

    Of two fluids of equal density, the more viscous is the heavier one; of two that are equal in this too, the one
    whose name comes later.
    """
    order = sorted(range(len(fluids)), key=lambda i: (fluids[i].density, fluids[i].viscosity, fluids[i].name))
    result = np.empty(len(fluids), dtype=np.int32)
    result[order] = np.arange(len(fluids))
    return result
