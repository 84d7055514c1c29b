"""Flows with surface tension, against closed forms and reference solutions.

static           a drop at rest: capillary number over 1000 steps, jump of the pressure
sessile          drops that come to rest on a floor, at angles from 30 to 150 degrees
spreading        drops that are let go on a floor: speed of their contacts, at three spacings
meniscus         between two plates: height of its contacts, and its order
rise             a liquid in a narrow and a wide arm: difference of the heights
lens             of oil on water: its width and angles
floating         discs that float by tension: their height, and that of their contacts
plate            a plate that stands in a liquid: the force on it
hanging          drops under a ceiling, which hang or drip
incline          drops that two contact angles hold on an incline, and that slide
oscillating      a drop that swings: its frequency
moving           a drop of water that flies through air: Krylov iterations
wave             a standing capillary wave, against Prosperetti's solution
bubble           a bubble that rises, against the benchmark of Hysing et al.
rayleigh-taylor  a heavy fluid on a light one: critical wave number
kelvin-helmholtz two streams: rate of growth with tension
dam_break        the dam break with tension and without: front and time
film             a film with a free end: its speed

summary.json     figures of all runs
drops.csv        the same, beside what is expected
bubble.png       the bubble's height, velocity and circularity

python -m tipfem demo validation/drops --flow static bubble
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np
from tipfem.demos import harness
from tipfem.demos.support.figures import COLOURS, new_figure, save
from tipfem.demos.support.options import Arch, Several
from tipfem.demos.validation.drops import at_rest, in_motion, theory
from tipfem.demos.validation.periodic import run as periodic

import tipfem as tp

TENSION = 100.0  # of the interface between two streams [N/m]; their instability grows at 0.56 of the rate without
Figures = dict[str, Any]


def _named(measure: Callable[..., Figures], text: str, values: tuple[Any, ...]) -> dict[str, Callable[[], Figures]]:
    """Runs of a measure, by their names: a text with the value in it."""
    return {text.format(value): lambda value=value: measure(value) for value in values}  # type: ignore[misc]


RUNS: dict[str, dict[str, Callable[[], Figures]]] = {
    "static": _named(at_rest.static, "density ratio {}", (0.001, 0.999, 1.0, 1.001, 1000.0))
    | {"density ratio 1.0, 16 spacings": lambda: at_rest.static(1.0, 16, 200)},
    "sessile": {
        f"{angle} degrees, {wall}": lambda angle=angle, wall=wall: at_rest.sessile(float(angle), wall)  # type: ignore[misc]
        for angle, wall in [*((a, "slip") for a in (30, 60, 120, 150)), (60, "layer"), (120, "no-slip")]
    },
    "spreading": _named(lambda half: at_rest.spreading("no-slip", half), "no-slip, {} spacings", (5, 10, 20))
    | _named(lambda half: at_rest.spreading("slip", half), "slip length, {} spacings", (5, 10, 20)),
    "meniscus": _named(lambda half: at_rest.meniscus(30.0, half), "30 degrees, {} spacings in half the gap", (8, 16))
    | _named(lambda half: at_rest.meniscus(120.0, half), "120 degrees, {} spacings in half the gap", (8, 16)),
    "rise": _named(lambda half: at_rest.rise(30.0, half), "{} spacings in half the narrow arm", (4, 6)),
    "lens": _named(at_rest.lens, "under {}", ("empty space", "air")),
    "floating": {
        "heavy, 120 degrees, no-slip": lambda: at_rest.floating(120.0, 1.1, "no-slip"),
        "light, 60 degrees, slip": lambda: at_rest.floating(60.0, 0.7, "slip"),
    },
    "plate": {
        "60 degrees, no-slip": lambda: at_rest.plate(60.0, "no-slip"),
        "120 degrees, slip": lambda: at_rest.plate(120.0, "slip"),
    },
    "hanging": _named(at_rest.hanging, "{} of the largest", (0.9, 1.1)),
    "incline": _named(at_rest.incline, "{} of the largest force", (0.98, 1.02)),
    "oscillating": _named(in_motion.oscillating, "density ratio {}", (0.001, 1.0))
    | _named(lambda across: in_motion.oscillating(0.001, across), "{} spacings", (8, 32)),
    "moving": _named(in_motion.moving, "{} mm", (0.2, 0.1)),
    "wave": _named(in_motion.wave, "{} spacings", (16, 32)),
    "bubble": _named(in_motion.bubble, "{} spacings", (40, 80)),
    "rayleigh-taylor": _named(in_motion.rayleigh_taylor, "{} spacings", (16, 32)),
    "kelvin-helmholtz": _named(lambda n: periodic.shear(n, 12.0, TENSION), "{} particles in the thickness", (3, 6)),
    "dam_break": _named(in_motion.dam_break, "{} m", (0.01, 0.005)),
    "film": _named(in_motion.film, "{} spacings in the thickness", (4, 6)),
}
Flow = Literal[
    "static", "sessile", "spreading", "meniscus", "rise", "lens", "floating", "plate", "hanging", "incline",
    "oscillating", "moving", "wave", "bubble", "rayleigh-taylor", "kelvin-helmholtz", "dam_break", "film",
]  # fmt: skip
# The largest magnitude of each figure: in all runs of a flow, or in those whose names begin with a text.
LARGEST: dict[str, list[tuple[str, str, float]]] = {
    "static": [("", "capillary_number", 1e-10), ("", "volume", 1e-12), ("", "krylov_iterations", 30)],
    "sessile": [("", "radius", 0.005), ("60 degrees, layer", "angle", 1.0), ("120 degrees, no-slip", "angle", 1.0)],
    "spreading": [("no-slip", "speed", 0.05), ("slip", "speed", 0.065)],
    "meniscus": [("", "height", 0.01)],
    "rise": [("", "height", 0.01)],
    "lens": [("", "width", 0.01), ("", "upper", 1.0), ("", "lower", 1.0)],
    "floating": [("", "height", 0.03), ("", "contact", 0.03)],
    "plate": [("", "force", 0.01), ("", "contact", 0.03)],
    "hanging": [("", "wrong", 0.0)],
    "incline": [("", "wrong", 0.0)],
    "oscillating": [
        ("density ratio 0.001", "frequency", 0.005),
        ("density ratio 1.0", "frequency", 0.01),
        ("8", "frequency", 0.015),
        ("32", "frequency", 0.005),
    ],
    "moving": [("", "krylov_iterations", 30), ("", "first_step", 30)],
    "wave": [("16", "error", 0.018), ("32", "error", 0.005)],
    "bubble": [
        ("80", "height", 1e-4),
        ("80", "velocity", 1e-3),
        ("80", "circularity", 5e-4),
        ("", "krylov_iterations", 12),
    ],
    "rayleigh-taylor": [("32", "wave_number", 0.02), ("32", "slope", 0.02)],
    "kelvin-helmholtz": [("6", "error", 0.02)],
    "dam_break": [("", "front", 0.01), ("0.005", "time", 1.25)],
    "film": [("", "speed", 0.02)],
}


def check(flow: str, results: Mapping[str, Figures]) -> list[str]:
    """What the runs of a flow, by their names, miss of what is expected; an empty list when all is well."""
    return [
        f"{flow}, {run}: {name} is {figures[name]:.3g}, not {largest:g} at most"
        for begin, name, largest in LARGEST[flow]
        for run, figures in results.items()
        if run.startswith(begin) and not abs(figures[name]) <= largest
    ]


def write_table(path: Path, results: Mapping[str, Mapping[str, Figures]]) -> None:
    """Write the figures of all runs with the largest magnitudes that are allowed."""
    with path.open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(["flow", "run", "figure", "found", "allowed"])
        for flow, runs in results.items():
            for run, figures in runs.items():
                allowed = {name: most for begin, name, most in LARGEST[flow] if run.startswith(begin)}
                for name, value in figures.items():
                    if name != "course":
                        table.writerow([flow, run, name, f"{value:.3g}", allowed.get(name, "")])


def plot(path: Path, results: Mapping[str, Figures]) -> None:
    """Draw the course of the bubble beside the benchmark's.

    Raises:
        ImportError: there is no matplotlib.
    """
    figure, wanted = new_figure(10, 3.6), theory.rising_bubble()
    labels = {"height": "height of the centre [m]", "velocity": "velocity [m/s]", "circularity": "circularity"}
    columns = ("time", "circularity", "height", "velocity")
    places = figure.subplots(1, 3)
    for axes, (name, label) in zip(places, labels.items(), strict=True):
        for number, (run, figures) in enumerate(results.items()):
            course = np.array(figures["course"])
            axes.plot(course[:, 0], course[:, columns.index(name)], color=COLOURS[number], label=run)
        axes.plot(wanted["time"], wanted[name], "k--", linewidth=1, label="Hysing et al., finest mesh")
        axes.set(xlabel="time [s]", ylabel=label)
        axes.grid(alpha=0.3)
    places[0].legend()
    save(figure, path)


def main(*, flow: Several[Flow] | None = None, arch: Arch = "cpu", out: Path = Path("out/validation/drops")) -> int:
    """Run the flows at all resolutions.

    Args:
        flow: which flows; by default all.
        arch: where the kernels run.
        out: folder for the results.
    """
    tp.init(arch=arch)
    out.mkdir(parents=True, exist_ok=True)
    results: dict[str, dict[str, Figures]] = {}
    for name in flow or RUNS:
        results[name] = {}
        for run, measured in RUNS[name].items():
            results[name][run] = figures = measured()
            print(name, run, {key: value for key, value in figures.items() if key != "course"}, flush=True)
    write_table(out / "drops.csv", results)
    if "bubble" in results:
        plot(out / "bubble.png", results["bubble"])
    return harness.report(out, results, [text for name in results for text in check(name, results[name])])


if __name__ == "__main__":
    harness.command(__name__)
