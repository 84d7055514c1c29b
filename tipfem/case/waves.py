"""Waves by height and period: the motion of a piston that makes them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated

from annotated_types import Ge, Gt

from tipfem.case.declaration import Unit, require

GRAVITY = 9.81  # m/s^2


@dataclass(frozen=True, kw_only=True)
class WavePiston:
    """Displacement of a wall that makes waves: ``tank.wall("left", slip=True, motion=WavePiston(...))``.

    In first order the stroke is S = H / m, m = 2 sinh(kd)^2 / (sinh(kd) cosh(kd) + kd) (T. H. Havelock, Phil. Mag. 8,
    1929). The second order takes away the free wave of twice the frequency that a sine of the piston would make (O. S.
    Madsen, J. Geophys. Res. 76, 1971). The tank needs a vent, or a free surface, since the piston changes its volume.

    Attributes:
        height: of the waves, from trough to crest.
        period: of the waves.
        depth: of the water at rest.
        ramp: periods in which the motion rises smoothly from rest.
        order: 1 or 2.

    Raises:
        ValueError: a value is out of its range, or a wave of that height would break.
    """

    height: Annotated[float, Gt(0), Unit("m")]
    period: Annotated[float, Gt(0), Unit("s")]
    depth: Annotated[float, Gt(0), Unit("m")]
    ramp: Annotated[float, Ge(0), Unit("periods")] = 2.0
    order: int = 2

    def __post_init__(self) -> None:
        require(self, subject="WavePiston")
        if self.order not in (1, 2):
            raise ValueError(f"WavePiston: order is {self.order!r}; it must be 1 or 2")
        steepest = 0.142 * self.length * math.tanh(self.number * self.depth)  # Miche
        if self.height > steepest:
            raise ValueError(f"WavePiston: height is {self.height:g} m; waves break above {steepest:.3g} m")

    @cached_property
    def number(self) -> float:
        """Wave number k of omega^2 = g k tanh(k d) [1/m]."""
        frequency = 2 * math.pi / self.period
        k = frequency**2 / GRAVITY
        for _ in range(200):  # halving steps: the iteration alone swings in shallow water
            k = 0.5 * (k + frequency**2 / (GRAVITY * math.tanh(k * self.depth)))
        return k

    @property
    def length(self) -> float:
        """Of the waves [m]."""
        return 2 * math.pi / self.number

    @property
    def stroke(self) -> float:
        """Of the piston from end to end, in first order [m]."""
        return self.height / self._transfer

    @property
    def _transfer(self) -> float:
        kd = self.number * self.depth
        return 2 * math.sinh(kd) ** 2 / (math.sinh(kd) * math.cosh(kd) + kd)

    def __call__(self, time: float) -> float:
        """Displacement at a time [s] along the wall's normal, into the water [m]."""
        kd, phase = self.number * self.depth, 2 * math.pi * time / self.period
        result = 0.5 * self.stroke * math.sin(phase)
        if self.order == 2:
            second = 3 * math.cosh(kd) / math.sinh(kd) ** 3 - 2 / self._transfer
            result += self.height**2 / (32 * self.depth) * second * math.sin(2 * phase)
        part = min(max(time / (self.ramp * self.period), 0.0), 1.0) if self.ramp else 1.0
        return part * part * (3 - 2 * part) * result
