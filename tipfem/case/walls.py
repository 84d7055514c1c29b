"""Walls as users describe them: slip, sliding and moving walls, and the rigid motion of a whole tank."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, ClassVar, Literal, NamedTuple

import numpy as np
from annotated_types import Gt, Len, MinLen

from tipfem.arguments import is_number, numbers
from tipfem.case.declaration import Unit, require
from tipfem.errors import Invalid
from tipfem.typing import Array

Function = Callable[[float], Any]
OPTIONS = ("law", "slip", "slip_length", "velocity", "motion", "contact_angle")  # of a wall, beside name and place

SEEN = 0.0, 1e-3, 1e-2, 0.1, 1.0  # at which speeds of walls are looked at before a run [s]

# Weights of finite differences of fourth order for f' (divided by the step) and f'' (divided by its square): central,
# and one-sided for the start of a run, before which functions need not be defined.
_AROUND = (np.array([1, -8, 0, 8, -1]) / 12, np.array([-1, 16, -30, 16, -1]) / 12)
_ONWARDS = (np.array([-25, 48, -36, 16, -3, 0]) / 12, np.array([45, -154, 214, -156, 61, -10]) / 12)


@dataclass(frozen=True)
class Wall:
    """A straight wall, or a part of one, that slips, slides or moves.

    Its particles are those on the line between two points (2-D), or those given by index or mask. They must lie on
    one straight side of the domain. Particles in corners are held by both walls. In 2-D so are the ends of a wall
    that continues straight as another wall.

    Attributes:
        name: for messages; unique within a case.
        between: the two ends [m], each (2,).
        particles: indices (K,) or mask (N,) of its particles, instead of ``between``.
        slip: whether the fluid slides along it without friction.
        slip_length: l [m] of Navier's condition, traction = viscosity / l (v - v_wall) along the wall.
        law: "no-slip": the fluid moves with the wall. "layer": it slips with the friction of the boundary layer where
            this is thinner than the particles' spacing, and moves with the wall elsewhere; see
            `tipfem.physics.walls.layers`. None: by ``slip`` and ``slip_length``, and no-slip without these. For walls
            of a tank of which nothing is said see `tipfem.case.default_laws`.
        contact_angle: of interfaces with surface tension [degrees], by the names of two fluids, the first one that it
            is measured in, as ``{("water", "air"): 60}``, or of one at a free surface. Contacts then slide along the
            wall by the forces there, also along a no-slip wall, see docs/theory/surface-tension.md. Of two angles,
            ``(50, 80)``, a contact recedes at the first one, advances at the second, and is held between.
        side: name of a side of the tank's shape, instead of ``between`` and ``particles``.
        velocity: of a wall that slides along itself, relative to the tank: (d,) [m/s], or a function of time
            [s] that returns it. In 2-D, with the sharp interface, the particles of a no-slip wall, and the surfaces
            that meet it, go with it where the film that it draws out is a spacing thick. In 2-D it may be a number, the
            speed, positive anticlockwise about what the wall's outline encloses; a curved wall needs that.
        motion: function of time [s] to the displacement [m] of the wall along its normal since t = 0, relative
            to the tank; positive into the fluid. It must be smooth, because velocity and acceleration are its
            derivatives.

    Raises:
        ValueError: a value has the wrong shape or sign, or two of them contradict each other.
    """

    name: Annotated[str, MinLen(1)]
    between: Sequence[Sequence[float]] | None = None
    particles: Any = None
    slip: bool = False
    slip_length: Annotated[float, Gt(0), Unit("m")] | None = None
    velocity: Sequence[float] | float | Function | None = None
    motion: Function | None = None
    law: Literal["no-slip", "layer"] | None = None
    side: str | None = None
    contact_angle: Any = None

    # Whether surfaces that meet it go with it, where it slides along itself; no field.
    carries: ClassVar[bool] = False

    def __post_init__(self) -> None:
        require(self, subject="wall", names=("name",))
        require(self, self.path, f"wall {self.name!r}", ("slip_length", "law"))
        if not isinstance(self.slip, bool):
            raise self._invalid("slip", f"is {self.slip!r}; it must be True or False (a length is slip_length)")
        if sum(place is not None for place in (self.between, self.particles, self.side)) != 1:
            raise self._invalid((), ": give either its ends, between, or its particles, or the side of a shape")
        if self.slip and self.slip_length is not None:
            raise self._invalid("slip_length", "is given with free slip, which has none; give one of the two")
        if self.law is not None and (self.slip or self.slip_length is not None):
            given = "slip" if self.slip else "slip_length"
            raise self._invalid("law", f"is {self.law!r} and {given} is given; give one of the two")
        if self.slip and self.velocity is not None:
            raise self._invalid("velocity", "has no effect on a fluid that slips freely; leave out one of the two")
        if self.motion is not None and not callable(self.motion):
            raise self._invalid("motion", f"is {self.motion!r}; it must be a function of time to a displacement in m")
        if self.between is not None:
            ends = numbers(self.between)
            if ends.shape != (2, 2) or not np.isfinite(ends).all() or (ends[0] == ends[1]).all():
                raise self._invalid("between", f"is {self.between!r}; it must be two different points (x, y) in m")

    @property
    def path(self) -> tuple[str, ...]:
        """Keys that lead to it in a case file."""
        return "walls", self.name

    def _invalid(self, key: str | tuple[()], text: str) -> Invalid:
        return Invalid((*self.path, *((key,) if key else ())), text, f"wall {self.name!r}")

    @property
    def slips(self) -> bool:
        """Whether fluid slides along the wall, with friction or without."""
        return self.slip or self.has_friction

    @property
    def has_friction(self) -> bool:
        """Whether fluid slides along it with friction; along a no-slip wall only where contacts slide."""
        return self.slip_length is not None or self.law == "layer" or (bool(self.contact_angle) and not self.slip)

    def like(self, other: Wall) -> bool:
        """Whether it and another wall of a shape, both at rest, do the same to a fluid."""
        if self.velocity is not None or self.motion is not None or self.side is None or other.side is None:
            return False
        return replace(self, name=other.name, side=other.side) == other

    def displacement(self, time: float) -> Array:
        """Displacement () [m] along the inward normal at a time [s]; `ValueError` if ``motion`` returned none."""
        value = 0.0 if self.motion is None else self.motion(time)
        if not is_number(value):
            raise self._invalid("motion", f"at t = {time:g} s gave {value!r}; it must be a length in m")
        return np.array(float(value))

    def sliding(self, time: float, dimension: int) -> Array:
        """Velocity (d,) [m/s] of the wall along itself; `ValueError` if it is not finite or has another shape."""
        given = self.velocity(time) if callable(self.velocity) else self.velocity
        if is_number(given) and dimension == 2:
            return np.zeros(dimension)  # see `speed`
        value = np.zeros(dimension) if given is None else numbers(given)
        if value.shape != (dimension,) or not np.isfinite(value).all():
            text = f"at t = {time:g} s is {given!r}; it must be {dimension} finite speeds in m/s"
            raise self._invalid("velocity", text)
        return value

    def speed(self, time: float) -> Array:
        """Speed () [m/s] along itself where its velocity is a number, anticlockwise about the outline; else zero."""
        given: Any = self.velocity(time) if callable(self.velocity) else self.velocity
        return np.array(float(given) if is_number(given) else 0.0)

    @property
    def steers(self) -> bool:
        """Whether commands to a run move it: it has a motion, or a number as its velocity."""
        return self.motion is not None or is_number(self.velocity(0.0) if callable(self.velocity) else self.velocity)

    def going_over(self, time: float, value: float, ramp: float) -> Wall:
        """The wall, whose displacement [m], or without a motion speed [m/s], goes over to a value in ``ramp`` [s].

        By the polynomial of fifth degree that begins with its first two derivatives at the ``time``, and ends with
        none.
        """
        given = self.speed if self.motion is None else self.displacement
        start, rate, change = (float(part) for part in rates(given, time, 1e-3 * ramp))

        def gone(t: float) -> float:
            if t <= time:
                return float(given(t))
            s = min((t - time) / ramp, 1.0)
            over, left = s**3 * (10 - 15 * s + 6 * s * s), (1 - s) ** 3
            begun = rate * ramp * s * (1 + 3 * s) + 0.5 * change * (ramp * s) ** 2
            return start + (value - start) * over + left * begun

        changed: Any = {"velocity" if self.motion is None else "motion": gone}
        return replace(self, **changed)


@dataclass(frozen=True)
class Motion:
    """The rigid motion of a whole tank: x = pivot + translation(t) + R(angle(t)) (x_0 - pivot).

    Functions must be smooth and zero at t = 0: velocity and acceleration are their derivatives.

    Attributes:
        translation: displacement (d,) [m], a function of time [s] that is zero at t = 0.
        angle: anticlockwise [rad], a function of time [s] that is zero at t = 0.
        pivot: (d,) point [m] about which it turns, and which is translated; by default the origin, of a body
            its centre.
        axis: (3,) direction of the axis of rotation; of a three-dimensional tank only.

    Raises:
        ValueError: neither function is given, one of them is not callable, or the axis is not a direction.
    """

    translation: Annotated[Function | None, Unit("m")] = None
    angle: Annotated[Function | None, Unit("rad")] = None
    pivot: Annotated[Sequence[float], Len(2, 3), Unit("m")] | None = None
    axis: Annotated[Sequence[float], Len(3, 3)] = (0.0, 0.0, 1.0)

    def __post_init__(self) -> None:
        if self.translation is None and self.angle is None:
            raise Invalid((), "has neither translation nor angle; give one, or leave it out", "Motion")
        require(self, subject="Motion")
        if not numbers(self.axis).any():
            raise Invalid("axis", f"is {self.axis!r}; it must be a direction of 3 numbers", "Motion")

    def check(self, dimension: int) -> None:
        """Check the dimension and the values at t = 0.

        Raises:
            ValueError: pivot or translation has the wrong shape, or the motion is not zero at t = 0.
        """
        if self.pivot is not None and numbers(self.pivot).shape != (dimension,):
            raise Invalid("pivot", f"is {self.pivot!r} m; it must be a point of {dimension} coordinates", "Motion")
        if dimension == 2 and (numbers(self.axis)[:2] != 0).any():
            raise Invalid("axis", f"is {self.axis!r}; in 2-D the axis is (0, 0, 1), leave it out", "Motion")
        for name, value in (("translation", self.shift(0.0, dimension)), ("angle", self.turn(0.0))):
            if np.any(value != 0):
                why = "it must be zero, because the particles stand where the walls are at that time"
                raise Invalid(name, f"at t = 0 is {value.tolist()}; {why}", "Motion")

    def pose(self, time: float, step: float, dimension: int) -> Pose:
        """Position and motion of a d-dimensional tank at a time, by finite differences with a step [s]."""
        shift, velocity, acceleration = rates(lambda t: self.shift(t, dimension), time, step)
        angle, rate, rate_change = (float(value) for value in rates(self.turn, time, step))
        pivot = np.zeros(dimension) if self.pivot is None else numbers(self.pivot)
        if dimension == 2:
            skew = np.array([[0.0, -1.0], [1.0, 0.0]])
        else:
            x, y, z = numbers(self.axis) / np.linalg.norm(self.axis)
            skew = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        rotation = np.eye(dimension) + np.sin(angle) * skew + (1 - np.cos(angle)) * skew @ skew  # Rodrigues
        return Pose(pivot, pivot + shift, rotation, rate * skew, rate_change * skew, velocity, acceleration)

    def freedoms(self, time: float) -> Array:
        """Translation x, y [m] and angle [rad] at a time [s] (3,), in two dimensions."""
        return np.append(self.shift(time, 2), self.turn(time))

    def shift(self, time: float, dimension: int) -> Array:
        """Translation (d,) [m] at a time [s]."""
        given = np.zeros(dimension) if self.translation is None else self.translation(time)
        value = numbers(given)
        if value.shape != (dimension,) or not np.isfinite(value).all():
            text = f"at t = {time:g} s gave {given!r}; it must be {dimension} finite lengths in m"
            raise Invalid("translation", text, "Motion")
        return value

    def turn(self, time: float) -> Array:
        """Angle () [rad] at a time [s]."""
        value = 0.0 if self.angle is None else self.angle(time)
        if not is_number(value):
            raise Invalid("angle", f"at t = {time:g} s gave {value!r}; it must be an angle in rad", "Motion")
        return np.array(float(value))


@dataclass(frozen=True)
class Pose:
    """A rigid motion at one time: x = centre + rotation (y - pivot) for a point y of the tank at t = 0."""

    pivot: Array  # (d,) the pivot at t = 0 [m]
    centre: Array  # (d,) the pivot at this time [m]
    rotation: Array  # (d, d) orthogonal matrix
    angular_velocity: Array  # (d, d) skew-symmetric matrix W of w x r = W r [1/s]
    angular_acceleration: Array  # (d, d) skew-symmetric matrix, the time derivative of ``angular_velocity`` [1/s^2]
    velocity: Array  # (d,) of the pivot [m/s]
    acceleration: Array  # (d,) of the pivot [m/s^2]

    @classmethod
    def still(cls, dimension: int) -> Pose:
        """The pose of a tank of ``dimension`` d at rest."""
        zero, zeros = np.zeros(dimension), np.zeros((dimension, dimension))
        return cls(zero, zero, np.eye(dimension), zeros, zeros, zero, zero)

    def place(self, y: Array) -> Array:
        """Positions x (K, d) of the tank's points ``y`` (K, d) [m]."""
        return np.asarray(self.centre + (y - self.pivot) @ self.rotation.T)

    def origin(self, x: Array) -> Array:
        """The tank's points y (K, d) that are at ``x`` (K, d)."""
        return np.asarray(self.pivot + (x - self.centre) @ self.rotation)

    def rigid_velocity(self, x: Array) -> Array:
        """Velocity (K, d) of the tank's points at ``x`` (K, d)."""
        return np.asarray(self.velocity + (x - self.centre) @ self.angular_velocity.T)

    def rigid_acceleration(self, x: Array) -> Array:
        """Acceleration (K, d) of the tank's points at ``x`` (K, d)."""
        w = self.angular_velocity
        return np.asarray(self.acceleration + (x - self.centre) @ (self.angular_acceleration + w @ w).T)


class CarryingWall(Wall):
    """A no-slip wall that slides along itself and takes its particles, and the surfaces that meet it, with it."""

    carries = True

    @property
    def has_friction(self) -> bool:
        """See `Wall.has_friction`: what holds the fluid at the wall's speed is a friction."""
        return True


class Drawn(NamedTuple):
    """Film of a liquid that a wall draws out, (nu U / g)^(1/2) thick.

    L. Landau, B. Levich, Dragging of a liquid by a moving plate, Acta Physicochimica URSS 17, 1942.
    """

    fluid: str  # its name, that of the heaviest one
    viscosity: float  # kinematic [m^2/s]
    gravity: float  # its strength [m/s^2]
    spacing: float  # of the particles [m]
    fluids: Array | None  # (N,) numbers of those of the particles in 3-D, where no wall carries surfaces; None in 2-D

    def film(self, wall: Wall) -> float:
        """Thickness [m] at the largest speed of a wall at the times `SEEN`; of one at rest at a speed it may have."""
        if not self.gravity:
            return math.inf
        dimension = 2 if self.fluids is None else 3
        speed = max(math.hypot(*wall.sliding(time, dimension), wall.speed(time)) for time in SEEN)
        return math.sqrt(self.viscosity * (speed or math.sqrt(self.gravity * self.spacing)) / self.gravity)

    def carrying(self, walls: Sequence[Wall]) -> list[Wall]:
        """The walls; no-slip ones that slide, of which particles resolve the film, as ones that carry surfaces.

        Raises:
            Invalid: one in 3-D meets a surface.
        """
        found = []
        for wall in walls:
            follows = wall.velocity is not None and not wall.slips and wall.motion is None
            if not follows or self.film(wall) < self.spacing:
                found.append(wall)
            elif self.fluids is None:
                found.append(CarryingWall(**vars(wall)))
            elif len(np.unique(self.fluids[wall.particles])) == 1:
                found.append(wall)
            else:
                film = f"draws out a film of {self.film(wall):.2g} m of {self.fluid}, a spacing or more"
                text = f"{film}, and in 3-D surfaces do not follow walls: simulate it in 2-D, or let it slip"
                raise Invalid(("walls", wall.name, "velocity"), text, f"wall {wall.name!r}")
        return found


def left_contacts(walls: Sequence[Wall], drawn: Drawn | None) -> list[str]:
    """Lines on walls that slide along themselves and carry no surfaces; ``drawn`` where others may do so."""
    found = []
    for wall in walls:
        if wall.carries or not (callable(wall.velocity) or np.any(wall.velocity)):
            continue
        why = "surfaces follow it by less than they should; the wall's particles stay where they are"
        if drawn is not None and not wall.slips and drawn.film(wall) < drawn.spacing:
            film = f"the film of {drawn.film(wall):.2g} m of {drawn.fluid} that it draws out"
            why += f", for {film} is thinner than a spacing"
        found.append(f"wall {wall.name!r} slides along itself: {why}")
    return found


def rates(function: Callable[[float], Array], time: float, step: float) -> tuple[Array, Array, Array]:
    """Value of a function of time and two derivatives, by differences with a step [s], not at negative times."""
    onwards = time < 2 * step
    weights, first = (_ONWARDS, 0) if onwards else (_AROUND, -2)
    values = [function(time + (first + k) * step) for k in range(len(weights[0]))]
    value = values[0] if onwards else values[2]
    one, two = (sum(w * v for w, v in zip(weight, values, strict=True)) for weight in weights)
    return value, np.asarray(one) / step, np.asarray(two) / step**2
