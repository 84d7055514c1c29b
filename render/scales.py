"""Ranges and ticks: round numbers, their labels, and the units of the fields."""

import math
from collections.abc import Iterable

import numpy as np
from numpy.typing import ArrayLike

from .arrays import Array, Range
from .scene import Scene

LABELS = {
    "speed": ("speed", "m/s"),
    "velocity_x": ("velocity x", "m/s"),
    "velocity_y": ("velocity y", "m/s"),
    "pressure": ("pressure", "Pa"),
    "density": ("density", "kg/m^3"),
}

_MOST_CONTOURS = 14


def is_signed(field: str) -> bool:
    """Whether the field has a direction, and zero is the middle of its colours."""
    return field.startswith("velocity_")


def colour_map_of(field: str) -> str:
    """Name of the colour map of a field, if no other is chosen."""
    return "blue-red" if is_signed(field) else "viridis"


def field_label(field: str) -> str:
    """The name of a field with its unit, such as "pressure [Pa]"; only the name if the unit is unknown."""
    name, unit = LABELS.get(field, (field.replace("_", " "), ""))
    return f"{name} [{unit}]" if unit else name


def round_ticks(low: float, high: float, most: int) -> Array:
    """Round numbers in a range, in steps of 1, 2 or 5 times a power of ten.

    Args:
        low: end of the range.
        high: end of the range.
        most: largest number of ticks.
    """
    step = _round_step((high - low) / max(most - 1, 1))
    while math.floor(high / step + 1e-9) - math.ceil(low / step - 1e-9) + 1 > most:
        step = _round_step(step * 1.01)
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    return np.asarray(np.arange(first, last + 1) * step)


def tick_labels(ticks: ArrayLike) -> list[str]:
    """One label per tick, all with as many decimals as their step needs."""
    ticks = np.asarray(ticks)
    step = ticks[1] - ticks[0] if len(ticks) > 1 else abs(ticks[0]) if len(ticks) else 1.0
    largest = np.abs(ticks).max(initial=0.0)
    if largest >= 1e6 or (0 < largest < 1e-3):
        return [f"{value + 0.0:.3g}" for value in np.where(np.abs(ticks) < 1e-9 * largest, 0, ticks)]
    decimals = max(0, -math.floor(math.log10(step) + 1e-9)) if step > 0 else 0
    return [f"{round(float(value), decimals) + 0.0:.{decimals}f}" for value in ticks]


def field_limits(scenes: Iterable[Scene], field: str) -> Range:
    """A round range (low, high) for a field over scenes.

    The 0.5 % at either end are left out, so that a few extreme particles do not determine the colours;
    a signed quantity gets a range symmetric about zero, and a speed starts at zero.

    Args:
        scenes: with the field.
        field: its name.
    """
    low, high = np.inf, -np.inf
    for scene in scenes:
        ends = field_ends(scene, field)
        low, high = min(low, ends[0]), max(high, ends[1])
    return round_limits(field, low, high)


def field_ends(scene: Scene, field: str) -> Range:
    """The values of a field in a scene without the 0.5 % at either end.

    Args:
        scene: with the field.
        field: its name.
    """
    low, high = np.percentile(scene.field_values(field), [0.5, 99.5])
    return float(low), float(high)


def round_limits(field: str, low: float, high: float) -> Range:
    """A round range for a field; see `field_limits`.

    Args:
        field: its name.
        low: the lowest value of `field_ends`.
        high: the highest.
    """
    if is_signed(field):
        high = max(abs(low), abs(high))
        low = -high
    elif field == "speed":
        low = 0.0
    if not high > low:  # a uniform field: a range around its value
        width = abs(high) * 0.1 or 1.0
        return (0.0, width) if field == "speed" else (low - width, high + width)
    step = _round_step((high - low) / 10)
    return math.floor(low / step + 1e-9) * step, math.ceil(high / step - 1e-9) * step


def contour_interval(scenes: Iterable[Scene], field: str) -> float:
    """A round distance between the contours of a field, for at most 14 of them over the range of `field_limits`.

    Args:
        scenes: with the field.
        field: its name.
    """
    low, high = field_limits(scenes, field)
    return _round_step((high - low) / (_MOST_CONTOURS - 1))


def check_range(field_range: Iterable[float]) -> Range:
    """The range as two numbers.

    Args:
        field_range: low and high.

    Raises:
        ValueError: these are not two finite numbers, low below high.
    """
    try:
        low, high = (float(value) for value in field_range)
    except (TypeError, ValueError):
        raise ValueError(f"field range {field_range!r}: expected two numbers, low and high") from None
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        raise ValueError(f"field range {low:g} to {high:g}: expected low below high, both finite")
    return low, high


def _round_step(value: float) -> float:
    """The smallest of 1, 2, 5 times a power of ten that is not below the value."""
    power = 10.0 ** math.floor(math.log10(value))
    return next(step * power for step in (1, 2, 5, 10) if step * power >= value * (1 - 1e-9))
