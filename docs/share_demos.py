"""Run demos, and write their results as the pages of docs/shared.

    python docs/share_demos.py [NAME ...]

Without names all pages are renewed, which takes half an hour. What went into a page is kept in out/.
"""

import subprocess
import sys
from pathlib import Path

SHARED = Path(__file__).resolve().parent / "shared"


def main(names: list[str]) -> None:
    """Renew the pages of these names, or of all."""
    for path in sorted(SHARED.glob("*.html")):
        if names and path.stem not in names:
            continue
        demo = "dam_break_free_surface" if path.stem == "free_surface" else path.stem
        out = Path("out") / demo
        run = "demo", demo, "--no-frames", "--overwrite", "--out", out
        for words in run, ("share", out, "--to", path):
            subprocess.run([sys.executable, "-m", "tipfem", *map(str, words)], check=True)


if __name__ == "__main__":
    main(sys.argv[1:])
