"""Two rules for the interface of two fluids, measured side by side in one run.

The rule of Carvalho & Sanches, "Analysis of two-phase flows using position-based PFEM formulation":
properties are interpolated between particles, and the interface runs through the middle of edges. The
sharp rule: every element belongs to one fluid, and the interface runs along edges. Flows: layers at rest;
the dam break of Martin & Moyce (1952); layers that slosh and come to rest.
docs/theory/interfaces.md says what came out.

    summary.json      all figures
    table.md          the same as a table
    *.png             speeds at rest, fluids and budgets of the dam breaks, decay of the sloshing
    <flow>/<rule>/    history.csv and summary.json of each run

    python -m tipfem demo validation/interfaces --short
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

import numpy as np
from tipfem.demos import harness
from tipfem.demos.support.options import Arch, Count, Flag, Positive, Several
from tipfem.demos.validation.dam_break import case as dam_break
from tipfem.demos.validation.dam_break import check as experiment
from tipfem.demos.validation.dam_break import experiments
from tipfem.demos.validation.energy import run as energy
from tipfem.demos.validation.interfaces import flows, pictures

import tipfem as tp

# Resolution: spacings along an edge, or the spacing [m]; end times [s]. --short is for a look, and for the tests.
FINE: dict[str, Any] = {"rest": (22, 0.5), "dam": (0.01, 0.3), "sloshing": (20, 10.0)}
SHORT: dict[str, Any] = {"rest": (10, 0.05), "dam": (0.02, 0.12), "sloshing": (8, 1.0)}
DAM_TIME_STEP = 1e-3  # [s]
SHOWN = (0.8, 1.0)  # states of the dam break that are drawn, as parts of its end time

# Fluids and geometry: in flows.py, and in dam_break/case.py.

# Check: the largest figures that the sharp rule may show; the dam break's also have the limits of dam_break/check.py.
LARGEST_REST_SPEED = 1e-9  # [m/s]
LARGEST_VOLUME_ERROR = 1e-6
LARGEST_DECAY = 1e-6  # last kinetic energy over the largest; of runs shorter than 10 s:
LARGEST_SHORT_DECAY = 0.3
Figures = dict[str, dict[str, float]]


def rest(out: Path, cells: int, end: float) -> Figures:
    """Layers at rest, gravity along the tank and tilted: the largest speed of the run's second half [m/s]."""
    figures: Figures = {rule: {} for rule in flows.RULES}
    speeds: dict[str, Any] = {}
    for pair in flows.PAIRS:
        speeds[pair] = {}
        for gravity, tilt in (("level", 0.0), ("tilted", flows.TILT)):
            cases = {rule: flows.rest(pair, cells, tilt, rule) for rule in flows.RULES}
            name = f"{pair.replace(' ', '_')}_{gravity}"
            runs = flows.started(cases, out / name)
            flows.advance(runs, end)
            for rule, run in runs.items():
                run.finish()
                t, speed = run.column("time"), run.column("max_speed")
                speeds[pair][rule, gravity] = (t, speed)
                figures[rule][f"rest_{name}"] = float(speed[t > end / 2].max())
    pictures.rest(out / "rest.png", speeds)
    return figures


def dam(out: Path, spacing: float, end: float) -> Figures:
    """The dam break of water in air: front, slope and volume, budgets of energy and momentum, cost."""
    # Steps as short as everywhere else in this study.
    numerics = tp.Numerics()
    cases = {rule: dam_break.build(spacing, law="no-slip", interface=rule, numerics=numerics) for rule in flows.RULES}
    columns = {"front": dam_break.front, "column_height": dam_break.column_height}
    runs = flows.started(cases, out / "dam_break", time_step=DAM_TIME_STEP, columns=columns)
    start = {rule: sum(run.simulation.energy()) for rule, run in runs.items()}
    volume = {rule: run.simulation.volume("water") for rule, run in runs.items()}
    states: dict[str, list[pictures.State]] = {rule: [] for rule in runs}
    for part in SHOWN:
        flows.advance(runs, part * end)
        for rule, run in runs.items():
            states[rule].append(pictures.State.of(run.simulation))
    figures: Figures = {}
    for rule, run in runs.items():
        run.finish()
        history = run.simulation.history
        water = run.column("volume_water")
        against = experiment.figures_of(history) | {"volume_error": float(np.abs(water / volume[rule] - 1).max())}
        figures[rule] = {
            f"dam_{name}": float(value)
            for name, value in {**against, **energy.figures(history, start[rule]), **run.cost()}.items()
        }
    pictures.states(out / "dam_break.png", states, (dam_break.TANK[0], 0.6 * dam_break.TANK[1]))
    pictures.budget(out / "budget.png", {rule: run.simulation.history for rule, run in runs.items()}, volume)
    fronts = {
        f"{rule}, {1e3 * spacing:g} mm": (runs[rule].column("time"), runs[rule].column("front"))
        for rule in reversed(flows.RULES)  # so that they get the colours they have elsewhere
    }
    experiments.plot_front(out / "front.png", fronts, dam_break.COLUMN[0], dam_break.GRAVITY)
    return figures


def sloshing(out: Path, cells: int, end: float) -> Figures:
    """Viscous layers that slosh: kinetic energy at the end over its largest, and cost."""
    runs = flows.started({rule: flows.sloshing(cells, rule) for rule in flows.RULES}, out / "sloshing")
    flows.advance(runs, end)
    figures, curves = {}, {}
    for rule, run in runs.items():
        run.finish()
        t, kinetic = run.column("time"), run.column("kinetic_energy")
        curves[rule] = (t, kinetic / kinetic.max())
        late = float(np.median(curves[rule][1][t > 0.9 * end]))
        decayed = {"decay": late, "end": end, "largest_energy": float(kinetic.max())}
        figures[rule] = {f"sloshing_{name}": value for name, value in {**decayed, **run.cost()}.items()}
    pictures.decay(out / "sloshing.png", curves)
    return figures


Study = Literal["rest", "dam", "sloshing"]
STUDIES: dict[str, Callable[..., Figures]] = {"rest": rest, "dam": dam, "sloshing": sloshing}

ROWS = {
    **{
        f"rest_{pair.replace(' ', '_')}_{gravity}": f"{pair}, {gravity}: largest speed, second half [m/s]"
        for pair in flows.PAIRS
        for gravity in ("level", "tilted")
    },
    "dam_front_rms": "dam break: front against Martin & Moyce, RMS of dZ/Z",
    "dam_front_shift": "shift in time for it, in T",
    "dam_front_slope": "dZ/dT over 1.43 <= T <= 3, the run's clock",
    "dam_front_slope_shifted": "dZ/dT at the experiment's readings, shifted",
    "dam_height_rms": "height of the column, RMS of dH/H",
    "dam_volume_error": "largest change of the water's volume",
    "dam_lost_energy": "energy lost [J/m]",
    "dam_viscous_dissipation": "- by viscosity [J/m]",
    "dam_remeshing_dissipation": "- by remeshing [J/m]",
    "dam_remeshing_absolute": "the same, sum of absolute values [J/m]",
    "dam_remeshing_momentum_x": "horizontal momentum added by remeshing [N s/m]",
    "dam_remeshing_momentum_y": "vertical momentum added by remeshing [N s/m]",
    "dam_remeshing_momentum_absolute": "momentum changed by remeshing, sum of absolute values [N s/m]",
    "sloshing_decay": "sloshing: kinetic energy / largest, median of the last tenth",
    **{
        f"{flow}_{name}": f"{title}: {text}"
        for flow, title in (("dam", "dam break"), ("sloshing", "sloshing"))
        for name, text in (
            ("steps", "steps"),
            ("seconds_a_step", "seconds a step, median"),
            ("remeshing_seconds_a_step", "- remeshing"),
            ("other_seconds_a_step", "- solving and the rest"),
            ("remeshing_share", "share of remeshing"),
            ("newton_a_step", "Newton iterations per step"),
            ("krylov_a_step", "Krylov iterations per step"),
        )
    },
}


def table(figures: Figures) -> str:
    """Both rules side by side in Markdown, with the ratio where one is a cost; what was not run is left out."""
    lines = ["| | " + " | ".join(flows.RULES) + " | sharp / interpolated |", "|---|" + "---|" * 3]
    for name, text in ROWS.items():
        one, other = (figures[rule].get(name, float("nan")) for rule in flows.RULES)
        if np.isnan(one) and np.isnan(other):
            continue
        ratio = f"{other / one:.2g}" if one and not name.endswith(("_x", "_y", "_shift", "_share")) else ""
        form = ".0f" if name.endswith("_steps") else ".3g"
        lines.append(f"| {text} | {one:{form}} | {other:{form}} | {ratio} |")
    return "\n".join(lines) + "\n"


def check(figures: Figures, spacing: float, short: bool = False) -> list[str]:
    """What the sharp rule misses of what is expected of it; an empty list when all is well.

    Args:
        figures: of both rules; what was not run is not judged.
        spacing: of the dam break [m].
        short: whether they are of the short version.
    """
    sharp, other = figures["sharp"], figures["interpolated"]
    limits = {name: LARGEST_REST_SPEED for name in sharp if name.startswith("rest_")}
    limits["dam_volume_error"] = LARGEST_VOLUME_ERROR
    end = sharp.get("sloshing_end", 0.0)
    if end >= SHORT["sloshing"][1]:  # before, the wave is still at its height
        limits["sloshing_decay"] = LARGEST_DECAY if end >= FINE["sloshing"][1] else LARGEST_SHORT_DECAY
    missed = harness.above(sharp, limits)
    flow = {name.removeprefix("dam_"): value for name, value in sharp.items() if name.startswith("dam_")}
    # A coarse front is known to its spacing only.
    missed += [] if short else experiment.missed(flow, spacing)
    # At the spacing of the short version the sum of the momentum's changes scatters by a factor of two.
    for name in ("dam_remeshing_absolute", *(() if short else ("dam_remeshing_momentum_absolute",))):
        if name in sharp and not sharp[name] < other[name]:
            missed.append(f"{name} is {sharp[name]:.3g}, not below the interpolated rule's {other[name]:.3g}")
    return missed


def warm_up() -> None:
    """Compile all kernels, so that no run pays for those that others use."""
    cases = {rule: dam_break.build(0.04, law="no-slip", interface=rule) for rule in flows.RULES}
    flows.advance(flows.started(cases, None, time_step=4e-3), 0.2)


def main(
    *,
    short: Flag = False,
    only: Several[Study] | None = None,
    rest_cells: Count | None = None,
    spacing: Positive | None = None,
    sloshing_end: Positive | None = None,
    arch: Arch = "cpu",
    out: Path = Path("out/validation/interfaces"),
) -> int:
    """Run the flows with both rules.

    Args:
        short: coarse and quick, for a look, and for the tests.
        only: which flows; by default all.
        rest_cells: spacings along an edge of the layers at rest.
        spacing: of the dam break's particles [m].
        sloshing_end: simulated time of the sloshing [s].
        arch: where the kernels run.
        out: folder for the results.
    """
    sizes = dict(SHORT if short else FINE)
    sizes["rest"] = (rest_cells or sizes["rest"][0], sizes["rest"][1])
    sizes["dam"] = (spacing or sizes["dam"][0], sizes["dam"][1])
    sizes["sloshing"] = (sizes["sloshing"][0], sloshing_end or sizes["sloshing"][1])
    figures: Figures = {rule: {} for rule in flows.RULES}
    seconds: dict[str, float] = {}
    out.mkdir(parents=True, exist_ok=True)
    tp.init(arch=arch)
    warm_up()
    for name in only or STUDIES:
        began = time.perf_counter()
        for rule, found in STUDIES[name](out, *sizes[name]).items():
            figures[rule] |= found
        seconds[name] = round(time.perf_counter() - began, 1)
        print(f"{name}: {seconds[name]:.0f} s", flush=True)
    (out / "table.md").write_text(table(figures), encoding="utf-8")
    print(table(figures))
    summary = {"short": short, "wall_seconds": seconds, "figures": figures}
    return harness.report(out, summary, check(figures, sizes["dam"][0], short))


if __name__ == "__main__":
    harness.command(__name__)
