"""Bodies that touch walls and each other, against equilibrium, Coulomb's law, and the law of thin films.

    slope     boxes on dry slopes, below and above their friction
    stack     two boxes, one on the other
    tumble    a box that falls on its corner, and comes to rest on a side
    bounce    a ball that falls on a dry floor, with coefficients of restitution
    gate      a closed gate with water behind it
    stand     a box on the floor under water, with the water's pressure below it and without
    land      the same box, which falls under water: the time until it lands, and what it carries then
    lift      a light box, let go on the floor under water: when and how fast the film below it opens
    push      a dam break that pushes a box along the floor
    full      a box that is lifted off the floor of a full tank, and put down, in one fluid and in two
    flap      a flap on a closed gap that makes waves, whose height is that of linear theory, by the spacing
    baffle    sloshing over a thin baffle: its period, by the spacing

What is refused is tried, too, and the messages are printed.

    summary.json      figures of all flows, and the messages
    contact.png       heights of balls that bounce, the gap below the box that lands, the one below a box that
                      lifts off, the displacement of the box that is pushed, and the flap's waves

    python -m tipfem demo validation/contact --flow stand push
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Literal

from tipfem.demos import harness
from tipfem.demos.support.figures import Curves, plot_flows
from tipfem.demos.support.options import Arch, Flag, Several
from tipfem.demos.validation.contact import flows

import tipfem as tp

Flow = Literal["slope", "stack", "tumble", "bounce", "gate", "stand", "land", "lift", "push", "full", "flap", "baffle"]
# Largest figures of each flow, by their size: relative errors, speeds [m/s], lengths [spacings], energies [J/m].
LIMITS: dict[str, dict[str, float]] = {
    "slope": {"speed": 1e-6, "weight": 1e-5},
    "stack": {"speed": 1e-9, "weight": 1e-8},
    "tumble": {"rise": 1e-6, "height": 1e-6, "angle": 1e-5, "energy": 1e-8},
    "bounce": {"rise 0.9": 5e-4, "rise 0.8": 5e-4, "rise 0.5": 5e-4, "energy": 1e-8},
    "gate": {"force": 2e-5, "speed": 1e-10},
    "stand": {"seep": 1e-6, "seal": 1e-6, "speed": 1e-8},
    "land": {"time": 0.1, "carried": 0.03, "rebound": 0.05, "gap": 1e-3, "energy": 1e-7},
    "lift": {"time": 0.1, "speed": 0.1, "opened": 0.35, "energy": 1e-7},
    "push": {"friction": 1e-6, "lifted": 2e-3, "energy": 1e-7},
    "full": {"volume": 1e-10, "energy": 1e-10},
    "flap": {"height 10": 0.04, "height 20": 0.02, "behind": 0.0, "volume": 1e-12},
    "baffle": {"period 12": 0.015, "period 24": 0.01, "period 48": 0.005},
}


def check(flow: str, figures: Mapping[str, float]) -> list[str]:
    """What a flow misses, a line each."""
    sizes = {f"{flow}: {name}": abs(value) for name, value in figures.items()}
    return harness.above(sizes, {f"{flow}: {name}": limit for name, limit in LIMITS[flow].items()})


def main(
    *,
    flow: Several[Flow] | None = None,
    short: Flag = False,
    arch: Arch = "cpu",
    out: Path = Path("out/validation/contact"),
) -> int:
    """Run flows and compare their figures.

    Args:
        flow: which flows; by default all.
        short: coarser, or not as long.
        arch: where the kernels run.
        out: folder for the results.
    """
    tp.init(arch=arch)
    out.mkdir(parents=True, exist_ok=True)
    figures: dict[str, dict[str, float]] = {}
    curves: dict[str, Curves] = {}
    missed: list[str] = []
    for name in flow or LIMITS:
        figures[name], drawn = getattr(flows, name)(short)
        if drawn:
            curves[name] = drawn
        missed += check(name, figures[name])
        print(name, {key: f"{value:.3g}" for key, value in figures[name].items()}, flush=True)
    messages = {what: flows.refusal(what) for what in flows.REFUSED}
    for what, message in messages.items():
        print(f"refused: {what}: {message}")
    missed += [f"{what} is not refused" for what, message in messages.items() if not message]
    if curves:
        plot_flows(out / "contact.png", curves)
    return harness.report(out, {"flows": figures, "refused": messages}, missed)


if __name__ == "__main__":
    harness.command(__name__)
