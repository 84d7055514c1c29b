"""Drawn state at one time: particles, the mesh between them, and fields on them."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from tipfem.results.fields.catalogue import Lazy, field_of

from .arrays import Array
from .bodies import PlacedBody
from .geometry import Geometry
from .mirror import ON_AXIS, with_mirrored
from .openings import Gap, on_both_sides
from .periodic import with_images
from .tank import PlacedTank

_LEFT_OUT: Any = None  # in place of what a scene has in any case, and finds where it is not given


@dataclass(frozen=True, kw_only=True)
class Scene:
    """One time of a two-dimensional multi-fluid flow, in SI units.

    Attributes:
        position: (N, 2) particle positions [m].
        cells: (M, 3) triangles as particle indices; M may be 0.
        fluid: (N,) fluid of each particle, an index into ``fluid_names``.
        wall: (N,) 1 on wall particles, 0 elsewhere; by default no walls.
        fields: values (N,) at the particles, by name.
        cell_fields: values (M,) of the cells, by name, for the fields that jump from cell to cell.
            They colour the cells in place of the particles' values.
        time: [s].
        fluid_names: one name per fluid.
        fluid_densities: one density per fluid [kg/m^3], which chooses the colours. By default the fluids are
            ordered from heavy to light.
        lower: (2,) lower corner of the box that is framed [m]; by default that of the particles' bounding box.
        upper: (2,) upper corner of it.
        cell_fluid: (M,) fluid of each cell. If given, interfaces follow cell edges, and the
            particles on them belong to both sides; otherwise a cell whose particles carry different fluids
            is cut at the mid-points of its edges.
        spacing: mean particle spacing [m], the scale of the dots; by default from the mean area per particle.
        title: a line above the picture.
        digits: of the time behind the point.
        span: of the times of the run [s], or 0.
        trails: (P, K, 2) paths of tracers up to this time [m], the oldest point first; None for none.
        bodies: rigid bodies in the fluids.
        tank: its walls; None where they are those of the cells, or the convex hull of their particles.
        openings: in the walls.
        period: (2,) width of the domain along the axes that are periodic, 0 for others [m], for a domain that begins
            at 0 there. Particles and cells have images then, see `tipfem.render.periodic.with_images`.
        axial: whether positions are (r, z) of an axisymmetric flow. It has a half on each side of the axis then, see
            `tipfem.render.mirror.with_mirrored`; trails and tank are as they are given.
        plane: names of the two coordinates, of a flow that does not lie in x and y.

    Raises:
        ValueError: a shape or a value is wrong; the message names the argument.
    """

    position: Array
    cells: Array
    fluid: Array
    wall: Array = _LEFT_OUT
    fields: Mapping[str, Array] = field(default_factory=dict)
    cell_fields: Mapping[str, Array] = field(default_factory=dict)
    time: float = 0.0
    fluid_names: tuple[str, ...] = ("fluid",)
    fluid_densities: tuple[float, ...] | None = None
    lower: Array = _LEFT_OUT
    upper: Array = _LEFT_OUT
    cell_fluid: Array | None = None
    spacing: float = _LEFT_OUT
    title: str = ""
    digits: int = 3
    span: float = 0.0
    trails: Array | None = None
    bodies: tuple[PlacedBody, ...] = ()
    tank: PlacedTank | None = None
    openings: tuple[Gap, ...] = ()
    period: Array | None = None
    axial: bool = False
    plane: tuple[str, str] | None = None

    def __post_init__(self) -> None:
        position = np.asarray(self.position, np.float64)
        if position.ndim != 2 or position.shape[1] != 2 or len(position) == 0:
            raise ValueError(f"position: shape {position.shape}, expected (N, 2) with N > 0")
        if not np.isfinite(position).all():
            bad = np.flatnonzero(~np.isfinite(position).all(axis=1))
            raise ValueError(f"position: {len(bad)} particles are not finite, the first is particle {bad[0]}")
        count = len(position)
        cells = np.asarray(self.cells, np.int64)
        if cells.size == 0:
            cells = cells.reshape(0, 3)
        if cells.ndim != 2 or cells.shape[1] != 3:
            raise ValueError(f"cells: shape {cells.shape}, expected (M, 3)")
        _check_index("cells", cells, count, "particles")

        names = tuple(str(name) for name in self.fluid_names)
        if self.fluid_densities is not None and len(self.fluid_densities) != len(names):
            raise ValueError(
                f"fluid_densities: {len(self.fluid_densities)} values, "
                f"expected {len(names)}, one for each of fluid_names"
            )
        fluid = _integers("fluid", self.fluid, count)
        _check_index("fluid", fluid, len(names), "fluid_names")
        wall = np.zeros(count, bool) if self.wall is None else _integers("wall", self.wall, count) != 0
        cell_fluid = self.cell_fluid
        if cell_fluid is not None:
            cell_fluid = _integers("cell_fluid", cell_fluid, len(cells))
            _check_index("cell_fluid", cell_fluid, len(names), "fluid_names")

        fields = _checked("field", self.fields, count)
        cell_fields = _checked("cell_fields", self.cell_fields, len(cells))
        for name in cell_fields:
            if name not in fields:
                raise ValueError(f"cell_fields: {name!r} is not among fields")
        lower = position.min(axis=0) if self.lower is None else np.asarray(self.lower, np.float64)
        upper = position.max(axis=0) if self.upper is None else np.asarray(self.upper, np.float64)
        if lower.shape != (2,) or upper.shape != (2,) or not np.all(upper > lower):
            raise ValueError(f"lower, upper: {lower} and {upper}, expected two points with upper above lower")
        spacing = self.spacing
        if spacing is None:
            spacing = float(np.sqrt(np.prod(upper - lower) / count))
        if not spacing > 0:
            raise ValueError(f"spacing: {spacing}, expected a length above 0 m")

        trails = None if self.trails is None else np.asarray(self.trails, np.float64)
        if trails is not None and (trails.ndim != 3 or trails.shape[1:] != (trails.shape[1], 2)):
            raise ValueError(f"trails: shape {trails.shape}, expected (P, K, 2)")

        period = None if self.period is None else np.asarray(self.period, np.float64)
        if period is not None:
            if period.shape != (2,) or not (np.isfinite(period).all() and (period >= 0).all() and period.any()):
                raise ValueError(f"period: {period}, expected two widths, one of them above 0 m")
            position, cells, particle, cell = with_images(position, cells, period, spacing)
            fluid, wall = fluid[particle], wall[particle]
            cell_fluid = None if cell_fluid is None else cell_fluid[cell]
            fields = fields.changed(lambda _, values: values[particle])
            cell_fields = cell_fields.changed(lambda _, values: values[cell])
            lower, upper = np.where(period > 0, 0.0, lower), np.where(period > 0, period, upper)

        openings = self.openings
        if self.axial:
            position, cells, particle = with_mirrored(position, cells, spacing)
            sign = np.where(np.arange(len(particle)) < count, 1.0, -1.0)
            fluid, wall = fluid[particle], wall[particle]
            # On the axis are no walls, but where it meets them; in empty space its particles are no drops.
            stays = (position[:, 1] <= lower[1] + ON_AXIS * spacing) | (position[:, 1] >= upper[1] - ON_AXIS * spacing)
            stays |= np.bincount(cells.ravel(), minlength=len(position)) == 0
            wall &= (np.abs(position[:, 0]) > ON_AXIS * spacing) | stays
            cell_fluid = None if cell_fluid is None else np.tile(cell_fluid, 2)
            fields = fields.changed(lambda n, values: values[particle] * (sign if field_of(n).odd else 1.0))
            cell_fields = cell_fields.changed(lambda _, values: np.tile(values, 2))
            lower, openings = np.array([-upper[0], lower[1]]), on_both_sides(openings)

        checked: dict[str, Any] = dict(position=position, cells=cells, fluid=fluid, wall=wall, cell_fluid=cell_fluid)
        checked |= dict(fields=fields, cell_fields=cell_fields, time=float(self.time), fluid_names=names, lower=lower)
        checked |= dict(upper=upper, spacing=spacing, trails=trails, openings=openings, period=period)
        for name, value in checked.items():
            object.__setattr__(self, name, value)

    @cached_property
    def geometry(self) -> Geometry:
        """Edges, interface and walls, computed at the first use and kept."""
        return Geometry(self.position, self.cells, self.fluid, self.wall, self.cell_fluid)

    @property
    def axes(self) -> tuple[str, str]:
        """Names of the coordinates."""
        return ("r", "z") if self.axial else self.plane or ("x", "y")

    def field_values(self, name: str) -> Array:
        """Values (N,) of a field at the particles; `ValueError` if there is none, or they are not finite."""
        if name not in self.fields:
            known = ", ".join(sorted(self.fields)) or "none"
            raise ValueError(f"field {name!r} is not in the results; there are: {known}")
        return self._finite(name, self.fields[name], "particle")

    def cell_values(self, name: str) -> Array:
        """Values (M,) of a field of `cell_fields`; `ValueError` if they are not finite."""
        return self._finite(name, self.cell_fields[name], "cell")

    def _finite(self, name: str, values: Array, of: str) -> Array:
        bad = np.flatnonzero(~np.isfinite(values))
        if len(bad):
            raise ValueError(
                f"field {name!r} at t = {self.time:g} s: {len(bad)} values are not finite, the first at {of} {bad[0]}"
            )
        return values


def _checked(what: str, given: Mapping[str, Array], count: int) -> Lazy:
    """Fields (count,) as float64; those that are `Lazy` are made and checked at their first use, others now."""

    def check(name: str, values: Array) -> Array:
        values = np.asarray(values, np.float64)
        if values.shape != (count,):
            raise ValueError(f"{what} {name!r}: shape {values.shape}, expected ({count},)")
        return values

    if isinstance(given, Lazy):
        return given.changed(check)
    made = {name: check(name, values) for name, values in given.items()}
    return Lazy({name: partial(made.__getitem__, name) for name in made})


def _integers(name: str, values: ArrayLike, count: int) -> Array:
    array = np.asarray(values)
    if array.shape != (count,):
        raise ValueError(f"{name}: shape {array.shape}, expected ({count},)")
    return array.astype(np.int64)


def _check_index(name: str, values: Array, count: int, of: str) -> None:
    if values.size and (values.min() < 0 or values.max() >= count):
        raise ValueError(f"{name}: indices from {values.min()} to {values.max()}, expected 0 to {count - 1} ({of})")
