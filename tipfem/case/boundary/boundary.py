"""Boundary: on which straight sides and curves each wall particle lies, and in which directions it is free to slide."""

from __future__ import annotations

import copy
import dataclasses
import itertools
import math
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
from scipy.spatial import ConvexHull

from tipfem.arguments import is_number
from tipfem.case.boundary.passages import Passages, edges_named, opened, with_ends
from tipfem.case.boundary.passed import put_before
from tipfem.case.boundary.side_frames import frames
from tipfem.case.boundary.wall_members import ON_LINE, members_of, smooth_joints
from tipfem.case.open_lines import OpenLine, lines_of
from tipfem.case.openings import Opening
from tipfem.case.particles import Particles, squared_lengths
from tipfem.case.walls import Motion, Pose, Wall, rates
from tipfem.errors import Invalid, SimulationError
from tipfem.geometry.blocks import BlockedBox
from tipfem.geometry.period import Period, no_period
from tipfem.geometry.plane.curves import Curve, curve_of, runs_alike, runs_of
from tipfem.geometry.plane.domain import ON_BOUNDARY, Domain, enclosing
from tipfem.geometry.plane.vectors import turned
from tipfem.geometry.polyhedron import Polyhedron
from tipfem.scratch import copied, filled, owned, scratch
from tipfem.typing import Array

# A wall particle lies on a straight side if it is closer to it than this [spacings] after remeshing, which has given
# it a position with round-off; before, if it is closer than `ON_LINE`.
ON_SIDE = 1e-5
# A wall particle off all straight walls is on a curve if it is closer to it than this [spacings]; others are of bodies.
NEAR_CURVE = 0.5
# Relative change of the tank's volume that moving walls may cause, for the round-off of their functions.
VOLUME_SLACK = 1e-6
# Particles in free flight may move twice as far in a step as others, if they are not to miss a fluid that they land in.
IN_FLIGHT = 0.5
OF_CASE = {"walls", "motion", "period", "domain", "tank", "curves", "lines"}  # attributes that never change


class Boundary:
    """The walls of a case on its particles. Positions y are in the frame of the tank, as at t = 0.

    The sides are the edges of the domain, in 3-D its planes. A particle on one side, n . y = c + s(t) with the inward
    normal n and the side's displacement s, is held in the direction n; a particle on several sides (in a corner) in the
    directions of all their normals. Along the side it slides with the fluid where the wall slips, and otherwise stays.

    Args:
        walls: all walls that slip, slide or move.
        motion: rigid motion of the whole tank, or None.
        domain: that bounds the fluids; by default the convex hull of the particles.
        fixed_volume: whether the fluids fill the tank and cannot leave it, so that moving walls must keep its volume.
        room: whether there is empty space in the tank.
        period: none by default. There are no sides across periodic axes.
        bodies: number of loops of the domain, the last ones, that are outlines of bodies at t = 0.
        openings: in the walls; 2-D. No wall holds the particles on them, but those at their ends.
        sides: of a box, see `tipfem.case.boundary.passages.edges_named`; needed for the names of its openings' walls.
        normal: which of the openings are crossed at right angles only.

    Attributes:
        tank: the domain without bodies.
        body_edges: (E, 2) the edges of a mesh along the bodies, as long as their particles are the initial ones.
        active: whether any wall slips, slides or moves, or has an opening.
        lines, passages: the openings, and their particles; None without any.
        planes: (N, S) mask of the planes of the domain that each wall particle is on, in 3-D.
        index: (W,) the wall particles, but for those on openings that no wall holds.
        normal, inverse: (W, d, d) for each wall particle a matrix whose rows are the normals of its sides, unused rows
            zero; and its pseudo-inverse.
        side: (W, d) number of the side of each row.
        free: (W, d, d) projector on the directions in which the particle slides with the fluid.
        sliding: (W,) number of the wall whose velocity the particle takes; -1 for none.
        tangent: (W, d) direction in which the wall of each particle slides, anticlockwise about what its outline
            encloses; zero in 3-D, and where no wall moves.
        curvature: (W, d) vector to the centre of the arc that it is on over the square of the radius [1/m].
        pieces: rows of particles along a side, ends included, that are kept evenly spaced (2-D). Each row comes with
            the particles' coordinates along it, 0 at one end and 1 at the other, or None where the wall slips.
        endless: rows of particles along a whole side that slips, along a periodic axis.
        slides: (K,) positions in `index` of the particles that slide.
        still, stays: (N,) masks of the wall particles that do not slide, and of those not relocated along the wall
            either.
        pinned: (W,) mask of the wall particles at corners and at the ends of walls.
        members: the straight parts of the walls: number of the wall, number of the side, and its particles as positions
            in `index`, in order along the wall in 2-D.
        curves: the smooth parts of the walls that slip, of several edges; where a joint of walls is smooth, and both do
            the same to a fluid, it is inside of one.
        on_curve: (W,) number of the curve that each particle slides on, -1 for none.

    Raises:
        ValueError: a wall has no particles, is not straight, or overlaps another; the tank would change its volume; or
            a function of time returns an invalid value.
    """

    stays: Array
    still: Array
    index: Array
    pinned: Array

    def __init__(
        self,
        particles: Particles,
        walls: Sequence[Wall],
        motion: Motion | None,
        domain: Domain | Polyhedron | None = None,
        *,
        fixed_volume: bool = True,
        room: bool = False,
        period: Period | None = None,
        bodies: int = 0,
        openings: Sequence[Opening] = (),
        sides: Mapping[str, Array] | None = None,
        normal: Sequence[bool] = (),
        joins: bool = False,
    ) -> None:
        self.period = no_period(particles.dimension) if period is None else period
        self.walls, self.motion, self.fixed_volume = tuple(walls), motion, fixed_volume
        self.dimension = particles.dimension
        self.active = bool(self.walls) or motion is not None or bool(openings)
        self.lines: list[OpenLine] = []
        self.passages: Passages | None = None
        self._normal, self.room = list(normal), room
        self.curves: list[Curve] = []
        self._joins = joins and not openings
        self.pieces: list[tuple[Array, Array | None]] = []
        self.endless: list[Array] = []
        self._hold(particles.wall)
        self.slides: Array = np.zeros(0, dtype=np.int64)
        self._set_domain(particles, domain, bodies)
        if not self.active:
            return
        if motion is not None:
            motion.check(self.dimension)
        names = [wall.name for wall in self.walls]
        if len(set(names)) < len(names):
            raise Invalid("walls", f": walls are named {names}; every wall needs a name of its own", "Case")
        self._y = particles.position[self.index]
        self._h = particles.spacing
        self._find_sides(self.domain.on_edges(self._y, ON_LINE * self._h))
        self._find_curves()
        self.members = [part for number, wall in enumerate(self.walls) for part in self._parts(number, wall, particles)]
        if openings:
            self._find_lines(openings, sides or {}, len(particles))
        self._open(len(particles))
        self._assign()
        self._check_start(particles)
        self._volume = self.volume_at(0.0)
        if any(wall.motion is not None for wall in self.walls):
            for time in (1e-3, 1e-2, 0.1, 1.0):
                if message := self.volume_error(time):
                    raise Invalid("walls", f": {message}", "Case")

    def _set_domain(self, particles: Particles, domain: Domain | Polyhedron | None, bodies: int) -> None:
        """Set the domain, that without bodies, and the edges along them."""
        self.body_edges: Array = np.zeros((0, 2), dtype=np.int64)
        self.domain = self.tank = domain or self._hull(particles)
        self.planes: Array | None = None
        if isinstance(self.domain, Polyhedron):
            on = self.domain.on_edges(particles.position, ON_LINE * particles.spacing)
            self.planes = on & particles.wall[:, None]
        if bodies:
            assert isinstance(self.domain, Domain)
            loops = int(self.domain.loop.max()) + 1 - bodies
            self.tank = self.domain.first_loops(loops)
            reach = ON_BOUNDARY * particles.spacing
            pairs, edge = self.domain.boundary_edges(particles.position[self.index], reach)
            self.body_edges = self.index[pairs[self.domain.loop[edge] >= loops]]

    @property
    def start(self) -> Array:
        """(W, d) positions at the start of the wall particles, in 3-D [m]."""
        return self._y

    @property
    def entries(self) -> Array:
        """Numbers (K,) of the particles at the ends of inlets and outlets."""
        return np.zeros(0, dtype=np.int64) if self.passages is None else self.passages.ends

    @property
    def convex(self) -> bool:
        """Whether the fluids fill the convex hull of their particles, as in a box, so that no mesh needs `edges`."""
        return self.domain.convex

    def _hull(self, particles: Particles) -> Domain | Polyhedron:
        """The convex hull of the particles."""
        if self.dimension == 2:
            return enclosing(particles.position, particles.spacing, self.period)
        return Polyhedron(particles.position, ON_LINE * particles.spacing)

    def _find_sides(self, on_side: Array) -> None:
        """Set which sides the wall particles are on, from a mask (W, S), and the directions in which they are held."""
        domain = self.domain
        on_side[:, self._across_period()] = False
        self.side_normal, self.offset, self.on_side = domain.normal, domain.offset, on_side
        self.normal, self.side, self.inverse = frames(self.side_normal, on_side)
        self.on_curve = np.full(len(self.index), -1)

    def _parts(self, number: int, wall: Wall, particles: Particles) -> list[tuple[int, int, Array]]:
        """The straight parts of a wall, see `members`, that are no part of a curve."""
        here = f"Case: wall {wall.name!r}"
        if wall.motion is not None and isinstance(self.tank, Domain) and not self.tank.straight_and_convex:
            why = "is given; a wall of a tank that is not convex, or has arcs, cannot move along its normal"
            raise Invalid(("walls", wall.name, "motion"), why, here)
        if wall.motion is not None and isinstance(self.domain, BlockedBox):
            raise Invalid(("walls", wall.name, "motion"), "is given; no wall of a tank with blocks can move", here)
        if wall.side is None:
            return [(number, *members_of(wall, particles, self._y, self.on_side, self.side_normal))]
        if not isinstance(self.domain, Domain):
            why = f"is {wall.side!r}; in 3-D give its particles by index or mask"
            raise Invalid(("walls", wall.name, "side"), why, here)
        if wall.side not in self.domain.sides:
            why = f"is {wall.side!r}; it must be one of the sides of the shape, {', '.join(self.domain.sides)}"
            raise Invalid(("walls", wall.name, "side"), why, here)
        result = []
        on_curves = [edge for curve in self.curves for edge in curve.edges]
        for run in runs_of(self.domain, self.domain.sides.index(wall.side)):
            for side in np.setdiff1d(run, on_curves).tolist():
                found = np.flatnonzero(self.on_side[:, side])
                result.append((number, side, found[np.argsort(self._y[found] @ self._tangent(side))]))
        return result

    def _find_curves(self) -> None:
        """Find `curves`; walls that differ by their names only, and meet without a corner, may be one."""
        domain = self.domain
        if not isinstance(domain, Domain):
            return
        wall, kind = np.full((2, len(domain)), -1)
        alike: dict[int, int] = {}
        for number, own in enumerate(self.walls):
            if own.side in domain.sides and own.slips:
                same = (k for k in alike if self._joins and own.like(self.walls[k]))
                alike[number] = next(same, number)
                edges = domain.side == domain.sides.index(own.side)
                wall[edges], kind[edges] = number, alike[number]
        for run in runs_alike(domain, kind):
            # Straight walls alone, which turn a little where they meet, have the particle there fixed.
            parts = np.split(run, np.flatnonzero(np.diff(domain.side[run])) + 1)
            if max(map(len, parts)) > 1:
                self.curves.append(curve_of(domain, int(wall[run[0]]), run))
                self._put_on_curve(len(self.curves) - 1)

    def _put_on_curve(self, number: int) -> None:
        """Release the particles on a curve, except at its ends, to slide along it."""
        curve = self.curves[number]
        on = self.on_side[:, curve.edges].any(axis=1)
        rows = np.flatnonzero(on & ~curve.at_ends(self._y, ON_SIDE * self._h))
        tangent = curve.tangent(self._y[rows])
        self.on_curve[rows] = number
        self.normal[rows] = 0.0
        self.normal[rows, 0] = turned(tangent)
        self.inverse[rows] = np.linalg.pinv(self.normal[rows], rcond=1e-9)

    def _tangent(self, side: int) -> Array:
        return turned(self.side_normal[side])

    def _find_lines(self, openings: Sequence[Opening], sides: Mapping[str, Array], count: int) -> None:
        """Find the openings on the walls, and whether fluids slide along the walls at their ends."""
        assert isinstance(self.domain, Domain)
        named = edges_named(self.domain, sides, 1e-9 * self._h)
        walls = [(side, self.walls[number]) for number, side, _ in self.members]
        self.lines = lines_of(openings, self.domain, self._y, named, self._h, self.period, walls)
        # Once as if no fluid slid at the ends of inlets, to see where it does.
        trial, slides = copy.copy(self), np.zeros(count, dtype=bool)
        trial.still, trial.stays = self.still.copy(), self.stays.copy()
        trial._open(count)
        trial._assign()
        slides[trial.index[trial.slides]] = True
        assert trial.passages is not None
        slippery = {side for number, side, _ in self.members if self.walls[number].slip and self.room}
        corners = self.index[self.on_side.sum(axis=1) > 1]
        self.lines = with_ends(self.lines, trial.passages.nodes, slides, corners, slippery)

    def _open(self, count: int) -> None:
        """Release the particles on openings from walls, of ``count`` particles in all."""
        if not self.lines:
            return
        given = self.index, self._y, self.on_side, self.members
        self.passages, kept, on_side, self.members = opened(self.lines, self._normal, *given, count, ON_SIDE * self._h)
        self.index, self._y = self.index[kept], self._y[kept]
        self.still[self.passages.open] = self.stays[self.passages.open] = False
        self._find_sides(on_side)
        for k in range(len(self.curves)):
            self._put_on_curve(k)

    def _assign(self) -> None:
        """Find the free directions of each particle, and the rows of particles that are kept evenly spaced."""
        count, d = len(self.index), self.dimension
        owner = filled(-1, "boundary.owner", (count, len(self.offset)), np.int64)
        self.pinned = pinned = np.asarray(self.normal[:, 1].any(axis=1))
        self.mover = np.full(len(self.offset), -1)
        for number, side, found in self.members:
            # A wall along all of a periodic side has no ends.
            endless = bool(self.period) and len(found) == self.on_side[:, side].sum()
            inner = found[1:-1] if d == 2 and not endless else found
            if (owner[inner, side] >= 0).any() or (self.walls[number].motion is not None and self.mover[side] >= 0):
                other = max(int(owner[inner, side].max()), int(self.mover[side]))
                names = [self.walls[k].name for k in (other, number)]
                raise Invalid("walls", f": walls {names} overlap; every wall particle belongs to one wall", "Case")
            owner[inner, side] = number
            if d == 2 and not endless:
                pinned[found[[0, -1]]] = True
            if self.walls[number].motion is not None:
                self.mover[side] = number
        if self.passages is not None:
            for row, side, wall in self.passages.corners:
                owner[row, side], pinned[row] = wall, False
        slips = np.array([wall.slips for wall in self.walls] + [False])  # the last one is for no wall, -1
        for k, curve in enumerate(self.curves):
            rows = np.flatnonzero(self.on_curve == k)
            owner[rows[:, None], curve.edges] = curve.wall
            if not curve.closed:
                ends = self.on_side[:, curve.edges[[0, -1]]].any(axis=1) & (self.on_curve != k)
                pinned[ends] = True
        # On an edge in 3-D, all of the sides must slip for the particle to slide along it.
        free: Array = (slips[owner] | ~self.on_side).all(axis=1) & self.on_side.any(axis=1) & ~(pinned & (d == 2))
        unit = np.eye(d)
        self.free = np.matmul(self.inverse, self.normal, out=owned(self.normal.shape))
        np.subtract(unit, self.free, out=self.free)
        self.free[~free] = 0.0
        self.slides = np.flatnonzero((self.free > 1e-9).any(axis=(1, 2)))
        self.sliding = np.where(self.normal[:, 1].any(axis=1), -1, owner.max(axis=1))
        self._turn()
        self.still[self.index[self.slides]] = self.stays[self.index[self.slides]] = False
        if d == 2:
            self._find_pieces(pinned, slips, owner)

    @property
    def frictionless(self) -> bool:
        """Whether the domain is periodic between walls that all slip without friction."""
        friction = any(not wall.slip for wall in self.walls)
        return bool(self.period) and not self.still.any() and not friction

    def _turn(self) -> None:
        """Turn the corners of arcs with their walls, and set `tangent` and `curvature`."""
        domain = self.domain
        self.tangent = self.curvature = np.zeros_like(self._y)
        if not isinstance(domain, Domain) or self.at_rest:
            return
        edge = np.argmax(self.on_side, axis=1)
        wall = np.full(len(domain), -1)
        for number, side, _ in self.members:
            if is_number(self.walls[number].velocity) or callable(self.walls[number].velocity):
                wall[side] = number
        joint = smooth_joints(domain, self.on_side, wall)
        turns = joint.any(axis=1) & (self.on_curve < 0) & (wall[edge] >= 0)
        self.sliding = np.where(turns, wall[edge], self.sliding)
        off = np.nan_to_num(self._y - domain.centre[edge])
        square = np.where(off.any(axis=1), (off**2).sum(axis=1), 1.0)
        self.tangent = domain.sense[edge, None] * domain.tangents(self._y, edge)
        self.curvature = -off / square[:, None]
        # Of chords, as meshes have them, what the circle through a corner and its neighbours has.
        chords = np.flatnonzero(turns & ~off.any(axis=1))
        edge = np.argmax(joint[chords], axis=1)
        tangent, self.curvature[chords] = domain.bends(edge)
        self.tangent[chords] = domain.sense[edge, None] * tangent

    def _find_pieces(self, pinned: Array, slips: Array, owner: Array) -> None:
        """Find the rows between pinned particles that slip or slide, or whose length a moving wall changes."""
        slide = np.array([wall.velocity is not None for wall in self.walls] + [False])
        on_curves = [edge for curve in self.curves for edge in curve.edges]
        for side in np.setdiff1d(np.flatnonzero(self.on_side.any(axis=0)), on_curves).tolist():
            row = np.flatnonzero(self.on_side[:, side])
            row = row[np.argsort(self._y[row] @ self._tangent(side))]
            stops = np.flatnonzero(pinned[row])
            if not len(stops) and slips[owner[row, side]].all():
                self.endless.append(self.index[row])
                self.stays[self.index[row]] = False
            for first, last in itertools.pairwise(stops):
                piece = row[first : last + 1]
                at_ends: Array = np.asarray(self.on_side[piece[[0, -1]]].any(axis=0))
                at_ends[side] = False
                slippery = bool(slips[owner[piece[1:-1], side]].all())
                if len(piece) > 2 and (slippery or slide[owner[piece[1], side]] or (self.mover[at_ends] >= 0).any()):
                    along = self._y[piece] @ self._tangent(side)
                    coordinate = (along - along[0]) / (along[-1] - along[0])
                    self.pieces.append((self.index[piece], None if slippery else coordinate))
                    self.stays[self.index[piece[1:-1]]] = False

    def _check_start(self, particles: Particles) -> None:
        for number, side, _ in self.members:
            if (wall := self.walls[number]).displacement(0.0) != 0:
                text = f"at t = 0 is {wall.displacement(0.0):g} m; it must be zero, because the particles stand on the "
                raise Invalid(("walls", wall.name, "motion"), f"{text}wall at that time", f"Case: wall {wall.name!r}")
            velocity = wall.sliding(0.0, self.dimension)
            normal_speed = abs(float(velocity @ self.side_normal[side]))
            if normal_speed > 1e-9 * np.linalg.norm(velocity):
                text = f"{velocity.tolist()} m/s is not along the wall; use motion to move a wall along its normal"
                raise Invalid(("walls", wall.name, "velocity"), text, f"Case: wall {wall.name!r}")
        v = particles.velocity[self.index]
        held = v - np.einsum("wij,wj->wi", self.free, v)
        held[np.isin(self.index, self.body_edges)] = 0.0
        if (np.abs(held) > 1e-9 * max(particles.max_speed, 1e-300)).any():
            w = int(np.argmax(np.abs(held).max(axis=1)))
            text = f": wall particle {self.index[w]} at {self._y[w].tolist()} has velocity {v[w].tolist()} m/s; it "
            text += "must be zero in the directions that its walls hold (their own motion is added)"
            raise Invalid("particles", text, "Case")

    def walled(self, pairs: Array) -> Array:
        """The faces (E, 2) of the boundary, given by their particles, that are not on openings."""
        return pairs if self.passages is None else self.passages.without(pairs)

    def stored(self) -> dict[str, Any]:
        """Attributes that a checkpoint keeps: data of its own; the others are the case's."""
        return {name: value for name, value in vars(self).items() if name not in OF_CASE}

    def closed(self, position: Array, start: Array) -> Array:
        """Positions (N, 2) at the end of a step, with the particles of openings where they were at its ``start``."""
        position = position.copy()
        for on in () if self.passages is None else self.passages.nodes:
            position[on] = start[on]
        return position

    def going_over(self, name: str, time: float, value: float, ramp: float) -> Boundary:
        """The same with a wall of that name that goes over to another speed; see `Wall.going_over`."""
        new = copy.copy(self)
        new.walls = tuple(wall.going_over(time, value, ramp) if wall.name == name else wall for wall in self.walls)
        return new

    def displacements(self, time: float, step: float) -> tuple[Array, Array, Array]:
        """Displacement (S,) of the sides along their normals [m] with two derivatives; ``step`` of differences [s]."""
        values = np.zeros((3, len(self.offset)))
        for side in np.flatnonzero(self.mover >= 0):
            values[:, side] = rates(self.walls[self.mover[side]].displacement, time, step)
        return values[0], values[1], values[2]

    def sliding_velocities(self, time: float, step: float) -> tuple[Array, Array]:
        """Velocity (K + 1, d) [m/s] of the K walls along themselves and its derivative; the last row is zero."""
        d = self.dimension
        still = np.zeros(d)
        parts = [
            rates(partial(wall.sliding, dimension=d), time, step)[:2] if wall.velocity is not None else (still, still)
            for wall in self.walls
        ]
        return np.array([*(p[0] for p in parts), still]), np.array([*(p[1] for p in parts), still])

    def speeds(self, time: float, step: float) -> tuple[Array, Array]:
        """Speed (K + 1,) [m/s] along themselves of the walls whose velocity is a number, and its derivative."""
        none = np.array(0.0)
        given = [wall.speed if wall.velocity is not None else None for wall in self.walls]
        parts = [(none, none) if speed is None else rates(speed, time, step)[:2] for speed in given]
        return np.array([*(p[0] for p in parts), 0.0]), np.array([*(p[1] for p in parts), 0.0])

    def tank_at(self, time: float) -> Domain:
        """The tank in 2-D, in its frame, with the walls that move by themselves where they are at a time [s]."""
        assert isinstance(self.tank, Domain)
        if not self.active or (self.mover < 0).all():
            return self.tank
        return self.tank.moved(self.displacements(time, 1e-6)[0][: len(self.tank)])

    def pose(self, time: float, step: float) -> Pose:
        """Position and motion of the tank at a time, by finite differences with a step [s]."""
        return Pose.still(self.dimension) if self.motion is None else self.motion.pose(time, step, self.dimension)

    def speed_over_spacing(self, particles: Particles, time: float, step: float, flies: Array) -> float:
        """Largest ratio of a particle's speed relative to the tank and its target spacing [1/s].

        Those of the mask ``flies`` count by `IN_FLIGHT`. Between periodic sides that nothing holds a flow along,
        relative to its mean: it may all move at any speed.
        """
        relative = particles.velocity
        if self.motion is not None:
            relative = relative - self.pose(time, step).rigid_velocity(particles.position)
        elif self.frictionless:
            along = np.isin(np.arange(particles.dimension), self.period.axes)
            relative = relative - np.where(along, relative.mean(axis=0), 0.0)
        target = scratch("speed.target", len(particles))
        np.multiply(particles.target, particles.target, out=target)
        np.divide(squared_lengths(relative), target, out=target)
        target[flies] *= IN_FLIGHT**2
        return float(np.sqrt(target.max()))

    def _hold(self, wall: Array) -> None:
        """Take the particles of a mask (N,) for those of the walls, all of which stay where they are."""
        self.stays = wall.copy()
        self.still = wall.copy()
        self.index = np.flatnonzero(wall)
        self.pinned = np.zeros(len(self.index), dtype=bool)

    def holding(self, wall: Array) -> Boundary:
        """The same walls, none of which is active, on the particles of a mask (N,); itself if these are its own."""
        if np.array_equal(wall, self.still):
            return self
        new = copy.copy(self)
        new._hold(wall)
        return new

    def reassigned(self, particles: Particles, pose: Pose, displacement: Array) -> Boundary:
        """The same walls, in 3-D whole sides, on other particles, at ``displacement`` (S,) of the sides [m]."""
        new, slack = copy.copy(self), ON_SIDE * particles.spacing
        new.index = np.flatnonzero(particles.wall)
        new._y = particles.position[new.index]
        if self.motion is not None:
            new._y = pose.origin(new._y)
        if isinstance(self.domain, Polyhedron):
            return new._on_planes(particles, displacement, slack)
        on_side = new._sides_of(displacement, slack)
        if self._remains(new, on_side, len(particles)):
            if self.passages is not None:
                new.passages, new.index = dataclasses.replace(self.passages, y=new._y), self.index
                new._y = new._y[~self.passages.open[self.passages.index]]
            new._turn()
            return new
        new._find_sides(on_side)
        for k in range(len(new.curves)):
            new._put_on_curve(k)
        new.members = []
        p, own = self.passages, (self._y, self.on_side, self.members)
        closed_y, closed_sides, closed = own if p is None else (p.y, p.on_side, p.members)
        for number, side, old in closed:
            along = new._y @ self._tangent(side)
            found = np.flatnonzero(new.on_side[:, side])
            if len(old) < closed_sides[:, side].sum():  # a part of its side
                ends = closed_y[old[[0, -1]]] @ self._tangent(side)
                found = found[(along[found] > ends[0] - slack) & (along[found] < ends[1] + slack)]
            new.members.append((number, side, found[np.argsort(along[found])]))
        new.pieces, new.endless = [], []
        new.still, new.stays = copied(particles.wall), copied(particles.wall)
        new._open(len(particles))
        new._assign()
        return new

    def _on_planes(self, particles: Particles, displacement: Array, slack: float) -> Boundary:
        """This one with the sides that its particles are on, in 3-D; see `reassigned`."""
        assert isinstance(self.domain, Polyhedron)
        if self.domain.convex:
            apart = self._y @ self.domain.normal.T - self.domain.offset - displacement
            self._find_sides(np.abs(apart) < slack)
        else:
            self._find_sides(self.domain.on_edges(self._y, slack))
        self.members = [(number, side, np.flatnonzero(self.on_side[:, side])) for number, side, _ in self.members]
        self.still, self.stays = particles.wall.copy(), particles.wall.copy()
        self.planes = np.zeros((len(particles), len(self.domain)), dtype=bool)
        self.planes[self.index] = self.on_side
        self._assign()
        return self

    def _remains(self, new: Boundary, on_side: Array, count: int) -> bool:
        """Whether on ``count`` new particles only positions differ: as many on each side, in the same order.

        ``on_side`` (W, S) is the mask of the sides that they are on, from which those across a period are taken.
        """
        on_side[:, self._across_period()] = False
        p, index, sides, closed = self.passages, self.index, self.on_side, self.members
        if p is not None:
            index, sides, closed = p.index, p.on_side, p.members
        if self.curves or len(self.still) != count or not np.array_equal(new.index, index):
            return False
        if not np.array_equal(on_side, sides) or any(along is not None for _, along in self.pieces):
            return False
        whole = all(len(members) == np.count_nonzero(sides[:, side]) for _, side, members in closed)
        return (
            whole
            and all((np.diff(new._y[members] @ self._tangent(side)) > 0).all() for _, side, members in closed)
            and (p is None or p.remain(self.lines, new._y, on_side, ON_SIDE * self._h))
        )

    def _across_period(self) -> Array:
        """(S,) mask of the sides that particles cannot be on, because the domain is periodic across them."""
        return np.asarray((self.domain.normal[:, self.period.axes] != 0.0).any(axis=1))

    @property
    def at_rest(self) -> bool:
        """Whether no wall moves, nor slides, nor the whole tank."""
        return self.motion is None and all(wall.velocity is None and wall.motion is None for wall in self.walls)

    def _sides_of(self, displacement: Array, slack: float) -> Array:
        """Mask (W, S) of the sides that particles are on, up to ``slack`` [m]; near a curve, on one edge of it."""
        assert isinstance(self.domain, Domain)
        distance = self.domain.moved(displacement).distances(self._y)[0]
        on_side: Array = distance < slack
        if not self.curves:
            return on_side
        on_curves = np.concatenate([curve.edges for curve in self.curves])
        curved = np.zeros(len(self.domain), dtype=bool)
        curved[on_curves] = True
        # Particles on a curve are near its edges, not on them; those at its ends are in a corner.
        straight = on_side[:, ~curved].any(axis=1)
        nearest = on_curves[np.argmin(distance[:, on_curves], axis=1)]
        at_end = np.any([curve.at_ends(self._y, slack) for curve in self.curves], axis=0)
        near = distance[:, on_curves].min(axis=1) < NEAR_CURVE * slack / ON_SIDE
        rows = np.flatnonzero(~straight & ~at_end & near)
        on_side[rows] = False
        on_side[rows, nearest[rows]] = True
        return on_side

    def edges(self, particles: Particles, time: float) -> Array | None:
        """The edges (E, 2) of a mesh along the boundary, fluid on the left; None for the convex hull."""
        if self.convex:
            return None
        assert isinstance(self.domain, Domain)
        assert isinstance(self.tank, Domain)
        if not self.active or self.lines:  # whose particles are the initial ones
            edges = self.tank.edges_of(particles.position, particles.wall, particles.spacing)
            return np.concatenate([edges, self.body_edges])
        y = self.pose(time, 1e-6).origin(particles.position[self.index])
        pairs = []
        on_curves = [edge for curve in self.curves for edge in curve.edges]
        for side in np.setdiff1d(np.arange(len(self.tank)), on_curves).tolist():
            row = np.flatnonzero(self.on_side[:, side])
            row = row[np.argsort((y[row] - self.domain.start[side]) @ self.domain.direction[side])]
            pairs.append(np.stack([row[:-1], row[1:]], axis=1))
        pairs += [self.chain(k, y) for k in range(len(self.curves))]
        return np.concatenate([self.index[np.concatenate(pairs)], self.body_edges])

    def chain(self, k: int, y: Array) -> Array:
        """The wall particles along curve k two and two (E, 2), as positions in `index`, with the fluid on the left."""
        curve, row = self.curves[k], np.flatnonzero(self.on_curve == k)
        row = row[np.argsort(curve.along(y[row]))]
        if curve.closed:
            row = np.append(row, row[0])
        else:
            ends = np.stack([curve.start[0], curve.end[-1]])
            first, last = np.linalg.norm(y[:, None] - ends, axis=2).argmin(axis=0)
            row = np.concatenate([[first], row, [last]])
        return np.stack([row[:-1], row[1:]], axis=1)

    @property
    def is_open(self) -> bool:
        """Whether fluids may pass through a part of it."""
        return self.passages is not None

    def line_of(self, count: int) -> Array:
        """Number (``count``,) of the opening that each particle is on, -1 for none."""
        of = np.full(count, -1)
        for k, on in enumerate(() if self.passages is None else self.passages.nodes):
            of[on] = k
        return of

    def hold_ends(self, fixed: Array, slippery: Array) -> None:
        """Hold the ends of openings, see `Passages.hold`."""
        if self.passages is not None:
            self.passages.hold(fixed, slippery)

    def stopped(self, particles: Particles, loose: Array, time: float) -> Particles:
        """The particles, with ``loose`` (N,) ones that have passed a wall put back, unless the domain is convex."""
        if self.convex or not loose.any():
            return particles
        tank, pose, index = self.tank_at(time), self.pose(time, 1e-6), np.flatnonzero(loose)
        y = pose.origin(particles.position[index])
        out = np.flatnonzero(~tank.contains(y))
        if not len(out):
            return particles
        return put_before(particles, index[out], y[out], tank, pose, 1.0)

    def held(self, y: Array, displacement: Array) -> Array:
        """The nearest positions (W, d) [m] on all of a particle's sides, displaced by (S,) [m]."""
        missing = np.einsum("wki,wi->wk", self.normal, y, out=owned(self.side.shape))
        np.subtract((self.offset + displacement)[self.side], missing, out=missing)
        missing[~self.normal.any(axis=2)] = 0.0
        missing[self.on_curve >= 0] = 0.0
        back = np.einsum("wik,wk->wi", self.inverse, missing, out=owned(missing.shape))
        return np.asarray(np.add(y, back, out=back))

    def require_volume(self, time: float) -> None:
        """`SimulationError` unless the walls' motions keep the volume of a closed tank."""
        if (self.mover >= 0).any() and (message := self.volume_error(time)):
            raise SimulationError(message)

    def volume_at(self, time: float) -> float:
        """Volume that the walls and bodies enclose at a time [s] [m^2, or m^3 in 3-D]; NaN with a period."""
        if self.period:  # no walls move along their normals
            return math.nan
        displacement = np.array([0.0 if m < 0 else float(self.walls[m].displacement(time)) for m in self.mover])
        if isinstance(self.domain, Domain):
            return self.domain.moved(displacement).measure(self.period)
        if isinstance(self.domain, BlockedBox):
            return self.domain.volume
        corner = self.normal[:, -1].any(axis=1)
        return float(ConvexHull(self.held(self._y, displacement)[corner]).volume)

    def volume_error(self, time: float) -> str:
        """Fault of the volume of a closed tank at a time [s], in words; empty if there is none."""
        if not self.fixed_volume:
            return ""
        change = self.volume_at(time) / self._volume - 1
        if abs(change) <= VOLUME_SLACK:
            return ""
        return (
            f"at t = {time:g} s the walls' motions change the volume of the closed tank by {100 * change:.2g} %, and "
            "fluids are incompressible; another wall must move outwards by as much, or a vent must let the gas out"
        )
