"""Layers over the fluids: contours, streamlines, arrows, tails of tracers; and the frame of a window."""

from collections.abc import Sequence

import numpy as np

from . import colours, flow
from .arrays import Array
from .drawing import Drawing
from .layout import Layout
from .scales import LABELS, field_limits, round_ticks
from .scene import Scene
from .view import View

WALL_THICKNESS = 7.0  # in design pixels, like the widths below
LINE_WIDTH = 1.3
ARROWS_APART = 34.0
STREAMLINES_APART = 26.0
MOST_CONTOURS = 14
TRACER_RADIUS = 2.6


def draw_layers(drawing: Drawing, scene: Scene, cells: Array, layout: Layout, view: View, on_field: bool) -> list[str]:
    """Add the layers that a view asks for.

    Args:
        drawing: to which they are added.
        scene: what is drawn.
        cells: (C, 3) those of its cells that are seen.
        layout: of the picture.
        view: what is shown.
        on_field: whether the cells have the colours of a field, dark ones and light ones.

    Returns:
        A line of text on the scale of each layer.

    Raises:
        ValueError: a field that a layer needs is missing.
    """
    notes = []
    unit, lower, upper = layout.unit, layout.lower, layout.upper
    if view.contours is not None:
        low, high = field_limits([scene], view.contours)
        levels = round_ticks(low, high, MOST_CONTOURS)
        values = scene.field_values(view.contours)
        segments = flow.contour_segments(scene.position, cells, values, levels)
        _outlined(drawing, layout.pixels(segments), 1.0 * unit, unit)
        if len(levels) > 1:
            name, measure = LABELS.get(view.contours, (view.contours.replace("_", " "), ""))
            notes.append(f"{name} lines every {levels[1] - levels[0]:.3g} {measure}".rstrip())
    if view.streamlines:
        lines = flow.streamlines(scene, lower, upper, STREAMLINES_APART * unit / layout.scale)
        parts = [layout.pixels(np.stack([line[:-1], line[1:]], axis=1)) for line in lines]
        if parts:
            _outlined(drawing, np.concatenate(parts), LINE_WIDTH * unit, unit)
            middles = np.stack([part[len(part) // 2] for part in parts])
            tips, along = middles[:, 1], middles[:, 1] - middles[:, 0]
            _heads(drawing, tips, along, 11 * unit, colours.rgb(colours.HALO))
            _heads(drawing, tips, along, 8 * unit, colours.rgb(colours.INTERFACE))
    if view.arrows:
        shafts, fastest = flow.arrows(scene, lower, upper, ARROWS_APART * unit / layout.scale)
        ends = layout.pixels(shafts)
        along = ends[:, 1] - ends[:, 0]
        length = np.linalg.norm(along, axis=1)
        _arrows(drawing, ends, np.minimum(9 * unit, 0.6 * length), unit, on_field)
        notes.append(f"longest arrow {fastest:.3g} m/s")
    if scene.trails is not None and scene.trails.size:
        _tails(drawing, layout.pixels(scene.trails), unit)
    return notes


def mask_outside(drawing: Drawing, scene: Scene, layout: Layout) -> None:
    """Cover what lies outside the window, except for walls at the sides where the window ends with the domain.

    Args:
        drawing: to which the cover is added.
        scene: what is drawn.
        layout: of the picture.
    """
    assert scene.lower is not None, "a Scene fills in what was left out"
    assert scene.upper is not None, "a Scene fills in what was left out"
    (width, height), (left, top, right, bottom) = layout.size, layout.box
    thick, near = WALL_THICKNESS * layout.unit, 0.5 / layout.scale
    at_walls = [*(layout.lower <= scene.lower + near), *(layout.upper >= scene.upper - near)]
    walls = [thick if at else 0.0 for at in at_walls]  # left, bottom, right, top
    outer = (left - walls[0], top - walls[3], right + walls[2], bottom + walls[1])
    far = (-2.0, -2.0, width + 2.0, height + 2.0)
    for x0, y0, x1, y1 in (
        (far[0], far[1], outer[0], far[3]),
        (outer[2], far[1], far[2], far[3]),
        (far[0], far[1], far[2], outer[1]),
        (far[0], outer[3], far[2], far[3]),
    ):
        _rectangle(drawing, x0, y0, x1, y1, colours.BACKGROUND)
    corners = np.array([[left, bottom], [left, top], [right, top], [right, bottom]])
    sides = np.array([[0, 1], [3, 0], [2, 3], [1, 2]])[[not at for at in at_walls]]
    drawing.lines(corners[sides], 1.4 * layout.unit, colours.rgb(colours.SUBTLE), cap=0.7 * layout.unit)


def cover_ends(drawing: Drawing, scene: Scene, layout: Layout, background: Sequence[float]) -> None:
    """Cover what lies beyond the periodic sides of a scene, which end in a thin line.

    Args:
        drawing: to which the cover is added.
        scene: what is drawn.
        layout: of the picture.
        background: red, green and blue, 0 to 1.
    """
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


def _outlined(drawing: Drawing, segments: Array, width: float, unit: float) -> None:
    """Dark lines with a light rim, which are visible on every colour."""
    drawing.lines(segments, width + 1.2 * unit, colours.rgb(colours.HALO), cap=0.3 * unit)
    drawing.lines(segments, width, colours.rgb(colours.INTERFACE), cap=0.3 * unit)


def _heads(drawing: Drawing, tips: Array, along: Array, length: Array | float, colour: Array) -> None:
    """Triangles with their tips at points (P, 2), in directions (P, 2), of a length [px]."""
    forward = along / np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-12)
    forward = forward * np.broadcast_to(np.asarray(length), (len(tips),))[:, None]
    aside = 0.42 * np.stack([-forward[:, 1], forward[:, 0]], axis=1)
    corners = np.stack([tips, tips - forward - aside, tips - forward + aside], axis=1)
    drawing.triangles(corners, colour)


def _arrows(drawing: Drawing, shafts: Array, head: Array, unit: float, light: bool) -> None:
    """Arrows along shafts (P, 2, 2) with heads of a length (P,) [px]; light ones with a dark rim, or the reverse."""
    core, rim = colours.rgb(colours.INTERFACE), colours.rgb(colours.HALO)
    if light:
        core, rim = rim, core
    along = shafts[:, 1] - shafts[:, 0]
    forward = along / np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-12)
    # A shaft ends inside its head.
    short = np.stack([shafts[:, 0], shafts[:, 1] - 0.7 * head[:, None] * forward], axis=1)
    for colour, more in ((rim, 1.1 * unit), (core, 0.0)):
        drawing.lines(short, 1.7 * unit + 2 * more, colour, cap=more)
        _heads(drawing, shafts[:, 1] + 1.6 * more * forward, along, head + 3.4 * more, colour)


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
