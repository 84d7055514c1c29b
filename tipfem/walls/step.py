"""WallStep: what the walls make of one time step's unknowns."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tipfem.case.boundary import Boundary, reassigned
from tipfem.case.particles import Particles
from tipfem.fem.time_integration import GeneralizedAlpha
from tipfem.mesh.mesh import Mesh, Surface
from tipfem.typing import Array
from tipfem.walls.motion import WallMotion
from tipfem.walls.spacing import space_back, space_sliding


@dataclass(frozen=True)
class Faces:
    """The F faces of the walls that slip with friction.

    Attributes:
        nodes: (F, d) particles, in the order in which the measure is positive with the normal.
        coefficient: (F,) viscosity over slip length [Pa s / m].
        normal: (F, d) of the wall, into the fluid, at the intermediate time.
        wall_velocity: (F, d * d) of the wall at each node, at the intermediate time [m/s].
        friction: (K,) what they add to diag(A) of each sliding particle [kg / s^2].
    """

    nodes: Array
    coefficient: Array
    normal: Array
    wall_velocity: Array
    friction: Array


class WallStep:
    """The walls in a step from t_n to t_n + dt: constrained unknowns u = w + P u, with the walls' own w.

    A particle that is fixed has P = 0. One that slides along a wall with the normal n at the step's end has
    P = I - n n^T and w = (c - n . x_n) n: it ends exactly on the wall's line. Its momentum row is projected with
    the wall's direction at the intermediate time, where the forces are.

    The particles of a no-slip wall that slides along itself go with it in the step, and are set back after it: other
    material of the wall takes their place. Were they held instead, the flow between the wall and the next
    particles would be missing from J, and a flow without net volume would have one of U h / 2.

    Args:
        boundary: of the case.
        mesh: of the step.
        particles: the state at t_n.
        viscosity: (M,) of the elements [Pa s].
        scheme: generalized-alpha with the step's length.
        time: t_n [s].

    Attributes:
        fixed: (N,) mask of the particles whose displacement is prescribed.
        sliding: (K,) the particles that slide.
        rows, columns: (K, d * d) their projectors for momentum and for displacements.
        displacement: (N, d) w [m].
        frame: (N, d) the positions in the tank's own frame [m].
        carried: (N, d) displacement by the tank's motion [m], or None.
        faces: those with friction, or None.

    Raises:
        ValueError: a function of time gives what it must not.
        SimulationError: the walls' motions change the tank's volume.
    """

    def __init__(
        self,
        boundary: Boundary,
        mesh: Mesh,
        particles: Particles,
        viscosity: Array,
        scheme: GeneralizedAlpha,
        time: float,
    ) -> None:
        self.boundary, self.scheme, self._time = boundary, scheme, time
        boundary.require_volume(time + scheme.dt)
        part = 0.25 * scheme.dt
        self._before, self._after = WallMotion(boundary, time, part), WallMotion(boundary, time + scheme.dt, part)
        index, slides = boundary.index, boundary.slides
        x, v, a = particles.position, particles.velocity[index], particles.acceleration[index]
        moving = boundary.motion is not None
        self.frame = self._before.pose.origin(x) if moving else x
        self.carried = self._after.pose.place(self.frame) - x if moving else None
        self._home = self._after.place(self.frame[index])
        slid = 0.5 * scheme.dt * (self._before.sliding + self._after.sliding)
        w = self._after.held(self._home + slid @ self._after.pose.rotation.T - x[index])
        self.displacement = np.zeros_like(x)
        self.displacement[index] = w
        self.sliding = index[slides]
        self.fixed = particles.wall.copy()
        self.fixed[self.sliding] = False
        # Where the sliding particles will be, about; of the fixed ones it is exact.
        self._predicted = x.copy()
        self._predicted[index] += w + self._after.slid(scheme.predict(particles)[index])
        v_next, a_next = self._after.rates(self._predicted[index], v)
        self._velocity = self._after.held((1 - scheme.alpha_f) * v_next + scheme.alpha_f * v)
        self._acceleration = self._after.held((1 - scheme.alpha_m) * a_next + scheme.alpha_m * a)
        # The rotation in between: the direction of the chords from the old places to the new.
        u, _, vt = np.linalg.svd(scheme.cf * self._after.pose.rotation + scheme.alpha_f * self._before.pose.rotation)
        self._turn = u @ vt
        self.rows = (self._turn @ boundary.free[slides] @ self._turn.T).reshape(len(slides), x.shape[1] ** 2)
        self.columns = self._after.free[slides].reshape(len(slides), x.shape[1] ** 2)
        self.faces = self._find_faces(mesh, viscosity)

    def _find_faces(self, mesh: Mesh, viscosity: Array) -> Faces | None:
        """The faces of walls that slip with friction."""
        b, d = self.boundary, mesh.dimension
        nodes, coefficient, normal, wall_velocity = [], [], [], []
        for number, (wall, (side, members)) in enumerate(zip(b.walls, b.members, strict=True)):
            if wall.slip_length is None:
                continue
            mask = np.zeros(len(mesh.position), dtype=bool)
            mask[b.index[members]] = True
            on_wall = mask[mesh.cells]
            # A cell has one face on a straight wall: with all of its corners there it would have no volume.
            cell = np.flatnonzero(on_wall.sum(axis=1) == d)
            face = mesh.cells[cell][on_wall[cell]].reshape(-1, d)
            n = self._turn @ b.side_normal[side]
            edge = mesh.position[face[:, 1:]] - mesh.position[face[:, :1]]
            measure = n[0] * edge[:, 0, 1] - n[1] * edge[:, 0, 0] if d == 2 else np.cross(edge[:, 0], edge[:, 1]) @ n
            face[measure < 0, :2] = face[measure < 0, 1::-1]
            now = self._before.along(number, mesh.position[face].reshape(-1, d))
            then = self._after.along(number, self._predicted[face].reshape(-1, d))
            nodes.append(face)
            coefficient.append(viscosity[cell] / wall.slip_length)
            normal.append(np.tile(n, (len(face), 1)))
            wall_velocity.append((self.scheme.alpha_f * now + self.scheme.cf * then).reshape(-1, d * d))
        if not nodes:
            return None
        face, mu = np.concatenate(nodes), np.concatenate(coefficient)
        edge = mesh.position[face[:, 1:]] - mesh.position[face[:, :1]]
        measure = np.linalg.norm(edge[:, 0] if d == 2 else 0.5 * np.cross(edge[:, 0], edge[:, 1]), axis=1)
        share = np.repeat(self.scheme.cv * mu * measure / d, d)
        friction = np.bincount(face.ravel(), share, minlength=len(mesh.position))[self.sliding]
        return Faces(face, mu, np.concatenate(normal), np.concatenate(wall_velocity), friction)

    def constrain(self, u: Array) -> Array:
        """Displacements (N, d) with their walls' constraints: w + P u."""
        index = self.boundary.index
        result = u.copy()
        result[index] = self.displacement[index] + self._after.slid(u[index])
        return result

    def histories(self, velocity: Array, acceleration: Array) -> tuple[Array, Array]:
        """What v_alpha and a_alpha (N, d) are at u = 0, from those of free particles.

        In the directions that are held they are such that cv w, cm w added to them gives the walls' own.
        """
        s, index = self.scheme, self.boundary.index
        w = self.displacement[index]
        v, a = velocity.copy(), acceleration.copy()
        v[index] = self._after.slid(velocity[index]) + self._velocity - s.cv * w
        a[index] = self._after.slid(acceleration[index]) + self._acceleration - s.cm * w
        return v, a

    def finish(self, before: Particles, u: Array, moved: Particles) -> Particles:
        """The state ``moved`` with wall particles where and as fast as their walls have them.

        Args:
            before: the state at t_n.
            u: (N, d) the solution's displacements [m].
            moved: the state at t_{n+1}, right but for the walls.
        """
        index = self.boundary.index
        free, done = self.scheme.acceleration(u, before), moved.copy()
        # Not x + u: in single precision the solution's w is not exact.
        done.position[index] = before.position[index] + self.constrain(u)[index]
        done.acceleration[index] = free[index]
        done.velocity[index] = self.scheme.velocity(free, before)[index]
        self._after.impose(done)
        return done

    def space(self, particles: Particles, surface: Surface | None = None) -> tuple[Particles, int]:
        """Space the particles along the walls that slip, slide, or that moving walls shorten and lengthen.

        Args:
            particles: the state at t_{n+1}.
            surface: of the step's mesh, if it has one.

        Returns:
            The state, and how many particles were set elsewhere.
        """
        slides = self.boundary.sliding >= 0
        if not self.boundary.pieces and not slides.any():
            return particles, 0
        spaced, count = particles.copy(), 0
        for piece, places in self.boundary.pieces:
            if places is None:
                count += space_sliding(spaced, piece, surface)
            else:
                space_back(spaced, piece, places)
        if particles.dimension == 3:
            spaced = self.set_back(spaced)
        if surface is not None:  # what is dry stays where it is
            dry = surface.dry(particles.wall)
            spaced.velocity[dry] = self._after.pose.rigid_velocity(spaced.position[dry])
            spaced.acceleration[dry] = self._after.pose.rigid_acceleration(spaced.position[dry])
        self._after.impose(spaced)
        return spaced, count

    def set_back(self, particles: Particles) -> Particles:
        """The state with the particles of no-slip walls that slide along themselves where they were in the tank."""
        slides = self.boundary.sliding >= 0
        slides[self.boundary.slides] = False
        if not slides.any():
            return particles
        back = particles.copy()
        back.position[self.boundary.index[slides]] = self._home[slides]
        return back

    def reassign(self, particles: Particles) -> Boundary:
        """The boundary at t_{n+1} of remeshed particles, in 2-D; imposes the walls' rates on them, in place."""
        boundary = reassigned(self.boundary, particles, self._after.pose, self._after.displacement)
        WallMotion(boundary, self._time + self.scheme.dt, 0.25 * self.scheme.dt).impose(particles)
        return boundary

    def impose(self, particles: Particles) -> Particles:
        """The state at t_{n+1}, changed in place to the velocities and accelerations that the walls prescribe."""
        self._after.impose(particles)
        return particles


def walls_in_step(
    boundary: Boundary, mesh: Mesh, particles: Particles, viscosity: Array, scheme: GeneralizedAlpha, time: float
) -> WallStep | None:
    """The walls of a step; None if all are fixed and no-slip. See `WallStep` for arguments and errors."""
    return WallStep(boundary, mesh, particles, viscosity, scheme, time) if boundary.active else None
