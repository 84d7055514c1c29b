"""What numerics took from a run, or gave it, relative to the flow's own: figures that a user can read."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from tipfem.case.fluid import Fluid
from tipfem.step.budget import AXES
from tipfem.typing import Array

LARGE = 0.01  # from here on a figure is a warning
AT_REST = 1e-10  # of the potential energy: energies below it are round-off of fluids at rest


def numerical_error(
    history: Sequence[Mapping[str, float]], fluids: Sequence[Fluid], start_volume: Array
) -> dict[str, float]:
    """What numerics took from the flow in all steps of a history, relative to the flow's own; negative where they gave.

    Args:
        history: rows with the columns of `Budget.account`.
        fluids: of the case.
        start_volume: (F,) of the fluids at the start [m^2, or m^3 in 3-D]; or (K, F) for the K rows, where drops were
            added on the way.

    Returns:
        ``energy``: numerical dissipation less the residual of Newton's method, over the larger of the largest kinetic
        energy and the range of the potential energy; ``momentum``: what remeshing and the residual took, over
        sqrt(2 m E) with the mass m of the fluids and the largest kinetic energy E; ``volume_<fluid>``: part of each
        fluid's volume, where it is largest in the run. Empty without steps; 0 where the flow has nothing of its own but
        round-off.
    """
    if not history:
        return {}

    def column(name: str) -> Array:
        return np.array([row[name] for row in history])

    def relative(part: float, whole: float) -> float:
        return part / whole if whole > 0 else 0.0

    potential = column("potential_energy")
    kinetic, fallen, least = (
        float(column("kinetic_energy").max()),
        float(np.ptp(potential)),
        AT_REST * abs(potential).max(),
    )
    energy = float((column("numerical_dissipation") - column("energy_residual")).sum())
    axes = [axis for axis in AXES if f"momentum_{axis}" in history[0]]
    momentum = math.hypot(
        *(float((column(f"remeshing_momentum_{a}") + column(f"momentum_residual_{a}")).sum()) for a in axes)
    )
    volumes = np.broadcast_to(start_volume, (len(history), len(fluids)))
    mass = sum(f.density * float(volume) for f, volume in zip(fluids, volumes[-1], strict=True))
    result = {
        "energy": relative(energy, max(kinetic, fallen)) if max(kinetic, fallen) > least else 0.0,
        "momentum": relative(momentum, math.sqrt(2 * mass * kinetic)) if kinetic > least else 0.0,
    }
    for f, volume in zip(fluids, volumes.T, strict=True):
        taken = volume - column(f"volume_{f.name}")
        result[f"volume_{f.name}"] = relative(float(taken[np.argmax(np.abs(taken))]), float(volume[-1]))
    return result


def summary_line(errors: Mapping[str, float]) -> str:
    """The figures of `numerical_error` in one line, with a warning that names those above 1 %."""
    texts = {}
    for name, value in errors.items():
        label = name.replace("volume_", "volume of ")
        verb = "changed" if name == "momentum" else "took" if value >= 0 else "gave"
        texts[name] = f"{verb} {abs(value):.2g} of the {label}"
    large = [name.replace("volume_", "volume of ") for name, value in errors.items() if not abs(value) <= LARGE]
    line = f"numerics {', '.join(texts.values())}"
    return (
        f"warning: {line}; above 1 %: {', '.join(large)} (the documentation's page on warnings says what helps)"
        if large
        else line
    )
