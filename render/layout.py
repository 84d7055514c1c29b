"""Layout of a picture: the tank, and a panel with time, legend and colour bar."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from .arrays import Array, Box, Point

# The values of a `Layout` in its order, with points as tuples: two equal layouts have equal keys.
LayoutKey: TypeAlias = tuple[tuple[int, int], float, Point, Point, float, Box, bool, Box]

SMALLEST = (320, 240)  # [px] width, height
LARGEST = 16384
SMALLEST_UNIT = 0.5625  # below it the smallest text, 16 design pixels, can no longer be read

_NARROW = 900  # [design pixels] below this width a panel below the tank takes two rows


@dataclass(frozen=True)
class Layout:
    """Positions in a picture in pixels, y down.

    Attributes:
        size: (width, height) of the picture [px].
        unit: size of one design pixel of a 1280x720 picture [px]; text and lines scale with it.
        lower: (2,) lower corner of the framed region [m].
        upper: (2,) upper corner of it.
        scale: [px/m].
        box: left, top, right, bottom of the framed region [px].
        beside: whether the panel is to the right of the tank, else below it.
        panel: left, top, right, bottom of the panel [px].
    """

    size: tuple[int, int]
    unit: float
    lower: Array
    upper: Array
    scale: float
    box: Box
    beside: bool
    panel: Box

    @property
    def narrow(self) -> bool:
        """Whether a panel below the tank takes two rows."""
        return self.size[0] < _NARROW * self.unit

    @property
    def key(self) -> LayoutKey:
        """The layout as a value that can be compared and looked up."""
        lower, upper = ((float(x), float(y)) for x, y in (self.lower, self.upper))
        return self.size, self.unit, lower, upper, self.scale, self.box, self.beside, self.panel

    @classmethod
    def from_key(cls, key: LayoutKey) -> "Layout":
        """The layout of a `key`."""
        size, unit, lower, upper, scale, box, beside, panel = key
        return cls(size, unit, np.array(lower), np.array(upper), scale, box, beside, panel)

    def pixels(self, points: ArrayLike) -> Array:
        """Points (..., 2) [m] in the picture, (..., 2) [px]."""
        points = np.asarray(points, np.float64)
        left, _, _, bottom = self.box
        x = left + (points[..., 0] - self.lower[0]) * self.scale
        y = bottom - (points[..., 1] - self.lower[1]) * self.scale
        return np.stack([x, y], axis=-1)


def check_size(size: Sequence[int]) -> tuple[int, int]:
    """The size (width, height) as integers.

    Args:
        size: (width, height) [px].

    Raises:
        ValueError: these are not two even numbers in the range supported.
    """
    try:
        width, height = (int(n) for n in size)
        if (width, height) != tuple(size):
            raise ValueError
    except (TypeError, ValueError):
        raise ValueError(f"size {size!r}: expected two whole numbers of pixels, (width, height)") from None
    small = width < SMALLEST[0] or height < SMALLEST[1]
    if small or max(width, height) > LARGEST or width % 2 or height % 2:
        raise ValueError(
            f"size {width}x{height}: expected even numbers of pixels, from "
            f"{SMALLEST[0]}x{SMALLEST[1]} to {LARGEST}x{LARGEST}"
        )
    return width, height


def make_layout(size: tuple[int, int], lower: ArrayLike, upper: ArrayLike, title: bool, panel_width: float) -> Layout:
    """Make the tank as large as possible, with the panel beside it or below it.

    Args:
        size: (width, height) of the picture [px].
        lower: (2,) lower corner of the framed region [m].
        upper: (2,) upper corner of it.
        title: whether there is a title above the tank.
        panel_width: width that the panel needs beside the tank [design pixels].
    """
    width, height = size
    unit = max(SMALLEST_UNIT, min((width * height / (1280 * 720)) ** 0.5, width / 480, height / 360))
    extent = np.asarray(upper) - np.asarray(lower)
    pad, axis_left, axis_below, gap = 16 * unit, 72 * unit, 58 * unit, 44 * unit
    head = (60 if title else 30) * unit
    panel_width = min(panel_width * unit, 0.4 * width)
    band = (118 if width < _NARROW * unit else 84) * unit

    room_beside = (width - 2 * pad - axis_left - gap - panel_width, height - 2 * pad - head - axis_below)
    room_below = (width - 2 * pad - axis_left - 18 * unit, height - 2 * pad - head - axis_below - band)
    scale_beside = min(room_beside[0] / extent[0], room_beside[1] / extent[1])
    scale_below = min(room_below[0] / extent[0], room_below[1] / extent[1])
    beside = scale_beside >= scale_below
    scale = max(scale_beside, scale_below)
    tank = extent * scale

    if beside:
        group = (axis_left + tank[0] + gap + panel_width, head + tank[1] + axis_below)
        left = (width - group[0]) / 2 + axis_left
        top = (height - group[1]) / 2 + head
        panel = (left + tank[0] + gap, top, left + tank[0] + gap + panel_width, top + tank[1])
    else:
        group = (axis_left + tank[0] + 18 * unit, head + tank[1] + axis_below + band)
        left = (width - group[0]) / 2 + axis_left
        top = (height - group[1]) / 2 + head
        panel_top = top + tank[1] + axis_below
        panel = (left, panel_top, left + tank[0], panel_top + band)
    # Whole pixels: the tank's straight walls then fall between pixel rows and stay crisp.
    left, bottom = round(left), round(top + tank[1])
    box = (left, bottom - tank[1], left + tank[0], bottom)
    return Layout(size, unit, np.asarray(lower), np.asarray(upper), float(scale), box, beside, panel)
