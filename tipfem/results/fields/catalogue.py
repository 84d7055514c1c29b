"""The fields of a flow, each declared here alone: names, unit, types, colours, and how it follows from a state."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Literal

import numpy as np

from tipfem.case.rheology import GRANULAR, viscosities, yield_stresses
from tipfem.results.fields.gradients import SAME_PLACE, at_particles, cell_gradients, first_of_each, wrapped
from tipfem.typing import Array


@dataclass(frozen=True, eq=False)
class Flow:
    """A state that fields are computed from: N particles and M cells in d dimensions."""

    data: Mapping[str, Array]  # what is stored of the particles (N, ...), by name
    position: Array  # (N, d) [m]
    cells: Array  # (M, d + 1) particles of each cell
    cell_fluid: Array | None  # (M,) number of each cell's fluid, or None where interfaces cut through cells
    densities: Sequence[float]  # of the fluids [kg/m^3]
    laws: Array | None = None  # (F, `tipfem.case.rheology.WIDTH`) of the viscosities; None where none follows a law
    period: Array | None = None  # (d,) width of the domain along periodic axes, 0 for others [m]; None if none is
    spacing: float = 1.0  # of the particles [m]
    axial: bool = False  # whether the flow is axisymmetric, with the first coordinate from the axis

    @cached_property
    def _gradients(self) -> tuple[Array, Array]:
        dimension = self.position.shape[1]
        velocity = self.data["velocity"][:, :dimension]
        return cell_gradients(self.position.astype(np.float64), self.cells, velocity.astype(np.float64), self.period)

    @property
    def gradient(self) -> Array:
        """Velocity gradient (M, d, d) of each cell [1/s]."""
        return self._gradients[0]

    @cached_property
    def shear_rate(self) -> Array:
        """sqrt(2 D : D) (M,) of each cell [1/s], with the rate of strain D."""
        strain = 0.5 * (self.gradient + self.gradient.transpose(0, 2, 1))
        squares = (strain**2).sum(axis=(1, 2))
        if self.axial:  # strain of rings
            away, radius = (each[self.cells, 0].mean(axis=1) for each in (self.data["velocity"], self.position))
            squares += (away / radius) ** 2
        return np.asarray(np.sqrt(2.0 * squares))

    @cached_property
    def _fluid_and_pressure(self) -> tuple[Array, Array]:
        fluid = np.zeros(len(self.cells), np.int64) if self.cell_fluid is None else self.cell_fluid
        return fluid, self.data["pressure"][self.cells].mean(axis=1)

    @cached_property
    def viscosity(self) -> Array:
        """Viscosity (M,) of each cell [Pa s], of flows in which one follows a law."""
        assert self.laws is not None
        fluid, pressure = self._fluid_and_pressure
        size2 = self._gradients[1] ** (2.0 / self.position.shape[1])
        return viscosities(self.laws, fluid, self.shear_rate, pressure, size2)

    @property
    def yielded(self) -> Array:
        """1 (M,) in cells where the shear stress is above the yield stress, and in fluids that have none; else 0."""
        assert self.laws is not None
        fluid, pressure = self._fluid_and_pressure
        factor = np.where(self.laws[fluid, 0] == GRANULAR, np.maximum(pressure, 0.0), 1.0)
        limit = yield_stresses(self.laws)[fluid] * factor
        return ((self.viscosity * self.shear_rate > limit) | (limit <= 0)).astype(np.float64)

    def at_particles(self, values: Array) -> Array:
        """Means (N, ...) of values (M, ...) of cells around each particle, see `gradients.at_particles`."""
        owner, fluid = self.cell_fluid, np.ravel(self.data["fluid"]) if "fluid" in self.data else None
        mine = (
            np.ones(self.cells.shape, bool) if owner is None or fluid is None else fluid[self.cells] == owner[:, None]
        )
        first = np.arange(len(self.position))
        if self.period is not None:
            home = wrapped(self.position.astype(np.float64), self.period)
            first = first_of_each(home, self.period, SAME_PLACE * self.spacing)
        return at_particles(values, self._gradients[1], self.cells, mine, first)


@dataclass(frozen=True)
class Stored:
    """NumPy's names of the types of a stored field."""

    memory: str = "f8"  # in a `FieldState`
    file: str | None = None  # in files; None for real numbers of the precision that was asked for
    stream: str = "f4"  # to a viewer; "" where it is not sent
    vector: bool = False  # whether it has a component per axis; files have three

    def written(self, values: Array, real: str) -> Array:
        """Values as files have them; ``real`` is NumPy's name of the type of real numbers."""
        return (three_components(values) if self.vector else values).astype(self.file or real, copy=False)

    def read(self, values: Array, dimension: int) -> Array:
        """Read the output of `written`; reals keep their precision."""
        kept = values[:, :dimension] if self.vector else values
        return kept if self.file is None else kept.astype(self.memory)


@dataclass(frozen=True)
class Field:
    """A field."""

    name: str  # in files, commands and code
    label: str  # in pictures
    unit: str = ""  # such as "kg/m^3"; "" for none
    symbol: str = ""  # in formulas
    stored: Stored | None = None  # its types, where files have it; None for what follows from others
    of: Callable[[Flow], Array] | None = None  # gives its values (N,) at the particles; None where it cannot be drawn
    of_cells: Callable[[Flow], Array] | None = None  # gives its values (M,) in cells, where they jump between cells
    needs: str = ""  # the stored field that it follows from
    law: str = ""  # which law of viscosity a fluid must have, in words; "" for none
    # of its colours: "signed" with zero in the middle, "positive" from zero on
    scale: Literal["", "signed", "positive"] = ""
    odd: bool = False  # whether its sign is another one in a mirror along the first axis
    dimension: int = 2  # the least of a flow that has it

    @property
    def title(self) -> str:
        """The label with the unit, such as "pressure [Pa]"."""
        return f"{self.label} [{self.unit}]" if self.unit else self.label

    def is_in(self, flow: Flow) -> bool:
        """Whether it can be drawn of a flow."""
        fits = flow.position.shape[1] >= self.dimension and self.there(flow.laws)
        return self.of is not None and self.needs in flow.data and fits

    def there(self, laws: Array | None) -> bool:
        """Whether a flow has it whose fluids have laws (F, WIDTH) of viscosity, or none."""
        if not self.law:
            return True
        return laws is not None and (self.law != "yield stress" or bool(yield_stresses(laws).any()))


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


def _vorticity(flow: Flow) -> Array:
    """Curl of the velocity, (N,) in 2-D and (N, 3) in 3-D."""
    spin = flow.gradient - flow.gradient.transpose(0, 2, 1)
    return flow.at_particles(spin[:, 1, 0] if spin.shape[1] == 2 else spin[:, [2, 0, 1], [1, 2, 0]])


def _in_cells(name: str, flow: Flow) -> Array:
    return np.asarray(getattr(flow, name))


def _recovered(name: str, flow: Flow) -> Array:
    return flow.at_particles(_in_cells(name, flow))


# Stored ones in the order of files, drawn ones in that of menus.
FIELDS: Mapping[str, Field] = {
    field.name: field
    for field in (
        Field("velocity", "velocity", "m/s", "u", Stored(vector=True)),
        Field("pressure", "pressure", "Pa", "p", Stored(), partial(_stored, "pressure"), needs="pressure"),
        Field("speed", "speed", "m/s", "\\lVert u \\rVert", None, _speed, needs="velocity", scale="positive"),
        *(
            Field(
                *(f"velocity_{x}", f"velocity {x}", "m/s", f"u_{x}", None, partial(_component, axis)),
                needs="velocity",
                scale="signed",
                odd=axis == 0,
                dimension=max(2, axis + 1),
            )
            for axis, x in enumerate("xyz")
        ),
        Field("fluid", "fluid", stored=Stored("i8", "i4", "i4")),
        Field(
            "density", "density", "kg/m^3", "\\rho", Stored(stream=""), partial(_stored, "density"), _density, "density"
        ),
        Field("wall", "wall", stored=Stored("?", "i4", "i1")),
        Field("vorticity", "vorticity", "1/s", "\\omega", None, _vorticity, needs="velocity", scale="signed", odd=True),
        Field(
            *("shear_rate", "shear rate", "1/s", "\\dot\\gamma", None, partial(_recovered, "shear_rate")),
            needs="velocity",
            scale="positive",
        ),
        *(
            Field(
                *(name, name, unit, symbol, None, partial(_recovered, name), partial(_in_cells, name)),
                needs="velocity",
                law=law,
                scale="positive",
            )
            for name, unit, symbol, law in (
                ("viscosity", "Pa s", "\\mu", "law of viscosity"),
                ("yielded", "", "", "yield stress"),
            )
        ),
    )
}
COMPUTED = [name for name, field in FIELDS.items() if field.of and not field.stored and field.dimension == 2]
STORED: Mapping[str, Stored] = {name: field.stored for name, field in FIELDS.items() if field.stored}


def field_of(name: str) -> Field:
    """The field of a name; one that other programs have added to files has no unit."""
    return FIELDS.get(name) or Field(name, name.replace("_", " "))


class Lazy(Mapping[str, Array]):
    """Arrays by name, each made by its maker at its first use."""

    def __init__(self, makers: Mapping[str, Callable[[], Array]]) -> None:
        self._makers = makers
        self._made: dict[str, Array] = {}

    def __getitem__(self, name: str) -> Array:
        if name not in self._made:
            self._made[name] = self._makers[name]()
        return self._made[name]

    def __contains__(self, name: object) -> bool:
        return name in self._makers

    def __iter__(self) -> Iterator[str]:
        return iter(self._makers)

    def __len__(self) -> int:
        return len(self._makers)

    def changed(self, change: Callable[[str, Array], Array]) -> Lazy:
        """The same with each array changed, when it is made."""

        def make(name: str) -> Array:
            return change(name, self[name])

        return Lazy({name: partial(make, name) for name in self})


def drawn_fields(flow: Flow) -> tuple[Lazy, Lazy]:
    """Fields of a flow to draw, by name: values (N,) at the particles, and (M,) in cells of what jumps there."""
    there = [field for field in FIELDS.values() if field.is_in(flow)]
    others = [name for name, data in flow.data.items() if name not in FIELDS and data.size == len(data)]
    fields = {name: partial(_stored, name, flow) for name in others}
    fields |= {field.name: partial(field.of, flow) for field in there if field.of}
    of_cells = [] if flow.cell_fluid is None else there
    cells = {field.name: partial(field.of_cells, flow) for field in of_cells if field.of_cells}
    return Lazy(fields), Lazy(cells)


def three_components(vectors: Array) -> Array:
    """Vectors (N, d) with zeros up to 3 components."""
    return np.pad(vectors, ((0, 0), (0, 3 - vectors.shape[1])))
