"""Passed: what has passed the openings of a case, carried from step to step."""

from __future__ import annotations

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
    """

    volume: Array
    total: Array
    energy_in: float
    momentum_in: Array

    @classmethod
    def nothing(cls, openings: int, fluids: int) -> Passed:
        """That at the start."""
        return cls(np.zeros((openings, fluids)), np.zeros((openings, fluids)), 0.0, np.zeros(2))

    def and_then(self, volume: Array, energy: float, momentum: Array) -> Passed:
        """The same after a step in which ``volume`` (K, F) has passed."""
        return Passed(volume, self.total + volume, energy, momentum)
