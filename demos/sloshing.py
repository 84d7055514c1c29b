"""Sloshing: a standing wave of small amplitude on water with a free surface, between walls that slip.

The position-based PFEM of Carvalho & Sanches, "Analysis of two-phase flows using position-based PFEM formulation",
with one fluid and nothing above it. A wave of one half length in the tank is let go from rest. By linear theory
(H. Lamb, Hydrodynamics, 6th ed., 1932, arts. 228 and 348) its amplitude is a exp(-2 nu k^2 t) cos(w t) with

    w^2 = g k tanh(k H),   k = pi / L,

and a small viscosity nu; walls and floor that slip are in no one's way.

    python demos/sloshing.py --spacing 0.05 --end-time 2.4
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import curve_fit
from tipfem.demos import harness

import tipfem as tp

sys.path.insert(0, str(Path(__file__).parent))
import line_figure

# Resolution.
SPACING = 0.025  # [m]
TIME_STEP = 0.01  # [s]
END_TIME = 4.8  # [s]: four periods
FRAMES_PER_SECOND = 25.0

# Fluids: as heavy as water, and so viscous that the wave loses a tenth a period.
FLUID = tp.Fluid("water", density=1000.0, viscosity=5.0)

# Geometry.
LENGTH, DEPTH, HEIGHT = 1.0, 0.5, 0.7  # of the tank, of the water, and of the tank [m]
AMPLITUDE = 0.01  # [m]
GRAVITY = 9.81  # [m/s^2]
WAVE_NUMBER = np.pi / LENGTH  # [1/m]
FREQUENCY = float(np.sqrt(GRAVITY * WAVE_NUMBER * np.tanh(WAVE_NUMBER * DEPTH)))  # [rad/s]
DAMPING = 2 * FLUID.viscosity / FLUID.density * WAVE_NUMBER**2  # [1/s]

# Check
LARGEST_PERIOD_ERROR = 0.02
DAMPING_RATIO = (0.6, 1.6)  # measured over that of theory
LARGEST_VOLUME_ERROR = 0.002


def build(spacing: float = SPACING, **options: Any) -> tp.Case:
    """The case with particles at a distance of ``spacing`` [m]; further options are those of `tipfem.Case`."""
    tank = tp.tank(size=(LENGTH, HEIGHT), spacing=spacing).fill(
        FLUID, where=lambda x: x[:, 1] < DEPTH + AMPLITUDE * np.cos(WAVE_NUMBER * x[:, 0])
    )
    for side in ("left", "right", "bottom"):
        tank.wall(side, slip=True)
    return tp.Case(tank, [FLUID], (0, -GRAVITY), free_surface=True, title="Sloshing", **options)


def amplitude(simulation: tp.Simulation) -> float:
    """Amplitude [m] of the wave cos kx on the surface: 2 / L int cos kx over the water, as the depth has no part."""
    mesh = simulation.mesh
    x = mesh.position[mesh.cells, 0]
    middle = 0.5 * (x + np.roll(x, 1, axis=1))
    return float(2 / LENGTH * mesh.measure @ np.cos(WAVE_NUMBER * middle).mean(axis=1))


# Run


def simulate(arguments: argparse.Namespace) -> tp.Simulation:
    """Build the case, and run it to the end."""
    tp.init(arch=arguments.arch)
    simulation = tp.Simulation(
        build(arguments.spacing),
        out=arguments.out,
        time_step=arguments.time_step,
        output_interval=1.0 / arguments.frames_per_second,
        columns={"amplitude": amplitude},
    )
    harness.run_demo(simulation, arguments.end_time)
    return simulation


# Check


def damped_wave(time: Any, size: float, frequency: float, damping: float, phase: float) -> Any:
    """What the amplitude [m] is fitted to."""
    return size * np.exp(-damping * time) * np.cos(frequency * time + phase)


def validate(history: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Period and damping of a run by least squares, and their ratios to theory's.

    Args:
        history: the simulation's history, one row a step.

    Returns:
        Both and the largest relative change of the volume; what a run of less than one period is too short for is
        left out.
    """
    time, size, volume = (np.array([row[name] for row in history]) for name in ("time", "amplitude", "volume_water"))
    figures = {"volume_error": float(np.abs(volume / (LENGTH * DEPTH) - 1).max())}
    if time[-1] * FREQUENCY >= 2 * np.pi:
        start = (AMPLITUDE, FREQUENCY, DAMPING, 0.0)
        (_, frequency, damping, _), _ = curve_fit(damped_wave, time, size, p0=start)
        figures |= {
            "period": 2 * np.pi / float(frequency),
            "period_over_theory": FREQUENCY / float(frequency),
            "damping": float(damping),
            "damping_over_theory": float(damping) / DAMPING,
        }
    return figures


def check(figures: Mapping[str, float]) -> list[str]:
    """What a run misses of what is expected of it, by its figures from `validate`; an empty list when all is well."""
    missed = []
    if not figures["volume_error"] <= LARGEST_VOLUME_ERROR:
        missed.append(f"volume_error is {figures['volume_error']:.4f}, above {LARGEST_VOLUME_ERROR}")
    if not abs(figures.get("period_over_theory", 1.0) - 1) <= LARGEST_PERIOD_ERROR:
        missed.append(f"period is {figures['period']:.4f} s, more than 2 % off {2 * np.pi / FREQUENCY:.4f} s")
    if not DAMPING_RATIO[0] <= figures.get("damping_over_theory", 1.0) <= DAMPING_RATIO[1]:
        missed.append(f"damping is {figures['damping']:.4f} 1/s, far off {DAMPING:.4f} 1/s")
    return missed


def main(words: Sequence[str] | None = None) -> None:
    """Run the demo with the given command line, or the process's."""
    arguments = harness.demo_arguments(
        __doc__.split("\n\n")[0],
        spacing=SPACING,
        end_time=END_TIME,
        time_step=TIME_STEP,
        out="out/sloshing",
        frames_per_second=FRAMES_PER_SECOND,
        interface=None,
        arguments=words,
    )
    with harness.one_message():
        simulation = simulate(arguments)
    figures = validate(simulation.history)
    time, size = (np.array([row[name] for row in simulation.history]) for name in ("time", "amplitude"))
    theory = damped_wave(time, AMPLITUDE, FREQUENCY, DAMPING, 0.0)
    lines = {"linear theory": (time, theory), f"tipfem, {arguments.spacing * 1e3:g} mm": (time, size)}
    harness.finish_demo(
        simulation,
        arguments,
        figures,
        check(figures),
        plot=lambda: line_figure.plot_lines(
            arguments.out / "amplitude.png", lines, "t [s]", "amplitude of the wave [m]"
        ),
    )


if __name__ == "__main__":
    main()
