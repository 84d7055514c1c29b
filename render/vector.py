"""Stored times of a run as vectors for papers, SVG and PDF, by matplotlib."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from math import ceil
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from tipfem.results.fields.catalogue import field_of

from . import bodies, colours
from .animation import picture_name
from .arrays import Array, Range
from .layers import is_muted
from .openings import COLOURS as opening_colours
from .openings import Gap, kinds_of
from .outlines import SMOOTHED, SPRAY_RADIUS, Loop, background_fluid, fluid_loops, smoothed, wall_loops
from .renderer import settled, swatches_of
from .results import Results
from .scales import MUTED_FIELD, MUTED_SHARE, check_range, colour_map_of, fitting, round_ticks, tick_labels
from .scene import Scene
from .strips import closest, label, usual_columns
from .view import Look, View

SUFFIXES = (".svg", ".pdf")
WIDTH = 6.7  # of the whole, as wide as the text of a page [inch]
_FIELD_DPI = 300  # of fields, which are pixels within the file
_WALL, _LINE = 2.2, 0.7  # widths of lines [pt]
_LETTER, _APART, _LEVEL = 0.065, 0.12, 0.3  # what a label of ticks needs: a letter, between two, and upwards [inch]


def draw_vectors(
    out: str | PathLike[str],
    times: Iterable[float] | None = None,
    suffixes: Iterable[str] = SUFFIXES,
    *,
    columns: int | None = None,
    field: str | None = None,
    field_range: Range | None = None,
    mesh: bool = False,
    particles: bool = False,
    fluid_colours: Mapping[str, str] | None = None,
    view: View | None = None,
    name: str | None = None,
    frame: str = "room",
    title: str | None = None,
    dark: bool = False,
    transparent: bool = False,
) -> list[Path]:
    """Draw a results folder at one or several times, side by side, as vectors.

    Args:
        out: results folder.
        times: of the panels [s], see `strip`; None takes the last one.
        suffixes: ".svg", ".pdf" or both.
        columns: panels in a row; at most 4 by default.
        field: name of a field to colour by; None shows the fluids. Fields are pixels within the file.
        field_range: (low, high) of the colours; None takes it from up to 24 stored times, as movies do.
        mesh: draw the edges of the cells.
        particles: not drawn as vectors.
        fluid_colours: colours "#rrggbb" by the names of fluids.
        view: the part shown, the outlines and the colour map.
        name: in place of the options in the name: strip_NAME.svg.
        frame: "tank" draws a tank that moves as if it rested, see `Results`.
        title: above all; None takes that of the case, "" none.
        dark: draw light text on a dark background.
        transparent: draw no background.

    Returns:
        The paths, strip.svg and strip.pdf in the results folder, or picture.svg and picture.pdf without times.

    Raises:
        ValueError: an argument is invalid, or matplotlib is not installed.
        ResultsError: the results folder cannot be read.
        OSError: a file cannot be written.
    """
    view = View() if view is None else view
    asked = {
        "particles": particles,
        "arrows": view.arrows,
        "streamlines": view.streamlines,
        "contours": view.contours is not None,
        "tracers": view.tracers > 0,
        "no-fill": not view.fill,
    }
    if beside := [word for word, there in asked.items() if there]:
        raise ValueError(f"SVG and PDF show fluids, a field and the mesh; leave out {beside[0]}, or draw PNG files")
    try:
        import matplotlib
    except ImportError:
        raise ValueError("SVG and PDF need matplotlib, which is not installed: pip install 'tipfem[plot]'") from None
    from matplotlib.figure import Figure

    results = Results(out, frame=frame, slice=view.slice)
    chosen = [len(results) - 1] if times is None else closest(results.times, times)
    scenes = [results.scene(k) for k in chosen]
    if field is not None:
        scenes[0].field_values(field)
        field_range = None if field_range is None else check_range(field_range)
    tail = name or picture_name(field, field_range, mesh, False, view, None, fluid_colours or {}, frame)
    view = replace(view.for_files(field, mesh, particles), look="flat")
    tail = "_".join([tail] * bool(tail) + (["dark"] * dark + ["transparent"] * transparent) * (not name))
    view, field_range = settled(view, results.sampled(), field, field_range)
    scheme = colours.DARK if dark else colours.LIGHT
    own = colours.fluid_colours(results.fluid_names, results.fluid_densities, fluid_colours)
    fills = colours.shades(own, scheme, view.look)[:, 0]
    columns = min(columns or usual_columns(len(chosen), 1600, *view.bounds(scenes[0])), len(chosen))
    rows = ceil(len(chosen) / columns)
    lower, upper = view.bounds(scenes[0])
    wide = (WIDTH - 0.5) / columns if len(chosen) > 1 else 4.2
    high = wide * float((upper - lower)[1] / (upper - lower)[0])
    style: Any = {"svg.fonttype": "none", "pdf.fonttype": 42, "font.size": 8, "axes.linewidth": 0.6}
    style |= dict.fromkeys(("text.color", "axes.labelcolor", "axes.titlecolor"), scheme.text)
    style |= dict.fromkeys(("xtick.color", "ytick.color", "axes.edgecolor"), scheme.subtle)
    style["figure.facecolor"] = style["axes.facecolor"] = colours.hex_code(scheme.background)
    with matplotlib.rc_context(style):
        title = results.title if title is None else title
        below = 0.65 + 0.5 * (field is not None) + 0.25 * bool(title)
        size = (wide * columns + 0.5, (high + 0.3) * rows + below)
        figure = Figure(size, layout="compressed")
        panels = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
        shades = None
        for number, axes in enumerate(panels.ravel()):
            if number >= len(chosen):
                axes.set_axis_off()
                continue
            look = Look(field, field_range, mesh, view=view)
            shades = _panel(axes, scenes[number], look, fills, scheme) or shades
            factor, unit = fitting(float(np.max(upper - lower)))
            axes.set_xticks(*_ticks(float(lower[0]), float(upper[0]), wide, factor))
            axes.set_yticks(*_ticks(float(lower[1]), float(upper[1]), high, factor, upwards=True))
            if len(chosen) > 1 or results.times[-1] > 0:
                axes.set_title(label(scenes[number].time, results.times), fontsize=8, pad=6)
            if number >= len(chosen) - columns:
                axes.set_xlabel(f"{scenes[0].axes[0]} [{unit}]")
                axes.tick_params(labelbottom=True)
            if number % columns == 0:
                axes.set_ylabel(f"{scenes[0].axes[1]} [{unit}]")
        if shades is not None and field is not None:
            beyond = "max" if field_range and field_range[0] == 0 else "both"  # no speed is below zero
            bar = figure.colorbar(shades, ax=panels, location="bottom", aspect=50, shrink=0.6, extend=beyond)
            bar.set_label(field_of(field).title.replace("^2", "²").replace("^3", "³"))
        handles = [_patch(fill, text) for text, fill in swatches_of(scenes[0], field, view, own, scheme)]
        if view.smooth:
            handles.append(_stroke(SMOOTHED, colours.INTERFACE))
        handles += [_stroke(kind, opening_colours[kind]) for kind in kinds_of(scenes[0].openings)]
        if title:
            figure.suptitle(title, fontsize=9)
        if handles:
            figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), frameon=False)
        written = []
        for suffix in suffixes:
            path = results.folder / f"{'picture' if times is None else 'strip'}{'_' if tail else ''}{tail}{suffix}"
            undated: dict[str, Any] = {"Date": None} if suffix == ".svg" else {"CreationDate": None}
            figure.savefig(path, dpi=_FIELD_DPI, metadata=undated, transparent=transparent)
            written.append(path)
    return written


def _panel(axes: Any, scene: Scene, look: Look, fills: Array, scheme: colours.Scheme) -> Any:
    """Draw a scene into matplotlib's axes; returns what a colour bar is made of, None without a field."""
    field, field_range, mesh, _, view = look
    lower, upper = view.bounds(scene)
    margin = 0.02 * float((upper - lower).max()) * (view.window is None)
    axes.set(xlim=(lower[0] - margin, upper[0] + margin), ylim=(lower[1] - margin, upper[1] + margin), aspect="equal")
    axes.spines[:].set_visible(False)
    regions, shades = scene.geometry.regions, None
    walls = wall_loops(scene)
    ground = colours.hex_code(scheme.background)
    _fill(axes, walls, "none", scheme.wall, 2 * _WALL)
    for gap in scene.openings:
        _fill(axes, [Loop(gap.ends, np.ones(2, bool))], "none", ground, 2 * _WALL + 0.5)
    _fill(axes, walls, ground, "none", 0)
    dark = scheme.line if len(scene.fluid_names) > 1 else "none"
    if field is not None:
        ends = field_range or (0.0, 1.0)
        from matplotlib.colors import LinearSegmentedColormap, ListedColormap

        table = colours.colour_table(view.colour_map or colour_map_of(field))
        options = {"cmap": LinearSegmentedColormap.from_list(field, table), "vmin": ends[0], "vmax": ends[1]}
        x, y = scene.position.T
        plain = np.zeros(len(scene.cells), dtype=bool)
        if field == MUTED_FIELD and view.muted and scene.cell_fluid is not None:
            plain = is_muted(scene, view, MUTED_SHARE * (ends[1] - ends[0]))
            for fluid in np.unique(scene.cell_fluid[plain]):
                cells = scene.cells[plain & (scene.cell_fluid == fluid)]
                axes.tripcolor(x, y, cells, np.zeros(len(x)), cmap=ListedColormap([fills[fluid]])).set_rasterized(True)
        cells = scene.cells[~plain]
        if field in scene.cell_fields:
            shades = axes.tripcolor(x, y, cells, facecolors=scene.cell_values(field)[~plain, 0], **options)
        else:
            shades = axes.tripcolor(x, y, cells, scene.field_values(field), shading="gouraud", **options)
        shades.set_rasterized(True)
    elif view.smooth:
        background = background_fluid(scene)
        if background is not None:
            _fill(axes, walls, colours.hex_code(fills[background]), "none", 0)
        for fluid in range(len(scene.fluid_names)):
            if fluid != background:
                loops = [smoothed(loop) for loop in fluid_loops(scene, fluid)]
                _fill(axes, loops, colours.hex_code(fills[fluid]), dark, _LINE)
    else:
        for fluid in range(len(scene.fluid_names)):
            _fill(axes, fluid_loops(scene, fluid), colours.hex_code(fills[fluid]), "none", 0)
    if not view.smooth and len(regions.segments):
        for colour, width in [(colours.HALO, 3 * _LINE)] * (field is not None) + [(colours.INTERFACE, _LINE)]:
            _lines(axes, regions.segments, colour, width)
    if mesh:
        _lines(axes, scene.position[scene.geometry.edges.pairs], colours.SUBTLE, 0.2)
    spray = scene.geometry.loose[0]
    if spray.any() and scene.spacing is not None:
        from matplotlib.patches import Circle

        for place, fluid in zip(scene.position[spray], scene.fluid[spray], strict=True):
            axes.add_patch(Circle(place, SPRAY_RADIUS * scene.spacing, color=colours.hex_code(fills[fluid]), lw=0))
    for gap in scene.openings:
        _opening(axes, gap, float(np.linalg.norm(upper - lower)))
    for body in scene.bodies:
        _fill(axes, [Loop(body.corners, np.ones(len(body.corners), bool))], scheme.body, bodies.MARK, _LINE)
        if body.mark is None:
            continue
        _lines(axes, body.mark[None], bodies.MARK, 1.5 * _LINE)
        axes.plot(*body.mark[0], "o", color=bodies.MARK, ms=4 * _LINE, mew=0)
    return shades


def _ticks(low: float, high: float, length: float, factor: float, upwards: bool = False) -> tuple[Array, list[str]]:
    """Places along an axis [m] that are round in a unit, ``factor`` per metre, and labels with room [inch]."""
    for most in range(8, 1, -1):
        ticks = round_ticks(factor * low, factor * high, most)
        labels = tick_labels(ticks)
        each = _LEVEL if upwards else _LETTER * max(map(len, labels), default=0) + _APART
        if len(ticks) * each <= length:
            break
    return ticks / factor, labels


def _fill(axes: Any, loops: list[Loop], fill: str, line: str, width: float) -> None:
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path as Curve

    if not loops:
        return
    places = np.concatenate([np.vstack([points, points[:1]]) for points, _ in loops])
    codes = np.concatenate([[Curve.MOVETO, *[Curve.LINETO] * (len(p) - 1), Curve.CLOSEPOLY] for p, _ in loops])
    axes.add_patch(PathPatch(Curve(places, codes), fc=fill, ec=line, lw=width, joinstyle="round"))


def _lines(axes: Any, segments: Array, colour: str, width: float) -> None:
    from matplotlib.collections import LineCollection

    axes.add_collection(LineCollection(list(segments), colors=colour, linewidths=width, capstyle="round"))


def _opening(axes: Any, gap: Gap, size: float) -> None:
    """The arrows of an opening, into the tank or out of it; ``size`` is that of the picture [m]."""
    from matplotlib.patheffects import withStroke

    colour, apart, reach = opening_colours[gap.kind], 0.06 * size, 0.05 * size
    count = max(1, round(float(np.linalg.norm(gap.ends[1] - gap.ends[0])) / apart))
    for part in (np.arange(count) + 0.5) / count:
        at = gap.ends[0] + part * (gap.ends[1] - gap.ends[0])
        along = (1 if gap.enters else -1) * 0.5 * reach * gap.inwards
        tip, tail = at + along, at - along
        style = {"arrowstyle": "-|>", "color": colour, "lw": _LINE, "mutation_scale": 7, "shrinkA": 0, "shrinkB": 0}
        style["path_effects"] = [withStroke(linewidth=_LINE + 0.9, foreground=colours.HALO)]
        axes.annotate("", tip, tail, arrowprops=style, annotation_clip=False)


def _patch(fill: Sequence[float], text: str) -> Any:
    from matplotlib.patches import Patch

    return Patch(fc=colours.hex_code(fill), ec=colours.WALL, lw=0.6, label=text)


def _stroke(text: str, colour: str = colours.INTERFACE) -> Any:
    from matplotlib.lines import Line2D
    from matplotlib.patheffects import withStroke

    rim = [withStroke(linewidth=_LINE + 0.9, foreground=colours.HALO)]
    return Line2D([], [], color=colour, lw=1.5 * _LINE, label=text, path_effects=rim)
