"""The commands, with values in SI units that are checked when a command is made and again for the case."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, ClassVar

import numpy as np
from annotated_types import Ge, Gt, Len

from tipfem.case.case import Case
from tipfem.case.declaration import Unit, declared, require
from tipfem.case.rheology import Law
from tipfem.case.walls import Wall
from tipfem.errors import Invalid

# Largest magnitude of a gravity or of a poke [m/s^2]: ten times that of the earth. More would shorten the steps, and
# throw the particles about, without showing more.
LARGEST_ACCELERATION = 98.0665
LEAST_DROP = 2.0  # radius, in spacings: a smaller drop has too few cells to keep its shape


Vector = Annotated[tuple[float, ...], Len(2, 3)]
Acceleration = Annotated[Vector, Unit("m/s^2")]


class Command(ABC):
    """A command to a run; its values are declared, and checked when it is made."""

    name: ClassVar[str]  # of the command in files and messages
    physical: ClassVar[bool] = True  # whether it changes what the steps compute
    strokes: ClassVar[bool] = False  # whether those that follow closely, as from a slider, are one for undo

    def __post_init__(self) -> None:
        require(self, subject=self.name)
        for key, field in declared(type(self)).items():
            value = getattr(self, key)
            if field.items is float:
                object.__setattr__(self, key, tuple(map(float, value)))
                if field.unit == "m/s^2" and (size := math.hypot(*value)) > LARGEST_ACCELERATION * (1 + 1e-9):
                    text = f"it must be at most {LARGEST_ACCELERATION:g} m/s^2"
                    raise Invalid(key, f"is {list(value)} m/s^2, of magnitude {size:.4g}; {text}", self.name)
            elif field.kind is float and value is not None:
                object.__setattr__(self, key, float(value))

    def values(self) -> dict[str, Any]:
        """Its values for JSON, by name, from which `command_from` makes it again."""
        return {key: list(value) if isinstance(value, tuple) else value for key, value in vars(self).items()}

    @abstractmethod
    def require(self, case: Case) -> None:
        """Check it against a case; `ValueError` if it does not fit."""


@dataclass(frozen=True)
class Gravity(Command):
    """Another gravity from now on, such as that in the frame of a tank that is tilted.

    The potential energy in the history remains that of the case's gravity; the work of the difference is a part of the
    external work. The largest time step remains that of the case.

    Args:
        value: (d,) acceleration [m/s^2].

    Raises:
        ValueError: it is not finite, or larger than `LARGEST_ACCELERATION`; or there are no walls, see `tipfem.Case`.
    """

    value: Acceleration
    name = "gravity"
    strokes = True

    def require(self, case: Case) -> None:
        """See `Command.require`."""
        _require_dimension("gravity", self.value, case)
        if any(self.value) and case.period.everywhere:
            raise ValueError("gravity: the domain is periodic in all directions; no wall would hold the fluids in it")
        if case.period.axial and self.value[0]:
            raise ValueError(f"gravity: is {list(self.value)}; it must act along z, (0, g), in an axisymmetric flow")


@dataclass(frozen=True)
class Poke(Command):
    """An acceleration in a radius around a point; it takes the place of a poke that still acts.

    See `tipfem.case.forces.PokeForce` for its distribution. Its work is a part of the external work in the history.

    Args:
        at: (d,) point [m].
        acceleration: (d,) at the point [m/s^2].
        radius: beyond which there is none [m].
        duration: simulated time for which it acts [s], in whole steps; None until it is released.

    Raises:
        ValueError: a value is not finite, not positive, or larger than `LARGEST_ACCELERATION`.
    """

    at: Annotated[Vector, Unit("m")]
    acceleration: Acceleration
    radius: Annotated[float, Gt(0), Unit("m")]
    duration: Annotated[float, Gt(0), Unit("s")] | None = None
    name = "poke"
    strokes = True

    def require(self, case: Case) -> None:
        """See `Command.require`."""
        _require_dimension("poke: at", self.at, case)
        _require_dimension("poke: acceleration", self.acceleration, case)
        _require_in_box("poke: at", self.at, case)
        h = case.particles.spacing
        if self.radius < h:
            raise ValueError(f"poke: radius is {self.radius:g} m; it must be at least the spacing, {h:g} m")


@dataclass(frozen=True)
class Release(Command):
    """Ends the poke; in files and messages a poke whose ``at`` is null."""

    name = "poke"

    def values(self) -> dict[str, Any]:
        """See `Command.values`."""
        return {"at": None}

    def require(self, case: Case) -> None:
        """It fits every case."""


@dataclass(frozen=True)
class Drop(Command):
    """A drop of a fluid, inside another fluid or in the empty space of a case with a free surface.

    Inside a fluid, cells (or particles, where interfaces are interpolated) change their fluid: the volume of the drop
    is taken from the other fluid, and particles keep their velocities. In empty space, in 2-D, particles at rest are
    added. From then on the fluids have their new volumes: what restores volumes restores these.

    Args:
        at: (d,) centre [m].
        radius: [m]; at least two spacings.
        fluid: name of the fluid.

    Raises:
        ValueError: a value is not finite or not positive, or the fluid is not named.
    """

    at: Annotated[Vector, Unit("m")]
    radius: Annotated[float, Gt(0), Unit("m")]
    fluid: str
    name = "drop"

    def require(self, case: Case) -> None:
        """See `Command.require`; where there is room is found when the drop is added."""
        _require_dimension("drop: at", self.at, case)
        _require_in_box("drop: at", self.at, case)
        if case.period.axial:
            raise ValueError("drop: none can be added in an axisymmetric flow; put it into the case")
        names = [fluid.name for fluid in case.fluids]
        if self.fluid not in names:
            raise ValueError(f"drop: fluid is {self.fluid!r}; it must be one of {names}")
        h = case.particles.spacing
        if self.radius < LEAST_DROP * h:
            text = f"drop: radius is {self.radius:g} m; it must be at least {LEAST_DROP:g} spacings, "
            raise ValueError(f"{text}{LEAST_DROP * h:g} m")


@dataclass(frozen=True)
class SurfaceTension(Command):
    """Another surface tension of an interface from now on. The largest time step remains that of the case.

    Args:
        between: names of the two fluids, or of the one at a free surface; an interface that the case has a tension for.
        value: surface tension [N/m].

    Raises:
        ValueError: the names are no texts, or the value is no number >= 0.
    """

    between: tuple[str, ...]
    value: Annotated[float, Ge(0), Unit("N/m")]
    name = "surface_tension"
    strokes = True

    def __post_init__(self) -> None:
        names = (self.between,) if isinstance(self.between, str) else self.between
        if not (isinstance(names, Sequence) and len(names) in (1, 2) and all(isinstance(name, str) for name in names)):
            raise ValueError(f"surface_tension: between is {self.between!r}; it must be the names of one or two fluids")
        object.__setattr__(self, "between", tuple(names))
        super().__post_init__()

    def require(self, case: Case) -> None:
        """See `Command.require`."""
        if not case.surface_tension.has(self.between):
            pairs = [(one,) if isinstance(one, str) else one for one in case.surface_tension.given]
            known = ", ".join(" and ".join(pair) for pair in pairs) or "none"
            text = f"surface_tension: between is {' and '.join(self.between)}; the interfaces that have a tension are "
            raise ValueError(f"{text}{known}")


@dataclass(frozen=True)
class Viscosity(Command):
    """Another viscosity of a fluid from now on. The largest time step remains that of the case.

    Args:
        fluid: name of the fluid.
        value: dynamic viscosity [Pa s]; of a law of viscosity, the value of its number.
        number: of a law, which of its numbers, as "yield_stress"; empty for fluids without a law.

    Raises:
        ValueError: the fluid is not named, or the value is no number >= 0, or out of the range of the number of its
            law, or there is no such number; or liquids that surface tension holds slide
            along each other, by the viscosities of the case.
    """

    fluid: str
    value: Annotated[float, Ge(0)]
    number: str = ""
    name = "viscosity"
    strokes = True

    def require(self, case: Case) -> None:
        """See `Command.require`."""
        names = [fluid.name for fluid in case.fluids]
        if self.fluid not in names:
            raise ValueError(f"viscosity: fluid is {self.fluid!r}; it must be one of {names}")
        self.of(case.fluids[names.index(self.fluid)].viscosity)
        if text := self.refused(case):
            raise ValueError(f"viscosity: {text}")

    def of(self, before: float | Law) -> float | Law:
        """The viscosity in place of another, or of a law; see the class for errors."""
        numbers = list(declared(type(before))) if isinstance(before, Law) else [""]
        if self.number not in numbers:
            words = f"one of {numbers}, of its law" if isinstance(before, Law) else "left out, for it follows no law"
            raise ValueError(f"viscosity: number is {self.number!r} of {self.fluid}; it must be {words}")
        if not isinstance(before, Law):
            return self.value
        return replace(before, **{self.number: self.value})

    @staticmethod
    def refused(case: Case) -> str:
        """Why a case keeps its viscosities; "" if it need not."""
        if not (case.surface_tension and case.numerics.sliding):
            return ""
        return (
            "with surface tension, liquids slide along each other by the viscosities of the case; "
            "Numerics(sliding=False) lets them be changed"
        )


@dataclass(frozen=True)
class Discharge(Command):
    """Another discharge of an inlet from now on, with its profile and valve. A large change is an impact.

    Args:
        opening: name of the inlet.
        value: what enters; less than 0 for what is drawn off [m^2/s].

    Raises:
        ValueError: the name is no text, or the value is no number.
    """

    opening: str
    value: Annotated[float, Unit("m^2/s")]
    name = "discharge"

    def require(self, case: Case) -> None:
        """See `Command.require`."""
        _require_opening(self.name, self.opening, [o.name for o in case.openings if o.velocities])


@dataclass(frozen=True)
class Valve(Command):
    """An opening is open, or closed, from now on, whatever the case says of its valve.

    Args:
        opening: name of the inlet, outlet or vent.
        open: whether it is open.

    Raises:
        ValueError: the name is no text, or ``open`` is not True or False.
    """

    opening: str
    open: bool
    name = "valve"

    def require(self, case: Case) -> None:
        """See `Command.require`."""
        _require_opening(self.name, self.opening, [o.name for o in case.openings])


@dataclass(frozen=True)
class MoveWall(Command):
    """A wall goes to another place and stays, if it has a motion in the case; otherwise to another speed along itself.

    It goes over smoothly, see `tipfem.case.walls.Wall.going_over`. In a closed tank walls move along themselves only,
    for its fluids are incompressible.

    Args:
        wall: name of a wall that has a ``motion`` or, in 2-D, a number as its ``velocity``.
        value: displacement along its normal since the start, positive into the fluid [m]; or speed along itself,
            positive anticlockwise [m/s].
        ramp: time in which it goes over [s].

    Raises:
        ValueError: the name is no text, the value is no number, or the ramp is no number > 0.
    """

    wall: str
    value: float
    ramp: Annotated[float, Gt(0), Unit("s")] = 0.5
    name = "wall"
    strokes = True

    def require(self, case: Case) -> None:
        """See `Command.require`."""
        walls = [wall.name for wall in steered_walls(case)]
        if self.wall not in walls:
            known = ", ".join(walls) or "none; a wall needs a velocity, which may be 0, or a motion in the case"
            raise ValueError(f"wall: wall is {self.wall!r}; it must be one that moves: {known}")


def steered_walls(case: Case) -> list[Wall]:
    """The walls of a case that take the command `MoveWall`."""
    return [wall for wall in case.walls if wall.steers and (wall.motion is None or not case.boundary.fixed_volume)]


def _require_opening(what: str, name: str, names: Sequence[str]) -> None:
    if name not in names:
        raise ValueError(f"{what}: opening is {name!r}; it must be one of {', '.join(names) or 'none: there is none'}")


@dataclass(frozen=True)
class _Timing(Command):
    """A command that changes when steps are taken only."""

    physical = False

    def require(self, case: Case) -> None:
        """It fits every case."""


class Pause(_Timing):
    """No further step until told."""

    name = "pause"


class Go(_Timing):
    """Steps one after another."""

    name = "go"


@dataclass(frozen=True)
class Advance(_Timing):
    """A ``count`` of steps, and a pause; `ValueError` unless it is a whole number > 0."""

    count: Annotated[int, Ge(1)] = 1
    name = "step"


class Stop(_Timing):
    """End the run in an orderly way: fields, a checkpoint and the summary are written."""

    name = "stop"


class Undo(_Timing):
    """Go back to where the run was before the last command to its physics."""

    name = "undo"


class Again(_Timing):
    """End the run as `Stop` does, and begin it anew; for runs that are begun with a way to, see `tipfem.live`."""

    name = "again"


_PHYSICAL = (Gravity, Poke, Drop, SurfaceTension, Viscosity, Discharge, Valve, MoveWall)
_KINDS: dict[str, type[Command]] = {kind.name: kind for kind in (*_PHYSICAL, Pause, Go, Advance, Stop, Again, Undo)}
_KINDS["tension"] = SurfaceTension  # as pages call it


def command_from(name: str, values: Mapping[str, Any]) -> Command:
    """The command of a name with values in SI units, as of `Command.values`.

    Raises:
        ValueError: there is no such command, or a value is missing, unknown or not possible.
    """
    if name not in _KINDS:
        raise ValueError(f"command is {name!r}; it must be one of {', '.join(_KINDS)}")
    if name == "poke" and values.get("at", 0) is None:
        return Release()
    kind = _KINDS[name]
    known = list(getattr(kind, "__dataclass_fields__", {}))
    unknown = [key for key in values if key not in known]
    if unknown:
        raise ValueError(f"{name}: there is no {unknown[0]!r}; it takes {', '.join(known) or 'no values'}")
    try:
        return kind(**values)
    except TypeError:
        missing = [key for key in known if key not in values and not hasattr(kind, key)]
        raise ValueError(f"{name}: {', '.join(missing)} is missing") from None


def tensions(case: Case) -> list[dict[str, Any]]:
    """Arguments of a case's `SurfaceTension`: ``between`` which fluids, and the ``value`` at the start [N/m]."""
    given = case.surface_tension.given.items()
    return [{"between": [pair] if isinstance(pair, str) else list(pair), "value": value} for pair, value in given]


def limits(case: Case) -> dict[str, float]:
    """The largest and smallest values that commands to a case should have, for the controls of a viewer.

    ``gravity`` and ``poke_acceleration`` [m/s^2], ``poke_radius`` and ``drop_radius`` [m]; the radii are a half and a
    quarter of the shortest side of the walls' box, or the least that a command takes where that is more. The least are
    ``least_poke_radius`` and ``least_drop_radius`` [m]. Of walls that move, ``wall_place`` [m], a quarter of this side,
    and ``wall_speed`` [m/s].
    """
    side = float(np.ptp(case.box, axis=0).min())
    h = case.particles.spacing
    return {
        "gravity": LARGEST_ACCELERATION,
        "poke_acceleration": LARGEST_ACCELERATION,
        "poke_radius": max(0.5 * side, h),
        "drop_radius": max(0.25 * side, LEAST_DROP * h),
        "wall_place": 0.25 * side,
        "wall_speed": 0.5 * math.sqrt(0.1 * LARGEST_ACCELERATION * side),
        "least_poke_radius": h,
        "least_drop_radius": LEAST_DROP * h,
    }


def _require_dimension(what: str, value: Sequence[float], case: Case) -> None:
    if len(value) != case.particles.dimension:
        raise ValueError(f"{what} is {list(value)}; in this case it must be {case.particles.dimension} numbers")


def _require_in_box(what: str, at: Sequence[float], case: Case) -> None:
    position = case.particles.position
    lower, upper = position.min(axis=0), position.max(axis=0)
    if case.period:
        lower, upper = case.box
    if case.tank_motion is not None or any(wall.motion is not None for wall in case.walls):
        return  # walls that move may leave the box
    if (np.array(at) < lower).any() or (np.array(at) > upper).any():
        place, low, high = (f"({', '.join(f'{x:.4g}' for x in point)})" for point in (at, lower, upper))
        raise ValueError(f"{what} is {place} m; it must lie between {low} and {high} m")
