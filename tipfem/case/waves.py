"""Waves by height and period, or by a spectrum: the motion of a piston that makes them."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, ClassVar, Literal

import numpy as np
from annotated_types import Ge, Gt, Le

from tipfem.case.declaration import Unit, require
from tipfem.errors import Invalid
from tipfem.typing import Array

GRAVITY = 9.81  # m/s^2
FREQUENCIES = 0.6, 3.0  # of a spectrum, over that of its peak: the rest has 2 % of the energy


def wave_number(period: float, depth: float) -> float:
    """Wave number k of omega^2 = g k tanh(k d) [1/m], for a period [s] and a depth d [m]."""
    frequency = 2 * math.pi / period
    k = frequency**2 / GRAVITY
    for _ in range(200):  # halving steps: the iteration alone swings in shallow water
        k = 0.5 * (k + frequency**2 / (GRAVITY * math.tanh(k * depth)))
    return k


def piston_transfer(kd: float) -> float:
    """Height of waves over the stroke of a piston, in first order (T. H. Havelock, Phil. Mag. 8, 1929)."""
    if kd > 300:
        return 2.0
    return 2 * math.sinh(kd) ** 2 / (math.sinh(kd) * math.cosh(kd) + kd)


@dataclass(frozen=True, kw_only=True)
class WaveMaker(ABC):
    """Displacement of a wall that makes waves.

    Attributes:
        height: of the waves, from trough to crest [m].
        period: of the waves [s].
        depth: of the water at rest [m].
        ramp: periods in which the motion rises smoothly from rest.
    """

    height: Annotated[float, Gt(0), Unit("m")]
    period: Annotated[float, Gt(0), Unit("s")]
    depth: Annotated[float, Gt(0), Unit("m")]
    ramp: Annotated[float, Ge(0), Unit("periods")] = 2.0
    form: ClassVar[str]  # in case files

    def __post_init__(self) -> None:
        require(self, subject=type(self).__name__)
        steepest = 0.142 * self.length * math.tanh(self.number * self.depth)  # Miche
        if self.height > steepest:
            text = f"is {self.height:g} m; waves of that period and depth break above {steepest:.3g} m"
            raise Invalid("height", text, type(self).__name__)

    @cached_property
    def number(self) -> float:
        """Wave number k of omega^2 = g k tanh(k d) [1/m]."""
        return wave_number(self.period, self.depth)

    @property
    def length(self) -> float:
        """Wavelength [m]."""
        return 2 * math.pi / self.number

    @abstractmethod
    def steady(self, time: float) -> float:
        """Displacement at a time [s] without the ramp [m]."""

    def __call__(self, time: float) -> float:
        """Displacement at a time [s] along the wall's normal, into the water [m]."""
        part = min(max(time / (self.ramp * self.period), 0.0), 1.0) if self.ramp else 1.0
        return part * part * (3 - 2 * part) * self.steady(time)


@dataclass(frozen=True, kw_only=True)
class WavePiston(WaveMaker):
    """Displacement of a wall that makes waves: ``tank.wall("left", slip=True, motion=WavePiston(...))``.

    In first order the stroke is S = H / m, m = 2 sinh(kd)^2 / (sinh(kd) cosh(kd) + kd) (T. H. Havelock, Phil. Mag. 8,
    1929). The second order takes away the free wave of twice the frequency that a sine of the piston would make (O. S.
    Madsen, J. Geophys. Res. 76, 1971). The tank needs a vent, or a free surface, since the piston changes its volume.

    Attributes:
        height: of the waves, from trough to crest [m].
        period: of the waves [s].
        depth: of the water at rest [m].
        ramp: periods in which the motion rises smoothly from rest.
        order: of the theory, 1 or 2.

    Raises:
        ValueError: a value is out of its range, or a wave of that height would break.
    """

    order: Annotated[int, Ge(1), Le(2)] = 2
    form: ClassVar[str] = "waves"

    @property
    def stroke(self) -> float:
        """First-order stroke of the piston [m]."""
        return self.height / piston_transfer(self.number * self.depth)

    def steady(self, time: float) -> float:
        """See `WaveMaker.steady`."""
        kd, phase = self.number * self.depth, 2 * math.pi * time / self.period
        result = 0.5 * self.stroke * math.sin(phase)
        if self.order == 2 and kd < 100:
            second = 3 * math.cosh(kd) / math.sinh(kd) ** 3 - 2 / piston_transfer(kd)
            result += self.height**2 / (32 * self.depth) * second * math.sin(2 * phase)
        return result


@dataclass(frozen=True, kw_only=True)
class IrregularWaves(WaveMaker):
    """Displacement of a wall that makes waves of a spectrum, in first order.

    The spectrum is that of K. Hasselmann et al. (JONSWAP, Dtsch. Hydrogr. Z. A8-12, 1973), or that of W. J. Pierson and
    L. Moskowitz (J. Geophys. Res. 69, 1964), which has no peak enhancement, scaled to the height. It is a sum of sines,
    one in each of equal bands of frequency, at a random place in the band and with a random phase, so that no record
    repeats itself. Long waves that go with groups of short ones are not made, since that takes the second order.

    Attributes:
        height: significant one, four times the standard deviation of the surface [m].
        period: of the peak of the spectrum [s].
        depth: of the water at rest [m].
        ramp: periods in which the motion rises smoothly from rest.
        spectrum: "jonswap" or "pierson-moskowitz".
        peak: enhancement of the peak of "jonswap".
        components: number of sines.
        seed: of the random numbers: the same seed makes the same waves.

    Raises:
        ValueError: a value is out of its range, or waves of that height would break.
    """

    spectrum: Literal["jonswap", "pierson-moskowitz"] = "jonswap"
    peak: Annotated[float, Ge(1), Le(10), Unit("")] = 3.3
    components: Annotated[int, Ge(8), Le(4096)] = 100
    seed: Annotated[int, Ge(0)] = 1
    form: ClassVar[str] = "irregular_waves"

    def density(self, frequency: Array) -> Array:
        """Spectral density (K,) at frequencies (K,) over that of the peak, but for a factor."""
        width = np.where(frequency <= 1, 0.07, 0.09)
        enhancement = self.peak if self.spectrum == "jonswap" else 1.0
        power = np.exp(-((frequency - 1) ** 2) / (2 * width**2))
        return np.asarray(frequency**-5 * np.exp(-1.25 * frequency**-4) * enhancement**power)

    @cached_property
    def waves(self) -> tuple[Array, Array, Array]:
        """Amplitudes [m], angular frequencies [1/s] and phases [rad] (K,) of the waves."""
        random = np.random.default_rng(self.seed)
        low, high = FREQUENCIES
        place, phase = random.random((2, self.components))
        frequency = low + (high - low) * (np.arange(self.components) + place) / self.components
        energy = self.density(frequency)
        amplitude = np.sqrt(2 * energy / energy.sum()) * self.height / 4
        return amplitude, 2 * np.pi * frequency / self.period, 2 * np.pi * phase

    @cached_property
    def _strokes(self) -> Array:
        """Amplitudes (K,) of the piston [m]."""
        amplitude, omega, _ = self.waves
        numbers = [wave_number(2 * math.pi / value, self.depth) for value in omega.tolist()]
        return np.asarray(amplitude / [piston_transfer(k * self.depth) for k in numbers])

    def steady(self, time: float) -> float:
        """See `WaveMaker.steady`."""
        _, omega, phase = self.waves
        return float(self._strokes @ np.sin(omega * time + phase))


WAVE_MAKERS: dict[str, type[WavePiston] | type[IrregularWaves]] = {
    kind.form: kind for kind in (WavePiston, IrregularWaves)
}
