"""Bodies: the rigid bodies of a case, in its steps and between them."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from tipfem.case.body import FREEDOMS, Body
from tipfem.case.boundary.boundary import Boundary
from tipfem.case.case import Case
from tipfem.case.fluid import typical_viscosity
from tipfem.case.particles import Particles
from tipfem.errors import StepRefused
from tipfem.fem.time_integration import TimeScheme
from tipfem.mesh.mesh import Mesh
from tipfem.physics.bodies.contacts import hold_contacts
from tipfem.physics.bodies.corners import put_back, with_corners
from tipfem.physics.bodies.energy import body_balance
from tipfem.physics.bodies.friction import first_layers, friction_on_outlines
from tipfem.physics.bodies.motion import (
    COLUMNS,
    CONTACT_COLUMNS,
    BodyMotion,
    BodyStates,
    on_outlines,
    placed,
    put_on_outlines,
    stopped_by_bodies,
)
from tipfem.physics.bodies.moved import MovedBodies
from tipfem.physics.bodies.outlines import Outline
from tipfem.physics.bodies.term import FloatingBodies
from tipfem.physics.carried import Remap
from tipfem.physics.contact.candidates import candidates
from tipfem.physics.contact.film import Stretch, films, streams, stretches
from tipfem.physics.contact.forces import NEAR, ROUNDS, Contacts, Films, Law, Trial
from tipfem.physics.contact.gaps import (
    HELD,
    WIDE,
    closed_cells,
    closed_particles,
    is_full,
    owners,
    relabelled,
    touching_particles,
)
from tipfem.physics.contact.mouths import Mouths, mouths
from tipfem.physics.physics import Balance, Entered, Moved, Physics, StepStart, no_particles
from tipfem.typing import Array


class Bodies(Physics[BodyStates]):
    """See the module; they carry where they are and how they move.

    ``label`` (N,) is the number of the body that each of the case's particles is on, -1 for none; for ``cosines`` see
    `Case`.
    """

    name = "bodies"
    _may: Array | None = None  # (B + 1,) mask of the solids that may touch others, the tank first
    _spacing, _fluids = 0.0, 0
    _seals = np.zeros(0, dtype=bool)  # (B + 1,) mask of the solids in whose gaps nothing seeps
    _seeps = np.zeros((0, 2))  # densities and viscosities of what seeps into gaps
    _kept: tuple[Mesh, dict[Callable[..., Any], Any]] | None = None
    _touch: Array | None = None  # (B + 1, B + 1) mask of the pairs with contact forces, None for none

    def __init__(self, bodies: Sequence[Body], label: Array, gravity: Array, cosines: Sequence[Any] = ()) -> None:
        self._bodies, self._label, self._gravity, self._cosines = bodies, label, gravity, cosines
        self._outlines = {b: Outline(body) for b, body in enumerate(bodies) if body.slips}
        self.curved = any(outline.curved for outline in self._outlines.values())
        self._floats = np.array([body.floats for body in bodies])
        self.columns = tuple(f"{body.name}_{name}" for body in bodies for name in COLUMNS)
        if self._floats.any():
            self.balance_columns = ("body_kinetic_energy", "body_potential_energy", "damper_dissipation")

    @classmethod
    def of(cls, case: Case) -> Bodies | None:
        """See `Physics.of`."""
        if not case.bodies:
            return None
        new = cls(case.bodies, case.body_label, case.potential_gravity, case.body_cosines)
        if any(body.gap for body in case.bodies):
            new._may = np.array([False, *(body.gap is not None for body in case.bodies)])
            new._spacing, new._fluids = case.particles.spacing, len(case.fluids)
            new._seeps = np.array([(fluid.density, typical_viscosity(fluid)) for fluid in case.fluids])
            new._seals = np.array([False, *(body.gap == "seal" for body in case.bodies)])
            moves = np.append(False, new._floats)
            new._touch = (new._may[:, None] | new._may) & (moves[:, None] | moves)
            np.fill_diagonal(new._touch, False)
            if new._touch.any():
                new.balance_columns = (*new.balance_columns, "contact_dissipation", "gap_work")
                new.columns = tuple(f"{body.name}_{n}" for body in case.bodies for n in (*COLUMNS, *CONTACT_COLUMNS))
                new.columns += ("gap_energy",)
            else:
                new._touch = None
        return new

    def start(self, particles: Particles, step: float) -> BodyStates:
        """See `Physics.start`."""
        states = BodyStates.start(self._bodies, particles, self._label, step, self._outlines)
        if self._touch is not None:
            own = np.array([(body.total_mass, body.total_mass, body.inertia_about_reference) for body in self._bodies])
            lightness = np.diag(np.where(np.repeat(self._floats, 3), 1 / own.ravel(), 0.0))
            states = dataclasses.replace(states, contacts=Contacts.none(lightness))
        return dataclasses.replace(
            states, boundary_layers=first_layers(self._bodies, self._outlines, states, particles)
        )

    def terms(self, part: BodyStates, step: StepStart) -> tuple[MovedBodies]:
        """See `Physics.terms`."""
        of_step = step.particles, step.time, step.mesh, self._outlines
        motion = BodyMotion(step.scheme, self._bodies, part, *of_step)
        # Where walls have curves, theirs is the area that the whole boundary encloses.
        closed = None if step.mesh.surface.exists else step.walls.curves is None
        friction, ended, stuck = friction_on_outlines(
            motion, self._outlines, step.mesh, step.particles, step.viscosity, step.density
        )
        if part.in_gaps is not None:
            motion.hold(part.in_gaps)
        if stuck is not None:  # there the outline is as one without slip
            motion.hold(stuck)
            if part.corners is not None:
                motion.hold_corners(stuck)
        motion.after = dataclasses.replace(motion.after, boundary_layers=ended, begun=True, stuck=stuck)
        young = self._young(motion.states.label, step)
        of_gaps = self._on(step.mesh, mouths) if part.full else None
        if part.contacts is not None:
            trial = part.trial or self._begun(part, motion, step, of_gaps)
            motion.begin_with(trial)
        if motion.floating.any():
            pinned = step.mesh.surface.pinned
            return (FloatingBodies(motion, friction, pinned, closed=closed, young=young, mouths=of_gaps),)
        return (MovedBodies(motion, friction, closed=closed, young=young, mouths=of_gaps),)

    def _on(self, mesh: Mesh, find: Callable[..., Any], *arguments: Any) -> Any:
        """Result of a function of a mesh, its empty cells and arguments, kept for the step on that mesh."""
        if self._kept is None or self._kept[0] is not mesh:
            self._kept = mesh, {}
        found = self._kept[1]
        if find not in found:
            found[find] = find(mesh, mesh.surface.empty, *arguments)
        return found[find]

    def _stretches(self, mesh: Mesh, owner: Array) -> list[Stretch]:
        """The closed gaps of a mesh in which fluid seeps; ``owner`` (N,) see `owners`."""
        found: list[Stretch] = self._on(mesh, stretches, owner, self._seals, self._spacing)
        return found

    def _law(self, part: BodyStates, boundary: Boundary, scheme: TimeScheme) -> Law:
        """Law of the contacts of a step, from its start on."""
        assert self._touch is not None
        outlines = [boundary.tank_at(0.0), *(placed(body, part, b) for b, body in enumerate(self._bodies))]
        # A step of an impact begins without accelerations; until a body strikes it has that of its flight.
        flies = (part.acceleration == 0) & (part.contacts is not None and not part.contacts.jumped)
        rates = part.position, part.velocity, np.where(flies, part.middle, part.acceleration)
        start, velocity, acceleration = (np.vstack([np.zeros(3), of]) for of in rates)
        places = candidates(outlines, start, self._touch, self._spacing)
        of_each = np.array([(0.0, 0.0), *((b.friction or 0.0, b.restitution or 0.0) for b in self._bodies)])
        friction, restitution = of_each[places.key[:, :2]].max(axis=1).T
        floats = self._floats & ~part.held
        free = np.array([[f in body.freedoms for f in FREEDOMS] for body in self._bodies]) & floats[:, None]
        lengths = np.array([np.linalg.norm(body.corners - body.reference, axis=1).max() for body in self._bodies])
        size = float(np.linalg.norm(self._gravity))
        given = friction, free.ravel(), lengths, self._spacing, size, scheme.dt, scheme.cm
        bounces = {"restitution": restitution, "acceleration": acceleration} if restitution.any() else {}
        law = Law(places, start, velocity, *given, **bounces)
        if (far := law.flight) > NEAR:
            raise StepRefused(f"a body would strike {far:.2g} spacings before the end of its flight")
        return law

    def _begun(self, part: BodyStates, motion: BodyMotion, step: StepStart, of_gaps: Mouths | None) -> Trial:
        """The contacts that a step is first solved with."""
        assert part.contacts is not None
        law, owner = self._law(part, step.boundary, step.scheme), owners(part.label, step.particles.wall)
        pose = np.vstack([np.zeros(3), part.position])
        given = owner, pose, self._gravity, self._seeps, self._spacing
        film, moving = films(self._stretches(step.mesh, owner), step.mesh, step.particles.pressure, *given, of_gaps)
        if moving:
            law = dataclasses.replace(law, films=Films(moving, *motion.linear_rates()))
        if part.contacts.jumped or not part.contacts.force.any():
            return law.begun(part.contacts, motion.increment, film)
        # The acceleration that those forces gave, which constraints let alternate from step to step.
        history = step.scheme.history(part.velocity, part.acceleration)[1]
        held = np.where(motion.free, (part.middle - history) / step.scheme.cm, motion.increment)
        return law.begun(part.contacts, held, film)

    def again(self, part: BodyStates, found: BodyStates) -> tuple[BodyStates, bool]:
        """See `Physics.again`: until the contacts' forces and the bodies' motions agree."""
        trial, increment = found.trial, found.position - part.position
        if trial is None:
            return found, True
        assert part.contacts is not None
        if math.isinf(trial.left):
            asked = trial.asked(increment, trial.mobility, trial.tolerance)
            trial = dataclasses.replace(trial, left=asked.left, most=asked.most) if asked.solved else asked
        if trial.solved:
            return dataclasses.replace(found, contacts=trial.ended(part.contacts, increment), trial=None), True
        if trial.rounds > ROUNDS:
            raise StepRefused(f"no forces of contacts are found in {ROUNDS} rounds")
        trial = dataclasses.replace(trial, left=math.inf, rounds=trial.rounds + 1)
        return dataclasses.replace(part, trial=trial), False

    def jumps(self, part: BodyStates) -> bool:
        """See `Physics.jumps`: where contacts begin or end."""
        return part is not None and part.contacts is not None and part.contacts.jumped

    def _young(self, label: Array, step: StepStart) -> Array | None:
        """(N, 2) Young's forces on the fluids at contacts with the bodies [N/m]; None without contact angles."""
        if not any(self._cosines):
            return None

        def on(one: Array, other: Array) -> Array:
            return np.where(label[one] == label[other], label[one], -1)

        given = step.mesh, step.particles, self._cosines, on
        found = (part.wetting_forces(*given) for part in step.parts.values())
        return next((each for each in found if each is not None), None)

    def set_back(self, part: BodyStates, particles: Particles) -> tuple[BodyStates, Particles, Array]:
        """See `Physics.set_back`: particles in corners are."""
        if part.corners is None:
            return part, particles, no_particles()
        brinks = part.corners[(part.corners[:, 1:3] < 0).any(axis=1), :3]
        return *put_back(self._bodies, part, particles), brinks[brinks >= 0]

    def before_repair(self, part: BodyStates, moved: Moved) -> tuple[BodyStates, Moved]:
        """See `Physics.before_repair`: particles on curves of outlines are put back there."""
        if not any(outline.curved for outline in self._outlines.values()):
            return part, moved
        closed = not moved.mesh.surface.exists
        particles, curved = on_outlines(part, self._outlines, moved.particles, moved.mesh, closed=closed)
        return part, dataclasses.replace(moved, particles=particles, curved=curved if closed else None)

    def put_on_curves(self, part: BodyStates, position: Array, new: Array, ends: Array) -> Array:
        """See `Physics.put_on_curves`."""
        return put_on_outlines(part, self._outlines, position, new, ends)

    def remeshed(self, part: BodyStates, particles: Particles, remap: Remap) -> tuple[BodyStates, Particles]:
        """See `Physics.remeshed`."""
        part = part.remeshed(self._bodies, particles, remap, self._outlines)
        slips = np.array([body.slips for body in self._bodies])
        brinks, shut = np.zeros(len(self._bodies), dtype=bool), None
        if self._may is not None:
            owner, empty = owners(part.label, particles.wall), remap.mesh.surface.empty
            full = is_full(remap.mesh, empty, owner)
            until = WIDE if full else HELD
            closed = closed_particles(remap.mesh.position, empty, owner, particles.spacing, until)
            closed = self._with_films(closed, remap.mesh, owner)
            part = dataclasses.replace(part, in_gaps=closed, full=full, handed=None)
            brinks = self._may[1:] & [body.slips_everywhere and not body.floats for body in self._bodies]
            if closed is not None and brinks.any():
                shut = touching_particles(remap.mesh.position, empty, owner, particles.spacing)
        if slips.any() or brinks.any():
            part = with_corners(self._bodies, part, slips, brinks, shut, remap.mesh, particles.target)
        return part, particles

    def _with_films(self, closed: Array | None, mesh: Mesh, owner: Array) -> Array | None:
        """A mask (N,) of particles, or None for none, with those of gaps that are full of what seeps there."""
        if self._touch is None:
            return closed
        found = self._stretches(mesh, owner)
        if not found:
            return closed
        result = np.zeros(len(owner), dtype=bool) if closed is None else closed
        result[np.concatenate([each.nodes for each in found])] = True
        return result

    def handed_over(
        self,
        before: BodyStates,
        part: BodyStates,
        particles: Particles,
        remap: Remap,
        boundary: Boundary,
    ) -> Array | None:
        """See `Physics.handed_over`: the flow of gaps that were full and have opened, where particles slide."""
        if self._touch is None or before.in_gaps is None:
            return None
        new = np.arange(len(before.in_gaps)) if remap.renumbered is None else remap.renumbered
        opened = before.in_gaps & (new >= 0)
        if part.in_gaps is not None:
            opened[opened] = ~part.in_gaps[new[opened]]
        if not opened.any():
            return None
        owner = owners(before.label, before.in_gaps)  # those of others do not matter
        found = stretches(remap.before, remap.before.surface.empty, owner, self._seals, self._spacing)
        whole = [each for each in found if opened[each.nodes].all()]
        pose = np.vstack([np.zeros(3), before.position])
        flow = streams(whole, remap.before.position, owner, pose, part.velocity.ravel(), self._spacing)
        old = np.flatnonzero(np.isfinite(flow[:, 0]))
        index, slides = new[old], boundary.slides
        along = np.einsum("ka,kb->kab", part.along, part.along)[index]
        free = np.zeros((len(particles), 2, 2))
        free[boundary.index[slides]] = boundary.free[slides]
        velocity = particles.velocity.copy()
        velocity[index] += np.einsum("kab,kb->ka", along + free[index], flow[old] - velocity[index])
        return np.asarray(velocity)

    def booked(self, part: BodyStates, energy: float, momentum: Array) -> BodyStates:
        """See `Physics.booked`."""
        return dataclasses.replace(part, handed=np.append(energy, momentum))

    def entered(self, part: BodyStates) -> Entered | None:
        """See `Physics.entered`: of the flow of gaps that opened."""
        if part is None or part.handed is None:
            return None
        return Entered(np.zeros(self._fluids), float(part.handed[0]), part.handed[1:])

    def flooded(self, part: BodyStates, mesh: Mesh, boundary: Boundary, position: Array, until: float) -> Mesh:
        """See `Physics.flooded`: gaps between solids close, and open."""
        if self._may is None:
            return mesh
        wall = np.zeros(len(position), dtype=bool)
        wall[boundary.index] = True
        owner = owners(part.label, wall)
        outlines = {b + 1: placed(body, part, b) for b, body in enumerate(self._bodies)}
        return relabelled(mesh, position, owner, outlines, self._may, self._spacing, self._fluids)

    def taken_up(self, part: BodyStates, mesh: Mesh, position: Array) -> Array | None:
        """See `Physics.taken_up`: by closed gaps in full tanks."""
        if not part.full:
            return None
        of_gaps = self._on(mesh, mouths)
        return np.zeros(self._fluids) if of_gaps is None else np.asarray(of_gaps.taken_up(position, self._fluids))

    def closed(self, part: BodyStates, particles: Particles) -> Callable[[Array, Array, Array], Array] | None:
        """See `Physics.closed`."""
        if self._may is None:
            return None
        owner, spacing = owners(part.label, particles.wall), particles.spacing

        def closed(position: Array, cells: Array, empty: Array) -> Array:
            more = np.full(len(position) - len(owner), -1, dtype=owner.dtype)
            result: Array = empty.copy()
            result[empty] = closed_cells(position, cells[empty], np.append(owner, more), spacing)
            if part.full:  # no film beside their mouths goes to them
                inside = np.zeros(len(position), dtype=bool)
                inside[cells[empty]] = True
                result |= inside[cells].sum(axis=1) > 1
            return result

        return closed

    def stopped(self, part: BodyStates, particles: Particles, loose: Array) -> Particles:
        """See `Physics.stopped`."""
        return stopped_by_bodies(self._bodies, part, particles, loose)

    def consistent(self, part: BodyStates, whole: BodyStates, half: BodyStates) -> BodyStates:
        """See `Physics.consistent`."""
        acceleration = np.where(self._floats[:, None], 2 * whole.middle - half.middle, part.acceleration)
        middle = np.where(self._floats[:, None], acceleration, part.middle)
        contacts = None if half.contacts is None else dataclasses.replace(half.contacts, jumped=False)
        return dataclasses.replace(part, acceleration=acceleration, middle=middle, contacts=contacts)

    def settled(
        self, part: BodyStates, particles: Particles, mesh: Mesh, boundary: Boundary, time: float
    ) -> BodyStates:
        """See `Physics.settled`: bodies that are in contact are held."""
        return hold_contacts(self._bodies, part, particles, mesh, boundary, time)

    def row(self, part: BodyStates, particles: Particles) -> dict[str, float]:
        """See `Physics.row`: position and velocity of each body's reference point, force and moment of the fluids."""
        values = np.stack([part.position, part.velocity, part.force], axis=1)
        row = values.reshape(len(values), -1)
        if part.contacts is not None:
            touches = part.contacts.touches(len(self._bodies))
            more = part.contacts.wrench, part.contacts.film[:, :2], touches[:, None]
            row = np.concatenate([row, *more], axis=1)
        values = row.ravel()
        if part.contacts is not None:
            values = np.append(values, 0.0 if part.handed is None else part.handed[0])
        return dict(zip(self.columns, values.tolist(), strict=True))

    def balance(self, before: BodyStates, after: BodyStates, scheme: TimeScheme, force: Array) -> Balance | None:
        """See `Physics.balance`: of the bodies that float."""
        if not self.balance_columns:
            return None
        found = body_balance(self._bodies, self._gravity, before, after, scheme, force)
        taken, given, columns = 0.0, 0.0, [found.kinetic, found.potential, found.dampers]
        if after.contacts is not None:
            floats = self._floats & ~before.held
            increment = (after.position - before.position)[floats]
            taken = -float((after.contacts.wrench[floats] * increment).sum())
            given = float((after.contacts.film[floats] * increment).sum())
            columns += taken, given
        return Balance(
            found.change,
            found.dampers + taken,
            found.numerical,
            found.work + found.external + given,
            dict(zip(self.balance_columns, columns, strict=True)),
        )
