"""Period and damping of a standing wave against linear theory.

A wave of one half length in a tank of length L, on water of depth H and kinematic viscosity nu, has the amplitude
a exp(-2 nu k^2 t) cos(w t) with w^2 = g k tanh(k H) and k = pi / L: H. Lamb, Hydrodynamics, 6th ed., 1932, arts. 228
(period) and 348 (damping, for small viscosity, between walls that slip).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import curve_fit
from tipfem.demos import harness
from tipfem.demos.support.figures import plot_lines

import tipfem as tp

Array = NDArray[np.float64]

LARGEST_PERIOD_ERROR = 0.02
DAMPING_RATIO = (0.6, 1.6)  # measured over that of theory
LARGEST_VOLUME_ERROR = 0.002


def damped_wave(time: Array, size: float, frequency: float, damping: float, phase: float) -> Array:
    """Amplitude (K,) [m] of a damped wave at times (K,) [s]: what the measured one is fitted to."""
    return np.asarray(size * np.exp(-damping * time) * np.cos(frequency * time + phase))


@dataclass(frozen=True)
class StandingWave(harness.Check):
    """Period and damping of a standing wave, and the volume of the water.

    Attributes:
        fluid: the water.
        length: of the tank [m].
        depth: of the water at rest [m].
        amplitude: of the wave at the start [m].
        gravity: [m/s^2].
    """

    fluid: tp.Fluid
    length: float
    depth: float
    amplitude: float
    gravity: float = 9.81

    @property
    def wave_number(self) -> float:
        """k [1/m]."""
        return float(np.pi / self.length)

    @property
    def frequency(self) -> float:
        """w [rad/s]."""
        return float(np.sqrt(self.gravity * self.wave_number * np.tanh(self.wave_number * self.depth)))

    @property
    def damping(self) -> float:
        """2 nu k^2 [1/s]."""
        return 2 * self.fluid.viscosity / self.fluid.density * self.wave_number**2

    def measured_amplitude(self, simulation: tp.Simulation) -> float:
        """Amplitude [m] of cos kx on the surface: 2 / L times the integral of cos kx over the water.

        The depth at rest has no part in it.
        """
        mesh = simulation.mesh
        x = mesh.position[mesh.cells, 0]
        middle = 0.5 * (x + np.roll(x, 1, axis=1))
        return float(2 / self.length * mesh.measure @ np.cos(self.wave_number * middle).mean(axis=1))

    def columns(self) -> dict[str, harness.Probe]:
        """The amplitude."""
        return {"amplitude": self.measured_amplitude}

    def figures(self, simulation: tp.Simulation) -> dict[str, float]:
        """See `figures_of`."""
        return self.figures_of(simulation.history)

    def figures_of(self, history: Sequence[Mapping[str, float]]) -> dict[str, float]:
        """Period and damping of a run by least squares, and their ratios to theory's.

        Args:
            history: the simulation's history, one row per step.

        Returns:
            Both, and the largest relative change of the volume; what a run of less than one period is too short for
            is left out.
        """
        time, size, volume = (
            np.array([row[name] for row in history]) for name in ("time", "amplitude", f"volume_{self.fluid.name}")
        )
        figures = {"volume_error": float(np.abs(volume / (self.length * self.depth) - 1).max())}
        if time[-1] * self.frequency >= 2 * np.pi:
            start = (self.amplitude, self.frequency, self.damping, 0.0)
            (_, frequency, damping, _), _ = curve_fit(damped_wave, time, size, p0=start)
            figures |= {
                "period": 2 * np.pi / float(frequency),
                "period_over_theory": self.frequency / float(frequency),
                "damping": float(damping),
                "damping_over_theory": float(damping) / self.damping,
            }
        return figures

    def missed(self, figures: Mapping[str, float], options: harness.Options) -> list[str]:
        """What a run misses of what is expected of it."""
        missed = harness.above(figures, {"volume_error": LARGEST_VOLUME_ERROR})
        if not abs(figures.get("period_over_theory", 1.0) - 1) <= LARGEST_PERIOD_ERROR:
            missed.append(f"period is {figures['period']:.4f} s, more than 2 % off {2 * np.pi / self.frequency:.4f} s")
        if not DAMPING_RATIO[0] <= figures.get("damping_over_theory", 1.0) <= DAMPING_RATIO[1]:
            missed.append(f"damping is {figures['damping']:.4f} 1/s, far off {self.damping:.4f} 1/s")
        return missed

    def plot(self, simulation: tp.Simulation, figures: Mapping[str, float], options: harness.Options) -> None:
        """amplitude.png: the amplitude over time, beside theory's."""
        time, size = (np.array([row[name] for row in simulation.history]) for name in ("time", "amplitude"))
        theory = damped_wave(time, self.amplitude, self.frequency, self.damping, 0.0)
        lines = {"linear theory": (time, theory), f"tipfem, {options.spacing * 1e3:g} mm": (time, size)}
        plot_lines(Path(options.out) / "amplitude.png", lines, "t [s]", "amplitude of the wave [m]")
