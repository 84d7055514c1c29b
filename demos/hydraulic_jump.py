"""A hydraulic jump: water that runs down a slope, fast and shallow, becomes slow and deep in a basin.

    tipfem demo hydraulic_jump --spacing 0.0125

The jump is full of eddies, and many are smaller than the cells: the water has Smagorinsky's eddy viscosity. The check
holds that the jump stands on the slope or at its foot, that the basin behind it is as deep as Bernoulli and Belanger
have it, and that the volume changes by what passes the openings; hydraulic_jump.png has the depth of the basin over
time, and where the energy goes. The case is demos/cases/hydraulic_jump.toml; `tipfem run` runs it without the check.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from tipfem.demos import harness
from tipfem.demos.support.figures import COLOURS, new_figure, save
from tipfem.demos.support.passing import Balance

import tipfem as tp

Array = NDArray[np.float64]

GRAVITY = 9.81  # [m/s^2]
SPEED, INLET, CREST = 1.6, 0.08, 0.2  # of what enters [m/s], its depth, and the height of the crest [m]
STANDING = (0.1, 0.9)  # where the toe of the jump may stand: the slope ends at 0.7 [m]
BASIN = (1.2, 1.8)  # where its depth is measured [m]
STANDS = 2.0  # when the jump stands [s]
LARGEST_ERROR = 0.08  # of the depth of the basin
BINS = np.arange(0.0, 2.01, 0.05)  # along the basin [m]


def conjugate() -> tuple[float, float]:
    """Depths of the water [m] before and behind a jump at the foot of the slope, without losses before it.

    Bernoulli's equation from the inlet to the foot, and Belanger's, d2 = d1 (sqrt(1 + 8 Fr^2) - 1) / 2.
    """
    head, flow = CREST + INLET + SPEED**2 / (2 * GRAVITY), SPEED * INLET
    thin = float(brentq(lambda d: d + (flow / d) ** 2 / (2 * GRAVITY) - head, 0.01, INLET))
    froude2 = flow**2 / (GRAVITY * thin**3)
    return thin, 0.5 * thin * (math.sqrt(1 + 8 * froude2) - 1)


def levels(simulation: tp.Simulation) -> Array:
    """Height of the water in each of `BINS` (K,) [m]; NaN where no particle of the surface is."""
    mesh = simulation.state.mesh
    top = mesh.position[mesh.used & mesh.surface.front]
    found = np.full(len(BINS) - 1, -math.inf)
    inside = (top[:, 0] > BINS[0]) & (top[:, 0] < BINS[-1])
    np.maximum.at(found, np.digitize(top[inside, 0], BINS) - 1, top[inside, 1])
    return np.where(np.isinf(found), math.nan, found)


class JumpStands(Balance):
    """The jump stands where the slope ends, and the basin behind it is as deep as in theory."""

    def columns(self) -> dict[str, harness.Probe]:
        """Where the water is lowest on the slope, at the toe of the jump, and the depth of the basin."""
        middle = (BINS[1:] + BINS[:-1]) / 2
        slope, basin = middle < 1.1, (middle > BASIN[0]) & (middle < BASIN[1])
        return {
            "toe": lambda simulation: float(middle[slope][np.nanargmin(levels(simulation)[slope])]),
            "depth": lambda simulation: float(np.nanmean(levels(simulation)[basin])),
        }

    def figures(self, simulation: tp.Simulation) -> dict[str, float]:
        """Place of the toe, error of the depth, and the power that eddies and numerics take, in the mean."""
        late = [row for row in simulation.history if row["time"] >= STANDS]
        step, toe, depth, eddies, numerics = (
            np.array([row[name] for row in late])
            for name in ("time_step", "toe", "depth", "viscous_dissipation", "numerical_dissipation")
        )
        time = step.sum() if late else math.nan
        return {
            **super().figures(simulation),
            "toe": float(toe @ step / time),
            "depth_error": float(depth @ step / time / conjugate()[1] - 1),
            "eddies": float(eddies.sum() / time),
            "numerics": float(numerics.sum() / time),
        }

    def missed(self, figures: Mapping[str, float], options: harness.Options) -> list[str]:
        """See `Check.missed`; in a short run the jump does not stand yet."""
        found = super().missed(figures, options)
        if options.end_time < STANDS + 1:
            return found
        if not STANDING[0] < figures["toe"] < STANDING[1]:
            found.append(f"the toe of the jump is at {figures['toe']:.2f} m; it should be within {STANDING}")
        if not abs(figures["depth_error"]) <= LARGEST_ERROR:
            found.append(f"the depth behind the jump is off by {figures['depth_error']:.1%}")
        return found

    def plot(self, simulation: tp.Simulation, figures: Mapping[str, float], options: harness.Options) -> None:
        """The depth of the basin, and where the energy goes."""
        rows = simulation.history
        figure = new_figure(9, 3.4)
        left, right = figure.subplots(1, 2)
        t = [row["time"] for row in rows]
        left.plot(t, [row["depth"] for row in rows], color=COLOURS[0], label="behind the jump")
        left.axhline(conjugate()[1], color="k", linestyle="--", label="Bernoulli and Belanger")
        left.set(xlabel="t [s]", ylabel="depth [m]", ylim=(0, 0.4))
        left.legend(loc="lower right")
        for number, (name, label) in enumerate((("viscous", "eddies"), ("numerical", "numerics"))):
            taken = np.cumsum([row[f"{name}_dissipation"] for row in rows])
            right.plot(t, taken, color=COLOURS[number], label=f"taken by {label}")
        right.set(xlabel="t [s]", ylabel="energy [J/m]")
        right.legend()
        save(figure, Path(options.out) / "hydraulic_jump.png")


main = harness.Demo("hydraulic_jump.toml", check=JumpStands(), strip=(0.0, 0.4, 1.0, 2.0, 3.0, 4.0))

if __name__ == "__main__":
    harness.command(__name__)
