"""Passed: what has passed the openings of a case, carried from step to step."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from tipfem.case.case import Case
from tipfem.physics.carried import Carried
from tipfem.typing import Array

LAG = 3.0  # time over which the discharge of a pump is a mean [longest steps]


@dataclass(frozen=True)
class Passed(Carried):
    """Fluids that have passed the K openings, of F fluids; more than 0 for what entered."""

    volume: Array  # (K, F) in the last step [m^2]
    total: Array  # (K, F) since the start [m^2]
    energy_in: float  # kinetic and potential, of what passed in the last step [J, per metre of depth]
    momentum_in: Array  # (2,) of it [N s]
    discharge: Array  # (K,) that inlets were told to have [m^2/s], NaN for those of the case
    valve: Array  # (K,) 1 for openings that were told to be open, 0 to be closed, -1 to be as the case says
    closed: Array  # (K,) mask of those that were closed in the last step
    rate: Array  # (K,) what enters by each, a mean over `LAG` of the longest steps: that of short ones is noisy [m^2/s]
    longest: float  # step so far [s]
    wet: Array  # (K, 2) whether the wall beyond its ends was wet
    pressure: Array  # (K,) at each, a mean like the rate [Pa]; NaN at the start, and where no pump has a head

    @classmethod
    def nothing(cls, openings: int, fluids: int) -> Passed:
        """Start value, with nothing passed."""
        none, passed = np.full(openings, -1, dtype=np.int8), np.zeros((openings, fluids))
        still = np.zeros(openings)
        told = np.full(openings, np.nan), none
        wet = np.zeros((openings, 2), dtype=bool)
        return cls(passed, passed, 0.0, np.zeros(2), *told, none == 0, still, 0.0, wet, still + np.nan)

    def shut(self, case: Case, time: float) -> tuple[int, ...]:
        """See `Carried.shut`; by their valves or by commands."""
        openings, told = [line.opening for line in case.boundary.lines], dict(enumerate(self.valve.tolist()))
        return tuple(k for k, one in enumerate(openings) if not (told[k] if told[k] >= 0 else one.is_open(time)))

    def and_then(self, volume: Array, energy: float, momentum: Array, pressure: Array, dt: float) -> Passed:
        """The same after a step of length ``dt`` [s] in which ``volume`` (K, F) has passed, with ``pressure`` (K,)."""
        longest = max(self.longest, dt)
        part = dt / (LAG * longest)
        rate = self.rate + (volume.sum(axis=1) / dt - self.rate) * part
        pressure = np.where(np.isnan(self.pressure), pressure, self.pressure + (pressure - self.pressure) * part)
        changes = {"energy_in": energy, "momentum_in": momentum, "rate": rate, "longest": longest, "pressure": pressure}
        return dataclasses.replace(self, volume=volume, total=self.total + volume, **changes)
