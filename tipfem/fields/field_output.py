"""How the fields of a run are written."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

FORMATS = ("vtu", "vtkhdf", "both")
PRECISIONS = ("double", "single")


@dataclass(frozen=True, kw_only=True)
class FieldOutput:
    """How the fields of a run are written.

    Attributes:
        format: "vtu": a VTU file for each stored time, and fields.pvd, which lists them; "vtkhdf": all of them in
            fields.vtkhdf; "both".
        precision: of positions, velocities, pressures and densities: "double", or "single", which takes half the space
            and keeps 7 digits.
        compression: level of zlib in fields.vtkhdf, from 0 (none) to 9; VTU files are always compressed.

    Raises:
        ValueError: a value is not one of these.
    """

    format: str = "vtu"
    precision: str = "double"
    compression: int = 4

    def __post_init__(self) -> None:
        for name, value, allowed in (
            ("format", self.format, FORMATS),
            ("precision", self.precision, PRECISIONS),
        ):
            if value not in allowed:
                raise ValueError(f"fields: {name} is {value!r}; it must be one of {', '.join(map(repr, allowed))}")
        if isinstance(self.compression, bool) or self.compression not in range(10):
            raise ValueError(f"fields: compression is {self.compression!r}; it must be a whole number from 0 to 9")

    @classmethod
    def of(cls, choice: str | FieldOutput) -> FieldOutput:
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
