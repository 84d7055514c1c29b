"""Flows through openings, and waves, against theory, experiments and computations of others.

summary.json   the figures of all flows
openings.png   what they differ by from what they are compared with

python -m tipfem demo validation/openings --flow poiseuille weir
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal

from tipfem.demos import harness
from tipfem.demos.support.figures import plot_differences
from tipfem.demos.support.options import Arch, Count, Several
from tipfem.demos.validation.openings import channels, water, waves

import tipfem as tp

Flow = Literal[
    "uniform",
    "poiseuille",
    "layers",
    "vortex",
    "step",
    "cylinder",
    "shedding",
    "overfall",
    "weir",
    "broad_weir",
    "bore",
    "waves",
    "plate",
]


@dataclass(frozen=True)
class Compared:
    """What a figure is compared with.

    Attributes:
        value: the reference, a number or the name of another figure.
        within: largest difference, relative to the reference, or absolute where that is 0.
    """

    value: float | str
    within: float


@dataclass(frozen=True)
class Study:
    """A flow with its figures.

    Attributes:
        run: from the resolution to the figures.
        across: spacings in the length that the flow has.
        compared: figures by name, with what they are compared with.
    """

    run: Callable[[int], dict[str, float]]
    across: int
    compared: Mapping[str, Compared]


STUDIES: dict[str, Study] = {
    "uniform": Study(channels.uniform, 8, {"velocity": Compared(0, 1e-9), "refused": Compared(0, 0)}),
    "poiseuille": Study(channels.poiseuille, 20, {"velocity": Compared(0, 0.003), "gradient": Compared(0, 0.003)}),
    "layers": Study(channels.layers, 16, {"velocity": Compared(0, 0.01), "interface": Compared(0, 0.02)}),
    "vortex": Study(channels.vortex, 32, {"left": Compared(0, 0.01)}),
    # E. Erturk, Numerical solutions of 2-D steady incompressible flow over a backward-facing step, 2008.
    "step": Study(channels.step, 10, {"reattachment": Compared(2.922, 0.05)}),
    # M. Schaefer and S. Turek, Benchmark computations of laminar flow around a cylinder, 1996: 2D-1 and 2D-2. They have
    # the largest drag of the latter, 3.22 to 3.24; its mean is about 3.19.
    "cylinder": Study(partial(channels.cylinder, reynolds=20.0, end=6.0), 12, {"drag": Compared(5.58, 0.05)}),
    "shedding": Study(channels.cylinder, 20, {"drag": Compared(3.19, 0.05), "strouhal": Compared(0.300, 0.03)}),
    "overfall": Study(water.overfall, 6, {"brink": Compared("hager", 0.03)}),
    "weir": Study(water.weir, 12, {"coefficient": Compared("expected", 0.03)}),
    "broad_weir": Study(partial(water.weir, broad=True), 12, {"coefficient": Compared("expected", 0.03)}),
    "bore": Study(water.bore, 6, {"depth": Compared(1.0, 0.03)}),
    "waves": Study(waves.regular, 10, {"height": Compared(1.0, 0.03), "reflection": Compared(0, 0.05)}),
    "plate": Study(
        waves.plate, 6, {"transmission": Compared("passes", 0.1), "reflection": Compared("comes back", 0.1)}
    ),
}


# Those that are as close to their references as is asked for: the others take minutes, and two of them miss.
USUAL = ("uniform", "poiseuille", "layers", "vortex", "step", "cylinder", "shedding", "overfall", "weir", "waves")


def differences(name: str, figures: Mapping[str, float]) -> dict[str, tuple[float, float]]:
    """What the figures of a flow differ by from what they are compared with, and what they may differ by [%]."""
    found = {}
    for key, compared in STUDIES[name].compared.items():
        value = compared.value if isinstance(compared.value, int | float) else figures[compared.value]
        found[f"{name}: {key}"] = 100 * (figures[key] - value) / (abs(value) or 1.0), 100 * compared.within
    return found


def check(name: str, figures: Mapping[str, float]) -> list[str]:
    """What a flow misses of what is expected; an empty list when all is well."""
    found = differences(name, figures).items()
    return [f"{key} is off by {by:.2g} %, allowed {may:.2g} %" for key, (by, may) in found if not abs(by) <= may]


def main(
    *,
    flow: Several[Flow] = USUAL,
    across: Count | None = None,
    arch: Arch = "cpu",
    out: Path = Path("out/validation/openings"),
) -> int:
    """Run flows and compare their figures.

    Args:
        flow: which flows; by default those that come as close as is asked for.
        across: spacings in the length that each flow has; by default its own.
        arch: where the kernels run.
        out: folder for the results.
    """
    tp.init(arch=arch)
    out.mkdir(parents=True, exist_ok=True)
    figures: dict[str, Any] = {}
    missed: list[str] = []
    off: dict[str, tuple[float, float]] = {}
    for name in flow:
        study = STUDIES[name]
        found = study.run(across or study.across)
        missed += check(name, found)
        off |= {key: pair for key, pair in differences(name, found).items() if pair[1]}
        # JSON has no NaN.
        figures[name] = {key: None if math.isnan(value) else value for key, value in found.items()}
        figures[name]["across"] = across or study.across
        print(name, figures[name], flush=True)
    plot_differences(out / "openings.png", off)
    return harness.report(out, figures, missed)


if __name__ == "__main__":
    harness.command(__name__)
