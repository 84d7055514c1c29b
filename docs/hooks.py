"""MkDocs hook: lay out the package for the API reference as it is installed.

`render/` and `demos/` stand beside `tipfem/` in the repository and are imported as `tipfem.render` and `tipfem.demos`.
mkdocstrings reads sources without importing them, so each build begins with a copy in `build/api/tipfem`.
"""

from __future__ import annotations

import shutil
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "build" / "api" / "tipfem"


def on_startup(*, command: str, dirty: bool) -> None:
    """Copy the parts of the package together, before mkdocstrings looks for it."""
    shutil.rmtree(PACKAGE, ignore_errors=True)
    shutil.copytree(ROOT / "tipfem", PACKAGE, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copytree(ROOT / "render", PACKAGE / "render", ignore=shutil.ignore_patterns("__pycache__"))
