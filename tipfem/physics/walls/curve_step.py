"""Curved walls that slip, in a time step: the directions in which particles slide, and where they are at its end.

The first iterate of a particle on a curve is along the direction from the particle before it to that after it, at the
positions predicted for the middle of the step. Then the boundary encloses the same area at the end of the step as at
its start: the area is quadratic in the positions, so that its change is that of the middle, n_i . u_i. Corrections are
along that direction at the end of the step, to which the derivative of the area is at right angles.

So the area of iterates differs from that at the start by what is quadratic in the corrections. In a closed tank no
motion of the fluids can give or take it, and no pressure: the equations of continuity, whose sum it is, would have no
solution, and the level of the pressure would grow without bound. There the elements grow by it, all alike. It is
removed after the step, when the particles are put on the curve.
"""

from __future__ import annotations

import numpy as np

from tipfem.case.boundary.boundary import ON_SIDE, Boundary
from tipfem.case.particles import Particles
from tipfem.fem.time_integration import TimeScheme
from tipfem.geometry.plane.curves import chain_tangents, outward_normals, restored, spread
from tipfem.geometry.plane.domain import Domain
from tipfem.mesh.mesh import Mesh, as_far_as_cells_bear
from tipfem.physics.walls.motion import WallMotion
from tipfem.typing import Array


class CurveStep:
    """The curves of a boundary in a step.

    Args:
        boundary: at the start of the step.
        particles: at its start.
        before: motion of the walls at its start.
        after: the same at its end.
        corners: particles in corners that slide, and by how much they are off these in the middle (L, 2) [m].

    Attributes:
        rows: (K,) the particles on curves, as positions in `Boundary.index`.
        particles: (K,) their numbers; along: (K, 2) unit vectors along which they slide in the step.
        projector: (K, 2, 2) on these directions.
        middle: (N, 2) positions predicted for the middle of the step [m].
        pressed: (E, 2) the faces of the mesh on curves, with the fluid on the left.
        cell: (E,) the cells at these faces.
        curve: (E,) the number of the curve.
    """

    def __init__(
        self,
        boundary: Boundary,
        mesh: Mesh,
        particles: Particles,
        before: WallMotion,
        after: WallMotion,
        scheme: TimeScheme,
        corners: tuple[Array, Array],
    ) -> None:
        self._boundary, self._after, self._position = boundary, after, particles.position
        self._mesh, self._spacing = mesh, particles.spacing
        self.rows = np.flatnonzero(boundary.on_curve >= 0)
        self.particles = index = boundary.index[self.rows]
        cell, _, *pair = mesh.hull
        self._pairs = np.stack(pair, axis=1)
        self._walls = boundary.walled(self._pairs)
        # Where a free surface begins on a wall, or spans a corner, its faces are no part of the wall.
        y, count = before.pose.origin(particles.position[boundary.index]), len(particles)
        chains = [boundary.index[boundary.chain(k, y)] for k in range(len(boundary.curves))]
        of_curve = np.repeat(np.arange(len(chains)), [len(chain) for chain in chains])
        numbers = np.array([1, count])
        key, own = self._pairs @ numbers, np.concatenate(chains) @ numbers
        here, order = np.flatnonzero(np.isin(key, own)), np.argsort(own)
        self.pressed, self.cell = np.ascontiguousarray(self._pairs[here]).astype(np.int32), cell[here]
        self.curve = of_curve[order[np.searchsorted(own[order], key[here])]]
        self._start = self._tangents(before.pose.origin(particles.position[index])) @ before.pose.rotation.T
        along = (scheme.predict(particles.velocity[index], particles.acceleration[index]) * self._start).sum(axis=1)[
            :, None
        ]
        middle = particles.position.copy()
        walls = boundary.index
        middle[walls] = 0.5 * (
            before.place(before.pose.origin(middle[walls])) + after.place(before.pose.origin(middle[walls]))
        )
        middle[index] += 0.5 * along * self._start
        middle[corners[0]] += corners[1]
        # Beside a free surface, and where it is dry, as the curve.
        both = np.isin(index, self.pressed[:, 0]) & np.isin(index, self.pressed[:, 1])
        self.middle, self.along = middle, self._start.copy()
        self.along[both] = chain_tangents(middle, self.pressed, index[both], boundary.period)
        self.projector = self.along[:, :, None] * self.along[:, None, :]

    def growth(self, u: Array) -> float:
        """Change of the area that the boundary encloses by displacements u (N, 2), but for what passes it [m^2]."""
        period, (a, b) = self._boundary.period, self._walls.T
        x = self._position + 0.5 * u
        if period.axial:  # by Simpson's rule: the volume is cubic in the positions
            ends = outward_normals(self._position, self._walls, period)
            ends += outward_normals(self._position + u, self._walls, period)
            return float(((ends + 4 * outward_normals(x, self._walls, period)) * u).sum()) / 6
        side = x[b] - x[a]
        # n_i . u_i with the normals in the middle, from both faces of each particle: exact, and without cancellation.
        return 0.5 * float((side[:, 1] * (u[a, 0] + u[b, 0]) - side[:, 0] * (u[a, 1] + u[b, 1])).sum())

    def projector_at(self, u: Array) -> Array:
        """(K, 2, 2) on the directions along which displacements from u (N, 2) [m] keep that area."""
        along = chain_tangents(self._position + u, self._pairs, self.particles, self._boundary.period)
        return np.asarray(along[:, :, None] * along[:, None, :])

    def _tangents(self, y: Array) -> Array:
        """Unit vectors (K, 2) along the curves at points y (K, 2) of their particles, in the tank's frame."""
        result: Array = np.empty_like(y)
        number = self._boundary.on_curve[self.rows]
        for k, curve in enumerate(self._boundary.curves):
            result[number == k] = curve.tangent(y[number == k])
        return result

    def turned(self, vectors: Array) -> Array:
        """Vectors (N, 2) with those on curves turned from the direction at the start to that of the step."""
        result: Array = vectors.copy()
        along = (vectors[self.particles] * self._start).sum(axis=1)[:, None]
        result[self.particles] = along * self.along
        return result

    def finished(self, done: Particles) -> tuple[Particles, Array]:
        """The state ``done`` at the end of the step, moved along the curves; with the projectors (K, 2, 2) there."""
        pose, index = self._after.pose, self.particles
        tangent = self._tangents(pose.origin(done.position[index])) @ pose.rotation.T
        velocity, acceleration = done.velocity.copy(), done.acceleration.copy()
        for values in (velocity, acceleration):
            values[index] = (values[index] * self.along).sum(axis=1)[:, None] * tangent
        moved = done.shallow_copy(velocity=velocity, acceleration=acceleration)
        return moved, tangent[:, :, None] * tangent[:, None, :]

    def on_curves(self, particles: Particles) -> Particles:
        """The particles put on their curves, in a closed tank so that the boundary encloses the area of the domain."""
        pose, index = self._after.pose, self.particles
        number, position = self._boundary.on_curve[self.rows], particles.position.copy()
        y, walls = position.copy(), self._boundary.index
        y[walls] = pose.origin(position[walls])
        for k, curve in enumerate(self._boundary.curves):
            mine = index[number == k]
            y[mine] = curve.project(y[mine])
            on = np.zeros(len(position), dtype=bool)
            on[mine] = True
            y = spread(y, self.pressed[self.curve == k], curve, on)
        position[index] = pose.place(y[index])
        on = np.zeros(len(position), dtype=bool)
        on[index] = True
        position = as_far_as_cells_bear(self._mesh, particles.position, position, on)
        if self._mesh.surface.exists:  # the boundary of the fluid is not that of the domain
            return particles.shallow_copy(position=position)
        domain = self._boundary.domain
        assert isinstance(domain, Domain)
        period = self._boundary.period
        start = self._boundary.closed(position, self._position)
        closed = restored(start, self._pairs, on, domain.measure(period), period)
        return particles.shallow_copy(position=np.where(on[:, None], closed, position))

    def projected(self, position: Array, among: Array) -> Array:
        """Positions (N, 2) at the end of the step, with those on curves of a mask (N,) put there."""
        pose, goal, number = self._after.pose, position.copy(), self._boundary.on_curve[self.rows]
        for k, curve in enumerate(self._boundary.curves):
            mine = self.particles[(number == k) & among[self.particles]]
            goal[mine] = pose.place(curve.project(pose.origin(position[mine])))
        return as_far_as_cells_bear(self._mesh, position, goal, among)

    def put_there(self, position: Array, new: Array, ends: Array) -> Array:
        """Positions (N, 2) at the end of the step, with new particles (K,) of curves, on chords, put there.

        ``ends`` (K, 2) are the particles before and after each of them along the boundary that are not new.
        """
        boundary, pose, position = self._boundary, self._after.pose, position.copy()
        on, at_end = np.zeros((2, len(position)), dtype=bool)
        for k, curve in enumerate(boundary.curves):
            on[:] = at_end[:] = False
            on[boundary.index[boundary.on_curve == k]] = True
            walls = boundary.index
            at_end[walls] = curve.at_ends(pose.origin(position[walls]), ON_SIDE * self._spacing)
            mine = new[(on | at_end)[ends].all(axis=1) & on[ends].any(axis=1)]
            position[mine] = pose.place(curve.project(pose.origin(position[mine])))
        return position
