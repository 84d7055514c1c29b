"""Kill the dam break at random moments and resume it, and compare with a run that nothing stops.

    python demos/benchmarks/resume.py --times 10

Each run is killed by SIGKILL at a moment between its first step and its last, then resumed. Its history must be that of
the undisturbed run to the bit, wall-clock times aside. Resuming is timed, too: from the import to the state of the
checkpoint, beyond the start of Taichi; and checkpoints, by what they take of the undisturbed run.
"""

from __future__ import annotations

import csv
import random
import shutil
import subprocess
import sys
import time
from pathlib import Path

from tipfem.demos import harness
from tipfem.demos.support.options import Count, Positive

from tipfem.app.options import Whole

TIMING = """
import sys, time
import tipfem as tp
from tipfem.demos.dam_break import main
tp.init()
case = main.prepared(spacing={spacing!r}).case
from tipfem.demos.validation.dam_break.check import DamBreak
import tipfem.run.simulation
begun = time.perf_counter()
tp.Simulation(case)
started = time.perf_counter()
simulation = tp.Simulation.resume(sys.argv[1], case, columns=DamBreak().columns())
print(started - begun, time.perf_counter() - started)
"""


def main(
    *,
    times: Count = 10,
    spacing: Positive = 0.01,
    end_time: Positive = 0.3,
    seed: Whole = 0,
    out: Path = Path("out/resume"),
) -> int:
    """Run the comparison; the exit code is 1 if a resumed run differs.

    Args:
        times: how many runs are killed.
        spacing: distance between particles [m].
        end_time: simulated time to run to [s].
        seed: of the random moments.
        out: folder for all runs.
    """
    shutil.rmtree(out, ignore_errors=True)
    moments = random.Random(seed)
    options = ["--spacing", str(spacing), "--end-time", str(end_time), "--no-frames"]

    whole = out / "whole"
    begun = time.perf_counter()
    start(whole, options).wait()
    seconds = time.perf_counter() - begun
    rows = history(whole)
    run = float(last_wall(whole))
    print(f"undisturbed: {len(rows) - 1} steps in {run:.1f} s, {seconds:.1f} s with its start")

    same = 0
    for k in range(times):
        folder = out / f"killed_{k}"
        process = start(folder, options)
        while not (folder / "history.csv").exists() and process.poll() is None:
            time.sleep(0.05)
        time.sleep(moments.uniform(0.0, 0.95) * run)
        process.kill()
        process.wait()
        steps = len(history(folder)) - 1
        code = start(folder, [*options, "--resume"]).wait()
        equal = code == 0 and history(folder) == rows
        same += equal
        print(f"killed after {steps} steps: {'the same to the bit' if equal else f'DIFFERS (exit code {code})'}")
    timing = TIMING.format(spacing=spacing)
    done = subprocess.run([sys.executable, "-c", timing, whole], capture_output=True, text=True, check=True)
    fresh, resumed = map(float, done.stdout.splitlines()[-1].split())
    print(f"resuming takes {resumed:.2f} s, a simulation at its start {fresh:.2f} s")
    print(f"{same} of {times} the same to the bit")
    return int(same < times)


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
    harness.command(__name__)
