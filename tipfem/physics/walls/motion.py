"""WallMotion: velocity and acceleration of the walls at one time, and positions of their particles."""

from __future__ import annotations

import warnings

import numpy as np

from tipfem.backend.launch import launch
from tipfem.case.boundary.boundary import Boundary
from tipfem.case.particles import Particles
from tipfem.errors import StartWarning
from tipfem.physics.walls.kernels import Rates, hold
from tipfem.scratch import copied, filled, owned
from tipfem.typing import Array


class WallMotion:
    """Velocities and accelerations that the walls prescribe at a time.

    They are the derivatives of the prescribed functions. Those that generalized-alpha would derive from displacements
    would oscillate.

    Attributes:
        pose: position of the tank.
        displacement: (S,) of the sides along their normals [m].
        free: (W, d, d) projectors on the directions in which the wall particles slide, in space.
        sliding: (W, d) velocity of walls that slide along themselves, in the tank's frame [m/s].

    Raises:
        ValueError: a function of time returns an invalid value.
    """

    def __init__(self, boundary: Boundary, time: float, step: float) -> None:
        self._boundary = b = boundary
        self.pose = b.pose(time, step)
        self._at_rest, d = b.at_rest, b.dimension
        if self._at_rest:
            count = len(b.walls) + 1
            self.displacement, self._own, self._speed = np.zeros(len(b.offset)), np.zeros((count, d)), np.zeros(count)
            self.free, self.sliding = copied(b.free), filled(0.0, "", b.tangent.shape)
            return
        self.displacement, *speeds = b.displacements(time, step)
        self._own, own_rate = b.sliding_velocities(time, step)
        self.sliding, sliding_rate = self._own[b.sliding], own_rate[b.sliding]
        self._speed, change = b.speeds(time, step)
        speed = self._speed[b.sliding][:, None]
        self.sliding = self.sliding + speed * b.tangent
        sliding_rate = sliding_rate + change[b.sliding][:, None] * b.tangent + speed**2 * b.curvature
        rotation = self.pose.rotation
        self.free = rotation @ b.free @ rotation.T
        across, across_rate = (np.einsum("wik,wk->wi", b.inverse, speed[b.side]) for speed in speeds)
        self._relative = (across + self.sliding) @ rotation.T
        self._relative_rate = (across_rate + sliding_rate) @ rotation.T

    def place(self, y: Array) -> Array:
        """Positions (W, d) [m] of the wall particles whose positions in the tank at t = 0 are y (W, d) [m]."""
        held = self._boundary.held(y, self.displacement)
        return held if self._at_rest else self.pose.place(held)

    @property
    def places(self) -> Array:
        """Places (W, d) [m] of the wall particles that slide in 3-D: as at the start between walls that have moved."""
        b, y = self._boundary, self._boundary.start
        across = y @ b.side_normal.T - b.offset
        return self.place(y + ((1 - across / across.max(axis=0)) * self.displacement) @ b.side_normal)

    @property
    def rows(self) -> tuple[Array, Array]:
        """The wall particles and the projectors (W, d d) of each, for kernels."""
        return self._boundary.index, self.free.reshape(len(self.free), -1)

    def held(self, values: Array) -> Array:
        """The components of vectors (W, d) in the directions that the walls constrain."""
        slid = self.slid(values)
        return np.subtract(values, slid, out=slid)

    def held_sums(self, of_walls: float, walls: Rates, of_given: float, given: Rates, more: float = 0.0) -> Rates:
        """See `tipfem.physics.walls.kernels.hold`."""
        shape = walls.velocity.shape
        result = Rates(owned(shape), owned(shape))
        launch(hold, *self.rows, walls, given, result, of_walls, of_given, more, shape[1])
        return result

    def slid(self, values: Array) -> Array:
        """The components of vectors (W, d) along the walls that slip."""
        return np.asarray(np.einsum("wij,wj->wi", self.free, values, out=owned(values.shape)))

    def rates_at(self, position: Array, velocity: Array) -> Rates:
        """Velocity and acceleration (W, d) of the walls at their particles, of states (N, d); see `rates`."""
        index = self._boundary.index
        if self._at_rest:
            still = filled(0.0, "walls.still", (len(index), position.shape[1]))
            return Rates(still, still)
        return Rates(*self.rates(position[index], velocity[index]))

    def rates(self, x: Array, velocity: Array) -> tuple[Array, Array]:
        """Velocity and acceleration (W, d) of the walls at x (W, d).

        velocity (W, d) is that of the particles: those that slide along a rotating wall have a Coriolis acceleration.
        """
        if self._at_rest:
            return np.zeros_like(x), np.zeros_like(x)
        rigid = self.pose.rigid_velocity(x)
        v = rigid + self._relative
        relative = self.slid(velocity) + self.held(v) - rigid
        coriolis = 2 * relative @ self.pose.angular_velocity.T
        return v, self.pose.rigid_acceleration(x) + self._relative_rate + coriolis

    def speed(self, wall: int) -> float:
        """Speed of a wall along itself, by its number, where its velocity is a number; 0 elsewhere [m/s]."""
        return float(self._speed[wall])

    @property
    def array(self) -> Array:
        """(2 d + 2 d^2,) velocity, centre, angular velocity and rotation of the tank, for kernels."""
        pose = self.pose
        return np.concatenate([pose.velocity, pose.centre, pose.angular_velocity.ravel(), pose.rotation.ravel()])

    @property
    def along_walls(self) -> Array:
        """(K + 1, d + 1) velocity of the K walls along themselves, and speed of those where it is a number [m/s].

        These slide in the direction of `Boundary.tangent`, in the tank's frame; the last row is zero.
        """
        return np.concatenate([self._own, self._speed[:, None]], axis=1)

    def imposed(self, particles: Particles, *, in_place: bool = False) -> Particles:
        """The particles with the velocities and accelerations that the walls prescribe; ``in_place``: the same ones."""
        index = self._boundary.index
        velocity, acceleration = particles.velocity, particles.acceleration
        given = Rates(np.ascontiguousarray(velocity), np.ascontiguousarray(acceleration))
        new_v, new_a = self.held_sums(1.0, self.rates_at(particles.position, velocity), -1.0, given, 1.0)
        if not in_place:  # as of walls at rest, which no particle has come to
            if (new_v == velocity[index]).all() and (new_a == acceleration[index]).all():
                return particles.shallow_copy()
            velocity, acceleration = copied(velocity), copied(acceleration)
        velocity[index], acceleration[index] = new_v, new_a
        return particles.shallow_copy(velocity=velocity, acceleration=acceleration)


def set_off(boundary: Boundary, particles: Particles, step: float) -> Particles:
    """The initial particles with the walls' velocities at t = 0; ``step`` [s] is that of the finite differences.

    A tank that sets off at once, with fluids at rest, is warned of: that is an impact.
    """
    if not boundary.active:
        return particles
    motion = WallMotion(boundary, 0.0, step)
    speed = float(
        np.linalg.norm(motion.pose.rigid_velocity(particles.position[boundary.index]), axis=1).max(initial=0.0)
    )
    if speed * step > 1e-6 * particles.spacing and not particles.velocity[~particles.wall].any():
        warnings.warn(
            f"tank_motion begins with a speed of {speed:.3g} m/s at t = 0 while the fluids are at rest, which is an "
            "impact; let the motion begin smoothly (soft_start of a sine), or give the fluids a velocity",
            StartWarning,
            stacklevel=4,
        )
    return motion.imposed(particles)
