"""The commands, with values in SI units that are checked when a command is made and again for the case."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import numpy as np
from annotated_types import Ge, Gt, Len

from tipfem.case.case import Case
from tipfem.case.declaration import Unit, declared, require
from tipfem.case.forces import PokeForce
from tipfem.case.rheology import Law
from tipfem.case.surface_tension import spreading
from tipfem.case.walls import Wall
from tipfem.errors import Invalid

if TYPE_CHECKING:  # which start Taichi
    from tipfem.physics.state import State
    from tipfem.step.stepper import Stepper

# Largest magnitude of a gravity or of a poke [m/s^2]: ten times that of the earth. More would shorten the steps, and
# throw the particles about, without showing more.
LARGEST_ACCELERATION = 98.0665
LEAST_DROP = 2.0  # radius, in spacings: a smaller drop has too few cells to keep its shape


Vector = Annotated[tuple[float, ...], Len(2, 3)]
Acceleration = Annotated[Vector, Unit("m/s^2")]
_KINDS: dict[str, type[Command]] = {}  # by their names


class Command:
    """A command to a run; its values are declared, and checked when it is made."""

    name: ClassVar[str]  # of the command in files and messages
    physical: ClassVar[bool] = True  # whether it changes what the steps compute
    strokes: ClassVar[bool] = False  # whether those that follow closely, as from a slider, are one for undo

    def __init_subclass__(cls) -> None:
        if "name" in vars(cls):
            _KINDS.setdefault(cls.name, cls)

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

    def require(self, case: Case) -> None:
        """Check it against a case; `ValueError` if it does not fit."""

    def apply(self, simulation: Stepper) -> dict[str, Any] | None:
        """Carry it out; returns what it changed at once. `ValueError` if refused, without any change."""
        return None

    def restored(self, state: State, time: float) -> State:
        """The state of a checkpoint with what it lacks of the command, which was carried out at a time [s] before."""
        return state


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

    def apply(self, simulation: Stepper) -> None:
        """See `Command.apply`."""
        simulation.forces = replace(simulation.forces, gravity=self.value)


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

    def apply(self, simulation: Stepper) -> None:
        """See `Command.apply`."""
        end = math.inf if self.duration is None else simulation.time + self.duration
        poke = PokeForce(self.at, self.acceleration, self.radius, end)
        simulation.forces = replace(simulation.forces, poke=poke)


@dataclass(frozen=True)
class Release(Command):
    """Ends the poke; in files and messages a poke whose ``at`` is null."""

    name = "poke"

    def values(self) -> dict[str, Any]:
        """See `Command.values`."""
        return {"at": None}

    def apply(self, simulation: Stepper) -> None:
        """See `Command.apply`."""
        simulation.forces = replace(simulation.forces, poke=None)


@dataclass(frozen=True)
class Drop(Command):
    """A drop of a fluid, inside another fluid or in the empty space of a case with a free surface.

    Inside a fluid, cells (or particles, where interfaces are interpolated) change their fluid: the volume of the drop
    is taken from the other fluid, and particles keep their velocities. In empty space particles at rest are added.
    From then on the fluids have their new volumes: what restores volumes restores these.

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

    def apply(self, simulation: Stepper) -> dict[str, Any]:
        """See `Command.apply`; it changes the totals."""
        from tipfem.step.budget import AXES

        case, before, at = simulation.case, simulation.state, np.array(self.at)
        force = simulation.forces.acceleration(case, at[None], before.time, before.time)[0]
        state = simulation.remesher.with_drop(before, at, self.radius, case.fluid_index(self.fluid), force)
        old, new = simulation.budget.totals(before), simulation.budget.totals(state)
        simulation.state = state
        simulation.volume_control.wanted = state.wanted_volume
        added, momentum = (state.volume - before.volume).tolist(), (new.momentum - old.momentum).tolist()
        return {
            **{f"volume_{fluid.name}": change for fluid, change in zip(case.fluids, added, strict=True)},
            "kinetic_energy": new.kinetic - old.kinetic,
            "potential_energy": new.potential - old.potential,
            **{f"momentum_{axis}": value for axis, value in zip(AXES, momentum, strict=False)},
        }


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

    def apply(self, simulation: Stepper) -> dict[str, Any]:
        """See `Command.apply`; it changes the interface's energy, and is refused if a fluid would spread."""
        from tipfem.physics.surface_tension.physics import find_tension
        from tipfem.physics.surface_tension.tension import Tension

        case, state = simulation.case, simulation.state
        edges, position = state.part(Tension), state.particles.position
        assert edges is not None
        one, other = [*(case.fluid_index(name) for name in self.between), len(case.fluids)][:2]
        table = edges.table.copy()
        table[one, other] = table[other, one] = self.value
        if text := spreading(table, [fluid.name for fluid in case.fluids]):
            raise ValueError(f"surface_tension: that {text}")
        parts = {**state.parts, "surface_tension": find_tension(state.mesh, state.particles, table)}
        simulation.state = new = replace(state, parts=parts)
        return {"surface_energy": new.stored(position) - state.stored(position)}


_KINDS["tension"] = SurfaceTension  # as pages call it


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

    def apply(self, simulation: Stepper) -> None:
        """See `Command.apply`; in the present elements and in those to come."""
        case, state, remesher = simulation.case, simulation.state, simulation.remesher
        values = [fluid.viscosity for fluid in simulation.forces.fluids(case)]
        changed = case.fluid_index(self.fluid)
        values[changed] = self.of(values[changed])
        simulation.forces = replace(simulation.forces, viscosity=tuple(values))
        _, viscosity = remesher.interface.element_properties(state.mesh, state.particles.fluid, remesher.fluids)
        simulation.state = replace(state, material=replace(state.material, viscosity=viscosity))

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

    def apply(self, simulation: Stepper) -> None:
        """See `Command.apply`."""
        simulation.state = self.restored(simulation.state, simulation.time)

    def restored(self, state: State, time: float) -> State:
        """See `Command.restored`."""
        return replace(state, boundary=state.boundary.going_over(self.wall, time, self.value, self.ramp))


def steered_walls(case: Case) -> list[Wall]:
    """The walls of a case that take the command `MoveWall`."""
    return [wall for wall in case.walls if wall.steers and (wall.motion is None or not case.boundary.fixed_volume)]


@dataclass(frozen=True)
class _Timing(Command):
    """A command that changes when steps are taken only."""

    physical = False


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


def command_from(name: str, values: Mapping[str, Any]) -> Command:
    """The command of a name with values in SI units, as of `Command.values`; `ValueError` if one is not possible."""
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
