"""The pressure of a dam break on the far wall, and its noise, against the experiment of Buchner (2002).

A column of water of height H and width 2 H runs along a dry floor and hits the wall at 5.366 H, where the pressure is
measured at a height of 0.2 H. The walls of the tank slip, for no mesh here resolves their boundary layers.

    summary.json      figures of all runs, and those of the experiment
    pressure.png      pressures over time
    <runs>/           history.csv, probes/pressure.csv and summary.json of each run

python -m tipfem demo validation/impact --across 20 30
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tipfem.demos import harness
from tipfem.demos.support.figures import COLOURS, new_figure, save

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
# Limits of the check: of the time at which the water arrives, and of the mean pressure on the plateau, relative.
LATE, OFF = 0.1, 0.25


def build(across: int, air_spacing: float | None = None) -> tp.Case:
    """The case.

    Args:
        across: particles over the height of the column.
        air_spacing: distance between particles in the air, far from the water [H]; by default that of all.
    """
    tank = tp.tank((LENGTH * HEIGHT, CEILING * HEIGHT), HEIGHT / across)
    tank.fill(AIR).fill(WATER, box=((0, 0), (2 * HEIGHT, HEIGHT)))
    for wall in ("left", "right", "bottom", "top"):
        tank.wall(wall, slip=True)
    grading = tp.Grading({"air": air_spacing * HEIGHT}) if air_spacing else None
    numerics = tp.Numerics(largest_move=0.8)
    return tp.Case(tank, [WATER, AIR], (0, -GRAVITY), numerics=numerics, grading=grading, title="Impact of a dam break")


def simulate(across: int, out: Path, end: float = END) -> tuple[Array, Array]:
    """Run the case to a time [sqrt(H / g)]; times (K,) [sqrt(H / g)] and pressures (K,) [rho g H] of all steps."""
    gauge = tp.WallPressure(name="pressure", wall="right", at=(LENGTH * HEIGHT, GAUGE * HEIGHT))
    simulation = tp.Simulation(
        build(across, air_spacing=0.2),
        out,
        time_step=0.05 * CLOCK,
        output_interval=0.1 * CLOCK,
        probes=[gauge],
        overwrite=True,
    )
    harness.run_to_end(simulation, end * CLOCK)
    return scaled(tp.read_results(out))


def scaled(results: tp.RunResults) -> tuple[Array, Array]:
    """Times [sqrt(H / g)] and pressures [rho g H] that the gauge of a run has measured."""
    table = results.probes["pressure"]
    pressure = np.asarray(table["pressure"]) / (WATER.density * GRAVITY * HEIGHT)
    return np.asarray(table["time"]) / CLOCK, pressure


def experiment() -> tuple[Array, Array]:
    """Times and pressures as Buchner measured them, in the same units."""
    path = Path(__file__).with_name("data") / "buchner2002_pressure.csv"
    table = np.loadtxt(path, delimiter=",", skiprows=2)
    table = table[np.argsort(table[:, 0], kind="stable")]
    return table[:, 0], table[:, 1]


def running_mean(time: Array, values: Array, length: float = SMOOTHING) -> Array:
    """Means (K,) of values (K,), linear between their times (K,), over a length of time around each."""
    whole = np.concatenate([[0.0], np.cumsum(np.diff(time) * 0.5 * (values[1:] + values[:-1]))])
    # The integral is a parabola between two times; linear, it is wrong by less than what one sample has in the mean.
    low, high = np.clip(time - 0.5 * length, time[0], None), np.clip(time + 0.5 * length, None, time[-1])
    return np.asarray((np.interp(high, time, whole) - np.interp(low, time, whole)) / np.maximum(high - low, 1e-12))


def figures_of(time: Array, pressure: Array) -> dict[str, float]:
    """Figures of a pressure history.

    Returns:
        ``arrival``: when the running mean first exceeds `RISEN` [sqrt(H / g)]; ``peak``: largest running mean within
        1 after that; ``plateau``: mean over `PLATEAU`; ``noise``: root mean square over the same time of what differs
        from the running mean, all in rho g H; ``largest``: largest single value of all. NaN for what the history is too
        short for.
    """
    smooth = running_mean(time, pressure)
    risen = np.flatnonzero(smooth > RISEN)
    arrival = float(time[risen[0]]) if len(risen) else math.nan
    after = (time >= arrival) & (time <= arrival + 1)
    on = (time >= PLATEAU[0]) & (time <= PLATEAU[1])
    whole = time[-1] >= PLATEAU[1]
    weights = np.gradient(time)
    return {
        "arrival": arrival,
        "peak": float(smooth[after].max()) if after.any() else math.nan,
        "plateau": float(np.average(pressure[on], weights=weights[on])) if whole else math.nan,
        "noise": float(np.sqrt(np.average((pressure - smooth)[on] ** 2, weights=weights[on]))) if whole else math.nan,
        "largest": float(pressure.max()),
    }


def missed(found: Mapping[str, float], measured: Mapping[str, float]) -> list[str]:
    """What of a run's figures is not as the experiment's; NaN is passed over."""
    lines = []
    for name, limit in (("arrival", LATE), ("plateau", OFF)):
        error = found[name] / measured[name] - 1
        if abs(error) > limit:
            lines.append(f"{name} is {found[name]:.3g}, {100 * error:+.0f} % of the experiment's {measured[name]:.3g}")
    return lines


def plot(path: Path, runs: Mapping[str, tuple[Array, Array]]) -> None:
    """Draw the pressures of runs, step by step and as running means, among the measured ones."""
    figure = new_figure(7.5, 4.2)
    axes = figure.subplots()
    for (label, (time, pressure)), colour in zip(runs.items(), COLOURS, strict=False):
        axes.plot(time, pressure, color=colour, linewidth=0.5, alpha=0.45)
        axes.plot(time, running_mean(time, pressure), color=colour, label=f"{label}, running mean (thin: every step)")
    axes.plot(*experiment(), "ko", markersize=3, label="Buchner (2002)")
    axes.set(xlim=(2, END), ylim=(-0.3, 2.0), xlabel=r"$t \sqrt{g / H}$", ylabel=r"$p / (\rho g H)$")
    axes.legend(frameon=False)
    axes.grid(alpha=0.3)
    save(figure, path)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run what the command line asks for."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("--across", type=int, nargs="+", default=[20, 30], help="particles over the column's height")
    parser.add_argument("--end-time", type=harness.positive, default=END, metavar="T", help="[sqrt(H / g)]")
    parser.add_argument("--out", type=Path, default=Path("out/impact"), help="folder for the results")
    given = parser.parse_args(arguments)
    tp.init()
    measured, runs, found = figures_of(*experiment()), {}, dict[str, Any]()
    lines: list[str] = []
    for across in sorted(given.across):
        label = f"H / {across}"
        with harness.one_message():
            runs[label] = simulate(across, given.out / f"{across}", given.end_time)
        found[label] = figures_of(*runs[label])
        print(f"{label}: " + ", ".join(f"{name} {value:.3g}" for name, value in found[label].items()))
        lines += [f"{label}: {line}" for line in missed(found[label], measured)]
    print("experiment: " + ", ".join(f"{name} {value:.3g}" for name, value in measured.items()))
    content = {"figures": found, "experiment": measured, "check": lines or "passed"}
    (given.out / "summary.json").write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
    plot(given.out / "pressure.png", runs)
    harness.conclude(given.out, lines)


if __name__ == "__main__":
    main()
