"""Forces: what moves the fluids in a step, where a run is steered: another gravity, a poke, other viscosities."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tipfem.case.case import Case
from tipfem.case.fluid import Fluid
from tipfem.case.rheology import Law
from tipfem.geometry.period import Period
from tipfem.typing import Array


@dataclass(frozen=True)
class PokeForce:
    """An acceleration a (1 - |x - c|^2 / r^2)^2 in a radius r around a point c until a time, and zero outside."""

    at: tuple[float, ...]  # (d,) the point c [m]
    acceleration: tuple[float, ...]  # (d,) a, that at the point [m/s^2]
    radius: float  # r [m]
    end: float  # time from which on there is no force [s]; a step that begins before it has the force to its end

    def field(self, position: Array, period: Period) -> Array:
        """Acceleration (N, d) [m/s^2] at positions (N, d) [m] with a period."""
        square = (period.shortest(position - np.array(self.at)) ** 2).sum(axis=1) / self.radius**2
        weight = np.maximum(1.0 - square, 0.0) ** 2
        return np.asarray(weight[:, None] * np.array(self.acceleration))


@dataclass(frozen=True)
class Forces:
    """Gravity and further forces in place of those of a case; by default the case's own."""

    gravity: tuple[float, ...] | None = None  # (d,) in place of the case's [m/s^2]; None for the case's
    poke: PokeForce | None = None  # a force in addition; None for none
    # (F,) of the fluids in place of the case's [Pa s], or their laws; None for the case's
    viscosity: tuple[float | Law, ...] | None = None

    def fluids(self, case: Case) -> list[Fluid]:
        """The case's fluids, with these viscosities."""
        if not self.viscosity:
            return list(case.fluids)
        return [replace(fluid, viscosity=value) for fluid, value in zip(case.fluids, self.viscosity, strict=True)]

    def pokes(self, time: float) -> bool:
        """Whether the poke acts in a step that begins at a time [s]."""
        return self.poke is not None and time < (1 - 1e-9) * self.poke.end

    def vary(self, case: Case, start: float) -> bool:
        """Whether the acceleration varies in space or time in a step that begins at ``start`` [s]."""
        return case.body_force is not None or self.pokes(start)

    def acceleration(self, case: Case, position: Array, time: float, start: float) -> Array:
        """Acceleration (N, d) [m/s^2] by gravity, body force and the poke, in a step that begins at ``start`` [s]."""
        force = case.acceleration(position, time)
        if self.gravity is not None:
            force += np.array(self.gravity) - case.gravity
        if self.pokes(start):
            assert self.poke is not None
            force += self.poke.field(position, case.period)
        return force
