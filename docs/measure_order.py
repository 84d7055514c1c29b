"""Measure docs/data/order_in_time.csv: how a decaying vortex changes when its time step is halved.

    python docs/measure_order.py

A vortex of the speed U = 1 m/s at Re = 100 turns in a box of 1 m with 20 spacings a side and no-slip walls, to 64 ms,
on three perturbed meshes. Runs with a step and with half of it are compared by the root mean square of the difference
of their particles' velocities, over U; with the default tolerances of Newton's method, and with it solved exactly.
"""

from __future__ import annotations

import subprocess
from pathlib import Path

import numpy as np

import tipfem as tp
from tipfem.typing import Array

RESULT = Path(__file__).resolve().parent / "data" / "order_in_time.csv"
STEPS = [8.0, 4.0, 2.0, 1.0, 0.5, 0.25]  # [ms]
END = 0.064  # [s]
MESHES = 3


def vortex(x: Array) -> Array:
    """Velocities (N, 2) [m/s] of the stream function sin(pi x)^2 sin(pi y)^2 / pi, at most 1 m/s."""
    s, c = np.sin(np.pi * x), np.cos(np.pi * x)
    return 2 * np.stack([s[:, 0] ** 2 * s[:, 1] * c[:, 1], -(s[:, 1] ** 2) * s[:, 0] * c[:, 0]], axis=1)


TOLERANCES = {"default": tp.Numerics(), "exact": tp.Numerics(newton_tolerance=1e-9, acceleration_tolerance=1e-8)}


def velocities(dt: float, seed: int, numerics: tp.Numerics) -> Array:
    """Velocities (N, 2) [m/s] at the end, in steps of ``dt`` [s]."""
    fluid = tp.Fluid("oil", density=1000.0, viscosity=10.0)
    tank = tp.tank(size=(1.0, 1.0), spacing=0.05, jitter=0.2, seed=seed).fill(fluid, velocity=vortex)
    for side in ("left", "right", "bottom", "top"):
        tank.wall(side, law="no-slip")
    simulation = tp.Simulation(tp.Case(tank, [fluid], gravity=(0, 0), numerics=numerics), time_step=dt)
    simulation.run(until=END)
    return simulation.particles.velocity.copy()


def main() -> None:
    """Run all, and write the changes."""
    root = RESULT.parents[2]
    commit = subprocess.run(
        ["git", "log", "-1", "--format=%h (%cs)"], cwd=root, check=True, capture_output=True, text=True
    ).stdout.strip()
    lines = [f"# commit: {commit}", "# command: python docs/measure_order.py", "tolerance,mesh,dt [ms],change"]
    for name, numerics in TOLERANCES.items():
        for seed in range(1, MESHES + 1):
            found = [velocities(step / 1000, seed, numerics) for step in STEPS]
            for step, coarse, fine in zip(STEPS, found, found[1:], strict=False):
                lines.append(f"{name},{seed},{step:g},{np.sqrt(((coarse - fine) ** 2).sum(axis=1).mean()):.2e}")
    RESULT.write_text("\n".join([*lines, ""]), encoding="utf-8")


if __name__ == "__main__":
    main()
