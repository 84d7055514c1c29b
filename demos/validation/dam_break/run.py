"""The dam break of Martin & Moyce (1952) at several spacings, or finished runs of it, in one figure.

fronts.png        the fronts of all runs among the experiments
summary.json      figures of all runs
<spacing>/        history.csv and summary.json of each run

python -m tipfem demo validation/dam_break --spacing 0.01 0.005
python -m tipfem demo validation/dam_break --compare out/5mm out/2mm
"""

from __future__ import annotations

import argparse
import csv
import json
from collections.abc import Sequence
from pathlib import Path

from tipfem.demos import harness
from tipfem.demos.support.options import ShowDefaults
from tipfem.demos.validation.dam_break import case, check, experiments

import tipfem as tp
from tipfem.case.case import DEFAULT_INTERFACE, INTERFACES

# Resolution.
SPACINGS = [0.01, 0.005]  # [m]
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


def compare(folders: Sequence[Path], out: Path) -> dict[str, dict[str, float]]:
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
    harness.run_to_end(simulation, END_TIME)
    missed = check.missed(check.figures_of(simulation.history), spacing)
    return out / f"{spacing * 1e3:g}mm", [f"{check.label(spacing)}: {text}" for text in missed]


def main(words: Sequence[str] | None = None) -> None:
    """Run with the given command line, or the process's."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n")[0], formatter_class=ShowDefaults)
    add = parser.add_argument
    add("--spacing", type=harness.positive, nargs="+", default=SPACINGS, metavar="H", help="of each run [m]")
    add("--interface", choices=sorted(INTERFACES), default=DEFAULT_INTERFACE, help="rule for the interface")
    add("--arch", choices=["cpu", "cuda"], default="cpu", help="where the kernels run; cuda is untried")
    add("--out", type=Path, default=Path("out/validation/dam_break"), metavar="FOLDER", help="for the results")
    add(
        "--compare",
        type=Path,
        nargs="+",
        default=[],
        metavar="RUN",
        help="run nothing; draw the fronts of these folders of finished runs in one figure, fronts.png",
    )
    given = parser.parse_args(words)
    missed: list[str] = []
    with harness.one_message():
        if given.compare:
            compare(given.compare, given.out)
        else:
            tp.init(arch=given.arch)
            runs = [simulate(spacing, given.interface, given.out) for spacing in given.spacing]
            figures = compare([folder for folder, _ in runs], given.out)
            missed = [text for _, texts in runs for text in texts]
            summary = {"interface": given.interface, "figures": figures, "check": missed or "passed"}
            (given.out / "summary.json").write_text(json.dumps(summary, indent=2) + "\n", encoding="utf-8")
    if given.compare:
        print(f"results: {(given.out / 'fronts.png').resolve()}")
    else:
        harness.conclude(given.out, missed)


if __name__ == "__main__":
    main()
