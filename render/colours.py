"""Colours of the fluids and of the fields, as sRGB in [0, 1]."""

import re
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from .arrays import Array

BACKGROUND = (1.0, 1.0, 1.0)
TEXT = "#1f2630"
SUBTLE = "#69717c"
WALL = "#3d4653"
INTERFACE = "#061528"
HALO = "#ffffff"
TRACER = "#8a1f62"
CONTOUR, CONTOUR_ON_RED = "#e8432e", "#00703c"  # the second on maps that have red themselves
STREAMLINE = "#6a3d9a"  # on fluids; white over a field
RIM = "#56606c"  # around white lines


class Scheme(NamedTuple):
    """Colours around the fluids."""

    background: tuple[float, float, float]  # (3,) of the picture and of space without a fluid
    wall: str  # "#rrggbb"
    text: str  # "#rrggbb"
    subtle: str  # "#rrggbb" of the axes
    line: str  # "#rrggbb" of interfaces, at a contrast of 3 at least to what `shades` gives
    body: str  # "#rrggbb" of rigid bodies

    @property
    def dark(self) -> bool:
        """Whether the ground is dark."""
        return self.line != INTERFACE


LIGHT = Scheme(BACKGROUND, WALL, TEXT, SUBTLE, INTERFACE, "#c3c8cf")
DARK = Scheme((0x15 / 255, 0x1A / 255, 0x21 / 255), "#8793a3", "#e4e9ef", "#9ba7b5", "#f4fafd", "#6b7683")
LOOKS = ("lit", "flat")  # of fluids: shaded by depth, or of one colour, for print


def on_transparent(draw: Callable[[Scheme], Array], scheme: Scheme) -> Array:
    """A picture (H, W, 4) uint8 without background, by two of ``draw``, (H, W, 3), with a white and a black one."""
    white, black = (draw(scheme._replace(background=(ground,) * 3)).astype(np.float64) for ground in (1.0, 0.0))
    alpha = 255 - (white - black).mean(axis=2, keepdims=True)
    colour = np.where(alpha > 0, 255 * black / np.maximum(alpha, 1.0), 0.0)
    return np.asarray(np.rint(np.clip(np.concatenate([colour, alpha], axis=2), 0, 255)), np.uint8)


# Okabe and Ito's palette, told apart with every common colour vision: blue, orange, bluish green,
# vermilion, reddish purple, yellow.
LIQUIDS = ("#0072b2", "#e69f00", "#009e73", "#d55e00", "#cc79a7", "#f0e442")
GASES = ("#e8f3fa", "#efe6f3", "#f4f1e1")
_NIGHT = ("#0c1622", "#15273a")  # gases on a dark ground, at the top and at the bottom
GAS_DENSITY = 50.0  # [kg/m^3]: gases below, liquids above, near room conditions

# viridis (S. van der Walt and N. Smith, 2015, CC0) at nine equal steps.
VIRIDIS = ("#440154", "#472d7b", "#3b528b", "#2c728e", "#21918c", "#28ae80", "#5ec962", "#addc30", "#fde725")
# RdBu from C. Brewer's ColorBrewer, reversed: blue below, white in the middle, red above.
BLUE_RED = tuple("#053061 #2166ac #4393c3 #92c5de #d1e5f0 #f7f7f7 #fddbc7 #f4a582 #d6604d #b2182b #67001f".split())

# cividis (J. Nunez, C. Anderton and R. Renslow, 2018), which looks alike with and without red-green colour blindness.
CIVIDIS = tuple(
    "#00224e #002e6a #1a386f #32436d #434e6c #535a6d #61656f #6f7073 #7d7c78 "
    "#8c8878 #9b9476 #aba072 #bcae6c #cdbb63 #dec958 #f0d846 #fee838".split()
)
COLOUR_MAPS = {"viridis": VIRIDIS, "cividis": CIVIDIS, "blue-red": BLUE_RED}


def rgb(code: str) -> Array:
    """The colour "#rrggbb" as an array (3,) in [0, 1]; `ValueError` for other forms."""
    if not isinstance(code, str) or not re.fullmatch(r"#[0-9a-fA-F]{6}", code):
        raise ValueError(f"colour {code!r}: expected '#rrggbb', for example '#0072b2'")
    return np.array([int(code[k : k + 2], 16) for k in (1, 3, 5)]) / 255


def hex_code(colour: ArrayLike) -> str:
    """The colour (3,) in [0, 1] as "#rrggbb"."""
    return "#" + "".join(f"{round(255 * float(part)):02x}" for part in np.asarray(colour))


def mix(colour: ArrayLike, other: ArrayLike, share: ArrayLike) -> Array:
    """Mixture of two colours (..., 3) with a ``share`` of the other one."""
    share = np.asarray(share)
    return np.asarray((1 - share) * np.asarray(colour) + share * np.asarray(other))


def colour_table(name: str) -> Array:
    """256 colours, (256, 3), of a map of `COLOUR_MAPS`."""
    points = np.stack([rgb(code) for code in COLOUR_MAPS[name]])
    at, steps = np.linspace(0, 1, 256), np.linspace(0, 1, len(points))
    return np.stack([np.interp(at, steps, channel) for channel in points.T], axis=1)


def map_values(values: ArrayLike, low: float, high: float, table: Array) -> Array:
    """Colours (..., 3) of values (...) in a table (K, 3); those outside [low, high] take that of the nearer end."""
    share = np.clip((np.asarray(values) - low) / (high - low), 0, 1)
    return np.asarray(table[np.rint(share * (len(table) - 1)).astype(np.int64)])


def fluid_colours(
    names: Sequence[str], densities: Sequence[float] | None = None, chosen: Mapping[str, str] | None = None
) -> Array:
    """Fill colours (F, 3), one per fluid of a density (F,) [kg/m^3], or those ``chosen``, "#rrggbb" by names.

    Gases are near-white, and so is the last of several fluids without densities. Among the liquids, the one named water
    (else the heaviest) is blue; the others take orange, green, ... from heavy to light.

    Raises:
        ValueError: a colour is given for a name that is not a fluid, or is not of the form "#rrggbb".
    """
    chosen = dict(chosen or {})
    for name in chosen:
        if name not in names:
            raise ValueError(f"colour given for {name!r}; the fluids are: {', '.join(names)}")
    if densities is None:
        densities = [1000.0 - k for k in range(len(names))]
        if len(names) > 1:
            densities[-1] = 1.0
    known = densities
    by_density = sorted(range(len(names)), key=lambda k: -known[k])
    gases = [k for k in by_density if densities[k] < GAS_DENSITY]
    liquids = [k for k in by_density if densities[k] >= GAS_DENSITY]
    liquids.sort(key=lambda k: "water" not in names[k].lower())  # stable: the rest stay heavy to light
    codes = {k: GASES[n % len(GASES)] for n, k in enumerate(gases)}
    codes |= {k: LIQUIDS[n % len(LIQUIDS)] for n, k in enumerate(liquids)}
    return np.stack([rgb(chosen.get(name, codes[k])) for k, name in enumerate(names)])


def shades(fills: ArrayLike, scheme: Scheme, look: str | None = "lit") -> Array:
    """Colours (F, 2, 3) of fluids filled with (F, 3) at the top of a picture and at its bottom, lit from above.

    On a dark ground liquids are darker, and gases are as dark as the night. Flat ``looks``, or None, have one colour.
    """
    own = np.asarray(fills, float)
    gas = _pale(own)
    top, bottom = mix(own, 1.0, np.where(gas, 0.5, 0.55)), own
    if scheme.dark:
        top = np.where(gas, mix(rgb(_NIGHT[0]), own, 0.03), _dimmed(mix(own, 1.0, 0.25), 0.25))
        bottom = np.where(gas, mix(rgb(_NIGHT[1]), own, 0.03), _dimmed(own, 0.05))
    flat = look != "lit"
    if flat and scheme.dark:
        top = bottom = mix(top, bottom, 0.5)
    return np.stack([bottom if flat else top, bottom], axis=1)


def at_depth(ends: ArrayLike, y: ArrayLike, top: float, bottom: float) -> Array:
    """Colours (..., 3) at heights (...), linear between ``ends`` (2, 3) or (..., 2, 3), one of `shades`."""
    share, ends = np.clip((np.asarray(y) - top) / (bottom - top), 0, 1)[..., None], np.asarray(ends)
    return np.asarray((1 - share) * ends[..., 0, :] + share * ends[..., 1, :])


def luminance(colour: ArrayLike) -> Array:
    """Approximate lightness (...,) of colours (..., 3)."""
    return np.asarray(np.asarray(colour) @ np.array([0.2126, 0.7152, 0.0722]))


def contrast(one: ArrayLike, other: ArrayLike) -> Array:
    """Contrast (...,) of colours (..., 3), 1 to 21, as the guidelines for accessible pages define it."""
    a, b = _brightness(one), _brightness(other)
    return np.asarray((np.maximum(a, b) + 0.05) / (np.minimum(a, b) + 0.05))


def _brightness(colour: ArrayLike) -> Array:
    """Relative luminance (...,) of sRGB colours (..., 3)."""
    part = np.asarray(colour, float)
    return luminance(np.where(part <= 0.04045, part / 12.92, ((part + 0.055) / 1.055) ** 2.4))


def _dimmed(colour: Array, most: float) -> Array:
    """Colours (..., 3) darkened to a relative luminance where they are brighter."""
    share = np.minimum(1.0, most / np.maximum(_brightness(colour), 1e-6)) ** (1 / 2.2)
    return np.asarray(colour * share[..., None])


def _pale(fills: ArrayLike) -> Array:
    return np.asarray((luminance(fills) > 0.75)[:, None])


def tone(fills: ArrayLike) -> Array:
    """Colours (F, 3) of fine lines on the fills: darker on pale ones, lighter on dark ones."""
    dark = (luminance(fills) < 0.45)[:, None]
    return np.where(dark, mix(fills, 1.0, 0.38), mix(fills, rgb(WALL), 0.38))


def dot_colours_on_field(fills: ArrayLike) -> Array:
    """Colours (F, 3) of particle dots over a field: pale fluids near-white, the others dark."""
    return np.where(_pale(fills), mix(fills, 1.0, 0.5), 0.45 * np.asarray(fills))


def dot_colours(fills: ArrayLike) -> Array:
    """Colours (F, 3) of particle dots: the fill where it is strong, a darker tone of it where it is pale."""
    fills = np.asarray(fills)
    return np.where(_pale(fills), fills * np.array([0.52, 0.64, 0.74]), fills)
