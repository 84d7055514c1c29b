"""MovedBodies: bodies in the fluids, of which none floats."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np

from tipfem.backend.launch import launch
from tipfem.case.particles import Particles
from tipfem.fem.condensation import Follows
from tipfem.linalg.sparsity import Csr
from tipfem.physics.bodies.motion import BodyMotion, BodyStates
from tipfem.physics.bodies.outlines import chain_directions
from tipfem.physics.contact.mouths import Mouths
from tipfem.physics.term import Equations, Term, TermWork
from tipfem.physics.walls.chords import ChordPressures, Slip
from tipfem.physics.walls.kernels import SLIDING, slip_scale
from tipfem.physics.walls.term import nodes_of, weight_at
from tipfem.typing import Array


class MovedBodies(Term):
    """Bodies in the fluids, of which none floats: their particles go where the bodies are.

    Args:
        friction: (N,) over slip velocity, of the particles [kg/s, per metre of depth].
        closed: whether the elements are to grow by what bodies with curves and corners lose of their area in the
            iterates, as with curved walls, see `tipfem.physics.walls.curve_step`; False where such walls have that
            already, None under a free surface.
        young: (N, 2) forces along outlines on the fluids at contacts [N, per metre of depth]; None for none.
        mouths: of closed gaps in full tanks; None without any.
    """

    def __init__(
        self,
        motion: BodyMotion,
        friction: Array,
        *,
        closed: bool | None = None,
        young: Array | None = None,
        mouths: Mouths | None = None,
    ) -> None:
        self._mouths = mouths
        self._prescribed: Array | float = 0.0  # displacements (N, 2) by walls, as soon as they are known [m]
        self.motion, self._friction, self._closed, self._young = motion, friction, closed, young
        self._along: Array | None = None  # of curves at the last residual, if that has been
        self._chords: ChordPressures | None = None

    def sources(self) -> Array | None:
        """See `Term.sources`: what closed gaps take up."""
        return None if self._mouths is None else self._mouths.growth(self._rigidly(1.0))

    def _rigidly(self, part: float) -> Array:
        """(N, 2) positions after a part of the step, of particles where the bodies and the walls take them [m]."""
        motion, u = self.motion, np.zeros_like(self._equations.mesh.position) + self._prescribed
        u[motion.index] = motion.rigid(self._present()[motion.of])
        return np.asarray(self._equations.mesh.position + part * u)

    def held(self, displacement: Array, pressure: Array) -> None:
        """See `Term.held`: particles that slide are not."""
        displacement[self.motion.index[self.motion.slides]] = False

    def histories(self, velocity: Array, acceleration: Array) -> tuple[Array, Array]:
        """See `Term.histories`."""
        return self.motion.histories(velocity, acceleration)

    def prescribe(self, displacement: Array, pressure: Array) -> tuple[Array, Array]:
        """See `Term.prescribe`."""
        if self._mouths is not None:
            self._prescribed = displacement.copy()
        return self.motion.constrain(displacement), pressure

    def begin(self, equations: Equations, first_node: int) -> None:
        """See `Term.begin`."""
        self._equations = equations
        self._find_chords()
        self._put_chords()

    def _find_chords(self) -> None:
        """Set the pressures of curves."""
        motion, e = self.motion, self._equations
        rows = np.flatnonzero(motion.slides)
        if len(rows):
            on = np.zeros(len(e.particles), dtype=bool)
            on[motion.index[motion.curved | motion.in_corners]] = True
            here = np.flatnonzero(on[motion.faces].any(axis=1))
            faces = motion.faces[here][:, ::-1]
            nodes = nodes_of(faces, motion.cell[here], e.nodes.cells, e.owner)
            index, along, row_along = motion.index[rows], motion.along[rows], motion.row_along[rows]
            corners = None
            if motion.in_corners.any():
                corners = np.zeros((2, len(on)), dtype=bool)
                corners[0, motion.index[motion.in_corners]] = True
                corners[1, motion.index[motion.slides & ~motion.curved & ~motion.in_corners]] = True
                along = np.where((motion.curved | motion.in_corners)[rows, None], along, 0.0)  # sides take none
            weight = weight_at(faces, motion.cell[here], e)
            given = motion.middle, index, along, row_along, e.mesh.period, weight, corners
            self._chords = ChordPressures("bodies", faces, nodes, *given)

    def _put_chords(self) -> None:
        """Set their matrix, with friction."""
        if self._chords is not None:
            motion, rows = self.motion, np.flatnonzero(self.motion.slides)
            self._drag = self._friction[motion.index[rows]]
            self._start_slip = motion.slip_history()[rows]
            force = self._drag * self._start_slip
            if self._young is not None:
                force = force - (self._young[motion.index] * motion.row_along).sum(axis=1)[rows]
            self._chords.put(self._equations, self._slips(), self._given(), motion.scheme.cv * self._drag, force)

    def _slips(self) -> Slip:
        """The unknown parts of slips."""
        rows = np.flatnonzero(self.motion.slides)
        along = np.append(self.motion.row_along[rows], np.zeros((len(rows), 1)), axis=1)
        return Slip(np.arange(len(rows)), self.motion.index[rows], along, along)

    def _given(self) -> Array:
        """The given parts of these slips [m]."""
        motion, rows = self.motion, np.flatnonzero(self.motion.slides)
        q = np.where(motion.floating[:, None], 0.0, motion.increment)[motion.of]
        return np.asarray(-(motion.linear(q) * motion.row_along).sum(axis=1)[rows])

    def couplings(self, *, near: bool) -> tuple[Array, Array] | None:
        """See `Term.couplings`."""
        return None if self._chords is None else self._chords.couplings(self._slips())

    def residual(self, x: Any, out: Any) -> None:
        """See `Term.residual`."""
        if self._chords is not None:
            if self.motion.in_corners.any():
                self._take(x)
            self._chords.residual(x, out)

    def _take(self, x: Any) -> float:
        """Set the volumes of corners at ``x``; what is taken from continuity."""
        assert self._chords is not None
        e, motion, q = self._equations, self.motion, self._present()[self.motion.of]
        u = e.values(x)[: len(e.mesh.position), :-1]
        end = e.mesh.position + u
        halfway = end.copy()
        here, slides = motion.in_corners, motion.slides
        halfway[motion.index[here]] -= 0.5 * (u[motion.index] - motion.rigid(q))[here]
        self._chords.take(halfway, end, self.directions()[slides])
        return self._chords.taken(((u[motion.index] - motion.linear(q)) * motion.row_along).sum(axis=1)[slides])

    def gather(self, matrix: Csr) -> None:
        """See `Term.gather`."""
        if self._chords is not None:
            self._chords.gather(matrix)

    def work(self, x: Any, displacement: Array) -> TermWork:
        """See `Term.work`."""
        if self._chords is None:
            return TermWork(lag=self.motion.lag)
        scheme, slides = self.motion.scheme, self.motion.slides
        slip, solved = self.motion.slips()[slides], self.motion.solved_slips()[slides]
        speed = scheme.cv * solved + self._start_slip
        return dataclasses.replace(
            self._chords.work(self._equations.values(x)[:, -1], slip, solved),
            friction=float((self._drag * speed) @ slip),
            friction_dissipation=float(scheme.dt * self._drag @ speed**2),
            lag=self.motion.lag,
        )

    def diagonal_done(self) -> None:
        """One scale for both momentum rows of a particle that slides."""
        sliding = self.motion.index[self.motion.slides].astype(np.int32)
        if len(sliding):
            e, count = self._equations, len(sliding)
            friction = self.motion.scheme.cv * self._friction[sliding]
            arrays = e.buffers.upload("bodies.sliding", sliding), e.buffers.upload("bodies.friction", friction)
            launch(slip_scale, *arrays, e.scale, count, e.dimension, work=(count, SLIDING))

    def growth(self, x: Any) -> float | None:
        """See `Term.growth`: what bodies with curves and corners lose of their area, but for what these take."""
        e, motion = self._equations, self.motion
        if self._closed is None or not (motion.curved.any() or motion.in_corners.any()):
            return None
        u = e.values(x)[: len(e.mesh.position), :-1]
        taken = self._take(x) if motion.in_corners.any() else 0.0
        if not self._closed:
            return -taken
        b, a = motion.faces.T  # with the fluid on the left
        middle = e.mesh.position + 0.5 * u
        side = middle[b] - middle[a]
        here = np.flatnonzero(motion.curved)
        index, now = motion.index[here], motion.turned_along(self.angle)[here]
        self._along = chain_directions(e.mesh.position + u, motion.faces, index, now)
        return 0.5 * float((side[:, 1] * (u[a, 0] + u[b, 0]) - side[:, 0] * (u[a, 1] + u[b, 1])).sum()) - taken

    def _present(self) -> Array:
        """(B, 3) the bodies' increments at the last residual."""
        return self.motion.increment

    @property
    def angle(self) -> Array:
        """(B,) by which the bodies turn in the step [rad]."""
        return np.asarray(self._present()[:, 2])

    def directions(self) -> Array:
        """(K, 2) along which corrections of the bodies' particles slide at the end of the step."""
        along = self.motion.turned_along(self.angle)
        if self._along is not None:
            along[self.motion.curved] = self._along
        return along

    def follows(self) -> Follows | None:
        """Particles that slide follow themselves along their outline."""
        motion = self.motion
        here = np.flatnonzero(motion.slides & ~motion.floating[motion.of])
        if not len(here):
            return None
        end, middle = self.directions()[here], motion.row_along[here]
        node = motion.index[here]
        return Follows(node, node, *(t[:, :, None] * t[:, None, :] for t in (middle, end)))

    def rest(self) -> None:
        """See `Term.rest`."""
        self.motion.solved(np.zeros_like(self.motion.increment))
        self.motion.slid[:] = 0.0

    def settle(self, x: Any, forces: Callable[[Any, Array], Array]) -> None:
        """Find where the bodies are at the end of the step, and what the fluids exert on them."""
        e, motion = self._equations, self.motion
        if motion.slides.any():
            motion.settled(e.values(x)[: len(e.mesh.position), :-1])
        # Of bodies that are moved, the equations have had the acceleration as predicted all along.
        here = np.flatnonzero(motion.floating[motion.of])
        if len(here):
            index, u = motion.index[here], motion.displacements(motion.increment)[here]
            e.relative[index] = motion.rates()[1][here] - e.force[index] - motion.scheme.cm * u
        index = e.nodes_of(motion.states.label >= 0)
        motion.measured(self._equations.owner[index], -forces(x, index))

    def finish(self, displacement: Array, particles: Particles) -> Particles:
        """See `Term.finish`."""
        return self.motion.finish(particles)

    def carried(self, x: Any) -> BodyStates:
        """See `Term.carried`."""
        return self.motion.after
