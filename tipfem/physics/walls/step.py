"""Walls in one time step: the constraints on its unknowns, and the particles of walls after it.

Walls that are all fixed and no-slip are `WallsInStep`, all others `WallStep`.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from tipfem.backend.launch import launch
from tipfem.case.boundary.boundary import Boundary
from tipfem.case.particles import Particles
from tipfem.case.walls import Pose
from tipfem.fem.time_integration import TimeScheme
from tipfem.mesh.mesh import Mesh
from tipfem.physics.contact.gaps import tightened
from tipfem.physics.walls import kernels
from tipfem.physics.walls.corners import Corners, corners_of_walls, loosened, put_back
from tipfem.physics.walls.curve_step import CurveStep
from tipfem.physics.walls.friction import Faces, WallStart, friction_in_step
from tipfem.physics.walls.layers import Layers
from tipfem.physics.walls.motion import WallMotion
from tipfem.physics.walls.places import back_to_places
from tipfem.physics.walls.spacing import space_back, space_endless, space_sliding
from tipfem.scratch import copied, filled, picked
from tipfem.typing import Array


class WallsInStep:
    """Walls in a step, all fixed and no-slip unless overridden by `WallStep`; N particles, d dimensions."""

    boundary: Boundary  # which particles lie on which walls, at the start of the step
    scheme: TimeScheme  # time integration, with the step's length
    fixed: Array  # (N,) mask of the particles whose displacement is prescribed
    sliding: Array  # (K,) the particles that slide along their walls
    frame: Array  # (N, d) the positions in the tank's own frame [m]
    tank_moves: bool  # whether the whole tank moves
    rows: Array  # rows, columns: (K, d * d) projectors of the sliding particles, for momentum and for displacements
    columns: Array
    faces: Faces  # those with friction
    # the boundary layers at the end of the step on walls with that law; None without such walls
    layers: Layers | None = None
    rigid: Array  # (N, d) displacements of the tank where the particles are, of walls with curves [m]
    # (N,) mask of the particles that slide, but next to nothing, for the layer there is resolved; None for no particle
    stuck: Array | None = None
    # convex ones round which fluids slide, with directions at the start of the step; None without any
    corners: Corners | None = None
    loose: Boundary  # the boundary, on which their particles slide
    curves: CurveStep | None = None  # the curved walls that slip; None without any
    # (K',) those of the sliding particles that are on curves, as positions in ``sliding``, and as ones in
    # `CurveStep.rows`
    on_curves: tuple[Array, Array]

    def __init__(self, boundary: Boundary, mesh: Mesh, particles: Particles, scheme: TimeScheme) -> None:
        self.boundary, self.loose, self.scheme, self.tank_moves = boundary, boundary, scheme, False
        self.fixed, self.frame = particles.wall, mesh.position
        self.sliding = np.zeros(0, dtype=np.int64)
        self.rows = self.columns = np.zeros((0, mesh.dimension**2))
        self.faces = Faces.none(mesh.dimension, 0)
        self._held = particles.wall.nonzero()[0]

    def constrain(self, u: Array, *, in_place: bool = False) -> Array:
        """Displacements (N, d) [m] with the walls' constraints; ``in_place``: the same array."""
        result = u if in_place else u.copy()
        result[self._held] = 0.0
        return np.asarray(result)

    def histories(self, velocity: Array, acceleration: Array) -> tuple[Array, Array]:
        """v_alpha and a_alpha (N, d) at u = 0, from those of free particles, which are changed."""
        return self.constrain(velocity, in_place=True), self.constrain(acceleration, in_place=True)

    def relative(self, u: Array) -> Array:
        """Displacements (N, d) [m] relative to the tank's motion."""
        return u

    @property
    def pose(self) -> Pose:
        """Pose of the tank at the end of the step."""
        return self.boundary.pose(0.0, 1.0)

    def lag(self) -> Array | None:
        """(N, d) dt v_alpha less the displacements of particles, where walls move them [m]; None where none do."""
        return None

    def finish(self, before: Particles, u: Array, moved: Particles) -> Particles:
        """The particles ``moved`` by a solution with displacements u, with wall particles as their walls prescribe.

        Fixed ones are held already. The arrays of ``moved`` may be changed.
        """
        return moved

    def space(self, particles: Particles, mesh: Mesh) -> tuple[Particles, int]:
        """Space the particles along walls that slip, slide or change length, at the end of a step; how many moved."""
        return particles, 0

    def set_back(self, particles: Particles) -> Particles:
        """The particles, with those of sliding no-slip walls back at their positions in the tank."""
        return particles

    def carry(self, before: Particles, particles: Particles, which: Array) -> Particles:
        """The particles at the end of a step, those that slide and no fluid moves, ``which``, as the walls go."""
        return particles

    @property
    def brinks(self) -> Array:
        """The particles over brinks and before them, see `tipfem.physics.physics.Moved.kept`."""
        return np.zeros(0, dtype=np.int64) if self.corners is None else self.corners.over

    def put_on_curves(self, position: Array, new: Array, ends: Array) -> Array:
        """Positions (N, d), with those of new particles of curved walls put there; see `CurveStep.put_there`."""
        return position if self.curves is None else self.curves.put_there(position, new, ends)

    def reassign(self, particles: Particles, mesh: Mesh, closed: Array | None) -> tuple[Particles, Boundary]:
        """Remeshed particles with the rates of the walls they lie on (2-D), but for closed gaps, and these walls."""
        return particles, self.boundary.holding(particles.wall)

    def imposed(self, particles: Particles) -> Particles:
        """The particles at the end of the step with the velocities and accelerations that their walls prescribe."""
        return particles


class WallStep(WallsInStep):
    """The walls in a step from t_n to t_n + dt: constrained unknowns u = w + P u, with the walls' own w.

    A particle that is fixed has P = 0. One that slides along a wall with the normal n at the step's end has P = I - n
    n^T and w = (c - n . x_n) n: it ends exactly on the wall's line. Its momentum row is projected with the wall's
    direction at the intermediate time, where the forces are. The particles of a no-slip wall that slides along itself
    go with it in the step, and are set back after it: other material of the wall takes their place. Were they held
    instead, the flow between the wall and the next particles would be missing from J, and a flow without net volume
    would have one of U h / 2. ``density`` (M,) of the elements [kg/m^3] is needed by walls with a layer; ``layers`` are
    at t_n, None before the first step; ``closed`` (N,) masks the particles of closed gaps, which do not slide.
    ``displacement`` (N, d) is w [m]. `SimulationError` if the walls' motions change the tank's volume.
    """

    def __init__(
        self,
        boundary: Boundary,
        mesh: Mesh,
        particles: Particles,
        viscosity: Array,
        scheme: TimeScheme,
        time: float,
        density: Array | None = None,
        layers: Layers | None = None,
        closed: Array | None = None,
    ) -> None:
        self.boundary, self.scheme, self._time = boundary, scheme, time
        boundary.require_volume(time + scheme.dt)
        self.corners, part = corners_of_walls(boundary, particles.target, mesh, closed), 0.25 * scheme.dt
        if self.corners is not None:
            boundary = loosened(boundary, self.corners, boundary.pose(time, part).rotation)
        self.loose = boundary
        if closed is not None:
            boundary = tightened(boundary, closed)
        index, slides = boundary.index, boundary.slides
        b_curves = bool(boundary.curves)
        self._before = self._after = WallMotion(boundary, time, part)
        if b_curves or not boundary.at_rest:  # with curves, what is free changes in the step
            self._after = WallMotion(boundary, time + scheme.dt, part)
        x, v, a = map(np.ascontiguousarray, (particles.position, particles.velocity, particles.acceleration))
        self.tank_moves = boundary.motion is not None
        self.frame = self._before.pose.origin(x) if self.tank_moves else x
        nothing = filled(0.0, "walls.rigid", x.shape)
        self.rigid = self._after.pose.place(self.frame) - x if self.tank_moves else nothing
        self._home = self._after.place(self.frame[index])
        middle = self._middle_of_corners(particles)
        self.curves = None
        if b_curves:
            self.curves = CurveStep(boundary, mesh, particles, self._before, self._after, scheme, middle)
        if self.curves is not None:
            self._after.free[self.curves.rows] = self.curves.projector
        w = self._home + self._slid()
        w = self._after.held(np.subtract(w, x[index], out=w))
        self.displacement = filled(0.0, "walls.displacement", x.shape)
        self.displacement[index] = w
        self.sliding, passages = index[slides], boundary.passages
        self.fixed = copied(particles.wall)
        if passages is not None:  # those that cross openings are constrained as if they slid along a wall
            self.sliding = np.concatenate([self.sliding, passages.crossing])
            self.fixed[passages.free] = False
        self.fixed[self.sliding] = False
        # Predicted positions of the wall particles, exact for the fixed ones.
        self._predicted = copied(x, "walls.predicted")
        self._move(x, v, a, self._predicted, scheme.dt, 0.5 * scheme.dt**2)
        # Prescribed ones are those of their times; generalized-alpha's a_n, which alpha_m is for, are not.
        of_walls, now = self._after.rates_at(self._predicted, v), kernels.Rates(v, a)
        self._rates = self._after.held_sums(1 - scheme.alpha_f, of_walls, scheme.alpha_f, now)
        # The rotation in between: the direction of the chords from the old positions to the new.
        self._rotation = self._after.pose.rotation
        if self.tank_moves:
            u, _, vt = np.linalg.svd(scheme.cf * self._rotation + scheme.alpha_f * self._before.pose.rotation)
            self._rotation = u @ vt
        self.rows = self.columns = picked(self._after.rows[1], slides)
        if self.tank_moves:
            self.rows = (self._rotation @ boundary.free[slides] @ self._rotation.T).reshape(self.columns.shape)
        if passages is not None:
            across = np.einsum("ki,kj->kij", passages.across, passages.across).reshape(-1, 4)
            self.rows, self.columns = np.concatenate([self.rows, across]), np.concatenate([self.columns, across])
        if self.curves is not None:
            here = np.flatnonzero(boundary.on_curve[slides] >= 0)
            self.rows[here] = self.columns[here]
            self.on_curves = here, np.searchsorted(self.curves.rows, slides[here])
        start = WallStart(
            boundary,
            scheme,
            self._before,
            self._after,
            self._rotation,
            self.frame,
            self._predicted,
            self.sliding,
            self.curves,
        )
        self.faces, self.layers, self.stuck = friction_in_step(start, mesh, particles, viscosity, density, layers)

    def _middle_of_corners(self, particles: Particles) -> tuple[Array, Array]:
        """Particles in corners, and where they are predicted to be halfway, from the corners there [m]."""
        if self.corners is None:
            return np.zeros(0, dtype=np.int64), np.zeros((0, 2))
        i, along = self.corners.particles, self.corners.along
        moved = self.scheme.predict(particles.velocity[i], particles.acceleration[i]) - self.rigid[i]
        return i, 0.5 * (moved * along).sum(axis=1)[:, None] * along

    def _move(self, start: Array, one: Array, other: Array, result: Array, of_one: float, of_other: float) -> None:
        """Set positions (N, d) of the wall particles, that slide by a sum of multiples of two fields (N, d)."""
        fields = map(np.ascontiguousarray, (start, self.displacement, one, other))
        launch(kernels.move, *self._after.rows, *fields, result, of_one, of_other, result.shape[1])

    def _slide(self, values: Array, held: Array, of_held: float, of_walls: float) -> None:
        """Set values (N, d) of the wall particles, see `kernels.slide`."""
        given = values, held, self.displacement, of_held, of_walls
        launch(kernels.slide, *self._after.rows, *given, values.shape[1])

    def _slid(self) -> Any:
        """Displacements (W, d) of the wall particles along walls that slide [m]; 0 where none does."""
        b = self.boundary
        if b.at_rest or not (self._before.sliding.any() or self._after.sliding.any()):
            return 0.0
        slid = 0.5 * self.scheme.dt * (self._before.sliding + self._after.sliding)
        # On an arc, the particle turns about the centre by as much: along a chord, not along the tangent.
        angle = np.linalg.norm(slid, axis=1) * np.linalg.norm(b.curvature, axis=1)
        turns = np.flatnonzero(angle > 0)
        inwards = b.curvature[turns] / (b.curvature[turns] ** 2).sum(axis=1)[:, None]  # to the centre
        cosine, sine = np.cos(angle[turns])[:, None], np.sin(angle[turns])[:, None]
        radius = np.linalg.norm(inwards, axis=1)[:, None]
        along = slid[turns] / np.linalg.norm(slid[turns], axis=1)[:, None]
        slid[turns] = (1 - cosine) * inwards + sine * radius * along
        return slid @ self._after.pose.rotation.T

    def constrain(self, u: Array, *, in_place: bool = False) -> Array:
        """Displacements (N, d) with their walls' constraints: w + P u; ``in_place``: the same array."""
        result = u if in_place else u.copy()
        self._slide(result, self._rates.velocity, 0.0, 1.0)
        return np.asarray(result)

    def histories(self, velocity: Array, acceleration: Array) -> tuple[Array, Array]:
        """v_alpha and a_alpha (N, d) at u = 0, from those of free particles, which are changed.

        In the constrained directions they are the walls' own less cv w and cm w.
        """
        if self.curves is not None:
            velocity, acceleration = self.curves.turned(velocity), self.curves.turned(acceleration)
        self._slide(velocity, self._rates.velocity, 1.0, -self.scheme.cv)
        self._slide(acceleration, self._rates.acceleration, 1.0, -self.scheme.cm)
        return velocity, acceleration

    def relative(self, u: Array) -> Array:
        """See `WallsInStep.relative`."""
        return np.asarray(u - self.rigid)

    @property
    def pose(self) -> Pose:
        """See `WallsInStep.pose`."""
        return self._after.pose

    def lag(self) -> Array | None:
        """See `WallsInStep.lag`."""
        b = self.boundary
        if b.at_rest:
            return None
        result, on = np.zeros_like(self.displacement), b.index[b.on_side.any(axis=1)]
        velocity = np.zeros_like(result)
        velocity[b.index] = self._rates.velocity
        result[on] = self.scheme.dt * velocity[on] - self.displacement[on]
        return result

    def finish(self, before: Particles, u: Array, moved: Particles) -> Particles:
        """See `WallsInStep.finish`."""
        index = self.boundary.index
        if self.curves is not None:
            before = before.shallow_copy(
                velocity=self.curves.turned(before.velocity), acceleration=self.curves.turned(before.acceleration)
            )
        fields = {"walls.u": u, "walls.v": before.velocity, "walls.a": before.acceleration}
        velocity, acceleration = self.scheme.rates(*(picked(values, index, name) for name, values in fields.items()))
        done = moved
        # Not x + u: in single precision the solution's w is not exact.
        self._move(before.position, u, u, done.position, 1.0, 0.0)
        if self.curves is not None:  # whose directions corrections have changed
            curved = index[self.curves.rows]
            done.position[curved] = before.position[curved] + u[curved]
        done.acceleration[index], done.velocity[index] = acceleration, velocity
        if self.curves is not None:
            done, free_at_end = self.curves.finished(done)
            self._after.free[self.curves.rows] = free_at_end
        return self._after.imposed(done, in_place=True)

    def space(self, particles: Particles, mesh: Mesh) -> tuple[Particles, int]:
        """See `WallsInStep.space`."""
        slides, b = self.boundary.sliding >= 0, self.boundary
        particles = self._cornered(particles)
        if self.curves is not None:
            particles = self.curves.on_curves(particles)
        on_faces = b.slides if b.dimension == 3 else b.slides[:0]
        if not b.pieces and not slides.any() and not b.period and not len(on_faces):
            return particles, 0
        spaced, count = particles.copy(), 0
        if len(on_faces):
            count += back_to_places(spaced, mesh, b.index[on_faces], self._after.places[on_faces])
        for row in self.boundary.endless:
            count += space_endless(spaced, row, self.boundary.period)
        for piece, coordinates in self.boundary.pieces:
            if coordinates is None:
                count += space_sliding(spaced, piece, mesh)
            else:
                space_back(spaced, piece, coordinates)
        spaced = self.set_back(spaced, in_rows=False)
        dry = mesh.dry(particles.wall)  # these stay where they are
        spaced.velocity[dry] = self._after.pose.rigid_velocity(spaced.position[dry])
        spaced.acceleration[dry] = self._after.pose.rigid_acceleration(spaced.position[dry])
        return self._after.imposed(spaced), count

    def set_back(self, particles: Particles, *, in_rows: bool = True) -> Particles:
        """See `WallsInStep.set_back`; without ``in_rows``, not those in rows that are evenly spaced."""
        slides = self.boundary.sliding >= 0
        slides[self.boundary.slides] = False
        if not in_rows:  # the others are at corners of arcs, on periodic sides, and in 3-D
            slides &= ~np.isin(self.boundary.index, [i for row, _ in self.boundary.pieces for i in row])
        particles = self._cornered(particles)
        if self.curves is not None:
            particles = self.curves.on_curves(particles)
        if not slides.any():
            return particles
        back = particles.copy()
        back.position[self.boundary.index[slides]] = self._home[slides]
        return back

    def _cornered(self, particles: Particles) -> Particles:
        """The particles at the end of the step, with those of corners there again."""
        corners = self.corners
        if corners is None:
            return particles
        place, pose = self._home[np.searchsorted(self.boundary.index, corners.particles)], self._after.pose
        x, directions = self.frame, np.zeros_like(particles.position)
        for beside, sign in ((corners.before, 1.0), (corners.after, -1.0)):
            wet = beside >= 0
            way = sign * self.boundary.period.shortest(x[corners.particles[wet]] - x[beside[wet]])
            directions[beside[wet]] = way / np.linalg.norm(way, axis=1, keepdims=True) @ pose.rotation.T
        directions[corners.particles] = corners.along @ self._before.pose.rotation @ pose.rotation.T

        def rates(x: Array) -> tuple[Array, Array]:
            return pose.rigid_velocity(x), pose.rigid_acceleration(x)

        return put_back(corners, place, directions, rates, particles)

    def carry(self, before: Particles, particles: Particles, which: Array) -> Particles:
        """See `WallsInStep.carry`."""
        index = self.boundary.index
        here = self.boundary.slides[which[index[self.boundary.slides]]]
        if not len(here):
            return particles
        result, moved = particles.copy(), index[here]
        result.position[moved] = before.position[moved] + self.constrain(self.rigid)[moved]
        if self.curves is not None:
            result.position[:] = self.curves.projected(result.position, which)
        x = result.position[index]
        own = self._after.rates(x, np.zeros_like(x))[0]
        velocity, acceleration = self._after.rates(x, own)
        result.velocity[moved], result.acceleration[moved] = velocity[here], acceleration[here]
        return result

    def reassign(self, particles: Particles, mesh: Mesh, closed: Array | None) -> tuple[Particles, Boundary]:
        """See `WallsInStep.reassign`; what slides round corners keeps its velocity along their directions."""
        boundary = self.boundary.reassigned(particles, self._after.pose, self._after.displacement)
        rates = self._after
        if boundary.free is not self.boundary.free or not boundary.at_rest:
            rates = WallMotion(boundary, self._time + self.scheme.dt, 0.25 * self.scheme.dt)
        done = rates.imposed(particles)
        corners = None if self.corners is None else corners_of_walls(boundary, particles.target, mesh, closed)
        if corners is not None:
            done, i, along = done.copy(), corners.particles, corners.along
            for name in ("velocity", "acceleration"):
                values = getattr(done, name)
                values[i] += ((getattr(particles, name)[i] - values[i]) * along).sum(axis=1)[:, None] * along
        return done, boundary

    def imposed(self, particles: Particles) -> Particles:
        """See `WallsInStep.imposed`."""
        return self._after.imposed(particles)
