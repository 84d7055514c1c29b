"""Flows in tanks with walls at angles and round ones, against closed forms.

couette: oil between two circles, the inner one turning: u = A r + B / r, torque 4 pi mu B (Landau & Lifshitz, Fluid
Mechanics, section 18). rings: the same with two oils, one around the other. rest: water and air at rest over an
inclined, a stepped and a round bottom, walls with slip and without. circle: sloshing in a half-filled horizontal
cylinder with slip, omega^2 a / g = 1.3557 (McIver, J. Fluid Mech. 201, 1989), under air; bowl: under a free surface.
wedge: the same between two walls at 45 degrees, where the surface stays a straight line and omega^2 h / g = 1 (Lamb,
Hydrodynamics, art. 258). tube: water that swings in a U-tube, omega^2 l / g = 2.

    summary.json      figures of all runs
    table.md          the same as a table
    shapes.png        speeds of the Couette flow, and the sloshing over time

    python -m tipfem demo validation/shapes --flow couette rest
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from tipfem.demos import harness
from tipfem.demos.support.figures import COLOURS, new_figure, save, table, with_legend
from tipfem.demos.support.histories import column, middle_of_water, zeros
from tipfem.demos.support.options import Arch, Count, Counts, Several

import tipfem as tp

Array = NDArray[np.float64]

GRAVITY = 9.81  # [m/s^2]
WATER = tp.Fluid("water", density=998.2, viscosity=1.002e-3)
AIR = tp.Fluid("air", density=1.204, viscosity=1.825e-5)
INNER, OUTER, SPEED = 0.5, 1.0, 0.1  # of the Couette flow: radii [m], speed of the inner circle [m/s]
OILS = (tp.Fluid("oil", density=1000.0, viscosity=10.0), tp.Fluid("heavy oil", density=1000.0, viscosity=20.0))
BETWEEN = 0.75  # radius of the interface of two rings [m]
TILT = 0.02  # of the surface at the start of sloshing [rad]; in the tube, of the water above the middle [m]
CIRCLE = tp.shapes.circle((0, 0), 1.0)
ROUND_RATE = math.sqrt(1.35573 * GRAVITY)  # angular frequency of the circle [rad/s]
# The U-tube: width, depth of the water in its straight arms [m], and the length l of water in a straight tube that has
# the same inertia. In the bend alone, as between circles, it would be pi / ln 3; Laplace's equation, solved by finite
# elements with 10, 20 and 40 in the width, gives 0.031 m more.
WIDTH, ARM, LENGTH = 1.0, 1.5, 5.8907
TUBE = tp.shapes.polygon(
    [(-1.5, 2.5), (-1.5, 0), tp.shapes.arc((0, 0)), (1.5, 0), (1.5, 2.5)]
    + [(0.5, 2.5), (0.5, 0), tp.shapes.arc((0, 0), clockwise=True), (-0.5, 0), (-0.5, 2.5)],
    names=["far left", "outer", "far right", "right", "near right", "inner", "near left", "left"],
)
# Cells across, of the two runs of each flow.
Flow = Literal["couette", "rings", "rest", "circle", "bowl", "wedge", "tube"]
ACROSS = {
    "couette": (8, 16),
    "rings": (8, 16),
    "rest": (10, 20),
    "circle": (10, 16),
    "bowl": (12, 20),
    "wedge": (20, 30),
    "tube": (10, 16),
}
LIMITS = {"speed": 0.01, "torque": 0.02, "speed_at_rest": 1e-9, "period": 0.01, "loss": 0.01}
# Of the rms error of the speed between circles; from 8 to 16 spacings across it is 1.66, with two oils 1.60.
SMALLEST_ORDER = 1.5
BOTTOMS = {
    "inclined": ([(0, 0.3), (0.7, 0.05), (1, 0.1), (1, 0.8), (0, 0.8)], 0.47),
    "stepped": ([(0, 0), (0.5, 0), (0.5, 0.2), (1, 0.2), (1, 0.7), (0, 0.7)], 0.4),
    "round": (tp.shapes.polygon([(-0.5, 0), tp.shapes.arc((0, 0)), (0.5, 0), (0.5, 0.3), (-0.5, 0.3)]), -0.13),
}


def exact_speed(r: Array, oils: Sequence[tp.Fluid]) -> tuple[Array, float]:
    """Speed (K,) of the flow between circles at radii r (K,), and the torque on the inner circle [N]."""
    if len(oils) == 1:
        b = SPEED * INNER * OUTER**2 / (OUTER**2 - INNER**2)
        return b / r - b / OUTER**2 * r, 4 * math.pi * oils[0].viscosity * b
    # u = T / (4 pi mu) (1 / r - r / R^2) + c r in each ring, with the same torque T and speed at the interface.
    outer = (1 / BETWEEN - BETWEEN / OUTER**2) / oils[1].viscosity
    inner = (1 / INNER - INNER / BETWEEN**2) / oils[0].viscosity
    torque = 4 * math.pi * SPEED / (inner + outer * INNER / BETWEEN)
    at = torque / (4 * math.pi) * outer  # speed of the interface
    within = torque / (4 * math.pi * oils[0].viscosity) * (1 / r - r / BETWEEN**2) + at * r / BETWEEN
    beyond = torque / (4 * math.pi * oils[1].viscosity) * (1 / r - r / OUTER**2)
    return np.where(r < BETWEEN, within, beyond), torque


def couette(across: int, oils: Sequence[tp.Fluid] = OILS[:1]) -> tuple[dict[str, float], Array]:
    """The flow between circles, steady.

    Args:
        across: spacings between the circles.
        oils: one, or two of which the second is outside.

    Returns:
        Its figures: largest error of the speed over that of the circle, error of the torque; and radii and speeds
        (K, 2).
    """
    spacing = (OUTER - INNER) / across
    ring = tp.shapes.circle((0, 0), OUTER, name="outer", holes=[tp.shapes.circle((0, 0), INNER, name="inner")])
    tank = tp.tank(shape=ring, spacing=spacing).fill(oils[-1]).wall("inner", velocity=SPEED)
    if len(oils) > 1:
        tank.fill(oils[0], disc=((0, 0), BETWEEN))
    simulation = tp.Simulation(tp.Case(tank, list(oils), (0, 0)), time_step=0.2 * spacing / SPEED)
    simulation.run(60.0, progress=False)
    particles = simulation.particles
    r = np.linalg.norm(particles.position, axis=1)
    around = np.stack([-particles.position[:, 1], particles.position[:, 0]], axis=1) / r[:, None]
    speed = (particles.velocity * around).sum(axis=1)
    expected, torque = exact_speed(r, oils)
    # The power of the wall is what the fluid dissipates: torque times angular speed. Mean over a turn's tenth.
    rows = simulation.history[-20:]
    power = sum(row["viscous_dissipation"] for row in rows) / sum(row["time_step"] for row in rows)
    error = speed - expected
    figures = {
        "speed": float(np.abs(error).max() / SPEED),
        "rms": float(np.sqrt((error**2).mean()) / SPEED),
        "torque": power / (SPEED / INNER) / torque - 1,
    }
    return figures, np.stack([r, speed], axis=1)


def rest(across: int, bottom: str, *, slip: bool) -> dict[str, float]:
    """Water and air at rest over a bottom of `BOTTOMS`: the largest speed after 20 steps [m/s]."""
    shape, level = BOTTOMS[bottom]
    tank = tp.tank(shape=shape, spacing=1 / across).fill(AIR).fill(WATER, box=((-1, -1), (1, level)))
    if slip:
        for side in tank.sides:
            tank.wall(side, slip=True)
    simulation = tp.Simulation(tp.Case(tank, [WATER, AIR], (0, -GRAVITY)))
    for _ in range(20):
        simulation.step()
    return {"speed_at_rest": simulation.particles.max_speed}


def sloshing(flow: str, across: int, periods: float = 1.6) -> tuple[dict[str, float], Array]:
    """Water that swings: its period over theory's, and times [periods] with the x of its centre of mass (K, 2).

    Under free surfaces also the part of the amplitude that is lost in half a period.
    """
    shape, rate, width = CIRCLE, ROUND_RATE, 1.0
    normal, through = np.array([-math.sin(TILT), math.cos(TILT)]), (0.0, 0.0)
    if flow == "wedge":
        shape, rate, through = tp.shapes.polygon([(0, 0), (1.4, 1.4), (-1.4, 1.4)]), math.sqrt(GRAVITY), (0.0, 1.0)
    elif flow == "tube":
        shape, rate, width = TUBE, math.sqrt(2 * GRAVITY / LENGTH), WIDTH
    tank = tp.tank(shape=shape, spacing=width / across)
    free = flow != "circle"
    if not free:
        tank.fill(AIR)
    if flow == "tube":
        tank.fill(WATER, where=lambda x: x[:, 1] < ARM - TILT * np.sign(x[:, 0]))
    else:
        tank.fill(WATER, where=lambda x: (x - through) @ normal < 0)
    for side in tank.sides:
        tank.wall(side, slip=True)
    case = tp.Case(tank, [WATER] if free else [WATER, AIR], (0, -GRAVITY), free_surface=free)
    simulation = tp.Simulation(case, columns={"middle": middle_of_water})
    period = 2 * math.pi / rate
    simulation.run(periods * period, progress=False)
    time, middle = column(simulation, "time"), column(simulation, "middle")
    k, passes = zeros(time, middle)
    found = 2 * (passes[-1] - passes[0]) / (len(passes) - 1) if len(passes) > 1 else math.nan
    figures = {"period": found / period - 1}
    if flow in ("bowl", "tube"):
        peaks = [np.abs(part).max() for part in np.split(middle, k + 1)[: round(2 * periods)]]
        figures["loss"] = 1 - (peaks[-1] / peaks[0]) ** (1 / (len(peaks) - 1))
    return figures, np.stack([time / period, middle], axis=1)


def check(name: str, figures: Mapping[str, float]) -> list[str]:
    """What a run misses of what is expected of it; an empty list when all is well."""
    missed = []
    for key in LIMITS:
        if key in figures and not abs(figures[key]) <= LIMITS[key]:
            missed.append(f"{name}: {key} is {figures[key]:.3g}, more than {LIMITS[key]:g}")
    if not figures.get("order", SMALLEST_ORDER) >= SMALLEST_ORDER:
        missed.append(f"{name}: order is {figures['order']:.3g}, less than {SMALLEST_ORDER:g}")
    return missed


def measure(flow: str, across: Sequence[int]) -> tuple[dict[str, dict[str, float]], dict[str, Array]]:
    """Run a flow at several resolutions: figures, and what is drawn, by the runs' names."""
    figures: dict[str, dict[str, float]] = {}
    drawn: dict[str, Array] = {}
    for n in across:
        name = f"{flow}, {n} across"
        if flow == "rest":
            for bottom in BOTTOMS:
                for slip in (False, True):
                    text = f"rest, {bottom} bottom, {'slip' if slip else 'default walls'}, {n} across"
                    figures[text] = rest(n, bottom, slip=slip)
        elif flow in ("couette", "rings"):
            figures[name], drawn[name] = couette(n, OILS[: 1 + (flow == "rings")])
        else:
            figures[name], drawn[name] = sloshing(flow, n)
    names = list(figures)
    if flow in ("couette", "rings") and len(across) > 1:
        coarse, fine = figures[names[0]]["rms"], figures[names[-1]]["rms"]
        figures[names[-1]]["order"] = math.log(coarse / fine) / math.log(across[-1] / across[0])
    return figures, drawn


def plot(path: Path, drawn: Mapping[str, Array]) -> None:
    """Draw the speeds between circles, and the sloshing over time."""
    figure = new_figure(9.0, 4.0)
    left, right = figure.subplots(1, 2)
    r = np.linspace(INNER, OUTER, 200)
    for number, (name, data) in enumerate(drawn.items()):
        colour = COLOURS[number % len(COLOURS)]
        if name.startswith(("couette", "rings")):
            left.plot(data[:, 0], data[:, 1], ".", markersize=2, color=colour, label=name)
        else:
            right.plot(data[:, 0], data[:, 1], color=colour, label=name)
    for oils in (OILS[:1], OILS):
        left.plot(r, exact_speed(r, oils)[0], "k-", linewidth=0.7)
    left.set_xlabel("r [m]")
    left.set_ylabel("speed [m/s]; lines: exact")
    right.set_xlabel("t / T of theory")
    right.set_ylabel("x of the water's centre [m]")
    for axes in (left, right):
        with_legend(axes)
    save(figure, path)


def main(
    *,
    flow: Several[Flow] | None = None,
    across: Counts | None = None,
    arch: Arch = "cpu",
    threads: Count | None = None,
    out: Path = Path("out/validation/shapes"),
) -> int:
    """Run the flows at all resolutions.

    Args:
        flow: which flows; by default all.
        across: spacings across; by default two of each flow.
        arch: where the kernels run.
        threads: of the processor; by default all.
        out: folder for the results.
    """
    tp.init(arch=arch, threads=threads)
    results: dict[str, Any] = {}
    drawn: dict[str, Array] = {}
    for name in flow or ACROSS:
        figures, curves = measure(name, across or ACROSS[name])
        results.update(figures)
        drawn.update(curves)
    out.mkdir(parents=True, exist_ok=True)
    (out / "table.md").write_text(table(results), encoding="utf-8")
    plot(out / "shapes.png", drawn)
    print(table(results))
    return harness.report(out, {"runs": results}, [text for name, one in results.items() for text in check(name, one)])


if __name__ == "__main__":
    harness.command(__name__)
