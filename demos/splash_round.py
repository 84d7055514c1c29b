"""A drop of water falls into a pool: it digs a crater, and the crater's collapse throws up a jet.

    tipfem demo splash_round --spacing 0.0005

An axisymmetric flow with a free surface. The check holds that the crater is as deep as energy allows, that the jet
rises over the pool, and that the water keeps its volume; splash_round.png has the surface on the axis over time.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from tipfem.demos import harness
from tipfem.demos.support.figures import COLOURS, new_figure, save
from tipfem.demos.support.options import Positive

import tipfem as tp

DIAMETER, SPEED = 4e-3, 2.0  # of the drop [m, m/s]: Weber number 220, Froude number 102
SIZE, DEPTH = (0.024, 0.04), 0.016  # of the tank, and of the water in it [m]
DENSITY, VISCOSITY, SIGMA, GRAVITY = 998.2, 1.002e-3, 0.0728, 9.81
CRATER = (0.5, 1.0)  # its depth, over that of a hemisphere that takes all of the drop's energy
JET = 1.0  # least height over the pool [diameters of the drop]
COLLAPSED = 0.06  # when the jet has risen [s]


def case(spacing: Positive = 5e-4) -> tp.Case:
    """A drop that touches a pool.

    Args:
        spacing: distance between particles [m].
    """
    water = tp.Fluid("water", density=DENSITY, viscosity=VISCOSITY)
    tank = tp.tank(SIZE, spacing, coordinates="axisymmetric").fill(water, box=((0, 0), (SIZE[0], DEPTH)))
    middle = DEPTH + DIAMETER / 2 + spacing
    tank.fill(water, disc=((0.0, middle), DIAMETER / 2), velocity=(0.0, -SPEED))
    return tp.Case(
        tank,
        [water],
        gravity=(0, -GRAVITY),
        free_surface=True,
        surface_tension={"water": SIGMA},
        title="A drop falls into a pool",
    )


def deepest() -> float:
    """Depth [m] of a hemisphere for which the drop's energy is spent on weight and surface.

    rho g pi R^4 / 4 + sigma pi R^2 = rho pi D^3 V^2 / 12 + sigma pi D^2
    """
    energy = DENSITY * DIAMETER**3 * SPEED**2 / 12 + SIGMA * DIAMETER**2
    return float(max(np.roots([DENSITY * GRAVITY / 4, 0, SIGMA, 0, -energy]).real))


def lowest(simulation: tp.Simulation) -> float:
    """Height of the lowest point of the surface over that of the pool [m]."""
    mesh = simulation.state.mesh
    return float(mesh.position[mesh.used & mesh.surface.front, 1].min()) - DEPTH


def highest(simulation: tp.Simulation) -> float:
    """Height over the pool of the highest water within a quarter of the drop's diameter of the axis [m]."""
    mesh = simulation.state.mesh
    there = mesh.used & (mesh.position[:, 0] < 0.25 * DIAMETER)
    return float(mesh.position[there, 1].max(initial=0.0)) - DEPTH


class Splashes(harness.Check):
    """The crater has its depth, a jet rises, and the water keeps its volume."""

    def columns(self) -> dict[str, harness.Probe]:
        """The lowest point of the surface, and the highest one near the axis."""
        return {"lowest": lowest, "highest": highest}

    def begin(self, simulation: tp.Simulation, options: harness.Options) -> None:
        """See `Check.begin`."""
        self._volume = simulation.volume("water")

    def figures(self, simulation: tp.Simulation) -> dict[str, float]:
        """Depth of the crater over `deepest`, when it is deepest, the jet after that, and the change of the volume."""
        t, low, high = (np.array([row[name] for row in simulation.history]) for name in ("time", "lowest", "highest"))
        k = int(low.argmin())
        return {
            "crater": -float(low[k]) / deepest(),
            "crater_time": float(t[k]),
            "jet": float(high[k:].max()) / DIAMETER,
            "volume": abs(simulation.volume("water") / self._volume - 1),
        }

    def missed(self, figures: Mapping[str, float], options: harness.Options) -> list[str]:
        """See `Check.missed`; a short run has no crater yet."""
        found = [f"the volume is off by {figures['volume']:.1e}"] if not figures["volume"] <= 1e-12 else []
        if options.end_time < COLLAPSED:
            return found
        if not CRATER[0] <= figures["crater"] <= CRATER[1]:
            found.append(f"the crater's depth is {figures['crater']:.2f} of what energy allows; it should be {CRATER}")
        if not figures["jet"] >= JET:
            found.append(f"the jet rises {figures['jet']:.2f} diameters over the pool, less than {JET:g}")
        return found

    def plot(self, simulation: tp.Simulation, figures: Mapping[str, float], options: harness.Options) -> None:
        """The surface over time."""
        rows = simulation.history
        t = 1e3 * np.array([row["time"] for row in rows])
        figure = new_figure(6, 4)
        axes = figure.subplots()
        for number, name in enumerate(("highest", "lowest")):
            axes.plot(t, 1e3 * np.array([row[name] for row in rows]), color=COLOURS[number], label=f"{name} point")
        axes.axhline(-1e3 * deepest(), color="k", linestyle="--", label="a hemisphere of the drop's energy")
        axes.set(xlabel="t [ms]", ylabel="height over the pool [mm]")
        axes.legend()
        save(figure, Path(options.out) / "splash_round.png")


main = harness.Demo(
    case,
    end_time=0.07,  # [s]
    time_step=5e-4,  # [s]
    frames_per_second=250.0,
    check=Splashes(),
    strip=(0.0, 0.004, 0.012, 0.024, 0.032, 0.04, 0.052, 0.064),
)

if __name__ == "__main__":
    harness.command(__name__)
