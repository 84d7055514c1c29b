"""The check of a drop that falls into a pool."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from scipy.optimize import brentq
from tipfem.demos.harness import Check, Options

import tipfem as tp
from tipfem.physics.surface_tension.edges import TensionEdges

LARGEST_VOLUME_ERROR, LARGEST_RISE = 1e-9, 1e-3  # of a fluid's volume; of the drop's energy in a step
SHALLOWEST, OPEN = 1.5, 0.009  # the crater is so many radii of the drop deep from this time on [s]


class Crater(Check):
    """Volumes, energy and depth of the crater of the last disc that a case fills, which falls into a pool.

    Args:
        case: of water and air, whose last two fills are the pool and the drop.
    """

    def __init__(self, case: tp.Case) -> None:
        pool, drop = case.tank.regions[-2:]
        (self._centre, self._radius), self._level = drop.given["disc"], float(np.asarray(pool.given["box"])[1][1])
        self._sigma = float(next(iter(case.surface_tension.given.values())))
        density, gravity = drop.fluid.density, float(np.linalg.norm(case.gravity))
        speed = float(np.linalg.norm(drop.velocity))
        area, height = math.pi * self._radius**2, float(self._centre[1]) - self._level
        self._weight = density * gravity
        # Kinetic and potential energy of the drop, and that of its surface [J, per metre of depth].
        self._energy = density * area * (0.5 * speed**2 + gravity * height) + 2 * math.pi * self._radius * self._sigma

    def deepest(self) -> float:
        """Depth a of a half disc whose energy is the drop's: 2/3 rho g a^3 to lift its water, and (pi - 2) a sigma."""
        needs = lambda a: 2 / 3 * self._weight * a**3 + (math.pi - 2) * a * self._sigma - self._energy  # noqa: E731
        return float(brentq(needs, 0.0, 1e3 * self._radius))

    def figures(self, simulation: tp.Simulation) -> dict[str, float]:
        """See `Check.figures`; depths relative to the drop's radius, rises of energy to its energy."""
        history, wanted = simulation.history, simulation.state.wanted_volume
        columns = "kinetic_energy", "potential_energy", "surface_energy"
        energy = np.array([sum(row[name] for name in columns) for row in history])
        edges = simulation.state.part(TensionEdges)
        lowest = float(simulation.particles.position[np.append(edges.one, edges.other), 1].min())
        return {
            "volume_error": float(np.abs(simulation.state.volume / wanted - 1).max()),
            "energy_rise": float(np.diff(energy).max(initial=0.0)) / self._energy,
            "depth": (self._level - lowest) / self._radius,
            "deepest": self.deepest() / self._radius,
            "broken": sum(row["breakup_energy"] for row in history) / self._energy,
        }

    def missed(self, figures: Mapping[str, float], options: Options) -> list[str]:
        """See `Check.missed`; the depth is looked at where the crater had time to open."""
        found = []
        for name, most in (("volume_error", LARGEST_VOLUME_ERROR), ("energy_rise", LARGEST_RISE)):
            if not figures[name] <= most:
                found.append(f"{name} is {figures[name]:.1e}, above {most:g}")
        least = SHALLOWEST if options.end_time >= OPEN else -math.inf
        if not least <= figures["depth"] <= figures["deepest"]:
            found.append(f"the crater is {figures['depth']:.2f} radii deep, and energy allows {figures['deepest']:.2f}")
        return found
