"""A heap of mud slumps along a dry floor, and stops.

    tipfem demo mud_slump --spacing 0.00625

Mud is a Bingham fluid: below its yield stress it does not flow. The check holds that it stops, and there has the length
and the shape at which its weight and its yield stress are in balance over the whole length, h^2 = 2 tau_y / (rho g)
(x_f - x); mud_slump.png has that shape beside the mud. The case is demos/cases/mud_slump.toml; `tipfem run` runs it
without the check.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from tipfem.demos import harness
from tipfem.demos.support.figures import COLOURS, new_figure, save

import tipfem as tp

Array = NDArray[np.float64]

GRAVITY = 9.81  # [m/s^2]
STOPPED = 0.8  # when the mud has stopped [s]
LARGEST = {"length": 0.03, "shape": 0.035, "speed": 2e-3, "volume": 1e-12}


def front(simulation: tp.Simulation) -> float:
    """Where the mud ends [m]."""
    mesh = simulation.state.mesh
    return float(mesh.position[mesh.used, 0].max())


class Stops(harness.Check):
    """The mud stops in the shape of balance, and keeps its volume.

    Args:
        case: of the mud.
    """

    def __init__(self, case: tp.Case) -> None:
        mud = case.fluids[0]
        assert isinstance(mud.viscosity, tp.Bingham)
        self._slope = mud.viscosity.yield_stress / (mud.density * GRAVITY)  # of a layer of height h it is this over h

    def columns(self) -> dict[str, harness.Probe]:
        """The length of the mud."""
        return {"front": front}

    def begin(self, simulation: tp.Simulation, options: harness.Options) -> None:
        """See `Check.begin`."""
        mesh = simulation.state.mesh
        self._volume, self._height = simulation.volume("mud"), float(mesh.position[mesh.used, 1].max())
        self._start = front(simulation)
        self.length = (9 * self._volume**2 / (8 * self._slope)) ** (1 / 3)

    def shape(self, x: Array) -> Array:
        """Heights (K,) [m] of mud in balance at places (K,) [m]."""
        return np.asarray(np.sqrt(2 * self._slope * np.maximum(self.length - x, 0.0)))

    def figures(self, simulation: tp.Simulation) -> dict[str, float]:
        """Errors of the length, and of the shape over the first height; the speed over the largest."""
        x, y = top(simulation).T
        fastest = max(row["max_speed"] for row in simulation.history)
        return {
            "length": front(simulation) / self.length - 1,
            "shape": float(np.sqrt(((y - self.shape(x)) ** 2).mean())) / self._height,
            "speed": simulation.particles.max_speed / fastest,
            "volume": abs(simulation.volume("mud") / self._volume - 1),
        }

    def missed(self, figures: Mapping[str, float], options: harness.Options) -> list[str]:
        """See `Check.missed`; in a short run the mud has not stopped."""
        known = LARGEST if options.end_time >= STOPPED else {"volume": LARGEST["volume"]}
        sizes = {name: abs(value) for name, value in figures.items()}
        return harness.above(sizes, known)

    def plot(self, simulation: tp.Simulation, figures: Mapping[str, float], options: harness.Options) -> None:
        """The mud beside the shape of balance, and its length over time."""
        figure = new_figure(9, 3.4)
        left, right = figure.subplots(1, 2, gridspec_kw={"width_ratios": [1.6, 1]})
        x = np.linspace(0, self.length, 200)
        left.plot(
            [0, self._start, self._start], [self._height, self._height, 0], ":", color="0.5", label="at the start"
        )
        left.fill_between(*top(simulation).T, color=COLOURS[0], alpha=0.3)
        left.plot(*top(simulation).T, color=COLOURS[0], label=f"at {simulation.time:g} s")
        left.plot(x, self.shape(x), "k--", label="weight and yield stress in balance")
        left.set(xlabel="x [m]", ylabel="height [m]", ylim=(0, 1.45 * self._height))
        left.legend()
        rows = simulation.history
        right.plot([row["time"] for row in rows], [row["front"] for row in rows], color=COLOURS[0])
        right.axhline(self.length, color="k", linestyle="--")
        right.set(xlabel="t [s]", ylabel="length of the mud [m]")
        save(figure, Path(options.out) / "mud_slump.png")


def top(simulation: tp.Simulation) -> Array:
    """Particles (K, 2) of the free surface, from left to right [m]."""
    mesh = simulation.state.mesh
    found = mesh.position[mesh.used & mesh.surface.front]
    return np.asarray(found[np.argsort(found[:, 0])])


main = harness.Demo("mud_slump.toml", check=Stops, strip=(0.0, 0.1, 0.2, 0.3, 0.5, 1.0))

if __name__ == "__main__":
    harness.command(__name__)
