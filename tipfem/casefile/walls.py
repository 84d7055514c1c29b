"""Conditions at the walls of a case, with reasons."""

from __future__ import annotations

from tipfem.case.body import Body
from tipfem.case.case import Case
from tipfem.case.walls import Wall
from tipfem.geometry.box_sides import AXIS


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
