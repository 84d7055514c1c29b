"""How much two workers shorten a sweep of eight runs: at most 0.6 of the time of one worker is asked for.

The runs are a dam break at eight viscosities, one thread each, in processes of their own; their start, which takes some
seconds, counts. Two cores without other load are needed for a figure that means something: the load is printed, too.

python -m tipfem demo benchmarks/sweep
"""

from __future__ import annotations

import csv
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from tipfem.demos import harness
from tipfem.demos.support.options import Positive

ASKED = 0.6
STUDY = """
case = "{case}"
folder = "{folder}"

[set]
time.end = {end}
tank.spacing = {spacing}

[grid]
fluids.water.viscosity = [1e-3, 2e-3, 3e-3, 4e-3, 5e-3, 6e-3, 7e-3, 8e-3]
"""


def sweep(folder: Path, workers: int, spacing: float, end: float) -> tuple[float, float]:
    """Run the study with so many workers.

    Returns:
        How long it took, and the sum of what its runs took by their own clocks, without their starts [s].

    Raises:
        SystemExit: a run failed.
    """
    case = Path(__file__).parents[1] / "cases" / "dam_break.toml"
    study = folder / f"workers_{workers}.toml"
    out = folder / f"out_{workers}"
    study.write_text(STUDY.format(case=case, folder=out, end=end, spacing=spacing), encoding="utf-8")
    begun = time.perf_counter()
    done = subprocess.run(
        [sys.executable, "-m", "tipfem", "sweep", str(study), "--workers", str(workers), "--threads", "1"],
        capture_output=True,
        text=True,
        check=False,
    )
    taken = time.perf_counter() - begun
    if done.returncode:
        raise SystemExit(f"error: the sweep failed: {done.stdout}{done.stderr}")
    with open(out / "study.csv", encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    if [row["status"] for row in rows] != ["complete"] * 8:
        raise SystemExit(f"error: not all runs are complete: {[row['status'] for row in rows]}")
    return taken, sum(float(row["wall_seconds"]) for row in rows)


def main(*, spacing: Positive = 0.02, end_time: Positive = 0.2) -> int:
    """Run the sweep with two workers and with one; the exit code is 1 if two workers take too long.

    Args:
        spacing: distance between particles [m].
        end_time: simulated time of each run [s].
    """
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else float("nan")
    with tempfile.TemporaryDirectory(prefix="tipfem-sweep-") as folder:
        taken = {}
        for workers in (2, 1):
            taken[workers], own = sweep(Path(folder), workers, spacing, end_time)
            print(f"{workers} worker(s): {taken[workers]:.1f} s; the runs by their own clocks: {own:.1f} s")
    ratio = taken[2] / taken[1]
    print(f"two workers take {ratio:.2f} of the time of one (asked: below {ASKED}); load at the start {load:.1f}")
    return int(not ratio < ASKED)


if __name__ == "__main__":
    harness.command(__name__)
