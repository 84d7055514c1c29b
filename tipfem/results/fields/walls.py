"""Walls, and what moves between them, as lines, in three dimensions as faces: what ParaView shows beside the fields."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tipfem.geometry.plane.vectors import turning
from tipfem.typing import Array

Pose = tuple[float, float, float]


def rigid(case: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """List what is rigid between the walls, by case.json: all that has corners, which a pose places."""
    lists = [each for each in case.values() if isinstance(each, list)]
    return [one for each in lists for one in each if isinstance(one, Mapping) and "corners" in one]


def poses_between(rows: Sequence[Mapping[str, float]], time: float, names: Sequence[str]) -> dict[str, Pose]:
    """Places (x, y) [m] and angles [rad] of what moves, by name, from the last rows of a history.

    Between the rows, two or fewer in order of time, places are linear in time; ``names`` without columns are left out.
    """
    moved = [name for name in names if rows and f"{name}_angle" in rows[-1]]
    times = [row["time"] for row in rows]
    found = {}
    for name in moved:
        x, y, angle = (float(np.interp(time, times, [row[f"{name}_{k}"] for row in rows])) for k in ("x", "y", "angle"))
        found[name] = x, y, angle
    return found


class Outline(NamedTuple):
    """A closed line that may move."""

    name: str  # of what moves it, see `poses_between`
    corners: Array  # (K, 2) at t = 0 [m]
    reference: Sequence[float]  # (2,) the point that a pose places [m]
    number: int  # -1 for walls, else that of the body


def lines(outlines: Sequence[Outline], poses: Mapping[str, Pose]) -> tuple[Array, Array, Array]:
    """Outlines at ``poses``: points (P, 3) [m], lines (C, 2) between them, and the outline's number (C,) of each."""
    points, ends, owners, count = [np.zeros((0, 3))], [np.zeros((0, 2), int)], [np.zeros(0, int)], 0
    for name, corners, reference, number in outlines:
        x, y, angle = poses.get(name, (*reference, 0.0))
        points.append(np.pad((corners - reference) @ turning(angle) + (x, y), ((0, 0), (0, 1))))
        own = count + np.arange(len(corners))
        ends.append(np.stack([own, np.roll(own, -1)], axis=1))
        owners.append(np.full(len(own), number))
        count += len(corners)
    return np.concatenate(points), np.concatenate(ends), np.concatenate(owners)


def hull(walls: Array) -> Array:
    """Corners of the convex hull of wall particles (W, 2), which is drawn where no outline is known."""
    from scipy.spatial import ConvexHull

    return np.asarray(walls[ConvexHull(walls).vertices])


def faces(walls: Array) -> tuple[Array, Array, Array]:
    """Triangles around wall particles (W, 3): points (P, 3) [m], triangles (C, 3), and their numbers, all -1."""
    from scipy.spatial import ConvexHull

    found = ConvexHull(walls)
    used = np.sort(found.vertices)
    return walls[used], np.searchsorted(used, found.simplices), np.full(len(found.simplices), -1)


def moved(points: Array, reference: Sequence[float] | Array, pose: Sequence[float] | Array) -> Array:
    """Points (..., 3) of a tank at t = 0 [m] where a pose (6,), see `tipfem.case.outline.tank_pose`, takes them."""
    from scipy.spatial.transform import Rotation

    turn = Rotation.from_rotvec(pose[3:]).as_matrix()
    return np.asarray((points - np.asarray(reference)) @ turn.T + pose[:3])


def boxes(facts: Mapping[str, Any], row: Mapping[str, float]) -> tuple[Array, Array, Array]:
    """A tank with blocks, see `tipfem.case.outline.tank_blocks`, as `faces`, where a row of a history places it."""
    start = dict(zip(("x", "y", "z", "turn_x", "turn_y", "turn_z"), (*facts["reference"], 0.0, 0.0, 0.0), strict=True))
    pose = [row.get(f"tank_{name}", value) for name, value in start.items()]
    every = np.array([[(0.0, 0.0, 0.0), facts["size"]], *facts["boxes"].values()]).clip(0.0, facts["size"])
    points, triangles, _ = faces(np.stack(np.meshgrid([0, 1], [0, 1], [0, 1], indexing="ij"), axis=-1).reshape(-1, 3))
    corners = every[:, 0, None] + points * (every[:, 1] - every[:, 0])[:, None]
    cells = triangles + len(points) * np.arange(len(every))[:, None, None]
    places = moved(corners.reshape(-1, 3), facts["reference"], pose)
    return places, cells.reshape(-1, 3), np.full(len(every) * len(triangles), -1)


def write(path: Path, points: Array, cells: Array, body: Array) -> None:
    """Write lines or faces as a VTU file; `OSError` if it cannot be written."""
    import meshio  # here, for it takes a while and not every run writes fields

    kind = "line" if cells.shape[1] == 2 else "triangle"
    content = meshio.Mesh(points, [(kind, cells)], cell_data={"body": [body.astype(np.int32)]})
    meshio.write(path, content, file_format="vtu")
