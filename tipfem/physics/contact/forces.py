"""Forces of unilateral contacts with Coulomb friction on the solids that float.

With gaps g and slips s of the contacts at the end of a step, the skin d and the friction coefficient mu,

    0 <= lambda _|_ g - d >= 0 ,    |tau| <= mu lambda ,  s = 0 or tau = -mu lambda sign(s) .

The step is solved with the wrenches w = N^T lambda + T^T tau on the solids, which gives their increments q; with these
and the solids' mobility A = dq / dw projected Gauss-Seidel sweeps find other forces, until both agree. The mobility is
at first that of mass, viscosity and added mass that the step's preconditioner has, then corrected by what each solve
shows, as in the method of Broyden, Fletcher, Goldfarb and Shanno: the step is linear but for its rotations, and solids
have few unknowns.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tipfem.geometry.touching import SKIN
from tipfem.physics.carried import Carried
from tipfem.physics.contact.candidates import Candidates
from tipfem.typing import Array

ROUNDS = 14  # solves of a step
EXACT = 4  # rounds, after which each allows twice the change of the last one: Newton's method ends with an error
CLOSE = 1e-7  # of the solids' increments in the last round [spacings]
FALL = 2e-6  # the same, of the fall by gravity in the step
FINEST = 1e-12  # the same [spacings]: round-off
TELLS = 30.0  # times these, above which a change of increments tells the mobility
SWEEPS = 2000
SHUT = 1e-3  # gap beyond the skin, below which a contact is closed [skins]
STICKS = 1e-6  # slip below which it sticks [spacings]


@dataclass(frozen=True)
class Contacts(Carried):
    """Contacts of B solids in a step, C of them.

    Attributes:
        key: (C, 4) see `Candidates`.
        force: (C, 2) normal and along the edges [N/m].
        sense: (C,) signs of the slips; 0 where they stick, 2 where the contact is open.
        jumped: whether contacts closed or opened, began to slide or stopped, so that velocities jumped.
        struck: (C,) mask of those that had less than the skin in a round.
        rounds: how many times the step has been solved.
        wrench: (B, 3) of them on the solids [N/m, N/m, N].
        film: (B, 3) of pressures in closed gaps on the solids.
        increment: (B, 3) of the solids in the last round [m, m, rad].
        tried: (B, 3) the wrench that gave it.
        mobility: (3 B, 3 B) its derivative by the wrench; None for none yet.
    """

    key: Array
    force: Array
    sense: Array
    jumped: bool
    struck: Array
    rounds: int
    wrench: Array
    film: Array
    increment: Array
    tried: Array
    mobility: Array | None = None

    @classmethod
    def none(cls, solids: int) -> Contacts:
        """No contacts."""
        empty, still = np.zeros(0), np.zeros((solids, 3))
        key = np.zeros((0, 4), dtype=int)
        return cls(key, np.zeros((0, 2)), empty, False, empty > 0, 0, still, still, still, still)

    def of(self, key: Array) -> tuple[Array, Array]:
        """Forces and senses of the contacts with other keys (C', 4), where they were; (0, 0) and open for others."""
        old = {tuple(row): k for k, row in enumerate(self.key.tolist())}
        rows = np.array([old.get(tuple(row), -1) for row in key.tolist()], dtype=int)
        there = rows >= 0
        force, sense = np.zeros((len(key), 2)), np.full(len(key), 2.0)
        force[there], sense[there] = self.force[rows[there]], self.sense[rows[there]]
        return force, sense

    def touches(self, solids: int) -> Array:
        """(B,) number of closed contacts of each solid."""
        number = self.key[self.sense < 2, :2].ravel() - 1
        return np.bincount(number[number >= 0], minlength=solids)


@dataclass(frozen=True)
class Law:
    """Law of the contacts in a step.

    Attributes:
        places: C candidates.
        start: (S, 3) poses at the step's start, the tank first.
        velocity: (S, 3) of the solids then.
        friction: (C,) mu.
        free: (3 B,) mask of the freedoms of solids that float.
        lengths: (B,) by which angles are multiplied [m].
        spacing: [m].
        gravity: [m/s^2].
        dt: [s].
    """

    places: Candidates
    start: Array
    velocity: Array
    friction: Array
    free: Array
    lengths: Array
    spacing: float
    gravity: float
    dt: float

    @property
    def skin(self) -> float:
        """Gap in contact [m]."""
        return SKIN * self.spacing

    def _rows(self, increment: Array) -> tuple[Array, Array]:
        """Derivatives (C, 3 B) of gaps and slips at the middle of the step, without the tank's columns."""
        middle = self.start.copy()
        middle[1:] += 0.5 * increment
        normal, along = self.places.rows(middle)
        return normal[:, 3:], along[:, 3:]

    def wrench(self, force: Array, increment: Array) -> Array:
        """(B, 3) of forces (C, 2) on all solids."""
        normal, along = self._rows(increment)
        return np.asarray((force[:, 0] @ normal + force[:, 1] @ along).reshape(-1, 3))

    def gaps(self, increment: Array) -> Array:
        """(C,) at the end of the step [m]."""
        end = self.start.copy()
        end[1:] += increment
        return self.places.gaps(end)

    def slips(self, increment: Array) -> Array:
        """(C,) in the step [m]."""
        return np.asarray(self._rows(increment)[1] @ increment.ravel())

    def senses(self, increment: Array) -> Array:
        """(C,) see `Contacts`."""
        slip = self.slips(increment)
        sense = np.where(np.abs(slip) > STICKS * self.spacing, np.sign(slip), 0.0)
        return np.where(self.gaps(increment) < (1 + SHUT) * self.skin, sense, 2.0)

    @property
    def _speeds(self) -> Array:
        """(C,) at which gaps close at the start of the step [m/s]."""
        return np.asarray(-(self.places.rows(self.start)[0] @ self.velocity.ravel()))

    def _strikes(self, increment: Array) -> Array:
        """(C,) mask of the contacts with gaps less than the skin at the end of the step."""
        return np.asarray(self.gaps(increment) < (1 - SHUT) * self.skin)

    def adjusted(self, force: Array, increment: Array, mobility: Array) -> Array:
        """Forces (C, 2) that obey the law, by sweeps over all contacts.

        Args:
            force: with which the ``increment`` was found.
            increment: (B, 3) of the solids.
            mobility: (3 B, 3 B) its derivative by the wrench.
        """
        normal, along = (np.where(self.free, row, 0.0) for row in self._rows(increment))
        left, slip = self.gaps(increment) - self.skin, self.slips(increment)
        own = [np.einsum("ci,ij,cj->c", row, mobility, row) for row in (normal, along)]
        response = [row @ mobility.T for row in (normal, along)]
        new, moved = force.copy(), np.zeros(mobility.shape[0])
        least = 1e-3 * self.close
        for _ in range(SWEEPS):
            largest = 0.0
            for k in range(len(new)):
                if not own[0][k] > 0:
                    continue
                push = max(0.0, new[k, 0] - (left[k] + normal[k] @ moved) / own[0][k]) - new[k, 0]
                new[k, 0] += push
                moved += push * response[0][k]
                limit = self.friction[k] * new[k, 0]
                drag = 0.0
                if own[1][k] > 0:
                    wanted = new[k, 1] - (slip[k] + along[k] @ moved) / own[1][k]
                    drag = float(np.clip(wanted, -limit, limit)) - new[k, 1]
                    new[k, 1] += drag
                    moved += drag * response[1][k]
                largest = max(largest, abs(push) * own[0][k], abs(drag) * own[1][k])
            if largest < least:
                break
        return np.asarray(new)

    @property
    def close(self) -> float:
        """Change of the solids' increments, below which a step is solved [m]."""
        fall = FALL * self.gravity * self.dt**2
        return float(max(FINEST * self.spacing, min(CLOSE * self.spacing, fall) if fall else CLOSE * self.spacing))

    def begun(self, before: Contacts, predicted: Array, mobility: Array, film: Array) -> Contacts:
        """The contacts that a step is first solved with.

        Args:
            before: at the end of the last step.
            predicted: (B, 3) increments of the solids, with the forces of the last step.
            mobility: (3 B, 3 B) of the solids' own mass.
            film: (B, 3) see `Contacts`.
        """
        force, sense = before.of(self.places.key)
        if before.jumped:  # impulses
            force = np.zeros_like(force)
        struck = self._strikes(predicted)
        force = self.adjusted(force, predicted, mobility)
        wrench = self.wrench(force, predicted)
        return Contacts(self.places.key, force, sense, False, struck, 1, wrench, film, predicted, wrench)

    def again(self, last: Contacts, before: Contacts, increment: Array, mobility: Array) -> tuple[Contacts, bool]:
        """The contacts for another round, or those that the step has been solved with, and whether it has.

        Args:
            last: with which the step was solved.
            before: at the end of the step before.
            increment: (B, 3) of the solids, that it found.
            mobility: (3 B, 3 B) of the step.
        """
        struck = last.struck | self._strikes(increment)
        force = self.adjusted(last.force, increment, mobility)
        wrench = self.wrench(force, increment)
        moved = self._scale * (mobility @ np.where(self.free, (wrench - last.wrench).ravel(), 0.0))
        if np.abs(moved).max() < self.close * 2 ** max(0, last.rounds - EXACT):
            sense, old = self.senses(increment), before.of(self.places.key)[1]
            stays = set(map(tuple, self.places.key.tolist()))
            lost = any(tuple(k) not in stays for k in before.key[before.sense < 2].tolist())
            changed = (sense != old) & (old < 2)
            hits = struck & (self._speeds * self.dt > SHUT * self.skin) & (sense < 2)
            jumped = bool((changed | hits & (force[:, 0] > 0)).any() or lost)
            return replace(last, sense=sense, jumped=jumped, struck=struck, increment=increment), True
        new = replace(last, force=force, wrench=wrench, struck=struck, rounds=last.rounds + 1)
        return replace(new, increment=increment, tried=last.wrench, mobility=mobility), False

    def corrected(self, mobility: Array, wrench: Array, increment: Array) -> Array:
        """A mobility that has what a change of wrenches (B, 3) did to increments (B, 3), see the module."""
        scale = self._scale
        dw, dq = (np.where(self.free, d.ravel(), 0.0) * s for d, s in ((wrench, 1 / scale), (increment, scale)))
        size, unit = float(dw @ dq), np.eye(len(dw))
        if np.abs(dq).max(initial=0.0) < TELLS * self.close or size <= 1e-3 * np.linalg.norm(dw) * np.linalg.norm(dq):
            return mobility
        left = unit - np.outer(dq, dw) / size
        new = left @ (mobility * scale * scale[:, None]) @ left.T + np.outer(dq, dq) / size
        return np.asarray(new / scale / scale[:, None])

    @property
    def _scale(self) -> Array:
        """(3 B,) by which increments are all lengths [1, 1, m]."""
        return np.stack([np.ones_like(self.lengths), np.ones_like(self.lengths), self.lengths], axis=1).ravel()
