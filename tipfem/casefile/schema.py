"""The schema of case files: every table and key with its unit, range and default.

Ranges and defaults are those of the classes that the tables become; a test compares them.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field

from tipfem.casefile.forms import (
    Curve,
    Disc,
    HalfSpace,
    Limit,
    Model,
    Point,
    TimeFunction,
    Vector,
    VectorOrFunction,
    quantity,
)
from tipfem.casefile.outlines import ShapeTable

SCHEMA_ID = "case.schema.json"  # beside the case file; `tipfem schema --out case.schema.json` writes it


class FluidTable(Model):
    """An incompressible Newtonian fluid."""

    density: float = quantity("mass density", "kg/m^3", gt=0)
    viscosity: float = quantity("dynamic viscosity", "Pa s", ge=0)


class TankTable(Model):
    """A closed box with walls all around, one corner of which is the origin; or a tank of any shape in 2-D."""

    size: list[Annotated[float, Field(gt=0)]] | None = quantity(
        "edge lengths of a box", "m", None, min_length=2, max_length=3
    )
    shape: ShapeTable | None = Field(None, description="the shape of the tank in 2-D, in place of size")
    spacing: float = quantity("distance between particles", "m", gt=0)
    jitter: float = quantity(
        "random displacement of the particles off the walls, in spacings; a tank in 3-D needs some",
        default=0.0,
        ge=0,
        le=0.4,
    )
    seed: int = quantity("seed of the random displacement", default=0, ge=0)
    periodic: Literal["x", "xy"] | None = quantity(
        "x: no walls on the left and right of a box in 2-D, what leaves there enters on the other side; "
        "xy: nor below and above",
        default=None,
    )


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


class WallTable(Model):
    """A wall that is not simply fixed and no-slip."""

    between: list[Point] | None = quantity(
        "the two ends of a part of a wall in 2-D; left out, the table is named after a wall of the tank, or a side of "
        "its shape",
        "m",
        None,
        min_length=2,
        max_length=2,
    )
    particles: list[int] | None = quantity("indices of its particles, in place of between", default=None, min_length=1)
    slip: bool = quantity("whether the fluid slides along it without friction", default=False)
    slip_length: float | None = quantity("length of Navier's slip condition", "m", None, gt=0)
    law: Literal["no-slip", "layer"] | None = quantity(
        "no-slip, or layer: slip with the friction of a boundary layer that is thinner than the spacing; "
        "layer for straight walls without a table, in 2-D",
        default=None,
    )
    velocity: VectorOrFunction | None = quantity("velocity of a wall that slides along itself", "m/s", None)
    speed: float | None = quantity(
        "speed of a side of a shape along itself, anticlockwise about what its outline encloses; in place of velocity",
        "m/s",
        None,
    )
    motion: TimeFunction | None = quantity(
        "displacement along the wall's normal into the fluid, a smooth function of time that is zero at t = 0",
        "m",
        None,
    )


class MotionTable(Model):
    """Rigid motion of the whole tank."""

    translation: TimeFunction | None = quantity("displacement, a function of time that is zero at t = 0", "m", None)
    angle: TimeFunction | None = quantity("angle, anticlockwise, a function that is zero at t = 0", "rad", None)
    pivot: Vector | None = quantity("point about which the tank turns; by default the origin", "m", None)
    axis: list[float] = quantity(
        "axis of the rotation, in 3-D only", default=[0.0, 0.0, 1.0], min_length=3, max_length=3
    )


class BodyMotionTable(Model):
    """Prescribed rigid motion of a body."""

    translation: TimeFunction | None = quantity("displacement, a function of time that is zero at t = 0", "m", None)
    angle: TimeFunction | None = quantity("angle, anticlockwise, a function that is zero at t = 0", "rad", None)
    pivot: Point | None = quantity("point about which the body turns; by default its centre", "m", None)


class BodyTable(Model):
    """A rigid body in a tank in 2-D: fixed, with a prescribed motion, or, with a density or a mass, floating."""

    name: str = quantity("for columns of the history and messages", default="body", min_length=1)
    box: list[Point] | None = quantity("lower and upper corner", "m", None, min_length=2, max_length=2)
    disc: Disc | None = Field(None, description="a circular body")
    polygon: list[Point] | None = quantity("corners (x, y) of its outline, in order", "m", None, min_length=3)
    motion: BodyMotionTable | None = Field(None, description="prescribed motion")
    density: float | None = quantity("of a body that floats", "kg/m^3", None, gt=0)
    mass: float | None = quantity("of a body that floats, in place of density", "kg/m", None, gt=0)
    centre: Point | None = quantity("centre of mass at t = 0; by default that of the area", "m", None)
    inertia: float | None = quantity("moment of inertia about the centre of mass", "kg m^2/m", None, gt=0)
    hinge: Point | None = quantity("fixed point about which a body that floats turns", "m", None)
    free: list[Literal["x", "y", "angle"]] | None = quantity(
        "in what a body that floats moves; by default in all, with a hinge in its angle", default=None, min_length=1
    )
    velocity: Point = quantity("of the centre of mass of a body that floats, at the start", "m/s", [0.0, 0.0])
    angular_velocity: float = quantity("of a body that floats, at the start", "rad/s", 0.0)
    stiffness: list[float] = quantity(
        "of springs to ground in x and y [N/m] and angle [N m/rad], per metre of depth",
        default=[0.0, 0.0, 0.0],
        min_length=3,
        max_length=3,
    )
    damping: list[float] = quantity(
        "of dampers to ground in x and y [N s/m] and angle [N m s], per metre of depth",
        default=[0.0, 0.0, 0.0],
        min_length=3,
        max_length=3,
    )
    contact: Literal["stop", "hold"] = quantity(
        "at a gap of about half a spacing: stop the run, or hold the body where it is", default="stop"
    )


class GradingTable(Model):
    """Distances between particles that grow away from interfaces; with the sharp interface only."""

    largest: dict[str, float] = quantity("by a fluid's name, the distance far from its interfaces", "m", {})
    growth: float = quantity("by how much the distance grows per distance", default=0.2, ge=0.02, le=0.5)
    limits: list[Limit] = Field([], description="boxes in which particles stand closer")


class FittingTable(Model):
    """When the triangulation is changed with the sharp interface; lengths in spacings."""

    too_close: float = quantity("closer particles inside a fluid are removed", "spacings", 0.6, ge=0.1, le=0.95)
    too_close_to_interface: float = quantity(
        "the same for the distance to edges of interfaces and walls", "spacings", 0.4, ge=0.05, le=0.8
    )
    too_close_along_interface: float = quantity(
        "the same along interfaces and walls", "spacings", 0.55, ge=0.1, le=0.95
    )
    long_edge: float = quantity("longer edges of interfaces and walls are split first", "spacings", 1.5, ge=1.2, le=5.0)
    removable: float = quantity("closer particles can be removed for such edges", "spacings", 0.75, ge=0.1, le=0.95)
    thin_film: float = quantity("thinner films break", "spacings", 0.3, ge=0.0, le=0.8)
    contact_reach: float = quantity("how far a contact may slide in one repair", "spacings", 0.8, ge=0.0, le=3.0)
    flip_tolerance: float = quantity(
        "how far a particle may be inside a circumcircle before an edge is flipped, relative",
        default=1e-3,
        ge=0.0,
        le=0.2,
    )


class RelocationTable(Model):
    """When a particle is moved, and where to, with the interpolated interface; lengths in spacings."""

    too_close: float = quantity("closer particles are moved", "spacings", 0.6, gt=0)
    too_close_to_wall: float = quantity("particles closer to a wall are moved", "spacings", 0.4, gt=0)
    long_edge: float = quantity("longer edges within a fluid take a particle", "spacings", 1.2, gt=0)
    long_mixed_edge: float = quantity("longer edges between two fluids take a particle", "spacings", 1.8, gt=0)
    urgent: float = quantity("closer particles are moved at once", "spacings", 0.35, gt=0)
    at_surface: float = quantity("factor where one of two particles is on a free surface", default=0.75, gt=0)
    along_surface: float = quantity("factor where both are", default=0.5, gt=0)


class SurfaceTable(Model):
    """Which simplices are fluid, with a free surface; lengths in spacings."""

    alpha: float = quantity("largest circumradius at the surface", "spacings", 1.2, ge=0.75, le=10.0)
    inner: float = quantity("the same below the surface", "spacings", 1.8, ge=0.75, le=20.0)
    first: float = quantity("factor for the first mesh of particles given as arrays", default=0.85, ge=0.5, le=2.0)
    join: float = quantity("largest circumradius of simplices that become fluid", "spacings", 0.8, ge=0.3, le=10.0)
    gap: float = quantity("or largest height of theirs", "spacings", 0.6, ge=0.1, le=2.0)
    touch: float = quantity("height over a dry wall that counts as touching", "spacings", 0.6, ge=0.4, le=2.0)
    wet: float = quantity("the same over a wall that is wet at one end", "spacings", 1.2, ge=0.4, le=3.0)
    dry: float = quantity("part of the wall's edge behind which a particle leaves", default=0.25, ge=0.0, le=0.5)


class NumericsTable(Model):
    """The numbers of the method; see tipfem.Numerics."""

    rho_inf: float = quantity("spectral radius of generalized-alpha", default=0.0, ge=0.0, le=1.0)
    stabilisation: float = quantity("c in tau = c dt T of the PSPG term", default=0.25, ge=1e-6, le=10.0)
    volume_correction: float = quantity(
        "rate at which lost volume is given back, in sqrt(|b| / h); 0: not", default=1.0, ge=0.0, le=100.0
    )
    momentum_transfer: bool = quantity(
        "whether particles take on momentum with mass, with the interpolated interface", default=True
    )
    newton_tolerance: float = quantity("of the largest residual", "spacings", 1e-5, ge=1e-14, le=1e-1)
    acceleration_tolerance: float = quantity(
        "of the same residual as an acceleration, relative to the flow's own", default=1e-2, ge=1e-12, le=1.0
    )
    newton_iterations: int = quantity("after which a step is refused", default=12, ge=1, le=100)
    jacobian: Literal["rows", "matrix-free"] = quantity(
        "rows: gather the Jacobian; matrix-free: compute its products from the elements", default="rows"
    )
    pressure: Literal["auto", "continuous", "two-sided"] = quantity(
        "on interfaces: one for all fluids, or one for each, with the sharp interface only; auto: there, for each",
        default="auto",
    )
    mass: Literal["lumped", "consistent", "interfaces"] = quantity(
        "matrix: lumped, consistent, or consistent in cells at interfaces between fluids only", default="lumped"
    )
    largest_move: float = quantity("displacement that a step aims at", "spacings", 0.35, ge=0.01, le=0.8)
    smallest_jacobian: float = quantity("below it a step is refused", default=0.05, ge=0.0, le=0.9)
    triangulation: Literal["repair", "rebuild"] = quantity(
        "of the interpolated interface in 2-D: repair the last mesh, or rebuild it every time", default="repair"
    )
    energy_balance: bool = quantity(
        "whether energy that remeshing adds or takes is balanced, with the sharp interface", default=True
    )
    budget: Literal["total", "detailed"] = quantity(
        "detailed: the history also has what each kind of repair of the mesh adds to each fluid", default="total"
    )
    fitting: FittingTable = Field(default_factory=FittingTable, description="rule of the sharp interface")
    relocation: RelocationTable = Field(
        default_factory=RelocationTable, description="rule of the interpolated interface"
    )
    surface: SurfaceTable = Field(default_factory=SurfaceTable, description="rule of the free surface")


class TimeTable(Model):
    """How long, and in which steps."""

    end: float = quantity("simulated time to run to", "s", gt=0)
    largest_step: float | None = quantity(
        "largest time step; by default 0.05 sqrt(h / |b|) with the largest acceleration b", "s", None, gt=0
    )


class OutputTable(Model):
    """What is written, and where."""

    folder: str | None = quantity(
        "folder for the results, relative to where the command runs; by default out/ and the case file's name",
        default=None,
        min_length=1,
    )
    interval: float | None = quantity(
        "time between states written to disk; by default only the first and the last", "s", None, gt=0
    )
    fields: Literal["vtu", "vtkhdf", "both"] = quantity(
        "vtu: a file a state, and fields.pvd, which lists them; vtkhdf: all in fields.vtkhdf; or both", default="vtu"
    )
    precision: Literal["double", "single"] = quantity(
        "of positions, velocities, pressures and densities; single takes half the space", default="double"
    )
    compression: int = quantity("level of zlib in fields.vtkhdf; 0: none", default=4, ge=0, le=9)


class ProbeTable(Model):
    """What is measured on the way; which keys it takes beside type, name and interval depends on its type."""

    type: Literal["point", "line", "wall pressure", "wall force", "wave gauge", "front", "volume", "energy"] = quantity(
        "the kind of probe"
    )
    name: str = quantity("of the probe, and of its file probes/NAME.csv", min_length=1)
    interval: float | None = quantity("time between samples; by default every step", "s", None, gt=0)
    at: Vector | None = quantity("place, of a point or a wall pressure", "m", None)
    start: Vector | None = quantity("one end of a line", "m", None)
    end: Vector | None = quantity("the other end of a line", "m", None)
    count: int | None = quantity("number of points on a line, both ends included", default=None, ge=2)
    quantities: list[str] | None = quantity(
        "at points and along lines: pressure, velocity_x, velocity_y, velocity_z, density; by default pressure",
        default=None,
        min_length=1,
    )
    frame: Literal["laboratory", "tank"] | None = quantity(
        "tank: points, lines and wave gauges move with the tank; by default laboratory", default=None
    )
    wall: str | None = quantity("name of a wall: left, right, bottom, top, or one of the table walls", default=None)
    fluid: str | None = quantity("name of a fluid", default=None)
    about: Point | None = quantity("point about which a wall force has its moment; by default the origin", "m", None)
    impulse: bool | None = quantity(
        "of a wall pressure or force: further columns with the integrals over time; by default none", default=None
    )
    time_constant: float | None = quantity(
        "of a wall pressure or force: further columns with the values of a first-order low-pass filter of this time "
        "constant; by default none",
        "s",
        None,
        gt=0,
    )
    x: float | None = quantity("place of a wave gauge", "m", None)
    axis: int | None = quantity("of a front: 0 for x, 1 for y, 2 for z; by default 0", default=None, ge=0, le=2)


class CheckpointTable(Model):
    """How often a checkpoint is written, from which the run can go on."""

    interval: float | None = quantity("simulated time between checkpoints; by default none by it", "s", None, gt=0)
    wall_interval: float = quantity("wall-clock time between checkpoints; 0: none by the clock", "s", 60.0, ge=0)


class CaseTable(Model):
    """A two-phase flow for tipfem. All quantities are in SI units."""

    title: str = quantity("what pictures are headed with", default="")
    gravity: Vector = quantity("acceleration, a number for each coordinate", "m/s^2")
    body_force: TimeFunction | None = quantity("further acceleration, the same everywhere", "m/s^2", None)
    interface: Literal["sharp", "interpolated"] | None = quantity(
        "sharp: interfaces run along edges (2-D, no free surface); interpolated: through elements. By default sharp, "
        "with a free surface interpolated",
        default=None,
    )
    free_surface: bool = quantity("whether fluids may end where nothing is", default=False)
    fluids: dict[str, FluidTable] = Field(description="the fluids by their names", min_length=1)
    tank: TankTable | None = Field(None, description="the tank that is filled; or particles")
    particles: ParticlesTable | None = Field(None, description="particles given as arrays, in place of a tank")
    fill: list[FillTable] = Field([], description="what the tank is filled with, in order")
    bodies: list[BodyTable] = Field([], description="rigid bodies in the tank")
    walls: dict[str, WallTable] = Field({}, description="walls that slip, slide or move, by their names")
    tank_motion: MotionTable | None = Field(None, description="rigid motion of the whole tank")
    grading: GradingTable | None = Field(None, description="distances between particles by place and fluid")
    numerics: NumericsTable = Field(default_factory=NumericsTable, description="the numbers of the method")
    time: TimeTable = Field(description="how long, and in which steps")
    output: OutputTable = Field(default_factory=OutputTable, description="what is written, and where")
    checkpoint: CheckpointTable = Field(
        default_factory=CheckpointTable, description="how often checkpoints are written"
    )
    probes: list[ProbeTable] = Field([], description="what is measured on the way, each in a file of its own")


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
    choices = [choice for choice in content.get("anyOf", []) if choice != {"type": "null"}]
    if len(choices) == 1:
        del content["anyOf"]
        content = {**choices[0], **content}
    return content
