"""Passed: what has passed the openings of a case, carried from step to step."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from tipfem.physics.carried import Carried
from tipfem.typing import Array


@dataclass(frozen=True)
class Passed(Carried):
    """What has passed the K openings, of F fluids; more than 0 for what entered.

    Attributes:
        volume: (K, F) in the last step [m^2].
        total: (K, F) since the start [m^2].
        energy_in: kinetic and potential, of what passed in the last step [J, per metre of depth].
        momentum_in: (2,) of it [N s].
        discharge: (K,) that inlets were told to have [m^2/s], NaN for those of the case.
        valve: (K,) 1 for openings that were told to be open, 0 to be closed, -1 to be as the case says.
        closed: (K,) mask of those that were closed in the last step.
        rate: (K,) what entered by each in the last step, over its length [m^2/s].
    """

    volume: Array
    total: Array
    energy_in: float
    momentum_in: Array
    discharge: Array
    valve: Array
    closed: Array
    rate: Array

    @classmethod
    def nothing(cls, openings: int, fluids: int) -> Passed:
        """That at the start."""
        none, passed = np.full(openings, -1, dtype=np.int8), np.zeros((openings, fluids))
        still = np.zeros(openings)
        return cls(passed, passed, 0.0, np.zeros(2), np.full(openings, np.nan), none, none == 0, still)

    def and_then(self, volume: Array, energy: float, momentum: Array, dt: float) -> Passed:
        """The same after a step of length ``dt`` [s] in which ``volume`` (K, F) has passed."""
        changes = {"energy_in": energy, "momentum_in": momentum, "rate": volume.sum(axis=1) / dt}
        return dataclasses.replace(self, volume=volume, total=self.total + volume, **changes)
