"""OpeningTerm: openings in the equations of a step.

At an inlet displacements are prescribed. At an outlet they are unknowns, and pressure is one as on a free surface: the
natural condition of the momentum equation is a traction, -p n of the pressure p that is given,

    - int_opening (-p n) . u' ,

a force that does not depend on the unknowns, taken along the line at the start of the step. So the particles move with
the fluid in the step; `tipfem.physics.openings.put_back` brings them back onto their line after it.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np

from tipfem.backend.launch import launch
from tipfem.case.boundary.passages import Passages
from tipfem.case.particles import Particles
from tipfem.errors import SimulationError
from tipfem.fem import schur
from tipfem.fem.time_integration import TimeScheme
from tipfem.linalg.sparsity import Csr
from tipfem.mesh.mesh import Mesh
from tipfem.physics.openings import kernels
from tipfem.physics.openings.lines import OpeningLines
from tipfem.physics.openings.passed import Passed
from tipfem.physics.term import Equations, Term, TermWork
from tipfem.physics.walls.step import WallsInStep
from tipfem.typing import Array


class OpeningTerm(Term):
    """Constraints at openings, and the pressures given there.

    `SimulationError` if all outlets are closed and what enters does not leave, or no fluid is left.
    """

    def __init__(
        self,
        openings: OpeningLines,
        walls: WallsInStep,
        particles: Particles,
        mesh: Mesh,
        scheme: TimeScheme,
        time: float,
        part: Passed,
    ) -> None:
        passages = walls.boundary.passages
        assert passages is not None
        self._passages: Passages = passages
        self.unheld: Array = passages.open
        self._walls, self._scheme, self._particles = walls, scheme, particles
        if not len(mesh.cells):
            raise SimulationError(f"the run stops at t = {time:.6g} s: all fluid has left the tank")
        part = dataclasses.replace(part, wet=openings.wet_beyond(passages.nodes, mesh))
        setting = openings.setting(part, time + 0.5 * scheme.dt)
        self._part, self._free, self._shut = part, passages.free.copy(), np.zeros(len(passages.free), dtype=bool)
        for k in np.flatnonzero(setting.closed):
            self._shut[passages.nodes[k][1:-1]] = True
        dry = np.flatnonzero(self._free & mesh.dry(particles.wall))
        self._shut[dry] = True
        self._free[self._shut] = False
        self.grounds, self._closed = bool(self._free.any()), setting.closed
        self._inlets = inlets = openings.prescribed(passages.nodes, mesh, time, scheme.dt, setting, dry)
        if text := setting.unbalanced(time):
            raise SimulationError(f"the run stops at t = {time:.6g} s: {text}")
        end = time + scheme.cf * scheme.dt
        self._force = openings.tractions(passages.nodes, particles, mesh, end, self._moves, setting)
        start, end = inlets.velocity
        self._velocity = (1 - scheme.alpha_f) * end + scheme.alpha_f * start - scheme.cv * inlets.displacement
        start, end = inlets.acceleration
        self._acceleration = (1 - scheme.alpha_m) * end + scheme.alpha_m * start - scheme.cm * inlets.displacement
        self._holding = np.zeros((len(inlets.particles), 2))

    def _moves(self, velocity: Array, acceleration: Array) -> Array:
        """Displacements (K, 2) by velocities and accelerations (K, 2) until the balance of momentum holds [m]."""
        return np.asarray(self._scheme.cf * self._scheme.predict(velocity, acceleration))

    def _across(self, values: Array) -> Array:
        """Fields (N, d) whose values at particles that cross at right angles do."""
        on, n = self._passages.crossing, self._passages.across
        result = values.copy()
        result[on] = np.einsum("ki,ki->k", values[on], n)[:, None] * n
        return np.asarray(result)

    def histories(self, velocity: Array, acceleration: Array) -> tuple[Array, Array]:
        """See `Term.histories`."""
        v, a, on = self._across(velocity), self._across(acceleration), self._inlets.particles
        v[on], a[on] = self._velocity, self._acceleration
        return v, a

    def prescribe(self, displacement: Array, pressure: Array) -> tuple[Array, Array]:
        """See `Term.prescribe`."""
        u = self._across(displacement)
        u[self._inlets.particles] = self._inlets.displacement
        return u, pressure

    def begin(self, equations: Equations, first_node: int) -> None:
        """See `Term.begin`."""
        self._equations, put = equations, equations.buffers.upload
        outlets = [
            on
            for line, on in zip(self._walls.boundary.lines, self._passages.nodes, strict=True)
            if not line.opening.velocities
        ]
        self._loaded = np.unique(np.concatenate([np.zeros(0, dtype=np.int32), *outlets])).astype(np.int32)
        if len(self._loaded):
            self._arrays = put("openings.loaded", self._loaded), put("openings.force", self._force[self._loaded])

    def schur_complement(self, laplacian: Csr) -> Csr:
        """See `Term.schur_complement`: particles that move off their opening change the volume of the fluid.

        Those on interfaces are left out where each fluid has a pressure: their own entries are there already.
        """
        e, walls, d = self._equations, self._walls, self._equations.dimension
        ends = self._passages.ends
        near = self._free.copy()
        near[ends] = ~walls.fixed[ends]
        near[e.owner[len(near) :]] = False
        index = np.flatnonzero(near)
        if not len(index):
            return laplacian
        # Derivatives of the volume by the positions of particles on the hull.
        (_, _, one, other), gradient = e.mesh.hull, np.zeros((len(near), 2))
        launch(kernels.add_hull_gradient, one, other, len(one), e.mesh.period.array, e.mesh.position, gradient)
        at = np.flatnonzero(near[walls.sliding])
        if len(at):
            on, columns = walls.sliding[at], walls.columns[at].reshape(-1, d, d)
            gradient[on] = np.einsum("kij,kj->ki", columns, gradient[on])
        put = e.buffers.upload
        arrays = put("openings.grounds", index.astype(np.int32)), put("openings.gradient", gradient[index])
        rest = laplacian.row_offsets, laplacian.values, schur.SCHUR_SCALE, len(index), d
        launch(schur.add_grounds, *arrays, e.scale, *rest, work=(len(index), schur.GROUND))
        return laplacian

    def residual(self, x: Any, out: Any) -> None:
        """See `Term.residual`."""
        e, count = self._equations, len(self._loaded)
        if count:
            work = (count, kernels.FORCE)
            launch(kernels.add_forces, *self._arrays, e.scale, out, count, e.dimension, work=work)

    def forces(self, x: Any) -> Array:
        """See `Term.forces`."""
        result = np.zeros((len(self._equations.owner), 2))
        result[: len(self._force)] = -self._force
        return result

    def held(self, displacement: Array, pressure: Array) -> None:
        """See `Term.held`."""
        displacement |= self._shut

    def carried(self, x: Any) -> Passed:
        """See `Term.carried`: which openings were closed."""
        return dataclasses.replace(self._part, closed=self._closed)

    def settle(self, x: Any, forces: Callable[[Any, Array], Array]) -> None:
        """See `Term.settle`: the forces that hold the particles of inlets, with their copies, and those that cross."""
        e, mask = self._equations, np.zeros(len(self._force), dtype=bool)
        crossing = self._passages.crossing[self._free[self._passages.crossing]]
        mask[self._inlets.particles] = mask[crossing] = True
        mask &= self.unheld
        nodes = e.nodes_of(mask)
        holding, self._held = forces(x, nodes), np.flatnonzero(mask)
        self._holding = holding[: len(self._held)].copy()
        if len(nodes) > len(self._held):  # copies
            of = np.searchsorted(self._held, e.owner[nodes[len(self._held) :]])
            np.add.at(self._holding, of, holding[len(self._held) :])
        # What crosses at right angles is held along its line only.
        across = np.zeros_like(self._force)
        across[self._passages.crossing] = self._passages.across
        across = np.where(self._free[self._held, None], across[self._held], 0.0)
        self._holding -= np.einsum("ki,ki->k", self._holding, across)[:, None] * across

    def finish(self, displacement: Array, particles: Particles) -> Particles:
        """See `Term.finish`."""
        before, inlets = self._particles, self._inlets
        moved = (particles.position, particles.velocity, particles.acceleration)
        done = particles.shallow_copy(
            **dict(zip(("position", "velocity", "acceleration"), map(np.copy, moved), strict=True))
        )
        on = np.flatnonzero(self._free)
        v, a = self._scheme.rates(displacement[on], before.velocity[on], before.acceleration[on])
        done.position[on] = before.position[on] + displacement[on]
        done.velocity[on], done.acceleration[on] = v, a
        crossing, n = self._passages.crossing, self._passages.across
        for values in (done.velocity, done.acceleration):
            values[crossing] = np.einsum("ki,ki->k", values[crossing], n)[:, None] * n
        on = inlets.particles
        done.position[on] = before.position[on] + inlets.displacement
        done.velocity[on], done.acceleration[on] = inlets.velocity[1], inlets.acceleration[1]
        return done

    def work(self, x: Any, displacement: Array) -> TermWork:
        """See `Term.work`: what pressures and inlets do is not what walls do, at the ends of openings either."""
        on, force = self._at_ends(x)
        on, force = np.concatenate([self._loaded, on]), np.concatenate([self._force[self._loaded], force])
        u, walls = displacement[on], ~self.unheld[on]
        return TermWork(
            walls=-float((force[walls] * u[walls]).sum()),
            wall_force=-force[walls].sum(axis=0),
            passing=float((force * u).sum() + (self._holding * displacement[self._held]).sum()),
            passing_force=force.sum(axis=0) + self._holding.sum(axis=0),
        )

    def _at_ends(self, x: Any) -> tuple[Array, Array]:
        """Ends (E,) of inlets that walls hold, and the forces (E, 2) of the pressure on the faces beside them."""
        ends, beside, inwards = [], [], []
        for line, on in zip(self._walls.boundary.lines, self._passages.nodes, strict=True):
            for end, next_one in ((on[0], on[1]), (on[-1], on[-2])):
                if line.opening.velocities and not self.unheld[end]:
                    ends.append(end)
                    beside.append(next_one)
                    inwards.append(line.inwards)
        if not ends:
            return np.zeros(0, dtype=np.int64), np.zeros((0, 2))
        place, pressure = self._particles.position, self._equations.values(x)[:, -1]
        length = np.linalg.norm(place[beside] - place[ends], axis=1)
        r, s = (self._walls.boundary.period.radius(place[i]) for i in (ends, beside))
        force = length * (pressure[ends] / 3 * (0.25 * (3 * r + s)) + pressure[beside] / 6 * (0.5 * (r + s)))
        return np.array(ends), force[:, None] * np.array(inwards)
