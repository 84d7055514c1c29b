"""A figure of several stored times of a run, side by side in one picture."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from math import ceil
from os import PathLike
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from PIL import Image

from tipfem.results.fields.catalogue import field_of

from . import colours
from .animation import picture_name
from .annotation import NORMAL, Annotator, text_width
from .arrays import Array, Range
from .flow import Tracers
from .layers import WALL_THICKNESS, Key
from .layout import LARGEST, SMALLEST, Layout, point
from .renderer import Renderer, settled, swatches_of
from .results import Results
from .scales import check_range, digits_of, time_text
from .view import Look, View

WIDTH = 1600  # [px] of a whole strip
MOST_COLUMNS = 4  # by default
USUAL = 4  # times of a strip of which none is named
_HEAD, _FOOT, _SIDE = 40.0, 14.0, 14.0  # around a tank, for its time and the next tank [design pixels]
_LEGEND, _ROW, _GAP, _BAR = 18.0, 34.0, 40.0, 56.0  # below all tanks: the legend, each of its rows, between its entries
_BAR_WIDTH = 640.0
Entry = Key | tuple[str, tuple[float, ...]]  # of the legend: a line, or the name and the colour of a fluid


def strip(
    out: str | PathLike[str],
    times: Iterable[float] | float,
    path: str | PathLike[str] | None = None,
    *,
    columns: int | None = None,
    width: int | None = None,
    backend: str = "auto",
    fluid_colours: Mapping[str, str] | None = None,
    field: str | None = None,
    field_range: Range | None = None,
    mesh: bool = False,
    particles: bool = False,
    view: View | None = None,
    samples: int = 2,
    name: str | None = None,
    frame: str = "room",
    dark: bool = False,
    transparent: bool = False,
) -> Path:
    """Draw a results folder at several times, side by side in one PNG, with one legend and one scale for all.

    Args:
        out: results folder.
        times: one or several [s]; the closest stored times are drawn, each once, with their times above. None may be
            later than the last one by more than the time between two. Without any, four from the first to the last.
        path: of the picture; by default strip.png in the results folder, with the options that change what is seen in
            its name, see `tipfem.render.animation.picture_name`: strip_pressure_mesh.png.
        columns: tanks in a row; at most 4 by default, and fewer of flat tanks.
        width: of the whole picture [px]; by default 1600, of a single time 800.
        backend: "ggui", "raster" or "auto", see `Renderer`.
        fluid_colours: colours "#rrggbb" by the names of fluids.
        field: name of a field to colour by; None shows the fluids.
        field_range: (low, high) of the colours; None takes it from up to 24 stored times, as movies do.
        mesh: draw the edges of the cells.
        particles: draw the particles as dots.
        view: the part shown, the layers and the colour map; None for all of the scene without layers. Tracers are
            followed through all stored times.
        samples: of the rasteriser along a side of a pixel, 1 or 2, see `Renderer`.
        name: in place of the options in the name: strip_NAME.png.
        frame: "tank" draws a tank that moves as if it rested, see `Results`.
        dark: draw light text on a dark background.
        transparent: draw no background.

    Returns:
        The path of the picture.

    Raises:
        ValueError: an argument is invalid.
        ResultsError: the results folder cannot be read.
        OSError: the picture cannot be written.
    """
    view = View() if view is None else view
    results = Results(out, frame=frame, slice=view.slice)
    chosen = closest(results.times, times)
    if field is None and field_range is not None:
        raise ValueError("a field range is given, but no field to colour by")
    if columns is not None and columns < 1:
        raise ValueError(f"strip: columns is {columns}; it must be 1 or more")
    shown, view = view, view.for_files(field, mesh, particles)
    if path is None:
        tail = name or picture_name(field, field_range, mesh, particles, shown, None, fluid_colours or {}, frame)
        tail = "_".join([tail] * bool(tail) + (["dark"] * dark + ["transparent"] * transparent) * (not name))
        path = results.folder / f"strip{'_' if tail else ''}{tail}.png"
    width = width or (WIDTH if len(chosen) > 1 else WIDTH // 2)
    if view.tracers:
        tracers = Tracers(results.scene(0), view.tracers)
        moving = (replace(scene, trails=tracers.advance(scene)) for scene in map(results.scene, range(chosen[-1] + 1)))
        scenes = [scene for k, scene in enumerate(moving) if k in chosen]
    else:
        scenes = [results.scene(k) for k in chosen]
    for wanted in (field, view.contours):
        if wanted is not None:
            scenes[0].field_values(wanted)
    if field_range is not None:
        field_range = check_range(field_range)
    view, field_range = settled(view, results.sampled(), field, field_range)
    columns = min(columns or usual_columns(len(chosen), width, *view.bounds(scenes[0])), len(chosen))
    # Even numbers of pixels, as the back ends need them.
    room = 2 * int(width // columns // 2)
    layout = _tank_layout(room, width, *view.bounds(scenes[0]))
    unit = layout.unit
    rows = ceil(len(chosen) / columns)
    height = layout.size[1]
    fills = colours.fluid_colours(results.fluid_names, results.fluid_densities, fluid_colours)

    def drawn(scheme: colours.Scheme) -> Array:
        ground = np.rint(255 * np.array(scheme.background)).astype(np.uint8)
        sheet = np.tile(ground, (rows * height, columns * room, 1))
        keys: list[Key] = []
        where = layout
        for number, scene in enumerate(scenes):
            lower, upper = view.bounds(scene)  # a window may follow the flow
            where = replace(where, lower=point(lower), upper=point(upper))
            image, lines = renderer.tank(scene, where, Look(field, field_range, mesh, particles, view), scheme)
            keys += [key for key in lines if key not in keys]
            annotator = Annotator(image, where, scheme=scheme)
            left, top, right, _ = where.box
            at = ((left + right) / 2, top - (WALL_THICKNESS + 6) * unit)
            annotator.text(at, label(scene.time, results.times), NORMAL, anchor="ms")
            row, column = divmod(number, columns)
            sheet[row * height : (row + 1) * height, column * room : (column + 1) * room] = np.asarray(annotator.image)
        entries: list[Entry] = [*swatches_of(scenes[0], field, view, fills, scheme), *keys]
        legend = _legend_rows(entries, unit, columns * room)
        below = _LEGEND + _ROW * len(legend)
        foot = np.tile(ground, (round((below + (_BAR if field is not None else 0)) * unit), columns * room, 1))
        whole = Annotator(np.concatenate([sheet, foot]), where, view.colour_map, scheme)
        _legend(whole, legend, rows * height)
        if field is not None and field_range is not None:
            _bar(whole, field, field_range, rows * height + below * unit)
        return np.asarray(whole.image)

    scheme = colours.DARK if dark else colours.LIGHT
    with Renderer(layout.size, backend, fluid_colours, samples) as renderer:
        picture = colours.on_transparent(drawn, scheme) if transparent else drawn(scheme)
    target = Path(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(picture).save(target, format="png", compress_level=6)
    return target


def closest(stored: ArrayLike, times: Iterable[float] | float) -> list[int]:
    """Numbers of the stored times (K,) [s] closest to given ones, in order, each once; without any, of four.

    Raises:
        ValueError: a time is not a finite number, or not within the stored ones.
    """
    if not np.isscalar(times) and not len(times := list(times)):  # type: ignore[arg-type]
        return sorted({int(k) for k in np.linspace(0, len(np.asarray(stored)) - 1, USUAL).round()})
    wanted = np.atleast_1d(np.asarray(times, np.float64))
    if not np.isfinite(wanted).all():
        raise ValueError(f"times of a strip are {wanted.tolist()}; give finite ones, in seconds")
    there = np.asarray(stored, np.float64)
    slack = 1e-6 * abs(float(there[-1])) + (float(np.diff(there).max()) if len(there) > 1 else 0.0)
    outside = wanted[(wanted > there[-1] + slack) | (wanted < there[0] - slack)]
    if outside.size:
        raise ValueError(
            f"times of a strip are {wanted.tolist()} s; {outside[0]:g} s is not among the stored times, from "
            f"{there[0]:g} to {there[-1]:g} s"
        )
    return sorted({int(np.argmin(np.abs(np.asarray(stored) - time))) for time in wanted})


def moved(stored: ArrayLike, times: Iterable[float]) -> list[str]:
    """Lines that say which stored times (K,) [s] stand for times that are not stored, see `closest`."""
    there = np.asarray(stored, np.float64)
    near = 0.01 * float(np.diff(there).min()) if len(there) > 1 else 0.0
    pairs = [(time, float(there[closest(stored, time)[0]])) for time in times]
    return [f"{time:g} s is not stored; {found:.6g} s is drawn" for time, found in pairs if abs(time - found) > near]


def label(time: float, stored: ArrayLike) -> str:
    """The label of a picture: its time [s] with as many digits as distinguish the stored times (K,)."""
    return time_text(time, digits_of(stored), float(np.ptp(stored)))


def usual_columns(count: int, width: int, lower: ArrayLike, upper: ArrayLike) -> int:
    """Tanks in a row of a strip: as many as stand in even rows of up to 4 and are tall enough to be seen."""
    columns = 1
    for most in range(min(MOST_COLUMNS, count), 0, -1):
        columns = ceil(count / ceil(count / most))
        room = 2 * int(width // columns // 2)
        if room >= SMALLEST[0] and _tank_height(room, width, lower, upper) >= SMALLEST[1]:
            break
    return columns


def _unit(room: int, width: int) -> float:
    """A design pixel [px], in tanks of the width ``room`` in a strip of a ``width`` [px]."""
    return max(min(room / 400, width / 800), 1.0)


def _tank_height(room: int, width: int, lower: ArrayLike, upper: ArrayLike) -> int:
    """Height of a tank with its time above in the width ``room`` of a strip of a ``width`` [px]."""
    extent, unit = np.asarray(upper) - np.asarray(lower), _unit(room, width)
    return 2 * ceil(float((room - 2 * _SIDE * unit) * extent[1] / extent[0] + (_HEAD + _FOOT) * unit) / 2)


def _tank_layout(room: int, width: int, lower: ArrayLike, upper: ArrayLike) -> Layout:
    """The tank without a panel, as large as the width ``room`` of a strip of a ``width`` [px] allows."""
    extent = np.asarray(upper) - np.asarray(lower)
    unit = _unit(room, width)
    scale = (room - 2 * _SIDE * unit) / extent[0]
    tank = extent * scale
    height = max(_tank_height(room, width, lower, upper), SMALLEST[1])  # the flattest have room below them
    smallest = f"{room}x{height} pixels a tank"
    if room < SMALLEST[0]:
        raise ValueError(f"strip: {smallest} are too few; choose a larger width or fewer columns")
    if height > LARGEST:
        raise ValueError(f"strip: {smallest} are too many; choose a smaller width or more columns")
    left, bottom = round((room - tank[0]) / 2), round(_HEAD * unit + tank[1])
    box = (left, bottom - tank[1], left + tank[0], bottom)
    return Layout((room, height), unit, point(lower), point(upper), float(scale), box, False, box)


def _legend_rows(entries: Sequence[Entry], unit: float, room: float) -> list[list[tuple[Entry, float]]]:
    """The entries of a legend with their lengths [px], in rows that fit into ``room`` [px]."""
    rows, x = list[list[tuple[Entry, float]]](), 0.0
    for entry in entries:
        text, line = (entry.text, 48) if isinstance(entry, Key) else (entry[0], 34)
        length = line * unit + text_width(text, NORMAL * unit)
        x += _GAP * unit + length
        if not rows or x > room - 2 * _SIDE * unit:
            rows.append([])
            x = length
        rows[-1].append((entry, length))
    return rows


def _legend(annotator: Annotator, rows: Sequence[Sequence[tuple[Entry, float]]], top: float) -> None:
    """Draw the fluids' colours and names, and what lines stand for, each row centred below all tanks."""
    gap = _GAP * annotator.unit
    for number, row in enumerate(rows):
        x = (annotator.image.width - sum(length for _, length in row) - gap * (len(row) - 1)) / 2
        at = top + (8 + _ROW * number) * annotator.unit
        for entry, length in row:
            if isinstance(entry, Key):
                annotator.key((x, at), entry, length + 1)
            else:
                annotator.swatch((x, at), *entry, length + 1)
            x += length + gap


def _bar(annotator: Annotator, field: str, field_range: Range, top: float) -> None:
    """Draw the colour bar of a field below all tanks."""
    u, width = annotator.unit, annotator.image.width
    name = field_of(field).title
    left, right = width / 2 - _BAR_WIDTH / 2 * u, width / 2 + _BAR_WIDTH / 2 * u
    left, right = max(left, 40 * u + text_width(name, NORMAL * u)), min(right, width - 30 * u)
    annotator.text((left - 22 * u, top + 10 * u), name, NORMAL, anchor="rm")
    annotator.bar((left, top, right, top + 20 * u), field, field_range)
