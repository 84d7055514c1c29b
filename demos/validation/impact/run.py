"""The pressure of a dam break on the far wall, and its noise, against the experiment of Buchner (2002).

A column of water of height H and width 2 H runs along a dry floor and hits the wall at 5.366 H, where the pressure is
measured at a height of 0.2 H, and in the corner. What can be compared of an impact is its impulse, and means over a
time that is stated; see docs/howto/probes.md.

    summary.json      figures of all runs, their means and spreads, and those of the experiment
    pressure.png      pressures over time
    corner.png        pressures and impulses in the corner: each step, and filtered
    <runs>/           history.csv, probes/*.csv and summary.json of each run

python -m tipfem demo validation/impact --across 20 30
python -m tipfem demo validation/impact --across 30 --starts 10 --end-time 5    # particles moved by 1 % at the start
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tipfem.demos import harness
from tipfem.demos.support.figures import COLOURS, new_figure, save
from tipfem.demos.support.options import Count, Counts, Positive

import tipfem as tp

Array = NDArray[np.float64]

HEIGHT = 0.6  # H of the experiment [m]
LENGTH, GAUGE = 5.366, 0.2  # of the tank, and height of the gauge [H]
CEILING = 3.0  # of the tank, which has air in it and no opening [H]
GRAVITY = 9.81  # [m/s^2]
CLOCK = math.sqrt(HEIGHT / GRAVITY)  # one unit of dimensionless time [s]
WATER = tp.Fluid("water", density=998.2, viscosity=1.002e-3)
AIR = tp.Fluid("air", density=1.204, viscosity=1.825e-5)

END = 6.0  # [sqrt(H / g)]
RISEN = 0.2  # pressure at which the water has arrived [rho g H]
PLATEAU = (3.2, 5.0)  # in which the pressure is smooth in the experiment [sqrt(H / g)]
SMOOTHING = 0.1  # length of the running mean that noise is measured from [sqrt(H / g)]
TIME_CONSTANT = 0.05  # of the probes' filter [sqrt(H / g)]
IMPACT = 1.0  # time that an impact's impulse is taken over [sqrt(H / g)]
JITTER = 0.01  # random displacements of particles at the start of all runs but the first [spacings]
# Limits of the check: of the time at which the water arrives, and of the mean pressure on the plateau, relative.
LATE, OFF = 0.1, 0.1


def build(across: int, air_spacing: float | None = None, start: int = 0) -> tp.Case:
    """The case.

    Args:
        across: particles over the height of the column.
        air_spacing: distance between particles in the air, far from the water [H]; by default that of all.
        start: 0 for particles on a lattice; k > 0 for those moved by random displacements, another each k.
    """
    size, spacing = (LENGTH * HEIGHT, CEILING * HEIGHT), HEIGHT / across
    tank = tp.tank(size, spacing, jitter=JITTER if start else 0.0, seed=start)
    tank.fill(AIR).fill(WATER, box=((0, 0), (2 * HEIGHT, HEIGHT)))
    grading = tp.Grading({"air": air_spacing * HEIGHT}) if air_spacing else None
    numerics = tp.Numerics(largest_move=0.8)
    return tp.Case(tank, [WATER, AIR], (0, -GRAVITY), numerics=numerics, grading=grading, title="Impact of a dam break")


@dataclass(frozen=True)
class Measured:
    """What a gauge has measured.

    Attributes:
        time: (K,) [sqrt(H / g)].
        pressure: (K,) of each step [rho g H].
        impulse: (K,) its integral over time [rho g H sqrt(H / g)].
        filtered: (K,) low-pass filtered pressure [rho g H].
    """

    time: Array
    pressure: Array
    impulse: Array
    filtered: Array


Run = dict[str, Measured]  # by the names of the gauges


def simulate(across: int, out: Path, end: float = END, start: int = 0) -> Run:
    """Run the case to a time [sqrt(H / g)]; see `build`."""
    gauges = [
        tp.WallPressure(name=name, wall="right", at=at, impulse=True, time_constant=TIME_CONSTANT * CLOCK)
        for name, at in (("pressure", (LENGTH * HEIGHT, GAUGE * HEIGHT)), ("corner", (LENGTH * HEIGHT, 0.0)))
    ]
    simulation = tp.Simulation(
        build(across, 0.2, start),
        out,
        time_step=0.05 * CLOCK,
        output_interval=0.1 * CLOCK,
        probes=gauges,
        overwrite=True,
    )
    simulation.run(end * CLOCK)
    return scaled(tp.read_results(out))


def scaled(results: tp.RunResults) -> Run:
    """What the gauges of a run have measured."""
    unit = WATER.density * GRAVITY * HEIGHT
    run = Run()
    for name in ("pressure", "corner"):
        table = results.probes[name]
        pressure, impulse, filtered = (
            np.asarray(table[column]) / unit for column in ("pressure", "pressure_impulse", "pressure_filtered")
        )
        run[name] = Measured(np.asarray(table["time"]) / CLOCK, pressure, impulse / CLOCK, filtered)
    return run


def experiment() -> tuple[Array, Array]:
    """Times and pressures as Buchner measured them, in the same units."""
    path = Path(__file__).with_name("data") / "buchner2002_pressure.csv"
    table = np.loadtxt(path, delimiter=",", skiprows=2)
    table = table[np.argsort(table[:, 0], kind="stable")]
    return table[:, 0], table[:, 1]


def integral(time: Array, values: Array) -> Array:
    """Integrals (K,) of values (K,), linear between their times (K,)."""
    return np.concatenate([[0.0], np.cumsum(np.diff(time) * 0.5 * (values[1:] + values[:-1]))])


def running_mean(time: Array, impulse: Array, length: float = SMOOTHING) -> Array:
    """Means (K,) over a length of time around each of the times (K,), from integrals (K,) up to these."""
    low, high = np.clip(time - 0.5 * length, time[0], None), np.clip(time + 0.5 * length, None, time[-1])
    return np.asarray((np.interp(high, time, impulse) - np.interp(low, time, impulse)) / np.maximum(high - low, 1e-12))


def figures_of(time: Array, pressure: Array, impulse: Array) -> dict[str, float]:
    """Figures of a pressure history.

    Args:
        time: (K,) [sqrt(H / g)].
        pressure: (K,) [rho g H].
        impulse: (K,) its integral over time.

    Returns:
        ``arrival``: when the running mean first exceeds `RISEN` [sqrt(H / g)]; ``peak``: largest running mean within
        `IMPACT` after that; ``impulse``: integral over the same time; ``plateau``: mean over `PLATEAU`; ``noise``:
        root mean square over the same time of what differs from the running mean, all in rho g H; ``largest``: largest
        single value of all. NaN for what the history is too short for.
    """
    smooth = running_mean(time, impulse)
    risen = np.flatnonzero(smooth > RISEN)
    arrival = float(time[risen[0]]) if len(risen) else math.nan
    after = (time >= arrival) & (time <= arrival + IMPACT)
    on = (time >= PLATEAU[0]) & (time <= PLATEAU[1])
    whole = time[-1] >= PLATEAU[1] - 1e-9
    weights = np.gradient(time)
    return {
        "arrival": arrival,
        "peak": float(smooth[after].max()) if after.any() else math.nan,
        "impulse": _between(time, impulse, arrival, arrival + IMPACT),
        "plateau": _between(time, impulse, *PLATEAU) / (PLATEAU[1] - PLATEAU[0]),
        "noise": float(np.sqrt(np.average((pressure - smooth)[on] ** 2, weights=weights[on]))) if whole else math.nan,
        "largest": float(pressure.max()),
    }


def _between(time: Array, impulse: Array, start: float, end: float) -> float:
    """The impulse from one time to another; NaN if that is not known."""
    if not end <= time[-1] + 1e-9:  # also if it is NaN
        return math.nan
    return float(np.interp(end, time, impulse) - np.interp(start, time, impulse))


def spread_of(found: Sequence[Mapping[str, float]]) -> dict[str, tuple[float, float]]:
    """Mean and standard deviation of the figures of several runs, by name."""
    return {
        name: (float(np.mean(values)), float(np.std(values, ddof=1)))
        for name in found[0]
        for values in [[figures[name] for figures in found]]
    }


def missed(found: Mapping[str, float], measured: Mapping[str, float], end: float = END) -> list[str]:
    """What of a run's figures is not as the experiment's.

    Args:
        found: figures of the run.
        measured: those of the experiment.
        end: of the run [sqrt(H / g)]; what it is too short for is not judged.
    """
    lines = []
    needed = {"arrival": measured["arrival"] * (1 + LATE), "plateau": PLATEAU[1]}
    for name, limit in (("arrival", LATE), ("plateau", OFF)):
        error = found[name] / measured[name] - 1
        if math.isnan(error) and end < needed[name]:
            continue
        if not abs(error) <= limit:
            lines.append(f"{name} is {found[name]:.3g}, {100 * error:+.0f} % of the experiment's {measured[name]:.3g}")
    return lines


def plot(path: Path, runs: Mapping[str, Sequence[Run]]) -> None:
    """Draw the pressures at the gauge as running means, of the first run step by step too, among the measured ones."""
    figure = new_figure(7.5, 4.2)
    axes = figure.subplots()
    for (label, starts), colour in zip(runs.items(), COLOURS, strict=False):
        for k, run in enumerate(starts):
            of = run["pressure"]
            mean = running_mean(of.time, of.impulse)
            if k:
                axes.plot(of.time, mean, color=colour, linewidth=0.6)
                continue
            axes.plot(of.time, of.pressure, color=colour, linewidth=0.5, alpha=0.45)
            axes.plot(of.time, mean, color=colour, label=f"{label}, running mean (thin: every step)")
    axes.plot(*experiment(), "ko", markersize=3, label="Buchner (2002)")
    axes.set(xlim=(2, END), ylim=(-0.3, 1.5), xlabel=r"$t \sqrt{g / H}$", ylabel=r"$p / (\rho g H)$")
    axes.legend(frameon=False)
    axes.grid(alpha=0.3)
    save(figure, path)


def plot_corner(path: Path, runs: Mapping[str, Sequence[Run]]) -> None:
    """Draw what the gauge in the corner measured in the first run of each resolution: each step, filtered, impulse."""
    figure = new_figure(7.5, 5.6)
    each, filtered, impulse = figure.subplots(3, 1, sharex=True)
    for (label, starts), colour in zip(runs.items(), COLOURS, strict=False):
        of = starts[0]["corner"]
        for axes, values in ((each, of.pressure), (filtered, of.filtered), (impulse, of.impulse)):
            axes.plot(of.time, values, color=colour, linewidth=1, label=label)
    each.set(ylabel=r"$p / (\rho g H)$", title="each step", xlim=(2.3, 3.5))
    filtered.set(ylabel=r"$p / (\rho g H)$", title=rf"filtered, time constant ${TIME_CONSTANT:g} \sqrt{{H / g}}$")
    impulse.set(ylabel=r"$I / (\rho H \sqrt{g H})$", title="impulse", xlabel=r"$t \sqrt{g / H}$", ylim=(0, 1.4))
    each.legend(frameon=False)
    for axes in (each, filtered, impulse):
        axes.title.set_fontsize("medium")
        axes.grid(alpha=0.3)
    save(figure, path)


def main(
    *, across: Counts = (20, 30), starts: Count = 1, end_time: Positive = END, out: Path = Path("out/impact")
) -> int:
    """Run the impact at all resolutions, from one start or several.

    Args:
        across: particles over the column's height.
        starts: runs of each resolution, from perturbed starts.
        end_time: simulated time to run to [sqrt(H / g)].
        out: folder for the results.
    """
    tp.init()
    measured_time, measured_pressure = experiment()
    measured = figures_of(measured_time, measured_pressure, integral(measured_time, measured_pressure))
    runs, found, spread, lines = dict[str, list[Run]](), dict[str, Any](), dict[str, Any](), list[str]()
    for n in sorted(across):
        label, figures = f"H / {n}", []
        runs[label] = []
        for start in range(starts):
            runs[label].append(simulate(n, out / (f"{n}_{start}" if start else f"{n}"), end_time, start))
            gauge = runs[label][-1]["pressure"]
            figures.append(figures_of(gauge.time, gauge.pressure, gauge.impulse))
            print(f"{label}: " + ", ".join(f"{name} {value:.3g}" for name, value in figures[-1].items()))
            lines += [f"{label}: {line}" for line in missed(figures[-1], measured, end_time)]
        found[label] = figures[0] if starts == 1 else figures
        if starts > 1:
            spread[label] = spread_of(figures)
            means = (f"{name} {mean:.3f} +- {deviation:.3f}" for name, (mean, deviation) in spread[label].items())
            print(f"{label}, {starts} starts: " + ", ".join(means))
    print("experiment: " + ", ".join(f"{name} {value:.3g}" for name, value in measured.items()))
    plot(out / "pressure.png", runs)
    plot_corner(out / "corner.png", runs)
    return harness.report(out, {"figures": found, "spread": spread, "experiment": measured}, lines)


if __name__ == "__main__":
    harness.command(__name__)
