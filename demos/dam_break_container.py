"""Dam break in three dimensions against a container, with water levels and pressures of an experiment.

    tipfem demo dam_break_container --spacing 0.06

The check holds that water levels are those of the experiment of MARIN (K. M. T. Kleefsman et al., J. Comput. Phys. 206
(2005) 363-393; SPHERIC benchmark test 2), that the container's face gets the impulses of its pressures, and that the
water keeps its volume; levels.png and pressures.png have them over time. The case is
demos/cases/dam_break_container.toml; `tipfem run` runs it without the check.

The levels are lengths of vertical lines in the water, like the wires of the experiment. At x = 2.638 m a gauge is in
the column; the front passes those at 1.488 and 0.992 m, and goes round the container to the one at 0.496 m. How soon it
gets there depends on the spacing: the check does not hold that. Pressures of single steps are rough while the front
hits the face, so they are compared by their impulses in the 0.17 s from their own arrival on, and drawn through a
filter of 5 ms.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from tipfem.demos import harness
from tipfem.demos.support.figures import COLOURS, new_figure, save

import tipfem as tp

DATA = Path(__file__).parent / "data"
MEASURED, PRESSED = DATA / "kleefsman2005_levels.csv", DATA / "kleefsman2005_pressures.csv"
COLUMN, BEHIND = "at_2.638", "at_0.496"  # gauges in the column, and behind the container; the others are between
HIGH = 0.55  # the column [m]
ARRIVED = 0.02  # level at which a front has come [m]
HIT = 1000.0  # pressure at which the water has hit the container [Pa]
SPAN = -0.01, 0.17  # of impulses, from then on [s]
# RMS off the experiment [column heights]; how late or early a front arrives between [s]; change of the volume; impulses
# off the experiment's, relative.
LARGEST = {"column": 0.03, "between": 0.1, "arrival": 0.05, "volume": 1e-12, "impulse_P1": 0.25, "impulse_P3": 0.4}


def measured(path: Path = MEASURED) -> dict[str, np.ndarray]:
    """Times [s] and levels [m] or pressures [Pa] (K,) of the experiment, as "time" and "at_X" or "P1" and "P3"."""
    lines = [line for line in path.read_text(encoding="utf-8").splitlines() if not line.startswith("#")]
    rows = list(csv.DictReader(lines))
    return {name: np.array([float(row[name]) for row in rows]) for name in rows[0]}


def arrival(time: np.ndarray, level: np.ndarray) -> float:
    """When a level first rises above `ARRIVED` [s], linear between samples; NaN if it never does."""
    above = np.flatnonzero(level > ARRIVED)
    if not len(above) or above[0] == 0:
        return float("nan")
    k = above[0]
    return float(np.interp(ARRIVED, level[k - 1 : k + 1], time[k - 1 : k + 1]))


def impulse(time: np.ndarray, pressure: np.ndarray, summed: np.ndarray) -> float:
    """Impulse [Pa s] of a pressure (T,) with integral ``summed`` (T,) after its arrival; NaN if it never arrives."""
    there = np.flatnonzero(pressure > HIT)
    if not len(there):
        return float("nan")
    hit = time[there[0]]
    return float(np.diff(np.interp(hit + np.array(SPAN), time, summed))[0])


class AsMeasured(harness.Check):
    """The water has the levels of the experiment, hits the container as in it, and keeps its volume.

    Args:
        case: with probes whose names are those of the columns of the experiment.
    """

    def __init__(self, case: tp.Case) -> None:
        self._fluid = case.fluids[0].name

    def begin(self, simulation: tp.Simulation, options: harness.Options) -> None:
        """See `Check.begin`."""
        self._volume = simulation.volume(self._fluid)

    def curves(self, simulation: tp.Simulation) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        """Times [s] and levels [m] (T,) at each gauge; 0 where there is no water."""
        tables = {name: probe for name, probe in simulation.probes.items() if name.startswith("at_")}
        return {name: (table["time"], np.nan_to_num(table["depth"])) for name, table in tables.items()}

    def figures(self, simulation: tp.Simulation) -> dict[str, float]:
        """RMS off the experiment in the column, behind the container and between them, and the change of the volume.

        And the largest difference of the front's arrivals at the gauges between, which it reaches in time.
        """
        found, given = self.curves(simulation), measured()
        off, late = {}, [0.0]
        for name, (time, level) in found.items():
            there = given["time"] <= time[-1]
            off[name] = (np.interp(given["time"][there], time, level) - given[name][there]) / HIGH
            if name not in (COLUMN, BEHIND):
                late.append(abs(arrival(time, level) - arrival(given["time"][there], given[name][there])))
        between = np.concatenate([value for name, value in off.items() if name not in (COLUMN, BEHIND)])
        pressed = measured(PRESSED)
        steps = np.diff(pressed["time"])
        for name in ("P1", "P3"):
            table, values = simulation.probes[name], pressed[name]
            if table["time"][-1] > pressed["time"][-1]:
                sums = np.concatenate([[0.0], np.cumsum(steps * 0.5 * (values[1:] + values[:-1]))])
                ours = impulse(table["time"], table["pressure"], table["pressure_impulse"])
                off[f"impulse_{name}"] = abs(ours / impulse(pressed["time"], values, sums) - 1)
        rms = {"column": off[COLUMN], "between": between, "behind": off[BEHIND]}
        return {
            **{name: float(np.sqrt((value**2).mean())) for name, value in rms.items()},
            "arrival": float(np.nanmax(late)),
            **{name: float(value) for name, value in off.items() if name.startswith("impulse")},
            "volume": abs(simulation.volume(self._fluid) / self._volume - 1),
        }

    def missed(self, figures: Mapping[str, float], options: harness.Options) -> list[str]:
        """See `Check.missed`."""
        return harness.above(figures, LARGEST)

    def plot(self, simulation: tp.Simulation, figures: Mapping[str, float], options: harness.Options) -> None:
        """The levels and pressures over time."""
        figure, given = new_figure(7, 4), measured()
        axes = figure.subplots()
        for number, (name, (time, level)) in enumerate(self.curves(simulation).items()):
            colour = COLOURS[number % len(COLOURS)]
            axes.plot(time, level, color=colour, label=f"x = {name.removeprefix('at_')} m")
            there = given["time"] <= time[-1]
            axes.plot(given["time"][there], given[name][there], "o", color=colour, markersize=3)
        axes.set(xlabel="t [s]", ylabel="level [m]", title="dots: experiment of MARIN")
        axes.legend()
        save(figure, Path(options.out) / "levels.png")
        figure, given = new_figure(7, 4), measured(PRESSED)
        axes = figure.subplots()
        for colour, name in zip(COLOURS, ("P1", "P3"), strict=False):
            table = simulation.probes[name]
            axes.plot(table["time"], table["pressure_filtered"] / 1e3, color=colour, label=name)
            axes.plot(given["time"], given[name] / 1e3, "o", color=colour, markersize=3)
        axes.set(xlabel="t [s]", ylabel="pressure [kPa]", xlim=(0.35, 0.65), title="dots: experiment of MARIN")
        axes.legend()
        save(figure, Path(options.out) / "pressures.png")


main = harness.Demo("dam_break_container.toml", check=AsMeasured)

if __name__ == "__main__":
    harness.command(__name__)
