"""Figures of a dam break against the experiments, and the limits that they have to keep."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from tipfem.demos import harness
from tipfem.demos.validation.dam_break import experiments
from tipfem.demos.validation.dam_break.case import COLUMN, GRAVITY, SPACING, column_height, front, spray

import tipfem as tp

Array = NDArray[np.float64]
History = Sequence[Mapping[str, float]]

SLOPE = 1.32  # dZ/dT of Martin & Moyce over their readings with 1.43 <= T <= 3.33
PER_SECOND = float(np.sqrt(2 * GRAVITY / COLUMN[0]))  # T in one second

# The largest figures that a run may show. The coarser the mesh, the wider the margin.
LARGEST_RMS = 0.04  # of dZ/Z against Martin & Moyce, up to 5 mm; above:
LARGEST_COARSE_RMS = 0.05
LARGEST_COARSE_SURFACE_RMS = 0.06  # with a free surface
LARGEST_SLOPE_ERROR = 0.10  # up to 5 mm
LARGEST_HEIGHT_ERROR = 0.05  # up to 5 mm
LARGEST_VOLUME_ERROR = 0.02  # up to 10 mm, and with a free surface; otherwise:
LARGEST_COARSE_VOLUME_ERROR = 0.05


def fronts_of(history: History) -> tuple[Array, Array]:
    """Times (K,) [s] and fronts (K,) [m] of a history."""
    return np.array([row["time"] for row in history]), np.array([row["front"] for row in history])


def front_slope(time: Array, front: Array) -> float:
    """Speed of the front, dZ/dT by least squares over all steps with 1.43 <= T <= 3.0, T on the run's clock.

    Args:
        time: (K,) [s].
        front: (K,) [m].

    Returns:
        The slope; NaN when the run does not reach T = 3.
    """
    scaled = time * PER_SECOND
    window = (scaled >= 1.43) & (scaled <= 3.0)
    if not window.any() or scaled[-1] < 3.0:
        return float("nan")
    return float(np.polyfit(scaled[window], front[window] / COLUMN[0], 1)[0])


def front_figures(history: History) -> dict[str, float]:
    """RMS of the front against Martin & Moyce and the time shift used; the front's slopes.

    A run too short to be compared, T < 1.5, has none; one that ends before T = 3 has no ``front_slope``.
    """
    time, position = fronts_of(history)
    if time[-1] * PER_SECOND <= 1.5:
        return {}
    reached = time <= 3.35 / PER_SECOND
    compared = experiments.compare_front(time[reached], position[reached], COLUMN[0], GRAVITY)
    figures = {
        "front_rms": compared.rms,
        "front_shift": compared.shift,
        "front_slope_shifted": compared.slope,
        "front_slope_experiment": compared.slope_experiment,
    }
    slope = front_slope(time, position)
    return figures | ({"front_slope": slope} if np.isfinite(slope) else {})


def figures_of(history: History) -> dict[str, float]:
    """Figures of a run against the experiments.

    Args:
        history: the simulation's history, one row per step, with the columns front and column_height.

    Returns:
        The largest relative change of the water's volume; the figures of the front, see `front_figures`; the RMS of
        the height. What the run is too short for is left out.
    """
    water = np.array([row["volume_water"] for row in history])
    figures = {"volume_error": float(np.abs(water / (COLUMN[0] * COLUMN[1]) - 1).max()), **front_figures(history)}
    if "front_rms" in figures:
        time, height = (np.array([row[name] for row in history]) for name in ("time", "column_height"))
        figures["height_rms"] = experiments.compare_height(time, height, COLUMN[1], COLUMN[0], GRAVITY).rms
    return figures


def surface_figures_of(history: History) -> dict[str, float]:
    """Further figures with a free surface, with the sign of a gain and relative to the column's volume.

    The change of the water's volume at the end; what of it flies as spray then; what the source in the continuity
    equation has added over the run.
    """
    column, last = COLUMN[0] * COLUMN[1], history[-1]
    return {
        "volume_change_at_end": last["volume_water"] / column - 1,
        "spray_at_end": last.get("spray", 0.0) / column,
        "volume_from_source": float(np.sum([row.get("source_volume_water", 0.0) for row in history])) / column,
    }


def missed(figures: Mapping[str, float], spacing: float, *, free_surface: bool = False) -> list[str]:
    """What a run misses of what is expected of it; empty when all is well.

    Args:
        figures: from `figures_of`.
        spacing: of the run [m].
        free_surface: whether the water ends at a free surface instead of in air.
    """
    fine = spacing <= 1.01 * SPACING
    coarse_rms = LARGEST_COARSE_SURFACE_RMS if free_surface else LARGEST_COARSE_RMS
    limits = {"front_rms": LARGEST_RMS if fine else coarse_rms, "volume_error": LARGEST_VOLUME_ERROR}
    if spacing > 2.02 * SPACING and not free_surface:
        limits["volume_error"] = LARGEST_COARSE_VOLUME_ERROR
    if fine:
        limits["height_rms"] = LARGEST_HEIGHT_ERROR
    found = harness.above(figures, limits)
    if fine and not abs(figures.get("front_slope", SLOPE) / SLOPE - 1) <= LARGEST_SLOPE_ERROR:
        found.append(f"front_slope is {figures['front_slope']:.3f}, more than 10 % off {SLOPE}")
    return found


def label(spacing: float, kind: str = "") -> str:
    """What figures call a run with particles at a distance of ``spacing`` [m]."""
    return f"tipfem, {spacing * 1e3:g} mm" + (f", {kind}" if kind else "")


@dataclass(frozen=True)
class DamBreak(harness.Check):
    """Front and height of the collapsing column against the experiments; its volume.

    Attributes:
        free_surface: whether the water ends at a free surface instead of in air.
    """

    free_surface: bool = False

    def columns(self) -> dict[str, harness.Probe]:
        """Front and height of the water, and with a free surface its spray."""
        both: dict[str, harness.Probe] = {"front": front, "column_height": column_height}
        return {**both, "spray": spray} if self.free_surface else both

    def figures(self, simulation: tp.Simulation) -> dict[str, float]:
        """See `figures_of` and `surface_figures_of`."""
        further = surface_figures_of(simulation.history) if self.free_surface else {}
        return figures_of(simulation.history) | further

    def missed(self, figures: Mapping[str, float], options: harness.Options) -> list[str]:
        """See the function `missed`."""
        return missed(figures, options.spacing, free_surface=self.free_surface)

    def plot(self, simulation: tp.Simulation, figures: Mapping[str, float], options: harness.Options) -> None:
        """front.png: the front among the experiments, of two steps at least."""
        if len(simulation.history) < 2:
            return
        graded = getattr(options, "air_spacing", None) is not None
        kind = "free surface" if self.free_surface else "graded" if graded else ""
        runs = {label(options.spacing, kind): fronts_of(simulation.history)}
        path = Path(options.out) / "front.png"
        experiments.plot_front(path, runs, COLUMN[0], GRAVITY, shift=figures.get("front_shift", 0.0))
