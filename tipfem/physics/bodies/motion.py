"""Rigid bodies between two steps and in a step: their motion, and that of the particles on them; in two dimensions.

A body has a reference point c and an angle; a particle on it is at c + r, and turns with it. Three numbers per body, in
x, y and the angle, are its position, velocity and acceleration.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from tipfem.case.body import FREEDOMS, Body
from tipfem.case.boundary.passed import put_before
from tipfem.case.particles import Particles
from tipfem.case.walls import Pose
from tipfem.fem.time_integration import TimeScheme, lasting
from tipfem.geometry.plane.domain import Domain
from tipfem.geometry.plane.vectors import complexes, nonzero, turned, turning
from tipfem.mesh.mesh import Mesh, as_far_as_cells_bear
from tipfem.physics.bodies.outlines import Outline, body_faces, chain_directions, put_back, with_new
from tipfem.physics.carried import Carried, Remap
from tipfem.physics.contact.forces import Contacts, Trial
from tipfem.typing import Array

# A wall particle closer than this to the outline of a body is on the body [spacings].
ON_BODY = 1e-5
# Columns of the history for a body, after its name.
COLUMNS = (
    *("x", "y", "angle"),
    *("velocity_x", "velocity_y", "angular_velocity"),
    *("force_x", "force_y", "moment"),
)
# The same where bodies that float may touch.
CONTACT_COLUMNS = ("contact_force_x", "contact_force_y", "contact_moment", "gap_force_x", "gap_force_y", "touches")

Outlines = Mapping[int, Outline]  # by the numbers of their bodies


@dataclass(frozen=True)
class BodyStates(Carried):
    """The bodies of a simulation between two steps."""

    moves = True

    label: Array  # (N,) number of the body that each particle is on, -1 for none, int32
    position: Array  # (B, 3) of the bodies [m, m, rad]
    velocity: Array  # (B, 3) [m/s, m/s, rad/s]
    acceleration: Array  # (B, 3) [m/s^2, m/s^2, rad/s^2]
    held: Array  # (B,) mask of the bodies that a contact has fixed
    # (B, 3) force [N/m] and moment about the reference point [N] of the fluids, at the intermediate time of the last
    # step
    force: Array
    work: Array  # (B,) of the fluids on the bodies in the last step [J, per metre of depth]
    middle: Array  # (B, 3) a_alpha, the acceleration at that time [m/s^2, m/s^2, rad/s^2]
    along: Array  # (N, 2) unit vectors along the outlines at the particles that slide on them, 0 for all others
    # on outlines with that law, None without any; begun: whether they have begun
    boundary_layers: Carried | None = None
    begun: bool = False
    stuck: Array | None = None  # (N,) mask of the particles at which these are resolved; None without any
    in_gaps: Array | None = None  # (N,) mask of the particles of closed gaps; None without any
    full: bool = False  # see `Carried`
    # (K, 4) particles in corners that slide, see `tipfem.physics.bodies.corners`, those before and after them on the
    # outline, -1 where it is dry, and the numbers of the corners; None without any
    corners: Array | None = None
    contacts: Contacts | None = None  # of bodies that float and may touch, in the last step; None without any
    # (3,) kinetic energy [J/m] and momentum [N s/m] that the fluid of gaps had which opened in the last remeshing
    handed: Array | None = None
    trial: Trial | None = None  # those of a step that is being solved; None between two steps

    @classmethod
    def start(
        cls, bodies: Sequence[Body], particles: Particles, label: Array, step: float, outlines: Outlines
    ) -> BodyStates:
        """The bodies at t = 0; ``label`` (N,) number of the body that each particle is on, -1 for none."""
        rows = np.zeros((3, len(bodies), 3))
        for b, body in enumerate(bodies):
            rows[:, b] = body.prescribed(0.0, step)
            if body.floats:
                rows[1, b] = *body.velocity, body.angular_velocity
        position, velocity, acceleration = rows
        return cls(
            label.astype(np.int32),
            position,
            velocity,
            acceleration,
            held=np.zeros(len(bodies), dtype=bool),
            force=np.zeros((len(bodies), 3)),
            work=np.zeros(len(bodies)),
            middle=np.zeros((len(bodies), 3)),
            along=np.zeros((len(label), 2)),
        ).with_directions(outlines, particles)

    def lasting(self, end: BodyStates) -> BodyStates:
        """See `Carried.lasting`: translations and rotations apart, and nothing of bodies that touch."""
        ways = (slice(0, 2), slice(2, 3))
        rows = np.hstack([lasting(self.acceleration[:, way], end.middle[:, way]) for way in ways])
        if end.contacts is not None:
            rows[end.contacts.touches(len(rows)) > 0] = 0.0
        return replace(self, acceleration=rows)

    def with_directions(self, outlines: Outlines, particles: Particles) -> BodyStates:
        """The same with the directions in which particles slide, where they are now."""
        along = np.zeros((len(self.label), 2))
        for b, outline in outlines.items():
            index = np.flatnonzero(self.label == b)
            r = particles.position[index] - self.position[b, :2]
            _, tangent = outline.number(outline.reference + unturned(r, self.position[b, 2]), particles.spacing)
            along[index] = tangent + rotated(tangent, self.position[b, 2])
        return replace(self, along=along, stuck=None)

    @property
    def poses(self) -> Array:  # type: ignore[override]
        """See `Carried`."""
        return self.position

    @property
    def slides(self) -> Array:
        """(N,) mask of the particles that slide."""
        return nonzero(self.along)

    def arms(self, x: Array) -> tuple[Array, Array, Array]:
        """Particles (K,) on bodies, the bodies' numbers (K,), and r (K, 2) of the positions x (N, 2) [m]."""
        index = np.flatnonzero(self.label >= 0)
        of = self.label[index]
        return index, of, x[index] - self.position[of, :2]

    def imposed(self, particles: Particles) -> Particles:
        """The particles, those on bodies with the velocities and accelerations of the bodies, but for what slides."""
        index, of, r = self.arms(particles.position)
        velocity, acceleration, t = particles.velocity.copy(), particles.acceleration.copy(), self.along[index]
        for values, own in zip(
            (velocity, acceleration), rigid_rates(r, self.velocity[of], self.acceleration[of]), strict=True
        ):
            values[index] = own + component(values[index] - own, t)
        return particles.shallow_copy(velocity=velocity, acceleration=acceleration)

    def remeshed(self, bodies: Sequence[Body], particles: Particles, remap: Remap, outlines: Outlines) -> BodyStates:
        """The same bodies on remeshed particles, of which those along straight edges of the bodies may be others."""
        label, numbers = self.label, remap.renumbered
        if numbers is not None:
            kept = np.flatnonzero((numbers >= 0) & (label >= 0))
            label = np.full(len(particles), -1, dtype=np.int32)
            label[numbers[kept]] = self.label[kept]
        moved = np.flatnonzero(remap.relocated & (particles.wall | (label >= 0)))
        if len(moved):
            label = label.copy()
            label[moved] = -1
            if outlines:
                label = with_new(label, moved[particles.wall[moved]], remap.mesh)
            for b, body in enumerate(bodies):
                at_start = unturned(particles.position[moved] - self.position[b, :2], self.position[b, 2])
                on = body.distance(at_start + body.reference) < ON_BODY * particles.spacing
                label[moved[on & particles.wall[moved]]] = b
        new = self if label is self.label else replace(self, label=label, along=np.zeros((len(label), 2)))
        return new.with_directions(outlines, particles) if outlines else new


def body_pose(body: Body, states: BodyStates, number: int) -> Pose:
    """The motion of a body from where it is at t = 0."""
    (x, y, angle), (u, v, w), (a, b, c) = (
        of[number].tolist() for of in (states.position, states.velocity, states.acceleration)
    )
    across = np.array([[0.0, -1.0], [1.0, 0.0]])
    return Pose(
        np.asarray(body.reference, dtype=float),
        np.array([x, y]),
        turning(-angle),
        w * across,
        c * across,
        np.array([u, v]),
        np.array([a, b]),
    )


def outline_of(body: Body) -> Domain:
    """The region that a body covers at t = 0."""
    count = len(body.corners)
    return Domain([body.corners], [[body.name] * count], [[-1] * count])


def placed(body: Body, states: BodyStates, number: int) -> Domain:
    """The region that a body covers."""
    outline = outline_of(body)
    return outline.with_corners(body_pose(body, states, number).place(outline.start))


def stopped_by_bodies(bodies: Sequence[Body], states: BodyStates, particles: Particles, loose: Array) -> Particles:
    """The particles, with ``loose`` ones (N,) that have flown into a body put back in front of it."""
    for number, body in enumerate(bodies):
        index = np.flatnonzero(loose)
        if not len(index):
            break
        pose, outline = body_pose(body, states, number), outline_of(body)
        y = pose.origin(particles.position[index])
        inside = outline.contains(y)
        if inside.any():
            particles = put_before(particles, index[inside], y[inside], outline, pose, -1.0)
    return particles


def on_outlines(
    states: BodyStates, outlines: Outlines, particles: Particles, mesh: Mesh, *, closed: bool
) -> tuple[Particles, Array]:
    """The particles at the end of a step, those on curves of outlines put back there, and the mask (N,) of these.

    So bodies keep their area. New ones are on chords, and go as far as their cells bear in a step. Fluids surround all
    bodies if ``closed``.
    """
    position, moves = particles.position.copy(), np.zeros(len(particles), dtype=bool)
    for b, outline in outlines.items():
        index = np.flatnonzero((states.label == b) & states.slides)
        if outline.curved and len(index):
            pose_of = states.position[b]
            y = outline.reference + unturned(position[index] - pose_of[:2], pose_of[2])
            number, _ = outline.number(y, particles.spacing)
            moves[index] = outline.several(number)
            r = outline.project(y, number) - outline.reference
            here = outline.several(number)
            position[index[here]] = (pose_of[:2] + r + rotated(r, pose_of[2]))[here]
    position = as_far_as_cells_bear(mesh, particles.position, position, moves)
    if closed:
        faces = body_faces(mesh, states.label)[0]
        position = put_back(position, faces, moves, states.label, outlines)
    return particles.shallow_copy(position=position), moves


def put_on_outlines(states: BodyStates, outlines: Outlines, position: Array, new: Array, ends: Array) -> Array:
    """Positions (N, 2), with those of new particles on curves of outlines put there; see `Physics.put_on_curves`."""
    label, position = np.full(len(position), -1), position.copy()
    label[: len(states.label)] = states.label
    label[new] = -1
    one, other = label[ends].T
    for b, outline in outlines.items():
        mine = new[(one == b) & (other == b)]
        if outline.curved and len(mine):
            x, y, angle = states.position[b]
            at_start = outline.reference + unturned(position[mine] - [x, y], angle)
            r = outline.project(at_start, outline.number(at_start, 0.0)[0]) - outline.reference
            position[mine] = [x, y] + r + rotated(r, angle)
    return position


def rigid_rates(r: Array, velocity: Array, acceleration: Array) -> tuple[Array, Array]:
    """Velocities and accelerations (K, 2) at r (K, 2), of bodies with these rates (K, 3)."""
    w, side = velocity[:, 2:], turned(r)
    return velocity[:, :2] + w * side, acceleration[:, :2] + acceleration[:, 2:] * side - w * w * r


def unturned(r: Array, angle: float) -> Array:
    """Vectors (K, 2) turned back by an angle [rad]."""
    return np.asarray(r @ turning(-angle))


def component(values: Array, along: Array) -> Array:
    """The components of vectors (K, 2) along unit vectors (K, 2), or zeros."""
    return np.asarray((values * along).sum(axis=1)[:, None] * along)


def rotated(r: Array, angle: Array | float) -> Array:
    """The change (K, 2) of r (K, 2) by rotations, ``angle`` (K,) or one [rad]; without loss of digits at small ones."""
    factor = np.empty(np.shape(angle), dtype=complex)
    factor.real, factor.imag = -2 * np.sin(0.5 * angle) ** 2, np.sin(angle)
    return np.asarray((factor * complexes(r)).view(float).reshape(r.shape))


class BodyMotion:
    """The bodies in a step: their particles are placed by the bodies' motions.

    A particle that slides has slid by R s relative to the body at the end of the step, where R is the body's rotation
    in it; along the outline its velocity and acceleration are those of any particle.

    Args:
        states: of the bodies at the start of the step.
        particles: at the start of the step.
        time: at the start of the step [s].

    Attributes:
        index: (K,) the particles on bodies, of: (K,) their bodies, arm: (K, 2) from the reference points [m].
        floating: (B,) mask of the bodies that the fluids move.
        free: (B, 3) mask of the unknowns among their increments.
        increment: (B, 3) motion of the bodies in the step: prescribed, and for bodies that float that at constant
            acceleration.
        along: (K, 2) directions in which the particles slide in the step, without R; 0 for those that do not.
        slid: (K, 2) s, at first as predicted [m].
        slides: (K,) mask of those that slide, curved: (K,) of those on curves of several edges, in_corners: (K,) of
            those that slide round corners.
        middle: (N, 2) positions of particles, those that slide as predicted for the middle of the step, with the bodies
            where they were [m].
        faces: (E, 2) the faces on bodies, see `tipfem.physics.bodies.outlines.body_faces`; cell: (E,) their cells.
        after: the bodies at the end of the step; of those that float, see `solved`.
        lag: see `tipfem.physics.term.TermWork`, of those that are moved; set by `measured`.

    Raises:
        ValueError: a function of time returns an invalid value.
    """

    def __init__(
        self,
        scheme: TimeScheme,
        bodies: Sequence[Body],
        states: BodyStates,
        particles: Particles,
        time: float,
        mesh: Mesh,
        outlines: Outlines,
    ) -> None:
        self.scheme, self.bodies, self.states, dt = scheme, bodies, states, scheme.dt
        self.index, self.of, self.arm = states.arms(particles.position)
        self.floating = np.array([body.floats for body in bodies]) & ~states.held
        self.free = np.array([[f in body.freedoms for f in FREEDOMS] for body in bodies]) & self.floating[:, None]
        self.increment = np.where(self.free, scheme.predict(states.velocity, states.acceleration), 0.0)
        velocity, acceleration, self._middle = np.zeros((3, *self.increment.shape))
        for b, body in enumerate(bodies):
            if not body.floats and not states.held[b]:
                place, velocity[b], acceleration[b] = body.prescribed(time + dt, 0.25 * dt)
                self.increment[b] = place - states.position[b]
                self._middle[b] = body.prescribed(time + scheme.cf * dt, 0.25 * dt)[2]
        place = states.position + self.increment
        self.after = replace(states, position=place, velocity=velocity, acceleration=acceleration)
        self._predicted = self.increment.copy()
        self._slide(particles, mesh, outlines)

    def begin_with(self, trial: Trial) -> None:
        """Take contacts, and the increments and slips with which they begin, in place of those predicted."""
        self.after = replace(self.after, trial=trial)
        if trial.begins is not None:
            self.increment = np.where(self.free, trial.begins[0], self.increment)
            self._predicted = self.increment.copy()
            if trial.begins[1] is not None:
                self.slid[:] = self._slid[:] = trial.begins[1]
            self._forget()

    def _slide(self, particles: Particles, mesh: Mesh, outlines: Outlines) -> None:
        """Set how the particles slide, as predicted."""
        states, index, scheme = self.states, self.index, self.scheme
        start = states.along[index]
        self._slid = np.zeros_like(start)
        self.slides, self.slid = np.asarray(start.any(axis=1)), np.zeros_like(start)
        self.along, self.curved, self.in_corners = start.copy(), *np.zeros((2, len(index)), dtype=bool)
        self.faces, self.cell = np.zeros((0, 2), dtype=np.int64), np.zeros(0, dtype=np.int64)
        if not self.slides.any():
            return
        own = rigid_rates(self.arm, states.velocity[self.of], states.acceleration[self.of])
        relative = [
            component(getattr(particles, name)[index] - values, start)
            for name, values in zip(("velocity", "acceleration"), own, strict=True)
        ]
        self.slid = scheme.predict(relative[0], relative[1])
        self.faces, self.cell = body_faces(mesh, states.label)
        self.middle = particles.position.copy()
        self.middle[index] += 0.5 * self.slid
        for b, outline in outlines.items():
            mine = np.flatnonzero((self.of == b) & self.slides)
            y = outline.reference + unturned(self.arm[mine], states.position[b, 2])
            self.curved[mine] = outline.several(outline.number(y, particles.spacing)[0])
        if self.curved.any():
            here = np.flatnonzero(self.curved)
            self.along = start.copy()
            self.along[here] = chain_directions(self.middle, self.faces, index[here], start[here])
            self.along[here] *= np.sign((self.along[here] * start[here]).sum(axis=1))[:, None]
        # Relative to the body, velocities keep their size where the outline bends.
        turn = self.along - start
        self._velocity, self._acceleration = (
            getattr(particles, name)[index] + (values * start).sum(axis=1)[:, None] * turn
            for name, values in zip(("velocity", "acceleration"), relative, strict=True)
        )
        self.slid += (self.slid * start).sum(axis=1)[:, None] * turn
        self._slid = self.slid.copy()
        if states.corners is not None:
            self.in_corners = np.isin(index, states.corners[(states.corners[:, 1:3] >= 0).all(axis=1), 0])

    def _forget(self) -> None:
        """Forget what follows from predicted increments, slips and their directions."""
        for name in ("row_slid", "levers", "turned_arms", "row_along"):
            self.__dict__.pop(name, None)

    @cached_property
    def row_slid(self) -> Array:
        """(K, 2) how far they slide, as predicted at first, with the bodies' rotations then [m]."""
        return self._slid + rotated(self._slid, self._predicted[self.of, 2])

    def slip_history(self) -> Array:
        """(K,) v_alpha along `row_along` relative to the bodies, where nothing slides in the step [m/s]."""
        states, s = self.states, self.scheme
        if not self.slides.any():
            return np.zeros(len(self.index))
        own = s.history(states.velocity, states.acceleration)[0]
        # Of bodies whose motion is prescribed, the rates do not follow from the increments.
        middle = s.alpha_f * states.velocity + s.cf * self.after.velocity
        own = np.where(self.floating[:, None], own, middle - s.cv * self.increment)[self.of]
        # A slip times cv has the velocity that a displacement gives: it is not that of a rotation.
        q = self.increment[self.of]
        relative = self.free_histories()[0] - self.levered(own) + s.cv * (self.rigid(q) - self.levered(q))
        return np.asarray((relative * self.row_along).sum(axis=1))

    def slips(self) -> Array:
        """(K,) how far the particles have slid along `row_along` [m]."""
        q = self.increment[self.of]
        return np.asarray(((self.displacements(self.increment) - self.rigid(q)) * self.row_along).sum(axis=1))

    def rigid(self, q: Array) -> Array:
        """Displacements (K, 2) of the bodies where the particles are at the start, by increments (K, 3) of these."""
        return np.asarray(q[:, :2] + rotated(self.arm, q[:, 2]))

    def linear(self, q: Array) -> Array:
        """The same displacements as the equations of slips have them: linear in q from the increments predicted on."""
        change = q - self._predicted[self.of]
        moved = self.rigid(self._predicted[self.of]) + change[:, :2] + change[:, 2:] * turned(self.turned_arms)
        return np.asarray(moved)

    def solved_slips(self) -> Array:
        """(K,) the slips of these equations [m]."""
        moved = self.displacements(self.increment) - self.linear(self.increment[self.of])
        return np.asarray((moved * self.row_along).sum(axis=1))

    def levered(self, rate: Array) -> Array:
        """(K, 2) of rates (K, 3) of the bodies at the places where forces along outlines act on them."""
        return np.asarray(rate[:, :2] + rate[:, 2:] * turned(self.levers))

    @cached_property
    def levers(self) -> Array:
        """(K, 2) from the reference points to these places: at the intermediate time, as predicted [m]."""
        return self.arm + self.scheme.cf * (self.turned_arms - self.arm + self.row_slid)

    @cached_property
    def turned_arms(self) -> Array:
        """(K, 2) arms turned with the bodies as predicted [m]."""
        return self.arm + rotated(self.arm, self._predicted[self.of, 2])

    def free_histories(self) -> tuple[Array, Array]:
        """v_alpha and a_alpha (K, 2) at u = 0 of the particles on bodies, as if they were free."""
        return self.scheme.history(self._velocity, self._acceleration)

    def hold(self, mask: Array) -> None:
        """Hold the particles of a mask (N,) on their bodies: they do not slide in the step."""
        here = self.slides & mask[self.index]
        for values in (self.along, self.slid, self._slid):
            values[here] = 0.0
        self._forget()
        self.slides, self.curved, self.in_corners = (of & ~here for of in (self.slides, self.curved, self.in_corners))

    def hold_corners(self, mask: Array) -> None:
        """Hold the particles in corners beside those of a mask (N,), too."""
        corners = self.states.corners
        assert corners is not None
        stay = ((corners[:, 1:3] >= 0) & mask[corners[:, 1:3]]).any(axis=1)
        self.hold(np.isin(np.arange(len(mask)), corners[stay, 0]))

    def turned_along(self, angle: Array) -> Array:
        """(K, 2) the directions in which particles slide, turned by (B,) angles of the bodies [rad]."""
        return np.asarray(self.along + rotated(self.along, angle[self.of]))

    @cached_property
    def row_along(self) -> Array:
        """(K, 2) the directions in which they slide at the intermediate time, as predicted."""
        return self.turned_along(self.scheme.cf * self._predicted[:, 2])

    def displacements(self, increment: Array) -> Array:
        """(K, 2) of the particles on bodies, at increments (B, 3)."""
        q = increment[self.of]
        return q[:, :2] + rotated(self.arm + self.slid, q[:, 2]) + self.slid

    def solved(self, increment: Array) -> None:
        """Set the end of the step by the solution's increments (B, 3) of the bodies that float."""
        states, free = self.states, self.free
        self.increment = np.where(free, increment, self.increment)
        v_next, a_next = self.scheme.rates(increment, states.velocity, states.acceleration)
        self.after = replace(
            self.after,
            position=states.position + self.increment,
            velocity=np.where(free, v_next, self.after.velocity),
            acceleration=np.where(free, a_next, self.after.acceleration),
        )

    def settled(self, displacement: Array) -> None:
        """Take how far particles have slid from the solution's displacements (N, 2), at the present ``increment``."""
        if self.slides.any():
            q = self.increment[self.of]
            moved = displacement[self.index] - q[:, :2] - rotated(self.arm, q[:, 2])
            self.slid = np.where(self.slides[:, None], moved + rotated(moved, -q[:, 2]), 0.0)

    def measured(self, index: Array, force: Array) -> None:
        """Set what the fluids did to the bodies by forces (K, 2) on particles (K,), which may repeat [N/m]."""
        arm, u, lever, along = np.zeros((4, len(self.states.label), 2))
        moved, slid = self.displacements(self.increment), self.slips()[:, None] * self.row_along
        turn = rotated(self.arm, self.increment[self.of, 2])
        arm[self.index] = self.arm + self.scheme.cf * (turn + self.row_slid)
        u[self.index] = moved - slid  # what slides is not moved by the body
        lever[self.index], along[self.index] = self.levers, self.row_along
        r, of, count = arm[index], self.states.label[index], len(self.bodies)
        friction = component(force, along[index])
        moment = (turned(r) * (force - friction) + turned(lever[index]) * friction).sum(axis=1)
        work = (force * u[index]).sum(axis=1)
        sums = [np.bincount(of, values, minlength=count) for values in (*force.T, moment, work)]
        states, s = self.states, self.scheme
        # As walls that move: at the time of the forces.
        own = (s.alpha_f * states.velocity + s.cf * self.after.velocity)[of]
        ahead = s.dt * (own[:, :2] + own[:, 2:] * turned(r)) - u[index]
        self.lag = -float((force * ahead)[~self.floating[of]].sum())
        middle = np.asarray(s.cm * self.increment + s.history(states.velocity, states.acceleration)[1])
        self.after = replace(self.after, force=np.stack(sums[:3], axis=1), work=sums[3], middle=middle)

    def rates(self) -> tuple[Array, Array]:
        """v_alpha and a_alpha (K, 2) of the particles on bodies, with the present end of the step."""
        s, states, after = self.scheme, self.states, self.after
        u = self.displacements(self.increment)
        v, a = rigid_rates(self.arm, states.velocity[self.of], states.acceleration[self.of])
        arm = self.arm + u - self.increment[self.of, :2]
        v_next, a_next = rigid_rates(arm, after.velocity[self.of], after.acceleration[self.of])
        v_alpha, a_alpha = s.alpha_f * v + s.cf * v_next, s.alpha_m * a + (1 - s.alpha_m) * a_next
        floats = self.floating[self.of, None]
        if not s.weighs:  # they follow from the displacements, as those of any particle
            v_start, a_start = s.history(v, a)
            v_alpha = np.where(floats, v_start + s.cv * u, v_alpha)
            a_alpha = a_start + s.cm * u
        # A prescribed motion has its own acceleration at the intermediate time. Generalized-alpha's a_n are those of
        # another time than t_n.
        middle = s.alpha_f * states.velocity + s.cf * after.velocity
        arm = self.arm + s.cf * (arm - self.arm)
        own = rigid_rates(arm, middle[self.of], self._middle[self.of])[1]
        a_alpha = np.where(floats, a_alpha, own)
        if self.slides.any():
            along = self.row_along
            v_own, a_own = self.free_histories()
            v_alpha = v_alpha + component(v_own + s.cv * u - v_alpha, along)
            a_alpha = a_alpha + component(a_own + s.cm * u - a_alpha, along)
        return v_alpha, a_alpha

    def linear_rates(self) -> tuple[Array, Array, Array, Array]:
        """v_alpha and a_alpha (3 B,) of the bodies at increments of zero, and their derivatives by these."""
        s, states = self.scheme, self.states
        v, a = s.history(states.velocity, states.acceleration)
        given = s.alpha_f * states.velocity + s.cf * self.after.velocity, self._middle
        rates = [np.where(self.free, own, of) for own, of in zip((v, a), given, strict=True)]
        cv, cm = np.where(self.free, s.cv, 0.0), np.where(self.free, s.cm, 0.0)
        return rates[0].ravel(), rates[1].ravel(), cv.ravel(), cm.ravel()

    def constrain(self, u: Array) -> Array:
        """Displacements (N, 2), those of particles on bodies as the bodies' present increments place them.

        Along outlines they are those predicted: in what is given, walls have set them to zero.
        """
        result = u.copy()
        result[self.index] = self.displacements(self.increment)
        return np.asarray(result)

    def histories(self, velocity: Array, acceleration: Array) -> tuple[Array, Array]:
        """v_alpha and a_alpha (N, 2) at u = 0, from those of free particles; on bodies at ``increment``."""
        v, a = velocity.copy(), acceleration.copy()
        u = self.displacements(self.increment)
        v_alpha, a_alpha = self.rates()
        v[self.index], a[self.index] = v_alpha - self.scheme.cv * u, a_alpha - self.scheme.cm * u
        return v, a

    def finish(self, moved: Particles) -> Particles:
        """The particles at the end of the step, those on bodies where the bodies have them."""
        done, after = moved.copy(), self.after
        u, angle = self.displacements(self.increment), self.increment[:, 2]
        arm = self.arm + u - self.increment[self.of, :2]
        done.position[self.index] = after.position[self.of, :2] + arm
        if self.slides.any():
            along = self.turned_along(angle)
            own = rigid_rates(arm, after.velocity[self.of], after.acceleration[self.of])
            rates = self.scheme.rates(u, self._velocity, self._acceleration)
            end = np.zeros_like(after.along)
            end[self.index] = along
            for values, rigid, free in zip((done.velocity, done.acceleration), own, rates, strict=True):
                values[self.index] = rigid + component(free - rigid, along)
            self.after = after = replace(after, along=end)
        return after.imposed(done)
