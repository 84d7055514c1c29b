"""A square tank is moved round a circle, in three dimensions, and a wave runs round along its walls.

    tipfem demo sloshing_3d --spacing 0.06

The check holds that the wave along each pair of sides is that of linear theory, and that the water keeps its volume;
sloshing_3d.png has both over time. The case is demos/cases/sloshing_3d.toml; `tipfem run` runs it without the check.

With one half wave along sides of length L the surface in a tank that moves by x(t) is a(t) cos(k x) with k = pi / L,

    a'' + w^2 a = 4 L / pi^2 w^2 x'' / g,   w^2 = g k tanh(k H)

on water of depth H: H. N. Abramson (ed.), The dynamic behavior of liquids in moving containers, NASA SP-106, 1966,
chapter 2. In a box what motion along each of two sides raises is added. In waves as high as these crests are higher
than troughs are deep; their half waves along the sides are still near those of linear theory.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp
from tipfem.demos import harness
from tipfem.demos.support.figures import COLOURS, new_figure, save

import tipfem as tp

DIFFERENCE = 1e-4  # of times, for second derivatives of the tank's place [s]
LARGEST = {"off": 0.12, "volume": 1e-12}  # RMS over that of theory; change of the volume
BEGUN = 1.0  # when there is a wave [s]
NAMES = ("along_x", "along_y")


class RunsRound(harness.Check):
    """The water rises as in linear theory, and keeps its volume.

    Args:
        case: of a box with water on its floor, and a motion of the tank.
    """

    def __init__(self, case: tp.Case) -> None:
        (*_, self._depth) = case.tank.regions[-1].given["box"][1]
        self._size = np.asarray(case.tank.size[:2], dtype=float)
        self._gravity, self._place = float(np.linalg.norm(case.gravity)), case.tank_motion.translation

    def begin(self, simulation: tp.Simulation, options: harness.Options) -> None:
        """See `Check.begin`."""
        self._volume = simulation.volume("water")

    def columns(self) -> dict[str, harness.Probe]:
        """Amplitudes a [m]: 2 / (L W) times the integral of cos(k x) over the water."""

        def amplitude(axis: int) -> harness.Probe:
            def measured(simulation: tp.Simulation) -> float:
                mesh, at = simulation.mesh, self._place(simulation.time)[axis]
                x = mesh.position[mesh.cells, axis] - at
                wave = 0.8 * self._wave(x.mean(axis=1), axis) + 0.2 * self._wave(x, axis).mean(axis=1)
                return float(2 / self._size.prod() * mesh.measure @ wave)

            return measured

        return {name: amplitude(axis) for axis, name in enumerate(NAMES)}

    def _wave(self, x: np.ndarray, axis: int) -> np.ndarray:
        """The cosines at places along an axis [m]."""
        return np.asarray(np.cos(np.pi / self._size[axis] * x))

    def theory(self, times: np.ndarray) -> np.ndarray:
        """Amplitudes (2, T) [m] at times (T,) [s], ascending."""
        k = np.pi / self._size
        square = self._gravity * k * np.tanh(k * self._depth)
        forcing = 4 * self._size / np.pi**2 * square / self._gravity

        def rates(t: float, state: np.ndarray) -> np.ndarray:
            before, now, after = (np.asarray(self._place(t + s))[:2] for s in (-DIFFERENCE, 0.0, DIFFERENCE))
            pushed = (before - 2 * now + after) / DIFFERENCE**2
            return np.concatenate([state[2:], forcing * pushed - square * state[:2]])

        return np.asarray(
            solve_ivp(rates, (0.0, float(times[-1])), np.zeros(4), t_eval=times, max_step=0.02, rtol=1e-6).y[:2]
        )

    def _curves(self, simulation: tp.Simulation) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Times (T,), measured amplitudes (2, T) and those of theory."""
        rows = simulation.history
        times = np.array([row["time"] for row in rows])
        return times, np.array([[row[name] for row in rows] for name in NAMES]), self.theory(times)

    def figures(self, simulation: tp.Simulation) -> dict[str, float]:
        """RMS of measured amplitudes less those of theory over that of theory, and the change of the volume."""
        _, measured, theory = self._curves(simulation)
        return {
            "off": float(np.sqrt(((measured - theory) ** 2).sum() / (theory**2).sum())),
            "largest": float(np.abs(measured).max()),
            "volume": abs(simulation.volume("water") / self._volume - 1),
        }

    def missed(self, figures: Mapping[str, float], options: harness.Options) -> list[str]:
        """See `Check.missed`; a short run has no wave yet."""
        texts = {
            "off": "the amplitudes are {:.1%} of theory's off, more than {:.0%}",
            "volume": "the volume is off by {:.1e}, more than {:.0e}",
        }
        short = options.end_time < BEGUN
        return [
            text.format(figures[name], LARGEST[name])
            for name, text in texts.items()
            if not figures[name] <= LARGEST[name] and not (short and name == "off")
        ]

    def plot(self, simulation: tp.Simulation, figures: Mapping[str, float], options: harness.Options) -> None:
        """The amplitudes over time."""
        times, measured, theory = self._curves(simulation)
        figure = new_figure(7, 4)
        axes = figure.subplots()
        for number, name in enumerate(NAMES):
            axes.plot(times, 1e3 * measured[number], color=COLOURS[number], label=name.replace("_", " "))
            axes.plot(times, 1e3 * theory[number], color=COLOURS[number], linestyle=":")
        axes.set(xlabel="t [s]", ylabel="amplitude [mm]", title="dotted: linear theory")
        axes.legend()
        save(figure, Path(options.out) / "sloshing_3d.png")


main = harness.Demo("sloshing_3d.toml", check=RunsRound)

if __name__ == "__main__":
    harness.command(__name__)
