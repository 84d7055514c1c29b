"""CPU time of one picture: fluids, a field with its mesh, a time played, a window moved.

    python -m tipfem demo benchmarks/frame_time --results out/dam_break

Several results folders give one row each. `--against FOLDER` names another checkout of the repository: both are
measured in turns, each time in a process of its own, so that a busy machine slows both.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from tipfem.demos import harness
from tipfem.demos.support.options import Count, Several

# Run in a process of its own; it uses only what every version of the package has.
MEASURE = """
import sys, time
from tipfem.render import Renderer, Results
folder, repeats = sys.argv[1], int(sys.argv[2])
options = dict(field="pressure", field_range=(0, 3000), mesh=True)
results = Results(folder)
def least(draw):
    best = 1e9
    for k in range(repeats + 1):
        before = time.process_time()
        draw(k)
        if k:
            best = min(best, time.process_time() - before)
    return f"{1e3 * best:.1f}"
def new():
    import dataclasses
    return dataclasses.replace(results.scene(-1))
scene = results.scene(-1)
found = [str(len(scene.position))]
for samples in (2, 1):
    try:
        renderer = Renderer((1280, 720), "raster", samples=samples)
    except TypeError:
        found += ["-", "-", "-"] if samples == 1 else []
        if samples == 1:
            continue
        renderer = Renderer((1280, 720), "raster")
    scenes = [new() for _ in range(repeats + 1)]
    found.append(least(lambda k: renderer.frame(scenes[k])))
    scenes = [new() for _ in range(repeats + 1)]
    found.append(least(lambda k: renderer.frame(scenes[k], **options)))
    try:
        from tipfem.render import View
    except ImportError:
        found.append("-")
        continue
    x, y = (scene.upper - scene.lower) / 3
    def moved(k):
        left, low = scene.lower[0] + 0.02 * k * x, scene.lower[1]
        renderer.frame(scene, **options, view=View(window=(left, low, left + x, low + y)))
    found.append(least(moved))
print("\\t".join(found))
"""
HEAD = "| code | particles | fluids | field and mesh | window moved | fluids | field and mesh | window moved |"


def main(
    *,
    results: Several[Path],
    against: Path | None = None,
    repeats: Count = 10,
    rounds: Count = 2,
) -> int:
    """Measure and print the table.

    Args:
        results: results folders.
        against: another checkout with its environment in .venv.
        repeats: pictures of each kind.
        rounds: turns of the two codes.
    """
    codes = {"this": sys.executable}
    if against is not None:
        codes["other"] = str(against / ".venv" / "bin" / "python")
    print("Milliseconds of CPU for a picture of 1280x720 with 2x2 samples a pixel, and with 1 (the least of all):\n")
    print(HEAD)
    print("|" + "---|" * (HEAD.count("|") - 1))
    for folder in results:
        rows: dict[str, list[str]] = {}
        for _ in range(rounds):
            for name, python in codes.items():
                words = [python, "-c", MEASURE, str(folder.resolve()), str(repeats)]
                done = subprocess.run(words, capture_output=True, text=True, check=False, cwd="/")
                if done.returncode:
                    print(done.stderr, file=sys.stderr)
                    return 1
                found = done.stdout.split()
                rows[name] = [min(a, b, key=_number) for a, b in zip(rows.get(name, found), found, strict=True)]
        for name, row in rows.items():
            print(f"| {name} | " + " | ".join(row) + " |", flush=True)
    return 0


def _number(text: str) -> float:
    return float("inf") if text == "-" else float(text)


if __name__ == "__main__":
    harness.command(__name__)
