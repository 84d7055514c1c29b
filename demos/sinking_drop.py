"""A drop of glycerin falls through air into water, and sinks to the floor: three fluids.

No case of Carvalho & Sanches, "Analysis of two-phase flows using position-based PFEM formulation", but
one that their method takes as it is: properties belong to the fluids, and there may be any number of
them. The drop's surface is at first one between glycerin and air, and then one between glycerin and
water. Nothing is compared with measurements; the check is on volumes, and on where the fluids end.

    python demos/sinking_drop.py --spacing 0.005
"""

from __future__ import annotations

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
SPACING = 0.0025  # [m]
TIME_STEP = 1e-3  # [s]
END_TIME = 2.0  # [s]
FRAMES_PER_SECOND = 50.0  # of simulated time; at 25 pictures a second the movie is two times slower
SHOWN = (0.0, 0.06, 0.1, 0.14, 0.2, 0.3, 0.5, END_TIME)  # side by side in strip.png [s]

# Fluids, at 20 degrees Celsius.
GLYCERIN = tp.Fluid("glycerin", density=1261.0, viscosity=1.412)
WATER = tp.Fluid("water", density=998.2, viscosity=1.002e-3)
AIR = tp.Fluid("air", density=1.204, viscosity=1.825e-5)
FLUIDS = [GLYCERIN, WATER, AIR]

# Geometry.
TANK = (0.1, 0.12)  # [m]
DEPTH = 0.06  # of the water [m]
RADIUS = 0.0125  # of the drop [m]
CENTRE = (0.05, 0.09)  # [m]
GRAVITY = 9.81  # [m/s^2]

# Check: the largest figures that a run may show.
LARGEST_VOLUME_ERROR = 0.01  # of each fluid
LARGEST_SPEED = 8.0  # at any time, of the air that gives way too; the drop meets the water at 0.6 [m/s]
SUNK_AFTER = 1.0  # [s]; from then on:
LARGEST_DRY = 0.02  # part of the glycerin that is above the water's middle height
HIGHEST_CENTRE = 0.5  # of the drop's centre of mass, in water depths: it lies on the floor


def build(spacing: float = SPACING, **options: Any) -> tp.Case:
    """The case with particles at a distance of ``spacing`` [m]; further options are those of `tipfem.Case`."""
    tank = tp.tank(TANK, spacing).fill(AIR).fill(WATER, box=((0, 0), (TANK[0], DEPTH)))
    tank.fill(GLYCERIN, disc=(CENTRE, RADIUS))
    return tp.Case(tank, FLUIDS, (0, -GRAVITY), title="Glycerin falls through air into water", **options)


def centre_height(simulation: tp.Simulation) -> float:
    """Height of the glycerin's centre of mass [m]."""
    share, middle = glycerin(simulation)
    return float(share @ middle / share.sum())


def glycerin(simulation: tp.Simulation) -> tuple[np.ndarray, np.ndarray]:
    """Glycerin in each element (M,) [m^2], and the height (M,) of the element's middle [m]."""
    mesh = simulation.mesh
    fraction = simulation.interface.fluid_fraction(mesh, simulation.particles.fluid, len(FLUIDS))
    return fraction[:, 0] * mesh.measure, mesh.position[mesh.cells].mean(axis=1)[:, 1]


def validate(simulation: tp.Simulation, start: Mapping[str, float]) -> dict[str, float]:
    """Figures of a run at its end.

    Args:
        simulation: at its end.
        start: volume of each fluid at the start [m^2].

    Returns:
        Largest relative change of each fluid's volume; largest speed of the run [m/s]; height of the glycerin's
        centre of mass in water depths; part of the glycerin above the water's depth at the start.
    """
    history = simulation.history
    share, middle = glycerin(simulation)
    return {
        **{
            f"volume_error_{name}": max(abs(row[f"volume_{name}"] / volume - 1) for row in history)
            for name, volume in start.items()
        },
        "largest_speed": max(row["max_speed"] for row in history),
        "centre": centre_height(simulation) / DEPTH,
        "dry": float(share[middle > DEPTH].sum() / share.sum()),
    }


def check(figures: Mapping[str, float], end_time: float) -> list[str]:
    """What a run to ``end_time`` [s] misses of what is expected of it; an empty list when all is well."""
    limits = {f"volume_error_{fluid.name}": LARGEST_VOLUME_ERROR for fluid in FLUIDS}
    limits["largest_speed"] = LARGEST_SPEED
    if end_time >= SUNK_AFTER:
        limits |= {"centre": HIGHEST_CENTRE, "dry": LARGEST_DRY}
    return harness.above(figures, limits)


def main(words: Sequence[str] | None = None) -> None:
    """Run the demo with the given command line, or the process's."""
    arguments = harness.demo_arguments(
        __doc__.split("\n\n")[0],
        spacing=SPACING,
        end_time=END_TIME,
        time_step=TIME_STEP,
        out="out/sinking_drop",
        frames_per_second=FRAMES_PER_SECOND,
        arguments=words,
    )
    with harness.one_message():
        tp.init(arch=arguments.arch)
        simulation = tp.Simulation(
            build(arguments.spacing, interface=arguments.interface),
            out=arguments.out,
            time_step=arguments.time_step,
            output_interval=1.0 / arguments.frames_per_second,
            columns={"centre_height": centre_height},
        )
    start = {fluid.name: simulation.volume(fluid.name) for fluid in FLUIDS}
    harness.run_demo(simulation, arguments.end_time)
    figures = validate(simulation, start)
    harness.finish_demo(
        simulation,
        arguments,
        figures,
        check(figures, arguments.end_time),
        plot=lambda: profiles.plot_drop(arguments.out / "drop.png", simulation.history, start, DEPTH),
        strip=[time for time in SHOWN if time <= arguments.end_time],
    )


if __name__ == "__main__":
    main()
