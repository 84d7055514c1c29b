"""Format and options of the stored fields of a run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal

from annotated_types import Ge, Le

from tipfem.case.declaration import require
from tipfem.errors import Invalid
from tipfem.results.fields.catalogue import COMPUTED, FIELDS
from tipfem.typing import Array


@dataclass(frozen=True, kw_only=True)
class FieldOutput:
    """Format and options of the stored fields of a run.

    Attributes:
        format: "vtu": a VTU file for each stored time, and fields.pvd, which lists them; "vtkhdf": all of them in
            fields.vtkhdf; "both".
        precision: of positions, velocities, pressures and densities: "double", or "single", which takes half the space
            and keeps 7 digits.
        quantities: fields that are computed and written besides, as "vorticity" and "shear_rate": for other programs,
            since tipfem computes them from what is always written.
        compression: level of zlib in fields.vtkhdf, 0 for none; VTU files are always compressed.

    Raises:
        ValueError: a value is not one of these.
    """

    format: Literal["vtu", "vtkhdf", "both"] = "vtu"
    precision: Literal["double", "single"] = "double"
    compression: Annotated[int, Ge(0), Le(9)] = 4
    quantities: Sequence[str] = ()

    def __post_init__(self) -> None:
        require(self, ("output",), "fields")
        object.__setattr__(self, "quantities", tuple(self.quantities))
        for name in self.quantities:
            if name not in COMPUTED:
                text = f"has {name!r}; expected some of {', '.join(COMPUTED)}"
                raise Invalid(("output", "quantities"), text, "fields")

    @classmethod
    def of(cls, choice: Any) -> FieldOutput:
        """A choice by the name of a format alone, or one that is complete; `ValueError` if it is neither."""
        return choice if isinstance(choice, FieldOutput) else cls(format=choice)

    @property
    def vtu(self) -> bool:
        """Whether VTU files are written."""
        return self.format != "vtkhdf"

    @property
    def vtkhdf(self) -> bool:
        """Whether a VTKHDF file is written."""
        return self.format != "vtu"

    @property
    def real(self) -> str:
        """NumPy's name of the type of real numbers."""
        return "f8" if self.precision == "double" else "f4"

    def record(self) -> dict[str, Any]:
        """The choice as plain values."""
        return {**vars(self), "quantities": list(self.quantities)}

    def require_laws(self, laws: Array | None) -> None:
        """`Invalid` for quantities that a flow with these laws has not, see `tipfem.case.fluid.law_table`."""
        for name in self.quantities:
            if not FIELDS[name].there(laws):
                text = f"has {name!r}, which this flow has not: no fluid has a {FIELDS[name].law}"
                raise Invalid(("output", "quantities"), text, "fields")
