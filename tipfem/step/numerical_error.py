"""Numerical errors of a run, relative to the flow's own values: figures that a user can read."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from tipfem.case.fluid import Fluid
from tipfem.step.budget import AXES
from tipfem.typing import Array

LARGE = 0.01  # from here on a part is a warning
EARLY, PARTS = 0.25, 50  # the early part of a run, and how many parts are searched for the largest loss of energy
TELLING = 1e-3  # part of the flow's energy, from which on it is told when it was lost
ROUGH = "roughness_"
SUCTION = 0.05  # of the highest pressure at a free surface: pressures below that of the empty space that are told
AT_REST = 1e-10  # of the potential energy, or that of surfaces: energies below it are round-off of fluids at rest


def numerical_error(
    history: Sequence[Mapping[str, float]], fluids: Sequence[Fluid], start_volume: Array
) -> dict[str, float]:
    """Numerical losses in all steps of a history; negative for gains.

    Args:
        history: rows with the columns of `Budget.account`.
        start_volume: (F,) of the fluids at the start [m^2, or m^3 in 3-D]; or (K, F) for the K rows, where drops were
            added on the way.

    Returns:
        Relative to the flow's own: ``energy``, numerical dissipation less the residual of Newton's method, over the
        largest of the largest kinetic energy and the ranges of the potential energy and that of surfaces; ``momentum``,
        what remeshing and the residual took, over sqrt(2 m E) with the largest mass m of the fluids and the largest
        kinetic energy E;
        ``volume_<fluid>``, part of each fluid's largest volume, where it is largest in the run.
        To ``energy`` also: numerator ``energy_lost`` and denominator ``energy_of_flow`` [J, in 2-D per metre of depth];
        ``early_time``, a quarter of the last time, and ``early_loss`` until then, a part of ``energy_lost``; and
        ``time_of_loss``, the middle of the fiftieth of the run with the largest loss [s]; of through-flow
        also ``energy_of_through_flow``, what it has brought in, by its pressure and with what has passed [J].
        At free surfaces: ``suction``, by how much the lowest pressure was below that of the empty space, the largest
        median of the fiftieths of the run [Pa], and ``time_of_suction`` [s], if that is more than 5 % of the
        highest one. With the sharp interface: ``roughness_<fluid>`` and ``interface_turning`` [degrees] of the last
        step, see `tipfem.step.roughness.roughness`. Empty without steps; 0 where the flow has nothing of its own but
        round-off.
    """
    if not history:
        return {}

    def column(name: str) -> Array:
        return np.array([row[name] for row in history])

    def relative(part: float, whole: float) -> float:
        return part / whole if whole > 0 else 0.0

    kinetic = float(column("kinetic_energy").max())
    stored = [column(name) for name in ("potential_energy", "surface_energy") if name in history[0]]
    own = max(kinetic, *(float(np.ptp(each)) for each in stored))
    least = AT_REST * max(abs(each).max() for each in stored)
    losses, times = column("numerical_dissipation") - column("energy_residual"), column("time")
    energy, end = float(losses.sum()), float(times[-1])
    axes = [axis for axis in AXES if f"momentum_{axis}" in history[0]]
    momentum = math.hypot(
        *(float((column(f"remeshing_momentum_{a}") + column(f"momentum_residual_{a}")).sum()) for a in axes)
    )
    volumes = np.broadcast_to(start_volume, (len(history), len(fluids)))
    mass = float((volumes @ np.array([f.density for f in fluids])).max())
    result = {
        "energy": relative(energy, own) if own > least else 0.0,
        "momentum": relative(momentum, math.sqrt(2 * mass * kinetic)) if kinetic > least else 0.0,
    }
    for f, volume in zip(fluids, volumes.T, strict=True):
        taken = volume - column(f"volume_{f.name}")
        result[f"volume_{f.name}"] = relative(float(taken[np.argmax(np.abs(taken))]), float(volume.max()))
    parts = np.histogram(times, PARTS, (0.0, end), weights=losses)[0]
    result |= {
        "energy_lost": energy,
        "energy_of_flow": own,
        "early_time": EARLY * end,
        "early_loss": float(losses[times <= EARLY * end].sum()) / energy if energy else 0.0,
        "time_of_loss": (int(np.argmax(parts * np.sign(energy))) + 0.5) * end / PARTS,
    }
    if "opening_energy" in history[0]:
        result["energy_of_through_flow"] = float((column("opening_work") + column("opening_energy")).sum())
    if "lowest_pressure" in history[0]:
        part = np.minimum((PARTS * times / end).astype(int), PARTS - 1)
        each = np.unique(part)
        low, high = (
            np.array([np.median(column(f"{name}_pressure")[part == k]) for k in each]) for name in ("lowest", "highest")
        )
        k = int(np.argmin(low))
        if low[k] < -SUCTION * high[k]:
            result |= {"suction": -float(low[k]), "time_of_suction": (float(each[k]) + 0.5) * end / PARTS}
    rough = [name for name in history[-1] if name.startswith("roughness_") or name == "interface_turning"]
    return result | {name: history[-1][name] for name in rough}


def summary_line(errors: Mapping[str, float]) -> str:
    """The figures of `numerical_error` in one line, with a warning that names those above 1 %.

    The energy that through-flow has brought in counts as the flow's own.
    """
    parts = {name: e for name, e in errors.items() if name in ("energy", "momentum") or name.startswith("volume_")}
    texts = [_energy(errors)]
    for name, value in parts.items():
        if name != "energy":
            verb = "changed" if name == "momentum" else "took" if value >= 0 else "gave"
            texts.append(f"{verb} {abs(value):.2g} of the {name.replace('volume_', 'volume of ')}")
    rough = [f"{e:.2g} in {name[len(ROUGH) :]}" for name, e in errors.items() if name.startswith(ROUGH)]
    line = f"numerics {', '.join(texts)}" + (
        f"; roughness of velocities at the end {', '.join(rough)}" if rough else ""
    )
    if "suction" in errors:
        line += f"; the lowest pressure was {errors['suction']:.2g} Pa below that of the empty space at "
        line += f"t = {errors['time_of_suction']:.3g} s, where no cavity opens"
    brought = max(errors.get("energy_of_through_flow", 0.0), 0.0)
    if brought > 0 and errors["energy_of_flow"] > 0:
        parts["energy"] /= 1 + brought / errors["energy_of_flow"]
    large = [name.replace("volume_", "volume of ") for name, value in parts.items() if not abs(value) <= LARGE]
    return (
        f"warning: {line}; above 1 %: {', '.join(large)} (the documentation's page on warnings says what helps)"
        if large
        else line
    )


def _energy(errors: Mapping[str, float]) -> str:
    """Sentence on the energy lost: its amount, the flow's energy, and the time."""
    lost, own = errors["energy_lost"], errors["energy_of_flow"]
    verb, of = ("lost", "of") if lost >= 0 else ("added", "to")
    brought = errors.get("energy_of_through_flow", 0.0)
    whole = f"the flow's {own:.3g} J" + (f" and the {brought:.3g} J that through-flow brought" if brought > 0 else "")
    text = f"{verb} {abs(lost):.3g} J {of} {whole}"
    if brought < 0:
        text += f", of which through-flow took {-brought:.3g} J"
    if not abs(errors["energy"]) > TELLING:
        return text
    early, time, worst = (errors[name] for name in ("early_loss", "early_time", "time_of_loss"))
    return f"{text} ({early:.0%} of it before t = {time:.3g} s, most at t = {worst:.3g} s)"
