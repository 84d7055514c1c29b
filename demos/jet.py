"""A jet of water breaks into drops: surface tension squeezes it where it is thin.

    tipfem demo jet --spacing 0.0001

An axisymmetric flow, seen by an observer who moves with the jet. Two waves of the length that grows fastest become two
large drops, and two small ones between them. The check holds that the waves grow at the rate of theory, that the jet
breaks, and that the water keeps its volume; jet.png has the measured wave beside the predicted one.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from tipfem.demos import harness
from tipfem.demos.support.figures import COLOURS, new_figure, save
from tipfem.demos.support.options import Positive
from tipfem.demos.validation.round.run import growth

import tipfem as tp
from tipfem.physics.surface_tension.edges import TensionEdges

Array = NDArray[np.float64]

RADIUS, AMPLITUDE = 1e-3, 0.02  # of the jet [m], of its waves [radii]
WAVE = 0.7 / RADIUS  # k [1/m]; waves with k R = 0.697 grow fastest
LENGTH = 4 * math.pi / WAVE  # of the part that is computed, two waves [m]
SIGMA, DENSITY, VISCOSITY = 0.0728, 998.2, 1.002e-3
SMALL, LARGE = 2.5, 6.0  # amplitudes between which the rate is measured, over that at the start
LARGEST = {"rate": 0.03, "volume": 1e-12}


def case(spacing: Positive = 2e-4) -> tp.Case:
    """A jet with two waves, in empty space between two planes of symmetry.

    Args:
        spacing: distance between particles [m].
    """
    water = tp.Fluid("water", density=DENSITY, viscosity=VISCOSITY)
    z = np.linspace(0, LENGTH, 25)
    surface = np.stack([RADIUS * (1 + AMPLITUDE * np.cos(WAVE * z)), z], axis=1)
    jet = [(0.0, 0.0), *surface.tolist(), (0.0, LENGTH)]
    tank = tp.tank((3 * RADIUS, LENGTH), spacing, coordinates="axisymmetric").fill(water, shape=jet)
    for side in ("right", "bottom", "top"):
        tank.wall(side, slip=True)
    return tp.Case(
        tank,
        [water],
        gravity=(0, 0),
        free_surface=True,
        surface_tension={"water": SIGMA},
        title="A jet of water breaks into drops",
    )


def amplitude(simulation: tp.Simulation) -> float:
    """Amplitude of the wave of the surface, over the jet's radius; NaN once the jet is in pieces."""
    edges, x = simulation.state.part(TensionEdges), simulation.particles.position
    (r, z), length = (x[edges.one] + x[edges.other]).T / 2, np.abs(x[edges.one, 1] - x[edges.other, 1])
    if length.sum() > 1.001 * LENGTH:  # the surface turns back
        return math.nan
    return float((r / RADIUS - 1) @ (np.cos(WAVE * z) * length)) * 2 / LENGTH


def rate() -> float:
    """Rate at which a wave grows [1/s]."""
    scale = math.sqrt(SIGMA / (DENSITY * RADIUS**3))
    return scale * growth(WAVE * RADIUS, VISCOSITY / math.sqrt(DENSITY * SIGMA * RADIUS))


class BreaksUp(harness.Check):
    """The waves grow at the rate of theory, the jet breaks, and the water keeps its volume."""

    def columns(self) -> dict[str, harness.Probe]:
        """The amplitude of the waves, and the number of drops."""
        return {"amplitude": amplitude, "drops": lambda simulation: float(simulation.mesh.connected[0])}

    def begin(self, simulation: tp.Simulation, options: harness.Options) -> None:
        """See `Check.begin`."""
        self._volume, self._start = simulation.volume("water"), amplitude(simulation)

    def course(self, simulation: tp.Simulation) -> tuple[Array, Array]:
        """Times [s] and amplitudes [radii] (K,), from the start to where the jet breaks."""
        t, a = (np.array([row[name] for row in simulation.history]) for name in ("time", "amplitude"))
        first = int(np.argmax(np.isnan(a))) if np.isnan(a).any() else len(a)
        return np.append(0.0, t[:first]), np.append(self._start, a[:first])

    def figures(self, simulation: tp.Simulation) -> dict[str, float]:
        """The rate relative to theory: from rest waves grow as cosh(w t)."""
        t, a = self.course(simulation)
        there = (a > SMALL * self._start) & (a < LARGE * self._start)
        found = float(np.mean(np.arccosh(a[there] / self._start) / t[there])) if there.any() else math.nan
        return {
            "rate": found / rate() - 1,
            "volume": abs(simulation.volume("water") / self._volume - 1),
            "drops": simulation.history[-1]["drops"],
        }

    def missed(self, figures: Mapping[str, float], options: harness.Options) -> list[str]:
        """See `Check.missed`."""
        short = options.end_time < 5.5 / rate()  # its waves may not have grown yet
        known = {name: figures[name] for name in LARGEST if not (short and math.isnan(figures[name]))}
        found = [f"{name} is off by {value:.1e}" for name, value in known.items() if not abs(value) <= LARGEST[name]]
        if not short and figures["drops"] < 2:
            found.append("the jet has not broken")
        return found

    def plot(self, simulation: tp.Simulation, figures: Mapping[str, float], options: harness.Options) -> None:
        """The wave beside that of theory."""
        t, a = self.course(simulation)
        figure = new_figure(6, 4)
        axes = figure.subplots()
        axes.semilogy(1e3 * t, a, color=COLOURS[0], label="measured")
        axes.semilogy(1e3 * t, a[0] * np.cosh(rate() * t), "k--", label=f"theory, {rate():.0f} per second")
        axes.set(xlabel="t [ms]", ylabel="amplitude of the waves [radii]")
        axes.legend()
        save(figure, Path(options.out) / "jet.png")


main = harness.Demo(
    case,
    end_time=0.06,  # [s]
    time_step=1e-4,  # [s]
    frames_per_second=500.0,
    check=BreaksUp(),
    strip=(0.0, 0.03, 0.04, 0.044, 0.048, 0.05, 0.054, 0.06),
)

if __name__ == "__main__":
    harness.command(__name__)
