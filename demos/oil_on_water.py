"""Oil on water: a column of two fluids with a free surface collapses.

The position-based PFEM of Carvalho & Sanches, "Analysis of two-phase flows using position-based PFEM formulation",
with both of its kinds of boundary at once: an interface, between water and the oil that floats on it, and free
surfaces, where the alpha-shape ends and pressure is zero. The column is that of their dam break (section 4.2), half of
it oil. Nobody has measured it; what is held is what must be so: each fluid keeps its volume, the oil stays on top until
the water climbs the far wall, energy only falls, and the front comes close to that of water alone (Martin & Moyce 1952;
sources in demos/data), for the oil is nearly as heavy.

    python demos/oil_on_water.py --spacing 0.01 --end-time 0.3
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from tipfem.demos import harness

import tipfem as tp
from tipfem.mesh import probes

sys.path.insert(0, str(Path(__file__).parent))
import experiments
import line_figure

# Resolution.
SPACING = 0.005  # [m]
TIME_STEP = 1e-3  # [s]
END_TIME = 0.5  # [s]
FRAMES_PER_SECOND = 125.0  # of simulated time

# Fluids: water, and an oil like that of sunflowers, at 20 degrees Celsius.
WATER = tp.Fluid("water", density=998.2, viscosity=1.002e-3)
OIL = tp.Fluid("oil", density=920.0, viscosity=0.06)

# Geometry.
TANK = (0.584, 0.4)  # [m]
COLUMN = (0.146, 0.292)  # width and height [m]
LAYER = 0.146  # height of the water [m]
GRAVITY = 9.81  # [m/s^2]

# Check: the largest figures that a run may show. The coarser the mesh, the wider the margin.
LARGEST_VOLUME_ERROR = 0.02  # of each fluid up to 5 mm; 0.04 above
BEFORE_IMPACT = 0.25  # [s]; until then the oil must be on top
LARGEST_GAIN = 0.01  # of energy above that of the start, relative to what potential energy can give
LARGEST_RMS = 0.08  # of dZ/Z against Martin & Moyce


def build(spacing: float = SPACING, **options: Any) -> tp.Case:
    """The case with particles at a distance of ``spacing`` [m]; further options are those of `tipfem.Case`."""
    tank = tp.tank(size=TANK, spacing=spacing)
    tank.fill(WATER, box=((0, 0), (COLUMN[0], LAYER))).fill(OIL, box=((0, LAYER), COLUMN))
    # The layers become thin: what remeshing moves across their interface is given back faster than by default.
    options = {"numerics": tp.Numerics(volume_correction=3.0), "title": "A column of oil and water", **options}
    return tp.Case(tank, [WATER, OIL], (0, -GRAVITY), free_surface=True, **options)


def front(simulation: tp.Simulation) -> float:
    """Largest x of the two fluids [m], drops that fly apart."""
    fluid = np.zeros_like(simulation.particles.fluid)
    return probes.extent(simulation.mesh, fluid, 0, axis=0)


def mean_height(simulation: tp.Simulation, index: int) -> float:
    """Mean height [m] of a fluid over the floor, of what does not fly."""
    mesh, fluid = simulation.mesh, simulation.particles.fluid
    fraction = simulation.interface.fluid_fraction(mesh, fluid, 2)[:, index]
    weight = mesh.measure * fraction
    return float(weight @ mesh.position[mesh.cells, 1].mean(axis=1) / weight.sum())


# Run


def simulate(arguments: argparse.Namespace) -> tp.Simulation:
    """Build the case, and run it to the end."""
    tp.init(arch=arguments.arch)
    simulation = tp.Simulation(
        build(arguments.spacing),
        out=arguments.out,
        time_step=arguments.time_step,
        output_interval=1.0 / arguments.frames_per_second,
        columns={
            "front": front,
            "water_height": lambda s: mean_height(s, 0),
            "oil_height": lambda s: mean_height(s, 1),
        },
    )
    harness.run_demo(simulation, arguments.end_time)
    return simulation


# Check


def validate(history: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Figures of a run.

    Args:
        history: the simulation's history, one row a step.

    Returns:
        Largest relative change of each fluid's volume since the first step; the largest gain of energy since then,
        relative to the start's potential energy; the lowest height of the oil's middle over the water's before the
        impact [m]; and the front's RMS and shift against Martin & Moyce, if the run is long enough.
    """
    time, place = (np.array([row[name] for row in history]) for name in ("time", "front"))
    energy = np.array([row["kinetic_energy"] + row["potential_energy"] for row in history])
    figures = {}
    for name in ("water", "oil"):
        volume = np.array([row[f"volume_{name}"] for row in history])
        figures[f"volume_error_{name}"] = float(np.abs(volume / volume[0] - 1).max())
    figures["energy_gain"] = float((energy / energy[0]).max() - 1)
    figures["oil_over_water"] = min(
        row["oil_height"] - row["water_height"] for row in history if row["time"] <= BEFORE_IMPACT
    )
    if time[-1] * np.sqrt(2 * GRAVITY / COLUMN[0]) > 1.5:
        reached = time <= 3.35 / np.sqrt(2 * GRAVITY / COLUMN[0])
        compared = experiments.compare_front(time[reached], place[reached], COLUMN[0], GRAVITY)
        figures |= {"front_rms": compared.rms, "front_shift": compared.shift}
    return figures


def check(figures: Mapping[str, float], spacing: float) -> list[str]:
    """What a run misses of what is expected of it; an empty list when all is well.

    Args:
        figures: from `validate`.
        spacing: of the run [m].
    """
    largest = LARGEST_VOLUME_ERROR if spacing <= 1.01 * SPACING else 0.04
    limits = {
        "volume_error_water": largest,
        "volume_error_oil": largest,
        "energy_gain": LARGEST_GAIN,
        "front_rms": LARGEST_RMS,
    }
    missed = harness.above(figures, limits)
    if not figures["oil_over_water"] > 0:
        missed.append(f"oil_over_water is {figures['oil_over_water']:.4f} m: the oil has sunk")
    return missed


def main(words: Sequence[str] | None = None) -> None:
    """Run the demo with the given command line, or the process's."""
    arguments = harness.demo_arguments(
        __doc__.split("\n\n")[0],
        spacing=SPACING,
        end_time=END_TIME,
        time_step=TIME_STEP,
        out="out/oil_on_water",
        frames_per_second=FRAMES_PER_SECOND,
        interface=None,
        arguments=words,
    )
    with harness.one_message():
        simulation = simulate(arguments)
    figures = validate(simulation.history)
    time, water, oil = (
        np.array([row[name] for row in simulation.history]) for name in ("time", "water_height", "oil_height")
    )
    harness.finish_demo(
        simulation,
        arguments,
        figures,
        check(figures, arguments.spacing),
        plot=lambda: line_figure.plot_lines(
            arguments.out / "heights.png",
            {"water": (time, water), "oil": (time, oil)},
            "t [s]",
            "mean height over the floor [m]",
        ),
    )


if __name__ == "__main__":
    main()
