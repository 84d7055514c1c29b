"""Draw docs/images/layers.svg: the folders of tipfem/, each importing only from those below it.

    python docs/draw_layers.py

The layers are those of the import-linter contract in pyproject.toml.
"""

from __future__ import annotations

import re
from html import escape
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PICTURE = ROOT / "docs" / "images" / "layers.svg"

# What each part is for, in a line.
WHAT = {
    "casefile": "cases in TOML, and the commands for them",
    "study": "many runs of one case",
    "simulation": "the step and the run",
    "resuming": "checkpoints of a run, and the way back",
    "resume_changes": "what a run that goes on may change",
    "run": "a run to a time: outputs, checkpoints, signals",
    "checkpoint": "files to go on from",
    "liveview": "running simulations in the viewer",
    "steering": "commands between steps",
    "viewer": "results and runs in a browser",
    "results": "results read back",
    "fields": "states in files",
    "remeshing_table": "what repairs of the mesh add",
    "tables": "tables of columns",
    "notebook": "what notebooks show",
    "state": "particles, mesh and material at one time",
    "output": "results folder",
    "probes": "measured on the way",
    "progress": "bar and lines",
    "step": "one step: equations, solution, budget",
    "remesh": "the mesh of the next step",
    "walls": "slipping, sliding, moving walls in a step",
    "fem": "residual, Jacobian, time integration",
    "linalg": "Newton, FGMRES, multigrid",
    "mesh": "triangulations, interfaces, free surfaces",
    "case": "what the user describes: fluids, tank, walls, numbers",
    "backend": "Taichi: start-up, launching kernels, arrays, threads",
    "arguments": "checks",
    "errors": "errors",
    "folder_lock": "one run a folder",
    "logs": "the log",
    "timers": "timers",
    "typing": "types",
}
WIDTH, HEIGHT, GAP, MARGIN = 720, 40, 10, 12


def layers(text: str) -> list[list[str]]:
    """The layers of the contract, top first; each is a list of names in tipfem/."""
    listed = re.search(r"^layers = \[(.*?)^\]", text, re.MULTILINE | re.DOTALL)
    if listed is None:
        raise ValueError("pyproject.toml has no layers")
    return [re.findall(r"tipfem\.(\w+)", line) for line in re.findall(r'"([^"]+)"', listed[1])]


def picture(rows: list[list[str]]) -> str:
    """The layers as an SVG, one row a layer."""
    height = 2 * MARGIN + len(rows) * (HEIGHT + GAP) - GAP
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height}" width="{WIDTH}" height="{height}" '
        'font-family="sans-serif" font-size="13">',
        f'<rect width="{WIDTH}" height="{height}" fill="#ffffff"/>',
    ]
    for number, names in enumerate(rows):
        top = MARGIN + number * (HEIGHT + GAP)
        room = (WIDTH - 2 * MARGIN - GAP * (len(names) - 1)) / len(names)
        for place, name in enumerate(names):
            left = MARGIN + place * (room + GAP)
            parts.append(
                f'<rect x="{left:g}" y="{top}" width="{room:g}" height="{HEIGHT}" rx="4" fill="#e8f2f9" '
                'stroke="#0072b2"/>'
            )
            lines = f'<tspan font-weight="bold">{name}</tspan>'
            if len(names) < 4:
                lines += f'<tspan dx="10" fill="#444444">{escape(WHAT[name])}</tspan>'
            parts.append(f'<text x="{left + 12:g}" y="{top + 25}">{lines}</text>')
    return "\n".join([*parts, "</svg>", ""])


if __name__ == "__main__":
    PICTURE.write_text(picture(layers((ROOT / "pyproject.toml").read_text("utf-8"))), encoding="utf-8")
