"""Comparison of a computed history with measured data."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar

from tipfem.typing import Array

TRIES = 201  # shifts among which the best one is looked for before it is refined
LARGEST_SHIFT = 0.25  # of the time that the two have in common


@dataclass(frozen=True)
class Comparison:
    """Measured and computed values at the times of the measurement."""

    time: Array  # (K,) of the measured values, shifted [s]
    measured: Array  # (K,) values
    computed: Array  # (K,) values, interpolated linearly
    shift: float = 0.0  # added to the times of the measurement [s]

    @property
    def difference(self) -> Array:
        """(K,) computed less measured."""
        return self.computed - self.measured

    @property
    def rms(self) -> float:
        """Root mean square of the difference."""
        return float(np.sqrt(np.mean(self.difference**2)))

    @property
    def correlation(self) -> float:
        """Pearson's coefficient; NaN where one of the two is constant."""
        spread = [float(np.std(values)) for values in (self.measured, self.computed)]
        return float(np.corrcoef(self.measured, self.computed)[0, 1]) if min(spread) > 0 else float("nan")


def compared(time: Array, computed: Array, at: Array, measured: Array, *, fit_shift: bool = False) -> Comparison:
    """Compare a history (N,) with values (K,) measured at times (K,) [s], where their times overlap.

    With ``fit_shift`` the measurement is shifted in time by what makes the root mean square least; at most by a quarter
    of the time that the two have in common. `ValueError` if fewer than two measured values are within the computed
    times.
    """

    def shifted(shift: float) -> Comparison:
        moved = at + shift
        inside = (moved >= time[0]) & (moved <= time[-1])
        return Comparison(moved[inside], measured[inside], np.interp(moved[inside], time, computed), shift)

    plain = shifted(0.0)
    if len(plain.time) < 2:
        text = f"the data is from {at.min():g} s to {at.max():g} s, the run from {time[0]:g} s to {time[-1]:g} s"
        raise ValueError(f"{text}: fewer than two values have a time in common")
    if not fit_shift:
        return plain

    def error(shift: float) -> float:
        """Root mean square, where at least half of the values are left."""
        found = shifted(shift)
        return found.rms if 2 * len(found.time) >= len(plain.time) else np.inf

    largest = LARGEST_SHIFT * float(np.ptp(plain.time))
    tries = np.linspace(-largest, largest, TRIES)
    best = float(tries[np.argmin([error(shift) for shift in tries])])
    step = 2 * largest / (TRIES - 1)
    refined = minimize_scalar(
        error, bounds=(best - step, best + step), method="bounded", options={"xatol": 1e-4 * step}
    )
    return shifted(min((best, float(refined.x), 0.0), key=error))
