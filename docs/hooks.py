"""MkDocs hook: lay out the package for the API reference as it is installed.

`render/` and `demos/` stand beside `tipfem/` in the repository and are imported as `tipfem.render` and `tipfem.demos`.
mkdocstrings reads sources without importing them, so each build begins with a copy in `build/api/tipfem`.
"""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "build" / "api" / "tipfem"


def on_config(config: Any) -> Any:
    """Copy the parts of the package together, before any page is read."""
    shutil.rmtree(PACKAGE, ignore_errors=True)
    shutil.copytree(ROOT / "tipfem", PACKAGE, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copytree(ROOT / "render", PACKAGE / "render", ignore=shutil.ignore_patterns("__pycache__"))
    return config
