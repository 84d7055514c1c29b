"""Text, ticks, legend and colour bar, painted on a finished picture at its own resolution."""

from collections.abc import Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from PIL import Image, ImageDraw, ImageFont

from tipfem.results.fields.catalogue import field_of

from . import colours
from .arrays import Array, Box, Point, Range
from .layers import WALL_THICKNESS, Key
from .layout import BESIDE_BAR, CLOCK, ROW, Layout, rows_of
from .scales import colour_map_of, fitting, round_ticks, tick_labels, time_text
from .scene import Scene
from .volume import Volume

SMALL, NORMAL, LARGE = 16, 19, 27  # text heights in design pixels
KEY_GROUND = "#3b7a78"  # behind light lines in the legend, a colour from the middle of the fields' tables


@lru_cache(maxsize=32)
def _font(height: float) -> Any:
    return ImageFont.load_default(size=height)


def text_width(text: str, height: float) -> float:
    """Width of a line of text of a height [px]."""
    return float(_font(height).getlength(text))


def panel_width(scene: Scene, field: str | None, texts: Sequence[str] = ()) -> float:
    """Width that the panel, with other ``texts`` in its legend, needs beside the tank [design pixels]."""
    names = [text_width(name, NORMAL) + 42 for name in (*scene.fluid_names, *texts)]
    return max([200.0, *names, text_width(field_of(field).title, NORMAL) if field else 0.0])


def entry_width(text: str) -> float:
    """Width of an entry of a legend with the space after it [design pixels]."""
    return text_width(text, NORMAL) + 72


class Annotator:
    """Paints text and scales on one picture (H, W, 3) uint8; without a colour map in that of the field."""

    def __init__(
        self, image: Array, layout: Layout, colour_map: str | None = None, scheme: colours.Scheme = colours.LIGHT
    ) -> None:
        self.image = Image.fromarray(image)
        self.draw = ImageDraw.Draw(self.image)
        self.layout = layout
        self.unit = layout.unit
        self.colour_map, self.scheme = colour_map, scheme

    def text(
        self,
        at: Point,
        text: str,
        height: float = NORMAL,
        colour: str | None = None,
        anchor: str = "lt",
        limit: float | None = None,
    ) -> None:
        """Write a line of text of a height [design pixels] at x, y [px]; a "^" raises the next character.

        Without a colour "#rrggbb" it has the scheme's; ``anchor`` is Pillow's; texts beyond a width ``limit`` [px] end
        in dots.
        """
        font, colour = _font(height * self.unit), colour or self.scheme.text
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

    def line(self, points: Sequence[Point]) -> None:
        """Draw a thin line through points [px]."""
        self.draw.line(list(points), fill=self.scheme.subtle, width=max(1, round(self.unit)))

    def axes(self, names: tuple[str, str]) -> None:
        """Draw ticks and their labels, left of the tank and below it, and the coordinates' ``names``."""
        left, top, right, bottom = self.layout.box
        u, lower, upper = self.unit, self.layout.lower, self.layout.upper
        factor, unit = fitting(max(upper[0] - lower[0], upper[1] - lower[1]))
        start, length = (WALL_THICKNESS + 3) * u, 6 * u

        horizontal = _with_ends(factor * lower[0], factor * upper[0], right - left, 90 * u)
        for value, label in horizontal:
            x = self.layout.pixels([value / factor, lower[1]])[0]
            self.line([(x, bottom + start), (x, bottom + start + length)])
            self.text((x, bottom + start + length + 5 * u), label, SMALL, self.scheme.subtle, "mt")
        vertical = _with_ends(factor * lower[1], factor * upper[1], bottom - top, 60 * u)
        for value, label in vertical:
            y = self.layout.pixels([lower[0], value / factor])[1]
            self.line([(left - start, y), (left - start - length, y)])
            self.text((left - start - length - 5 * u, y), label, SMALL, self.scheme.subtle, "rm")
        below = bottom + start + length + 27 * u
        self.text(((left + right) / 2, below), f"{names[0]} [{unit}]", SMALL, self.scheme.subtle, "mt")
        widest = max(text_width(label, SMALL * u) for _, label in vertical)
        at = left - start - length - 13 * u - widest, (top + bottom) / 2
        self.upright(at, f"{names[1]} [{unit}]", SMALL, self.scheme.subtle)

    def upright(self, at: Point, text: str, height: float, colour: str) -> None:
        """Write text of a height [design pixels] that reads upwards, its lower, right side's middle at x, y [px]."""
        font = _font(height * self.unit)
        size = (round(font.getlength(text)) + 2, round(1.3 * height * self.unit))
        mask = Image.new("L", size)
        ImageDraw.Draw(mask).text((1, size[1] / 2), text, fill=255, font=font, anchor="lm")
        mask = mask.transpose(Image.Transpose.ROTATE_90)
        place = (max(0, round(at[0] - size[1])), round(at[1] - size[0] / 2))
        self.image.paste(Image.new("RGB", mask.size, colour), place, mask)

    def title(self, text: str) -> None:
        """Write the title above the tank, cut at the end of the picture."""
        left, top, _, _ = self.layout.box
        room = self.layout.size[0] - left - 20 * self.unit
        self.text((left, top - 34 * self.unit), text, 23, self.scheme.text, "lm", limit=room)

    def panel(self, legend: "Legend") -> None:
        """Draw a legend with its colour bar, beside the tank or in rows below it."""
        swatches, field, field_range, _, keys, _ = legend
        left, top, right, bottom = self.layout.panel
        u = self.unit
        if self.layout.beside:
            y = top + 58 * u
            for name, fill in swatches:
                self.swatch((left, y), name, fill, right - left)
                y += ROW * u
            for key in keys:
                self.key((left, y), key, right - left)
                y += ROW * u
            if field is not None and field_range is not None:
                y += 10 * u * (len(swatches) + len(keys) > 0)
                self.text((left, y), field_of(field).title, NORMAL, limit=right - left)
                self.bar((left, y + 44 * u, left + 24 * u, bottom - 14 * u), field, field_range, upright=True)
            return
        y = top + 20 * u
        widths = [entry_width(text) for text in (*(name for name, _ in swatches), *(key.text for key in keys))]
        places = rows_of(widths, (right - left) / u)
        for (row, x), (name, fill) in zip(places, swatches, strict=False):
            self.swatch((left + x * u, y + row * ROW * u), name, fill, right - left - x * u)
        for (row, x), key in zip(places[len(swatches) :], keys, strict=True):
            self.key((left + x * u, y + row * ROW * u), key, right - left - x * u)
        if field is None or field_range is None:
            return
        x = left + CLOCK * u  # beside the time, and how the movie goes below it
        if sum(widths) > BESIDE_BAR:
            y += (places[-1][0] + 1) * ROW * u + 4 * u
        else:
            x += sum(widths) * u
        self.text((x, y), field_of(field).title, NORMAL)
        x += text_width(field_of(field).title, NORMAL * u) + 40 * u
        if self.layout.narrow:
            x, y = left + 12 * u, y + 52 * u
        self.bar((x, y, right - 12 * u, y + 20 * u), field, field_range)

    def swatch(self, at: Point, name: str, fill: ArrayLike, room: float) -> None:
        """Draw a fluid's colour (3,) and its name, the upper left corner at x, y, no wider than ``room`` [px]."""
        (x, y), u = at, self.unit
        side = 22 * u
        self.draw.rectangle(
            [x, y, x + side, y + side], fill=_bytes(fill), outline=self.scheme.wall, width=max(1, round(1.2 * u))
        )
        self.text((x + side + 12 * u, y + side / 2), name, NORMAL, anchor="lm", limit=room - side - 12 * u)

    def key(self, at: Point, key: Key, room: float) -> None:
        """Draw a line of the picture and what it stands for, from x, y, no wider than ``room`` [px]."""
        (x, y), u = at, self.unit
        side, middle = (24 if key.length is None else key.length + 4) * u, y + 11 * u
        # A light line is seen on the ground that it is for.
        if key.line == colours.HALO:
            self.draw.rectangle([x, middle - 8 * u, x + side, middle + 8 * u], fill=KEY_GROUND)
        # A shaft ends inside its head, whose tip is at the end of the length.
        ends = [(x + 2 * u, middle), (x + side - (6 if key.head else 2) * u, middle)]
        for colour, width in ((key.rim, 4.0), (key.line, 2.0)):
            self.draw.line(ends, fill=colour, width=max(1, round(width * u)))
        if key.head:
            tip = x + side - 2 * u
            corners = [(tip, middle), (tip - 9 * u, middle - 4 * u), (tip - 9 * u, middle + 4 * u)]
            self.draw.polygon(corners, fill=key.line)
        self.text((x + side + 10 * u, middle), key.text, NORMAL, anchor="lm", limit=room - side - 10 * u)

    def bar(self, box: Box, field: str, field_range: Range, upright: bool = False) -> None:
        """Draw a colour bar in a box [px], level or upright; its pointed ends stand for values outside the range."""
        left, top, right, bottom = box
        low, high = field_range
        length, width = (bottom - top, right - left) if upright else (right - left, bottom - top)
        u, table = self.unit, colours.colour_table(self.colour_map or colour_map_of(field))
        shades = table[np.rint(np.linspace(0, 255, max(2, round(length)))).astype(int)]
        pixels = np.rint(np.repeat(shades[None], max(2, round(width)), axis=0) * 255).astype(np.uint8)
        pixels = np.ascontiguousarray(pixels.swapaxes(0, 1)[::-1]) if upright else pixels
        self.image.paste(Image.fromarray(pixels), (round(left), round(top)))

        def at(along: float, across: float) -> Point:
            """A place so far from the low end, and from the side without labels [px]."""
            return (left + across, bottom - along) if upright else (left + along, top + across)

        ends = [(length, 0.55 * width, table[-1])]
        if field_of(field).scale != "positive" or low != 0:
            ends.append((0.0, -0.55 * width, table[0]))
        for end, tip, colour in ends:
            corners = at(end, 0), at(end + tip, width / 2), at(end, width)
            self.draw.polygon([(round(x), round(y)) for x, y in corners], fill=_bytes(colour))
        ticks = round_ticks(low, high, _most(length, (56 if upright else 70) * u))
        for value, label in zip(ticks, tick_labels(ticks), strict=True):
            along = (value - low) / (high - low) * length
            self.line([at(along, width), at(along, width + 6 * u)])
            self.text(at(along, width + (11 if upright else 10) * u), label, SMALL, anchor="lm" if upright else "mt")


class Legend(NamedTuple):
    """Explanation of what is seen in a picture."""

    swatches: tuple[tuple[str, tuple[float, ...]], ...]  # names of fluids, and their colours (3,)
    field: str | None = None  # that colours them
    field_range: Range | None = None  # (low, high) of its colours
    colour_map: str | None = None  # name; None for the usual one
    keys: tuple[Key, ...] = ()  # of the lines
    lapse: str = ""  # pace of the movie, below the time; "" for none


def annotate(
    image: Array, scene: Scene, layout: Layout, legend: Legend, scheme: colours.Scheme = colours.LIGHT
) -> Array:
    """Write all text and scales on a picture (H, W, 3) uint8, outside of its tank, and return it.

    All but the time is the same in many pictures: it is drawn once, and its pixels are kept.
    """
    where, colour = _constant_pixels(layout, scene.axes, scene.title, legend, scheme)
    image.reshape(-1, 3)[where] = colour
    clock(image, scene, layout, scheme)
    return image


def clock(image: Array, scene: Scene | Volume, layout: Layout, scheme: colours.Scheme = colours.LIGHT) -> None:
    """Write a scene's time on a picture (H, W, 3) uint8."""
    left, top = layout.panel[:2]
    u, text = layout.unit, time_text(scene.time, scene.digits, scene.span)
    if not layout.beside:
        top += 20 * u
    # Only the part of the picture about the text is copied to Pillow and back.
    column, row = max(0, int(left) - 2), max(0, int(top) - 2)
    height, width = round(1.3 * LARGE * u) + 4, round(text_width(text, LARGE * u)) + 8
    part = image[row : row + height, column : column + width]
    annotator = Annotator(np.ascontiguousarray(part), layout, scheme=scheme)
    annotator.text((left - column, top - row), text, LARGE)
    part[:] = np.asarray(annotator.image)


@lru_cache(maxsize=16)
def _constant_pixels(
    layout: Layout, axes: tuple[str, str], title: str, legend: Legend, scheme: colours.Scheme
) -> tuple[Array, Array]:
    """Axes, title, legend and colour bar: the pixels (K,) that they change in a picture, and their colours (K, 3)."""
    width, height = layout.size
    ground = np.array(_bytes(scheme.background), np.uint8)
    annotator = Annotator(np.tile(ground, (height, width, 1)), layout, legend.colour_map, scheme)
    annotator.axes(axes)
    if title:
        annotator.title(title)
    left, top = layout.panel[:2]
    below = (30 if layout.beside else 50) * layout.unit
    annotator.text((left, top + below), legend.lapse, SMALL, scheme.subtle)
    annotator.panel(legend)
    pixels = np.asarray(annotator.image).reshape(-1, 3)
    red, green, blue = (pixels != ground).T
    where = np.flatnonzero(red | green | blue)  # many times faster than a reduction over the channels
    return where, pixels[where]


def _with_ends(low: float, high: float, length: float, each: float) -> list[tuple[float, str]]:
    """Ticks of an axis of a length [px] and labels of about ``each`` [px]: round numbers, and ends with room."""
    ticks = round_ticks(low, high, _most(length, each))
    found = list(zip(ticks.tolist(), tick_labels(ticks), strict=True))
    room = 0.5 * each / length * (high - low)
    if len(ticks) and high - ticks[-1] > room:
        found.append((high, f"{high:.4g}"))
    if len(ticks) and ticks[0] - low > room:
        found.insert(0, (low, f"{low:.4g}"))
    return found


def _most(length: float, each: float) -> int:
    return max(2, int(length / each) + 1)


def _bytes(colour: ArrayLike) -> tuple[int, int, int]:
    red, green, blue = (round(255 * float(channel)) for channel in np.asarray(colour))
    return red, green, blue
