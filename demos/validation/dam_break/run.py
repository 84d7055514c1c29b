"""The dam break of Martin & Moyce (1952) at several spacings, or finished runs of it, in one figure.

fronts.png        the fronts of all runs among the experiments
summary.json      figures of all runs
<spacing>/        history.csv and summary.json of each run

python -m tipfem demo validation/dam_break --spacing 0.01 0.005
python -m tipfem demo validation/dam_break --compare out/5mm out/2mm
"""

from __future__ import annotations

import csv
import json
from collections.abc import Sequence
from pathlib import Path

from tipfem.demos import harness
from tipfem.demos.support.options import Arch, Positives, Rule, Several
from tipfem.demos.validation.dam_break import case, check, experiments

import tipfem as tp

# Resolution.
SPACINGS = (0.01, 0.005)  # [m]
END_TIME = 0.3  # [s]; T = 3.5


def read_run(folder: Path) -> tuple[float, bool, list[dict[str, float]]]:
    """Spacing [m], whether it was graded, and history of a finished run of the dam break.

    Raises:
        ValueError: the folder holds none.
    """
    try:
        summary = json.loads((folder / "summary.json").read_text("utf-8"))
        spacing, graded = float(summary["spacing"]), summary.get("grading") is not None
        with (folder / "history.csv").open(encoding="utf-8", newline="") as file:
            rows = [{name: float(value) for name, value in row.items()} for row in csv.DictReader(file)]
        check.fronts_of(rows)
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ValueError(f"{folder}: no finished run of the dam break: {type(error).__name__}: {error}") from error
    return spacing, graded, rows


def compared(folders: Sequence[Path], out: Path) -> dict[str, dict[str, float]]:
    """Draw the fronts of finished runs in one figure, ``out``/fronts.png, and print their figures.

    Returns:
        The figures of each run by its label, from the coarsest to the finest.

    Raises:
        ValueError: a folder holds no such run.
    """
    runs, found, shift = {}, {}, 0.0
    for spacing, graded, history in sorted((read_run(folder) for folder in folders), key=lambda run: -run[0]):
        label = check.label(spacing, "graded" if graded else "")
        while label in runs:
            label += "'"
        figures = check.figures_of(history)
        runs[label], shift = check.fronts_of(history), figures.get("front_shift", shift)
        figures["volume_error"] = max(figures["volume_error"], 1e-9)  # the file has nine digits
        found[label] = figures
        print(f"{label}: " + ", ".join(f"{name} {value:.4g}" for name, value in figures.items()))
    # Of the experiment's clock there is one: that of the finest run.
    experiments.plot_front(out / "fronts.png", runs, case.COLUMN[0], case.GRAVITY, shift=shift)
    return found


def simulate(spacing: float, interface: str, out: Path) -> tuple[Path, list[str]]:
    """Run the dam break at a spacing [m]; the folder of its results, and what its check misses."""
    simulation = tp.Simulation(
        case.build(spacing, interface=interface),
        out=out / f"{spacing * 1e3:g}mm",
        time_step=case.TIME_STEP,
        columns={"front": case.front, "column_height": case.column_height},
    )
    simulation.run(END_TIME)
    missed = check.missed(check.figures_of(simulation.history), spacing)
    return out / f"{spacing * 1e3:g}mm", [f"{check.label(spacing)}: {text}" for text in missed]


def main(
    *,
    spacing: Positives = SPACINGS,
    interface: Rule = "sharp",
    arch: Arch = "cpu",
    out: Path = Path("out/validation/dam_break"),
    compare: Several[Path] | None = None,
) -> int:
    """Run the dam break at each spacing.

    Args:
        spacing: of each run [m].
        interface: rule for the interface.
        arch: where the kernels run.
        out: folder for the results.
        compare: run nothing; draw the fronts of these folders of finished runs in one figure, fronts.png.
    """
    if compare:
        compared(compare, out)
        print(f"results: {(out / 'fronts.png').resolve()}")
        return 0
    tp.init(arch=arch)
    runs = [simulate(h, interface, out) for h in spacing]
    figures = compared([folder for folder, _ in runs], out)
    missed = [text for _, texts in runs for text in texts]
    return harness.report(out, {"interface": interface, "figures": figures}, missed)


if __name__ == "__main__":
    harness.command(__name__)
