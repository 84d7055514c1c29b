"""Dam break of water in air, in a closed tank.

The case of section 4.2 of Carvalho & Sanches, "Analysis of two-phase flows using position-based PFEM
formulation": a column of water collapses under gravity and runs along the floor of a tank full of air.
The front is compared with the experiments of Martin & Moyce (1952) and Koshizuka & Oka (1996), the
height of the column with Martin & Moyce; sources stand on top of the files in demos/data.

    python demos/dam_break.py --spacing 0.01 --end-time 0.3

With ``--air-spacing`` particles stand farther apart in the air, the farther from the water: as good a front, for a part
of the time.

    python demos/dam_break.py --spacing 0.002 --air-spacing 0.02
"""

from __future__ import annotations

import argparse
import csv
import json
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

# Resolution: 5 mm is the coarser of the paper's two.
SPACING = 0.005  # [m]
TIME_STEP = 1.2e-3  # [s]
LARGEST_MOVE = 0.8  # of a particle in a step, in spacings; more than 0.5 where no element is crushed
END_TIME = 0.4  # [s]
FRAMES_PER_SECOND = 250.0  # of simulated time; at 25 pictures a second the movie is ten times slower
SHOWN = (0.0, 0.1, 0.2, 0.25, 0.3, 0.4, 0.6, 1.0)  # side by side in strip.png [s]

# Fluids, at 20 degrees Celsius.
WATER = tp.Fluid("water", density=998.2, viscosity=1.002e-3)
AIR = tp.Fluid("air", density=1.204, viscosity=1.825e-5)

# Geometry.
TANK = (0.584, 0.584)  # [m]
COLUMN = (0.146, 0.292)  # width and height [m]
GRAVITY = 9.81  # [m/s^2]
# Where the column's height is read off, from the left wall [m]. No-slip walls keep a film of water
# a particle wide and drops that stick to it; this is far enough from them, and the surface is flat there.
GAUGE = 0.15 * COLUMN[0]

# Check: the largest figures that a run may show. The coarser the mesh, the wider the margin.
LARGEST_RMS = 0.04  # of dZ/Z against Martin & Moyce, up to 5 mm; 0.05 above
SLOPE = 1.32  # dZ/dT of Martin & Moyce over their readings with 1.43 <= T <= 3.33
LARGEST_SLOPE_ERROR = 0.10
LARGEST_HEIGHT_ERROR = 0.05
LARGEST_VOLUME_ERROR = 0.02  # up to 10 mm; 0.05 above


def build(spacing: float = SPACING, air_spacing: float | None = None, **options: Any) -> tp.Case:
    """The case.

    Args:
        spacing: distance of the particles [m].
        air_spacing: the same in the air, far from the water [m]; by default no other than in the water.
        options: further ones of `tipfem.Case`.
    """
    if air_spacing:
        options.setdefault("grading", tp.Grading({AIR.name: air_spacing}))
    particles = tp.tank(size=TANK, spacing=spacing).fill(AIR).fill(WATER, box=((0, 0), COLUMN))
    options.setdefault("numerics", tp.Numerics(largest_move=LARGEST_MOVE))
    return tp.Case(particles, fluids=[WATER, AIR], gravity=(0, -GRAVITY), title="Dam break of water in air", **options)


def front(simulation: tp.Simulation) -> float:
    """Largest x of the water [m], at the middle of the edges that join it to the air."""
    return probes.extent(simulation.mesh, simulation.particles.fluid, 0, axis=0)


def column_height(simulation: tp.Simulation) -> float:
    """Depth of the water at the gauge near the left wall [m]."""
    return probes.depth(simulation.mesh, simulation.particles.fluid, 0, GAUGE)


def simulate(arguments: argparse.Namespace) -> tp.Simulation:
    """Build the case, and run it to the end."""
    tp.init(arch=arguments.arch)
    simulation = tp.Simulation(
        build(arguments.spacing, arguments.air_spacing, interface=arguments.interface),
        out=arguments.out,
        time_step=arguments.time_step,
        output_interval=1.0 / arguments.frames_per_second,
        columns={"front": front, "column_height": column_height},
    )
    harness.run_demo(simulation, arguments.end_time)
    return simulation


def front_slope(time: np.ndarray, front: np.ndarray) -> float:
    """Speed of the front, dZ/dT by least squares over all steps with 1.43 <= T <= 3.0, T on the run's clock.

    Args:
        time: (K,) [s].
        front: (K,) [m].

    Returns:
        The slope; NaN when the run does not reach T = 3.
    """
    scaled = time * np.sqrt(2 * GRAVITY / COLUMN[0])
    window = (scaled >= 1.43) & (scaled <= 3.0)
    if not window.any() or scaled[-1] < 3.0:
        return float("nan")
    return float(np.polyfit(scaled[window], front[window] / COLUMN[0], 1)[0])


def validate(history: Sequence[Mapping[str, float]]) -> dict[str, Any]:
    """Figures of a run against the experiments.

    Args:
        history: the simulation's history, one row a step.

    Returns:
        RMS of the front with the time shift that was used; the front's slope on the run's clock, and on the
        experiment's (shifted, at the times of its readings) beside the experiment's own; RMS of the height;
        the largest relative change of the water's volume. What the run is too short for is left out.
    """
    time, front, height, water = (
        np.array([row[name] for row in history]) for name in ("time", "front", "column_height", "volume_water")
    )
    figures: dict[str, Any] = {"volume_error": float(np.abs(water / (COLUMN[0] * COLUMN[1]) - 1).max())}
    if time[-1] * np.sqrt(2 * GRAVITY / COLUMN[0]) > 1.5:
        reached = time <= 3.35 / np.sqrt(2 * GRAVITY / COLUMN[0])
        compared = experiments.compare_front(time[reached], front[reached], COLUMN[0], GRAVITY)
        figures |= {
            "front_rms": compared.rms,
            "front_shift": compared.shift,
            "front_slope_shifted": compared.slope,
            "front_slope_experiment": compared.slope_experiment,
        }
        if np.isfinite(slope := front_slope(time, front)):
            figures["front_slope"] = slope
        figures["height_rms"] = experiments.compare_height(time, height, COLUMN[1], COLUMN[0], GRAVITY).rms
    return figures


def check(figures: Mapping[str, Any], spacing: float) -> list[str]:
    """What a run misses of what is expected of it; an empty list when all is well.

    Args:
        figures: from `validate`.
        spacing: of the run [m].
    """
    fine = spacing <= 1.01 * SPACING
    limits = {"front_rms": LARGEST_RMS if fine else 0.05, "volume_error": LARGEST_VOLUME_ERROR}
    if spacing > 2.02 * SPACING:
        limits["volume_error"] = 0.05
    if fine:
        limits["height_rms"] = LARGEST_HEIGHT_ERROR
    missed = harness.above(figures, limits)
    if fine and abs(figures.get("front_slope", SLOPE) / SLOPE - 1) > LARGEST_SLOPE_ERROR:
        missed.append(f"front_slope is {figures['front_slope']:.3f}, more than 10 % off {SLOPE}")
    return missed


def fronts_of(history: Sequence[Mapping[str, float]]) -> tuple[np.ndarray, np.ndarray]:
    """Times (K,) [s] and fronts (K,) [m] of a history."""
    time, position = (np.array([row[name] for row in history]) for name in ("time", "front"))
    return time, position


def name_of(spacing: float, graded: bool) -> str:
    """What a run with particles at a distance of ``spacing`` [m] is called in figures."""
    return f"tipfem, {spacing * 1e3:g} mm" + (" graded" if graded else "")


def read_run(folder: Path) -> tuple[float, bool, list[dict[str, float]]]:
    """Spacing [m], whether it was graded, and history of a finished run of this demo.

    Raises:
        ValueError: the folder holds none.
    """
    try:
        summary = json.loads((folder / "summary.json").read_text("utf-8"))
        spacing, graded = float(summary["spacing"]), summary.get("grading") is not None
        with (folder / "history.csv").open(encoding="utf-8", newline="") as file:
            rows = [{name: float(value) for name, value in row.items()} for row in csv.DictReader(file)]
        fronts_of(rows)
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ValueError(f"{folder}: no finished run of the dam break: {type(error).__name__}: {error}") from error
    return spacing, graded, rows


def compare(folders: Sequence[Path], out: Path) -> None:
    """Draw the fronts of finished runs in one figure, ``out``/fronts.png, and print their figures.

    Raises:
        ValueError: a folder holds no such run.
    """
    runs, shift = {}, 0.0
    for spacing, graded, history in sorted((read_run(folder) for folder in folders), key=lambda run: -run[0]):
        label = name_of(spacing, graded)
        while label in runs:
            label += "'"
        figures = validate(history)
        runs[label], shift = fronts_of(history), figures.get("front_shift", shift)
        figures["volume_error"] = max(figures["volume_error"], 1e-9)  # the file has nine digits
        print(f"{label}: " + ", ".join(f"{name} {value:.4g}" for name, value in figures.items()))
    # Of the experiment's clock there is one: that of the finest run.
    path = experiments.plot_front(out / "fronts.png", runs, COLUMN[0], GRAVITY, shift=shift)
    print(f"results: {path.resolve()}")


def main(words: Sequence[str] | None = None) -> None:
    """Run the demo with the given command line, or the process's."""
    arguments = harness.demo_arguments(
        __doc__.split("\n\n")[0],
        spacing=SPACING,
        end_time=END_TIME,
        time_step=TIME_STEP,
        out="out/dam_break",
        frames_per_second=FRAMES_PER_SECOND,
        further=_own_options,
        arguments=words,
    )
    with harness.one_message():
        if arguments.compare:
            compare(arguments.compare, arguments.out)
            return
        simulation = simulate(arguments)
    figures = validate(simulation.history)
    label = name_of(arguments.spacing, arguments.air_spacing is not None)
    harness.finish_demo(
        simulation,
        arguments,
        figures,
        check(figures, arguments.spacing),
        plot=lambda: experiments.plot_front(
            arguments.out / "front.png",
            {label: fronts_of(simulation.history)},
            COLUMN[0],
            GRAVITY,
            shift=figures.get("front_shift", 0.0),
        ),
        strip=[time for time in SHOWN if time <= arguments.end_time],
    )


def _own_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--air-spacing",
        type=harness.positive,
        metavar="H",
        help="distance between particles in the air, far from the water [m]; by default that of all others",
    )
    parser.add_argument(
        "--compare",
        type=Path,
        nargs="+",
        default=[],
        metavar="RUN",
        help="run nothing; draw the fronts of these folders of finished runs in one figure, fronts.png",
    )


if __name__ == "__main__":
    main()
