"""Estimates of the cost of a run, before it starts: particles, memory, steps and time."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from tipfem.case.case import Case
from tipfem.case.memory import BYTES_A_PARTICLE
from tipfem.results.fields import FieldOutput

# Measured with dam breaks of 2 000 to 220 000 particles on one core of a 2.x GHz server of 2023 (x86-64), on an idle
# machine; 3-D with demos of 3 000 to 10 000 particles, 25 on an idle machine. Splashes cost up to twice as much as the
# first steps.
MICROSECONDS = {"sharp": 4.0, "interpolated": 7.0, "free surface": 13.0, "3-D": 30.0}  # a particle and step
STEP = 2e-3  # of a step without particles [s]
# Largest speed in a splash in a closed tank with gas, that of the gas which jets push aside, by that of a free fall, in
# the mean of a run: 2 in the dam break to 0.4 s, 3.4 in one over a step to 0.6 s.
SPLASH = 3.0
ACCURATE = 1.1  # largest move in a step that the error of the time integration allows in splashes [spacings]
GAS = 0.02  # of the largest density
START = 8.0  # of a start, in which the kernels are compiled or loaded [s]
# Bytes of a state on disk, a particle, and of the checkpoints that are kept, with dam breaks in 2-D.
VTU = {"double": 56.0, "single": 34.0}
VTKHDF = {"double": 48.0, "single": 29.0}  # compressed; without, three times as many
CHECKPOINTS = 3 * 330.0
BYTES = 200e6  # of a process without particles


@dataclass(frozen=True)
class Estimate:
    """Estimated cost of a run."""

    particles: int  # at the start, and how many of them make the walls
    walls: int  # how many of them make the walls
    memory: float  # [bytes]
    disk: float  # of states and checkpoints together [bytes]
    states: int  # written to disk, the initial one included
    # fewest, if no particle is fast; and most, if the fastest always falls freely from the highest place, or, where a
    # gas gives way to a liquid that splashes, is `SPLASH` times as fast
    steps: tuple[int, int]
    seconds: tuple[float, float]  # on one core, for the fewest and the most steps [s]

    def lines(self) -> list[str]:
        """For people."""
        (few, many), (short, long) = self.steps, self.seconds
        last = f" to {duration(long)}" if duration(long) != duration(short) else ""
        return [
            f"particles   {self.particles}, {self.walls} of them on walls",
            f"memory      about {self.memory / 1e6:.0f} MB",
            f"steps       {few} to {many}" if few < many else f"steps       {few}",
            f"states      {self.states} written to disk, with the checkpoints about {self.disk / 1e6:.3g} MB",
            f"time        about {duration(short)}{last} on one core",
        ]


def estimate(
    case: Case, end: float, largest_step: float | None, interval: float | None, fields: FieldOutput | None = None
) -> Estimate:
    """Estimate the cost of a run to ``end`` [s] from rates of one machine: right within a factor of two or so.

    ``interval`` is that between states on disk [s], or None; ``largest_step`` and ``fields`` are None for the defaults.
    """
    particles, d = case.particles, case.particles.dimension
    default = case.default_step()
    step = largest_step or (default if math.isfinite(default) else 1e-3)
    outputs = math.ceil(end / interval) if interval else 0
    few = math.ceil(end / step - 1e-9)
    move = min(case.largest_move, ACCURATE) * particles.spacing
    densities = [fluid.density for fluid in case.fluids]
    splash = SPLASH if not case.free_surface and min(densities) < GAS * max(densities) else 1.0
    many = max(few, math.ceil(splash * end * largest_speed(case) / move))
    if case.grading is not None and case.grading.film_resolution is not None:
        many = math.ceil(many * particles.spacing / case.grading.film_resolution)  # as short as films allow
    kind = "3-D" if d == 3 else "free surface" if case.free_surface else case.interface
    count = len(particles)
    a_step = STEP + 1e-6 * MICROSECONDS[kind] * count
    return Estimate(
        count,
        int(particles.wall.sum()),
        BYTES + BYTES_A_PARTICLE[d] * count,
        count * (_bytes_of_state(fields or FieldOutput(), d) * (1 + max(outputs, 1)) + CHECKPOINTS * d / 2),
        1 + max(outputs, 1),
        (few, many),
        (START + few * a_step, START + many * a_step),
    )


def _bytes_of_state(fields: FieldOutput, dimension: int) -> float:
    """Bytes of a state on disk per particle."""
    each = VTU[fields.precision] * fields.vtu + VTKHDF[fields.precision] * fields.vtkhdf
    return each * (1.0 if dimension == 2 else 2.5)  # in 3-D there are three times as many cells a particle


def largest_speed(case: Case) -> float:
    """The speed of a free fall through the height of the fluids, or of a wall or an inlet that is faster [m/s]."""
    particles = case.particles
    gravity = float(np.linalg.norm(case.gravity))
    fall = 0.0
    if gravity:
        height = -particles.position[particles.fluid >= 0] @ (np.asarray(case.gravity) / gravity)
        if not case.free_surface and len(case.fluids) > 1:  # the heaviest fluid falls, the others give way
            heaviest = int(np.argmax([fluid.density for fluid in case.fluids]))
            own = -particles.position[particles.fluid == heaviest] @ (np.asarray(case.gravity) / gravity)
            fall = math.sqrt(2 * gravity * float(own.max() - height.min())) if len(own) else 0.0
        elif case.free_surface:
            fall = math.sqrt(2 * gravity * float(np.ptp(height)))
    walls = [float(np.linalg.norm(wall.sliding(0.0, particles.dimension))) for wall in case.walls]
    return max([fall, particles.max_speed, case.entering_speed(), *walls])


def duration(seconds: float) -> str:
    """A time for people."""
    for unit, size in (("days", 86400.0), ("h", 3600.0), ("min", 60.0)):
        if seconds >= 2 * size:
            return f"{seconds / size:.1f} {unit}"
    return f"{seconds:.0f} s"
