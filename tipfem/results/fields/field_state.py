"""The fields at one stored time."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tipfem.arguments import numbers
from tipfem.geometry.period import Period
from tipfem.mesh.measures import locate
from tipfem.mesh.mesh import Mesh
from tipfem.results.fields.catalogue import FIELDS, STORED, Flow
from tipfem.typing import Array

# Cell types of VTK, by the number of particles of a cell.
VTK_CELLS = {1: 1, 3: 5, 4: 10}


@dataclass(frozen=True, eq=False)
class StoredState:
    """A state as a file has it: N particles and M cells in d dimensions."""

    file: Path
    points: Array  # (N, 3) [m]
    cells: Array  # (M, d + 1)
    cell_fluid: Array | None  # (M,)
    loose: Array  # (L,)
    data: Mapping[str, Array]  # of the particles (N, ...), by name, also what other programs have added

    def fields(self, step: int, time: float) -> FieldState:
        """The fields that tipfem stores, of a step at a time [s]; `ValueError` if one is missing."""
        missing = [name for name in STORED if name not in self.data]
        if missing:
            raise ValueError(f"{self.file}: point data {missing[0]!r} is missing; a file of tipfem has it")
        d = self.cells.shape[1] - 1
        stored: dict[str, Any] = {name: kind.read(self.data[name], d) for name, kind in STORED.items()}
        return FieldState(
            step=step,
            time=time,
            position=self.points[:, :d],
            cells=self.cells,
            cell_fluid=self.cell_fluid,
            loose=self.loose,
            **stored,
        )


@dataclass(frozen=True, eq=False)
class FieldState:
    """The fields at one stored time: N particles and M cells in d dimensions.

    Attributes:
        step: number of the step.
        time: [s].
        position: (N, d) of the particles [m].
        velocity: (N, d) [m/s].
        pressure: (N,) [Pa].
        fluid: (N,) number of each particle's fluid.
        density: (N,) of that fluid [kg/m^3].
        wall: (N,) whether the particle is of a wall.
        cells: (M, d + 1) particles of each cell.
        cell_fluid: (M,) number of each cell's fluid, or None where interfaces cut through cells.
        loose: (L,) numbers of the particles that are in no cell: spray.
        laws: of the fluids' viscosities, see `tipfem.case.fluid.law_table`; None where none follows a law.
        period: (d,) width of the domain along periodic axes, 0 for others [m]; None if none is.
        spacing: of the particles [m].
        axial: whether the flow is axisymmetric.
    """

    step: int
    time: float
    position: Array
    velocity: Array
    pressure: Array
    fluid: Array
    density: Array
    wall: Array
    cells: Array
    cell_fluid: Array | None
    loose: Array
    laws: Array | None = None
    period: Array | None = None
    spacing: float = 1.0
    axial: bool = False

    @property
    def dimension(self) -> int:
        """2 or 3."""
        return int(self.position.shape[1])

    def point_data(self, real: str, quantities: Iterable[str] = ()) -> dict[str, Array]:
        """Fields of the particles as they are written, vectors with 3 components, of NumPy's type named ``real``.

        ``quantities`` are names of fields besides those that are stored.
        """
        data = {name: kind.written(getattr(self, name), real) for name, kind in STORED.items()}
        return data | {name: self.field(name).astype(real) for name in quantities}

    def cell_data(self, real: str, quantities: Iterable[str] = ()) -> dict[str, Array]:
        """The fields of the cells (M + L,) as they are written, those of spray behind; see `point_data`."""
        if self.cell_fluid is None:
            return {}
        data = {"fluid": np.concatenate([self.cell_fluid, self.fluid[self.loose]]).astype(np.int32)}
        for name in quantities:
            if FIELDS[name].of_cells:
                values = self.field(name, cells=True), self.field(name)[self.loose]
                data[name] = np.concatenate(values).astype(real)
        return data

    def field(self, name: str, cells: bool = False) -> Array:
        """Values of a field, also of one that follows from those that are stored, as "vorticity" or "shear_rate".

        Of the particles (N,), or with ``cells`` of the cells (M,), for a field that jumps between them; see
        `tipfem.results.fields.catalogue`.

        Raises:
            ValueError: there is no such field in this flow.
        """
        data, place = {one: getattr(self, one) for one in STORED}, (self.position, self.cells, self.cell_fluid)
        flow = Flow(data, *place, (), self.laws, self.period, self.spacing, self.axial)
        there = {field.name: field.of_cells if cells else field.of for field in FIELDS.values() if field.is_in(flow)}
        of = there.get(name)
        if of is None or (name == "density" and cells):
            known = ", ".join(sorted(one for one, how in there.items() if how))
            raise ValueError(f"field {name!r} is not in this flow{' in cells' if cells else ''}; there are: {known}")
        return of(flow)

    def at(self, name: str, places: Any) -> Array:
        """Values of a field at places, interpolated in the cells there; NaN where there is no fluid.

        The density, and what jumps between cells, is that of the cell.

        Args:
            name: see `field`.
            places: (K, d) [m].

        Returns:
            (K,), or (K, d) of a vorticity in 3-D.

        Raises:
            ValueError: there is no such field in this flow; the places are no numbers (K, d).
        """
        where = numbers(places)
        if where.ndim != 2 or where.shape[1] != self.dimension or not np.isfinite(where).all():
            raise ValueError(f"places: an array of shape {where.shape}; it must have {self.dimension} numbers a place")
        period = Period(np.zeros(self.dimension) if self.period is None else self.period, axial=self.axial)
        cell, weights = locate(Mesh(self.position, self.cells, period=period), where)
        inside, values = cell >= 0, self.field(name)
        if self.cell_fluid is not None and name == "density":
            of_fluid = np.zeros(self.fluid.max() + 1)
            of_fluid[self.fluid] = self.density
            found = of_fluid[self.cell_fluid[cell[inside]]]
        elif self.cell_fluid is not None and FIELDS[name].of_cells:
            found = self.field(name, cells=True)[cell[inside]]
        else:
            found = np.einsum("kc,kc...->k...", weights[inside], values[self.cells[cell[inside]]])
        result = np.full((len(where), *values.shape[1:]), np.nan)
        result[inside] = found
        return result

    def _repr_html_(self) -> str:
        return f"<pre>{self!r}</pre>"

    def __repr__(self) -> str:
        speed = float(np.linalg.norm(self.velocity, axis=1).max()) if len(self.position) else 0.0
        return (
            f"FieldState at t = {self.time:g} s (step {self.step}): {len(self.position)} particles, "
            f"{len(self.cells)} cells, {self.dimension} dimensions, largest speed {speed:.3g} m/s"
        )
