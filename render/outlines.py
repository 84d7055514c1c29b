"""Outlines of fluids as closed loops, and smooth curves through them.

The outlines follow the edges of the mesh. Smoothed, they are drawn without the mesh's saw teeth: two passes of Taubin's
filter, which keeps the area, then corners cut by Chaikin's rule. It is a way of drawing, for which the loops must be
named as smoothed; nothing is measured on them.

G. Taubin, A signal processing approach to fair surface design, SIGGRAPH 1995. G. M. Chaikin, An algorithm for
high-speed curve generation, Computer Graphics and Image Processing 3, 1974.
"""

from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from scipy.spatial import ConvexHull

from .arrays import Array
from .drawing import Drawing
from .interface import outer_sides
from .layout import Layout
from .polygons import fill_loops
from .scene import Scene

SPRAY_RADIUS = 0.4  # of a particle in no cell, in spacings
PASSES = 2
SHRINK, GROW = 0.5, -0.53  # of Taubin's filter
CUTS = 3  # of all corners
ROWS = 4  # to a pixel, on which the ends of areas are put
THIN = 0.03  # of a tank: circumradius up to which what is solid may be filled
SMOOTHED = "smoothed outlines"  # in the legend


Shader: TypeAlias = Callable[[Array, Any], Array]


class Loop(NamedTuple):
    """A closed line."""

    points: Array  # (K, 2) in order [m]; the last is joined to the first
    fixed: Array  # (K,) mask of the points on walls, which stay where they are


def fluid_loops(scene: Scene, fluid: int) -> list[Loop]:
    """The outline of a fluid: loops with the fluid on the left."""
    if scene.cell_fluid is not None:
        starts, ends = outer_sides(scene.position, scene.cells[scene.cell_fluid == fluid])
        return [Loop(scene.position[loop], scene.wall[loop]) for loop in _chained(starts, ends)]
    regions, edges = scene.geometry.regions, scene.geometry.edges
    corners = regions.triangles[regions.fluid == fluid]
    if not len(corners):
        return []
    # Cut cells have corners at mid-points of edges, so corners are known by their places.
    origin, unit = scene.position.min(axis=0), 1e-6 * scene.spacing
    along = edges.pairs[(edges.shared_by == 1) & scene.wall[edges.pairs].all(axis=1)]
    held = np.concatenate([scene.position[scene.wall], scene.position[along].mean(axis=1)])
    keys = np.rint((np.concatenate([corners.reshape(-1, 2), held]) - origin) / unit).astype(np.int64)
    _, first, number = np.unique(keys[:, 0] * (1 << 31) + keys[:, 1], return_index=True, return_inverse=True)
    places = np.concatenate([corners.reshape(-1, 2), held])[first]
    fixed = np.zeros(len(places), bool)
    fixed[number[3 * len(corners) :]] = True
    cells = number[: 3 * len(corners)].reshape(-1, 3)
    u, v = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    cells = np.where((u[:, 0] * v[:, 1] < u[:, 1] * v[:, 0])[:, None], cells[:, ::-1], cells)
    starts, ends = cells.ravel(), np.roll(cells, -1, axis=1).ravel()
    count = len(places)
    outer = ~np.isin(starts * count + ends, ends * count + starts)
    return [Loop(places[own], fixed[own]) for own in _chained(starts[outer], ends[outer])]


def smoothed(loop: Loop) -> Loop:
    """A smooth line along a loop, with eight times as many points; loops of three points stay as they are."""
    points, fixed = loop
    if len(points) < 4:
        return loop
    for _ in range(PASSES):
        for share in (SHRINK, GROW):
            moved = points + share * ((np.roll(points, 1, axis=0) + np.roll(points, -1, axis=0)) / 2 - points)
            points = np.where(fixed[:, None], points, moved)
    for _ in range(CUTS):
        after, held = np.roll(points, -1, axis=0), np.roll(fixed, -1)
        near = np.where(fixed[:, None], points, 0.75 * points + 0.25 * after)
        far = np.where(held[:, None], after, 0.25 * points + 0.75 * after)
        points, fixed = np.stack([near, far], axis=1).reshape(-1, 2), np.stack([fixed, held], axis=1).ravel()
    return Loop(points, fixed)


def area_within(loops: list[Loop]) -> float:
    """Area within loops, holes taken off [m^2]."""
    total = 0.0
    for points, _ in loops:
        x, y = (points - points[0]).T
        total += 0.5 * float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))
    return total


def picture_loops(scene: Scene, background: int | None) -> list[list[Loop]]:
    """The loops of a picture, in layers from the lowest: the fluids, but the ``background``, the bodies, the walls."""
    fluids = [fluid for fluid in range(len(scene.fluid_names)) if fluid != background]
    layers = [fluid_loops(scene, fluid) + _drops(scene, fluid) for fluid in fluids]
    return [*layers, _whole([body.corners for body in scene.bodies]), wall_loops(scene)]


def turning_marks(scene: Scene) -> list[list[list[float]]]:
    """Ends of the lines that show how bodies turn [m]."""
    return [body.mark.tolist() for body in scene.bodies if body.mark is not None]


def background_fluid(scene: Scene) -> int | None:
    """The fluid that is drawn by filling the tank: the last of several that fill it together."""
    ends = scene.geometry.rim
    full = len(ends) > 0 and bool(scene.wall[ends].all()) and scene.period is None
    densities = np.asarray(scene.fluid_densities if scene.fluid_densities is not None else ())
    return int(densities.argmin()) if full and len(scene.fluid_names) > 1 and len(densities) else None


def draw_smoothed(drawing: Drawing, scene: Scene, layout: Layout, fill: Shader, width: float, colour: Array) -> None:
    """Add the fluids within their smoothed outlines, and these as lines [px] where several fluids are.

    ``fill`` gives the colours of triangles [px] of a fluid.
    """
    background, lines = background_fluid(scene), []
    if background is not None:
        known = scene.tank.inside if scene.tank is not None else scene.geometry.regions.triangles
        corners = layout.pixels(known)
        drawing.triangles(corners, fill(corners, background))
    for fluid in range(len(scene.fluid_names)):
        if fluid == background:
            continue
        smooth = [smoothed(loop) for loop in fluid_loops(scene, fluid)]
        curves = [layout.pixels(loop.points) for loop in smooth]
        # Trapezoids end at rows, so that there are not more of them than points or rows.
        corners = fill_loops([np.stack([curve[:, 0], np.rint(ROWS * curve[:, 1]) / ROWS], axis=1) for curve in curves])
        drawing.triangles(corners, fill(corners, fluid))
        for (_, fixed), curve in zip(smooth, curves, strict=True):
            free = ~(fixed & np.roll(fixed, -1))
            lines.append(np.stack([curve, np.roll(curve, -1, axis=0)], axis=1)[free])
    if len(scene.fluid_names) > 1 and lines:
        drawing.lines(np.concatenate(lines), width, colour, cap=0.2 * width)


def _drops(scene: Scene, fluid: int) -> list[Loop]:
    """The particles of a fluid in no cell as small squares, which smoothing makes round."""
    loose = scene.geometry.loose[0] & (scene.fluid == fluid)
    corners = SPRAY_RADIUS * scene.spacing * np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]])
    return [Loop(place + corners, np.zeros(4, bool)) for place in scene.position[loose]]


def thin_solids(scene: Scene) -> list[list[float]]:
    """Solid parts of a tank, and what may be too thin for two walls' lines, to be filled where it is.

    Of each triangle, or gap in the walls' hull, the radius of `tipfem.render.tank.Solids`, and its corners' x and y
    [m]; none of a tank that has moved.
    """
    tank = scene.tank
    if tank is None or tank.moved:
        return []
    most = THIN * float(np.ptp(tank.points, axis=0).max())
    triangles, radius, feet, reach = tank.solids
    found = [
        [r, *tank.points[corners].ravel()]
        for corners, r in [*zip(triangles, radius, strict=True), *zip(feet, reach, strict=True)]
        if r < most
    ]
    return [[float(f"{value:.5g}") for value in each] for each in found]


def wall_loops(scene: Scene) -> list[Loop]:
    """The outline of the tank and its holes; where no outline is known, the convex hull of the walls."""
    return _whole(_walls(scene))


def _walls(scene: Scene) -> list[Array]:
    """Corners of the outline of the tank and of its holes: where no outline is known, of the walls' convex hull."""
    if scene.tank is not None:
        return [scene.tank.points[loop] for loop in scene.tank.loops]
    walls = scene.position[scene.wall]
    if scene.period is not None or len(walls) < 3:
        (x0, y0), (x1, y1) = scene.lower, scene.upper
        return [np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])]
    return [walls[ConvexHull(walls - walls.mean(axis=0)).vertices]]


def _whole(loops: list[Array]) -> list[Loop]:
    """Loops that are not smoothed, without points between corners."""
    found = []
    for points in loops:
        before, after = points - np.roll(points, 1, axis=0), np.roll(points, -1, axis=0) - points
        bend = abs(before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0])
        kept = points[bend > 1e-9 * np.linalg.norm(before, axis=1) * np.linalg.norm(after, axis=1)]
        found.append(Loop(kept, np.ones(len(kept), bool)))
    return found


def _chained(starts: Array, ends: Array) -> list[Array]:
    """Edges from point to point as loops of points."""
    onwards: dict[int, list[int]] = {}
    for start, end in zip(starts.tolist(), ends.tolist(), strict=True):
        onwards.setdefault(start, []).append(end)
    loops = []
    while onwards:
        first = next(iter(onwards))
        loop: list[int] = []
        at = first
        while not loop or at != first:
            loop.append(at)
            following = onwards[at]
            at, last = following.pop(), not following
            if last:
                del onwards[loop[-1]]
        loops.append(np.array(loop))
    return loops
