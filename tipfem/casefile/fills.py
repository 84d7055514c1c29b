"""The shapes of the table fill, as `tipfem.Tank.fill` takes them, and which of them the tank cuts."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from tipfem.arguments import numbers, rounded
from tipfem.case.case import Case
from tipfem.casefile.forms import Polygon, Side
from tipfem.casefile.schema import FillTable

# What `Tank.fill` is given for each key of a fill that is a shape, of its value and the folder of the case file.
SHAPES: dict[str, Callable[[Any, Path], dict[str, Any]]] = {
    "box": lambda box, _: {"box": box},
    "disc": lambda disc, _: {"disc": (disc.centre, disc.radius)},
    "half_space": lambda half_space, _: {"where": half_space},
    "polygon": lambda points, _: {"where": Polygon(points=points)},
    "shape": lambda table, folder: {"shape": table.shape(folder)},
    "below": lambda curve, _: {"where": Side(curve=curve, above=False)},
    "above": lambda curve, _: {"where": Side(curve=curve, above=True)},
}


def shapes_of(table: FillTable) -> list[str]:
    """The keys of a fill that are shapes."""
    return [key for key in SHAPES if getattr(table, key) is not None]


def shape_of(table: FillTable, folder: Path) -> dict[str, Any]:
    """Shape that `Tank.fill` is given for a fill; ``folder``: that paths are relative to."""
    return next((SHAPES[key](getattr(table, key), folder) for key in shapes_of(table)), {})


def cut_fills(case: Case) -> list[str]:
    """Lines on the boxes and shapes of fills that reach out of the tank, more than by round-off."""
    found = []
    for k, region in enumerate(case.tank.regions if case.tank is not None else ()):
        given = region.given.get("box", getattr(region.given.get("shape"), "box", None))
        if given is None or case.tank is None:
            continue
        (lower, upper), tank = numbers(given), case.tank.box
        slack = 1e-6 * case.particles.spacing
        if (lower < tank[0] - slack).any() or (upper > tank[1] + slack).any():
            text = f"fill[{k}] of {region.fluid.name} reaches from {rounded(lower)} to {rounded(upper)} m, out of the "
            found.append(f"{text}tank from {rounded(tank[0])} to {rounded(tank[1])} m; what is outside is left out")
    return found
