"""DomainBoundary: the walls of a tank with a shape, on its straight sides and along its curves."""

from __future__ import annotations

import copy
from collections.abc import Iterable, Sequence

import numpy as np

from tipfem.arguments import is_number
from tipfem.case.boundary import ON_LINE, ON_SIDE, Boundary, frames
from tipfem.case.curves import curve_of, runs_of
from tipfem.case.domain import ON_BOUNDARY, Domain
from tipfem.case.particles import Particles
from tipfem.case.walls import Motion, Pose, Wall
from tipfem.typing import Array

# A wall particle off all straight walls is on a curve if it is closer to it than this [spacings]; others are of bodies.
NEAR_CURVE = 0.5
# Distance from a wall of a particle that has flown through it [spacings].
OFF_WALL = 0.05


class DomainBoundary(Boundary):
    """The walls of a case on its particles, in a domain; its edges are the sides.

    Args:
        particles: the initial state.
        walls: all walls that slip, slide or move.
        motion: rigid motion of the whole tank, or None.
        domain: that bounds the fluids.
        closed: whether the fluids fill the tank.
        bodies: number of loops of the domain, the last ones, that are outlines of bodies at t = 0.

    Attributes:
        tank: the domain without bodies.
        body_edges: (E, 2) the edges of a mesh along the bodies, as long as their particles are the initial ones.
        tangent: (W, 2) direction in which the wall of each particle slides, anticlockwise about what its outline
            encloses.
        curvature: (W, 2) vector to the centre of the arc that it is on over the square of the radius [1/m].

    The others are those of `Boundary`, which has the errors, too.
    """

    domain: Domain

    def __init__(
        self,
        particles: Particles,
        walls: Sequence[Wall],
        motion: Motion | None,
        domain: Domain,
        *,
        closed: bool = True,
        bodies: int = 0,
    ) -> None:
        loops = int(domain.loop.max()) + 1 - bodies
        self.domain, self.tank = domain, domain.first_loops(loops) if bodies else domain
        self.body_edges = np.zeros((0, 2), dtype=np.int64)
        if bodies:
            index = np.flatnonzero(particles.wall)
            pairs, edge = domain.boundary_edges(particles.position[index], ON_BOUNDARY * particles.spacing)
            self.body_edges = index[pairs[domain.loop[edge] >= loops]]
        super().__init__(particles, walls, motion, closed=closed)

    def _find_sides(self, particles: Particles) -> None:
        """The edges of a domain as sides, and the wall particles on each of them."""
        domain = self.domain
        self.side_normal, self.offset = domain.normal, (domain.normal * domain.start).sum(axis=1)
        self.on_side = domain.on_edges(self._y, ON_LINE * self._h)
        self.normal, self.side = frames(self.side_normal, self.on_side)
        self.inverse = np.linalg.pinv(self.normal, rcond=1e-9)
        self.on_curve = np.full(len(self.index), -1)
        self.smooth = _smooth_joints(domain, self.on_side)

    def _parts(self, number: int, wall: Wall, particles: Particles) -> list[tuple[int, Array]]:
        """The straight parts of a wall, see `members`; its curves are added to `curves`."""
        here = f"Case: wall {wall.name!r}"
        if wall.motion is not None:
            raise ValueError(f"{here}: motion is given; a wall of a tank with a shape cannot move along its normal")
        if wall.side is None:
            return [self._members(wall, particles)]
        if wall.side not in self.domain.sides:
            sides = ", ".join(self.domain.sides)
            raise ValueError(f"{here}: side is {wall.side!r}; it must be one of the sides of the shape, {sides}")
        parts: list[Array] = []
        for run in runs_of(self.domain, self.domain.sides.index(wall.side)):
            if wall.slips and len(run) > 1:
                self.curves.append(curve_of(self.domain, number, run))
                self._put_on_curve(len(self.curves) - 1)
            else:
                parts += [run[k : k + 1] for k in range(len(run))]
        result = []
        for (side,) in parts:
            found = np.flatnonzero(self.on_side[:, side])
            result.append((int(side), found[np.argsort(self._y[found] @ self._tangent(side))]))
        return result

    def _put_on_curve(self, number: int) -> None:
        """Let the particles on a curve, except at its ends, slide along it."""
        curve = self.curves[number]
        on = self.on_side[:, curve.edges].any(axis=1)
        if not curve.closed:
            ends = np.stack([curve.start[0], curve.end[-1]])
            on &= (np.linalg.norm(self._y[:, None] - ends, axis=2) > ON_SIDE * self._h).all(axis=1)
        rows = np.flatnonzero(on)
        tangent = curve.tangent(self._y[rows])
        self.on_curve[rows] = number
        self.normal[rows] = 0.0
        self.normal[rows, 0] = np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)
        self.inverse[rows] = np.linalg.pinv(self.normal[rows], rcond=1e-9)

    def _turn(self) -> None:
        """Let the corners of arcs turn with their walls, and find the direction in which each particle's wall slides.

        Sets `tangent` (W, 2), anticlockwise about what the outline encloses, and `curvature` (W, 2), the vector to the
        centre of its arc over the square of the radius [1/m].
        """
        edge = np.argmax(self.on_side, axis=1)
        wall = np.full(len(self.domain), -1)
        for number, side, _ in self.members:
            if is_number(self.walls[number].velocity) or callable(self.walls[number].velocity):
                wall[side] = number
        turns = self.smooth & (self.on_curve < 0) & (wall[edge] >= 0)
        self.sliding = np.where(turns, wall[edge], self.sliding)
        off = np.nan_to_num(self._y - self.domain.centre[edge])
        square = np.where(off.any(axis=1), (off**2).sum(axis=1), 1.0)
        sign = np.where(self.domain.loop[edge] == 0, 1.0, -1.0)[:, None]
        self.tangent = sign * self.domain.tangents(self._y, edge)
        self.curvature = -off / square[:, None]

    def _sides_with_rows(self) -> Iterable[int]:
        """The straight sides of walls that slip or slide."""
        on_curves = [edge for curve in self.curves for edge in curve.edges]
        return [int(side) for side in np.setdiff1d([side for _, side, _ in self.members], on_curves)]

    def reassigned(self, particles: Particles, pose: Pose, displacement: Array) -> Boundary:
        """The same walls on other particles, see `Boundary.reassigned`."""
        del displacement
        new = copy.copy(self)
        new.index = np.flatnonzero(particles.wall)
        new._y = pose.origin(particles.position[new.index])
        new._reassign(particles)
        return new

    def _reassign(self, particles: Particles) -> None:
        """Find the edges that the wall particles are on."""
        domain = self.domain
        slack, old = ON_SIDE * particles.spacing, self.members
        distance = domain.distances(self._y)[0]
        self.on_side = distance < slack
        on_curves = np.array([edge for curve in self.curves for edge in curve.edges], dtype=np.int64)
        curved = np.zeros(len(domain), dtype=bool)
        curved[on_curves] = True
        # Particles on a curve are near its edges, not on them; those at its ends are in a corner.
        straight = self.on_side[:, ~curved].any(axis=1)
        if len(on_curves):
            nearest = on_curves[np.argmin(distance[:, on_curves], axis=1)]
            at_end = np.zeros(len(self._y), dtype=bool)
            for curve in self.curves:
                if not curve.closed:
                    ends = np.stack([curve.start[0], curve.end[-1]])
                    at_end |= (np.linalg.norm(self._y[:, None] - ends, axis=2) < slack).any(axis=1)
            near = distance[:, on_curves].min(axis=1) < NEAR_CURVE * particles.spacing
            rows = np.flatnonzero(~straight & ~at_end & near)
            self.on_side[rows] = False
            self.on_side[rows, nearest[rows]] = True
        self.normal, self.side = frames(self.side_normal, self.on_side)
        self.inverse = np.linalg.pinv(self.normal, rcond=1e-9)
        self.on_curve = np.full(len(self.index), -1)
        self.smooth = _smooth_joints(domain, self.on_side)
        for k in range(len(self.curves)):
            self._put_on_curve(k)
        self.members = []
        for number, side, _ in old:
            found = np.flatnonzero(self.on_side[:, side])
            along = self._y[found] @ self._tangent(side)
            self.members.append((number, side, found[np.argsort(along)]))
        self.pieces = []
        self.still, self.stays = particles.wall.copy(), particles.wall.copy()
        self._assign()

    def edges(self, particles: Particles, time: float) -> Array:
        """The edges of the mesh along the boundary.

        Args:
            particles: the state; which of them are on which side must be as here.
            time: [s].

        Returns:
            (E, 2) numbers of particles, with the fluid on the left.
        """
        if not self.active:
            return np.concatenate([self.tank.edges_of(particles), self.body_edges])
        y = self.pose(time, 1e-6).origin(particles.position[self.index])
        pairs = []
        on_curves = np.array([edge for curve in self.curves for edge in curve.edges], dtype=np.int64)
        for side in np.setdiff1d(np.arange(len(self.tank)), on_curves).tolist():
            row = np.flatnonzero(self.on_side[:, side])
            row = row[np.argsort((y[row] - self.domain.start[side]) @ self.domain.direction[side])]
            pairs.append(np.stack([row[:-1], row[1:]], axis=1))
        for k, curve in enumerate(self.curves):
            row = np.flatnonzero(self.on_curve == k)
            if not curve.closed:
                ends = np.stack([curve.start[0], curve.end[-1]])
                first, last = np.linalg.norm(y[:, None] - ends, axis=2).argmin(axis=0)
                row = np.concatenate([[first], row[np.argsort(curve.along(y[row]))], [last]])
            else:
                row = row[np.argsort(curve.along(y[row]))]
                row = np.append(row, row[0])
            pairs.append(np.stack([row[:-1], row[1:]], axis=1))
        return np.concatenate([self.index[np.concatenate(pairs)], self.body_edges])

    def stopped(self, particles: Particles, loose: Array, time: float) -> Particles:
        """The particles, with loose ones that have passed a wall of the domain put back in front of it.

        Args:
            particles: the state.
            loose: (N,) mask of the particles in free flight.
            time: [s].
        """
        if not loose.any():
            return particles
        pose, index = self.pose(time, 1e-6), np.flatnonzero(loose)
        y = pose.origin(particles.position[index])
        out = np.flatnonzero(~self.tank.contains(y))
        if not len(out):
            return particles
        return put_before(particles, index[out], y[out], self.tank, pose, 1.0)

    def _volume_at(self, time: float) -> float:
        """That of the domain: no wall moves along its normal."""
        del time
        return self.domain.area


def put_before(particles: Particles, index: Array, y: Array, domain: Domain, pose: Pose, side: float) -> Particles:
    """The particles, with some that have passed the boundary of a domain put back in front of it.

    Args:
        particles: the state.
        index: (K,) those that have passed it.
        y: (K, 2) where they are in the frame of the domain [m].
        domain: of a tank, or the outline of a body.
        pose: of the domain's frame.
        side: 1 where particles belong inside the domain, -1 where they belong outside.
    """
    distance, part = domain.distances(y)
    edge = np.argmin(distance, axis=1)
    foot = domain.start[edge] + part[np.arange(len(y)), edge, None] * (domain.end - domain.start)[edge]
    normal = side * domain.normal[edge] @ pose.rotation.T
    position, velocity = particles.position.copy(), particles.velocity.copy()
    position[index] = pose.place(foot) + OFF_WALL * particles.spacing * normal
    relative = velocity[index] - pose.rigid_velocity(position[index])
    velocity[index] -= np.minimum((relative * normal).sum(axis=1), 0.0)[:, None] * normal
    return particles.shallow_copy(position=position, velocity=velocity)


def _smooth_joints(domain: Domain, on_side: Array) -> Array:
    """Mask (W,) of the particles at corners between two edges of one arc, from those on each side (W, S)."""
    before = np.argsort(domain.following)  # the edge that ends where each begins
    joint = on_side & on_side[:, before] & ((domain.curve >= 0) & (domain.curve == domain.curve[before]))
    return np.asarray(joint.any(axis=1))
