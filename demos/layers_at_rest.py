"""Layers of fluids at rest in a closed tank: pressure against the analytic one.

The first case of section 4.1 of Carvalho & Sanches, "Analysis of two-phase flows using position-based
PFEM formulation": glycerin below, water above. Pressure is to be hydrostatic from the first step on, and
to stay so. Water under air, whose densities are further apart, and three layers are there too.

    python demos/layers_at_rest.py --layers water-air --interface interpolated
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

sys.path.insert(0, str(Path(__file__).parent))
import profiles

# Resolution.
SPACING = 0.005  # [m]
TIME_STEP = 5e-3  # [s]
END_TIME = 1.0  # [s]
FRAMES_PER_SECOND = 10.0  # of simulated time

# Fluids, at 20 degrees Celsius; layers from the floor up.
GLYCERIN = tp.Fluid("glycerin", density=1261.0, viscosity=1.412)
WATER = tp.Fluid("water", density=998.2, viscosity=1.002e-3)
AIR = tp.Fluid("air", density=1.204, viscosity=1.825e-5)
LAYERS = {"glycerin-water": (GLYCERIN, WATER), "water-air": (WATER, AIR), "three": (GLYCERIN, WATER, AIR)}
DEFAULT_LAYERS = "glycerin-water"

# Geometry.
EDGE = 0.1  # of the square tank [m]; the layers share its height evenly
GRAVITY = 9.81  # [m/s^2]
JITTER = 0.2  # of the particles inside, in spacings: a regular lattice would be too easy

# Check: the largest figures that a run may show; pressure's error is a part of the largest pressure.
LARGEST_PRESSURE_ERROR = 0.01
LARGEST_VOLUME_ERROR = 0.01
LARGEST_REST_SPEED = 1e-6  # with the sharp interface [m/s]


def fluids_of(layers: str) -> list[tuple[tp.Fluid, float]]:
    """(Fluid, thickness [m]) from the floor up."""
    fluids = LAYERS[layers]
    return [(fluid, EDGE / len(fluids)) for fluid in fluids]


def build(spacing: float = SPACING, layers: str = DEFAULT_LAYERS, **options: Any) -> tp.Case:
    """The case with particles at a distance of ``spacing`` [m]; further options are those of `tipfem.Case`."""
    tank = tp.tank((EDGE, EDGE), spacing, jitter=JITTER).fill(LAYERS[layers][-1])
    floor = 0.0
    for fluid, thickness in fluids_of(layers)[:-1]:
        tank.fill(fluid, box=((0.0, floor), (EDGE, floor + thickness)))
        floor += thickness
    title = " under ".join(fluid.name for fluid in LAYERS[layers]) + ", at rest"
    return tp.Case(tank, list(LAYERS[layers]), (0, -GRAVITY), title=title[0].upper() + title[1:], **options)


def validate(history: Sequence[Mapping[str, float]], layers: str) -> dict[str, float]:
    """Errors of pressure after the first step and in the last, the largest of all steps; the largest relative change
    of a fluid's volume; the largest speed over the run's second half [m/s]."""
    error, time, speed = (np.array([row[name] for row in history]) for name in ("pressure_error", "time", "max_speed"))
    change = [
        np.abs(np.array([row[f"volume_{fluid.name}"] for row in history]) / (EDGE * thickness) - 1).max()
        for fluid, thickness in fluids_of(layers)
    ]
    return {
        "pressure_error_first_step": float(error[0]),
        "pressure_error_end": float(error[-1]),
        "pressure_error_median": float(np.median(error)),
        "pressure_error_largest": float(error.max()),
        "volume_error": float(max(change)),
        "rest_speed": float(speed[time >= time[-1] / 2].max()),
    }


def check(figures: Mapping[str, float], interface: str) -> list[str]:
    """What a run misses of what is expected of it; an empty list when all is well."""
    limits = {
        "pressure_error_first_step": LARGEST_PRESSURE_ERROR,
        "pressure_error_end": LARGEST_PRESSURE_ERROR,
        "volume_error": LARGEST_VOLUME_ERROR,
    }
    if interface == "sharp":
        limits["rest_speed"] = LARGEST_REST_SPEED
    return harness.above(figures, limits)


def main(words: Sequence[str] | None = None) -> None:
    """Run the demo with the given command line, or the process's."""
    arguments = harness.demo_arguments(
        __doc__.split("\n\n")[0],
        spacing=SPACING,
        end_time=END_TIME,
        time_step=TIME_STEP,
        out="out/layers_at_rest",
        frames_per_second=FRAMES_PER_SECOND,
        further=_own_options,
        arguments=words,
    )
    layers = arguments.layers
    with harness.one_message():
        tp.init(arch=arguments.arch)
        simulation = tp.Simulation(
            build(arguments.spacing, layers, interface=arguments.interface),
            out=arguments.out,
            time_step=arguments.time_step,
            output_interval=1.0 / arguments.frames_per_second,
            columns={"pressure_error": profiles.PressureWatch(fluids_of(layers), GRAVITY, since=arguments.end_time)},
        )
        first = tp.Simulation(simulation.case, time_step=arguments.time_step)
        first.step()
    harness.run_demo(simulation, arguments.end_time)
    figures = validate(simulation.history, layers)
    harness.finish_demo(
        simulation,
        arguments,
        figures,
        check(figures, arguments.interface),
        plot=lambda: profiles.plot_layers(
            arguments.out / "layers.png",
            {"after the first step": first, f"t = {simulation.time:g} s": simulation},
            fluids_of(layers),
            GRAVITY,
        ),
    )


def _own_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--layers", choices=list(LAYERS), default=DEFAULT_LAYERS, help="the fluids, from the floor up")


if __name__ == "__main__":
    main()
