"""A ball of water falls into a pool, in three dimensions: a crater, a crown of drops, and a jet.

    tipfem demo splash_3d --spacing 0.06

The check holds that the crater is as deep as energy allows, that its collapse throws up a jet, that the water keeps its
volume, and that nothing pushes it aside; splash_3d.png has the surface in the middle over time. The case is
demos/cases/splash_3d.toml; `tipfem run` runs it without the check.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from tipfem.demos import harness
from tipfem.demos.support.figures import COLOURS, new_figure, save

import tipfem as tp

CRATER = (0.5, 1.0)  # its depth, over that of a hemisphere that takes all of the ball's energy
JET = 0.5  # least height over the pool [diameters of the ball]
COLLAPSED = 0.6  # when the jet has risen [s]
ASIDE = 0.1  # largest way of the centre of mass to a side [spacings]
NEAR = 0.5  # of the ball's radius: what is in the middle


class Splashes(harness.Check):
    """The crater has its depth, a jet rises, and the water keeps its volume and its place.

    Args:
        case: whose last fills are the pool and a ball that falls, with gravity along the last axis.
    """

    def __init__(self, case: tp.Case) -> None:
        pool, ball = case.tank.regions[-2:]
        (*_, self._level), (self._middle, self._radius) = pool.given["box"][1], ball.given["disc"]
        self._gravity, self._spacing = float(np.linalg.norm(case.gravity)), case.particles.spacing
        fall = self._middle[-1] - self._radius - self._level
        self._square = float(np.linalg.norm(ball.velocity)) ** 2 + 2 * self._gravity * fall  # of its speed there

    @property
    def deepest(self) -> float:
        """Depth [m] of a hemisphere on whose weight the ball's energy is spent.

        rho g pi R^4 / 4 = rho pi D^3 V^2 / 12
        """
        return float(((2 * self._radius) ** 3 * self._square / (3 * self._gravity)) ** 0.25)

    def _in_the_middle(self, simulation: tp.Simulation) -> np.ndarray:
        """Heights over the pool of the surface's particles in the middle [m]."""
        mesh = simulation.mesh
        x = mesh.position[mesh.used & mesh.surface.front]
        apart = np.linalg.norm(x[:, :-1] - self._middle[:-1], axis=1)
        return np.asarray(x[apart < NEAR * self._radius, -1] - self._level)

    def columns(self) -> dict[str, harness.Probe]:
        """The lowest and the highest point of the surface in the middle [m], and the centre of mass to a side [m]."""

        def aside(simulation: tp.Simulation) -> float:
            mass = simulation.state.mass
            centre = mass @ simulation.particles.position[:, :-1] / mass.sum()
            return float(np.linalg.norm(centre - self._middle[:-1]))

        return {
            "lowest": lambda simulation: float(self._in_the_middle(simulation).min(initial=np.inf)),
            "highest": lambda simulation: float(self._in_the_middle(simulation).max(initial=-np.inf)),
            "aside": aside,
        }

    def begin(self, simulation: tp.Simulation, options: harness.Options) -> None:
        """See `Check.begin`."""
        self._volume = simulation.volume("water")

    def figures(self, simulation: tp.Simulation) -> dict[str, float]:
        """Depth of the crater over `deepest`, its time, the jet after that, and changes of volume and place."""
        rows = simulation.history
        t, low, high, aside = (np.array([row[name] for row in rows]) for name in ("time", "lowest", "highest", "aside"))
        k = int(low.argmin())
        return {
            "crater": -float(low[k]) / self.deepest,
            "crater_time": float(t[k]),
            "jet": float(high[k:].max()) / (2 * self._radius),
            "volume": abs(simulation.volume("water") / self._volume - 1),
            "aside": float(np.abs(aside - aside[0]).max()) / self._spacing,
        }

    def missed(self, figures: Mapping[str, float], options: harness.Options) -> list[str]:
        """See `Check.missed`; a short run has no crater yet."""
        found = [f"the volume is off by {figures['volume']:.1e}"] if not figures["volume"] <= 1e-12 else []
        if not figures["aside"] <= ASIDE:
            found.append(f"the water is {figures['aside']:.2f} spacings aside, more than {ASIDE:g}")
        if options.end_time < COLLAPSED:
            return found
        if not CRATER[0] <= figures["crater"] <= CRATER[1]:
            found.append(f"the crater's depth is {figures['crater']:.2f} of what energy allows; it should be {CRATER}")
        if not figures["jet"] >= JET:
            found.append(f"the jet rises {figures['jet']:.2f} diameters over the pool, less than {JET:g}")
        return found

    def plot(self, simulation: tp.Simulation, figures: Mapping[str, float], options: harness.Options) -> None:
        """The surface in the middle over time."""
        rows = simulation.history
        figure = new_figure(6, 4)
        axes = figure.subplots()
        for number, name in enumerate(("highest", "lowest")):
            values = 1e3 * np.array([row[name] for row in rows])
            axes.plot([row["time"] for row in rows], values, color=COLOURS[number], label=f"{name} point")
        axes.axhline(-1e3 * self.deepest, color="k", linestyle="--", label="a hemisphere of the ball's energy")
        axes.set(xlabel="t [s]", ylabel="height over the pool [mm]")
        axes.legend()
        save(figure, Path(options.out) / "splash_3d.png")


main = harness.Demo("splash_3d.toml", check=Splashes)

if __name__ == "__main__":
    harness.command(__name__)
