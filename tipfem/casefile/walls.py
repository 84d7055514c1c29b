"""Walls of case files: what is read and written of them, and their conditions, with reasons."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np

from tipfem.arguments import is_number, meant, numbers
from tipfem.case.body import Body
from tipfem.case.case import Case
from tipfem.case.tank import Tank
from tipfem.case.walls import OPTIONS, Wall
from tipfem.case.waves import WAVE_MAKERS
from tipfem.casefile.cannot import cannot
from tipfem.casefile.forms import Model, Point, VectorOrFunction, WallMotion, declares, quantity
from tipfem.casefile.lists import Listed, Place
from tipfem.casefile.pairs import Angles, by_names
from tipfem.errors import Invalid
from tipfem.geometry.box_sides import AXIS


@declares(Wall, "slip", "slip_length", "law")
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
    velocity: VectorOrFunction | None = quantity("velocity of a wall that slides along itself", "m/s", None)
    speed: float | None = quantity(
        "speed of a side of a shape along itself, anticlockwise about what its outline encloses; in place of velocity",
        "m/s",
        None,
    )
    contact_angle: Angles = quantity(
        "contact angle by the names of the two fluids, measured in the first one, as water.air = 60, or by the one "
        "at a free surface, as water = 60; [receding, advancing] where a contact is held between two angles",
        "degrees",
        {},
    )
    motion: WallMotion | None = quantity(
        "displacement along the wall's normal into the fluid, a smooth function of time that is zero at t = 0",
        "m",
        None,
    )


class Walls(Listed):
    """See `Listed`."""

    attribute = "walls"
    kinds: ClassVar = {"walls": Wall}
    tables: ClassVar = {"walls": (WallTable, "walls that slip, slide or move, by their names")}
    named = True

    def made(self, key: str, place: Place, **given: Any) -> Wall | None:
        """See `Listed.made`; `Invalid` if the tank has no such wall, or nothing is said of it that fits."""
        name, d, where = given.pop("name"), place.dimension, {}
        for one in ("between", "particles"):
            where.update({one: given.pop(one)} if one in given else {})
        if not where and not place.tank:
            if place.particles:
                raise Invalid((), "has neither between nor particles; without a tank, give the wall's place", "wall")
            return None
        if not where and place.sides is not None and name not in place.sides:
            text = f"is no wall of the tank; it must be one of {', '.join(place.sides) or 'none'}, or have between, "
            raise Invalid((), cannot(name) or f"{text}two points{meant(name, place.sides)}", "wall")
        if not given:
            raise Invalid((), f"is empty; give one of {', '.join(OPTIONS)}, or leave the table out", "wall")
        speed, velocity = given.pop("speed", None), given.get("velocity")
        if speed is not None:
            if not place.shape or velocity is not None:
                why = "only a side of a shape has a speed" if velocity is None else "velocity is given, too"
                raise Invalid("speed", f"is {speed:g} m/s; {why}", "wall")
            given["velocity"] = speed
        if isinstance(velocity, list) and d and len(velocity) != d:
            raise Invalid("velocity", f"is {velocity} m/s; it must be {d} numbers", "wall")
        wall = Wall(name, **(where or {"particles": []}), **given)
        if d:
            wall.sliding(0.0, d)
            wall.displacement(0.0)
        return wall

    def into(self, tank: Tank, made: list[Wall]) -> list[Wall]:
        """See `Listed.into`."""
        for wall in made:
            if _is_of_tank(wall):
                options = {key: value for key in OPTIONS if (value := getattr(wall, key)) not in (None, False)}
                tank.wall(wall.name, **(options or {"slip": False}))
        return [wall for wall in made if not _is_of_tank(wall)]

    def written(self, case: Case, tank: Tank | None) -> Sequence[Wall]:
        """See `Listed.written`: those of the tank as they were described, without places."""
        if tank is None:
            return case.walls
        own = {name: Wall(name, particles=[], **options) for name, options in tank.wall_options.items()}
        axis = [AXIS] if case.period.axial else []
        return [*own.values(), *(wall for wall in case.walls if wall.name not in (*own, *axis))]

    def content(self, one: Wall, values: Mapping[str, Any]) -> dict[str, Any]:
        """See `Listed.content`; a number as its velocity is its speed."""
        given, place = {key: value for key, value in values.items() if key in OPTIONS}, dict[str, Any]()
        if one.between is not None:
            place["between"] = numbers(one.between).tolist()
        elif one.side is None and not _is_of_tank(one):
            particles = np.asarray(one.particles)
            place["particles"] = (np.flatnonzero(particles) if particles.dtype == bool else particles).tolist()
        if is_number(one.velocity):
            given["speed"] = float(given.pop("velocity"))
        elif one.velocity is not None and not callable(one.velocity):
            given["velocity"] = numbers(one.velocity).tolist()
        if one.contact_angle:
            given["contact_angle"] = by_names(one.contact_angle)
        return {**place, **(given or {"slip": False})}

    def restored(self, record: Mapping[str, Any]) -> Wall:
        """See `Listed.restored`; the displacement that makes waves is kept, functions of Python's are not."""
        motion = record["motion"]
        if isinstance(motion, Mapping):
            motion = WAVE_MAKERS[motion["form"]](**{key: value for key, value in motion.items() if key != "form"})
        return Wall(**{**record, "motion": motion})


def _is_of_tank(wall: Wall) -> bool:
    """Whether it is a wall of a tank, which knows its place."""
    return wall.particles is not None and not np.size(wall.particles)


def wall_lines(case: Case) -> list[str]:
    """Lines for people on the walls of a case; those with the same condition are in one."""
    found: dict[str, list[str]] = {}
    chosen = case.tank.default_laws if case.tank else {}
    walls = {wall.name: wall for wall in case.walls}
    names = [*(case.tank.sides if case.tank else ()), *walls]
    for name in dict.fromkeys(names):
        if name == AXIS and case.period.axial:
            continue
        rule = chosen.get(name)
        text = f"{rule.law}, because {rule.why}" if rule else _condition(walls.get(name))
        found.setdefault(text, []).append(name)
    if case.tank is None:
        found["no-slip, because nothing is said of them"] = ["all others" if names else "all"]
    for body in case.bodies:
        found.setdefault(f"{_friction(body)}, along the outline", []).append(body.name)
    lines = [f"{', '.join(names)}: {text}" for text, names in found.items()]
    return [f"{'' if number else 'walls':12s}{line}" for number, line in enumerate(lines)]


def _condition(wall: Wall | None) -> str:
    """Condition at a wall, in words; None for a wall that is fixed and no-slip."""
    if wall is None:
        return "no-slip"
    condition = _friction(wall)
    if wall.velocity is not None:
        condition += ", slides"
    return condition + (", moves" if wall.motion is not None else "")


def _friction(of: Wall | Body) -> str:
    if of.slip:
        return "slip"
    return of.law or "no-slip" if of.slip_length is None else f"slip length {of.slip_length:g} m"
