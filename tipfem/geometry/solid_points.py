"""Points of a convex solid: a lattice along the axes, and points on the walls along none."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from tipfem.errors import Invalid
from tipfem.geometry.lattice import BESIDE, Part, bisected, fitted_lines
from tipfem.geometry.solids import ON, Solid
from tipfem.typing import Array

SNAPS = 0.45  # how far points move onto faces [spacings]
OFF_CORNERS = 0.5  # of faces that are not at these [spacings]
OFF_WALL = 0.55  # least distance of the points inside, and on walls, from a slope and its edges [spacings]


@dataclass(frozen=True)
class SolidPoints:
    """The N points of a solid; see `tipfem.geometry.box_points.BoxPoints` for those of boxes.

    Edges that cross faces between fluids are cut in the first mesh; none of the points moves there.
    """

    solid: Solid
    spacing: float  # h [m]
    position: Array  # (N, 3) [m]
    wall: Array  # (N,) mask of those on walls
    on_face: Array  # (N,) mask of those on faces between parts, or, before `fitted`, in their planes
    along: Array  # (N, 3, 3) projectors on the directions in which each may be displaced
    placed: Array  # (N, 3) before `fitted` [m]

    @staticmethod
    def of(solid: Solid, spacing: float, faces: list[set[float]]) -> SolidPoints:
        """The points of a solid with ``faces`` [m] between fluids along each axis; see `fitted_lines` for errors."""
        lower, size = solid.box[0], np.ptp(solid.box, axis=0)
        near = solid.near
        inner = [sorted({face - lower[k] for face in found}) for k, found in enumerate(faces)]
        for k, found in enumerate(faces):
            _require_off_corners(solid, k, sorted(found), near, spacing)
        lines = [fitted_lines(k, size[k], spacing, inner[k]) for k in range(3)]
        slopes = np.flatnonzero([name.startswith("slope") for name in solid.names])
        x = lower + np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, 3)
        depth = x @ solid.normal.T - solid.offset
        x = x[(depth > -near).all(axis=1) & (depth[:, slopes] > OFF_WALL * spacing).all(axis=1)]
        planes = [(np.eye(3)[k], lower[k] + at) for k in range(3) for at in inner[k] if near < at < size[k] - near]
        planes += list(zip(solid.normal, solid.offset, strict=True))
        on_slopes = [_on_slope(solid, int(k), planes, lower, lines, spacing) for k in slopes]
        x = np.concatenate([*on_slopes, x])
        x = x[_first_of_each(x, near)]
        normals, on = [n for n, _ in planes], np.stack([np.abs(x @ n - c) < near for n, c in planes], axis=1)
        kinds, kind = np.unique(on, axis=0, return_inverse=True)
        projectors = np.stack([_projector([normals[k] for k in np.flatnonzero(row)]) for row in kinds])
        faces_end = len(planes) - len(solid)
        on_face, wall = (np.asarray(which.any(axis=1)) for which in (on[:, :faces_end], on[:, faces_end:]))
        return SolidPoints(solid, spacing, x, wall, on_face, projectors[kind.ravel()], x)

    @property
    def images(self) -> Array:
        """(N,) mask of nothing, see `BoxPoints.images`."""
        return np.zeros(len(self.position), dtype=bool)

    def fitted(self, part: Part) -> SolidPoints:
        """The points, some moved onto faces between parts, and those alone on faces that have two parts beside them."""
        x = self.position.copy()
        steps = BESIDE * self.spacing * np.eye(3)
        differs = [part(x + step) != part(x - step) for step in steps]
        on_face = self.on_face & np.any(differs, axis=0)
        nearest = np.full(len(x), SNAPS * self.spacing)
        for axis, sign in itertools.product(range(3), (1.0, -1.0)):
            way = self.along[:, :, axis]
            size = np.linalg.norm(way, axis=1)
            goal = x + sign * SNAPS * self.spacing * way / np.maximum(size, ON)[:, None]
            may = np.flatnonzero((size > 0.3) & ~self.on_face & (self.solid.clear(goal, -self.solid.near)))
            may = may[part(self.position[may]) != part(goal[may])]
            found = bisected(self.position[may], goal[may], part)
            apart = np.linalg.norm(found - self.position[may], axis=1)
            closer = apart < nearest[may]
            x[may[closer]], nearest[may[closer]], on_face[may[closer]] = found[closer], apart[closer], True
        return replace(self, position=x, on_face=on_face)

    def along_faces(self, by: Array, spacing: float, part: Part) -> SolidPoints:
        """See `BoxPoints.along_faces`; `shifted` displaces all of them."""
        return self

    def shifted(self, by: Array, *, along_walls: bool) -> SolidPoints:
        """The points displaced by (N, 3) [m], along the walls and faces that they are on."""
        moved = np.any(self.position != self.placed, axis=1)  # onto a face, which may be curved
        by = np.where(moved[:, None], 0.0, by)
        position = self.position + np.einsum("nij,nj->ni", self.along, by)
        return replace(self, position=position)

    def along_walls(self, x: Array, velocity: Array, slips: Callable[[str], bool]) -> Array:
        """See `BoxPoints.along_walls`."""
        velocity = velocity.copy()
        on = self.solid.on(x)
        for plane, name in enumerate(self.solid.names):
            here, n = on[:, plane], self.solid.normal[plane]
            velocity[here] -= (velocity[here] @ n)[:, None] * n
            if not slips(name):
                velocity[here] = 0.0
        return velocity


def _require_off_corners(solid: Solid, axis: int, faces: list[float], near: float, spacing: float) -> None:
    """Raise ValueError if a face between fluids passes a corner of a slope closely, where no cells fit between them."""
    steep = np.flatnonzero([name.startswith("slope") for name in solid.names])
    at = np.unique(solid.corners[solid.on(solid.corners)[:, steep].any(axis=1), axis])
    low, high = solid.box[:, axis]
    for face in faces:
        if not low + near < face < high - near:
            continue
        apart = np.abs(at - face)
        close = at[(apart > near) & (apart < OFF_CORNERS * spacing * (1 - 1e-9))]
        if len(close):
            raise Invalid(
                "tank",
                f": a fill ends at {'xyz'[axis]} = {face:g} m, beside the corner of a slope at {close[0]:g} m; end it "
                f"there, or {OFF_CORNERS * spacing:g} m off, {OFF_CORNERS:g} spacings",
            )


def _on_slope(
    solid: Solid, plane: int, planes: list[tuple[Array, float]], lower: Array, lines: list[Array], spacing: float
) -> Array:
    """Points (K, 3) of a plane along no axis: on its lines with all others, and about a spacing apart between."""
    n, c = solid.normal[plane], solid.offset[plane]
    near = solid.near
    corners, ends = solid.corners[np.abs(solid.corners @ n - c) < near], list[Array]()
    for m, d in planes:
        if np.linalg.norm(way := np.cross(n, m)) < ON:
            continue
        way /= np.linalg.norm(way)
        start = np.linalg.lstsq(np.stack([n, m, way]), np.array([c, d, way @ corners.mean(axis=0)]), rcond=None)[0]
        # Where the line meets the other planes; between the nearest walls it is in the solid.
        slope = np.array([k @ way for k, _ in planes])
        cross = np.abs(slope) > ON
        at = np.array([e - k @ start for k, e in planes])[cross] / slope[cross]
        at = np.sort(at[solid.clear(start + at[:, None] * way, -near)])
        if len(at) and at[-1] - at[0] > near:
            at = at[np.append(True, np.diff(at) > near)]
            ends += [start + way * k for k in _between(at, spacing)]
    edges = np.array(ends)
    axis = int(np.abs(n).argmin())
    first = np.eye(3)[axis] - n[axis] * n
    first /= np.linalg.norm(first)
    second = np.cross(n, first)
    origin = corners.mean(axis=0)
    reach = np.ptp((corners - origin) @ np.stack([first, second]).T, axis=0).max()
    steps = np.arange(-reach, reach, spacing)
    u = lower[axis] + lines[axis] - origin[axis] if n[axis] == 0 else steps
    a, b = np.meshgrid(u, steps, indexing="ij")
    x = origin + a.reshape(-1, 1) * first + b.reshape(-1, 1) * second
    within = np.delete(solid.normal, plane, axis=0), np.delete(solid.offset, plane)
    x = x[(x @ within[0].T - within[1] > 0).all(axis=1)]
    crossing = [(m, d, np.linalg.norm(np.cross(n, m))) for m, d in planes if np.linalg.norm(np.cross(n, m)) > ON]
    apart = np.min([np.abs(x @ m - d) / sine for m, d, sine in crossing], axis=0)  # from the lines
    return np.concatenate([edges, x[apart > OFF_WALL * spacing]])


def _between(at: Array, spacing: float) -> Array:
    """Coordinates along a line, at ``at`` (K,) and about a spacing apart between them [m]."""
    pieces = [at[:1]]
    for low, high in itertools.pairwise(at):
        pieces.append(np.linspace(low, high, max(1, round((high - low) / spacing)) + 1)[1:])
    return np.concatenate(pieces)


def _first_of_each(x: Array, near: float) -> Array:
    """Numbers of the points (K, 3) of which none before is as ``near`` [m]."""
    pairs = cKDTree(x).query_pairs(near, output_type="ndarray")
    kept = np.ones(len(x), dtype=bool)
    kept[pairs.max(axis=1)] = False
    return np.flatnonzero(kept)


def _projector(normals: list[Array]) -> Array:
    """The projector (3, 3) on the directions along all planes with these normals."""
    if not normals:
        return np.eye(3)
    u, s, _ = np.linalg.svd(np.array(normals).T)
    basis = u[:, : int((s > ON).sum())]
    return np.asarray(np.eye(3) - basis @ basis.T)
