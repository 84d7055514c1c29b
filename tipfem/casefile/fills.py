"""The shapes of the table fill, as `tipfem.Tank.fill` takes them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from tipfem.casefile.forms import Polygon, Side
from tipfem.casefile.schema import FillTable

# What `Tank.fill` is given for each key of a fill that is a shape.
SHAPES: dict[str, Callable[[Any], dict[str, Any]]] = {
    "box": lambda box: {"box": box},
    "disc": lambda disc: {"disc": (disc.centre, disc.radius)},
    "half_space": lambda half_space: {"where": half_space},
    "polygon": lambda points: {"where": Polygon(points=points)},
    "shape": lambda table: {"shape": table.shape()},
    "below": lambda curve: {"where": Side(curve=curve, above=False)},
    "above": lambda curve: {"where": Side(curve=curve, above=True)},
}


def shapes_of(table: FillTable) -> list[str]:
    """The keys of a fill that are shapes."""
    return [key for key in SHAPES if getattr(table, key) is not None]


def shape_of(table: FillTable) -> dict[str, Any]:
    """What `Tank.fill` is given for a fill's shape."""
    return next((SHAPES[key](getattr(table, key)) for key in shapes_of(table)), {})
