"""Generalized-alpha, and the length of the time step."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from tipfem.backend.arrays import partials
from tipfem.backend.launch import launch
from tipfem.case.particles import Particles
from tipfem.fem import step_limits
from tipfem.mesh.mesh import Mesh
from tipfem.typing import Array

# Steps in which a particle moves by more than this [spacings] are shortened until J >= GENTLE; shorter steps are not,
# because a particle that approaches a wall would make steps ever shorter and never reach it.
LONG_MOVE = 0.5
GENTLE = 0.4  # smallest J of an element at the present velocities after such a step

SHORTEST = 1e-6  # time step in sqrt(h / |b|), in which gravity moves a particle by 1e-12 h, ten times the round-off


def require_felt(dt: float, frequency: float) -> None:
    """Check that gravity is not lost in the round-off of positions.

    Args:
        dt: the largest time step [s].
        frequency: sqrt(|b| / h) with the acceleration b by gravity and body force [1/s].

    Raises:
        ValueError: it is.
    """
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


@dataclass(frozen=True)
class GeneralizedAlpha:
    """The generalized-alpha method (Chung & Hulbert, J. Appl. Mech. 60, 1993) in displacements.

    With u = x_{n+1} - x_n:
    a_{n+1} = u / (beta dt^2) - v_n / (beta dt) - (1 / (2 beta) - 1) a_n,
    v_{n+1} = v_n + dt ((1 - gamma) a_n + gamma a_{n+1}), and (.)_alpha = (1 - alpha) (.)_{n+1} + alpha (.)_n.

    Attributes:
        rho_inf: spectral radius at infinite frequency, 0 (strongest damping) to 1 (none).
        dt: time step [s].
    """

    rho_inf: float
    dt: float
    alpha_m: float = field(init=False)
    alpha_f: float = field(init=False)
    gamma: float = field(init=False)
    beta: float = field(init=False)

    def __post_init__(self) -> None:
        alpha_m = (2 * self.rho_inf - 1) / (self.rho_inf + 1)
        alpha_f = self.rho_inf / (self.rho_inf + 1)
        object.__setattr__(self, "alpha_m", alpha_m)
        object.__setattr__(self, "alpha_f", alpha_f)
        object.__setattr__(self, "gamma", 0.5 - alpha_m + alpha_f)
        object.__setattr__(self, "beta", 0.25 * (1 - alpha_m + alpha_f) ** 2)

    @property
    def cm(self) -> float:
        """d a_alpha / d u [1/s^2]."""
        return (1 - self.alpha_m) / (self.beta * self.dt**2)

    @property
    def cv(self) -> float:
        """d v_alpha / d u [1/s]."""
        return (1 - self.alpha_f) * self.gamma / (self.beta * self.dt)

    @property
    def cf(self) -> float:
        """d x_alpha / d u."""
        return 1 - self.alpha_f

    def acceleration(self, u: Array, particles: Particles) -> Array:
        """a_{n+1} (N, d) [m/s^2] for displacements ``u`` (N, d) [m]."""
        v, a = particles.velocity, particles.acceleration
        result = u * (1 / (self.beta * self.dt**2))
        result -= v * (1 / (self.beta * self.dt))
        result -= a * (0.5 / self.beta - 1)
        return result

    def velocity(self, a_next: Array, particles: Particles) -> Array:
        """v_{n+1} (N, d) [m/s] for accelerations ``a_next`` (N, d)."""
        return particles.velocity + self.dt * ((1 - self.gamma) * particles.acceleration + self.gamma * a_next)

    def history(self, particles: Particles) -> tuple[Array, Array]:
        """v_alpha and a_alpha (N, d) at u = 0."""
        v, a = particles.velocity, particles.acceleration
        by_v, by_a = -1 / (self.beta * self.dt), 1 - 0.5 / self.beta  # a_{n+1} at u = 0 is by_v v_n + by_a a_n
        share = (1 - self.alpha_f) * self.dt
        velocity = (1 + share * self.gamma * by_v) * v + share * (1 - self.gamma + self.gamma * by_a) * a
        return velocity, (1 - self.alpha_m) * by_v * v + ((1 - self.alpha_m) * by_a + self.alpha_m) * a

    def predict(self, particles: Particles) -> Array:
        """Displacements (N, d) [m] at constant acceleration."""
        return self.dt * particles.velocity + 0.5 * self.dt**2 * particles.acceleration

    def advance(self, particles: Particles, u: Array, pressure: Array) -> Particles:
        """The state at the end of the step, from displacements (N, d) and pressures (N,)."""
        a_next = self.acceleration(u, particles)
        v_next = self.velocity(a_next, particles)
        fixed = particles.wall.nonzero()[0]
        a_next[fixed] = 0.0
        v_next[fixed] = 0.0
        return particles.shallow_copy(
            position=particles.position + u, velocity=v_next, acceleration=a_next, pressure=pressure
        )


@dataclass
class StepControl:
    """The length of the time step: halved when a step is refused, grown back afterwards.

    Attributes:
        largest: largest time step [s].
        smallest: smallest time step, below which a run ends with an error [s].
        growth: factor by which an accepted step may grow.
        reach: largest displacement of a particle in a step, in spacings; steps that exceed it
            are refused. By default 0.15 more than ``target``.
        target: displacement of the fastest particle that the next step aims at, in spacings; more than half a
            spacing only if J of no element falls below a limit.
        limit: what limited the last `length`: "maximum" (`largest`), "motion" (`target`), "smallest J", "output" (the
            next output or the end of the run), "refusals" (growing back after a step that was refused) or "minimum"
            (`smallest`).
    """

    largest: float
    smallest: float = 0.0
    growth: float = 1.25
    reach: float = 0.0
    target: float = 0.35
    current: float = field(default=0.0)
    limit: str = "maximum"

    def __post_init__(self) -> None:
        if not (math.isfinite(self.largest) and self.largest > 0):
            raise ValueError(f"time step is {self.largest!r} s; it must be > 0")
        self.smallest = self.smallest or 1e-5 * self.largest
        self.current = self.current or self.largest
        self.reach = self.reach or self.target + 0.15

    def length(self, speed: float, remaining: float, jacobian: Callable[[float], float] = lambda _dt: 1.0) -> float:
        """Length of the next step [s].

        Args:
            speed: largest speed of a particle, in its target spacings [1/s].
            remaining: time until the next output or the end of the run [s]; it is divided evenly.
            jacobian: smallest J of an element at the present velocities, as a function of the step's length.
        """
        dt = self.current
        self.limit = "maximum" if dt >= self.largest else "refusals"
        if speed > 0:
            if self.target / speed < dt:
                dt, self.limit = self.target / speed, "motion"
            least = min(dt, LONG_MOVE / speed)
            for _ in range(3):
                if dt <= least or (smallest := jacobian(dt)) >= GENTLE:
                    break
                # In a divergence-free flow, 1 - J grows as dt^2.
                dt = max(least, 0.99 * dt * math.sqrt((1 - GENTLE) / (1 - smallest)))
                self.limit = "smallest J"
            else:
                dt = least
        if dt < self.smallest:
            dt, self.limit = self.smallest, "minimum"
        if math.isfinite(remaining):
            divided = remaining / max(1, math.ceil(remaining / dt - 1e-9))
            if divided < (1 - 1e-6) * dt:
                self.limit = "output"
            dt = divided
        return dt

    def accept(self, dt: float) -> None:
        """A step of length ``dt`` was accepted: the next may be longer."""
        self.current = min(self.largest, max(self.current, dt) * self.growth)

    def refuse(self, dt: float) -> bool:
        """A step of length ``dt`` was refused: halve it. False when that is below the smallest."""
        self.current = 0.5 * dt
        return self.current >= self.smallest
