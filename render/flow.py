"""Velocities between the particles: arrows, contours, and tracers that move from time to time."""

from collections.abc import Iterable

import numpy as np
from numpy.typing import ArrayLike

from .arrays import Array
from .rasterizer import locate
from .scales import round_limits
from .scene import Scene
from .view import View

SHORTEST_ARROW = 0.08  # of the length of the arrow in the legend
ARROW_SHARE = 0.9  # of the distance between arrows: the length of the one in the legend
_MOST_GRID = 400  # points along a side of the grid that stands for the velocity


def grid_values(scene: Scene, values: Array, lower: Array, step: float, shape: tuple[int, int]) -> Array:
    """Values (rows, columns, K) of those (N, K) at particles on a grid, linear within the cells; NaN outside.

    The first point is half a ``step`` [m] beyond the corner ``lower`` (2,) [m].
    """
    found = np.full((*shape, values.shape[1]), np.nan)
    corners = (scene.position[scene.cells] - lower) / step
    owner = locate(corners.astype(np.float32), shape)
    rows, columns = np.nonzero(owner >= 0)
    cell = owner[rows, columns]
    a, b, c = np.moveaxis(corners[cell], 1, 0)
    at = np.stack([columns + 0.5, rows + 0.5], axis=1) - a
    b, c = b - a, c - a
    area = b[:, 0] * c[:, 1] - b[:, 1] * c[:, 0]
    area = np.where(area == 0, 1.0, area)
    v = np.clip((at[:, 0] * c[:, 1] - at[:, 1] * c[:, 0]) / area, 0, 1)
    w = np.clip((b[:, 0] * at[:, 1] - b[:, 1] * at[:, 0]) / area, 0, 1 - v)
    weights = np.stack([1 - v - w, v, w], axis=1)
    found[rows, columns] = np.einsum("pc,pck->pk", weights, values[scene.cells[cell]])
    return found


def velocity(scene: Scene) -> Array:
    """Velocity (N, 2) [m/s] at the particles, along the axes of the scene's plane; `ValueError` without it."""
    return np.stack([scene.field_values(f"velocity_{axis}") for axis in scene.plane or "xy"], axis=1)


class VelocityGrid:
    """The velocity of a scene on a regular grid, for values at any points between two corners (2,) [m].

    Points are a ``step`` apart [m], or more where the grid would have too many of them.
    """

    def __init__(self, scene: Scene, lower: Array, upper: Array, step: float) -> None:
        extent = upper - lower
        self.step = max(step, float(extent.max()) / _MOST_GRID)
        self.lower = lower
        columns, rows = (max(2, int(np.ceil(length / self.step))) for length in extent)
        values = grid_values(scene, velocity(scene), lower, self.step, (rows, columns))
        self.inside = np.isfinite(values[..., 0])
        self.values = np.nan_to_num(values)

    def __call__(self, points: Array) -> tuple[Array, Array]:
        """Velocity (P, 2) [m/s] at points (P, 2) [m], and whether they are in cells, (P,) bool."""
        rows, columns = self.inside.shape
        x, y = ((points - self.lower) / self.step - 0.5).T
        x, y = np.clip(x, 0, columns - 1.001), np.clip(y, 0, rows - 1.001)
        i, j = x.astype(int), y.astype(int)
        s, t = (x - i)[:, None], (y - j)[:, None]
        grid = self.values
        found = (1 - t) * ((1 - s) * grid[j, i] + s * grid[j, i + 1])
        found += t * ((1 - s) * grid[j + 1, i] + s * grid[j + 1, i + 1])
        beyond = (points < self.lower) | (points > self.lower + self.step * np.array([columns, rows]))
        return found, self.inside[np.rint(y).astype(int), np.rint(x).astype(int)] & ~beyond.any(axis=1)


def arrow_speed(scenes: Iterable[Scene], view: View) -> float:
    """A round speed [m/s] for the arrow in the legend, so that arrows have one scale in all pictures of the scenes.

    Of all particles that are shown in all scenes together, at most 1 % are faster.
    """
    speeds = []
    for scene in scenes:
        lower, upper = view.bounds(scene)
        seen = ((scene.position >= lower) & (scene.position <= upper)).all(axis=1)
        speeds.append(np.linalg.norm(velocity(scene)[seen], axis=1))
    found = np.concatenate(speeds)
    return round_limits("speed", 0.0, float(np.percentile(found, 99)) if len(found) else 0.0)[1]


def arrows(scene: Scene, lower: Array, upper: Array, step: float, speed: float) -> Array:
    """Arrows on a regular grid, tails and tips (P, 2, 2) [m], a ``step`` apart between two corners (2,) [m].

    An arrow of ``speed`` [m/s], the legend's, is as long as `ARROW_SHARE` of the step. Those too short to show a
    direction, below `SHORTEST_ARROW` of that, are left out. Those longer than twice that length are drawn at twice of
    it: single fast particles do not cross the picture.
    """
    columns, rows = (max(1, int(length / step)) for length in upper - lower)
    first = lower + (upper - lower - step * np.array([columns, rows])) / 2
    values = grid_values(scene, velocity(scene), first, step, (rows, columns))
    j, i = np.nonzero(np.isfinite(values[..., 0]))
    values, centres = values[j, i], first + step * (np.stack([i, j], axis=1) + 0.5)
    size = np.linalg.norm(values, axis=1)
    moving = size > SHORTEST_ARROW * speed
    values *= np.minimum(1.0, 2 * speed / np.maximum(size, 1e-300))[:, None]
    half = ARROW_SHARE / 2 * step * values[moving] / speed
    return np.stack([centres[moving] - half, centres[moving] + half], axis=1)


def contour_segments(position: Array, cells: Array, values: Array, levels: ArrayLike) -> Array:
    """Segments (S, 2, 2) [m] along which linear values (N,) in the cells equal one of the levels (L,)."""
    found = [np.empty((0, 2, 2))]
    corners, points = values[cells], position[cells]
    for level in np.asarray(levels, np.float64):
        above = corners >= level
        crossed = above.any(axis=1) & ~above.all(axis=1)
        cell, flags = np.flatnonzero(crossed), above[crossed]
        # The corner that is alone on its side; the line crosses the two edges that meet there.
        single = np.where(flags[:, 0] == flags[:, 1], 2, np.where(flags[:, 0] == flags[:, 2], 1, 0))
        ends = []
        for other in ((single + 1) % 3, (single + 2) % 3):
            low, high = corners[cell, single], corners[cell, other]
            share = ((level - low) / (high - low))[:, None]
            ends.append((1 - share) * points[cell, single] + share * points[cell, other])
        found.append(np.stack(ends, axis=1))
    return np.concatenate(found)


def _beyond(points: Array, period: Array | None) -> Array | float:
    """Offset of points (P, 2) from their images inside the domain, in whole periods (P, 2) [m]."""
    if period is None:
        return 0.0
    return period * np.floor(np.divide(points, period, out=np.zeros_like(points), where=period > 0))


class Tracers:
    """Points that move with the fluids through the stored times, and the paths behind them.

    Between two times a tracer moves by Heun's rule with the velocities of both. A tracer that leaves the cells stays
    where it left them; one that leaves through a periodic side enters on the other, its path with it. About ``count``
    begin on a regular grid in the cells of the first scene; tails reach back ``kept`` times.
    """

    def __init__(self, scene: Scene, count: int, kept: int = 12) -> None:
        extent = scene.upper - scene.lower
        step = float(np.sqrt(np.prod(extent) / count))
        columns, rows = (max(1, round(length / step)) for length in extent)
        i, j = np.meshgrid(np.arange(columns) + 0.5, np.arange(rows) + 0.5)
        points = scene.lower + np.stack([i.ravel(), j.ravel()], axis=1) * extent / [columns, rows]
        self._field, self._time, self._kept = self._sampled(scene), scene.time, kept
        _, inside = self._field(points)
        self._paths = [points[inside]]

    def advance(self, scene: Scene) -> Array:
        """Move to the time of a scene, the next or the same; paths (P, K, 2) [m], the oldest point first."""
        if scene.time != self._time:
            field, step, at = self._sampled(scene), scene.time - self._time, self._paths[-1]
            before, inside = self._field(at)
            after, still = field(at + step * before - _beyond(at + step * before, scene.period))
            moved = np.where((inside & still)[:, None], at + step / 2 * (before + after), at)
            beyond = _beyond(moved, scene.period)
            self._paths = [path - beyond for path in [*self._paths[1 - self._kept :], moved]]
            self._field, self._time = field, scene.time
        return np.stack(self._paths, axis=1)

    @staticmethod
    def _sampled(scene: Scene) -> VelocityGrid:
        return VelocityGrid(scene, scene.lower, scene.upper, scene.spacing / 2)
