"""Format and options of the stored fields of a run."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, Literal

from annotated_types import Ge, Le

from tipfem.case.declaration import require


@dataclass(frozen=True, kw_only=True)
class FieldOutput:
    """Format and options of the stored fields of a run.

    Attributes:
        format: "vtu": a VTU file for each stored time, and fields.pvd, which lists them; "vtkhdf": all of them in
            fields.vtkhdf; "both".
        precision: of positions, velocities, pressures and densities: "double", or "single", which takes half the space
            and keeps 7 digits.
        compression: level of zlib in fields.vtkhdf, 0 for none; VTU files are always compressed.

    Raises:
        ValueError: a value is not one of these.
    """

    format: Literal["vtu", "vtkhdf", "both"] = "vtu"
    precision: Literal["double", "single"] = "double"
    compression: Annotated[int, Ge(0), Le(9)] = 4

    def __post_init__(self) -> None:
        require(self, ("output",), "fields")

    @classmethod
    def of(cls, choice: Any) -> FieldOutput:
        """A choice by the name of a format alone, or one that is complete.

        Raises:
            ValueError: it is neither.
        """
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
        return dict(vars(self))
