"""The sides of a box by their names."""

from __future__ import annotations

from collections.abc import Container, Sequence

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


def misnamed(given: Container[str], gravity: Sequence[float]) -> list[str]:
    """A line on a bottom or top that is given, alone, in a box in which gravity (3,) has its floor at another side."""
    axis = max(range(len(gravity)), key=lambda k: abs(gravity[k]))
    names = [name for name in ("bottom", "top") if name in given]
    low, high = sides_of([axis])
    if len(gravity) < 3 or not gravity[axis] or not names or low in given or high in given:
        return []
    floor, lid = (low, high) if gravity[axis] < 0 else (high, low)
    sides = " and ".join(
        f"{name!r} is the side at the {'upper' if SIDES[name][1] else 'lower'} end of y" for name in names
    )
    return [f"wall {sides}; gravity acts along {'xyz'[axis]}, so the floor is {floor!r} and the lid {lid!r}"]
