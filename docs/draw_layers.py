"""Draw docs/images/layers.svg: the folders of tipfem/, each importing only from those below it.

    python docs/write_generated.py

The layers are those of the import-linter contract in pyproject.toml; what each is comes from its docstring.
"""

from __future__ import annotations

import ast
import re
from html import escape
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PICTURE = ROOT / "docs" / "images" / "layers.svg"

WIDTH, HEIGHT, GAP, MARGIN = 720, 40, 10, 12
LETTER, BOLD = 6.9, 8.6  # widths at 13 points, generous


def layers(text: str) -> list[list[str]]:
    """The layers of the contract, top first; each is a list of names in tipfem/."""
    listed = re.search(r"^layers = \[(.*?)^\]", text, re.MULTILINE | re.DOTALL)
    if listed is None:
        raise ValueError("pyproject.toml has no layers")
    return [re.findall(r"tipfem\.(\w+)", line) for line in re.findall(r'"([^"]+)"', listed[1])]


def summary(path: Path) -> str:
    """The first sentence of a module's docstring, without its full stop."""
    text = ast.get_docstring(ast.parse(path.read_text("utf-8"))) or ""
    first = " ".join(text.split("\n\n")[0].split())
    return re.split(r"(?<=[\w)`])[.;](?: |$)", first)[0].rstrip(".")


def purpose(name: str, room: float) -> str:
    """What a part of tipfem/ is for, cut at a comma or colon to fit into ``room`` points; empty if it does not."""
    folder, file = ROOT / "tipfem" / name / "__init__.py", ROOT / "tipfem" / f"{name}.py"
    text = summary(folder if folder.is_file() else file)
    text = text.split(": ", 1)[1] if text.lower().startswith(name.lower()) and ": " in text else text
    while text and len(text) * LETTER > room:
        cut = max(text.rfind(","), text.rfind(":"))
        text = text[: max(cut, 0)]
    return text


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
            size = min(13.0, 13 * (room - 18) / (BOLD * len(name)))
            lines = f'<tspan font-weight="bold" font-size="{size:.3g}">{name}</tspan>'
            if text := purpose(name, room - 34 - BOLD * len(name)):
                lines += f'<tspan dx="10" fill="#444444">{escape(text)}</tspan>'
            parts.append(f'<text x="{left + 12:g}" y="{top + 25}">{lines}</text>')
    return "\n".join([*parts, "</svg>", ""])
