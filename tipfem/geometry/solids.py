"""Convex solids in 3-D, for tanks with sloping walls: the hull of corners, a prism, or a convex surface of a file."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import meshio
import numpy as np
from scipy.spatial import ConvexHull, QhullError

from tipfem.arguments import is_number, numbers, rounded
from tipfem.geometry.box_sides import SIDES
from tipfem.geometry.polyhedron import Polyhedron
from tipfem.typing import Array

MOST = 13  # planes of a tank: labels of cells have as many bits for them
BEND = 8.0  # least angle between two planes [degrees]
ON = 1e-9  # distance of a point on a plane, relative to the size
FLAT = 1e-6  # volume of a solid that is none, relative to its size, and area between a surface and its hull


class Solid(Polyhedron):
    """The region within the planes around corners.

    Args:
        corners: (K, 3), in any order, those inside the hull of the others are left out [m].

    Attributes:
        corners: (K, 3) of the hull [m].
        names: (S,) of its planes: those across an axis are sides of a box; others "slope", or "slope1" to the last, in
            the order of the x, then y, then z, of their middles.
        box: (2, 3) lower and upper corner of the box around it [m].

    The others are those of `Polyhedron`.

    Raises:
        ValueError: there are fewer than four corners, they are in one plane, there are more than 13 planes, or two of
            them bend by less than 8 degrees.
    """

    def __init__(self, corners: Any) -> None:
        points = numbers(corners)
        if points.ndim != 2 or points.shape[1] != 3 or len(points) < 4 or not np.isfinite(points).all():
            raise ValueError("solid: it needs four corners (x, y, z) or more, in m")
        self.box = np.stack([points.min(axis=0), points.max(axis=0)])
        size = float(np.ptp(self.box, axis=0).max())
        try:
            super().__init__(points, ON * size)
        except QhullError:
            self.whole = 0.0
        if self.whole <= FLAT * size**3:
            raise ValueError("solid: all its corners are in one plane")
        if len(self) > MOST:
            raise ValueError(f"solid: it has {len(self)} planes; a tank in 3-D has {MOST} at most")
        self.normal = np.where(np.abs(self.normal) < ON, 0.0, self.normal)
        near = self.normal @ self.normal.T - 2 * np.eye(len(self))
        if near.max() > math.cos(math.radians(BEND)):
            one = int(near.max(axis=1).argmax())
            at = points[self.on(points)[:, one]].mean(axis=0)
            raise ValueError(
                f"solid: two of its planes, at {rounded(at)} m, are within {BEND:g} degrees of each other; make them "
                "one, or give corners with more digits"
            )
        middle = np.array([np.ptp(points[on], axis=0) / 2 + points[on].min(axis=0) for on in self.on(points).T])
        order = np.lexsort((middle / size).round(6).T[::-1])
        self.normal, self.offset = self.normal[order], self.offset[order]
        self.corners = points[self.on(points).sum(axis=1) >= 3]
        self.names = self._named()

    @property
    def near(self) -> float:
        """Distance of a point from a plane that it is on, by round-off [m]."""
        return ON * float(np.ptp(self.box, axis=0).max())

    def on(self, x: Array) -> Array:
        """Mask (K, S) of the planes that points (K, 3) [m] are on, up to round-off."""
        return self.on_edges(x, self.near)

    def _named(self) -> tuple[str, ...]:
        """The names of the planes."""
        side = {(axis, -1.0 if upper else 1.0): name for name, (axis, upper) in SIDES.items()}
        plane = [(int(np.abs(n).argmax()), float(n.sum())) if np.abs(n).max() == 1 else None for n in self.normal]
        across = [None if which is None else side[which] for which in plane]
        number = np.cumsum([name is None for name in across])
        slopes = [f"slope{k}" if number[-1] > 1 else "slope" for k in number]
        return tuple(name or slope for name, slope in zip(across, slopes, strict=True))

    @property
    def sides(self) -> tuple[str, ...]:
        """(S,) names of the planes, as a `Shape` has those of its sides."""
        return self.names


def hull(corners: Sequence[Sequence[float]]) -> Solid:
    """The convex hull of corners, as the shape of a tank in 3-D; see `Solid` for the names of its walls.

    Args:
        corners: (x, y, z) of each [m], in any order.

    Raises:
        ValueError: see `Solid`.
    """
    return Solid(corners)


def prism(outline: Sequence[Sequence[float]], length: float, *, along: str = "z") -> Solid:
    """A convex outline extended along an axis from 0 on: a channel with sloping sides, a tank with chamfers.

    Args:
        outline: corners of the cross-section [m]: (x, y) for one along z, (x, z) along y, (y, z) along x.
        length: along the axis [m].
        along: "x", "y" or "z".

    Raises:
        ValueError: the outline is not convex, the length not positive, the axis none; see `Solid`.
    """
    corners = numbers(outline)
    if corners.ndim != 2 or corners.shape[1] != 2 or len(corners) < 3:
        raise ValueError(f"prism: outline is {outline!r}; it must be three corners or more, of two coordinates in m")
    if along not in ("x", "y", "z"):
        raise ValueError(f"prism: along is {along!r}; it must be 'x', 'y' or 'z'")
    if not (is_number(length) and length > 0):
        raise ValueError(f"prism: length is {length!r}; it must be a number > 0, in m")
    ends = [np.insert(corners, "xyz".index(along), end, axis=1) for end in (0.0, float(length))]
    solid = Solid(np.concatenate(ends))
    if len(solid.corners) < 2 * len(corners):
        raise ValueError("prism: the outline is not convex, or a corner is on the line between its neighbours")
    return solid


def read(path: str | Path, *, scale: float = 1.0) -> Solid:
    """The solid within a closed convex surface of a file: STL, or another that meshio reads.

    Args:
        path: of the file.
        scale: by which coordinates are multiplied, 1e-3 for a file in mm.

    Raises:
        OSError: the file cannot be read.
        ValueError: the scale is not positive, the file has no triangles, is not closed, or not convex; see `Solid`.
    """
    if not (is_number(scale) and scale > 0):
        raise ValueError(f"{path}: scale is {scale!r}; it must be a number > 0")
    if not Path(path).is_file():
        raise FileNotFoundError(f"{path}: there is no such file")
    try:
        with np.errstate(over="ignore"):  # meshio reads the text of STL as a number, to see whether it is one
            mesh = meshio.read(path)
    except (meshio.ReadError, ValueError, KeyError, IndexError, SystemExit) as error:
        raise ValueError(f"{path}: it cannot be read as a surface of triangles: {error}") from error
    triangles = np.asarray(mesh.cells_dict.get("triangle", np.zeros((0, 3), dtype=int)))
    if not len(triangles):
        raise ValueError(f"{path}: it has no triangles")
    points = np.asarray(mesh.points, dtype=float) * scale
    solid = Solid(points[np.unique(triangles)])
    a, b, c = (points[triangles[:, k]] for k in range(3))
    area, around = float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()) / 2, float(ConvexHull(points).area)
    if abs(area - around) > FLAT * around:
        raise ValueError(
            f"{path}: its triangles have {area:.6g} m^2 and the hull of its corners {around:.6g} m^2; "
            "it is not closed or not convex, and a tank in 3-D is, but for blocks in a box"
        )
    return solid
