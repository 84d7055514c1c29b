"""Columns of the histories of runs, and what demos read off them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

import tipfem as tp

Array = NDArray[Any]


def column(simulation: tp.Simulation, name: str) -> Array:
    """A column of the history."""
    return np.array([row[name] for row in simulation.history])


def middle_of_water(simulation: tp.Simulation) -> float:
    """Place x of the centre of mass of the first fluid [m]."""
    mesh = simulation.mesh
    of = np.ones(len(mesh.cells), dtype=bool) if mesh.fluid is None else mesh.fluid == 0
    weight = mesh.measure[of]
    return float((mesh.position[mesh.cells[of], 0].mean(axis=1) * weight).sum() / weight.sum())


def zeros(time: Array, values: Array) -> tuple[Array, Array]:
    """Samples before the changes of sign of values (K,), and their times, linear between samples."""
    k = np.flatnonzero((values[1:] < 0) != (values[:-1] < 0))
    return k, time[k] - values[k] * (time[k + 1] - time[k]) / (values[k + 1] - values[k])
