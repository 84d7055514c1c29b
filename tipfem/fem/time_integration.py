"""Time integration: generalized-alpha, backward Euler for impacts, and the length of the time step."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from tipfem.backend.arrays import partials
from tipfem.backend.launch import launch
from tipfem.case.particles import Particles
from tipfem.fem import step_limits
from tipfem.fem.bundles import Rates
from tipfem.fem.rates import combination, rates_at_end
from tipfem.mesh.mesh import Mesh
from tipfem.scratch import owned
from tipfem.typing import Array

# Steps in which a particle moves by more than this [spacings] are shortened until J >= GENTLE; shorter steps are not,
# because a particle that approaches a wall would make steps ever shorter and never reach it.
LONG_MOVE = 0.5
GENTLE = 0.4  # smallest J of an element at the present velocities after such a step

SAFETY, SHRINKAGE = 0.7, 0.5  # of the tolerated error that a step aims at; smallest length relative to the last

SHORTEST = 1e-6  # time step in sqrt(h / |b|), in which gravity moves a particle by 1e-12 h, ten times the round-off


def require_felt(dt: float, frequency: float) -> None:
    """Raise `ValueError` if gravity is lost in round-off of positions in steps ``dt`` [s]; sqrt(|b| / h) [1/s]."""
    if 0 < frequency * dt < SHORTEST:
        raise ValueError(
            f"Simulation: time step is {dt:g} s; it must be {SHORTEST / frequency:.2g} s or more, "
            "for what gravity moves in a shorter step is lost in round-off"
        )


def smallest_jacobian(mesh: Mesh, particles: Particles, dt: float) -> float:
    """Smallest J of an element after ``dt`` [s] at the particles' present velocities."""
    result = np.array([1e30])
    launch(
        step_limits.smallest_jacobian,
        np.ascontiguousarray(mesh.cells),
        mesh.position,
        mesh.period.array,
        np.ascontiguousarray(particles.velocity),
        partials(0),
        result,
        dt,
        len(mesh.cells),
        mesh.dimension,
    )
    return float(result[0])


class TimeScheme(ABC):
    """The interface of a step to its time integration, with the step's displacements u = x_{n+1} - x_n as unknowns.

    Accelerations and velocities of the equations are linear in u, those at the end of the step in u and the rates at
    its start. All arguments are arrays of one shape, (N, d) for particles and (B, 3) for bodies: what has a
    displacement, a velocity and an acceleration is integrated by the same formulas.
    """

    dt: float  # time step [s]
    # alpha_m, alpha_f: (.)_alpha = (1 - alpha) (.)_{n+1} + alpha (.)_n of what is prescribed, alpha_m for
    # accelerations, alpha_f for velocities and positions
    alpha_m: float
    alpha_f: float
    gamma: float  # gamma, beta: of velocities and displacements, see `GeneralizedAlpha`
    beta: float
    # whether v_alpha and a_alpha are those weighted means of the rates at both ends of the step. Where they are not,
    # they follow from u alone, also for particles whose motion is not linear in it.
    weighs: ClassVar[bool] = True

    @property
    @abstractmethod
    def cm(self) -> float:
        """d a_alpha / d u [1/s^2]."""

    @property
    @abstractmethod
    def cv(self) -> float:
        """d v_alpha / d u [1/s]."""

    @property
    def cf(self) -> float:
        """d x_alpha / d u."""
        return 1 - self.alpha_f

    @cached_property
    def factors(self) -> Rates:
        """These derivatives and the step's length, for kernels."""
        return Rates(self.cm, self.cv, self.cf, self.dt)

    @abstractmethod
    def rates(self, u: Array, velocity: Array, acceleration: Array) -> tuple[Array, Array]:
        """v_{n+1} and a_{n+1} for displacements ``u``, from v_n and a_n."""

    @abstractmethod
    def history(self, velocity: Array, acceleration: Array, name: str = "") -> tuple[Array, Array]:
        """v_alpha and a_alpha at u = 0, from v_n and a_n; in memory of a ``name`` or new, see `scratch`."""

    @abstractmethod
    def next_rate(self, load: Any, rate: Any) -> Any:
        """a_{n+1} where a_alpha is ``load`` and a_n is ``rate``; numbers or arrays, of accelerations or of forces."""

    @abstractmethod
    def mean_load(self, load: Any, rate: Any) -> Any:
        """(v_{n+1} - v_n) / dt for the same arguments."""

    def predict(self, velocity: Array, acceleration: Array, name: str = "") -> Array:
        """Displacements at constant acceleration, in memory of a ``name`` or new, see `scratch`."""
        return combination(self.dt, velocity, 0.5 * self.dt**2, acceleration, name)

    def advance(self, particles: Particles, u: Array, pressure: Array) -> Particles:
        """The state at the end of the step, from displacements (N, d) and pressures (N,)."""
        v_next, a_next = self.rates(u, particles.velocity, particles.acceleration)
        fixed = particles.wall.nonzero()[0]
        a_next[fixed] = 0.0
        v_next[fixed] = 0.0
        position = np.add(particles.position, u, out=owned(u.shape))
        return particles.shallow_copy(position=position, velocity=v_next, acceleration=a_next, pressure=pressure)


@dataclass(frozen=True)
class GeneralizedAlpha(TimeScheme):
    """The generalized-alpha method (Chung & Hulbert, J. Appl. Mech. 60, 1993) in displacements.

    With u = x_{n+1} - x_n:
    a_{n+1} = u / (beta dt^2) - v_n / (beta dt) - (1 / (2 beta) - 1) a_n,
    v_{n+1} = v_n + dt ((1 - gamma) a_n + gamma a_{n+1}), and (.)_alpha = (1 - alpha) (.)_{n+1} + alpha (.)_n.

    In other words, a_{n+1} = a_n + r (a_alpha - a_n) with r = 1 / (1 - alpha_m). Other alpha_m, with gamma of second
    order and (1 - alpha_m) / beta unchanged, have the same displacements and a_alpha in the step, and the same
    v_{n+1} + (1/2 - alpha_f) dt a_{n+1}, which is what the method conserves of momentum. So ``relaxation`` can be
    chosen when the step has been solved. It changes v_{n+1} by a part to dt^2 in smooth flows. With rho_inf = 0 what
    constraints stop is damped by sqrt(abs(1 - relaxation)) a step, instead of at once.
    """

    rho_inf: float  # spectral radius at infinite frequency, 0 (strongest damping) to 1 (none)
    dt: float  # time step [s]
    relaxation: float = 1.0  # r relative to that of Chung and Hulbert, above 0 and below 2
    alpha_m: float = field(init=False)
    alpha_f: float = field(init=False)
    gamma: float = field(init=False)
    beta: float = field(init=False)

    def __post_init__(self) -> None:
        alpha_m = (2 * self.rho_inf - 1) / (self.rho_inf + 1)
        alpha_f = self.rho_inf / (self.rho_inf + 1)
        beta = 0.25 * (1 - alpha_m + alpha_f) ** 2
        if self.relaxation != 1.0:
            beta /= self.relaxation
            alpha_m = 1 - (1 - alpha_m) / self.relaxation
        object.__setattr__(self, "alpha_m", alpha_m)
        object.__setattr__(self, "alpha_f", alpha_f)
        object.__setattr__(self, "gamma", 0.5 - alpha_m + alpha_f)
        object.__setattr__(self, "beta", beta)

    @property
    def cm(self) -> float:
        """See `TimeScheme.cm`."""
        return (1 - self.alpha_m) / (self.beta * self.dt**2)

    @property
    def cv(self) -> float:
        """See `TimeScheme.cv`."""
        return (1 - self.alpha_f) * self.gamma / (self.beta * self.dt)

    def rates(self, u: Array, velocity: Array, acceleration: Array) -> tuple[Array, Array]:
        """See `TimeScheme.rates`."""
        of_a = 1 / (self.beta * self.dt**2), 1 / (self.beta * self.dt), 0.5 / self.beta - 1
        return rates_at_end(u, velocity, acceleration, *of_a, 1 - self.gamma, self.gamma, self.dt)

    def history(self, velocity: Array, acceleration: Array, name: str = "") -> tuple[Array, Array]:
        """See `TimeScheme.history`."""
        by_v, by_a = -1 / (self.beta * self.dt), 1 - 0.5 / self.beta  # a_{n+1} at u = 0 is by_v v_n + by_a a_n
        share = (1 - self.alpha_f) * self.dt
        of_v = 1 + share * self.gamma * by_v, share * (1 - self.gamma + self.gamma * by_a)
        of_a = (1 - self.alpha_m) * by_v, (1 - self.alpha_m) * by_a + self.alpha_m
        names = f"{name}.velocity" if name else "", f"{name}.acceleration" if name else ""
        v_alpha, a_alpha = (
            combination(k, velocity, m, acceleration, of) for (k, m), of in zip((of_v, of_a), names, strict=True)
        )
        return v_alpha, a_alpha

    def next_rate(self, load: Any, rate: Any) -> Any:
        """See `TimeScheme.next_rate`."""
        return (load - self.alpha_m * rate) / (1 - self.alpha_m)

    def mean_load(self, load: Any, rate: Any) -> Any:
        """See `TimeScheme.mean_load`."""
        return (1 - self.gamma) * rate + self.gamma * self.next_rate(load, rate)


@dataclass(frozen=True)
class BackwardEuler(TimeScheme):
    """Backward Euler's method for what jumps in a step, with forces at the middle of the displacements.

    v_{n+1} = u / dt + a dt / 2 and a_alpha = (v_{n+1} - v_n) / dt with the acceleration a that lasts through the step,
    see `lasting`; velocities in the equations are u / dt, and forces act at the positions x_n + u / 2. Where a mass is
    stopped, a is 0: a wall takes its momentum once, and it does not overshoot. Elsewhere a is a_n, and the pressure is
    as exact as in other steps; with 0 it would be half of what accelerates the fluid, and twice that in the next step.
    Kinetic energy falls by sum m dt^2 a_alpha (a_alpha - a) / 2 beside the work of the forces, and pressure at the
    middle positions does no work on elements that keep their area (2-D). That velocities that jump are integrated so,
    and smooth ones by generalized-alpha, follows Q. Chen, V. Acary, G. Virlez, O. Bruls, Int. J. Numer. Meth. Eng. 96,
    2013, where it is a matter of each contact; pressure makes it one of the whole step.

    What generalized-alpha goes on from is the acceleration that lasts, which a_alpha is not.
    """

    dt: float  # time step [s]
    # whether a_{n+1} is a_alpha instead of a_n: in the second of two such steps, in which it has no jump any
    # more, or a_n does not hold any more
    renews: bool = False
    weighs: ClassVar[bool] = False
    alpha_m: float = field(init=False, default=0.5)
    alpha_f: float = field(init=False, default=0.5)
    gamma: float = field(init=False, default=1.0)
    beta: float = field(init=False, default=1.0)

    @property
    def cm(self) -> float:
        """See `TimeScheme.cm`."""
        return 1 / self.dt**2

    @property
    def cv(self) -> float:
        """See `TimeScheme.cv`."""
        return 1 / self.dt

    def rates(self, u: Array, velocity: Array, acceleration: Array) -> tuple[Array, Array]:
        """See `TimeScheme.rates`."""
        v_next = u / self.dt + 0.5 * self.dt * acceleration
        return v_next, (v_next - velocity) / self.dt if self.renews else acceleration.copy()

    def history(self, velocity: Array, acceleration: Array, name: str = "") -> tuple[Array, Array]:
        """See `TimeScheme.history`."""
        return np.zeros_like(velocity), velocity * (-1 / self.dt) + 0.5 * acceleration

    def next_rate(self, load: Any, rate: Any) -> Any:
        """See `TimeScheme.next_rate`."""
        return load if self.renews else rate

    def mean_load(self, load: Any, rate: Any) -> Any:
        """See `TimeScheme.mean_load`."""
        return load


def lasting(rate: Array, load: Array) -> Array:
    """Accelerations (K, d) that last through a jump of velocities: the part of a_n, ``rate``, that a_alpha has, too.

    They are a_n where a_alpha, ``load``, is at least as large along it, less of it where it is smaller, and 0 where it
    points the other way. So a_alpha (a_alpha - a) is never negative, see `BackwardEuler`.
    """
    square, along = (rate * rate).sum(axis=1), (rate * load).sum(axis=1)
    return np.asarray(rate * np.clip(along / np.where(square > 0, square, 1.0), 0.0, 1.0)[:, None])


def local_error(scheme: TimeScheme, change: float) -> float:
    """Estimated error of displacements that generalized-alpha makes in a step.

    In the manner of O. C. Zienkiewicz, Y. M. Xie, Earthq. Eng. Struct. Dyn. 20, 1991, it is what the displacement
    v_n dt + ((1/2 - beta) a_n + beta a_{n+1}) dt^2 differs by where the acceleration b is linear in time. The method's
    a_n is b a time s dt before, s = alpha_f - alpha_m, so that this is (beta - s/2 - 1/6) dt^2 (a_{n+1} - a_n), and
    a_{n+1} - a_n is the change of the acceleration to the intermediate time over 1 - alpha_m.

    Args:
        change: of the acceleration from its start to the intermediate time [1/s^2 for an error in spacings]. That of a
            flow is the root mean square over the particles, each with its target spacing as the unit and m |u|^2 as
            its weight: it is the error of what moves, however much fluid is at rest around.
    """
    factor = scheme.beta - 0.5 * (scheme.alpha_f - scheme.alpha_m) - 1 / 6
    return factor / (1 - scheme.alpha_m) * scheme.dt**2 * change


@dataclass
class StepControl:
    """The length of the time step: halved when a step is refused, grown back afterwards.

    It also follows the error of the time integration, of third order in the length: the next step is as long as its
    error would be 0.7 of the tolerance. No step is refused for its error.
    """

    largest: float  # largest time step [s]
    smallest: float = 0.0  # smallest time step, below which a run ends with an error [s]
    growth: float = 1.25  # factor by which an accepted step may grow
    # largest displacement of a particle in a step, in spacings; steps that exceed it are refused. By default 0.15
    # more than ``target``.
    reach: float = 0.0
    # displacement of the fastest particle that the next step aims at, in spacings; more than half a spacing only
    # if J of no element falls below a limit
    target: float = 0.35
    tolerance: float = math.inf  # of the error of a step, see `local_error` [spacings]; infinite for none
    # displacement of the fastest particle up to which steps are not shortened for their error, in spacings
    free: float = 0.0
    # a move [spacings] down to which steps are shortened further until J of no element falls below a limit
    shorter: tuple[float, float] = (LONG_MOVE, GENTLE)
    accurate: float = math.inf  # length that the error of the last step lets the next one have [s]
    current: float = field(default=0.0)
    # what limited the last `length`: "maximum" (`largest`), "error" (`accurate`), "motion" (`target`), "smallest
    # J", "output" (a time that a step is to end at: that of the run, or of outputs that are less than a step
    # apart), "refusals" (growing back after a step that was refused) or "minimum" (`smallest`)
    limit: str = "maximum"

    def __post_init__(self) -> None:
        if not (math.isfinite(self.largest) and self.largest > 0):
            raise ValueError(f"time step is {self.largest!r} s; it must be > 0")
        self.smallest = self.smallest or 1e-5 * self.largest
        self.current = self.current or self.largest
        self.reach = self.reach or self.target + 0.15

    def length(self, speed: float, remaining: float, jacobian: Callable[[float], float] = lambda _dt: 1.0) -> float:
        """Length of the next step [s].

        ``speed`` is the largest of a particle, in its target spacings [1/s]; the time until the step is to end at the
        latest, ``remaining`` [s], is divided evenly. ``jacobian`` is the smallest J of an element at the present
        velocities, by the length.
        """
        dt = self.current
        self.limit = "maximum" if dt >= self.largest else "refusals"
        accurate = max(self.accurate, self.free / speed) if speed > 0 else self.accurate
        if accurate < dt:
            dt, self.limit = accurate, "error"
        if speed > 0:
            if self.target / speed < dt:
                dt, self.limit = self.target / speed, "motion"
            dt = self._gentle(dt, LONG_MOVE / speed, GENTLE, jacobian)
            if dt <= LONG_MOVE / speed:
                dt = self._gentle(dt, self.shorter[0] / speed, self.shorter[1], jacobian)
        if dt < self.smallest:
            dt, self.limit = self.smallest, "minimum"
        if math.isfinite(remaining):
            divided = remaining / max(1, math.ceil(remaining / dt - 1e-9))
            if divided < (1 - 1e-6) * dt:
                self.limit = "output"
            if abs(divided - dt) > 1e-9 * dt:  # a run to another time has the same bits where its steps are the same
                dt = divided
        return dt

    def _gentle(self, dt: float, least: float, gentle: float, jacobian: Callable[[float], float]) -> float:
        """Length of a step, at most ``dt`` and at least ``least`` if that is less, after which J is ``gentle`` [s]."""
        least = min(dt, least)
        for _ in range(3):
            if dt <= least or (smallest := jacobian(dt)) >= gentle:
                return dt
            # In a divergence-free flow, 1 - J grows as dt^2.
            dt = max(least, 0.99 * dt * math.sqrt((1 - gentle) / (1 - smallest)))
            self.limit = "smallest J"
        return least

    def accept(self, dt: float, error: float = math.nan) -> None:
        """A step of length ``dt`` was accepted, with that error [spacings], NaN if unknown: the next may be longer."""
        self.current = min(self.largest, max(self.current, dt) * self.growth)
        if math.isfinite(self.tolerance) and error >= 0:
            factor = (SAFETY * self.tolerance / error) ** (1 / 3) if error > 0 else math.inf
            self.accurate = min(dt * max(SHRINKAGE, factor), self.growth * max(self.accurate, dt))

    def refuse(self, dt: float) -> bool:
        """A step of length ``dt`` was refused: halve it. False when that is below the smallest."""
        self.current = 0.5 * dt
        return self.current >= self.smallest
