"""What the dam break against an obstacle measures, and the figures of interFoam that it is compared with."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from tipfem.demos import harness
from tipfem.demos.support.figures import LINES, new_figure, save

import tipfem as tp

BLOCK = 0.292  # x of the block's left side [m]
WALL = 0.584  # x of the right wall [m]
HEIGHT = 0.048  # of the block [m]
# interFoam of OpenFOAM 1912, the tutorial damBreak (laminar, no-slip, its top open); the water ends where alpha is 1/2,
# between cells. Times at which it reaches the block and the right wall with cells of 3.1 mm [s], and the largest height
# of the water that has passed x = 0.25 m at two times with cells of 6.3 mm [m]: the jet is a sheet about as thin as
# that, and in interFoam it grows with finer cells, to 0.263 and 0.421 m at 3.1 mm.
REFERENCE = {"block": 0.1258, "wall": 0.3333, "jet_0.20": 0.243, "jet_0.25": 0.375}
# The largest deviations from it that a run may show, at 6 mm and less, relative.
LIMITS = {"block": 0.03, "wall": 0.05, "jet_0.20": 0.20, "jet_0.25": 0.20}
# Time that a run must reach to be judged by a figure [s].
NEEDED = {"jet_0.20": 0.20, "jet_0.25": 0.25}
NEEDED |= {name: (1 + LIMITS[name]) * REFERENCE[name] for name in ("block", "wall")}
FINE = 0.0065  # [m]
LARGEST_VOLUME_ERROR = 1e-6  # of the water


def _of_water(simulation: tp.Simulation) -> np.ndarray:
    """Positions (K, 2) of the water's particles [m]."""
    mesh = simulation.mesh
    if mesh.fluid is None:
        return np.asarray(simulation.particles.position[simulation.particles.fluid == 0])
    return np.asarray(mesh.position[np.unique(mesh.cells[mesh.fluid == 0])])


def front(simulation: tp.Simulation) -> float:
    """The largest x of the water [m]."""
    return float(_of_water(simulation)[:, 0].max())


def jet(simulation: tp.Simulation) -> float:
    """The largest height of the water that has passed x = 0.25 m; 0 before [m]."""
    x = _of_water(simulation)
    return float(x[x[:, 0] > 0.25, 1].max(initial=0.0))


def first_time(history: Sequence[Mapping[str, float]], x: float) -> float:
    """When the front reaches x [m], linear between steps; NaN if it does not [s]."""
    time, place = (np.array([row[name] for row in history]) for name in ("time", "front"))
    beyond = np.flatnonzero(place >= x - 1e-9)
    if not len(beyond):
        return math.nan
    k = int(beyond[0])
    return float(np.interp(x, place[max(k - 1, 0) : k + 1], time[max(k - 1, 0) : k + 1]))


@dataclass
class Obstacle(harness.Check):
    """The water meets the block and the right wall, and is thrown up, as in interFoam."""

    start: float = 0.0

    def columns(self) -> dict[str, harness.Probe]:
        """The front, and the height of the jet."""
        return {"front": front, "jet": jet}

    def begin(self, simulation: tp.Simulation, options: harness.Options) -> None:
        """Keep the volume of the water."""
        self.start = simulation.volume("water")

    def figures(self, simulation: tp.Simulation) -> dict[str, float]:
        """Times and heights, and the change of the water's volume."""
        history = simulation.history
        time, height = (np.array([row[name] for row in history]) for name in ("time", "jet"))
        found = {"block": first_time(history, BLOCK), "wall": first_time(history, WALL)}
        for at in (0.20, 0.25):
            found[f"jet_{at:.2f}"] = float(np.interp(at, time, height)) if time[-1] >= at else math.nan
        return {**found, "volume_error": simulation.volume("water") / self.start - 1}

    def missed(self, figures: Mapping[str, float], options: harness.Options) -> list[str]:
        """What is farther from interFoam than allowed."""
        missed = []
        if not abs(figures["volume_error"]) <= LARGEST_VOLUME_ERROR and options.interface == "sharp":
            missed.append(f"the water's volume changes by {figures['volume_error']:.1e}")
        if options.spacing <= FINE:
            for name, limit in LIMITS.items():
                error = figures[name] / REFERENCE[name] - 1
                if math.isnan(error) and options.end_time < NEEDED[name]:
                    continue
                if not abs(error) <= limit:
                    missed.append(f"{name} is {figures[name]:.4g}, {error:+.1%} of interFoam's {REFERENCE[name]:.4g}")
        return missed

    def plot(self, simulation: tp.Simulation, figures: Mapping[str, float], options: harness.Options) -> None:
        """Front and height over time."""
        figure = new_figure(7.0, 4.0)
        axes = figure.add_subplot()
        time = [row["time"] for row in simulation.history]
        for name, (colour, dash) in zip(("front", "jet"), LINES[1:], strict=False):
            axes.plot(time, [row[name] for row in simulation.history], color=colour, linestyle=dash, label=name)
        axes.plot([REFERENCE["block"], REFERENCE["wall"]], [BLOCK, WALL], "ko", label="interFoam, 3 mm")
        axes.plot([0.20, 0.25], [REFERENCE["jet_0.20"], REFERENCE["jet_0.25"]], "ko")
        axes.set_xlabel("t [s]")
        axes.set_ylabel("x of the front, y of the jet [m]")
        axes.grid(alpha=0.3)
        axes.legend()
        save(figure, Path(options.out) / "obstacle.png")
