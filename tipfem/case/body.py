"""Body: a rigid body in the fluids that is fixed, moves as prescribed, or floats; in two dimensions."""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, Literal

import numpy as np
from annotated_types import Ge, Gt, Le, Len, MinLen

from tipfem.arguments import numbers, rounded
from tipfem.case.declaration import Unit, changed, require
from tipfem.case.walls import Motion, rates
from tipfem.errors import Invalid
from tipfem.geometry.plane.domain import Domain
from tipfem.geometry.plane.shapes import Shape
from tipfem.geometry.plane.touching import TOUCHING, corners_over
from tipfem.typing import Array

RESERVED = ("wall",)  # names with columns of their own in the history
FREEDOMS = ("x", "y", "angle")
CONDITIONS = ("slip", "slip_length", "law")  # on the outline, of which one is given
CONTACT = 0.5  # gap below which bodies and walls are in contact [spacings]
LEAST_RISE = 0.1  # cosine of the steepest slope that a body stands on
FLAT = 1e-4  # of the same, less than 1, up to which it does not slide far
ARC = 32  # edges in place of an arc of a right angle, before the body is meshed


@dataclass(frozen=True)
class Body:
    """A rigid body in the fluids, per metre of depth.

    With ``motion`` the body moves as prescribed, with ``density`` (or ``mass``) it floats: its three degrees of freedom
    are solved together with the fluids. With neither it is a fixed obstacle.

    The equations of a body that floats are those of its centre of mass c and of its angle,

        M c'' = M g + F - damping c' - stiffness (c - c_0),  I angle'' = T - damping angle' - stiffness angle,

    with the force F and the moment T of the fluids on it. A body with a hinge turns about the hinge, and only turns.

    Attributes:
        shape: its outline at t = 0, without holes: a shape of `tipfem.shapes`, a list of corners [m], or a polygon of
            shapely. In a tank, arcs become edges of about a spacing; mass and inertia are those of that polygon.
        name: for columns of the history and messages; unique within a case.
        motion: prescribed rigid motion; its pivot is the centre of the body unless it is given.
        density: of a body that floats [kg/m^3]; its mass is that times its area.
        mass: of a body that floats [kg/m], instead of ``density``.
        centre: (2,) centre of mass at t = 0 [m]; by default that of the area.
        inertia: moment of inertia about the centre of mass [kg m^2/m]; by default that of the area with the mass
            spread evenly over it, about ``centre``.
        hinge: (2,) fixed point about which a body that floats turns [m]; None for none.
        free: in which of "x", "y" and "angle" a body that floats moves; with a hinge only in "angle".
        velocity: (2,) initial velocity of the centre of mass of a body that floats [m/s].
        angular_velocity: the initial one of a body that floats, anticlockwise [rad/s].
        stiffness: (3,) of springs to ground: in x and y [N/m per metre of depth], and against turning [N m/rad per
            metre of depth]. They are without force where the body is at t = 0.
        damping: (3,) of dampers to ground, for the same velocities [N s/m, N m s per metre of depth].
        contact: what happens when the gap to a wall or to another body becomes less than about half a spacing: "stop"
            ends the run with an error, "hold" fixes the body where it is from then on.
        gap: for a body that may touch walls and other bodies: what is in the closed gap where it does. "seal": nothing,
            without pressure. "seep", of bodies that float: the pressure of the fluid beside it, so that a body on the
            floor has its buoyancy. None for a body with fluid all around it, which ``contact`` is for.
        friction: coefficient of Coulomb's friction where it touches; between two bodies the larger one counts.
        restitution: speed with which it leaves what it strikes over that with which it came, in empty space; between
            two bodies the larger one counts. Steps are shortened before it strikes.
        slip: whether fluids slide along the outline without friction.
        slip_length: l [m] of Navier's condition on the outline, see `Wall`.
        law: "layer" or "no-slip", see `Wall`; by default the first with the sharp interface, which it needs,
            else the second.
        contact_angle: of interfaces with surface tension [degrees], as of `Wall`, one number each. Contacts then slide
            along the outline, also where it is no-slip; needs the sharp interface.
        outline: the shape.
        corners: (K, 2) of the outline as a polygon, anticlockwise [m].

    Raises:
        ValueError: a value has the wrong shape or sign, or two of them contradict each other.
    """

    shape: Any
    name: Annotated[str, MinLen(1)] = "body"
    motion: Motion | None = None
    density: Annotated[float, Gt(0), Unit("kg/m^3")] | None = None
    mass: Annotated[float, Gt(0), Unit("kg/m")] | None = None
    centre: Annotated[Sequence[float], Len(2, 2), Unit("m")] | None = None
    inertia: Annotated[float, Gt(0), Unit("kg m^2/m")] | None = None
    hinge: Annotated[Sequence[float], Len(2, 2), Unit("m")] | None = None
    free: Annotated[Sequence[Literal["x", "y", "angle"]], MinLen(1)] | None = None
    velocity: Annotated[Sequence[float], Len(2, 2), Unit("m/s")] = (0.0, 0.0)
    angular_velocity: Annotated[float, Unit("rad/s")] = 0.0
    stiffness: Annotated[Sequence[Annotated[float, Ge(0)]], Len(3, 3)] = (0.0, 0.0, 0.0)
    damping: Annotated[Sequence[Annotated[float, Ge(0)]], Len(3, 3)] = (0.0, 0.0, 0.0)
    contact: Literal["stop", "hold"] = "stop"
    gap: Literal["seal", "seep"] | None = None
    friction: Annotated[float, Ge(0)] | None = None
    restitution: Annotated[float, Ge(0), Le(1)] | None = None
    slip: bool = False
    slip_length: Annotated[float, Gt(0), Unit("m")] | None = None
    law: Literal["no-slip", "layer"] | None = None
    contact_angle: Any | None = None
    outline: Shape = field(init=False, repr=False, compare=False)
    corners: Array = field(init=False, repr=False, compare=False)
    _moments: tuple[float, Array, float] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        require(self, names=("name",))
        if self.name in RESERVED:
            text = f"is {self.name!r}, under which the history has the forces on the walls; choose another"
            raise self._invalid("name", text)
        outline = _outline(self.shape, self.path, self._here).named(self.name)
        object.__setattr__(self, "outline", outline)
        corners = [p.at(np.arange(ARC) / ARC if p.centre is not None else np.zeros(1)) for p in outline.pieces]
        self._set_corners(np.concatenate(corners))
        require(self, self.path, self._here)
        if self.density is not None and self.mass is not None:
            raise self._invalid("mass", "is given beside density; give one of the two")
        if self.motion is not None and self.floats:
            raise self._invalid("motion", "prescribes where the body is, and density or mass let it float; give one")
        self._check_freedoms()
        for name in ("friction", "restitution"):
            if (value := getattr(self, name)) is not None and self.gap is None:
                text = f"is {value!r}, but only a body that may touch others has it; give it a gap, too"
                raise self._invalid(name, text)
        given = [name for name in CONDITIONS if getattr(self, name)]
        if len(given) > 1:
            raise self._invalid(given[1], f"is given beside {given[0]}; give one of the two")
        if self.motion is not None:
            try:
                self.motion.check(2)
            except Invalid as error:
                raise Invalid((*self.path, "motion", *error.path), error.text, f"{self._here}, motion") from None

    @property
    def path(self) -> tuple[str, ...]:
        """Keys that lead to it in a case file."""
        return "bodies", self.name

    def _invalid(self, name: str, text: str) -> Invalid:
        return Invalid((*self.path, name), text, self._here)

    def _check_freedoms(self) -> None:
        """Check what belongs to bodies that float only."""
        if self.free is not None:
            known = isinstance(self.free, Sequence) and all(f in FREEDOMS for f in self.free)
            if isinstance(self.free, str) or not known or len(set(self.free)) < len(self.free) or not self.free:
                raise self._invalid("free", f"is {self.free!r}; it must be some of {list(FREEDOMS)}, each once")
            if self.hinge is not None and list(self.free) != ["angle"]:
                raise self._invalid("free", f"is {list(self.free)}; a body with a hinge is free in angle only")
        if self.floats:
            moving = {"x": self.velocity[0], "y": self.velocity[1], "angle": self.angular_velocity}
            stuck = [name for name, value in moving.items() if value != 0 and name not in self.freedoms]
            if stuck:
                name = "angular_velocity" if stuck == ["angle"] else "velocity"
                raise self._invalid(name, f"is not zero in {', '.join(stuck)}, in which the body is not free")
            return
        given = changed(self)
        for name in ("centre", "inertia", "hinge", "free", "velocity", "angular_velocity", "stiffness", "damping"):
            if name in given:
                raise self._invalid(
                    name, f"is {given[name]!r}, but only a body that floats, with density or mass, has it"
                )

    @property
    def _here(self) -> str:
        return f"body {self.name!r}"

    @property
    def slips(self) -> bool:
        """Whether fluids slide along the outline; along one without slip only where contacts slide."""
        return bool(self.contact_angle) or self.slips_everywhere

    @property
    def slips_everywhere(self) -> bool:
        """Whether fluids slide along the whole outline."""
        return any(getattr(self, name) not in (None, False, "no-slip") for name in CONDITIONS)

    @property
    def floats(self) -> bool:
        """Whether the fluids move the body."""
        return self.density is not None or self.mass is not None

    @property
    def freedoms(self) -> tuple[str, ...]:
        """In which of "x", "y" and "angle" the fluids move it."""
        if not self.floats:
            return ()
        return ("angle",) if self.hinge is not None else tuple(self.free or FREEDOMS)

    def with_law(self, law: str) -> Body:
        """The body with a law for its outline where nothing is said of that."""
        if self.slips_everywhere or self.law is not None:
            return self
        new = copy.copy(self)
        object.__setattr__(new, "law", law)
        return new

    def moved(self, shift: Array) -> Body:
        """The body elsewhere at t = 0, by (2,) [m], with its centre and the points about which it turns."""
        new = copy.copy(self)
        new._set_corners(self.corners + shift)
        object.__setattr__(new, "outline", self.outline.moved(shift))
        for name in ("centre", "hinge"):
            if getattr(self, name) is not None:
                object.__setattr__(new, name, tuple((numbers(getattr(self, name)) + shift).tolist()))
        if self.motion is not None and self.motion.pivot is not None:
            pivot = tuple((numbers(self.motion.pivot) + shift).tolist())
            object.__setattr__(new, "motion", replace(self.motion, pivot=pivot))
        return new

    def meshed(self, corners: Array) -> Body:
        """The body with its outline as a polygon (K, 2) [m], anticlockwise."""
        new = copy.copy(self)
        new._set_corners(corners)
        return new

    def _set_corners(self, corners: Array) -> None:
        """Set the polygon, and its moments, which every step needs."""
        object.__setattr__(self, "corners", corners)
        object.__setattr__(self, "_moments", polygon_moments(corners))

    @property
    def area(self) -> float:
        """Area of its shape [m^2]."""
        return self._moments[0]

    @property
    def centre_of_mass(self) -> Array:
        """(2,) at t = 0 [m]."""
        return self._moments[1] if self.centre is None else numbers(self.centre)

    @property
    def total_mass(self) -> float:
        """Mass of a body that floats [kg/m]."""
        if self.mass is not None:
            return float(self.mass)
        return math.nan if self.density is None else float(self.density) * self.area

    @property
    def reference(self) -> Array:
        """(2,) the point at t = 0 whose position is that of the body in results: hinge, pivot or centre of mass [m]."""
        if self.hinge is not None:
            return numbers(self.hinge)
        if self.motion is not None and self.motion.pivot is not None:
            return numbers(self.motion.pivot)
        return self.centre_of_mass

    @property
    def inertia_about_reference(self) -> float:
        """Moment of inertia of a body that floats, about `reference` [kg m^2/m]."""
        area, middle, second = self._moments
        centre = self.centre_of_mass
        own = self.inertia
        if own is None:
            own = self.total_mass * (second / area + float(((middle - centre) ** 2).sum()))
        return float(own) + self.total_mass * float(((centre - self.reference) ** 2).sum())

    def distance(self, x: Array) -> Array:
        """(K,) of points (K, 2) to the outline at t = 0 [m]."""
        result = np.full(len(x), np.inf)
        for a, b in zip(self.corners, np.roll(self.corners, -1, axis=0), strict=True):
            along = np.clip(((x - a) @ (b - a)) / ((b - a) @ (b - a)), 0.0, 1.0)
            result = np.minimum(result, np.linalg.norm(x - a - along[:, None] * (b - a), axis=1))
        return result

    def prescribed(self, time: float, step: float) -> tuple[Array, Array, Array]:
        """Position x, y and angle of the reference point at a time, velocities and accelerations (3,) by ``motion``.

        ``step`` is that of the finite differences [s]; `ValueError` if a function of time returned an invalid value.
        """
        start = np.append(self.reference, 0.0)
        motion = self.motion
        if motion is None:
            return start, np.zeros(3), np.zeros(3)
        moved, velocity, acceleration = rates(motion.freedoms, time, step)  # at rest these are 0, wherever that is
        return start + moved, velocity, acceleration


def require_gaps(bodies: Sequence[Body], needs: Mapping[str, bool]) -> None:
    """`Invalid` if bodies with a gap lack what they need: texts, and whether it is there, the most important first."""
    for body in (body for body in bodies if body.gap is not None):
        seeps = "a density or a mass; say 'seal' of a body that is moved or fixed"
        rest = {**needs, seeps: body.floats or body.gap != "seep"}
        if missing := [what for what, there in rest.items() if not there]:
            text = f"is {body.gap!r}, which needs {missing[0]}"
            raise body._invalid("gap", text)


def doubts(bodies: Sequence[Body], tank: Domain, gravity: Array, spacing: float) -> list[str]:
    """Lines on bodies that float and stand on a slope without friction, at t = 0, gravity (2,) [m/s^2]."""
    found, strength = [], float(np.linalg.norm(gravity))
    outlines = [tank, *(Domain([b.corners], [[b.name] * len(b.corners)], [[-1] * len(b.corners)]) for b in bodies)]
    for number, body in enumerate(bodies, 1):
        if not (strength and body.floats and body.gap and {"x", "y"} & set(body.freedoms)):
            continue
        for other, below in enumerate(outlines):
            if other == number or body.friction or (other and bodies[other - 1].friction):
                continue
            over = corners_over(outlines[number], below, TOUCHING * spacing, tanks=(False, other == 0))
            rise = -(over.normal @ gravity) / strength  # cosine of the slope
            steep = np.flatnonzero((rise > LEAST_RISE) & (rise < 1 - FLAT))
            if len(steep):
                slope = float(np.tan(np.arccos(rise[steep[0]])))
                place = rounded(outlines[number].start[over.corner[steep[0]]])
                on = f"body {bodies[other - 1].name!r}" if other else "the tank"
                found.append(
                    f"body {body.name!r} stands on a slope of {slope:.3g} of {on} at {place} m without friction, and "
                    f"slides; a friction of {slope:.3g} or more keeps it there"
                )
                break
    return found


def polygon_moments(corners: Array) -> tuple[float, Array, float]:
    """Area [m^2], centre (2,) [m] and polar second moment about it [m^4] of a polygon (K, 2), anticlockwise."""
    origin = corners.mean(axis=0)
    a = corners - origin
    b = np.roll(a, -1, axis=0)
    cross = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    area = 0.5 * float(cross.sum())
    middle = ((a + b) * cross[:, None]).sum(axis=0) / (6 * area)
    second = float((cross * (a * a + a * b + b * b).sum(axis=1)).sum()) / 12 - area * float(middle @ middle)
    return area, origin + middle, second


def _outline(given: Any, path: tuple[str, ...], here: str) -> Shape:
    """The outline of a body; see `Body` for errors."""
    try:
        shape = Shape.of(given)
    except ValueError as error:
        raise Invalid(path, f": {error}", here) from error
    if len(shape.loops) > 1:
        raise Invalid(path, f": shape has {len(shape.loops) - 1} holes; fluids inside a body are not supported", here)
    if not shape.area > 0:
        raise Invalid(path, ": shape has no area", here)
    return shape
