"""Probe: what all probes have."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from annotated_types import Gt, Len, MinLen

from tipfem.arguments import numbers
from tipfem.case.case import Case
from tipfem.case.declaration import Unit, plain, require
from tipfem.case.walls import Pose
from tipfem.errors import CheckpointError, Invalid
from tipfem.results.history_columns import contents_of
from tipfem.typing import Array

if TYPE_CHECKING:  # which start Taichi
    from tipfem.mesh.mesh import Mesh
    from tipfem.physics.state import Solved, State
    from tipfem.step.stepper import Stepper

Frame = Literal["laboratory", "tank"]
Place = Annotated[Sequence[float], Len(2, 3), Unit("m")]
_FILE_NAME = set("abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789-_.")
KINDS: dict[str, type[Probe]] = {}  # by what a case file calls them


@dataclass(frozen=True, kw_only=True)
class Probe:
    """Base class of all probes, also of a user's own.

    A probe of one's own is a frozen dataclass with the methods `columns` and `sample`: the first names what is
    measured and checks it against the case, the second measures. `Simulation` samples it and writes its file as
    with all others; `Simulation.resume` needs it to be given again.

    Attributes:
        name: of the probe, and of its file ``probes/NAME.csv``.
        interval: time between samples [s]: the first step that reaches a multiple of it is sampled, the steps
            themselves do not change. By default every step is.

    Raises:
        ValueError: the name cannot be that of a file, or the interval is no length of time.
    """

    name: Annotated[str, MinLen(1)]
    interval: Annotated[float, Gt(0), Unit("s")] | None = None

    def __init_subclass__(cls, kind: str = "", **others: Any) -> None:
        super().__init_subclass__(**others)
        if kind:
            KINDS[kind] = cls

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not self.name or not set(self.name) <= _FILE_NAME or self.name[0] == ".":
            text = f"is {self.name!r}; it names a file and must be letters, digits, - _ and ."
            raise Invalid(("probes", self.name, "name"), text, type(self).__name__)
        require(self, ("probes", self.name), str(self))

    def invalid(self, name: str, text: str) -> Invalid:
        """The error on a value of the probe."""
        return Invalid(("probes", self.name, name), text, str(self))

    def __str__(self) -> str:
        return f"{type(self).__name__} {self.name!r}"

    def columns(self, case: Case) -> list[tuple[str, str]]:
        """Names and units of the values; raises ValueError if the probe does not fit the case."""
        text = "has no method columns(case), the names and units of its values"
        raise NotImplementedError(f"{type(self).__name__} {text}")

    def sample(self, simulation: Stepper) -> list[float]:
        """The values at the present time, in the order of `columns`; NaN where there is nothing to measure."""
        text = "has no method sample(simulation), the values that it measures"
        raise NotImplementedError(f"{type(self).__name__} {text}")

    def rows(self, simulation: Stepper) -> list[list[float]]:
        """The rows that a step adds, by default the one of `sample`."""
        return [self.sample(simulation)]

    def _fluid(self, case: Case, name: str) -> int:
        try:
            return case.fluid_index(name)
        except ValueError as error:
            raise self.invalid("fluid", f": {error}") from None

    def _point(self, case: Case, what: str, value: Any) -> Array:
        point = floats(value)
        if point.shape != (case.particles.dimension,) or not np.isfinite(point).all():
            raise self.invalid(what, f"is {value!r}; it must be {case.particles.dimension} coordinates in m")
        return point


def floats(value: Any) -> Array:
    """``value`` as an array of floats; an empty one where it is none."""
    try:
        return np.asarray(numbers(value), dtype=float)
    except (TypeError, ValueError):
        return np.zeros(0)


def pressure_in(state: State | Solved, mesh: Mesh, particle: Array, cell: Array) -> Array:
    """Pressures (K,) of particles (K,) on the side of the cells (K,) of a mesh that they are corners of [Pa].

    A particle on an interface has a pressure of each fluid there. Those of the fluids beyond the interface are not
    continued: at a wall that water has just wetted at one particle, that would be a force on the dry face above.
    """
    from tipfem.physics.side_pressures.carried import PressureJump  # here, for it starts Taichi

    pressure, jump = state.particles.pressure[particle], state.part(PressureJump)
    if jump is None or mesh.fluid is None:
        return np.asarray(pressure)
    return np.asarray(pressure + jump.values[mesh.fluid[cell], particle])


def pose_of(case: Case, time: float) -> Pose:
    """Pose of the tank of a case at a time [s]."""
    if case.tank_motion is None:
        return Pose.still(case.particles.dimension)
    return case.tank_motion.pose(time, 1e-3, case.particles.dimension)


def in_laboratory(simulation: Stepper, places: Array, frame: str) -> Array:
    """Positions of ``places`` (K, d) [m] of a frame at present, in the laboratory."""
    return pose_of(simulation.case, simulation.time).place(places) if frame == "tank" else places


def require_plane(probe: Probe, case: Case) -> None:
    """Raise ValueError unless the case is 2-D."""
    if case.particles.dimension != 2:
        text = f": this probe is for 2-D; the case has {case.particles.dimension} dimensions"
        raise Invalid(("probes", probe.name), text, str(probe))


def require_inside(probe: Probe, case: Case, name: str, place: Array) -> None:
    """`ValueError` unless the place (d,) of the attribute ``name`` is in the tank, or the particles' box."""
    lower, upper = case.particles.position.min(axis=0), case.particles.position.max(axis=0)
    lower, upper = np.where(case.period.width > 0, 0.0, lower), np.maximum(upper, case.period.width)
    slack = 1e-9 * (upper - lower)
    if ((place < lower - slack) | (place > upper + slack)).any():
        text = f"is {place.tolist()} m, which lies outside of the tank from {lower.tolist()} to {upper.tolist()} m"
        raise probe.invalid(name, text)
    if case.blocks is not None and not case.blocks.around(place[None], slack.max())[0][0]:
        name_of_block = case.blocks.names[case.blocks.passed(place[None])[0]].rpartition(" ")[0]
        raise probe.invalid(name, f"is {place.tolist()} m, which lies in the block {name_of_block!r}")
    if case.tank is not None and (solid := case.tank.solid) is not None:
        depth = solid.normal @ place - solid.offset
        if depth.min() < -slack.max():
            text = f"is {place.tolist()} m, which lies outside of the tank, {-depth.min():.3g} m behind "
            raise probe.invalid(name, f"{text}{solid.names[depth.argmin()]!r}")
    domain = case.domain
    if domain is None or domain is not case.boundary.tank:  # what moves in the tank uncovers places
        return
    distance, _ = domain.distances(place[None])
    if not domain.contains(place[None])[0] and distance.min() > slack.max():
        side = domain.sides[domain.side[distance.argmin()]]
        text = f"is {place.tolist()} m, which lies outside of the tank, {distance.min():.3g} m behind {side!r}"
        raise probe.invalid(name, text)


def contents(case: Case) -> int:
    """3 where volumes are in m^3; 2 where all is per metre of depth."""
    return contents_of(case.particles.dimension, case.coordinates)


def probe_record(probe: Probe) -> dict[str, Any]:
    """Record of a probe as plain values; of one that is not of `KINDS`, its name and class alone."""
    for kind, made in KINDS.items():
        if made is type(probe):
            return {"type": kind, **plain(probe)}
    return {"class": type(probe).__qualname__, "name": probe.name}


def probe_from(record: Mapping[str, Any]) -> Probe:
    """The probe that a record of `probe_record` describes; `CheckpointError` if it is not of `KINDS`."""
    values = dict(record)
    kind = values.pop("type", None)
    if kind not in KINDS:
        text = f"the run had the probe {values['name']!r} of the class {values.get('class', kind)}, which no file "
        raise CheckpointError(f"{text}keeps; give the probes to resume")
    return KINDS[kind](**values)
