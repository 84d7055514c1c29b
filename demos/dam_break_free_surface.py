"""Dam break of water with a free surface: one fluid, and nothing around it.

The column of section 4.2 of Carvalho & Sanches, "Analysis of two-phase flows using position-based PFEM formulation",
in the same tank, but without the air: where the water ends, pressure is zero (the alpha-shape of their section 3).
The front is compared with the experiments of Martin & Moyce (1952) and Koshizuka & Oka (1996), the height of the
column with Martin & Moyce; sources stand on top of the files in demos/data.

    python demos/dam_break_free_surface.py --spacing 0.01 --end-time 0.3
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
import dam_break
import experiments

# Resolution: 5 mm is the coarser of the paper's two.
SPACING = 0.005  # [m]
TIME_STEP = 1e-3  # [s]
END_TIME = 0.6  # [s]; the splash at the far wall begins at 0.27 s
FRAMES_PER_SECOND = 250.0  # of simulated time; at 25 pictures a second the movie is ten times slower

# Fluids, at 20 degrees Celsius.
WATER = tp.Fluid("water", density=998.2, viscosity=1.002e-3)

# Geometry.
TANK = (0.584, 0.584)  # [m]
COLUMN = (0.146, 0.292)  # width and height [m]
GRAVITY = 9.81  # [m/s^2]
GAUGE = 0.15 * COLUMN[0]  # where the column's height is read off, from the left wall [m]

# Check: the largest figures that a run may show. The coarser the mesh, the wider the margin.
LARGEST_RMS = 0.04  # of dZ/Z against Martin & Moyce, up to 5 mm; 0.06 above
LARGEST_SLOPE_ERROR = 0.10  # of the front's speed dZ/dT
LARGEST_HEIGHT_ERROR = 0.05
LARGEST_VOLUME_ERROR = 0.02  # spray included


def build(spacing: float = SPACING, **options: Any) -> tp.Case:
    """The case with particles at a distance of ``spacing`` [m]; further options are those of `tipfem.Case`."""
    tank = tp.tank(size=TANK, spacing=spacing).fill(WATER, box=((0, 0), COLUMN))
    title = "Dam break of water with a free surface"
    return tp.Case(tank, fluids=[WATER], gravity=(0, -GRAVITY), free_surface=True, title=title, **options)


def front(simulation: tp.Simulation) -> float:
    """Largest x of the water [m], drops that fly apart."""
    return probes.extent(simulation.mesh, simulation.particles.fluid, 0, axis=0)


def column_height(simulation: tp.Simulation) -> float:
    """Depth of the water at the gauge near the left wall [m]."""
    return probes.depth(simulation.mesh, simulation.particles.fluid, 0, GAUGE)


def spray(simulation: tp.Simulation) -> float:
    """Volume of the water that flies as single particles [m^2]."""
    surface = simulation.mesh.surface
    return float(surface.volume.sum()) if surface else 0.0


# Run


def simulate(arguments: argparse.Namespace) -> tp.Simulation:
    """Build the case, and run it to the end."""
    tp.init(arch=arguments.arch)
    simulation = tp.Simulation(
        build(arguments.spacing),
        out=arguments.out,
        time_step=arguments.time_step,
        output_interval=1.0 / arguments.frames_per_second,
        columns={"front": front, "column_height": column_height, "spray": spray},
    )
    harness.run_demo(simulation, arguments.end_time)
    return simulation


# Check


def validate(history: Sequence[Mapping[str, float]]) -> dict[str, Any]:
    """Figures of a run against the experiments; see `dam_break.validate`.

    Beside them, with the sign of a gain, the change of the water's volume at the end, what of it flies as spray then,
    and what the source in the continuity equation has added over the run, all relative to the column's.
    """
    figures = dam_break.validate(history)
    column, last = COLUMN[0] * COLUMN[1], history[-1]
    figures["volume_change_at_end"] = last["volume_water"] / column - 1
    figures["spray_at_end"] = last.get("spray", 0.0) / column
    figures["volume_from_source"] = float(np.sum([row.get("source_volume_water", 0.0) for row in history])) / column
    return figures


def check(figures: Mapping[str, Any], spacing: float) -> list[str]:
    """What a run misses of what is expected of it; an empty list when all is well.

    Args:
        figures: from `validate`.
        spacing: of the run [m].
    """
    fine = spacing <= 1.01 * SPACING
    limits = {"front_rms": LARGEST_RMS if fine else 0.06, "volume_error": LARGEST_VOLUME_ERROR}
    if fine:
        limits["height_rms"] = LARGEST_HEIGHT_ERROR
    missed = harness.above(figures, limits)
    slope = figures.get("front_slope", dam_break.SLOPE)
    if fine and abs(slope / dam_break.SLOPE - 1) > LARGEST_SLOPE_ERROR:
        missed.append(f"front_slope is {slope:.3f}, more than 10 % off {dam_break.SLOPE}")
    return missed


def main(words: Sequence[str] | None = None) -> None:
    """Run the demo with the given command line, or the process's."""
    arguments = harness.demo_arguments(
        __doc__.split("\n\n")[0],
        spacing=SPACING,
        end_time=END_TIME,
        time_step=TIME_STEP,
        out="out/dam_break_free_surface",
        frames_per_second=FRAMES_PER_SECOND,
        interface=None,
        arguments=words,
    )
    with harness.one_message():
        simulation = simulate(arguments)
    figures = validate(simulation.history)
    front = dam_break.fronts_of(simulation.history)
    harness.finish_demo(
        simulation,
        arguments,
        figures,
        check(figures, arguments.spacing),
        plot=lambda: experiments.plot_front(
            arguments.out / "front.png",
            {f"tipfem, free surface, {arguments.spacing * 1e3:g} mm": front},
            COLUMN[0],
            GRAVITY,
            shift=figures.get("front_shift", 0.0),
        ),
    )


if __name__ == "__main__":
    main()
