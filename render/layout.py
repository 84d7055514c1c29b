"""Layout of a picture: the tank, and a panel with time, legend and colour bar."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from .arrays import Array, Box, Point

SMALLEST = (320, 240)  # [px] width, height
LARGEST = 16384
SMALLEST_UNIT = 0.5625  # below it the smallest text, 16 design pixels, can no longer be read

_NARROW = 900  # [design pixels] below this width a panel below the tank takes two rows
_PAD = 16  # [design pixels] around all, and room for the axes and to the right of a tank
_AXIS_LEFT, _AXIS_BELOW, _RIGHT = 88, 58, 18
CLOCK = 180  # [design pixels] width of the time in a panel below the tank
ROW = 34  # [design pixels] height of a row of a legend
BESIDE_BAR = 200  # [design pixels] width of a legend that leaves room for a colour bar in its row
DEFAULT = (1280, 720)  # [px] that a picture fits into if no size is given


@dataclass(frozen=True)
class Layout:
    """Positions in a picture in pixels, y down."""

    size: tuple[int, int]  # (width, height) of the picture [px]
    unit: float  # size of one design pixel of a 1280x720 picture [px]; text and lines scale with it
    lower: Point  # lower corner of the framed region [m]
    upper: Point  # upper corner of it
    scale: float  # [px/m]
    box: Box  # left, top, right, bottom of the framed region [px]
    beside: bool  # whether the panel is to the right of the tank, else below it
    panel: Box  # left, top, right, bottom of the panel [px]

    @property
    def narrow(self) -> bool:
        """Whether a panel below the tank takes two rows."""
        return self.size[0] < _NARROW * self.unit

    def pixels(self, points: ArrayLike) -> Array:
        """Points (..., 2) [m] in the picture, (..., 2) [px]."""
        points = np.asarray(points, np.float64)
        left, _, _, bottom = self.box
        x = left + (points[..., 0] - self.lower[0]) * self.scale
        y = bottom - (points[..., 1] - self.lower[1]) * self.scale
        return np.stack([x, y], axis=-1)


def point(place: ArrayLike) -> Point:
    """A place (2,) as a value that can be compared."""
    x, y = np.asarray(place, float).tolist()
    return x, y


def check_size(size: Sequence[int]) -> tuple[int, int]:
    """The size (width, height) [px] as integers; `ValueError` unless both are even and in the range supported."""
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


def rows_of(widths: Sequence[float], room: float) -> list[tuple[int, float]]:
    """Rows and x of the entries of a legend of some widths below a tank, in so much room [design pixels]."""
    places, row, x = [], 0, float(CLOCK)
    for width in widths:
        if x + width > room and x > CLOCK:
            row, x = row + 1, float(CLOCK)
        places.append((row, x))
        x += width
    return places


def make_layout(
    size: tuple[int, int],
    lower: ArrayLike,
    upper: ArrayLike,
    title: bool,
    panel_width: float,
    entries: Sequence[float] = (),
    bar: bool = False,
) -> Layout:
    """Make the tank as large as possible, with the panel beside it or below it.

    Args:
        size: (width, height) of the picture [px].
        lower: (2,) lower corner of the framed region [m].
        upper: (2,) upper corner of it.
        title: whether there is a title above the tank.
        panel_width: width that the panel needs beside the tank [design pixels].
        entries: widths of the entries of the legend [design pixels].
        bar: whether there is a colour bar.
    """
    width, height = size
    of_area = (width * height / (DEFAULT[0] * DEFAULT[1])) ** 0.5
    of_sides = max(width / DEFAULT[0], height / DEFAULT[1])
    unit = max(SMALLEST_UNIT, min(1.25 * of_area, of_sides, width / 480, height / 360))
    extent = np.asarray(upper) - np.asarray(lower)
    pad, axis_left, axis_below, gap = _PAD * unit, _AXIS_LEFT * unit, _AXIS_BELOW * unit, 44 * unit
    head = _head(title) * unit
    panel_width = min(panel_width * unit, 0.4 * width)

    room_beside = (width - 2 * pad - axis_left - gap - panel_width, height - 2 * pad - head - axis_below)
    wide = width - 2 * pad - axis_left - _RIGHT * unit
    scale_beside = min(room_beside[0] / extent[0], room_beside[1] / extent[1])
    scale_below, rows = wide / extent[0], -1
    while True:  # the legend is as wide as the tank, which the height of the legend may make smaller
        places, before = rows_of(entries, scale_below * extent[0] / unit), rows
        rows = places[-1][0] + 1 if places and (not bar or sum(entries) > BESIDE_BAR) else 0
        if rows <= before:
            break
        own = bar or not rows  # a row with the colour bar, or with nothing but the time
        band = ((128 if width < _NARROW * unit else 84) * own + ROW * rows + 30 * (not own)) * unit
        scale_below = min(scale_below, (height - 2 * pad - head - axis_below - band) / extent[1])
    beside = scale_beside >= scale_below
    scale = max(scale_beside, scale_below)
    tank = extent * scale

    if beside:
        group = (axis_left + tank[0] + gap + panel_width, head + tank[1] + axis_below)
        left = (width - group[0]) / 2 + axis_left
        top = (height - group[1]) / 2 + head
        panel = (left + tank[0] + gap, top, left + tank[0] + gap + panel_width, top + tank[1])
    else:
        group = (axis_left + tank[0] + _RIGHT * unit, head + tank[1] + axis_below + band)
        left = (width - group[0]) / 2 + axis_left
        top = (height - group[1]) / 2 + head
        panel_top = top + tank[1] + axis_below
        panel = (left, panel_top, left + tank[0], panel_top + band)
    # Whole pixels: the tank's straight walls then fall between pixel rows and stay crisp.
    left, bottom = round(left), round(top + tank[1])
    box = (left, bottom - tank[1], left + tank[0], bottom)
    return Layout(size, unit, point(lower), point(upper), float(scale), box, beside, panel)


def fitted_size(
    lower: ArrayLike,
    upper: ArrayLike,
    title: bool,
    panel_width: float,
    entries: Sequence[float] = (),
    bar: bool = False,
) -> tuple[int, int]:
    """The size (width, height) [px] without the empty margins of a picture of 1280x720; see `make_layout`."""
    layout = make_layout(DEFAULT, lower, upper, title, panel_width, entries, bar)
    left, top, right, bottom = layout.box
    right = layout.panel[2] if layout.beside else right + _RIGHT * layout.unit
    bottom = bottom + _AXIS_BELOW * layout.unit if layout.beside else layout.panel[3]
    width = right - left + (_AXIS_LEFT + 2 * _PAD) * layout.unit
    height = bottom - top + (_head(title) + 2 * _PAD) * layout.unit
    fitted = (max(640, 2 * math.ceil(width / 2)), max(320, 2 * math.ceil(height / 2)))
    return min(fitted[0], DEFAULT[0]), min(fitted[1], DEFAULT[1])


def _head(title: bool) -> int:
    """Room above the tank [design pixels]."""
    return 52 if title else 20
