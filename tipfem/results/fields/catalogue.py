"""The fields of a flow, each declared here alone: names, unit, types, colours, and how it follows from a state."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Literal

import numpy as np

from tipfem.typing import Array


@dataclass(frozen=True, eq=False, kw_only=True)
class Flow:
    """A state that fields are computed from: N particles and M cells.

    Attributes:
        data: what is stored of the particles (N, ...), by name.
        cell_fluid: (M,) number of each cell's fluid, or None where interfaces cut through cells.
        densities: of the fluids [kg/m^3].
    """

    data: Mapping[str, Array]
    cell_fluid: Array | None
    densities: Sequence[float]


@dataclass(frozen=True)
class Stored:
    """NumPy's names of the types of a stored field.

    Attributes:
        memory: in a `FieldState`.
        file: in files; None for real numbers of the precision that was asked for.
        stream: to a viewer; "" where it is not sent.
        vector: whether it has a component per axis; files have three.
    """

    memory: str = "f8"
    file: str | None = None
    stream: str = "f4"
    vector: bool = False

    def written(self, values: Array, real: str) -> Array:
        """Values as files have them; ``real`` is NumPy's name of the type of real numbers."""
        return (three_components(values) if self.vector else values).astype(self.file or real, copy=False)

    def read(self, values: Array, dimension: int) -> Array:
        """Read the output of `written`; reals keep their precision."""
        kept = values[:, :dimension] if self.vector else values
        return kept if self.file is None else kept.astype(self.memory)


@dataclass(frozen=True)
class Field:
    """A field.

    Attributes:
        name: in files, commands and code.
        label: in pictures.
        unit: such as "kg/m^3"; "" for none.
        symbol: in formulas.
        stored: its types, where files have it; None for what follows from others.
        of: gives its values (N,) at the particles; None where it cannot be drawn.
        of_cells: gives its values (M,) in cells, where they jump between cells.
        needs: the stored field that it follows from.
        scale: of its colours: "signed" with zero in the middle, "positive" from zero on.
    """

    name: str
    label: str
    unit: str = ""
    symbol: str = ""
    stored: Stored | None = None
    of: Callable[[Flow], Array] | None = None
    of_cells: Callable[[Flow], Array] | None = None
    needs: str = ""
    scale: Literal["", "signed", "positive"] = ""

    @property
    def title(self) -> str:
        """The label with the unit, such as "pressure [Pa]"."""
        return f"{self.label} [{self.unit}]" if self.unit else self.label


def _stored(name: str, flow: Flow) -> Array:
    return np.ravel(flow.data[name])


def _component(axis: int, flow: Flow) -> Array:
    return flow.data["velocity"][:, axis]


def _speed(flow: Flow) -> Array:
    return np.asarray(np.linalg.norm(flow.data["velocity"], axis=1))


def _density(flow: Flow) -> Array:
    """Density of the cells' fluids: that of a particle on an interface is of one side."""
    assert flow.cell_fluid is not None
    return np.take(np.asarray(flow.densities), flow.cell_fluid, mode="clip")


# Stored ones in the order of files, drawn ones in that of menus.
FIELDS: Mapping[str, Field] = {
    field.name: field
    for field in (
        Field("velocity", "velocity", "m/s", "u", Stored(vector=True)),
        Field("pressure", "pressure", "Pa", "p", Stored(), partial(_stored, "pressure"), needs="pressure"),
        Field("speed", "speed", "m/s", "|u|", None, _speed, needs="velocity", scale="positive"),
        *(
            Field(f"velocity_{x}", f"velocity {x}", "m/s", f"u_{x}", None, component, needs="velocity", scale="signed")
            for x, component in (("x", partial(_component, 0)), ("y", partial(_component, 1)))
        ),
        Field("fluid", "fluid", stored=Stored("i8", "i4", "i4")),
        Field(
            "density", "density", "kg/m^3", "rho", Stored(stream=""), partial(_stored, "density"), _density, "density"
        ),
        Field("wall", "wall", stored=Stored("?", "i4", "i1")),
    )
}
STORED: Mapping[str, Stored] = {name: field.stored for name, field in FIELDS.items() if field.stored}


def field_of(name: str) -> Field:
    """The field of a name; one that other programs have added to files has no unit."""
    return FIELDS.get(name) or Field(name, name.replace("_", " "))


def drawn_fields(flow: Flow) -> tuple[dict[str, Array], dict[str, Array]]:
    """Fields of a flow to draw, by name: values (N,) at the particles, and (M,) in cells of those that jump there."""
    fields = {name: np.ravel(data) for name, data in flow.data.items() if name not in FIELDS and data.size == len(data)}
    cells = {}
    for field in FIELDS.values():
        if field.of and field.needs in flow.data:
            fields[field.name] = field.of(flow)
            if field.of_cells and flow.cell_fluid is not None:
                cells[field.name] = field.of_cells(flow)
    return fields, cells


def three_components(vectors: Array) -> Array:
    """Vectors (N, d) with zeros up to 3 components."""
    return np.pad(vectors, ((0, 0), (0, 3 - vectors.shape[1])))
