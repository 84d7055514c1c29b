"""Forces of unilateral contacts with Coulomb friction on the solids that float.

With gaps g and slips s of the contacts at the end of a step, the skin d and the friction coefficient mu,

    0 <= lambda _|_ g - d >= 0 ,    |tau| <= mu lambda ,  s = 0 or tau = -mu lambda sign(s) .

Of contacts that strike with a coefficient of restitution e, g is at least that after a step away at -e g'.

The step is solved with the wrenches w = N^T lambda + T^T tau on the solids. After a correction of Newton's method,
which gives their increments q, projected Gauss-Seidel sweeps find the forces that these ask for, with the mobility
A = dq / dw of the solids by mass, viscosity and added mass, which the step's preconditioner has. By A dw they move at
once; it is right within a few per cent, so that the next correction finds increments for which the forces stay. Where
they do not, the step is solved again. A step begins so, too, with the forces and A of the last one: at rest it is
solved then.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy.linalg import lstsq

from tipfem.backend.launch import launch
from tipfem.geometry.plane.touching import SKIN
from tipfem.physics.carried import Carried
from tipfem.physics.contact.candidates import Candidates
from tipfem.physics.contact.film import Film
from tipfem.physics.contact.kernels import sweep
from tipfem.typing import Array

ROUNDS = 14  # solves of a step
EXACT = 4  # rounds, after which each allows twice the change of the last one: Newton's method ends with an error
CLOSE = 1e-7  # change of the solids' increments, below which a step is solved [spacings]
FALL = 2e-6  # the same, of the fall by gravity in the step
IN_FILMS = 0.002  # part of that where fluid in gaps moves with the solids, heavier than these
FINEST = 1e-12  # the same [spacings]: round-off
LEFT = 0.3  # the same, of the largest change in the step, up to the tolerance of Newton's method
SWEPT = 1e-5  # part of that left by sweeps, so that what rests is quiet
SWEEPS = 2000
FEW = 5  # of them, after which they may be cut short
CALM = 2.0  # speeds below this part of what gravity adds in a step do not bounce
NEAR = 0.01  # gap beyond the skin from which on a solid may bounce in a step [spacings]
SHUT = 1e-3  # gap beyond the skin, below which a contact is closed [skins]
FULL = 1e-6  # part of the largest friction that is missing where it sticks
SLIDES = 1e-5  # slip of a step above which it slides [spacings]
STUCK = 1e-2  # part of that which may be left where it sticks: sides that stick at both ends turn a little
GAPS_FIRST = 1e3  # weight of gaps over slips, which do not all agree


@dataclass(frozen=True)
class Contacts(Carried):
    """Contacts of B solids in a step, C of them."""

    key: Array  # (C, 4) see `Candidates`
    force: Array  # (C, 2) normal and along the edges, of smooth motion: from before an impact [N/m]
    sense: Array  # (C,) signs of the slips; 0 where they stick, 2 where the contact is open
    jumped: bool  # whether contacts closed or opened, began to slide or stopped, so that velocities jumped
    wrench: Array  # (B, 3) of them on the solids [N/m, N/m, N]
    film: Array  # (B, 3) of pressures in closed gaps on the solids, with those of what moves there
    squeeze: Array  # (B, 3) of these the latter
    lightness: Array  # (3 B, 3 B) of the solids: their mobility over that of a unit mass [1/kg, per metre of depth]

    @classmethod
    def none(cls, lightness: Array) -> Contacts:
        """No contacts."""
        still = np.zeros((len(lightness) // 3, 3))
        return cls(np.zeros((0, 4), dtype=int), np.zeros((0, 2)), np.zeros(0), False, still, still, still, lightness)

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
class Films:
    """Laws of the fluid in closed gaps in a step."""

    films: list[Film]  # at least one
    rate: Array  # (3 B,) v_alpha of the solids at increments of zero
    acceleration: Array  # (3 B,) a_alpha
    cv: Array  # (3 B,) derivatives of v_alpha by the increments [1/s]; 0 of what is given
    cm: Array  # (3 B,) those of a_alpha [1/s^2]

    def wrench(self, increment: Array) -> tuple[Array, Array]:
        """(3 B,) on the solids at increments (3 B,), and minus its derivative (3 B, 3 B)."""
        size = len(self.rate)
        total, stiff = np.zeros(size), np.zeros((size, size))
        v, a = self.rate + self.cv * increment, self.acceleration + self.cm * increment
        for film in self.films:
            force, against = film.law(increment, v, a, self.cv, self.cm)
            total += force
            stiff += against
        return total, stiff


@dataclass(frozen=True)
class Law:
    """Law of the contacts in a step."""

    places: Candidates  # C candidates
    start: Array  # (S, 3) poses at the step's start, the tank first
    velocity: Array  # (S, 3) of the solids then
    friction: Array  # (C,) mu
    free: Array  # (3 B,) mask of the freedoms of solids that float
    lengths: Array  # (B,) by which angles are multiplied [m]
    spacing: float  # [m]
    gravity: float  # [m/s^2]
    dt: float  # [s]
    cm: float  # d a_alpha / d u of the solids [1/s^2]
    films: Films | None = None  # of the fluid in closed gaps
    restitution: Array | None = None  # (C,) e; None for 0
    acceleration: Array | None = None  # (S, 3) of the solids at the step's start; needed with e
    _last: list[Array] = field(default_factory=list)  # increments and rows

    @property
    def skin(self) -> float:
        """Gap in contact [m]."""
        return SKIN * self.spacing

    def _rows(self, increment: Array) -> tuple[Array, Array]:
        """Derivatives (C, 3 B) of gaps and slips at the middle of the step, without the tank's columns."""
        if not self._last or (self._last[0] != increment).any():
            middle = self.start.copy()
            middle[1:] += 0.5 * increment
            normal, along = self.places.rows(middle)
            self._last[:] = increment.copy(), normal[:, 3:], along[:, 3:]
        return self._last[1], self._last[2]

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

    def senses(self, force: Array, increment: Array) -> Array:
        """(C,) of contacts with forces (C, 2), see `Contacts`."""
        slip = self.slips(increment)
        slides = (np.abs(force[:, 1]) >= (1 - FULL) * self.friction * force[:, 0]) & (
            np.abs(slip) > SLIDES * self.spacing
        )
        return np.where(self.gaps(increment) < (1 + SHUT) * self.skin, np.where(slides, np.sign(slip), 0.0), 2.0)

    @cached_property
    def bounces(self) -> tuple[Array, Array]:
        """(C,) mask of the contacts from which solids bounce, and their gaps at the end of the step at least [m]."""
        least, none = np.full(len(self.places), self.skin), np.zeros(len(self.places), dtype=bool)
        if self.restitution is None or self.acceleration is None:
            return none, least
        rows, gap = self.places.rows(self.start)[0], self.places.gaps(self.start)
        rate, more = rows @ self.velocity.ravel(), self.dt * (rows @ self.acceleration.ravel())
        away = more - self.restitution * rate
        fast = away > CALM * self.gravity * self.dt
        bounces = fast & (gap + self.dt * (rate + more) < self.skin) & (rate < 0)
        return bounces, np.where(bounces, gap + self.dt * away, least)

    @property
    def flight(self) -> float:
        """The largest gap beyond the skin of a contact that bounces, at the start of the step [spacings]."""
        gap = self.places.gaps(self.start)[self.bounces[0]] - self.skin
        return float(gap.max(initial=0.0) / self.spacing)

    @property
    def approaching(self) -> Array:
        """(C,) mask of the contacts whose gaps close at the start of the step."""
        speed = self.places.rows(self.start)[0] @ self.velocity.ravel()
        least = min(self.skin / self.dt, math.sqrt(self.gravity * self.skin) or math.inf)
        return np.asarray(-speed > SHUT * least)

    def response(self, mobility: Array, wrench: Array) -> Array:
        """Change (B, 3) of the solids' increments by one of the wrench (B, 3)."""
        return np.asarray((mobility @ np.where(self.free, wrench.ravel(), 0.0)).reshape(-1, 3))

    def moved(self, mobility: Array, wrench: Array) -> float:
        """The largest change of the solids' increments by a change (B, 3) of the wrench, angles times lengths [m]."""
        one = np.ones_like(self.lengths)
        return float(np.abs(np.stack([one, one, self.lengths], axis=1) * self.response(mobility, wrench)).max())

    def adjusted(self, force: Array, increment: Array, mobility: Array, further: Array | None = None) -> Array:
        """Forces (C, 2) that obey the law, by sweeps over all contacts, from those with which the increment was found.

        ``mobility`` (3 B, 3 B) is its derivative by the wrench, to which ``further`` (3 B,) is added.
        """
        count = len(force)
        rows = np.where(self.free, np.vstack(self._rows(increment)), 0.0)
        response = rows @ mobility @ rows.T  # of gaps and slips to normal forces and friction
        wrong = np.append(self.gaps(increment) - self.bounces[1], self.slips(increment))
        if further is not None:
            wrong += rows @ further
        new, moved, least = force.T.flatten(), np.zeros(1), SWEPT * self.close
        friction = np.ascontiguousarray(self.friction)
        done, until = 0, FEW
        while count and done < SWEEPS:
            launch(sweep, response, friction, until - done, least, new, wrong, moved)
            if moved[0] < least:
                break
            # What many bodies pass on to each other takes many sweeps; which contacts hold is known after a few.
            found = balanced(new, wrong, response, friction, least, STUCK * SLIDES * self.spacing)
            if found is not None:
                new = found
                break
            done, until = until, min(2 * until - 1, SWEEPS)
        return np.asarray(new.reshape(2, count).T)

    @property
    def close(self) -> float:
        """Change of the solids' increments, below which a step is solved [m]."""
        fall = FALL * self.gravity * self.dt**2 * (1.0 if self.films is None else IN_FILMS)
        return float(max(FINEST * self.spacing, min(CLOSE * self.spacing, fall) if fall else CLOSE * self.spacing))

    def begun(self, before: Contacts, predicted: Array, film: Array) -> Trial:
        """The contacts that a step is first solved with, from those before, and predicted increments (B, 3)."""
        mobility = before.lightness / self.cm
        held, moves = before.of(self.places.key)[0], before.squeeze if self.films else np.zeros_like(film)
        trial = Trial(self, held, self.wrench(held, predicted), film, moves, mobility)
        force, squeeze = trial.found(predicted, mobility)
        wrench = self.wrench(force, predicted)
        change = wrench - trial.wrench + squeeze - moves
        begins = (predicted + self.response(mobility, change), None) if change.any() else None
        return replace(trial, force=force, wrench=wrench, squeeze=squeeze, begins=begins)


def balanced(force: Array, wrong: Array, response: Array, friction: Array, least: float, stuck: float) -> Array | None:
    """Forces that obey the law with the contacts that hold, stick and slide in sweeps; None where these are others.

    ``force`` (2 C,) is normal and along the edges, by sweeps, ``wrong`` (2 C,) are gaps beyond the skin, and slips,
    with them [m], ``response`` (2 C, 2 C) these by forces. ``least`` is the error of gaps, ``stuck`` of slips, as those
    of one side at its two ends do not agree [m].
    """
    count = len(friction)
    normal, along = force[:count], force[count:]
    holds = normal > 0
    sticks = holds & (np.abs(along) < (1 - FULL) * friction * normal)
    slides = holds & ~sticks
    sense = np.where(slides, np.sign(along), 0.0)
    across, beside = np.hsplit(np.eye(2 * count), 2)
    ways = np.hstack([(across + sense * friction * beside)[:, holds], beside[:, sticks]])
    asked = np.append(holds, sticks)
    began = np.append(normal[holds], along[sticks])
    started = wrong + response @ (ways @ began - force)
    weight = np.append(np.full(count, GAPS_FIRST), np.ones(count))[asked]
    of_asked = (response @ ways)[asked] * weight[:, None]
    more = lstsq(of_asked, -started[asked] * weight, cond=1e-12, lapack_driver="gelsy", check_finite=False)[0]
    found = ways @ (began + more)
    left = started + response @ (ways @ more)
    pushes, rubs = found[:count], np.abs(found[count:])
    obeys = (
        (np.abs(left[:count][holds]) < least).all()
        and (np.abs(left[count:][sticks]) < stuck).all()
        and (pushes >= 0).all()
        and (rubs <= (1 + FULL) * friction * pushes).all()
        and (left[:count] > -least).all()
        and (sense * left[count:] < least).all()
    )
    return found if obeys else None


@dataclass(frozen=True)
class Trial:
    """Contacts of B solids in a step that is being solved."""

    law: Law  # of the step
    # force, wrench: see `Contacts`
    force: Array
    wrench: Array
    film: Array  # (B, 3) of the pressures of mouths in closed gaps on the solids
    squeeze: Array  # (B, 3) of the fluid that moves in them
    mobility: Array  # (3 B, 3 B) of the solids
    tolerance: float = 0.0  # of Newton's method [spacings]
    # change of the solids' increments by the last change of forces [m]; inf where that is not known
    left: float = math.inf
    most: float = 0.0  # the largest one in the step [m]
    rounds: int = 1  # how many times the step has been solved
    # (B, 3) increments of the solids, and how far particles slide on them, with which a solve begins; None as predicted
    begins: tuple[Array, Array | None] | None = None
    moved: Array | float = 0.0  # (B, 3) change of these by the last change of forces
    mouths: Array | float = 0.0  # (B, 3) of the pressures at the mouths of gaps in a full tank, see `Mouths`

    @property
    def solved(self) -> bool:
        """Whether the forces are those that the solids' increments ask for."""
        law, close = self.law, self.law.close * 2 ** max(0, self.rounds - EXACT)
        allowed = min(LEFT * self.most, self.tolerance * law.spacing)
        return bool(self.left < max(close, allowed))

    def asked(self, increment: Array, mobility: Array, tolerance: float = 0.0) -> Trial:
        """The same with the forces that increments (B, 3) ask for, and how far these move the solids.

        ``mobility`` (3 B, 3 B) is their derivative by the wrench; Newton's method has a tolerance [spacings].
        """
        law = self.law
        force, squeeze = self.found(increment, mobility)
        wrench = law.wrench(force, increment)
        left = max(law.moved(mobility, change) for change in (wrench - self.wrench, squeeze - self.squeeze))
        most = max(self.most, left)
        new = replace(self, mobility=mobility, left=left, most=most, tolerance=tolerance)
        change = wrench - self.wrench + squeeze - self.squeeze
        return replace(new, force=force, wrench=wrench, squeeze=squeeze, moved=law.response(mobility, change))

    def found(self, increment: Array, mobility: Array) -> tuple[Array, Array]:
        """Forces (C, 2) of contacts, and of films (B, 3), that increments (B, 3) ask for, see `asked`.

        With w = w_0 - K dq of films and dq = A dw of the solids, contacts move the solids with (1 + A K)^-1 A.
        """
        law = self.law
        if law.films is None:
            return law.adjusted(self.force, increment, mobility), self.squeeze
        free = np.outer(law.free, law.free)
        target, stiff = law.films.wrench(increment.ravel())
        short = target - self.squeeze.ravel()
        stiff = np.where(free, stiff, 0.0)
        softer = np.linalg.solve(np.eye(len(stiff)) + mobility @ stiff, mobility)
        by_film = softer @ np.where(law.free, short, 0.0)
        force = law.adjusted(self.force, increment, softer, by_film)
        change = law.wrench(force - self.force, increment).ravel()
        moved = by_film + softer @ np.where(law.free, change, 0.0)
        return force, self.squeeze + (short - stiff @ moved).reshape(-1, 3)

    @property
    def total(self) -> Array:
        """(B, 3) all of it on the solids."""
        return np.asarray(self.wrench + self.film + self.squeeze)

    def ended(self, before: Contacts, increment: Array) -> Contacts:
        """The contacts at the end of the step; ``before``: those at the end of the last one."""
        law, key = self.law, self.law.places.key
        sense, (smooth, old) = law.senses(self.force, increment), before.of(key)
        # What comes as near as that, but has not struck yet, is open.
        sense = np.where((old == 2) & (self.force[:, 0] == 0), 2.0, sense)
        stays = set(map(tuple, key.tolist()))
        lost = any(tuple(k) not in stays for k in before.key[before.sense < 2].tolist())
        changed = (sense != old) & (old < 2)
        hits = law.approaching & ((sense < 2) & ((old == 2) | before.jumped) | law.bounces[0])
        jumped = bool((changed | hits & (self.force[:, 0] > 0)).any() or lost)
        # Impulses do not go on; nor does the acceleration that they give, see `BackwardEuler`.
        force = np.where((sense < 2)[:, None], smooth, 0.0) if jumped else self.force
        film, lightness = self.film + self.squeeze + self.mouths, law.cm * self.mobility
        return Contacts(key, force, sense, jumped, self.wrench, film, self.squeeze, lightness)
