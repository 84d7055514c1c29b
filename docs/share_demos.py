"""Run demos as docs/gallery.md says, and write their results as the pages of docs/shared.

    python docs/share_demos.py [NAME ...]

Without names all pages are renewed, which takes half an hour. What went into a page is kept in out/.
"""

import re
import subprocess
import sys
from pathlib import Path

# Outlines that turn over, and those of spray, fill more than 400 kB; the home page with the splash has 600 kB in all.
SMALLER = {
    "layer_inversion": ("--field", "none", "--states", "70"),
    "splash": ("--states", "80"),
    "free_surface": ("--states", "100"),
}

SHARED = Path(__file__).resolve().parent / "shared"


def main(names: list[str]) -> None:
    """Renew the pages of these names, or of all."""
    for path in sorted(SHARED.glob("*.html")):
        if names and path.stem not in names:
            continue
        # The first command after the link to the page.
        _, _, after = (SHARED.parent / "gallery.md").read_text().partition(f"](shared/{path.stem}.html)**")
        words = re.findall(r"^python -m tipfem (demo [^#\n]*)", after, re.MULTILINE)[0].split()
        out = Path("out") / words[1]
        run = *words, "--no-frames", "--overwrite", "--out", out
        for words in run, ("share", out, "--to", path, *SMALLER.get(path.stem, ())):
            subprocess.run([sys.executable, "-m", "tipfem", *map(str, words)], check=True)


if __name__ == "__main__":
    main(sys.argv[1:])
