"""Fluids: incompressible, with density and viscosity."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from annotated_types import Ge, Gt

from tipfem.case.declaration import Unit, require
from tipfem.case.rheology import NEWTON, WIDTH, Law, law_record
from tipfem.errors import Invalid
from tipfem.typing import Array


@dataclass(frozen=True)
class Fluid:
    """An incompressible fluid.

    Attributes:
        name: of the fluid in results and pictures; unique within a case.
        density: mass density [kg/m^3].
        viscosity: dynamic viscosity, or a law of it, as `tipfem.Bingham`.

    Raises:
        ValueError: the name is empty or not a string, or a property is out of range or not a finite number.
    """

    name: str
    density: Annotated[float, Gt(0), Unit("kg/m^3")]
    viscosity: Annotated[float | Law, Ge(0), Unit("Pa s")]

    def __post_init__(self) -> None:
        require(self, names=("name",))
        require(self, ("fluids", self.name), f"Fluid {self.name!r}")


def typical_viscosity(fluid: Fluid) -> float:
    """Viscosity of a fluid [Pa s]; where it follows a law, that of a fast flow."""
    return fluid.viscosity.typical if isinstance(fluid.viscosity, Law) else float(fluid.viscosity)


def described_viscosity(viscosity: float | Law) -> str:
    """A viscosity in words: a number with its unit, or a law."""
    return str(viscosity) if isinstance(viscosity, Law) else f"{viscosity:g} Pa s"


def fluid_record(fluid: Fluid) -> dict[str, Any]:
    """A fluid as plain values."""
    return {"name": fluid.name, "density": fluid.density, "viscosity": law_record(fluid.viscosity)}


def law_table(fluids: Sequence[Fluid]) -> Array | None:
    """(F, `WIDTH`) of the viscosities of the fluids; None where none follows a law."""
    if not any(isinstance(fluid.viscosity, Law) for fluid in fluids):
        return None
    table = np.zeros((len(fluids), WIDTH))
    for f, fluid in enumerate(fluids):
        mu = fluid.viscosity
        row = mu.row(fluid.density) if isinstance(mu, Law) else (NEWTON, mu)
        table[f, : len(row)] = row
    return table


def ranks(fluids: Sequence[Fluid]) -> Array:
    """Rank (F,) of each fluid from the lightest, 0, to the heaviest, in whatever order they are listed.

    Of two fluids of equal density, the more viscous is the heavier one; of two that are equal in this too, the one
    whose name comes later.
    """
    order = sorted(range(len(fluids)), key=lambda i: (fluids[i].density, typical_viscosity(fluids[i]), fluids[i].name))
    result = np.empty(len(fluids), dtype=np.int32)
    result[order] = np.arange(len(fluids))
    return result


def without_layers(fluid: Fluid) -> bool:
    """Whether the viscosity of a fluid follows a law for which the law "layer" of walls has no meaning."""
    return isinstance(fluid.viscosity, Law) and not fluid.viscosity.has_layers


def checked_fluids(fluids: Sequence[Fluid]) -> list[Fluid]:
    """The fluids as a list; see `tipfem.Case` for errors."""
    found = list(fluids) if isinstance(fluids, Sequence) else []
    if not found or not all(isinstance(f, Fluid) for f in found):
        raise Invalid("fluids", f"is {fluids!r}; it must be a list of at least one Fluid", "Case")
    names = [f.name for f in found]
    if len(set(names)) < len(names):
        raise Invalid("fluids", f"are named {names}; every fluid needs a name of its own", "Case")
    return found
