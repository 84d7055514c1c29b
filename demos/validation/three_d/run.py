"""Flows in three dimensions against theory, published figures and the plane.

wave: frequency and damping of standing waves, half a wave along the tank or along both of its sides.
overturning: the rate at which a heavy fluid on a light one begins to come down.
column: a column of water that collapses in a thin tank, against the plane's.
bubble: one that rises in a thin tank, against S. Hysing et al., 2009, case 1; without tension, against the plane's.

    summary.json    figures of all runs
    three_d.png     the finest run of each flow

    python -m tipfem demo validation/three_d --flow wave
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Literal

from tipfem.demos import harness
from tipfem.demos.support.figures import Curves, plot_flows
from tipfem.demos.support.options import Arch, Several
from tipfem.demos.validation.three_d.flows import bubble, collapses, overturns, wave

import tipfem as tp

Flow = Literal["wave", "overturning", "column", "bubble"]
Run = Callable[[], tuple[dict[str, float], Curves]]
# By flow; the last run of each is drawn.
RUNS: dict[str, dict[str, Run]] = {
    "wave": {
        "along one side, 10 across": lambda: wave((1, 0), 10),
        "along one side, 20 across": lambda: wave((1, 0), 20),
        "along both sides, 10 across": lambda: wave((1, 1), 10),
        "along both sides, 20 across": lambda: wave((1, 1), 20),
        "viscous, along both, 10 across": lambda: wave((1, 1), 10, viscous=True),
        "viscous, along both, 20 across": lambda: wave((1, 1), 20, viscous=True),
    },
    "overturning": {"10 across": lambda: overturns(10), "20 across": lambda: overturns(20)},
    "column": {"8 across": lambda: collapses(8)},
    "bubble": {
        "without tension, 16 across": lambda: bubble(16, tension=False),
        "16 across": lambda: bubble(16),
    },
}
LARGEST = {"frequency": 0.01, "damping": 0.05, "lost": 0.01, "rate": 0.03, "front": 0.02, "height": 0.03}
LARGEST |= {"energy": 0.03, "speed": 0.03, "rise": 0.03, "volume": 1e-12}
COARSE = 4.0  # times as much is allowed with 10 spacings across


def check(name: str, figures: Mapping[str, float]) -> list[str]:
    """What a run misses of what is expected; an empty list when all is well."""
    times = COARSE if name.endswith("10 across") else 1.0
    found = {key: abs(value) for key, value in figures.items() if key in LARGEST}
    return [f"{name}: {key} {value:.1e}" for key, value in found.items() if not value <= LARGEST[key] * times]


def main(
    *,
    flow: Several[Flow] | None = None,
    arch: Arch = "cpu",
    out: Path = Path("out/validation/three_d"),
) -> int:
    """Run the flows; all of them take ten minutes.

    Args:
        flow: which flows; by default all.
        arch: where the kernels run.
        out: folder for the results.
    """
    tp.init(arch=arch)
    out.mkdir(parents=True, exist_ok=True)
    summary: dict[str, dict[str, dict[str, float]]] = {}
    curves: dict[str, Curves] = {}
    missed: list[str] = []
    for name in flow or RUNS:
        summary[name] = {}
        for what, run in RUNS[name].items():
            summary[name][what], curves[name] = run()
            missed += check(f"{name}, {what}", summary[name][what])
            print(name, what, {key: f"{value:.2e}" for key, value in summary[name][what].items()}, flush=True)
    plot_flows(out / "three_d.png", curves)
    return harness.report(out, summary, missed)


if __name__ == "__main__":
    harness.command(__name__)
