"""Beaches: damping of the fluids before a wall, see `tipfem.case.beaches.Beach`.

On a particle i of mass m_i acts the force -m_i c(x_i) v_alpha, with the velocity at the intermediate time of the step:
it is implicit, so that no strength bounds the time step. In a step it dissipates dt sum m c v_alpha^2. Its work, tested
with displacements u as all other work, is sum m c v_alpha . u; the difference is one of the time integration.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from tipfem.backend.arrays import download
from tipfem.backend.launch import launch
from tipfem.case.beaches import Zone
from tipfem.case.case import Case
from tipfem.case.particles import Particles
from tipfem.fem.time_integration import TimeScheme
from tipfem.linalg.sparsity import Csr
from tipfem.physics import linear_rows
from tipfem.physics.carried import Carried
from tipfem.physics.physics import Balance, Physics, StepStart
from tipfem.physics.state import lumped
from tipfem.physics.term import Equations, Term, TermWork
from tipfem.typing import Array


@dataclass(frozen=True)
class Damped(Carried):
    """Energy and work of beaches in the last step."""

    energy_lost: float = 0.0  # dissipated [J, per metre of depth]
    work: float = 0.0  # against the force [J, per metre of depth]


class Damping(Term):
    """The force of beaches, m c v_alpha in the rows of momentum; ``rate`` (N,) of damping [1/s]."""

    def __init__(self, rate: Array, mass: Array) -> None:
        self._on = np.flatnonzero(rate)
        self._strength = (rate * mass)[self._on]

    def begin(self, equations: Equations, first_node: int) -> None:
        """See `Term.begin`."""
        self._equations, e, on = equations, equations, self._on
        self._count, put, d = len(on), e.buffers.upload, e.dimension
        self._wall = e.particles.wall[on]
        self._history = download(e.motion, len(e.owner))[on, d : 2 * d]
        block, constant = np.zeros((self._count, 3, 3)), np.zeros((self._count, 3))
        block[:, (0, 1), (0, 1)] = (self._strength * e.scheme.cv)[:, None]
        constant[:, :2] = self._strength[:, None] * self._history
        rows = put("beaches.rows", on.astype(np.int32)), put("beaches.offsets", np.arange(len(on) + 1, dtype=np.int32))
        columns = put("beaches.columns", on.astype(np.int32)), put("beaches.values", block.ravel())
        self._matrix, self._constant = (*rows, *columns), put("beaches.constant", constant.ravel())

    def diagonal(self) -> None:
        """See `Term.diagonal`."""
        work = (self._count, linear_rows.ROW)
        launch(linear_rows.add_diagonal, *self._matrix, self._equations.scale, self._count, 2, work=work)

    def residual(self, x: Any, out: Any) -> None:
        """See `Term.residual`."""
        arrays = (*self._matrix, self._constant, self._equations.scale, x, out, self._count, 2)
        launch(linear_rows.add_product, *arrays, work=(self._count, linear_rows.ROW))

    def gather(self, matrix: Csr) -> None:
        """See `Term.gather`."""
        e, work = self._equations, (self._count, linear_rows.ROW)
        launch(linear_rows.add_blocks, *self._matrix, e.scale, matrix, e.rows, self._count, 2, work=work)

    def _force(self, displacement: Array) -> tuple[Array, Array]:
        """m c v_alpha and v_alpha (K, 2) of the particles, which a solution moves by (N, 2)."""
        velocity = self._equations.scheme.cv * displacement[self._on] + self._history
        return self._strength[:, None] * velocity, velocity

    def carried(self, x: Any) -> Damped:
        """See `Term.carried`."""
        displacement = self._equations.values(x)[:, :-1]
        force, velocity = self._force(displacement)
        dt = self._equations.scheme.dt
        return Damped(dt * float((force * velocity).sum()), float((force * displacement[self._on]).sum()))

    def forces(self, x: Any) -> Array:
        """See `Term.forces`."""
        values = self._equations.values(x)
        result = np.zeros((len(values), values.shape[1] - 1))
        result[self._on] = self._force(values[:, :-1])[0]
        return result

    def work(self, x: Any, displacement: Array) -> TermWork:
        """See `Term.work`: on walls what is not theirs of the forces there. That of the force itself is in `Damped`."""
        force, u = self._force(displacement)[0], displacement[self._on]
        on_walls = force * self._wall[:, None]
        walls = float((on_walls * u).sum())
        return TermWork(walls=walls, wall_force=on_walls.sum(axis=0), force=force.sum(axis=0))


class Beaches(Physics[Damped | None]):
    """See the module; they carry what they took in the last step."""

    name = "beaches"
    balance_columns = ("beach_dissipation",)

    def __init__(self, zones: list[Zone]) -> None:
        self._zones = zones

    @classmethod
    def of(cls, case: Case) -> Beaches | None:
        """See `Physics.of`."""
        return cls(case.beaches) if case.beaches else None

    def start(self, particles: Particles, step: float) -> Damped:
        """See `Physics.start`."""
        return Damped()

    def terms(self, part: Damped | None, step: StepStart) -> tuple[Damping, ...]:
        """See `Physics.terms`."""
        rate = np.sum([zone.rate(step.particles.position) for zone in self._zones], axis=0)
        mass = lumped(step.mesh, step.density)
        rate[mass == 0] = 0.0
        if step.boundary.passages is not None:
            rate[step.boundary.passages.open] = 0.0
        return (Damping(rate, mass),) if rate.any() else ()

    def balance(self, before: Damped | None, after: Damped | None, scheme: TimeScheme, force: Array) -> Balance:
        """See `Physics.balance`."""
        assert after is not None
        taken = after.energy_lost
        return Balance(dissipated=taken, numerical=after.work - taken, columns={"beach_dissipation": taken})
