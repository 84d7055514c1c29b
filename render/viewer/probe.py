"""Values at a point of a scene: interpolated in its cell, and those of the nearest particle."""

from __future__ import annotations

from typing import Any

import numpy as np
from tipfem.render import Scene

from tipfem.typing import Array


def cell_at(scene: Scene, at: tuple[float, float]) -> tuple[int, Array] | None:
    """The cell that holds a point [m], and its barycentric coordinates (3,); None outside of all cells."""
    point = np.asarray(at, float)
    near = scene.geometry.cell_bounds.touching(point, point)
    if len(near) == 0:
        return None
    a, b, c = np.moveaxis(scene.position[scene.cells[near]], 1, 0)
    b, c, p = b - a, c - a, point - a
    area = b[:, 0] * c[:, 1] - b[:, 1] * c[:, 0]
    whole = np.where(area == 0, np.inf, area)
    v = (p[:, 0] * c[:, 1] - p[:, 1] * c[:, 0]) / whole
    w = (b[:, 0] * p[:, 1] - b[:, 1] * p[:, 0]) / whole
    weights = np.stack([1 - v - w, v, w], axis=1)
    weights[area == 0] = -1.0
    best = int(np.argmax(weights.min(axis=1)))
    if weights[best].min() < -1e-9:
        return None
    return int(near[best]), weights[best]


def values_at(scene: Scene, at: tuple[float, float]) -> tuple[dict[str, float], str | None]:
    """Values of all fields at a point [m], and the fluid's name there; none outside of all cells."""
    found = cell_at(scene, at)
    if found is None:
        return {}, None
    cell, weights = found
    corners = scene.cells[cell]
    values = {}
    for name, field in scene.fields.items():
        jumps = name in scene.cell_fields
        values[name] = float(scene.cell_fields[name][cell] if jumps else weights @ field[corners])
    if "speed" in values and "velocity_x" in values:  # of the interpolated velocity
        values["speed"] = float(np.hypot(values["velocity_x"], values["velocity_y"]))
    fluid = int(scene.fluid[corners[np.argmax(weights)]] if scene.cell_fluid is None else scene.cell_fluid[cell])
    return values, scene.fluid_names[fluid]


def pick(scene: Scene, at: tuple[float, float]) -> dict[str, Any]:
    """Values at a point [m], for the message `picked`."""
    values, fluid = values_at(scene, at)
    offset = scene.position - np.asarray(at, float)
    nearest = int(np.argmin(np.einsum("nd,nd->n", offset, offset)))
    return {
        "time": scene.time,
        "inside": fluid is not None,
        "fluid": fluid,
        "values": _finite(values),
        "particle": {
            "index": nearest,
            "position": [float(x) for x in scene.position[nearest]],
            "wall": bool(scene.wall[nearest]),
            "values": _finite({name: float(field[nearest]) for name, field in scene.fields.items()}),
        },
    }


def _finite(values: dict[str, float]) -> dict[str, float | None]:
    return {name: value if np.isfinite(value) else None for name, value in values.items()}
