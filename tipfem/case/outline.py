"""The walls of a tank as what draws them needs them: outline, holes, names of sides, and where the tank has moved."""

from __future__ import annotations

from typing import Any

import numpy as np

from tipfem.case.case import Case
from tipfem.case.openings import Inlet
from tipfem.geometry.domain import Domain


def tank_outline(case: Case) -> dict[str, Any] | None:
    """The outline of a two-dimensional tank and of its holes at t = 0, as JSON.

    "loops": the outline, anticlockwise, and the holes, clockwise, each with "corners" (K, 2) [m] and "names" (K,) of
    the sides from each corner to the next; "reference": (2,) the point that the pose of the tank places [m]. None in
    three dimensions, and for walls that move by themselves or end at a periodic axis: those are convex.
    """
    if case.period or any(wall.motion is not None for wall in case.walls) or not isinstance(case.boundary.tank, Domain):
        return None
    tank = case.boundary.tank
    loops = [
        {"corners": tank.start[own].tolist(), "names": [tank.sides[side] for side in tank.side[own]]}
        for own in (tank.loop == number for number in np.unique(tank.loop))
    ]
    return {"loops": loops, "reference": case.boundary.pose(0.0, 1e-6).pivot.tolist()}


def wall_openings(case: Case) -> list[dict[str, Any]]:
    """The openings in the walls, as JSON: name, kind, ends (2, 2) [m], and the unit vector into the tank, inwards.

    An inlet that draws off "drains"; those with a valve have the times in which it is "open" (K, 2) [s].
    """
    found: list[dict[str, Any]] = []
    for line in case.boundary.lines:
        one = line.opening
        draws = isinstance(one, Inlet) and one.open is None and one.strength(one.ramp, line.size) < 0
        fact = {"name": one.name, "kind": one.kind, "ends": [line.a.tolist(), line.b.tolist()]}
        found.append({**fact, "inwards": line.inwards.tolist(), **({"drains": True} if draws else {})})
        if one.open is not None:
            found[-1]["open"] = [list(pair) for pair in one.open]
    return found


def tank_pose(case: Case, time: float) -> tuple[float, float, float]:
    """Place of a 2-D tank's reference point (x, y) [m], and the angle by which it has turned since t = 0 [rad]."""
    pose = case.boundary.pose(time, 1e-6)
    return float(pose.centre[0]), float(pose.centre[1]), float(np.arctan2(pose.rotation[1, 0], pose.rotation[0, 0]))


def tank_columns(case: Case, time: float) -> dict[str, float]:
    """Columns of the history of a two-dimensional tank that moves, see `tank_pose`; none for others."""
    if case.tank_motion is None or case.particles.dimension != 2:
        return {}
    return dict(zip(("tank_x", "tank_y", "tank_angle"), tank_pose(case, time), strict=True))
