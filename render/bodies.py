"""Rigid bodies in pictures: their outlines, filled, with a mark that shows how they turn."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tipfem.results.tables import Table

from . import colours
from .arrays import Array
from .drawing import Drawing
from .layout import Layout
from .polygons import fill_loops

MARK = "#3d4653"
OUTLINE_WIDTH, MARK_WIDTH = 2.2, 2.6  # in design pixels
# Columns of places and turns, by dimension: an angle, or a vector along the axis with the angle as its length.
POSES = {2: ("x", "y", "angle"), 3: ("x", "y", "z", "turn_x", "turn_y", "turn_z")}
MARK_LENGTH = 0.8  # of the distance from the middle to the outline


@dataclass(frozen=True)
class PlacedBody:
    """A body at one time."""

    corners: Array  # (K, 2) of its outline [m]
    inside: Array  # (T, 3, 2) triangles that fill it [m]
    # (2, 2) a line from its middle towards what was to the right of it at t = 0 [m]; None of what does not turn
    mark: Array | None


class BodyOutline:
    """A body by its ``corners`` (K, 2) and ``reference`` point (2,) at t = 0 [m], to be drawn wherever it is later."""

    def __init__(self, facts: Mapping[str, Any]) -> None:
        self.reference = np.asarray(facts["reference"], float)
        self._corners = np.asarray(facts["corners"], float)
        self._inside, self._mark = fill_loops([self._corners]), _mark(self._corners)

    def placed(self, x: float, y: float, angle: float) -> PlacedBody:
        """The body where its reference point is at (x, y) [m], turned by an angle [rad]."""
        turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
        parts = self._corners, self._inside, self._mark
        return PlacedBody(*((points - self.reference) @ turn + (x, y) for points in parts))


class Tracks:
    """Positions of bodies and the tank, by names and references (d,) at t = 0 [m], at any time, by history.csv."""

    def __init__(self, references: Mapping[str, Array], history: Path) -> None:
        self._history = history
        self._columns = POSES[max((len(place) for place in references.values()), default=2)]
        self._start = {name: np.pad(place, (0, len(self._columns) - len(place))) for name, place in references.items()}
        self._read: tuple[int, Array, dict[str, Array]] | None = None

    def at(self, time: float) -> list[tuple[float, ...]]:
        """Places [m] and turns [rad], see `POSES`, at a time [s], linear between the rows of the history."""
        if not self._start:
            return []
        times, poses = self._rows()
        found = []
        for name, start in self._start.items():
            rows = np.vstack([start[None], poses[name]]) if name in poses else start[None]
            at = np.append(0.0, times)[: len(rows)]
            found.append(tuple(float(np.interp(time, at, column)) for column in rows.T))
        return found

    def moves(self, name: str) -> bool:
        """Whether the history has places of a body, or of the tank."""
        return bool(self._start) and name in self._rows()[1]

    def _rows(self) -> tuple[Array, dict[str, Array]]:
        """Times (K,) [s] of the history, and places and turns (K, C) by name; read again when the file has changed."""
        stamp = self._history.stat().st_mtime_ns if self._history.is_file() else 0
        if self._read is None or self._read[0] != stamp:
            table, poses = Table.read(self._history), {}
            for name in self._start:
                if f"{name}_{self._columns[-1]}" in table:
                    poses[name] = np.stack([table[f"{name}_{column}"] for column in self._columns], axis=1)
            if len(self._columns) == 3:
                poses = {name: np.column_stack([pose[:, :2], np.unwrap(pose[:, 2])]) for name, pose in poses.items()}
            self._read = stamp, table["time"] if poses else np.zeros(0), poses
        return self._read[1], self._read[2]


def draw_bodies(drawing: Drawing, bodies: Sequence[PlacedBody], layout: Layout, scheme: colours.Scheme) -> None:
    """Add bodies to a drawing."""
    unit = layout.unit
    for body in bodies:
        corners = layout.pixels(body.corners)
        drawing.triangles(layout.pixels(body.inside), colours.rgb(scheme.body))
        outline = np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)
        drawing.lines(outline, OUTLINE_WIDTH * unit, colours.rgb(MARK), cap=0.5 * OUTLINE_WIDTH * unit)
        if body.mark is None:
            continue
        mark = layout.pixels(body.mark)
        drawing.lines(mark[None], MARK_WIDTH * unit, colours.rgb(MARK), cap=0.5 * MARK_WIDTH * unit)
        drawing.dots(mark[:1], 1.6 * MARK_WIDTH * unit, colours.rgb(MARK))


def _mark(corners: Array) -> Array:
    """(2, 2) a line to the right from the middle of a polygon's area, inside it."""
    after = np.roll(corners, -1, axis=0)
    origin = corners.mean(axis=0)
    a, b = corners - origin, after - origin
    cross = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    middle = origin + ((a + b) * cross[:, None]).sum(axis=0) / (3 * cross.sum())
    a, b = corners - middle, after - middle
    crossing = (a[:, 1] > 0) != (b[:, 1] > 0)
    reach = a[crossing, 0] - a[crossing, 1] * (b - a)[crossing, 0] / (b - a)[crossing, 1]
    ahead = reach[reach > 0]
    length = float(ahead.min()) if len(ahead) else float(np.abs(a).max())
    return np.array([middle, middle + (MARK_LENGTH * length, 0.0)])
