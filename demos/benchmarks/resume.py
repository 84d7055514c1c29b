"""Kill the dam break at random moments and resume it, and compare with a run that nothing stops.

    python demos/benchmarks/resume.py --times 10

Each run is killed by SIGKILL at a moment between its first step and its last, then resumed. Its history must be that of
the undisturbed run to the bit, wall-clock times aside. Resuming is timed, too: from the import to the state of the
checkpoint, beyond the start of Taichi; and checkpoints, by what they take of the undisturbed run.
"""

from __future__ import annotations

import argparse
import csv
import random
import shutil
import subprocess
import sys
import time
from pathlib import Path

TIMING = """
import sys, time
import tipfem as tp
from tipfem.demos import harness
tp.init()
case = harness.load("dam_break", spacing={spacing!r}).case
from tipfem.demos.validation.dam_break.check import DamBreak
import tipfem.simulation
begun = time.perf_counter()
tp.Simulation(case)
started = time.perf_counter()
simulation = tp.Simulation.resume(sys.argv[1], case, columns=DamBreak().columns())
print(started - begun, time.perf_counter() - started)
"""


def main() -> int:
    """Run the comparison; the exit status is 1 if a resumed run differs."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("--times", type=int, default=10, help="how many runs are killed")
    parser.add_argument("--spacing", default="0.01", help="distance between particles [m]")
    parser.add_argument("--end-time", default="0.3", help="simulated time to run to [s]")
    parser.add_argument("--seed", type=int, default=0, help="of the random moments")
    parser.add_argument("--out", type=Path, default=Path("out/resume"), help="folder for all runs")
    given = parser.parse_args()
    shutil.rmtree(given.out, ignore_errors=True)
    moments = random.Random(given.seed)
    options = ["--spacing", given.spacing, "--end-time", given.end_time, "--no-frames"]

    whole = given.out / "whole"
    begun = time.perf_counter()
    start(whole, options).wait()
    seconds = time.perf_counter() - begun
    rows = history(whole)
    run = float(last_wall(whole))
    print(f"undisturbed: {len(rows) - 1} steps in {run:.1f} s, {seconds:.1f} s with its start")

    same = 0
    for k in range(given.times):
        out = given.out / f"killed_{k}"
        process = start(out, options)
        while not (out / "history.csv").exists() and process.poll() is None:
            time.sleep(0.05)
        time.sleep(moments.uniform(0.0, 0.95) * run)
        process.kill()
        process.wait()
        steps = len(history(out)) - 1
        code = start(out, [*options, "--resume"]).wait()
        equal = code == 0 and history(out) == rows
        same += equal
        print(f"killed after {steps} steps: {'the same to the bit' if equal else f'DIFFERS (exit code {code})'}")
    code = TIMING.format(spacing=float(given.spacing))
    done = subprocess.run([sys.executable, "-c", code, whole], capture_output=True, text=True, check=True)
    fresh, resumed = map(float, done.stdout.splitlines()[-1].split())
    print(f"resuming takes {resumed:.2f} s, a simulation at its start {fresh:.2f} s")
    print(f"{same} of {given.times} the same to the bit")
    return int(same < given.times)


def start(out: Path, words: list[str]) -> subprocess.Popen[str]:
    """The demo, in a process of its own."""
    command = [sys.executable, "-m", "tipfem", "demo", "dam_break", *words, "--out", str(out)]
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, text=True)


def history(out: Path) -> list[list[str]]:
    """The rows of a history as text, without the wall-clock times, which stand last."""
    with open(out / "history.csv", encoding="utf-8", newline="") as file:
        return [row[:-1] for row in csv.reader(file)]


def last_wall(out: Path) -> str:
    """The wall-clock time of the last step [s]."""
    with open(out / "history.csv", encoding="utf-8", newline="") as file:
        return list(csv.reader(file))[-1][-1]


if __name__ == "__main__":
    sys.exit(main())
