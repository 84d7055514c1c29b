"""Layers over the fluids: contours, streamlines, arrows, tails of tracers; and the frame of a window."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tipfem.results.fields.catalogue import field_of

from . import colours, flow
from .arrays import Array
from .drawing import Drawing
from .layout import Layout
from .openings import COLOURS as OPENING_COLOURS
from .openings import Gap, kinds_of
from .outlines import SMOOTHED
from .scales import MUTED_FIELD, FieldSample
from .scene import Scene
from .streamlines import streamlines
from .view import View

INTERFACE = "interface"  # in the legend
WALL_THICKNESS = 7.0  # in design pixels, like the widths below
LINE_WIDTH = 1.3
CONTOUR_WIDTH = 1.5
HEADS_APART = 150.0  # along a streamline
ARROWS_APART = 34.0
STREAMLINES_APART = 26.0
MOST_LEVELS = 1000  # of contours with an interval that is far too small
HEAD_SLOPE = 0.4  # half the width of an arrowhead by its length
TRACER_RADIUS = 2.6
GAPS_APART, GAP_REACH, GAP_HEAD = 26.0, 13.0, 9.0  # arrows of openings: how far apart, into the tank, their heads


class Key(NamedTuple):
    """An entry of the legend: a line as it is drawn, and what it stands for."""

    text: str  # what the line stands for
    line: str  # "#rrggbb" of the line
    rim: str  # "#rrggbb" on both sides of it
    head: bool = False  # whether it is an arrow
    length: float | None = None  # of an arrow that is drawn to scale [design pixels]; None for other lines


class Layer(NamedTuple):
    """Lines over the fluids."""

    kind: str  # "contours", "streamlines", "arrows" or "tracers"
    # points (K, 2) of each line [m]: an array (P, K, 2) but for streamlines, which have any number of them
    paths: Array | Sequence[Array]
    key: Key  # its entry of the legend


def layers_of(
    scene: Scene, seen: Array | slice, lower: Array, upper: Array, pixel: float, view: View, on_field: str | None
) -> list[Layer]:
    """The layers that a view asks for between two corners (2,) [m], in the order in which they are drawn.

    ``seen`` are the numbers of cells that are seen, ``pixel`` is the size of a design pixel [m], and ``on_field`` the
    colour map of the cells, of dark colours and light ones; None where these are fluids.

    Raises:
        ValueError: a field that a layer needs is missing.
    """
    found, cells = [], scene.cells[seen]
    if view.contours is not None:
        interval = view.interval or FieldSample([scene], view.contours).interval()
        low, high = FieldSample([scene], view.contours).ends()
        levels = interval * np.arange(np.ceil(low / interval), np.floor(high / interval) + 1)
        values = scene.field_values(view.contours)
        if view.muted and view.contours == MUTED_FIELD and scene.cell_fluid is not None:
            # The light fluid is at about zero, and so is its interface: the contour of zero would be noise.
            cells, levels = cells[~is_muted(scene, view, interval)[seen]], levels[levels != 0]
        segments = flow.contour_segments(scene.position, cells, values, levels[:MOST_LEVELS])
        colour = colours.CONTOUR_ON_RED if on_field == "blue-red" else colours.CONTOUR
        key = Key(contour_text(view.contours, interval), colour, colours.HALO)
        found.append(Layer("contours", segments, key))
    if view.streamlines:
        line, rim = (colours.HALO, colours.RIM) if on_field else (colours.STREAMLINE, colours.HALO)
        lines = streamlines(scene, lower, upper, STREAMLINES_APART * pixel)
        found.append(Layer("streamlines", lines, Key("streamlines", line, rim, True)))
    if view.arrows:
        speed = view.arrow_speed or flow.arrow_speed([scene], view)
        shafts = flow.arrows(scene, lower, upper, ARROWS_APART * pixel, speed)
        line, rim = (colours.HALO, colours.INTERFACE) if on_field else (colours.INTERFACE, colours.HALO)
        key = Key(arrow_text(speed), line, rim, True, flow.ARROW_SHARE * ARROWS_APART)
        found.append(Layer("arrows", shafts, key))
    if scene.trails is not None and scene.trails.size:
        found.append(Layer("tracers", scene.trails, Key("paths of tracers", colours.TRACER, colours.HALO)))
    return found


def draw_layers(
    drawing: Drawing, scene: Scene, seen: Array | slice, layout: Layout, view: View, on_field: str | None
) -> list[Key]:
    """Add the layers that a view asks for, see `layers_of`; returns an entry of the legend for each."""
    unit, keys = layout.unit, []
    lower, upper = np.array([layout.lower, layout.upper])
    for kind, paths, key in layers_of(scene, seen, lower, upper, unit / layout.scale, view, on_field):
        keys.append(key)
        lines = [layout.pixels(path) for path in paths]
        if not lines:
            continue
        if kind == "contours":
            _rimmed(drawing, np.stack(lines), key, CONTOUR_WIDTH * unit, 0.5 * unit)
        elif kind == "streamlines":
            segments = np.concatenate([np.stack([path[:-1], path[1:]], axis=1) for path in lines])
            _rimmed(drawing, segments, key, LINE_WIDTH * unit, 0.7 * unit)
            tips, along = _heads_on(lines, HEADS_APART * unit)
            _heads(drawing, tips, along, 10 * unit, 0.7 * unit, colours.rgb(key.rim))
            _heads(drawing, tips, along, 10 * unit, 0.0, colours.rgb(key.line))
        elif kind == "arrows":
            shafts = np.stack(lines)
            length = np.linalg.norm(shafts[:, 1] - shafts[:, 0], axis=1)
            _arrows(drawing, shafts, np.minimum(9 * unit, 0.6 * length), unit, (key.line, key.rim))
        else:
            _tails(drawing, np.stack(lines), unit)
    return keys


def draw_openings(drawing: Drawing, openings: Sequence[Gap], layout: Layout, background: Sequence[float]) -> list[Key]:
    """Add gaps in the lines of walls, with arrows through openings; returns entries of the legend."""
    unit = layout.unit
    for gap in openings:
        one, other = layout.pixels(gap.ends)
        inwards = np.array([gap.inwards[0], -gap.inwards[1]])  # pixels count downwards
        out = -(WALL_THICKNESS + 1) * unit * inwards
        corners = np.stack([one, other, other + out, one + out])
        drawing.triangles(corners[[[0, 1, 2], [0, 2, 3]]], np.array(background))
        count = max(1, round(float(np.linalg.norm(other - one)) / (GAPS_APART * unit)))
        part = (np.arange(count) + 0.5)[:, None] / count
        at = one + part * (other - one)
        shafts = np.stack([at - WALL_THICKNESS * unit * inwards, at + GAP_REACH * unit * inwards], axis=1)
        if not gap.enters:
            shafts = shafts[:, ::-1]
        _arrows(drawing, shafts, np.full(count, GAP_HEAD * unit), unit, (OPENING_COLOURS[gap.kind], colours.HALO))
    return [Key(kind, OPENING_COLOURS[kind], colours.HALO, True) for kind in kinds_of(openings)]


def layer_texts(scene: Scene, view: View, field: str | None) -> list[str]:
    """The texts of the legend for a picture's lines, at their longest; the view has an interval and a speed."""
    texts = [INTERFACE] if len(scene.fluid_names) > 1 and (field is not None or not view.fill) else []
    texts += [SMOOTHED] * bool(view.smooth)
    if view.contours is not None and view.interval is not None:
        texts.append(contour_text(view.contours, view.interval))
    texts += ["streamlines"] * view.streamlines
    if view.arrows and view.arrow_speed is not None:
        texts.append(arrow_text(view.arrow_speed))
    texts += ["paths of tracers"] * (scene.trails is not None)
    return texts + kinds_of(scene.openings)


def is_muted(scene: Scene, view: View, tolerance: float) -> Array:
    """Mask (M,) of the cells that a view leaves uncoloured where the pressure is shown.

    They are those of its muted fluids, but for cells whose pressure is off the fluid's median by more than the
    tolerance [Pa], as in a bubble below the surface.
    """
    found = np.zeros(len(scene.cells), bool)
    if not view.muted or scene.cell_fluid is None:
        return found
    pressure = scene.field_values(MUTED_FIELD)
    for name in view.muted:
        own = np.flatnonzero(scene.cell_fluid == scene.fluid_names.index(name))
        if len(own):
            a, b, c = scene.cells[own].T
            near = np.abs(pressure - np.median(pressure[scene.cells[own]])) <= tolerance
            found[own] = near[a] | near[b] | near[c]
    return found


def contour_text(field: str, interval: float) -> str:
    """Legend of the contours of a field, such as "pressure, every 200 Pa"."""
    return f"{field_of(field).label}, every {interval:.3g} {field_of(field).unit}".rstrip()


def arrow_text(speed: float) -> str:
    """Legend of the arrow, such as "2 m/s"."""
    return f"{speed:.3g} m/s"


def mask_outside(drawing: Drawing, scene: Scene, layout: Layout, scheme: colours.Scheme) -> None:
    """Cover what lies outside the window, but walls at sides where the window ends with the domain."""
    (width, height), (left, top, right, bottom) = layout.size, layout.box
    thick, near = WALL_THICKNESS * layout.unit, 0.5 / layout.scale
    at_walls = [*np.less_equal(layout.lower, scene.lower + near), *np.greater_equal(layout.upper, scene.upper - near)]
    walls = [thick if at else 0.0 for at in at_walls]  # left, bottom, right, top
    outer = (left - walls[0], top - walls[3], right + walls[2], bottom + walls[1])
    far = (-2.0, -2.0, width + 2.0, height + 2.0)
    for x0, y0, x1, y1 in (
        (far[0], far[1], outer[0], far[3]),
        (outer[2], far[1], far[2], far[3]),
        (far[0], far[1], far[2], outer[1]),
        (far[0], outer[3], far[2], far[3]),
    ):
        _rectangle(drawing, x0, y0, x1, y1, scheme.background)
    corners = np.array([[left, bottom], [left, top], [right, top], [right, bottom]])
    sides = np.array([[0, 1], [3, 0], [2, 3], [1, 2]])[[not at for at in at_walls]]
    drawing.lines(corners[sides], 1.4 * layout.unit, colours.rgb(scheme.subtle), cap=0.7 * layout.unit)


def cover_ends(drawing: Drawing, scene: Scene, layout: Layout, background: Sequence[float]) -> None:
    """Cover what lies beyond the periodic sides of a scene, which end in a thin line."""
    assert scene.period is not None, "only periodic scenes have ends"
    (left, bottom), (right, top) = layout.pixels(np.stack([np.zeros(2), scene.period]))
    far = 2.0 + float(max(layout.size))
    x0, y0, x1, y1 = layout.box
    sides = []
    if scene.period[0] > 0:
        for end, beyond in ((left, -far), (right, far)):
            _rectangle(drawing, beyond, -far, end, far, background)
            sides.append([[end, y0], [end, y1]])
    if scene.period[1] > 0:
        for end, beyond in ((top, -far), (bottom, far)):
            _rectangle(drawing, -far, beyond, far, end, background)
            sides.append([[x0, end], [x1, end]])
    drawing.lines(np.array(sides), 1.4 * layout.unit, colours.rgb(colours.SUBTLE), cap=0.7 * layout.unit)


def _rectangle(drawing: Drawing, x0: float, y0: float, x1: float, y1: float, colour: Sequence[float]) -> None:
    """A rectangle between two corners [px]."""
    corners = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])
    drawing.triangles(corners[[[0, 1, 2], [0, 2, 3]]], np.array(colour))


def _rimmed(drawing: Drawing, segments: Array, key: Key, width: float, rim: float) -> None:
    """Lines with a rim, which are visible on every colour; widths [px]."""
    drawing.lines(segments, width + 2 * rim, colours.rgb(key.rim), cap=0.3 * width)
    drawing.lines(segments, width, colours.rgb(key.line), cap=0.3 * width)


def _heads_on(lines: Sequence[Array], apart: float) -> tuple[Array, Array]:
    """Tips (P, 2) of arrowheads on lines [px], one at least on each, and the directions (P, 2) there."""
    tips, along = [], []
    for path in lines:
        step = float(np.linalg.norm(path[1] - path[0])) or 1.0
        count = max(1, round((len(path) - 1) * step / apart))
        at = np.rint((np.arange(count) + 0.55) / count * (len(path) - 1)).astype(int)
        at = np.clip(at, 1, len(path) - 1)
        tips.append(path[at])
        along.append(path[at] - path[at - 1])
    return np.concatenate(tips), np.concatenate(along)


def _heads(drawing: Drawing, tips: Array, along: Array, length: Array | float, rim: float, colour: Array) -> None:
    """Barbed triangles with their tips at points (P, 2), in directions (P, 2), of a length and wider by a rim [px]."""
    unit = along / np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-12)
    forward = unit * np.broadcast_to(np.asarray(length), (len(tips),))[:, None]
    aside = HEAD_SLOPE * np.stack([-forward[:, 1], forward[:, 0]], axis=1)
    corners = [tips, tips - forward + aside, tips - 0.72 * forward, tips - forward - aside]
    if rim > 0:  # each corner moves along the bisector of its angle, so that all sides move by the rim
        across = np.stack([-unit[:, 1], unit[:, 0]], axis=1)
        corners[0] = corners[0] + rim / np.sin(np.arctan(HEAD_SLOPE)) * unit
        corners[1] = corners[1] + rim * (1.8 * across - 1.2 * unit)
        corners[2] = corners[2] - rim * unit
        corners[3] = corners[3] - rim * (1.8 * across + 1.2 * unit)
    tip, left, notch, right = corners
    halves = np.stack([np.stack([tip, left, notch], axis=1), np.stack([tip, notch, right], axis=1)], axis=1)
    drawing.triangles(halves.reshape(-1, 3, 2), colour)


def _arrows(drawing: Drawing, shafts: Array, head: Array, unit: float, shades: tuple[str, str]) -> None:
    """Arrows along shafts (P, 2, 2) with heads of a length (P,) [px], in a colour "#rrggbb", and that of their rim."""
    line, rim = shades
    along = shafts[:, 1] - shafts[:, 0]
    forward = along / np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-12)
    # A shaft ends inside its head.
    short = np.stack([shafts[:, 0], shafts[:, 1] - 0.7 * head[:, None] * forward], axis=1)
    for colour, more in ((colours.rgb(rim), 0.8 * unit), (colours.rgb(line), 0.0)):
        drawing.lines(short, 1.7 * unit + 2 * more, colour, cap=more)
        _heads(drawing, shafts[:, 1], along, head, more, colour)


def _tails(drawing: Drawing, paths: Array, unit: float) -> None:
    """Tails that become thinner and paler with age, and a dot at the place of each tracer."""
    dark, light = colours.rgb(colours.TRACER), colours.rgb(colours.HALO)
    steps = paths.shape[1] - 1
    for k in range(steps):
        age = 1 - (k + 1) / steps
        width = (2.4 - 1.6 * age) * unit
        drawing.lines(paths[:, k : k + 2], width, colours.mix(dark, light, 0.6 * age), cap=0.3 * width)
    drawing.dots(paths[:, -1], (TRACER_RADIUS + 0.9) * unit, light)
    drawing.dots(paths[:, -1], TRACER_RADIUS * unit, dark)
