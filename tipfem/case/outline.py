"""The walls of a tank as what draws them needs them: outline, holes, names of sides, and where the tank has moved."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from tipfem.case.case import Case
from tipfem.geometry.plane.domain import Domain


def tank_facts(case: Case) -> dict[str, Any]:
    """Facts of a case that its pictures need, as JSON: the box of the walls at the start, and what they are."""
    facts = {
        "size": np.ptp(case.box, axis=0).tolist(),  # lower and upper hold all places that a tank moves to
        "coordinates": case.coordinates if case.period.axial else None,
        "lower": case.box[0].tolist(),
        "upper": case.box[1].tolist(),
        "spacing": float(case.particles.spacing),
        "gravity": np.asarray(case.gravity).tolist(),
        "tank": tank_outline(case),
        "blocks": tank_blocks(case),
        "period": case.period.width.tolist() if case.period else None,
    }
    return {key: fact for key, fact in facts.items() if fact}


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


def tank_blocks(case: Case) -> dict[str, Any] | None:
    """A tank in 3-D with blocks at t = 0, as JSON; None for others.

    "size": (3,) of the tank, from the origin [m]; "boxes": lower and upper corner (2, 3) of each block [m], by its
    name; "reference": (3,) the point that the pose of the tank places [m].
    """
    if case.blocks is None:
        return None
    boxes = {name: box.tolist() for name, box in case.blocks.record["blocks"].items()}
    pivot = case.boundary.pose(0.0, 1e-6).pivot
    return {"size": case.blocks.record["size"].tolist(), "boxes": boxes, "reference": pivot.tolist()}


def tank_pose(case: Case, time: float) -> tuple[float, ...]:
    """Place of a tank's reference point (d,) [m], and how it has turned since t = 0 [rad].

    In 2-D by an angle; in 3-D by a vector (3,) along the axis, anticlockwise, of which the angle is the length.
    """
    pose = case.boundary.pose(time, 1e-6)
    if case.particles.dimension == 3:
        return tuple([*pose.centre.tolist(), *Rotation.from_matrix(pose.rotation).as_rotvec().tolist()])
    return float(pose.centre[0]), float(pose.centre[1]), float(np.arctan2(pose.rotation[1, 0], pose.rotation[0, 0]))


def tank_columns(case: Case, time: float) -> dict[str, float]:
    """Columns of the history of a tank that moves, see `tank_pose`; none for others."""
    if case.tank_motion is None:
        return {}
    names = ("x", "y", "angle") if case.particles.dimension == 2 else ("x", "y", "z", "turn_x", "turn_y", "turn_z")
    return dict(zip((f"tank_{name}" for name in names), tank_pose(case, time), strict=True))
