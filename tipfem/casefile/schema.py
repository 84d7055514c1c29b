"""The schema of case files: every table and key with its unit, range and default.

What a table has in common with the class that it becomes is declared there; see `tipfem.case.declaration`.
"""

from __future__ import annotations

from functools import cache, reduce
from operator import or_
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import Field, create_model

from tipfem.case.declaration import declared
from tipfem.case.fluid import Fluid
from tipfem.case.grading import Grading
from tipfem.case.numerics import Numerics
from tipfem.case.rheology import LAWS, Law
from tipfem.case.tank import TankNumbers
from tipfem.casefile.forms import (
    Curve,
    Disc,
    HalfSpace,
    Limit,
    Model,
    MotionTable,
    Point,
    TimeFunction,
    Vector,
    declares,
    or_function,
    quantity,
)
from tipfem.casefile.lists import with_lists
from tipfem.casefile.outlines import ShapeTable
from tipfem.casefile.pairs import Tensions
from tipfem.casefile.registry import LISTED
from tipfem.probes import KINDS, Probe
from tipfem.results.fields import FieldOutput

SCHEMA_ID = "case.schema.json"  # beside the case file; `tipfem schema --out case.schema.json` writes it


def _law_table(name: str, kind: type[Law]) -> type[Model]:
    tag: Any = (Literal[name], Field(description="the law"))
    text = (kind.__doc__ or "").partition("\n\n")[0]
    return declares(kind, *declared(kind))(create_model(kind.__name__, __base__=Model, __doc__=text, law=tag))


LAW_TABLES = {name: _law_table(name, kind) for name, kind in LAWS.items()}
ViscosityOrLaw = (
    Any if TYPE_CHECKING else or_function(Annotated[float, Field(ge=0)], (int, float), LAW_TABLES, key="law")
)


@declares(Fluid, "density")
class FluidTable(Model):
    """An incompressible fluid."""

    viscosity: ViscosityOrLaw = quantity("dynamic viscosity, or a table of the law that it follows", "Pa s")


@declares(TankNumbers)
class TankTable(Model):
    """A closed box with walls all around, one corner of which is the origin; or a tank of another shape, or a mesh."""

    size: list[Annotated[float, Field(gt=0)]] | None = quantity(
        "edge lengths of a box", "m", None, min_length=2, max_length=3
    )
    shape: ShapeTable | None = Field(None, description="the shape of the tank in 2-D, in place of size")
    corners: list[Vector] | None = quantity(
        "corners (x, y, z) of a convex tank in 3-D, in any order, in place of size", "m", None, min_length=4
    )
    mesh: str | None = quantity(
        "a mesh file, as of Gmsh, in place of size, its path relative to the case file: its surfaces are named after "
        "the fluids that fill them, its curves are the walls",
        default=None,
        min_length=1,
    )
    surface: str | None = quantity(
        "a file of a closed convex surface of triangles, STL, in place of size, its path relative to the case file: a "
        "tank in 3-D",
        default=None,
        min_length=1,
    )
    scale: float = quantity("by which the coordinates of a file are multiplied, 1e-3 for one in mm", "", 1.0, gt=0)


class BlockTable(Model):
    """A box taken out of a tank in 3-D. Its sides are walls: its name with left, right, bottom, top, back or front."""

    box: list[Vector] = quantity("lower and upper corner", "m", min_length=2, max_length=2)


class ParticlesTable(Model):
    """Particles given as arrays in place of a tank."""

    file: str = quantity(
        "an NPZ file of NumPy, its path relative to the case file, with the arrays of tipfem.Particles: position "
        "(N, d), fluid (N,), wall (N,), and, where not zero, velocity, acceleration, pressure; spacing",
        min_length=1,
    )


class FillTable(Model):
    """A part of the tank that is filled with a fluid; later fills replace earlier ones. Without a shape, all of it."""

    fluid: str = quantity("name of a fluid of the table fluids")
    box: list[Vector] | None = quantity("lower and upper corner", "m", None, min_length=2, max_length=2)
    disc: Disc | None = Field(None, description="a disc; a ball in 3-D")
    half_space: HalfSpace | None = Field(None, description="one side of a straight line or plane")
    polygon: list[Point] | None = quantity("corners (x, y) of a closed polyline, in order", "m", None, min_length=3)
    shape: ShapeTable | None = Field(None, description="any shape in 2-D, with arcs and holes")
    below: Curve | None = Field(None, description="what is below a curve over x: an interface given as a wave, say")
    above: Curve | None = Field(None, description="what is above a curve over x")
    velocity: Vector | None = quantity("velocity of the fluid at the start; at rest by default", "m/s", None)


@declares(Grading, "growth", "film_resolution")
class GradingTable(Model):
    """Distances between particles that grow away from interfaces; with the sharp interface only."""

    largest: dict[str, float] = quantity("by a fluid's name, the distance far from its interfaces", "m", {})
    limits: list[Limit] = Field([], description="boxes in which particles stand closer")


@declares(Numerics)
class NumericsTable(Model):
    """The numbers of the method; see tipfem.Numerics."""


class TimeTable(Model):
    """Duration, and time steps."""

    end: float = quantity("simulated time to run to", "s", gt=0)
    largest_step: float | None = quantity(
        "largest time step; by default 0.1 sqrt(h / |b|) with the largest acceleration b", "s", None, gt=0
    )


@declares(FieldOutput, "precision", "compression", "quantities", fields="format")
class OutputTable(Model):
    """Results that are written, and their folder."""

    folder: str | None = quantity(
        "folder for the results, relative to where the command runs; by default out/ and the case file's name",
        default=None,
        min_length=1,
    )
    interval: float | None = quantity(
        "time between states written to disk; by default only the first and the last", "s", None, gt=0
    )


def _probe_table(name: str, kind: type[Probe]) -> type[Model]:
    tag: Any = (Literal[name], Field(description="the kind of probe"))
    base = create_model(kind.__name__, __base__=Model, type=tag)
    return declares(kind, *declared(kind))(base)


PROBES = {name: _probe_table(name, kind) for name, kind in KINDS.items()}
ProbeTable = Annotated[reduce(or_, PROBES.values()), Field(discriminator="type")] if not TYPE_CHECKING else Model


class CheckpointTable(Model):
    """Intervals between checkpoints, from which the run can go on."""

    interval: float | None = quantity("simulated time between checkpoints; by default none by it", "s", None, gt=0)
    wall_interval: float = quantity("wall-clock time between checkpoints; 0: none by the clock", "s", 60.0, ge=0)


@with_lists(LISTED)
class CaseTable(Model):
    """A two-phase flow for tipfem. All quantities are in SI units."""

    variables: dict[str, float] = Field(
        {}, description='numbers by names, which other values may be written with, as "= gate / 2"'
    )
    title: str = quantity("what pictures are headed with", default="")
    gravity: Vector = quantity("acceleration, a number for each coordinate", "m/s^2")
    body_force: TimeFunction | None = quantity("further acceleration, the same everywhere", "m/s^2", None)
    interface: Literal["sharp", "interpolated"] | None = quantity(
        "sharp: interfaces run along edges or faces; interpolated: through elements, not with a free surface in 3-D. "
        "By default sharp",
        default=None,
    )
    free_surface: bool = quantity("whether fluids may end where nothing is", default=False)
    surface_tension: Tensions = quantity(
        "surface tension by the names of the two fluids, as water.air = 0.0728, or of the one at a free surface, as "
        "water = 0.0728, or beside other fluids there, as water = { surface = 0.0728, oil = 0.045 }",
        "N/m",
        {},
    )
    fluids: dict[str, FluidTable] = Field(description="the fluids by their names", min_length=1)
    tank: TankTable | None = Field(None, description="the tank that is filled; or particles")
    particles: ParticlesTable | None = Field(None, description="particles given as arrays, in place of a tank")
    fill: list[FillTable] = Field([], description="what the tank is filled with, in order")
    blocks: dict[str, BlockTable] = Field({}, description="boxes taken out of the tank, in 3-D, by their names")
    tank_motion: MotionTable | None = Field(None, description="rigid motion of the whole tank")
    grading: GradingTable | None = Field(None, description="distances between particles by place and fluid")
    numerics: NumericsTable = Field(default_factory=NumericsTable, description="the numbers of the method")
    time: TimeTable = Field(description="how long, and in which steps")
    output: OutputTable = Field(default_factory=OutputTable, description="what is written, and where")
    checkpoint: CheckpointTable = Field(
        default_factory=CheckpointTable, description="how often checkpoints are written"
    )
    probes: list[ProbeTable] = Field([], description="what is measured on the way, each in a file of its own")


@cache
def json_schema() -> dict[str, Any]:
    """The JSON schema of case files, for editors; `Problem` texts are made from it, too."""
    content = _without_null(CaseTable.model_json_schema())
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", "$id": SCHEMA_ID, **content, "title": "Case"}


def _without_null(node: Any) -> Any:
    """A schema without the choice of null, which TOML does not have, and without titles, which repeat the keys."""
    if isinstance(node, list):
        return [_without_null(item) for item in node]
    if not isinstance(node, dict):
        return node
    named = {"properties", "$defs"}  # whose keys are names of ours
    content = {
        key: {name: _without_null(item) for name, item in value.items()} if key in named else _without_null(value)
        for key, value in node.items()
        if not (key == "title" and isinstance(value, str)) and not (key == "default" and value is None)
    }
    choices = [choice for choice in content.pop("anyOf", []) if choice != {"type": "null"}]
    if len(choices) == 1:
        return {**choices[0], **content}
    return {"anyOf": choices, **content} if choices else content
