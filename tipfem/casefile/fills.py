"""The shapes of the table fill, as `tipfem.Tank.fill` takes them."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from tipfem.casefile.forms import HalfSpace, Polygon, Side
from tipfem.casefile.schema import FillTable

SHAPES = ("box", "disc", "half_space", "polygon", "shape", "below", "above")


def shapes_of(table: FillTable) -> list[str]:
    """The keys of a fill that are shapes."""
    return [key for key in SHAPES if getattr(table, key) is not None]


def shape_of(table: FillTable) -> dict[str, Any]:
    """What `Tank.fill` is given for a fill's shape."""
    given: Iterable[str] = shapes_of(table)
    for key in given:
        value = getattr(table, key)
        if key == "box":
            return {"box": value}
        if key == "disc":
            return {"disc": (value.centre, value.radius)}
        if key == "shape":
            return {"shape": value.shape()}
        if isinstance(value, HalfSpace):
            return {"where": value}
        if key == "polygon":
            return {"where": Polygon(points=value)}
        return {"where": Side(curve=value, above=key == "above")}
    return {}
