"""Measure docs/data/condensation.csv: what it takes to condense the Jacobian once a linearisation.

    python docs/measure_condensation.py

Of the first system of a run's tenth step: how many nodes follow others, FGMRES iterations to 1e-6 from zero, and times
of gathering the Jacobian, of condensing it as a part of that, of the solve, of a product with it, and of what would be
added to one by condensing in each product: spreading displacements to what follows, and collecting forces. One thread,
the least of twenty.
"""

from __future__ import annotations

import csv
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import tipfem as tp
from tipfem.linalg.fgmres import fgmres
from tipfem.step.problem import FlowProblem

RESULT = Path(__file__).resolve().parent / "data" / "condensation.csv"
WATER, AIR = tp.Fluid("water", density=998.2, viscosity=1.002e-3), tp.Fluid("air", density=1.204, viscosity=1.825e-5)
OIL, GLYCERIN = tp.Fluid("oil", density=850.0, viscosity=5e-3), tp.Fluid("glycerin", density=1261.0, viscosity=1.412)
GRAVITY, SIZE = (0.0, -9.81), (0.584, 0.584)
COLUMN, POOL = ((0.0, 0.0), (0.146, 0.292)), ((0.0, 0.0), (0.584, 0.292))


def systems() -> Iterator[tuple[str, tp.Case, float]]:
    """Seven flows with what follows in each, and their largest steps [s]."""

    def tank(h: float, above: tp.Fluid, below: tp.Fluid, box: Any) -> tp.Tank:
        return tp.tank(SIZE, h, jitter=0.1).fill(above).fill(below, box=box)

    both = [WATER, AIR]
    yield "dam break, 10 mm", tp.Case(tank(0.01, AIR, WATER, COLUMN), both, GRAVITY), 2e-3
    yield "dam break, 5 mm", tp.Case(tank(0.005, AIR, WATER, COLUMN), both, GRAVITY), 1e-3
    graded = tp.Grading({"air": 0.04})
    yield (
        "dam break, graded from 5 to 40 mm",
        tp.Case(tank(0.005, AIR, WATER, COLUMN), both, GRAVITY, grading=graded),
        1e-3,
    )
    bubbly = tp.tank((1.0, 1.0), 0.0125, jitter=0.1).fill(WATER).fill(AIR, box=((0, 0.85), (1, 1)))
    for k in range(26):
        bubbly.fill(AIR, disc=((0.12 + 0.15 * (k % 6), 0.1 + 0.15 * (k // 6)), 0.03))
    yield "26 bubbles of air in water", tp.Case(bubbly, both, GRAVITY), 1e-3
    over = tank(0.01, GLYCERIN, WATER, POOL)
    yield "glycerin over water", tp.Case(over, [WATER, GLYCERIN], (1.0, -9.81)), 1e-2
    slide = tank(0.01, OIL, WATER, POOL)
    yield "oil on water, which slide", tp.Case(slide, [WATER, OIL], (1.0, -9.81)), 2e-3
    floating = tank(0.01, AIR, WATER, POOL)
    floating.add(tp.Body(tp.shapes.rectangle((0.2, 0.22), (0.4, 0.34)), density=500.0))
    yield "box that floats", tp.Case(floating, both, GRAVITY), 2e-3


def least(function: Callable[[], Any], times: int = 20) -> float:
    """The least of the milliseconds that a function takes."""
    best = float("inf")
    for _ in range(times):
        start = time.perf_counter()
        function()
        best = min(best, time.perf_counter() - start)
    return 1e3 * best


def measured(case: tp.Case, step: float) -> list[str]:
    """Particles, followers, iterations, and the times of a case."""
    simulation, found = tp.Simulation(case, time_step=step), list[list[str]]()
    correct = FlowProblem.correct

    def measure(problem: FlowProblem, x: Any, tolerance: float) -> Any:
        if not found:
            found.append([str(len(simulation.particles)), *figures(problem)])
        return correct(problem, x, tolerance)

    for _ in range(9):
        simulation.step()
    FlowProblem.correct = measure  # type: ignore[method-assign]
    try:
        simulation.step()
    finally:
        FlowProblem.correct = correct  # type: ignore[method-assign]
    return found[0]


def figures(problem: FlowProblem) -> list[str]:
    """Followers, iterations, and times of a problem whose residual has been evaluated."""
    system, buffers, size = problem.system, problem.buffers, problem.size
    problem.linearise()
    r, x, out = (buffers.get(name, size) for name in ("residual", "measured.x", "measured.out"))
    options = {"tolerance": 1e-6, "max_iterations": 80, "buffers": buffers, "iteration": system.iteration}

    def solve() -> Any:
        return fgmres(problem.product, problem.precondition, r, x, size, **options)

    iterations = solve().iterations
    solving, product = least(solve), least(lambda: system.product(x, out))
    condensation = system.condensation
    each = least(lambda: (condensation.spread(out), condensation.collect(out)))
    condensing = least(lambda: condensation.condense(system.rows))
    gathering = least(system.gather)
    problem.linearise()
    times = [f"{value:.2f}" for value in (gathering, condensing, solving)]
    return [str(condensation.count), str(iterations), *times, f"{product:.3f}", f"{each:.3f}"]


def main() -> None:
    """Measure all, and write the table."""
    root = RESULT.parents[2]
    show = ["git", "log", "-1", "--format=%h (%cs)"]
    commit = subprocess.run(show, cwd=root, check=True, capture_output=True, text=True).stdout.strip()
    tp.init(threads=1)
    titles = ["system", "particles", "followers", "iterations"]
    titles += [f"{what} [ms]" for what in ("gathering", "of it condensing", "solve", "a product", "beside it")]
    notes = f"# commit: {commit}\n# command: python docs/measure_condensation.py\n"
    with RESULT.open("w", encoding="utf-8", newline="") as file:
        file.write(notes)
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(titles)
        for name, case, step in systems():
            rows.writerow([name, *measured(case, step)])


if __name__ == "__main__":
    main()
