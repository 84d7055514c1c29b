"""A Rayleigh-Taylor instability: a heavy fluid over a light one, which rises through it as a bubble.

Densities 3 and 1, walls that slip, a box of the width d and the height 4 d, the interface at y = -0.1 d cos(2 pi x / d)
from the middle, at rest. Both have the viscosity of a Reynolds number of 3000 with the heavy fluid, 1000 with the light
one, sqrt(g d^3) rho / mu. At t = 2.5 sqrt(d / (A g)), A = 1/2, the tips of bubble and spike are compared with the
references. Half of the box has each of them on a wall; in the whole one the spike is inside.

- G. Tryggvason, J. Comput. Phys. 75, 1988, 253-282.
- J.-L. Guermond, L. Quartapelle, J. Comput. Phys. 165, 2000, 167-188.
- H. Ding, P. D. M. Spelt, C. Shu, J. Comput. Phys. 226, 2007, 2078-2095.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

import tipfem as tp

WIDTH, GRAVITY = 1.0, 1.0  # d [m] and g [m/s^2]
REYNOLDS = 3000.0  # with the heavy fluid
HEAVY = tp.Fluid("heavy", density=3.0, viscosity=3.0 * math.sqrt(GRAVITY * WIDTH**3) / REYNOLDS)
LIGHT = tp.Fluid("light", density=1.0, viscosity=HEAVY.viscosity)
UNIT = math.sqrt(WIDTH / (0.5 * GRAVITY))  # of time [s]
END = 2.5  # [UNIT]
BUBBLE, SPIKE = 0.685, -1.120  # tips at the end [d]
LARGEST_ERRORS = {20: 0.05, 40: 0.035, 80: 0.025}  # of either, over the reference, by the particles across
STEP = 0.1  # largest step [sqrt(h / g)]


def build(across: int, *, whole: bool = False, jitter: float = 0.0, seed: int = 0, mass: str | None = None) -> tp.Case:
    """The case.

    Args:
        across: particles along the width d.
        whole: the whole box, not the half of it from the spike's tip to the bubble's.
        jitter: of the first particles, in spacings, with the random numbers of a ``seed``.
        mass: matrix, by default tipfem's.
    """
    width = WIDTH if whole else 0.5 * WIDTH
    tank = tp.tank((width, 4 * WIDTH), WIDTH / across, jitter=jitter, seed=seed)
    wave = 2 * math.pi / WIDTH
    middle = 0.5 * WIDTH if whole else 0.0  # of the spike
    tank.fill(HEAVY)
    tank.fill(LIGHT, where=lambda x: x[:, 1] < 2 * WIDTH - 0.1 * WIDTH * np.cos(wave * (x[:, 0] - middle)))
    for wall in ("left", "right", "bottom", "top"):
        tank.wall(wall, slip=True)
    numerics = tp.Numerics(**({"mass": mass} if mass else {}))
    return tp.Case(tank, [HEAVY, LIGHT], (0, -GRAVITY), numerics=numerics)


def tips(simulation: tp.Simulation) -> tuple[float, float]:
    """Heights of the bubble's and the spike's tip over the level of the interface [d]."""
    mesh = simulation.mesh
    y = mesh.position[mesh.cells, 1]
    return (
        float(y[mesh.fluid == 1].max() / WIDTH - 2),
        float(y[mesh.fluid == 0].min() / WIDTH - 2),
    )


def measure(across: int, *, out: Path | None = None, end: float = END, **options: Any) -> dict[str, Any]:
    """Run it.

    Args:
        across: see `build`.
        out: folder for the history, or None.
        end: [UNIT].
        options: of `build`.

    Returns:
        ``bubble`` and ``spike`` [d] at the end; ``volume_error``, the largest change of a fluid's volume, relative; and
        ``numerics``, energy that numerics took over that of the flow.
    """
    step = STEP * math.sqrt(WIDTH / across / GRAVITY)
    simulation = tp.Simulation(build(across, **options), out, time_step=step)
    simulation.run(end * UNIT, progress=False)
    bubble, spike = tips(simulation)
    return {
        "flow": "rayleigh-taylor",
        "across": across,
        "steps": simulation.step_number,
        "bubble": bubble,
        "spike": spike,
        "volume_error": simulation.state.volume_error,
        "numerics": simulation.numerical_error()["energy"],
    }


def table(results: Sequence[Mapping[str, Any]]) -> str:
    """The figures of several runs as a table in Markdown, a row each."""
    lines = ["| Rayleigh-Taylor, across | steps | bubble | spike | volume error | energy that numerics took |"]
    lines.append("|---|---|---|---|---|---|")
    lines += [
        f"| {r['across']} | {r['steps']} | {r['bubble']:.3f} | {r['spike']:.3f} | {r['volume_error']:.0e} | "
        f"{r['numerics']:.1%} |"
        for r in results
    ]
    return "\n".join(lines) + "\n"


def check(figures: Mapping[str, Any]) -> list[str]:
    """What a run to `END` misses of what is expected of it; an empty list when all is well."""
    allowed = [error for across, error in LARGEST_ERRORS.items() if figures["across"] >= across]
    return [
        f"rayleigh-taylor, {figures['across']} across: the {name} is at {figures[name]:.3f} d, not at {wanted} d"
        for name, wanted in (("bubble", BUBBLE), ("spike", SPIKE))
        if allowed and not abs(figures[name] / wanted - 1) <= allowed[-1]
    ]
