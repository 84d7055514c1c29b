"""Measured dam breaks, and how far a run is from them.

The data lie in ``data/`` beside this file, one CSV a series; the head of each says where its numbers come
from. All series here are for a column twice as high as wide (n^2 = 2), with the scaling of Martin & Moyce:
with the column's width a [m], the gravity g [m/s^2] and the time since the release t [s],

    T = t sqrt(2 g / a)     tau = t sqrt(g / a) = T / sqrt(2)
    Z = x / a               x [m]: the front, measured from the back wall
    H = eta / (2 a)         eta [m]: the height of the water at the back wall

THE SHIFT. The clock of the experiment does not start with the water: its films were lined up at Z = 1.44, and
the wall that held the water takes time to leave. A comparison may therefore use one constant ``shift`` in T,
which is ADDED to the times of the experiment: its reading at T is compared with the run at T + shift. A run
that leads the experiment has a negative shift. Nothing else is fitted.

Sources: J. C. Martin and W. J. Moyce, Phil. Trans. R. Soc. A 244 (1952) 312-324, tables 2 and 6;
S. Koshizuka and Y. Oka, Nucl. Sci. Eng. 123 (1996) 421-434.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from tipfem.demos.support import figures

DATA = Path(__file__).parent / "data"
MARTIN_MOYCE, KOSHIZUKA = "Martin & Moyce 1952", "Koshizuka & Oka 1996"
GRAVITY = 9.81  # m/s^2
SHIFT_STEP = 1e-4  # in T; the tables are printed to 0.01
FRONT_END = 3.0  # in T; a tank four widths long is reached soon after (Z = 4 at T = 3.2)
SLOPE_START = 1.43  # in T; from here on the front moves at a nearly constant speed
HEIGHT_END = 3.0  # in tau; after it H < 0.3 is known to two decimals only and waves return from the far wall

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Experiment:
    """One series of reference points, dimensionless: ``values`` (K,) at ``time`` (K,), increasing.

    ``columns`` are the names of both in the CSV; ``source`` is the text at its head.
    """

    label: str
    time: Array
    values: Array
    columns: tuple[str, str]
    source: str


@dataclass(frozen=True)
class FrontComparison:
    """A run's front against table 2 of Martin & Moyce, dimensionless.

    shift: added to the experiment's T for the best agreement; negative when the run leads.
    rms: root mean square of (Z_run - Z) / Z over ``points`` readings, at that shift.
    rms_unshifted: the same with no shift, over the readings the run covers then.
    slope, slope_experiment: dZ/dT by least squares over the readings with 1.43 <= T <= 3.0 (T on the clock of
        the experiment) that the run covers, run and experiment; nan when there are fewer than two.
    shift_at_limit: the best shift is the largest allowed, so a better one may lie outside.
    """

    shift: float
    rms: float
    rms_unshifted: float
    slope: float
    slope_experiment: float
    points: int
    shift_at_limit: bool

    @property
    def slope_error(self) -> float:
        """Relative error of the front's speed: slope / slope_experiment - 1."""
        return self.slope / self.slope_experiment - 1.0


@dataclass(frozen=True)
class HeightComparison:
    """A run's height at the back wall against table 6 of Martin & Moyce, dimensionless.

    shift: the one asked for, in T (in tau it is shift / sqrt(2)).
    rms, largest: root mean square and largest size of (H_run - H) / H over ``points`` readings.
    rms_unshifted, largest_unshifted: the same with no shift, over the readings the run covers then.
    """

    shift: float
    rms: float
    largest: float
    rms_unshifted: float
    largest_unshifted: float
    points: int


def _load(file: str, label: str, *columns: str) -> Experiment:
    """Two named columns of a CSV whose first lines start with ``#``. Raises KeyError for an absent column."""
    lines = (DATA / f"{file}.csv").read_text(encoding="utf-8").splitlines()
    source = "\n".join(line.lstrip("# ") for line in lines if line.startswith("#"))
    table = csv.DictReader(line for line in lines if line and not line.startswith("#"))
    time_name, values_name = columns
    time, values = np.array([(float(row[time_name]), float(row[values_name])) for row in table]).T
    return Experiment(label, time, values, (time_name, values_name), source)


def martin_moyce_front() -> Experiment:
    """Front Z against T, a = 2.25 in: Martin & Moyce 1952, table 2."""
    return _load("mm1952_front_n2_2_a2.25in_table2", MARTIN_MOYCE, "T_tsqrt2g_over_a", "Z_x_over_a")


def martin_moyce_height() -> Experiment:
    """Height H at the back wall against tau (not T), a = 2.25 in: Martin & Moyce 1952, table 6."""
    return _load("mm1952_height_n2_2_a2.25in_table6", MARTIN_MOYCE, "tau_tsqrtg_over_a", "H_eta_over_2a")


def koshizuka_oka_front() -> Experiment:
    """Front Z against T, a = 0.146 m: the experiment of Koshizuka & Oka 1996."""
    return _load("koshizuka_oka1996_front_exp", KOSHIZUKA + ", experiment", "T_tsqrt2g_over_L", "X_x_over_L")


def koshizuka_oka_mps_front() -> Experiment:
    """Front Z against T: the particle simulation (MPS) of Koshizuka & Oka 1996. Not a measurement."""
    return _load("koshizuka_oka1996_front_mps", KOSHIZUKA + ", MPS", "T_tsqrt2g_over_L", "X_x_over_L")


def _checked(time: ArrayLike, values: ArrayLike, name: str, **scales: float) -> tuple[Array, Array]:
    """The series as two float arrays (K,), K >= 2.

    Raises ValueError unless times increase, values and scales are positive, and all is finite.
    """
    for scale, value in scales.items():
        if not (math.isfinite(value) and value > 0.0):
            raise ValueError(f"{scale} must be positive, got {value}")
    t, v = np.asarray(time, dtype=np.float64), np.asarray(values, dtype=np.float64)
    if t.ndim != 1 or t.shape != v.shape or t.size < 2:
        raise ValueError(f"time and {name} must be arrays of one length >= 2, not of {t.shape} and {v.shape}")
    if not (np.isfinite(t).all() and (np.diff(t) > 0.0).all()):
        raise ValueError("time must be finite and increase from each sample to the next")
    if not (np.isfinite(v).all() and (v > 0.0).all()):
        raise ValueError(f"{name} must be finite and positive")
    return t, v


def _covered(axis: Array, points: Array, earliest: float, latest: float) -> NDArray[np.bool_]:
    """Which ``points`` (P,) lie within the run's ``axis`` (K,) under every shift from earliest to latest."""
    slack = 1e-9  # a reading on the run's first or last sample counts, whatever the rounding
    return np.asarray((points + earliest >= axis[0] - slack) & (points + latest <= axis[-1] + slack))


def _deviation(axis: Array, values: Array, points: Array, expected: Array, shift: ArrayLike) -> Array:
    """Relative deviation run / experiment - 1 at ``points`` (P,): (P,), or (S, P) for a shift (S, 1)."""
    return np.asarray(np.interp(points + np.asarray(shift), axis, values) / expected - 1.0)


def _rms(deviation: Array) -> float:
    """Root mean square; nan of nothing."""
    return float(np.sqrt(np.mean(deviation**2))) if deviation.size else math.nan


def compare_front(
    time: ArrayLike, front: ArrayLike, width: float, gravity: float = GRAVITY, *, shift_limit: float = 0.3
) -> FrontComparison:
    """Compare the front of a collapsing column, twice as high as wide, with table 2 of Martin & Moyce.

    time: (K,), s since the release, increasing.  front: (K,), m from the back wall.
    width: of the column at rest, m.  gravity: m/s^2.
    shift_limit: in T; the shift is the one within +- shift_limit of the smallest rms; 0 allows none. A much
        larger limit would let the shift hide a wrong speed.

    The shift is searched over the readings with T <= 3.0 that the run covers under every shift allowed, so
    that none can win by pushing a bad reading out of the run. The rms and the slopes are then taken over all
    readings covered at that shift. The module's text gives the scaling and the sign of the shift.

    Raises ValueError on wrong input, or when the search has fewer than three readings: a run from the release
    must go on to T = 1.19 + shift_limit.
    """
    t, x = _checked(time, front, "front", width=width, gravity=gravity)
    if not (math.isfinite(shift_limit) and shift_limit >= 0.0):
        raise ValueError(f"shift_limit must not be negative, got {shift_limit}")
    axis, z = t * math.sqrt(2.0 * gravity / width), x / width
    experiment = martin_moyce_front()
    used = experiment.time <= FRONT_END
    points, expected = experiment.time[used], experiment.values[used]

    always = _covered(axis, points, -shift_limit, shift_limit)
    if always.sum() < 3:
        raise ValueError(f"a run from T = {axis[0]:.2f} to {axis[-1]:.2f} covers fewer than three readings")
    steps = round(shift_limit / SHIFT_STEP)
    shifts = np.linspace(-shift_limit, shift_limit, 2 * steps + 1)  # (S,), with zero in the middle
    tried = _deviation(axis, z, points[always], expected[always], shifts[:, None])  # (S, P)
    best = int(np.argmin(np.mean(tried**2, axis=1)))
    shift = round(float(shifts[best]), 9)

    seen, seen_unshifted = _covered(axis, points, shift, shift), _covered(axis, points, 0.0, 0.0)
    steady = seen & (points >= SLOPE_START)
    slope = slope_experiment = math.nan
    if steady.sum() >= 2:
        slope = float(np.polyfit(points[steady], np.interp(points[steady] + shift, axis, z), 1)[0])
        slope_experiment = float(np.polyfit(points[steady], expected[steady], 1)[0])
    return FrontComparison(
        shift=shift,
        rms=_rms(_deviation(axis, z, points[seen], expected[seen], shift)),
        rms_unshifted=_rms(_deviation(axis, z, points[seen_unshifted], expected[seen_unshifted], 0.0)),
        slope=slope,
        slope_experiment=slope_experiment,
        points=int(seen.sum()),
        shift_at_limit=steps > 0 and best in (0, 2 * steps),
    )


def compare_height(
    time: ArrayLike,
    height: ArrayLike,
    initial_height: float,
    width: float,
    gravity: float = GRAVITY,
    *,
    shift: float = 0.0,
) -> HeightComparison:
    """Compare the height of the water at the back wall with table 6 of Martin & Moyce, up to tau = 3.0.

    time: (K,), s since the release, increasing.  height: (K,), m.  width, initial_height: of the column, m.
    shift: in T, as ``compare_front`` finds it; a reading at tau is compared at tau + shift / sqrt(2).

    Both the shifted and the unshifted deviation are given, for no reading of table 6 fixes its release: the
    first is H = 0.94 at tau = 0.56, when the top already sinks by 0.24 a unit of tau, so that a shift of 0.3
    in T moves H by 0.05. The flat part before it is not compared, and neither is a reading that the shift
    takes to before the run's first sample.

    Raises ValueError on wrong input, on a column that is not twice as high as wide (within 1 %), and when the
    run covers no reading.
    """
    t, eta = _checked(time, height, "height", width=width, gravity=gravity, initial_height=initial_height)
    if not math.isfinite(shift):
        raise ValueError(f"shift must be finite, got {shift}")
    if abs(initial_height / width - 2.0) > 0.02:
        raise ValueError(f"the column must be twice as high as wide, got {initial_height} m over {width} m")
    axis, h = t * math.sqrt(gravity / width), eta / initial_height
    experiment = martin_moyce_height()
    used = experiment.time <= HEIGHT_END
    points, expected = experiment.time[used], experiment.values[used]

    def measure(dtau: float) -> tuple[float, float, int]:
        seen = _covered(axis, points, dtau, dtau)
        size = np.abs(_deviation(axis, h, points[seen], expected[seen], dtau))
        return _rms(size), float(size.max()) if size.size else math.nan, int(size.size)

    rms, largest, count = measure(shift / math.sqrt(2.0))
    if count == 0:
        raise ValueError(f"a run from tau = {axis[0]:.2f} to {axis[-1]:.2f} covers no reading of the height")
    return HeightComparison(shift, rms, largest, *measure(0.0)[:2], count)


def plot_front(
    path: str | Path,
    runs: Mapping[str, tuple[ArrayLike, ArrayLike]],
    width: float,
    gravity: float = GRAVITY,
    *,
    shift: float = 0.0,
    title: str = "Dam break: the front of the water",
) -> Path:
    """Draw the front Z against T of one or more runs among the reference points.

    Args:
        path: of the picture; its ending is the format.
        runs: label -> (time (K,) [s], front (K,) [m]).
        width: of the column [m].
        gravity: [m/s^2].
        shift: in T, added to the times of Martin & Moyce alone and noted in the legend.
        title: above the figure.

    Returns:
        The picture's path.

    Raises:
        ImportError: there is no matplotlib.
        ValueError: the series are not as `compare_front` wants them, or there are none.
    """
    figure = figures.new_figure(8.0, 5.6)
    if not runs:
        raise ValueError("runs must hold at least one run")
    axes = figure.add_subplot()
    lines = [(figures.BLUE, "-"), (figures.VERMILION, "--"), (figures.PURPLE, "-."), ("#000000", ":")]
    last = FRONT_END
    for number, (label, (time, front)) in enumerate(runs.items()):
        t, x = _checked(time, front, "front", width=width, gravity=gravity)
        color, dash = lines[number % len(lines)]
        axis = t * math.sqrt(2.0 * gravity / width)
        axes.plot(axis, x / width, color=color, linestyle=dash, linewidth=2.2, label=label)
        last = max(last, axis[-1])
    note = f" (times moved by {shift:+.3f} in T)" if shift else ""
    style: dict[str, Any] = {"linestyle": "none", "markersize": 8, "mfc": "none", "mew": 1.8}
    first, second, third = martin_moyce_front(), koshizuka_oka_front(), koshizuka_oka_mps_front()
    axes.plot(first.time + shift, first.values, "o", color=figures.GREEN, label=first.label + note, **style)
    axes.plot(second.time, second.values, "s", color=figures.ORANGE, label=second.label, **style)
    axes.plot(third.time, third.values, "x", color=figures.SKY, label=third.label, **style)
    axes.set_title(title, fontsize=15)
    axes.set_xlabel(r"$T = t\,\sqrt{2g/a}$", fontsize=14)
    axes.set_ylabel(r"$Z = x/a$", fontsize=14)
    axes.set_xlim(0.0, min(last, 4.0) + 0.2)  # the references end at T = 3.4
    axes.tick_params(labelsize=12)
    axes.grid(alpha=0.3)
    axes.legend(fontsize=11, loc="lower right")
    return figures.save(figure, path)
