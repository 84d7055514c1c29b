"""A figure of several stored times of a run, side by side in one picture."""

from collections.abc import Iterable, Mapping, Sequence
from math import ceil
from os import PathLike
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from . import colours
from .annotation import NORMAL, Annotator, text_width
from .arrays import Array
from .layers import WALL_THICKNESS
from .layout import LARGEST, SMALLEST, Layout
from .renderer import Renderer
from .results import Results

WIDTH = 1600  # [px] of a whole strip
MOST_COLUMNS = 4  # by default
_HEAD, _FOOT, _SIDE = 40.0, 14.0, 14.0  # around a tank, for its time and the next tank [design pixels]
_LEGEND = 52.0


def strip(
    out: str | PathLike[str],
    times: Iterable[float] | float,
    path: str | PathLike[str] | None = None,
    *,
    columns: int | None = None,
    width: int = WIDTH,
    backend: str = "auto",
    fluid_colours: Mapping[str, str] | None = None,
) -> Path:
    """Draw the fluids of a results folder at several times, side by side in one PNG.

    Args:
        out: results folder.
        times: one or several [s]; the closest stored times are drawn, each once, with their times above. None may be
            later than the last one by more than the time between two.
        path: of the picture; by default strip.png in the results folder.
        columns: tanks in a row; at most 4 by default.
        width: of the whole picture [px].
        backend: "ggui", "raster" or "auto", see `Renderer`.
        fluid_colours: colours "#rrggbb" by the names of fluids.

    Returns:
        The path of the picture.

    Raises:
        ValueError: an argument is invalid.
        ResultsError: the results folder cannot be read.
        OSError: the picture cannot be written.
    """
    results = Results(out)
    chosen = closest(results.times, times)
    if columns is None:
        columns = ceil(len(chosen) / ceil(len(chosen) / MOST_COLUMNS))
    if columns < 1:
        raise ValueError(f"strip: columns is {columns}; it must be 1 or more")
    columns = min(columns, len(chosen))
    # Even numbers of pixels, as the back ends need them.
    room = 2 * int(width // columns // 2)
    layout = _tank_layout(room, results.lower, results.upper)
    unit = layout.unit
    rows = ceil(len(chosen) / columns)
    height = layout.size[1]
    sheet = np.full((rows * height + round(_LEGEND * unit), columns * room, 3), 255, np.uint8)
    with Renderer(layout.size, backend, fluid_colours) as renderer:
        for number, k in enumerate(chosen):
            scene = results.scene(k)
            annotator = Annotator(renderer.tank(scene, layout), layout)
            left, top, right, _ = layout.box
            at = ((left + right) / 2, top - (WALL_THICKNESS + 6) * unit)
            annotator.text(at, label(results.times[k], results.times), NORMAL, anchor="ms")
            row, column = divmod(number, columns)
            sheet[row * height : (row + 1) * height, column * room : (column + 1) * room] = np.asarray(annotator.image)
    fills = colours.fluid_colours(results.fluid_names, results.fluid_densities, fluid_colours)
    whole = Annotator(sheet, layout)
    _legend(whole, results.fluid_names, fills, rows * height)
    target = results.folder / "strip.png" if path is None else Path(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    whole.image.save(target, format="png", compress_level=6)
    return target


def closest(stored: ArrayLike, times: Iterable[float] | float) -> list[int]:
    """Numbers of the stored times that are closest to given ones, in order, each once.

    Args:
        stored: (K,) stored times [s].
        times: the times wanted [s].

    Raises:
        ValueError: no time is given, or one is not a finite number, or not within the stored ones.
    """
    wanted = np.atleast_1d(np.asarray(times if np.isscalar(times) else list(times), np.float64))  # type: ignore[arg-type]
    if wanted.size == 0 or not np.isfinite(wanted).all():
        raise ValueError(f"times of a strip are {wanted.tolist()}; give one or more, in seconds")
    there = np.asarray(stored, np.float64)
    slack = 1e-6 * abs(float(there[-1])) + (float(np.diff(there).max()) if len(there) > 1 else 0.0)
    outside = wanted[(wanted > there[-1] + slack) | (wanted < there[0] - slack)]
    if outside.size:
        raise ValueError(
            f"times of a strip are {wanted.tolist()} s; {outside[0]:g} s is not among the stored times, from "
            f"{there[0]:g} to {there[-1]:g} s"
        )
    return sorted({int(np.argmin(np.abs(np.asarray(stored) - time))) for time in wanted})


def label(time: float, stored: ArrayLike) -> str:
    """The label of a picture: its time with as many digits as distinguish the stored times.

    Args:
        time: [s].
        stored: (K,) stored times [s].
    """
    step = np.diff(np.unique(stored))
    digits = 3
    if len(step):  # 0.25 needs two digits
        digits = next((n for n in (1, 2) if abs(round(step.min(), n) - step.min()) < 1e-9), 3)
    return f"t = {time:.{digits}f} s"


def _tank_layout(room: int, lower: ArrayLike, upper: ArrayLike) -> Layout:
    """The tank without a panel, as large as the width ``room`` [px] allows."""
    extent = np.asarray(upper) - np.asarray(lower)
    unit = max(room / 400, 1.0)
    scale = (room - 2 * _SIDE * unit) / extent[0]
    tank = extent * scale
    height = 2 * ceil((tank[1] + (_HEAD + _FOOT) * unit) / 2)
    smallest = f"{room}x{height} pixels a tank"
    if room < SMALLEST[0] or height < SMALLEST[1]:
        raise ValueError(f"strip: {smallest} are too few; choose a larger width or fewer columns")
    if height > LARGEST:
        raise ValueError(f"strip: {smallest} are too many; choose a smaller width or more columns")
    left, bottom = round((room - tank[0]) / 2), round(_HEAD * unit + tank[1])
    box = (left, bottom - tank[1], left + tank[0], bottom)
    return Layout((room, height), unit, np.asarray(lower), np.asarray(upper), float(scale), box, False, box)


def _legend(annotator: Annotator, names: Sequence[str], fills: Array, top: float) -> None:
    """Draw the fluids' colours and names centred below all tanks."""
    u, gap = annotator.unit, 40.0
    lengths = [34 * u + text_width(name, NORMAL * u) for name in names]
    x = (annotator.image.width - sum(lengths) - gap * u * (len(names) - 1)) / 2
    for name, fill, length in zip(names, fills, lengths, strict=True):
        annotator.swatch((x, top + 8 * u), name, fill, length + 1)
        x += length + gap * u
