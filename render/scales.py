"""Ranges and ticks: round numbers, their labels, and the units of the fields."""

import copy
import math
from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from tipfem.results.fields.catalogue import field_of

from .arrays import Array, Range
from .interface import areas
from .scene import Scene

MUTED_FIELD = "pressure"  # which hardly varies in a gas over a liquid
MUTED_SHARE = 0.1  # of the range of the other fluids, in which its values lie then
_MOST_CONTOURS = 14
_ENDS = (0.005, 0.995)  # of the coloured area at one time, at the ends of the colours
_DOT = 0.5  # area of a particle in no cell, in squares of the spacing
_SPAN = (1, 99)  # [%] of those of all times, by which fluids are muted
_NEAR_ZERO = 0.05  # of a range: what it may pass zero by without going on beyond


def digits_of(times: ArrayLike) -> int:
    """Digits behind the point, one to six, that distinguish times (K,) [s]; three for a single one."""
    steps = np.diff(np.unique(times))
    if not len(steps):
        return 3
    step = float(steps.min())
    least = min(max(3, math.ceil(-math.log10(step))), 6)
    return next((n for n in range(1, 6) if abs(round(step, n) - step) < 1e-9 * max(1.0, step)), least)


def fitting(size: float, unit: str = "m") -> tuple[float, str]:
    """Factor and name of the unit in which lengths or times of a size are easy to read: 24 mm rather than 0.024 m."""
    return (1.0, unit) if size >= 0.1 or not size else (1e3, f"m{unit}") if size >= 1e-4 else (1e6, f"\u00b5{unit}")


def time_text(time: float, digits: int, span: float) -> str:
    """A time [s] as in pictures of a run, whose span [s] the unit fits, with so many digits."""
    factor, unit = fitting(span, "s")
    return f"t = {factor * time:.{max(0, digits - round(math.log10(factor)))}f} {unit}"


def colour_map_of(field: str) -> str:
    """Name of the colour map of a field, if no other is chosen."""
    return "blue-red" if field_of(field).scale == "signed" else "viridis"


def round_ticks(low: float, high: float, most: int) -> Array:
    """At most so many round numbers in a range, in steps of 1, 2 or 5 times a power of ten."""
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


class FieldSample:
    """Values of a field over scenes, for what all their pictures share."""

    def __init__(self, scenes: Iterable[Scene], field: str) -> None:
        values, fluids, covered = list[Array](), list[Array](), list[tuple[Array, Array]]()
        self._names: tuple[str, ...] = ()
        self._densities: tuple[float, ...] | None = None
        self._owned = True
        for scene in scenes:
            values.append(scene.field_values(field))
            fluids.append(scene.fluid)
            covered.append(_covered(scene, field))
            self._names, self._densities = scene.fluid_names, scene.fluid_densities
            self._owned = self._owned and scene.cell_fluid is not None
        self.field = field
        self._parts = list(zip(values, fluids, strict=True))
        self._covered = covered

    @classmethod
    def joined(cls, samples: Sequence["FieldSample"]) -> "FieldSample":
        """One sample of several of the same field, as if it had been taken of all of their scenes."""
        made = copy.copy(samples[-1])
        made._parts = [part for sample in samples for part in sample._parts]
        made._covered = [each for sample in samples for each in sample._covered]
        made._owned = all(sample._owned for sample in samples)
        return made

    def muted(self) -> tuple[str, ...]:
        """Names of the fluids that pictures of the field leave uncoloured.

        These are, for the pressure, fluids of less than 2 % of the largest density in which 96 % of the values
        lie in 10 % of the range of the others: air over water. Their cells at another pressure, in bubbles below the
        surface, are coloured nevertheless.
        """
        return muted_fluids(self.spans())

    def spans(self) -> dict[str, Range]:
        """Spans of the pressure in each of the fluids that may be muted, by name, and in all others together, as "".

        Of the latter 98 % of the values lie there, of the former 96 %. Empty for other fields, and where cells have no
        fluid.
        """
        if self.field != MUTED_FIELD or self._densities is None or not self._owned:
            return {}
        light = [k for k, density in enumerate(self._densities) if density < 0.02 * max(self._densities)]
        found: dict[str, Range] = {}
        values, fluid = (np.concatenate(each) for each in zip(*self._parts, strict=True))
        for name, mask, ends in (
            ("", ~np.isin(fluid, light), _SPAN),
            *((self._names[k], fluid == k, (2, 98)) for k in light),
        ):
            if mask.any():
                low, high = np.percentile(values[mask], ends)
                found[name] = float(low), float(high)
        return found

    def ends(self, muted: Sequence[str] = ()) -> Range:
        """The lowest and the highest value over all times, without 0.5 % of the area of each at either end.

        That of muted fluids does not count, unless there is no other.
        """
        shown = [k for k, name in enumerate(self._names) if name not in muted]
        low, high = zip(*(_ends_by_area(values, areas, shown) for values, areas in self._covered), strict=True)
        return min(low), max(high)

    def limits(self, muted: Sequence[str] = ()) -> Range:
        """A round range (low, high) for the colours, but for muted fluids.

        Of the area of each scene 0.5 % at either end are left out, so that single peaks in space do not determine
        the colours; the pointed ends of the colour bar say that there are more. A range that passes zero by little ends
        there. A signed quantity gets a range symmetric about zero, and a positive one starts at zero.
        """
        return round_limits(self.field, *self.ends(muted))

    def interval(self, muted: Sequence[str] = ()) -> float:
        """A round distance between contours, for at most 14 of them over the range of `limits`."""
        low, high = self.limits(muted)
        return _round_step((high - low) / (_MOST_CONTOURS - 1))


def _covered(scene: Scene, field: str) -> tuple[Array, Array]:
    """Values (K,) that colour a scene, and the areas (F, K) of each fluid that have them [m^2].

    A particle has a third of the area of the cells around it, one in no cell that of its dot.
    """
    cells, owner, count = scene.cells, scene.cell_fluid, len(scene.fluid_names)
    size = areas(scene.position, cells)
    if field in scene.cell_fields and owner is not None and len(cells):
        return scene.cell_values(field), np.where(owner == np.arange(count)[:, None], size, 0.0)
    own = scene.fluid[cells] if owner is None else np.repeat(owner[:, None], 3, axis=1)
    number = len(scene.position)
    covered = np.bincount((own * number + cells).ravel(), np.repeat(size / 3, 3), count * number)
    covered = covered.reshape(count, number)
    alone = scene.geometry.loose[0] if len(cells) else np.ones(number, bool)
    covered[scene.fluid[alone], alone] = _DOT * scene.spacing**2
    return scene.field_values(field), covered


def _ends_by_area(values: Array, covered: Array, shown: Sequence[int]) -> Range:
    """Ends of values (K,) beyond which lies 0.5 % of the area (F, K) of the fluids ``shown``, or of all."""
    own = covered[list(shown)].sum(axis=0)
    if not own.any():
        own = covered.sum(axis=0)
    order = np.argsort(values)
    passed = np.cumsum(own[order])
    low, high = np.searchsorted(passed, passed[-1] * np.array(_ENDS)).clip(0, len(values) - 1)
    return float(values[order[low]]), float(values[order[high]])


def muted_fluids(spans: Mapping[str, Range]) -> tuple[str, ...]:
    """Names of the fluids that pictures of the pressure leave uncoloured, by joined `FieldSample.spans`."""
    if "" not in spans:
        return ()
    low, high = spans[""]
    most = MUTED_SHARE * (high - low)
    return tuple(name for name, (lowest, highest) in spans.items() if name and highest - lowest < most)


def round_limits(field: str, low: float, high: float) -> Range:
    """A round range for a field by its ends, see `FieldSample.limits`."""
    scale = field_of(field).scale
    if scale == "signed":
        high = max(abs(low), abs(high))
        low = -high
    elif scale == "positive":
        low = 0.0
    elif -_NEAR_ZERO * high < low < 0:
        low = 0.0
    elif 0 < high < -_NEAR_ZERO * low:
        high = 0.0
    if not high > low:  # a uniform field: a range around its value
        width = abs(high) * 0.1 or 1.0
        return (0.0, width) if scale == "positive" else (low - width, high + width)
    step = _round_step((high - low) / 10)
    return math.floor(low / step + 1e-9) * step, math.ceil(high / step - 1e-9) * step


def check_range(field_range: Iterable[float]) -> Range:
    """The range as two numbers; `ValueError` unless both are finite, low below high."""
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
