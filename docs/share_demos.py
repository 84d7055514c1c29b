"""Run demos as docs/gallery.md says, and write their results as the pages of docs/shared.

    python docs/share_demos.py [NAME ...]
    python docs/share_demos.py --code [NAME ...]

Without names all pages are renewed, which takes half an hour. What went into a page is kept in out/. With --code the
flows stay as they are, and get the program of today's pages.
"""

import base64
import json
import re
import subprocess
import sys
import zlib
from pathlib import Path

from tipfem.render.viewer.share import PLANE, SOLID, assembled

# Outlines that turn over, and those of spray, fill more than 400 kB; the home page with the splash has 600 kB in all.
SMALLER = {
    "layer_inversion": ("--field", "none", "--states", "70"),
    "splash": ("--states", "80"),
    "free_surface": ("--states", "100"),
}

SHARED = Path(__file__).resolve().parent / "shared"


def with_todays_code(page: str) -> str:
    """A page with the flow and the links of an older one."""
    told, coded = re.search(r'^const told = (.*), data = "(.*)";$', page, re.MULTILINE).groups()
    told, data = json.loads(told), zlib.decompress(base64.b64decode(coded), -15)
    poster = re.search(r'<div id="poster">(.*?)</div></div>', page, re.DOTALL)[1]
    links = "".join(f"{line}\n" for line in re.findall(r'^<meta property="og:(?:url|image)".*>$', page, re.MULTILINE))
    made = assembled(told, poster, data, PLANE if "outlines" in told[0] else SOLID)
    return made.replace('<link rel="icon"', links + '<link rel="icon"', 1)


def main(names: list[str]) -> None:
    """Renew the pages of these names, or of all."""
    only_code = "--code" in names
    names = [name for name in names if name != "--code"]
    for path in sorted(SHARED.glob("*.html")):
        if names and path.stem not in names:
            continue
        if only_code:
            path.write_text(with_todays_code(path.read_text("utf-8")), "utf-8")
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
