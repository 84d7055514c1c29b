"""The checks of a drop that falls into a pool, and of a bubble that bursts at a surface."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from tipfem.demos.harness import Check, Options, Probe, above

import tipfem as tp
from tipfem.physics.surface_tension.edges import TensionEdges

Array = NDArray[Any]

LARGEST = {"volume_error": 1e-9, "energy_rise": 1e-3}  # of a fluid's volume; of the energy that moves it, in a step
POCKET = 0.02  # part of the bubble that may be left as bubbles once it has burst
RETRACTION = 0.7, 1.1  # the film's thickness is not even
FILM = "film_area", "film_width"
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
        edges = simulation.state.part(TensionEdges)
        lowest = float(simulation.particles.position[np.append(edges.one, edges.other), 1].min())
        return {
            **_kept(simulation, self._energy),
            "depth": (self._level - lowest) / self._radius,
            "deepest": self.deepest() / self._radius,
        }

    def missed(self, figures: Mapping[str, float], options: Options) -> list[str]:
        """See `Check.missed`; the depth is looked at where the crater had time to open."""
        found = above(figures, LARGEST)
        least = SHALLOWEST if options.end_time >= OPEN else -math.inf
        if not least <= figures["depth"] <= figures["deepest"]:
            found.append(f"the crater is {figures['depth']:.2f} radii deep, and energy allows {figures['deepest']:.2f}")
        return found


class Burst(Check):
    """Volumes, energy, whether the bubble has burst that a case fills last, below a surface, and how its film retracts.

    Args:
        case: of water and air, whose last two fills are the water and the bubble.
    """

    def __init__(self, case: tp.Case) -> None:
        water, bubble = case.tank.regions[-2:]
        centre, self._radius = bubble.given["disc"]
        self._level = float(np.asarray(water.given["box"])[1][1])
        self._area = math.pi * self._radius**2
        self._density, self._sigma = water.fluid.density, float(next(iter(case.surface_tension.given.values())))
        weight = (self._density - bubble.fluid.density) * float(np.linalg.norm(case.gravity))
        # Its surface, and the water above it that falls when it is gone [J, per metre of depth].
        lifted = weight * self._area * (self._level - float(centre[1]))
        self._energy = 2 * math.pi * self._radius * self._sigma + lifted
        self._fluids = {name: case.fluid_index(each.fluid) for name, each in (("water", water), ("air", bubble))}

    def columns(self) -> dict[str, Probe]:
        """Area [m^2] and width [m] of the largest water apart from the rest: of the film between its two breaks."""
        return {name: lambda simulation, k=k: self._film(simulation)[k] for k, name in enumerate(FILM)}  # type: ignore[misc]

    def _film(self, simulation: tp.Simulation) -> tuple[float, float]:
        area, label = self._pieces(simulation, "water")
        if len(area) < 2:
            return 0.0, 0.0
        cells = simulation.mesh.components.label == label[np.argsort(area)[-2]]  # type: ignore[union-attr]
        return float(np.sort(area)[-2]), float(np.ptp(simulation.mesh.corners(np.flatnonzero(cells))[..., 0]))

    def _pieces(self, simulation: tp.Simulation, fluid: str) -> tuple[Array, Array]:
        """Areas [m^2] and labels of the connected parts of the water or the air."""
        mesh = simulation.mesh
        assert mesh.components is not None
        area = np.bincount(mesh.components.label, mesh.measure, len(mesh.components))
        own = np.flatnonzero((mesh.components.fluid == self._fluids[fluid]) & (area > 0))
        return area[own], own

    def figures(self, simulation: tp.Simulation) -> dict[str, float]:
        """See `Check.figures`: among them when the first film breaks [s], NaN before; areas relative to the bubble's.

        The speed of the film's ends is over that of Taylor and Culick, sqrt(2 sigma / (rho e)), e its mean thickness,
        while the film is 0.9 to 0.5 as wide as when it broke; NaN where no film was apart from the rest.
        """
        pieces, history = self._pieces(simulation, "air")[0], simulation.history
        time, area, width = np.array([[row[name] for name in ("time", *FILM)] for row in history]).T
        speed, apart = math.nan, np.flatnonzero(width > self._radius)
        if len(apart):
            first = width[apart[0]]
            here = apart[(width[apart] < 0.9 * first) & (width[apart] > 0.5 * first)]
            if len(here) > 2:
                taylor_culick = math.sqrt(2 * self._sigma / (self._density * area[apart[0]] / first))
                speed = -0.5 * float(np.polyfit(time[here], width[here], 1)[0]) / taylor_culick
        return {
            **_kept(simulation, self._energy),
            "burst": min((row["time"] for row in history if row["broken_films"]), default=math.nan),
            "pockets": float(pieces.sum() - pieces.max()) / self._area,
            "retraction": speed,
        }

    def missed(self, figures: Mapping[str, float], options: Options) -> list[str]:
        """See `Check.missed`; a run that ends before a film breaks has its bubble."""
        found = above(figures, LARGEST)
        if not figures["pockets"] <= POCKET and figures["burst"] < options.end_time:
            text = f"a film broke at {figures['burst']:.3g} s, and {figures['pockets']:.2f} of the bubble is left"
            found.append(text)
        if not (math.isnan(figures["retraction"]) or RETRACTION[0] <= figures["retraction"] <= RETRACTION[1]):
            found.append(f"the film's ends have {figures['retraction']:.2f} of their speed by Taylor and Culick")
        return found


def _kept(simulation: tp.Simulation, energy: float) -> dict[str, float]:
    """Volumes and energies of a run, relative to an ``energy`` [J]: the largest rise in a step, what films released."""
    history, wanted = simulation.history, simulation.state.wanted_volume
    total = [sum(row[f"{kind}_energy"] for kind in ("kinetic", "potential", "surface")) for row in history]
    return {
        "volume_error": float(np.abs(simulation.state.volume / wanted - 1).max()),
        "energy_rise": float(np.diff(total).max(initial=0.0)) / energy,
        "broken": sum(row["breakup_energy"] for row in history) / energy,
    }
