"""Tanks of any shape in the plane, filled with fluids and sampled by particles."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from scipy.spatial import Delaunay

from tipfem.arguments import explained, is_number, rounded
from tipfem.case import lattice
from tipfem.case.curves import SMOOTH, has_curve
from tipfem.case.domain import LEAST_GAP, ON_BOUNDARY, Domain, domain_of, gap_between
from tipfem.case.domain_grading import Points, thinned_in_domain
from tipfem.case.fluid import Fluid, ranks
from tipfem.case.grading import Grading
from tipfem.case.lattice import BISECTIONS, heaviest_beside
from tipfem.case.particles import Particles
from tipfem.case.region import initial_velocities
from tipfem.case.shapes import Shape, cut_out
from tipfem.case.tank import Tank
from tipfem.case.walls import Wall
from tipfem.typing import Array

# The least distance of the particles inside to a wall at the start, and of two particles on a wall [spacings].
OFF_WALL = 0.6
ALONG_WALL = 0.5
# A particle inserted where a face between fluids crosses an edge keeps this distance from its ends [spacings].
ROOM = 0.25
ROUNDS = 12  # of fitting particles to faces


class ShapedTank(Tank):
    """A closed tank of any shape in 2-D, to be filled with fluids; `tipfem.tank` makes one.

    Its walls have particles at all corners and about one spacing apart between them. Those inside start on a
    lattice along the axes, with lines along the straight walls and the faces of filled boxes that run along an axis.

    Args:
        shape: of the tank.
        spacing: target distance between particles [m].
        jitter: random displacement of the particles off the walls, in spacings (0 to 0.4).
        seed: of the random displacement.

    Attributes:
        shape: as given.
        domain: its polygon, with the corners on arcs where fills meet them; known once it has been sampled.

    Raises:
        ValueError: see `Tank`; or a corner is too sharp, or a gap too narrow for the spacing.
    """

    SLACK = 1e-12  # smaller than a tank's, because walls along no axis meet the faces at round-off only

    def __init__(self, shape: Shape, spacing: float, jitter: float = 0.0, seed: int = 0) -> None:
        if not (is_number(spacing) and spacing > 0):
            raise ValueError(f"tank: spacing is {spacing!r} m; it must be > 0")
        lower, upper = shape.box
        super().__init__(upper - lower, spacing, jitter, seed)
        self.shape, self.lower, self.upper = shape, lower, upper
        self.sides = shape.sides
        self.domain = domain_of(shape, spacing)
        self.domain.require_resolved(spacing)

    def _is_curved(self, side: str) -> bool:
        """See `Tank._is_curved`."""
        return has_curve(self.domain, side)

    def walls(self, particles: Particles) -> list[Wall]:
        """The walls described by `wall`, by their sides."""
        return [Wall(name, side=name, **what) for name, what in self.wall_options.items()]

    def sample(
        self, fluids: Sequence[Fluid], *, fitted: bool = False, empty: bool = False, grading: Grading | None = None
    ) -> Particles:
        """Particles of the filled tank, walls included; see `Tank.sample`."""
        self._require_memory(self.shape.area, grading)
        numbers_of, nothing = self._numbers(fluids), len(fluids)

        def fluid_at(x: Array) -> Array:
            label = np.full(len(x), nothing if empty else 0, dtype=np.int32)
            for region, number in zip(self.regions, numbers_of, strict=True):
                label[region.mask(x)] = number
            return label

        def is_empty(x: Array) -> Array:
            return np.asarray(fluid_at(x) == nothing)

        part = fluid_at if fitted else is_empty if empty else None
        self.domain = domain = self._domain(part)
        lines = self._lines(domain, is_empty if empty else None, fitted=fitted)
        edge = _along_walls(domain, self.spacing, lines, part)
        position, wall, line = self._lattice(domain, lines, edge)
        on_face = np.zeros(len(position), dtype=bool)
        if part is not None:
            position, wall, on_face = _fitted_to_faces(position, wall, domain, self.spacing, part)
        fluid = np.full(len(position), -1, dtype=np.int32)
        for region, number in zip(self.regions, numbers_of, strict=True):
            fluid[self._mask(region, position, wall)] = number
        self._require_filled(position, fluid, empty=empty)
        if part is not None:
            rank, shifted = np.append(ranks(fluids), -1), _shifted(fluid_at, self.lower)
            fluid[on_face] = heaviest_beside(position[on_face] - self.lower, self.size, self.spacing, shifted, rank)
        if self.jitter:
            position = self._jittered(position, ~wall & ~on_face, domain)
        kept = wall | (fluid >= 0)
        if grading:
            added = np.full((len(position) - len(line), 2), -1)
            between = on_face.copy()
            between[wall] &= _between_parts(position[wall], domain, self.spacing, fluid_at)
            points = Points(position, np.concatenate([line, added]), wall, between, fluid)
            kept &= thinned_in_domain(grading, points, domain, fluids, self.spacing)
        velocity = initial_velocities(self.regions, numbers_of, position, fluid, self.spacing, self.period)
        velocity[wall] = self._along_walls(position[wall], velocity[wall])
        velocity = velocity[kept]
        return Particles(position[kept], fluid[kept], wall[kept], velocity, spacing=self.spacing)

    def _domain(self, part: Callable[[Array], Array] | None) -> Domain:
        """The polygon of the tank around its bodies, whose outlines become those of the polygon; see `sample`."""
        shape = self.shape
        for body in self.bodies:
            try:
                shape = cut_out(shape, [body.outline])
            except ValueError as error:
                raise ValueError(
                    self._crowded() or f"tank: body {body.name!r} must be inside the tank and off all walls: {error}"
                ) from error
        domain = domain_of(shape, self.spacing, part)
        if self.bodies:
            try:
                domain.require_resolved(self.spacing)
            except ValueError as error:
                raise ValueError(self._crowded() or str(error)) from error
        first = len(self.shape.loops)
        loops = [domain.start[domain.loop == first + k][::-1] for k in range(len(self.bodies))]
        self.bodies = [body.meshed(loop) for body, loop in zip(self.bodies, loops, strict=True)]
        return domain

    def _crowded(self) -> str:
        """What is wrong with the first body that is too close to a wall or to another; empty where none is."""
        tank, least = domain_of(self.shape, self.spacing), LEAST_GAP * self.spacing
        outlines = [domain_of(body.outline, self.spacing) for body in self.bodies]
        for b, outline in enumerate(outlines):
            gap, place, edge = gap_between(outline, tank, outside=False)
            other = f"the wall {tank.sides[tank.side[edge]]!r}"
            for k in range(b):
                found = gap_between(outline, outlines[k], outside=True)
                if found[0] < gap:
                    gap, place, other = found[0], found[1], f"body {self.bodies[k].name!r}"
            if gap < least * (1 - 1e-6):
                distance = f"{gap:.4g} m away from" if gap > 0 else "on, or on the wrong side of,"
                return (
                    f"tank: body {self.bodies[b].name!r} is {distance} {other} at {rounded(place)} m; it must be "
                    f"inside the tank and {least:.4g} m or more ({LEAST_GAP:g} spacings) off all walls and other "
                    "bodies, for fluid is between them: move it, or choose a smaller spacing. A body cannot stand on a "
                    "wall, or close a gap"
                )
        return ""

    def _along_walls(self, x: Array, velocity: Array) -> Array:
        """The part of velocities (K, 2) at points x (K, 2) on the walls that is along those that slip."""
        domain = self.domain
        assert domain is not None
        if not velocity.any():
            return velocity
        slips = np.array([Wall(name, particles=[], **self.wall_options.get(name, {})).slips for name in domain.sides])
        on = domain.on_edges(x, ON_BOUNDARY * self.spacing)
        slides = (slips[domain.side] | ~on).all(axis=1)
        before = np.argsort(domain.following)
        sharp = np.abs(domain.turn[before]) > math.radians(SMOOTH)
        slides &= ~(on & on[:, before] & sharp).any(axis=1)
        tangent = domain.tangents(x, np.argmax(on, axis=1))
        return np.where(slides[:, None], (velocity * tangent).sum(axis=1)[:, None] * tangent, 0.0)

    def _lines(self, domain: Domain, is_empty: Callable[[Array], Array] | None, *, fitted: bool) -> list[Array]:
        """Coordinates of the lattice's lines along each axis [m]."""
        h, result = self.spacing, []
        for axis in range(2):
            lower, length = float(self.lower[axis]), float(self.size[axis])
            faces = {face - lower for face in self._faces(axis)}
            on_lines: set[float] = set()
            if is_empty is not None:
                shifted = _shifted(is_empty, self.lower)
                on_lines = lattice.faces_of_part(faces, axis, self.size, h, shifted)
            taken = [0.0, length, *faces]
            straight = np.flatnonzero((domain.curve < 0) & (np.abs(domain.direction[:, axis]) < 1e-9))
            for k in straight[np.argsort(-domain.length[straight], kind="stable")]:
                at = float(domain.start[k, axis]) - lower
                if min(abs(at - other) for other in taken) > 2 * lattice.CLOSEST * h * (1 + 1e-9):
                    taken.append(at)
                    faces.add(at)
                    on_lines.add(at)
            if fitted:
                lines = lattice.fitted_lines(axis, length, h, faces)
            else:
                lines = lattice.lines(axis, length, h, faces, on_lines)
            lines = lines + lower
            # Exactly on the walls that are there.
            walls = np.unique(domain.start[straight, axis])
            if len(walls):
                nearest = walls[np.abs(lines[:, None] - walls).argmin(axis=1)]
                lines = np.where(np.abs(lines - nearest) < 1e-9 * h, nearest, lines)
            result.append(lines)
        return result

    def _lattice(self, domain: Domain, lines: list[Array], edge: Array) -> tuple[Array, Array, Array]:
        """Positions (N, 2), those on walls first, the mask (N,) of these, and lines (N, 2), see `Points`."""
        points = np.stack([x.ravel() for x in np.meshgrid(*lines, indexing="ij")], axis=1)
        from_end = [np.minimum(np.arange(len(x)), np.arange(len(x))[::-1]) for x in lines]
        line = np.stack([k.ravel() for k in np.meshgrid(*from_end, indexing="ij")], axis=1)
        inside = domain.contains(points)
        points, line = points[inside], line[inside]
        off = domain.depth(points, OFF_WALL * self.spacing) == np.inf
        points, line = points[off], line[off]
        wall = np.zeros(len(edge) + len(points), dtype=bool)
        wall[: len(edge)] = True
        return np.concatenate([edge, points]), wall, np.concatenate([np.full(edge.shape, -1), line])

    def _jittered(self, position: Array, moves: Array, domain: Domain) -> Array:
        """The positions with the particles that ``moves`` (N,) displaced at random, unless they come near a wall."""
        shift = np.random.default_rng(self.seed).uniform(-1, 1, position.shape) * self.jitter * self.spacing
        new = position + np.where(moves[:, None], shift, 0.0)
        near = moves & (domain.depth(new, ALONG_WALL * self.spacing) < np.inf)
        new[near] = position[near]
        return new


def _shifted(function: Callable[[Array], Array], by: Array) -> Callable[[Array], Array]:
    return lambda x: function(x + by)


def _along_walls(domain: Domain, spacing: float, lines: list[Array], part: Callable[[Array], Array] | None) -> Array:
    """Positions (K, 2) of the wall particles [m]: at all corners, and about a spacing apart between them.

    On walls along an axis they are on the lattice's lines; where a wall passes from one filled part into another there
    is one.
    """
    found = []
    for k in range(len(domain)):
        a, b, length = domain.start[k], domain.end[k], float(domain.length[k])
        count = max(1, round(length / spacing)) if domain.curve[k] < 0 else 1
        where = np.arange(count + 1) / count
        axis = int(np.argmax(np.abs(b - a)))
        if a[1 - axis] == b[1 - axis] and domain.curve[k] < 0:
            where = np.sort((lines[axis] - a[axis]) / (b[axis] - a[axis]))
            margin = ALONG_WALL * spacing / length
            where = where[(where > margin) & (where < 1 - margin)]
            where = np.concatenate([[0.0], where, [1.0]])
            gaps = np.flatnonzero(np.diff(where) > 1.6 * spacing / length)
            where = np.sort(np.concatenate([where, 0.5 * (where[gaps] + where[gaps + 1])]))
        if part is not None:
            where = _with_crossings(a, b, where, part, ROOM * spacing / length)
        found.append(a + where[:-1, None] * (b - a))
    return np.concatenate(found)


def _with_crossings(a: Array, b: Array, where: Array, part: Callable[[Array], Array], room: float) -> Array:
    """Places on an edge, from 0 to 1, with one where it passes from one filled part into another."""
    label = part(a + where[:, None] * (b - a))
    result = where.copy()
    more = []
    for k in np.flatnonzero(label[1:] != label[:-1]):
        low, high = where[k], where[k + 1]
        for _ in range(BISECTIONS):
            middle = 0.5 * (low + high)
            same = part((a + middle * (b - a))[None])[0] == label[k]
            low, high = (middle, high) if same else (low, middle)
        crossing = 0.5 * (low + high)
        nearer = int(k if crossing - where[k] < where[k + 1] - crossing else k + 1)
        if abs(crossing - where[nearer]) < 1e-6 * room:
            continue
        if 0 < nearer < len(where) - 1:
            result[nearer] = crossing
        elif abs(crossing - where[nearer]) > room:
            more.append(crossing)
    return np.sort(np.concatenate([result, more]))


def triangles_inside(position: Array, domain: Domain) -> Array:
    """Delaunay triangles (M, 3) of particles (N, 2) with their centroid in a domain."""
    centre, scale = position.mean(axis=0), np.ptp(position, axis=0).max()
    cells = Delaunay((position - centre) / scale).simplices
    return np.asarray(cells[domain.contains(position[cells].mean(axis=1))])


def _fitted_to_faces(
    position: Array, wall: Array, domain: Domain, spacing: float, part: Callable[[Array], Array]
) -> tuple[Array, Array, Array]:
    """Particles with some on every face between filled parts, so that no edge of their mesh crosses one.

    Of an edge that joins two parts, the end off the walls that is nearer to the face moves there along the edge; a
    particle with several targets moves to the nearest (Labelle & Shewchuk, "Isosurface stuffing", 2007). Where both
    ends are on walls or faces, a particle is added. This is repeated, because the mesh changes.

    Args:
        position: (N, 2) [m].
        wall: (N,) mask of those on walls; they stay.
        domain: of the tank.
        spacing: h [m].
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
        low, high = np.zeros(len(one)), np.ones(len(one))
        for _bisection in range(BISECTIONS):
            middle = 0.5 * (low + high)
            same = part(start + middle[:, None] * edge) == label[one]
            low, high = np.where(same, middle, low), np.where(same, high, middle)
        fraction = 0.5 * (low + high)
        fraction = np.where(fraction < 1e-7, 0.0, np.where(fraction > 1 - 1e-7, 1.0, fraction))  # as in `snap_to_faces`
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


def _on_face(x: Array, spacing: float, part: Callable[[Array], Array]) -> Array:
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


def _between_parts(x: Array, domain: Domain, spacing: float, part: Callable[[Array], Array]) -> Array:
    """Mask (K,) of the points (K, 2) on walls where a face between parts ends; not where parts end at walls."""
    corners = 1e-7 * spacing * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    around = (x[:, None] + corners).reshape(-1, 2)
    label, inside = part(around).reshape(-1, 4), domain.contains(around).reshape(-1, 4)
    lowest = np.where(inside, label, np.iinfo(np.int32).max).min(axis=1)
    return np.asarray(np.where(inside, label, -1).max(axis=1) > lowest)


@explained("say tank(size=(0.584, 0.584), spacing=0.02)")
def tank(
    size: Sequence[float] | None = None,
    spacing: Any = None,
    *,
    shape: Any = None,
    jitter: float = 0.0,
    seed: int = 0,
    periodic: str | None = None,
) -> Tank:
    """A closed tank to be filled: ``tank((1, 1), 0.05).fill(air).fill(water, box=((0, 0), (1, 0.5)))``.

    Args:
        size: (d,) edge lengths of a box [m].
        spacing: target distance between particles [m].
        shape: instead of ``size``, in 2-D: a shape of `tipfem.shapes`, a list of corners (x, y) [m], or a polygon of
            shapely, with holes or without.
        jitter: random displacement of the particles off the walls [spacings]; needed in 3-D.
        seed: of the random displacement.
        periodic: "x" for a box in 2-D without walls on the left and right, where what leaves on one side enters on the
            other: channels, shear layers, waves without side walls; "xy" for one without any walls.

    Raises:
        ValueError: an argument is missing or out of range, see `Tank` and `ShapedTank`.
    """
    if (size is None) == (shape is None):
        raise ValueError("tank: give either its size, for a box, or its shape")
    if size is not None:
        return Tank(size, spacing, jitter, seed, periodic)
    if periodic is not None:
        raise ValueError(f"tank: periodic is {periodic!r}; a tank with a shape has walls all around")
    return ShapedTank(Shape.of(shape), spacing, jitter, seed)
