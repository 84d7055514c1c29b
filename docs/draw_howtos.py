"""Draw the pictures of how-tos that have no demo: docs/images/howto_*.webp, from runs of some seconds each.

    python docs/draw_howtos.py

The cases are those of the pages; the dam break at 5 mm takes most of the minutes. ``--only NAME`` draws one.
"""

from __future__ import annotations

import re
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import cyclopts
import numpy as np
from PIL import Image
from tipfem.render import Results, Scene, View, animate, render_frame

import tipfem as tp

DOCS = Path(__file__).resolve().parent
CASE = "drop.toml"


def page_block(page: str, language: str, *, of: str = "") -> str:
    """The first block of code in a language, with a word in it, on a page of the how-tos."""
    text = (DOCS / "howto" / f"{page}.md").read_text("utf-8")
    found = re.findall(rf"^```{language}\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
    return next(block for block in found if of in block)


def run_drop(folder: Path, name: str, end: float, **values: float) -> Path:
    """The results of the case file of the page on case files, with other values."""
    (folder / CASE).write_text(page_block("case-files", "toml"), "utf-8")
    changes = {"time.end": end, "output.interval": 0.01, **values}
    words = [word for key, value in changes.items() for word in ("--set", f"{key.replace('__', '.')}={value}")]
    out = folder / name
    if out.exists():
        return out
    command = [sys.executable, "-m", "tipfem", "run", str(folder / CASE), "--out", str(out), "--no-progress", *words]
    subprocess.run(command, check=True)
    return out


def keep(image: Image.Image, name: str, width: int) -> None:
    """Write a picture, no wider than it is on a page."""
    height = round(image.height * width / image.width)
    image.convert("RGB").resize((width, height), Image.Resampling.LANCZOS).save(
        DOCS / "images" / f"howto_{name}.webp", quality=85, method=6
    )


def beside(parts: Sequence[Image.Image]) -> Image.Image:
    """Pictures of one height, side by side."""
    sheet = Image.new("RGB", (sum(part.width for part in parts), max(part.height for part in parts)), "white")
    at = 0
    for part in parts:
        sheet.paste(part, (at, 0))
        at += part.width
    return sheet


def shown(out: Path, time: float, title: str, size: tuple[int, int]) -> Image.Image:
    """A run at a time, with a title."""
    results = Results(out)
    results.title = title
    return Image.fromarray(
        render_frame(
            results.scene(int(np.argmin(np.abs(np.array(results.times) - time)))), size, view=View(smooth=True)
        )
    )


def draw_case_file(folder: Path) -> None:
    """The movie of the case file."""
    out = run_drop(folder, "drop", 0.5)
    done = animate(out, frames=False, movie="drop.webp", size=(420, 386), playback_rate=12.5)
    (DOCS / "images" / "howto_case_file.webp").write_bytes(done.movies[0].read_bytes())


def draw_study(folder: Path) -> None:
    """Water, and the thick run of the study, at one time."""
    runs = [
        (f"{value:g} Pa s", run_drop(folder, f"v{value}", 0.4, fluids__water__viscosity=value)) for value in (1e-3, 0.1)
    ]
    keep(beside([shown(out, 0.4, f"viscosity {text}", (520, 520)) for text, out in runs]), "study", 800)


def draw_resolution(folder: Path) -> None:
    """The dam break at three spacings."""
    parts = []
    for spacing in (0.02, 0.01, 0.005):
        out = folder / f"dam_{spacing}"
        words = ["demo", "dam_break", "--spacing", str(spacing), "--no-frames", "--no-progress", "--out", str(out)]
        if not out.exists():
            subprocess.run([sys.executable, "-m", "tipfem", *words], check=False)  # coarse ones may miss the check
        parts.append(shown(out, 0.36, f"{1000 * spacing:g} mm", (520, 620)))
    keep(beside(parts), "resolution", 1000)


def draw_own_particles(folder: Path) -> None:
    """The particles of the page and their mesh."""
    space: dict[str, Any] = {}
    exec(page_block("own-particles", "python"), space)
    sim, particles = space["sim"], space["sim"].particles
    scene = Scene(
        position=particles.position,
        cells=sim.mesh.cells,
        fluid=particles.fluid,
        wall=particles.wall,
        cell_fluid=sim.mesh.fluid,
        fluid_names=("glycerin", "water"),
        fluid_densities=(1261.0, 998.2),
        spacing=particles.spacing,
    )
    keep(Image.fromarray(render_frame(scene, (900, 640), mesh=True, particles=True)), "own_particles", 640)


def draw_slope(folder: Path) -> None:
    """The column in the tank with a slope, at three times."""
    space: dict[str, Any] = {"tp": tp, "water": tp.Fluid("water", 998.2, 1.002e-3)}
    exec(page_block("shapes", "python", of="solids"), space)
    out = folder / "slope"
    if not out.exists():
        tp.Simulation(space["run_up"], out, output_interval=0.1).run(0.6, progress=False)
    done = animate(out, size=(640, 440))
    keep(beside([Image.open(done.frames[k]) for k in (0, 3, 6)]), "slope", 1200)


def draw_progress(folder: Path) -> None:
    """Length of the steps of a dam break, and the energy of a run that is stopped and goes on."""
    import matplotlib.pyplot as plt

    water = tp.Fluid("water", density=998.2, viscosity=1.002e-3)
    air = tp.Fluid("air", density=1.204, viscosity=1.825e-5)
    tank = tp.tank(size=(0.584, 0.584), spacing=0.02).fill(air).fill(water, box=((0, 0), (0.146, 0.292)))
    case = tp.Case(tank, fluids=[water, air], gravity=(0, -9.81))
    whole = tp.Simulation(case, time_step=4e-3)
    whole.run(0.2, progress=False)
    whole.run(0.4, progress=False)
    first = tp.Simulation(case, out=folder / "first", time_step=4e-3)
    first.run(0.2, progress=False)
    second = tp.Simulation.resume(folder / "first")
    second.run(0.4, progress=False)

    figure, axes = plt.subplots(figsize=(6.4, 2.8), layout="constrained")
    time = np.array([row["time"] for row in whole.history])
    axes.step(time, [1000 * row["time_step"] for row in whole.history], where="pre", color="#0072b2", lw=1.4)
    axes.set(xlabel="t [s]", ylabel="length of the step [ms]", ylim=(0, None))
    figure.savefig(folder / "progress.png", dpi=160)
    keep(Image.open(folder / "progress.png"), "progress", 760)

    figure, axes = plt.subplots(figsize=(6.4, 2.8), layout="constrained")
    axes.plot(time, [row["kinetic_energy"] for row in whole.history], color="#c3c8cf", lw=5, label="not stopped")
    for run, colour, text in ((first, "#0072b2", "to 0.2 s"), (second, "#d55e00", "resumed")):
        rows = [row for row in run.history if run is first or row["time"] > 0.2]
        axes.plot(
            [row["time"] for row in rows], [row["kinetic_energy"] for row in rows], color=colour, lw=1.4, label=text
        )
    axes.set(xlabel="t [s]", ylabel="kinetic energy [J/m]")
    axes.legend(frameon=False)
    figure.savefig(folder / "resume.png", dpi=160)
    keep(Image.open(folder / "resume.png"), "resume", 760)
    assert second.history[-1]["kinetic_energy"] == whole.history[-1]["kinetic_energy"]


def draw_films(folder: Path) -> None:
    """The sheet of the page, without and with a resolution of films."""
    import matplotlib.pyplot as plt

    space: dict[str, Any] = {"tp": tp, "water": tp.Fluid("water", 998.2, 1.002e-3)}
    exec(page_block("grading", "python", of="stretched"), space)
    case = tp.Case(space["tank"], [space["water"]], (0, 0), free_surface=True)
    figure, axes = plt.subplots(2, figsize=(8, 2.2), layout="constrained")
    for axis, run in zip(axes, (tp.Simulation(case, time_step=0.01), space["sheet"]), strict=True):
        run.run(1.5, progress=False)
        x, y = 1000 * run.mesh.position.T
        axis.triplot(x, y, run.mesh.cells, lw=0.5, color="#0072b2")
        axis.set(xlim=(400, 600), ylim=(40, 60), ylabel="y [mm]", aspect="equal")
    axes[1].set_xlabel("x [mm]")
    figure.savefig(folder / "films.png", dpi=160)
    keep(Image.open(folder / "films.png"), "films", 960)


PICTURES: dict[str, Callable[[Path], None]] = {
    "case_file": draw_case_file,
    "study": draw_study,
    "own_particles": draw_own_particles,
    "slope": draw_slope,
    "films": draw_films,
    "progress": draw_progress,
    "resolution": draw_resolution,
}


def main(*, only: str | None = None, runs: Path | None = None) -> None:
    """Make the runs, and draw.

    Args:
        only: name of one picture.
        runs: folder of runs, among which those that are there are not made again.
    """
    if only is not None and only not in PICTURES:
        raise SystemExit(f"--only is {only!r}; it must be one of {list(PICTURES)}")
    tp.init(threads=1)
    with tempfile.TemporaryDirectory() as folder:
        for name, draw in PICTURES.items():
            if only in (None, name):
                draw(runs or Path(folder))


if __name__ == "__main__":
    cyclopts.run(main)
