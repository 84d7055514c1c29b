"""Text, ticks, legend and colour bar, painted on a finished picture at its own resolution."""

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from PIL import Image, ImageDraw, ImageFont

from . import colours
from .arrays import Array, Box, Point, Range
from .layers import WALL_THICKNESS
from .layout import Layout, LayoutKey
from .scales import colour_map_of, field_label, round_ticks, tick_labels
from .scene import Scene

SMALL, NORMAL, LARGE = 16, 19, 27  # text heights in design pixels


@lru_cache(maxsize=32)
def _font(height: float) -> Any:
    return ImageFont.load_default(size=height)


def text_width(text: str, height: float) -> float:
    """Width of a text [px].

    Args:
        text: one line.
        height: of the text [px].
    """
    return float(_font(height).getlength(text))


def panel_width(scene: Scene, field: str | None) -> float:
    """Width that the panel needs beside the tank [design pixels].

    Args:
        scene: what is drawn.
        field: name of the field shown, or None.
    """
    names = [text_width(name, NORMAL) + 42 for name in scene.fluid_names]
    return max([200.0, *names, text_width(field_label(field), NORMAL) if field else 0.0])


class Annotator:
    """Paints text and scales on one picture.

    Args:
        image: (H, W, 3) uint8.
        layout: of the picture.
        colour_map: of the colour bar; None takes that of the field.
    """

    def __init__(self, image: Array, layout: Layout, colour_map: str | None = None) -> None:
        self.image = Image.fromarray(image)
        self.draw = ImageDraw.Draw(self.image)
        self.layout = layout
        self.unit = layout.unit
        self.colour_map = colour_map

    def text(
        self,
        at: Point,
        text: str,
        height: float = NORMAL,
        colour: str = colours.TEXT,
        anchor: str = "lt",
        limit: float | None = None,
    ) -> None:
        """Write one line of text.

        Args:
            at: x and y of the anchor [px].
            text: to be written; a "^" raises the next character.
            height: [design pixels].
            colour: "#rrggbb".
            anchor: of Pillow.
            limit: largest width [px]; longer texts are cut and end in dots.
        """
        font = _font(height * self.unit)
        if limit is not None:
            whole = text
            while text and font.getlength(text if text == whole else text + "...") > limit:
                text = text[:-1]
            text = text if text == whole else text + "..."
        base, caret, power = text.partition("^")
        if not caret:
            self.draw.text(at, text, fill=colour, font=font, anchor=anchor)
            return
        # The built-in font has no superscript digits: set them smaller and higher.
        raised, rest = power[0], power[1:]
        small = _font(height * self.unit * 0.68)
        total = font.getlength(base) + small.getlength(raised) + font.getlength(rest)
        x = at[0] - {"l": 0, "m": total / 2, "r": total}[anchor[0]]
        y, anchor = at[1], "l" + anchor[1]
        higher = y - 0.28 * height * self.unit
        for part, part_font, part_y in ((base, font, y), (raised, small, higher), (rest, font, y)):
            self.draw.text((x, part_y), part, fill=colour, font=part_font, anchor=anchor)
            x += part_font.getlength(part)

    def line(self, points: Sequence[Point], colour: str = colours.SUBTLE) -> None:
        """Draw a thin line through points [px] in a ``colour`` "#rrggbb"."""
        self.draw.line(list(points), fill=colour, width=max(1, round(self.unit)))

    def axes(self) -> None:
        """Draw ticks and their labels in metres, left of the tank and below it."""
        left, top, right, bottom = self.layout.box
        u, lower, upper = self.unit, self.layout.lower, self.layout.upper
        start, length = (WALL_THICKNESS + 3) * u, 6 * u

        horizontal = round_ticks(lower[0], upper[0], _most(right - left, 90 * u))
        for value, label in zip(horizontal, tick_labels(horizontal), strict=True):
            x = self.layout.pixels([value, lower[1]])[0]
            self.line([(x, bottom + start), (x, bottom + start + length)])
            self.text((x, bottom + start + length + 5 * u), label, SMALL, colours.SUBTLE, "mt")
        vertical = round_ticks(lower[1], upper[1], _most(bottom - top, 60 * u))
        for value, label in zip(vertical, tick_labels(vertical), strict=True):
            y = self.layout.pixels([lower[0], value])[1]
            self.line([(left - start, y), (left - start - length, y)])
            self.text((left - start - length - 5 * u, y), label, SMALL, colours.SUBTLE, "rm")
        below = bottom + start + length + 27 * u
        self.text(((left + right) / 2, below), "x [m]", SMALL, colours.SUBTLE, "mt")
        self.text((left - start - length - 5 * u, top - 22 * u), "y [m]", SMALL, colours.SUBTLE, "rm")

    def title(self, text: str) -> None:
        """Write the title above the tank, cut at the end of the picture."""
        left, top, _, _ = self.layout.box
        room = self.layout.size[0] - left - 20 * self.unit
        self.text((left, top - 44 * self.unit), text, 23, colours.TEXT, "lm", limit=room)

    def panel(self, names: Sequence[str], fills: Array, field: str | None, field_range: Range | None) -> None:
        """Draw legend and colour bar, stacked beside the tank or in a row below it; see `clock` for the time.

        Args:
            names: of the fluids.
            fills: (F, 3) colours of the fluids.
            field: name of the field shown, or None.
            field_range: (low, high) of its colours.
        """
        left, top, right, bottom = self.layout.panel
        u = self.unit
        if self.layout.beside:
            y = top + 58 * u
            if field is None or field_range is None:
                for name, fill in zip(names, fills, strict=True):
                    self.swatch((left, y), name, fill, right - left)
                    y += 34 * u
            else:
                y = self.interface_key((left, y), len(names))
                self.text((left, y), field_label(field), NORMAL, limit=right - left)
                self.upright_bar((left, y + 44 * u, left + 24 * u, bottom - 14 * u), field, field_range)
            return
        y = top + 20 * u
        x = left + text_width("t = 000.000 s", LARGE * u) + 40 * u
        if field is None or field_range is None:
            for name, fill in zip(names, fills, strict=True):
                self.swatch((x, y), name, fill, right - x)
                x += text_width(name, NORMAL * u) + 72 * u
        else:
            self.text((x, y), field_label(field), NORMAL)
            x += text_width(field_label(field), NORMAL * u) + 40 * u
            if self.layout.narrow:
                x, y = left + 12 * u, y + 42 * u
            self.level_bar((x, y, right - 12 * u, y + 20 * u), field, field_range)

    def swatch(self, at: Point, name: str, fill: Array, room: float) -> None:
        """Draw a fluid's colour and its name.

        Args:
            at: upper left corner [px].
            name: of the fluid.
            fill: (3,) colour.
            room: largest width of both [px].
        """
        (x, y), u = at, self.unit
        side = 22 * u
        self.draw.rectangle(
            [x, y, x + side, y + side], fill=_bytes(fill), outline=colours.WALL, width=max(1, round(1.2 * u))
        )
        self.text((x + side + 12 * u, y + side / 2), name, NORMAL, anchor="lm", limit=room - side - 12 * u)

    def interface_key(self, at: Point, fluids: int) -> float:
        """Draw the key of the interface over a field, if there are two fluids.

        Args:
            at: upper left corner [px].
            fluids: their number.

        Returns:
            y below it [px].
        """
        (x, y), u = at, self.unit
        if fluids < 2:
            return y
        self.draw.line(
            [(x, y + 10 * u), (x + 24 * u, y + 10 * u)], fill=colours.INTERFACE, width=max(1, round(1.8 * u))
        )
        self.text((x + 34 * u, y + 10 * u), "interface", NORMAL, anchor="lm")
        return y + 44 * u

    def upright_bar(self, box: Box, field: str, field_range: Range) -> None:
        """Draw a vertical colour bar; its pointed ends stand for values outside the range.

        Args:
            box: left, top, right, bottom [px].
            field: name of the field.
            field_range: (low, high) of its colours.
        """
        left, top, right, bottom = box
        table = colours.colour_table(self.colour_map or colour_map_of(field))
        rows = max(2, round(bottom - top))
        shades = table[np.rint(np.linspace(255, 0, rows)).astype(int)]
        columns = max(2, round(right - left))
        self._bar(np.repeat(shades[:, None], columns, axis=1), box)
        tip, middle = (right - left) * 0.55, (left + right) / 2
        self._end([(left, top), (middle, top - tip), (right, top)], table[-1])
        if not (field == "speed" and field_range[0] == 0):
            self._end([(left, bottom), (middle, bottom + tip), (right, bottom)], table[0])
        ticks = round_ticks(field_range[0], field_range[1], _most(bottom - top, 56 * self.unit))
        for value, label in zip(ticks, tick_labels(ticks), strict=True):
            y = bottom - (value - field_range[0]) / (field_range[1] - field_range[0]) * (bottom - top)
            self.line([(right, y), (right + 6 * self.unit, y)])
            self.text((right + 11 * self.unit, y), label, SMALL, anchor="lm")

    def level_bar(self, box: Box, field: str, field_range: Range) -> None:
        """Draw a horizontal colour bar; see `upright_bar`."""
        left, top, right, bottom = box
        table = colours.colour_table(self.colour_map or colour_map_of(field))
        columns = max(2, round(right - left))
        shades = table[np.rint(np.linspace(0, 255, columns)).astype(int)]
        self._bar(np.repeat(shades[None], max(2, round(bottom - top)), axis=0), box)
        tip, middle = (bottom - top) * 0.55, (top + bottom) / 2
        self._end([(right, top), (right + tip, middle), (right, bottom)], table[-1])
        if not (field == "speed" and field_range[0] == 0):
            self._end([(left, top), (left - tip, middle), (left, bottom)], table[0])
        ticks = round_ticks(field_range[0], field_range[1], _most(right - left, 70 * self.unit))
        for value, label in zip(ticks, tick_labels(ticks), strict=True):
            x = left + (value - field_range[0]) / (field_range[1] - field_range[0]) * (right - left)
            self.line([(x, bottom), (x, bottom + 6 * self.unit)])
            self.text((x, bottom + 10 * self.unit), label, SMALL, anchor="mt")

    def _bar(self, shades: Array, box: Box) -> None:
        bar = Image.fromarray(np.rint(shades * 255).astype(np.uint8))
        self.image.paste(bar, (round(box[0]), round(box[1])))

    def _end(self, corners: Sequence[Point], colour: Array) -> None:
        self.draw.polygon([(round(x), round(y)) for x, y in corners], fill=_bytes(colour))


def annotate(
    image: Array,
    scene: Scene,
    layout: Layout,
    fills: Array,
    field: str | None = None,
    field_range: Range | None = None,
    colour_map: str | None = None,
    notes: Sequence[str] = (),
) -> Array:
    """Write all text and scales on a picture, outside of its tank.

    All but the time is the same in many pictures: it is drawn once, and its pixels are kept.

    Args:
        image: (H, W, 3) uint8; changed.
        scene: what is drawn.
        layout: of the picture.
        fills: (F, 3) colours of the fluids.
        field: name of the field shown, or None.
        field_range: (low, high) of its colours.
        colour_map: of the field; None takes the usual one.
        notes: lines of text on the scales of layers.

    Returns:
        The image.
    """
    shades = tuple(tuple(map(float, fill)) for fill in fills)
    where, colour = _constant_pixels(layout.key, scene.title, scene.fluid_names, shades, field, field_range, colour_map)
    image.reshape(-1, 3)[where] = colour
    clock(image, scene.time, layout, notes)
    return image


def clock(image: Array, time: float, layout: Layout, notes: Sequence[str] = ()) -> None:
    """Write the time on a picture, and notes below it.

    Args:
        image: (H, W, 3) uint8; changed.
        time: [s].
        layout: of the picture.
        notes: lines of text.
    """
    left, top = layout.panel[:2]
    u, text = layout.unit, f"t = {time:.3f} s"
    if not layout.beside:
        top += 20 * u
    # Only the part of the picture about the text is copied to Pillow and back.
    column, row = max(0, int(left) - 2), max(0, int(top) - 2)
    height, width = round(1.3 * LARGE * u) + 4, round(text_width(text, LARGE * u)) + 8
    if notes:
        row = max(0, row - round(20 * u))
        height += round(20 * u)
        width = max(width, round(text_width(", ".join(notes), SMALL * u)) + 8)
    part = image[row : row + height, column : column + width]
    annotator = Annotator(np.ascontiguousarray(part), layout)
    annotator.text((left - column, top - row), text, LARGE)
    if notes:
        annotator.text((left - column, 0), ", ".join(notes), SMALL, colours.SUBTLE)
    part[:] = np.asarray(annotator.image)


@lru_cache(maxsize=16)
def _constant_pixels(
    layout_key: LayoutKey,
    title: str,
    names: tuple[str, ...],
    shades: tuple[tuple[float, ...], ...],
    field: str | None,
    field_range: Range | None,
    colour_map: str | None,
) -> tuple[Array, Array]:
    """Axes, title, legend and colour bar: the pixels (K,) that they change in a picture, and their colours (K, 3)."""
    layout = Layout.from_key(layout_key)
    width, height = layout.size
    annotator = Annotator(np.full((height, width, 3), 255, np.uint8), layout, colour_map)
    annotator.axes()
    if title:
        annotator.title(title)
    annotator.panel(names, np.array(shades), field, field_range)
    pixels = np.asarray(annotator.image).reshape(-1, 3)
    red, green, blue = (pixels != 255).T
    where = np.flatnonzero(red | green | blue)  # many times faster than a reduction over the channels
    return where, pixels[where]


def _most(length: float, each: float) -> int:
    return max(2, int(length / each) + 1)


def _bytes(colour: ArrayLike) -> tuple[int, int, int]:
    red, green, blue = (round(255 * float(channel)) for channel in np.asarray(colour))
    return red, green, blue
