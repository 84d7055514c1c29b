"""Flows that show what an interface rule does, two simulations of each, stepped side by side.

`run.py` measures them. Both rules of a flow are advanced alternately, a step each, so that whatever else the machine
does slows both down alike.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import tipfem as tp

Array = NDArray[np.float64]
RULES = ("interpolated", "sharp")

# Fluids: density [kg/m^3] and viscosity [Pa s]; the heavier one of a pair first.
WATER = tp.Fluid("water", density=998.2, viscosity=1.002e-3)
AIR = tp.Fluid("air", density=1.204, viscosity=1.825e-5)
GLYCERIN = tp.Fluid("glycerin", density=1261.0, viscosity=1.412)
PAIRS = {"water under air": (WATER, AIR), "glycerin under water": (GLYCERIN, WATER)}
# Two layers so viscous that a wave dies within seconds.
HEAVY = tp.Fluid("heavy", density=1261.0, viscosity=1.0)
LIGHT = tp.Fluid("light", density=960.0, viscosity=1.0)

# Geometry.
GRAVITY = 9.81  # [m/s^2]
REST_TANK = 0.1  # edge [m]
TILT = 10.0  # of gravity against the tank's walls [degrees]
SLOSHING_TANK = 0.2  # edge [m]
SLOPE = 0.1  # of the interface at the start


def rest(pair: str, cells: int, tilt: float, interface: str) -> tp.Case:
    """Two layers that fill half of a square tank each, the interface perpendicular to gravity, on a jittered lattice.

    Args:
        pair: of `PAIRS`.
        cells: spacings along an edge.
        tilt: of gravity against the tank's walls [degrees].
        interface: rule.
    """
    lower, upper = PAIRS[pair]
    angle = np.radians(tilt)
    up = np.array([np.sin(angle), np.cos(angle)])
    filled = tp.tank((REST_TANK, REST_TANK), REST_TANK / cells, jitter=0.2).fill(upper)
    if tilt:
        filled.fill(lower, where=lambda x: (x - REST_TANK / 2) @ up < 0)
    else:
        filled.fill(lower, box=((0, 0), (REST_TANK, REST_TANK / 2)))
    return tp.Case(filled, [lower, upper], tuple(-GRAVITY * up), interface=interface)


def sloshing(cells: int, interface: str) -> tp.Case:
    """Two viscous layers, their interface straight but off the horizontal: it swings back and comes to rest."""
    middle = SLOSHING_TANK / 2
    filled = tp.tank((SLOSHING_TANK, SLOSHING_TANK), SLOSHING_TANK / cells, jitter=0.1).fill(LIGHT)
    filled.fill(HEAVY, where=lambda x: x[:, 1] < middle + SLOPE * (x[:, 0] - middle))
    return tp.Case(filled, [HEAVY, LIGHT], (0, -GRAVITY), interface=interface)


@dataclass
class Run:
    """A simulation and what its steps cost.

    Attributes:
        simulation: at any time.
        seconds: of each step, and of these in remeshing [s].
    """

    simulation: tp.Simulation
    seconds: list[tuple[float, float]] = field(default_factory=list)

    def step(self, until: float) -> None:
        """Advance by one step, not over the time ``until`` [s]."""
        timings = self.simulation.timings
        timings.reset()
        self.simulation.step(until)
        self.seconds.append((timings.seconds["step"], timings.seconds["step/remeshing"]))

    def column(self, name: str) -> Array:
        """One column (K,) of the history."""
        return np.array([row[name] for row in self.simulation.history])

    def cost(self) -> dict[str, float]:
        """Medians of a step's seconds, of those in remeshing and their share; means of Newton and Krylov iterations.

        Medians, for other work on the machine holds up single steps.
        """
        whole, remeshing = np.array(self.seconds).T
        return {
            "steps": len(whole),
            "seconds_a_step": float(np.median(whole)),
            "remeshing_seconds_a_step": float(np.median(remeshing)),
            "other_seconds_a_step": float(np.median(whole - remeshing)),
            "remeshing_share": float(np.median(remeshing / whole)),
            "newton_a_step": float(self.column("newton_iterations").mean()),
            "krylov_a_step": float(self.column("krylov_iterations").mean()),
        }

    def finish(self) -> None:
        """Close the history on disk and write the run's summary."""
        if self.simulation.results:
            self.simulation.results.close()
        self.simulation.write_summary({"status": "complete", "cost": self.cost()})


def started(cases: Mapping[str, tp.Case], out: Path | None, **options: Any) -> dict[str, Run]:
    """A run of each case, rule -> case; results in ``out``/<rule>; options are those of `tipfem.Simulation`."""
    return {
        rule: Run(tp.Simulation(case, None if out is None else out / rule, **options)) for rule, case in cases.items()
    }


def advance(runs: Mapping[str, Run], until: float) -> None:
    """Step runs to a time [s], always the one that is behind.

    Raises:
        SimulationError: a run cannot go on.
    """
    while behind := [run for run in runs.values() if run.simulation.time < until]:
        min(behind, key=lambda run: run.simulation.time).step(until)
