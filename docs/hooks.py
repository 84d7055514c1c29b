"""MkDocs hook: lay out the package for the API reference as it is installed.

`render/` and `demos/` stand beside `tipfem/` in the repository and are imported as `tipfem.render` and `tipfem.demos`.
mkdocstrings reads sources without importing them, so each build begins with a copy in `build/api/tipfem`. A build ends
with a smaller index for the search: without markup and formulas, and of the reference the public names alone. Pages
fetch it once the search is opened.
"""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "build" / "api" / "tipfem"


def on_startup(*, command: str, dirty: bool) -> None:
    """Copy the parts of the package together, before mkdocstrings looks for it."""
    shutil.rmtree(PACKAGE, ignore_errors=True)
    shutil.copytree(ROOT / "tipfem", PACKAGE, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copytree(ROOT / "render", PACKAGE / "render", ignore=shutil.ignore_patterns("__pycache__"))


def on_post_page(output: str, **_: object) -> str:
    """Name the theme's parts for those who hear the page, let its search wait; empty heads of tables are no heads."""
    dialog = 'data-md-component="search" role="dialog"'
    output = output.replace(dialog, dialog + ' aria-label="Search"')
    output = re.sub(
        r'(?=<script src="([./]*)assets/javascripts/bundle)', r'<script src="\1assets/search.js"></script>', output
    )
    output = re.sub(r"<thead>\s*<tr>\s*(?:<th[^>]*></th>\s*)+</tr>\s*</thead>", "", output)
    return re.sub(r"<th([^>]*)></th>", r"<td\1></td>", output)


def searched(entry: dict[str, object]) -> dict[str, object] | None:
    """An entry of the search index as it is kept, or None if it is left out."""
    location, text = str(entry["location"]), str(entry["text"])
    if location.startswith("api/"):
        return {**entry, "text": ""} if location.startswith(("api/index", "api/render")) else None
    text = re.sub(r"\\\(.*?\\\)|\\\[.*?\\\]|<[^>]+>", " ", text, flags=re.DOTALL)
    return {**entry, "text": " ".join(text.split())}


def on_post_build(*, config: dict[str, str]) -> None:
    """Write the index of the search anew, smaller."""
    path = Path(config["site_dir"]) / "search" / "search_index.json"
    index = json.loads(path.read_text("utf-8"))
    index["docs"] = [kept for entry in index["docs"] if (kept := searched(entry))]
    path.write_text(json.dumps(index, separators=(",", ":")), encoding="utf-8")
