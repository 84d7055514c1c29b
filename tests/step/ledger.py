"""What a step costs, without a clock: the same numbers at every run. ``python ledger.py cpu|vulkan`` prints them."""

from __future__ import annotations

import json
import sys
import tracemalloc
from collections import Counter
from pathlib import Path

import numpy as np
import taichi as ti

import tipfem as tp
from tipfem.backend import arrays, launch, staging

SOURCES = str(Path(tp.__file__).parent), str(Path(__file__).parent)
STEPS = {"cpu": 3, "vulkan": 10}  # that are counted
COPIES = (launch.copy, launch.copy_rows, staging.scatter, staging.scatter_rows, staging.gather, staging.gather_rows)


class Allocations:
    """The lines of tipfem that allocate at least a byte a particle while a function runs, and how many.

    Attributes:
        lines: whole bytes a particle by file and line; what Python itself allocates differs from run to run.
    """

    def __init__(self, particles: int) -> None:
        self.lines: Counter[tuple[str, int]] = Counter()
        self._particles, self._line, self._above, self._before = particles, None, [], 0

    def of(self, function) -> None:
        """Count those of a function's call, beside those counted before."""
        tracemalloc.start(1)
        sys.settrace(self._called)
        try:
            function()
        finally:
            sys.settrace(None)
            tracemalloc.stop()

    def _close(self):
        if self._line is not None:
            more = (tracemalloc.get_traced_memory()[1] - self._before) // self._particles
            if more:
                self.lines[self._line] += more

    def _open(self, line):
        self._line = line
        tracemalloc.reset_peak()
        self._before = tracemalloc.get_traced_memory()[0]

    def _called(self, frame, _event, _argument):
        if not frame.f_code.co_filename.startswith(SOURCES):
            return None
        self._close()
        self._above.append(self._line)
        self._open(None)
        return self._traced

    def _traced(self, frame, event, _argument):
        self._close()
        if event == "line":
            self._open((frame.f_code.co_filename, frame.f_lineno))
        elif event == "return":
            self._open(self._above.pop())
        return self._traced


class Crossings:
    """Kernels by the side they run on, their preparations, and what goes to device arrays and comes from them.

    Attributes:
        counts: how many there were of each.
    """

    def __init__(self) -> None:
        self.counts: Counter[str] = Counter()

    def count(self) -> None:
        """Count from now on."""
        counts = self.counts
        start, prepare, upload, download = (
            launch.Kernel.start,
            launch.Kernel._prepare,
            arrays.Buffers.upload,
            (arrays.download),
        )

        def starting(kernel, arguments):
            on_device = any(isinstance(each, ti.Ndarray) for each in arguments)
            if kernel not in COPIES:
                counts["kernels on the device" if on_device else "kernels on the host"] += 1
                counts["arrays of NumPy on the device"] += on_device * sum(type(a) is np.ndarray for a in arguments)
            returned = start(kernel, arguments)
            counts["waits"] += on_device and returned is not None
            return returned

        def preparing(kernel, key, arguments):
            counts["preparations"] += 1
            return prepare(kernel, key, arguments)

        def uploading(buffers, name, values, **options):
            counts["arrays up"] += 1
            counts["bytes up"] += values.nbytes
            return upload(buffers, name, values, **options)

        launch.Kernel.start, launch.Kernel._prepare, arrays.Buffers.upload = starting, preparing, uploading
        staging._copy_to = self._counted(staging._copy_to, "copies up")
        staging._copy_from = self._counted(staging._copy_from, "waits")
        counting = self._counted(download, "arrays down")
        for module in [module for name, module in sys.modules.items() if name.startswith("tipfem.")]:
            if vars(module).get("download") is download:
                module.download = counting

    def _counted(self, function, name):
        def counting(*arguments, **options):
            self.counts[name] += 1
            result = function(*arguments, **options)
            if name == "arrays down":
                self.counts["bytes down"] += result.nbytes
            return result

        return counting


def dam_break(spacing: float) -> tp.Simulation:
    """Water and air in a closed tank of 0.4 m, with the defaults."""
    water, air = tp.Fluid("water", 998.2, 1.002e-3), tp.Fluid("air", 1.204, 1.825e-5)
    tank = tp.tank((0.4, 0.4), spacing).fill(air).fill(water, box=((0, 0), (0.14, 0.28)))
    return tp.Simulation(tp.Case(tank, [water, air], gravity=(0, -9.81)))


def main(arch: str) -> None:
    """Print the figures of a step, and bytes as those of a particle, in JSON."""
    tp.init(arch, threads=1)
    simulation = dam_break(0.0035 if arch == "cpu" else 0.025)
    particles, steps = len(simulation.particles), STEPS[arch]
    for _ in range(10):
        simulation.step()
    figures = {}
    if arch == "cpu":
        found = Allocations(particles)
        for _ in range(steps):
            found.of(simulation.step)
        figures["lines"] = float(len(found.lines))
        figures["bytes"] = sum(found.lines.values()) / steps
        for (file, line), allocated in found.lines.most_common():
            print(
                f"{allocated / steps:8.1f}  {Path(file).relative_to(Path(tp.__file__).parents[1])}:{line}",
                file=sys.stderr,
            )
    crossings = Crossings()
    crossings.count()
    for _ in range(steps):
        simulation.step()
    for name, count in crossings.counts.items():
        figures[name] = count / steps / (particles if name.startswith("bytes") else 1)
    rows = simulation.history[-steps:]
    for name in ("newton_iterations", "krylov_iterations"):
        figures[name] = sum(row[name] for row in rows) / steps
    print(json.dumps(figures))


if __name__ == "__main__":
    main(sys.argv[1])
