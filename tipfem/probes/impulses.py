"""Impulses and filtered values: what of the pressures and forces of an impact can be compared.

In an incompressible fluid an impact is an impulse. Where water closes on a wall at a finite angle, the pressure of
a solution of finite steps grows as the steps get shorter, but its integral over time does not (Cooker & Peregrine,
J. Fluid Mech. 297, 1995). So probes of walls can measure that integral, and a mean that has a length of time of its
own.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from annotated_types import Gt

from tipfem.case.case import Case
from tipfem.case.declaration import Unit
from tipfem.probes.probe import Probe
from tipfem.typing import Array

if TYPE_CHECKING:
    from tipfem.fem.time_integration import TimeScheme  # which starts Taichi


@dataclass(frozen=True, kw_only=True)
class LoadProbe(Probe):
    """Base class of probes of pressures and forces on walls.

    Attributes:
        impulse: whether there are further columns with the integrals over time since the start of the run,
            ``NAME_impulse``.
        time_constant: of a low-pass filter, whose values are further columns, ``NAME_filtered`` [s]; see `TimeMeans`.

    With either, every step is measured, and an `interval` only says which steps are written.

    Raises:
        ValueError: see `Probe`; the time constant is no length of time.
    """

    impulse: bool = False
    time_constant: Annotated[float, Gt(0), Unit("s")] | None = None

    def loads(self, case: Case) -> list[tuple[str, str]]:
        """Names and units of what is measured; raises ValueError if the probe does not fit the case."""
        raise NotImplementedError

    def columns(self, case: Case) -> list[tuple[str, str]]:
        """Names and units of all values; raises ValueError if the probe does not fit the case."""
        loads = self.loads(case)
        result = list(loads)
        if self.impulse:
            result += [(f"{name}_impulse", IMPULSE[unit]) for name, unit in loads]
        if self.time_constant is not None:
            result += [(f"{name}_filtered", unit) for name, unit in loads]
        return result

    @property
    def averages(self) -> bool:
        """Whether the probe is to be sampled in every step, for its columns depend on all of them."""
        return self.impulse or self.time_constant is not None

    def averaged(self, means: TimeMeans) -> list[float]:
        """The values of the further columns."""
        impulses = means.impulse.tolist() if self.impulse else []
        return impulses + (means.filtered.tolist() if self.time_constant is not None else [])


IMPULSE = {"Pa": "Pa s", "N/m": "N s/m", "N": "N s", "N m": "N m s"}  # units of loads integrated over time


class TimeMeans:
    """Integrals over time and filtered values of K loads that are known at steps of different lengths.

    A step of generalized-alpha changes velocities by v_{n+1} - v_n = dt ((1 - gamma) a_n + gamma a_{n+1}), where the
    load r of the step gives (1 - alpha_m) a_{n+1} + alpha_m a_n = r. The mean load of the step is what the same
    recursion gives for r, so that integrals of loads are changes of momentum, whatever the lengths of the steps. With
    the default rho_inf = 0 an impulse I within a step is a load of 2 I / dt at its end and of -I / dt in the next; the
    velocity has changed by 1.5 I and then by I. The sum of r dt is I, too, but only while steps do not change. Steps in
    which the velocities of the flow jump are taken with backward Euler's method, whose load is I / dt, and whose mean
    load is the load.

    The filter is the first-order low-pass y' = (r - y) / tau, solved exactly for means that are constant in each step,
    and taken at the middle of the step, where displacements, unlike velocities, do not overshoot. It begins with the
    first load. It lags by tau and half a step, and takes 3 dB of the amplitude at 1 / (2 pi tau) [Hz]; an impulse I in
    a time much shorter than tau is a peak of I / tau.

    Args:
        time_constant: tau [s]; None for no filter.
        count: K.

    Attributes:
        time: of the last load [s].
        rate: (K,) the recursion's a.
        impulse: (K,) integrals since t = 0.
        filtered: (K,) y at the middle of the last step.
    """

    def __init__(self, time_constant: float | None, count: int) -> None:
        self._time_constant = time_constant
        self.time = 0.0
        self.rate, self._y = np.full(count, math.nan), np.zeros(count)
        self.impulse, self.filtered = np.zeros(count), np.zeros(count)

    def add(self, time: float, loads: Sequence[float], scheme: TimeScheme) -> None:
        """Take in the loads (K,) of the step that ends at a time [s], and was taken with a time integration."""
        dt, self.time = time - self.time, time
        load = np.asarray(loads, dtype=float)
        if np.isnan(self.rate).all():
            self.rate = self._y = load
        rate, mean = scheme.next_rate(load, self.rate), scheme.mean_load(load, self.rate)
        self.rate = rate
        self.impulse = self.impulse + dt * mean
        if self._time_constant is not None:
            part = -math.expm1(-dt / self._time_constant)
            self._y = self._y + part * (mean - self._y)
            self.filtered = self._y - (scheme.gamma - scheme.beta) * part * (rate - self._y)

    def content(self) -> dict[str, Any]:
        """All that later values depend on, for a checkpoint."""
        return {"time": self.time, "rate": self.rate, "impulse": self.impulse, "y": self._y}

    def go_on(self, content: Mapping[str, Array]) -> None:
        """Take over the values of a checkpoint, see `content`."""
        self.time = float(content["time"])
        self.rate, self.impulse, self._y = (np.asarray(content[name]) for name in ("rate", "impulse", "y"))


def means_of(probe: Probe, case: Case) -> TimeMeans | None:
    """The means that a probe needs from step to step; None if it needs none."""
    if isinstance(probe, LoadProbe) and probe.averages:
        return TimeMeans(probe.time_constant, len(probe.loads(case)))
    return None
