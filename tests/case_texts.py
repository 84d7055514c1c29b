"""Texts of case files that tests of several subjects begin with."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from tipfem.casefile.source import Key, Path

# Water in a tank of air; the box of the water, and what is tested, follow.
WATER_IN_AIR = """
gravity = [0, -9.81]
[fluids.water]
density = 1000.0
viscosity = 1e-3
[fluids.air]
density = 1.2
viscosity = 1.8e-5
[tank]
size = [0.4, 0.3]
spacing = 0.02
[[fill]]
fluid = "air"
[[fill]]
fluid = "water"
"""


def paths_of(data: Any, path: Path = ()) -> set[Path]:
    """The path of every key and list item of a content, at any depth."""
    children: list[tuple[Key, Any]] = []
    if isinstance(data, Mapping):
        children = list(data.items())
    elif isinstance(data, list):
        children = list(enumerate(data))
    found = {(*path, key) for key, _ in children}
    return found.union(*(paths_of(value, (*path, key)) for key, value in children))
