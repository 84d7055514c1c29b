"""Points of a tank of any shape in the plane: on its walls, and on a lattice along the axes between them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import Delaunay, cKDTree

from tipfem.geometry.lattice import CLOSEST, Part, bisected, crossings, faces_of_part, fitted_lines, lines
from tipfem.geometry.plane.curves import SMOOTH
from tipfem.geometry.plane.domain import ON_BOUNDARY, Domain, is_at_corner, reach_of
from tipfem.typing import Array

# The least distance of the points inside to a wall at the start, and of two points on a wall [spacings].
OFF_WALL = 0.6
ALONG_WALL = 0.5
# A point inserted where a face between parts crosses an edge keeps this distance from its ends [spacings].
ROOM = 0.25
FLAT = 1e-9  # height of a triangle over its longest side, below which it is none
ROUNDS = 12  # of fitting points to faces
# Between the corners of a straight wall, points of a grading are this far apart or more [targets]; they keep half of it
# from the corner at its end, and so do those inside from walls.
APART = 0.85


@dataclass(frozen=True)
class ShapePoints:
    """The N points of a domain: corners, walls a spacing apart, and a lattice inside, with lines along the walls."""

    domain: Domain  # the polygon
    spacing: float  # h [m]
    position: Array  # (N, 2) [m]; those on walls first, in the order of the domain's edges
    wall: Array  # (N,) mask of those on walls
    on_face: Array  # (N,) mask of those on faces between parts
    line: Array  # (N, 2) numbers of the lattice's lines that each is on, from the nearer end; -1 off the lattice

    @staticmethod
    def of(
        domain: Domain,
        box: Array,
        spacing: float,
        faces: list[set[float]],
        part: Part | None,
        is_empty: Part | None,
        *,
        fitted: bool,
    ) -> ShapePoints:
        """The points of a domain, before they are fitted to faces; see `tipfem.geometry.lattice` for errors.

        The shape is in the ``box`` (2, 2) [m]. Lines are on ``faces`` between parts along each axis [m] if ``fitted``,
        else on both sides of them. Where walls pass from one ``part`` into another, there is a point; ``is_empty``
        masks empty parts.
        """
        along = _lines(domain, box, spacing, faces, is_empty, fitted=fitted)
        edge = _wall_points(domain, spacing, along, part)
        inner = np.stack([x.ravel() for x in np.meshgrid(*along, indexing="ij")], axis=1)
        from_end = [np.minimum(np.arange(len(x)), np.arange(len(x))[::-1]) for x in along]
        line = np.stack([k.ravel() for k in np.meshgrid(*from_end, indexing="ij")], axis=1)
        for kept in (domain.contains, lambda x: domain.depth(x, OFF_WALL * spacing) == np.inf):
            here = kept(inner)
            inner, line = inner[here], line[here]
        position = np.concatenate([edge, inner])
        wall = np.arange(len(position)) < len(edge)
        line = np.concatenate([np.full(edge.shape, -1), line])
        return ShapePoints(domain, spacing, position, wall, np.zeros(len(position), dtype=bool), line)

    @property
    def images(self) -> Array:
        """(N,) mask of the points that are images of others: none."""
        return np.zeros(len(self.position), dtype=bool)

    def fitted(self, part: Part) -> ShapePoints:
        """The points with some on every face between parts; see `fitted_to_faces`."""
        position, wall, on_face = fitted_to_faces(self.position, self.wall, self.domain, self.spacing, part)
        added = np.full((len(position) - len(self.line), 2), -1)
        return replace(self, position=position, wall=wall, on_face=on_face, line=np.concatenate([self.line, added]))

    def shifted(self, by: Array, *, along_walls: bool) -> ShapePoints:
        """The points displaced by (N, 2) [m], but for those on faces and walls, or that would come near a wall."""
        moves = ~self.wall & ~self.on_face
        new = self.position + np.where(moves[:, None], by, 0.0)
        near = moves & (self.domain.depth(new, ALONG_WALL * self.spacing) < np.inf)
        new[near] = self.position[near]
        return replace(self, position=new)

    def along_walls(self, x: Array, velocity: Array, slips: Callable[[str], bool]) -> Array:
        """Velocities (K, 2) [m/s] of points x (K, 2) [m] on walls: their parts along walls that slip, 0 on others."""
        domain = self.domain
        if not velocity.any():
            return velocity
        on = domain.on_edges(x, ON_BOUNDARY * self.spacing)
        slides = (np.array([slips(name) for name in domain.sides])[domain.side] | ~on).all(axis=1)
        before = np.argsort(domain.following)
        sharp = np.abs(domain.turn[before]) > math.radians(SMOOTH)
        slides &= ~(on & on[:, before] & sharp).any(axis=1)
        tangent = domain.tangents(x, np.argmax(on, axis=1))
        along = (velocity * tangent).sum(axis=1)[:, None] * tangent
        return np.asarray(np.where(slides[:, None], along, 0.0))

    def at_interfaces(self, fluid: Array, fluid_at: Part) -> Array:
        """(N,) mask of the points on faces between fluids; of those on walls, where a face between two of them ends."""
        result: Array = self.on_face.copy()
        result[self.wall] &= _between_parts(self.position[self.wall], self.domain, self.spacing, fluid_at)
        return result

    def limited(self, size: Array, spacing: float) -> Array:
        """Target spacings (N,) of at most the lengths of edges at the corners of arcs, which all stay."""
        domain = self.domain
        corner = self._corners()
        arc = (domain.curve >= 0) & (domain.curve[np.argsort(domain.following)] >= 0)
        size = size.copy()
        size[corner[arc]] = np.minimum(size[corner[arc]], np.maximum(domain.length[arc], spacing))
        return size

    def fewer_on_walls(self, kept: Array, fixed: Array, target: Array, stride: Array, spacing: float) -> Array:
        """Mask of points that stay, every ``stride``-th (N,) on walls, none near; corners and ``fixed`` (N,) do."""
        x, domain, on_wall, corner = self.position, self.domain, np.flatnonzero(self.wall), self._corners()
        near = np.flatnonzero(kept & ~self.wall & ~fixed & (stride > 1))
        reach = 0.5 * APART * target[near]
        kept[near[domain.depth(x[near], float(reach.max(initial=0.0))) < reach]] = False
        kept[on_wall] = fixed[on_wall]
        kept[corner] = True
        for edge in range(len(domain)):
            row = on_wall[(domain.distances(x[on_wall], np.array([edge]))[0][:, 0] < 1e-9 * spacing)]
            along = np.linalg.norm(x[row] - domain.start[edge], axis=1)
            row, along = row[np.argsort(along)], np.sort(along)
            stays = along[kept[row]]
            behind = 0.0
            for k, place in zip(row.tolist(), along.tolist(), strict=True):
                if kept[k]:
                    behind = place
                    continue
                ahead = float(stays[np.searchsorted(stays, place)])
                apart = APART * target[k]
                if place - behind >= apart and ahead - place >= 0.5 * apart:
                    kept[k], behind = True, place
        return kept

    def _corners(self) -> Array:
        """(S,) the point at the start of each edge of the domain."""
        on_wall = np.flatnonzero(self.wall)
        return np.asarray(on_wall[cKDTree(self.position[on_wall]).query(self.domain.start)[1]])


def _lines(
    domain: Domain, box: Array, spacing: float, faces: list[set[float]], is_empty: Part | None, *, fitted: bool
) -> list[Array]:
    """Coordinates of the lattice's lines along each axis [m]; see `ShapePoints.of`."""
    h, result = spacing, []
    first, size = box[0], box[1] - box[0]
    for axis in range(2):
        lower, length = float(first[axis]), float(size[axis])
        inner = {face - lower for face in faces[axis]}
        on_lines = faces_of_part(inner, axis, first, size, h, is_empty) if is_empty is not None else set()
        taken = [0.0, length, *inner]
        straight = np.flatnonzero((domain.curve < 0) & (np.abs(domain.direction[:, axis]) < 1e-9))
        for k in straight[np.argsort(-domain.length[straight], kind="stable")]:
            at = float(domain.start[k, axis]) - lower
            if min(abs(at - other) for other in taken) > 2 * CLOSEST * h * (1 + 1e-9):
                taken.append(at)
                inner.add(at)
                on_lines.add(at)
        along = fitted_lines(axis, length, h, inner) if fitted else lines(axis, length, h, inner, on_lines)
        along = along + lower
        # Exactly on the walls that are there.
        walls = np.unique(domain.start[straight, axis])
        if len(walls):
            nearest = walls[np.abs(along[:, None] - walls).argmin(axis=1)]
            along = np.where(np.abs(along - nearest) < 1e-9 * h, nearest, along)
        result.append(along)
    return result


def _wall_points(domain: Domain, spacing: float, along: list[Array], part: Part | None) -> Array:
    """Positions (K, 2) of points on walls [m]: at corners, where the part changes, and a spacing apart between."""
    found, reach = [], reach_of(domain.start)
    for k in range(len(domain)):
        a, b, length = domain.start[k], domain.end[k], float(domain.length[k])
        count = max(1, round(length / spacing)) if domain.curve[k] < 0 else 1
        where = np.arange(count + 1) / count
        axis = int(np.argmax(np.abs(b - a)))
        if a[1 - axis] == b[1 - axis] and domain.curve[k] < 0:
            where = np.sort((along[axis] - a[axis]) / (b[axis] - a[axis]))
            margin = ALONG_WALL * spacing / length
            where = where[(where > margin) & (where < 1 - margin)]
            where = np.concatenate([[0.0], where, [1.0]])
            gaps = np.flatnonzero(np.diff(where) > 1.6 * spacing / length)
            where = np.sort(np.concatenate([where, 0.5 * (where[gaps] + where[gaps + 1])]))
        if part is not None:
            where = _with_crossings(a, b, where, part, spacing, reach)
        found.append(a + where[:-1, None] * (b - a))
    return np.concatenate(found)


def _with_crossings(a: Array, b: Array, where: Array, part: Part, spacing: float, reach: float) -> Array:
    """Places on an edge, from 0 to 1, with one where it passes from one part into another; see `is_at_corner`."""
    label, unit = part(a + where[:, None] * (b - a)), float(np.linalg.norm(b - a)) / spacing
    result = where.copy()
    more = []
    for k in np.flatnonzero(label[1:] != label[:-1]):
        ends = where[k : k + 1], where[k + 1 : k + 2]
        (crossing,) = bisected(*ends, lambda at: part(a + at[:, None] * (b - a)))
        nearer = int(k if crossing - where[k] < where[k + 1] - crossing else k + 1)
        if 0 < nearer < len(where) - 1:
            if abs(crossing - where[nearer]) * unit > ON_BOUNDARY:  # parts overlap by round-off
                result[nearer] = crossing
        elif not is_at_corner(abs(crossing - where[nearer]) * unit, b if nearer else a, spacing, reach):
            more.append(crossing)
    return np.sort(np.concatenate([result, more]))


def triangles_inside(position: Array, domain: Domain) -> Array:
    """Delaunay triangles (M, 3) of particles (N, 2) with their centroid in a domain."""
    centre, scale = position.mean(axis=0), np.ptp(position, axis=0).max()
    place = (position - centre) / scale
    cells = Delaunay(place).simplices
    side = place[cells[:, [1, 2, 0]]] - place[cells]
    area = np.abs(side[:, 0, 0] * side[:, 1, 1] - side[:, 0, 1] * side[:, 1, 0])
    cells = cells[area > FLAT * (side**2).sum(axis=2).max(axis=1)]  # along straight walls Qhull gives flat ones
    return np.asarray(cells[domain.contains(position[cells].mean(axis=1))])


def fitted_to_faces(
    position: Array, wall: Array, domain: Domain, spacing: float, part: Part
) -> tuple[Array, Array, Array]:
    """Particles with some on every face between filled parts, so that no edge of their mesh crosses one.

    Of an edge that joins two parts, the end off the walls that is nearer to the face moves there along the edge; a
    particle with several targets moves to the nearest (Labelle & Shewchuk, "Isosurface stuffing", 2007). Where both
    ends are on walls or faces, a particle is added. This is repeated, because the mesh changes.

    Args:
        wall: (N,) mask of those on walls; they stay.
        part: function of positions (K, 2) [m] to the number (K,) of the filled part that each lies in.

    Returns:
        Positions (N', 2), the mask (N',) of wall particles, and that of those on a face.
    """
    x = position.copy()
    on_face = wall & _on_face(x, spacing, part)
    for _ in range(ROUNDS):
        cells = triangles_inside(x, domain)
        pairs = np.unique(np.sort(cells[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)
        pairs = pairs[~on_face[pairs].any(axis=1)]
        label = part(x)
        one, other = pairs[label[pairs[:, 0]] != label[pairs[:, 1]]].T
        if not len(one):
            break
        start, edge = x[one], x[other] - x[one]
        fraction = crossings(start, edge, part)
        crossing = start + fraction[:, None] * edge
        mover = np.where((fraction <= 0.5) & ~wall[one] | wall[other], one, other)
        length = np.linalg.norm(edge, axis=1)
        distance = np.linalg.norm(crossing - x[mover], axis=1)
        # The particle that moves keeps off the wall that the other one is on.
        rest = length - distance
        fixed = wall[mover] | ((wall[one] | wall[other]) & (rest < ROOM * spacing))
        order = np.lexsort((distance, mover))
        order = order[~fixed[order]]
        moved, first = np.unique(mover[order], return_index=True)
        x[moved] = crossing[order][first]
        on_face[moved] = True
        room = np.minimum(fraction, 1 - fraction) * length > ROOM * spacing
        added = crossing[wall[one] & wall[other] & room]
        if len(added):
            added = np.unique(added.round(12), axis=0)
            x = np.concatenate([x, added])
            wall = np.concatenate([wall, np.zeros(len(added), dtype=bool)])
            on_face = np.concatenate([on_face, np.ones(len(added), dtype=bool)])
        if not len(moved) and not len(added):
            break
    return x, wall, on_face


def _on_face(x: Array, spacing: float, part: Part) -> Array:
    """Mask (K,) of the points (K, 2) that are on a face between parts, up to round-off."""
    near = 1e-7 * spacing
    label = part(x)
    found = np.zeros(len(x), dtype=bool)
    for step in (-near, near):
        for axis in (0, 1):
            shifted = x.copy()
            shifted[:, axis] += step
            found |= part(shifted) != label
    return found


def _between_parts(x: Array, domain: Domain, spacing: float, part: Part) -> Array:
    """Mask (K,) of the points (K, 2) on walls where a face between parts ends; not where parts end at walls."""
    corners = 1e-7 * spacing * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    around = (x[:, None] + corners).reshape(-1, 2)
    label, inside = part(around).reshape(-1, 4), domain.contains(around).reshape(-1, 4)
    lowest = np.where(inside, label, np.iinfo(np.int32).max).min(axis=1)
    return np.asarray(np.where(inside, label, -1).max(axis=1) > lowest)
