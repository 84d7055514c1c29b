"""The sides of a box by their names."""

from __future__ import annotations

from collections.abc import Container

# The walls of a box by their names: axis, and whether it is the one at the upper end.
SIDES = {name: (k // 2, k % 2 == 1) for k, name in enumerate(["left", "right", "bottom", "top", "back", "front"])}
AXIS = "axis"  # of an axisymmetric flow, in place of the left side


def side_of(name: str) -> tuple[int, bool]:
    """The axis that a side of a box is across, and whether it is the upper end."""
    return SIDES["left" if name == AXIS else name]


def sides_of(axes: Container[int], coordinates: str = "planar") -> list[str]:
    """Names of the sides across ``axes``; in an axisymmetric flow the left one is the axis."""
    names = [name for name, (axis, _) in SIDES.items() if axis in axes]
    return [AXIS if name == "left" and coordinates == "axisymmetric" else name for name in names]
