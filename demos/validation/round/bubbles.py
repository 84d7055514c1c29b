"""Bubbles that rise, against experiments."""

from __future__ import annotations

import numpy as np
from scipy.optimize import brentq

import tipfem as tp

# Of the bubbles, whose diameter, and whose liquid's density are 1, as is gravity.
EOTVOS, DENSITY_RATIO, VISCOSITY_RATIO = 116.0, 1e-3, 1e-2
SIZE, FAR = (8.0, 12.0), 0.5  # of the tank, and the spacing far from the bubble [diameters]
END, STEADY = 7.0, 5.0  # of a run, and when the speed is even, in sqrt(diameter / gravity)


def terminal_reynolds(eotvos: float, morton: float) -> float:
    """The Reynolds number at which a bubble rises in a liquid of a Morton number above 4e-3.

    It follows from the drag coefficient of D. Bhaga & M. E. Weber, Journal of Fluid Mechanics 105, 1981,
    4 g D / (3 U^2) = (2.67^0.9 + (16 / Re)^0.9)^(1 / 0.9), with the number of Eotvos and that of Morton, as quoted by
    A. Zhang et al., Physics of Fluids 31, 2019, eq. 8.
    """
    galilei = (eotvos**3 / morton) ** 0.25  # sqrt(g D^3) / nu

    def off(reynolds: float) -> float:
        drag: float = (2.67**0.9 + (16 / reynolds) ** 0.9) ** (1 / 0.9)
        return drag - 4 / 3 * (galilei / reynolds) ** 2

    return float(brentq(off, 1e-3 * galilei, 10 * galilei))


def bubble(morton: float, across: int = 16) -> dict[str, float]:
    """Error of the Reynolds number of a bubble with ``across`` spacings in its diameter."""
    tension = 1 / EOTVOS
    viscosity = (morton * tension**3) ** 0.25
    gas = tp.Fluid("bubble", DENSITY_RATIO, VISCOSITY_RATIO * viscosity)
    liquid = tp.Fluid("liquid", 1.0, viscosity)
    tank = tp.tank(SIZE, 1 / across, coordinates="axisymmetric").fill(liquid).fill(gas, disc=((0.0, 3.0), 0.5))
    for side in ("right", "top", "bottom"):
        tank.wall(side, slip=True)
    grading = tp.Grading({"liquid": FAR}, growth=0.1)
    case = tp.Case(tank, [gas, liquid], (0, -1), surface_tension={("bubble", "liquid"): tension}, grading=grading)
    simulation, probe = tp.Simulation(case), tp.DropProbe(name="bubble", fluid="bubble")
    volume, speeds, worst = simulation.volume("bubble"), [], 0.0
    while simulation.time < END:
        simulation.step()
        worst = max(worst, abs(simulation.volume("bubble") / volume - 1))
        if simulation.time >= STEADY:
            speeds.append(probe.sample(simulation)[2])
    reynolds = float(np.mean(speeds)) / viscosity
    return {"reynolds": reynolds / terminal_reynolds(EOTVOS, morton) - 1, "number": reynolds, "bubble_volume": worst}
