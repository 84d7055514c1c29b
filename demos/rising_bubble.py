"""A bubble of air rises in syrup: it becomes a cap, and draws a skirt.

    tipfem demo rising_bubble --spacing 0.0013

An axisymmetric flow. The check holds that the bubble rises as fast as in the experiments of Bhaga & Weber, whose drag
coefficient of bubbles in viscous liquids is ((2.67)^0.9 + (16 / Re)^0.9)^(1/0.9), and that it keeps its volume;
rising_bubble.png has the speed over time. The case is demos/cases/rising_bubble.toml; `tipfem run` runs it without the
check.

D. Bhaga & M. E. Weber, Bubbles in viscous liquids: shapes, wakes and velocities, Journal of Fluid Mechanics 105, 1981.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from tipfem.demos import harness
from tipfem.demos.support.figures import COLOURS, new_figure, save
from tipfem.demos.validation.round.bubbles import terminal_reynolds

import tipfem as tp

GRAVITY = 9.81  # [m/s^2]
STEADY = 0.3  # when the bubble's speed has become even [s]
LARGEST = {"reynolds": 0.05, "volume": 1e-9}


class Rises(harness.Check):
    """The bubble rises as in experiments, and keeps its volume.

    Args:
        case: of the bubble.
    """

    def __init__(self, case: tp.Case) -> None:
        self._liquid, self._gas = case.fluids
        self._tension = float(case.surface_tension.sigma[0, 1])

    def begin(self, simulation: tp.Simulation, options: harness.Options) -> None:
        """See `Check.begin`."""
        self._probe = tp.DropProbe(name="bubble", fluid=self._gas.name)
        self._volume = simulation.volume(self._gas.name)
        diameter = (6 * self._volume / math.pi) ** (1 / 3)
        weight = (self._liquid.density - self._gas.density) * GRAVITY
        viscosity = float(self._liquid.viscosity)
        eotvos = weight * diameter**2 / self._tension
        morton = weight * viscosity**4 / (self._liquid.density**2 * self._tension**3)
        self.wanted = terminal_reynolds(eotvos, morton)
        self._scale = self._liquid.density * diameter / viscosity

    def columns(self) -> dict[str, harness.Probe]:
        """The Reynolds number of the bubble's speed."""
        return {"reynolds": lambda simulation: float(self._scale * self._probe.sample(simulation)[2])}

    def figures(self, simulation: tp.Simulation) -> dict[str, float]:
        """The error of the Reynolds number, in the mean from `STEADY` on, and the bubble's shape."""
        _, height, _, sphericity, *_ = self._probe.sample(simulation)
        late = [row["reynolds"] for row in simulation.history if row["time"] >= STEADY]
        return {
            "reynolds": float(np.mean(late)) / self.wanted - 1 if late else math.nan,
            "height": height,
            "sphericity": sphericity,
            "volume": abs(simulation.volume(self._gas.name) / self._volume - 1),
        }

    def missed(self, figures: Mapping[str, float], options: harness.Options) -> list[str]:
        """See `Check.missed`; in a short run the speed is not even."""
        known = LARGEST if options.end_time > STEADY else {"volume": LARGEST["volume"]}
        return harness.above({name: abs(value) for name, value in figures.items()}, known)

    def plot(self, simulation: tp.Simulation, figures: Mapping[str, float], options: harness.Options) -> None:
        """The speed over time."""
        rows = simulation.history
        figure = new_figure(6, 3.6)
        axes = figure.subplots()
        axes.plot([row["time"] for row in rows], [row["reynolds"] for row in rows], color=COLOURS[0], label="computed")
        axes.axhline(self.wanted, color="k", linestyle="--", label="Bhaga & Weber (1981)")
        axes.set(xlabel="t [s]", ylabel="Reynolds number of the bubble", ylim=(0, None))
        axes.legend(loc="lower right")
        save(figure, Path(options.out) / "rising_bubble.png")


main = harness.Demo("rising_bubble.toml", check=Rises, strip=(0.0, 0.05, 0.1, 0.2, 0.3, 0.4))

if __name__ == "__main__":
    harness.command(__name__)
