"""A bubble rises in a box, in three dimensions, and becomes flat.

    tipfem demo rising_bubble_3d --spacing 0.1

Box, fluids and bubble are those of J. Adelsberger et al. (2014), case 1; walls have a layer. The check holds that the
bubble comes to rise evenly, goes to no side and keeps its volume; rising_bubble_3d.png has its speed over time. The
case is demos/cases/rising_bubble_3d.toml; `tipfem run` runs it without the check.

J. Adelsberger, P. Esser, M. Griebel, S. Gross, M. Klitz & A. Rüttgers, 3D incompressible two-phase flow benchmark
computations for rising droplets, Proceedings of the 11th World Congress on Computational Mechanics, 2014.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from tipfem.demos import harness
from tipfem.demos.support.figures import COLOURS, new_figure, save

import tipfem as tp

STEADY = 2.0  # when the bubble's speed has become even [s]
LARGEST = {"changes": 0.05, "aside": 0.5, "volume": 1e-9}  # of its speed since then; way to a side [spacings]


class Rises(harness.Check):
    """The bubble rises evenly in the middle, and keeps its volume.

    Args:
        case: of the bubble.
    """

    def __init__(self, case: tp.Case) -> None:
        self._probe = tp.DropProbe(name="bubble", fluid=case.fluids[1].name)
        self._middle = np.asarray(case.tank.regions[-1].given["disc"][0])
        self._spacing = case.particles.spacing

    def begin(self, simulation: tp.Simulation, options: harness.Options) -> None:
        """See `Check.begin`."""
        self._volume = simulation.volume(self._probe.fluid)

    def columns(self) -> dict[str, harness.Probe]:
        """Speed [m/s], way to a side [m] and sphericity of the bubble."""

        def measured(simulation: tp.Simulation) -> dict[str, float]:
            names = [name for name, _ in self._probe.columns(simulation.case)]
            return dict(zip(names, self._probe.sample(simulation), strict=True))

        def aside(simulation: tp.Simulation) -> float:
            place = measured(simulation)
            return float(np.hypot(place["x"] - self._middle[0], place["y"] - self._middle[1]))

        return {
            "speed": lambda simulation: measured(simulation)["velocity_z"],
            "aside": aside,
            "sphericity": lambda simulation: measured(simulation)["sphericity"],
        }

    def figures(self, simulation: tp.Simulation) -> dict[str, float]:
        """The largest and the last speed, how the speed changes from `STEADY` on, and shape, place and volume."""
        rows = simulation.history
        speed, aside = (np.array([row[name] for row in rows]) for name in ("speed", "aside"))
        late = speed[[row["time"] >= STEADY for row in rows]]
        return {
            "largest_speed": float(speed.max()),
            "speed": float(late.mean()) if len(late) else float(speed[-1]),
            "changes": float(np.ptp(late) / late.mean()) if len(late) else 0.0,
            "sphericity": rows[-1]["sphericity"],
            "aside": float(aside.max()) / self._spacing,
            "volume": abs(simulation.volume(self._probe.fluid) / self._volume - 1),
        }

    def missed(self, figures: Mapping[str, float], options: harness.Options) -> list[str]:
        """See `Check.missed`."""
        return harness.above(figures, LARGEST)

    def plot(self, simulation: tp.Simulation, figures: Mapping[str, float], options: harness.Options) -> None:
        """The speed over time."""
        rows = simulation.history
        figure = new_figure(6, 3.6)
        axes = figure.subplots()
        axes.plot([row["time"] for row in rows], [row["speed"] for row in rows], color=COLOURS[0])
        axes.set(xlabel="t [s]", ylabel="speed of the bubble [m/s]", ylim=(0, None))
        save(figure, Path(options.out) / "rising_bubble_3d.png")


main = harness.Demo("rising_bubble_3d.toml", check=Rises)

if __name__ == "__main__":
    harness.command(__name__)
