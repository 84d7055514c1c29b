"""MkDocs hook: lay out the package for the API reference as it is installed.

`render/` and `demos/` stand beside `tipfem/` in the repository and are imported as `tipfem.render` and `tipfem.demos`.
mkdocstrings reads sources without importing them, so each build begins with a copy in `build/api/tipfem`. A build ends
with a smaller index for the search: without markup and formulas, of code and of the reference the names alone. Pages
fetch it once the search is opened. A link to a page that is posted somewhere shows its title and a picture; where the
environment has `SITE_URL`, by a whole address, as most who read them ask for.
"""

from __future__ import annotations

import html
import json
import re
import shutil
from pathlib import Path
from typing import Any

from mkdocs.exceptions import PluginError

ROOT = Path(__file__).resolve().parents[1]
LARGEST = 520_000  # bytes of the index of the search
SEEN = "viewer.png"  # what is seen of a page where it is linked
PACKAGE = ROOT / "build" / "api" / "tipfem"


def on_startup(*, command: str, dirty: bool) -> None:
    """Copy the parts of the package together, before mkdocstrings looks for it."""
    shutil.rmtree(PACKAGE, ignore_errors=True)
    shutil.copytree(ROOT / "tipfem", PACKAGE, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copytree(ROOT / "render", PACKAGE / "render", ignore=shutil.ignore_patterns("__pycache__"))


def preview(config: Any, root: str, image: str, told: dict[str, str]) -> str:
    """Elements of a page's head for those who show links: what is told, and a picture; ``root`` leads to the site's."""
    said = {**told, "image": f"{config['site_url'] or root}images/{image}"}
    return "".join(f'<meta property="og:{name}" content="{html.escape(text)}">' for name, text in said.items())


def on_post_page(output: str, page: Any, config: Any) -> str:
    """Tell those who show links what a page is, and see `named`."""
    title = config["site_name"] if page.is_homepage else page.title
    told = {"title": title, "description": config["site_description"], "type": "website"}
    seen = preview(config, "../" * page.url.count("/"), SEEN, told)
    return named(output.replace("</head>", seen + "</head>", 1))


def on_post_template(output_content: str, template_name: str, config: Any) -> str:
    """The page for addresses that are not there is no page of its own to MkDocs; see `named`."""
    return named(output_content) if template_name.endswith(".html") else output_content


def named(output: str) -> str:
    """Name the theme's parts for those who hear the page, let its search wait; empty heads of tables are no heads."""
    dialog = 'data-md-component="search" role="dialog"'
    output = output.replace(dialog, dialog + ' aria-label="Search"')
    output = re.sub(
        r'(?=<script src="([./]*)assets/javascripts/bundle)', r'<script src="\1assets/search.js"></script>', output
    )
    output = re.sub(r"<thead>\s*<tr>\s*(?:<th[^>]*></th>\s*)+</tr>\s*</thead>", "", output)
    return re.sub(r"<th([^>]*)></th>", r"<td\1></td>", output)


def names_in(code: re.Match[str]) -> str:
    """The names in a block of code, each once."""
    names = re.findall(r"[A-Za-z_][\w.-]*\w", html.unescape(re.sub("<[^>]+>", " ", code[0])))
    return f" {' '.join(dict.fromkeys(names))} "


def searched(entry: dict[str, object]) -> dict[str, object] | None:
    """An entry of the search index as it is kept, or None if it is left out."""
    location, text = str(entry["location"]), str(entry["text"])
    if location.startswith("api/"):
        return {**entry, "text": ""} if location.startswith(("api/index", "api/render")) else None
    text = re.sub("<pre.*?</pre>", names_in, text, flags=re.DOTALL)
    text = re.sub(r"\\\(.*?\\\)|\\\[.*?\\\]|<[^>]+>", " ", text, flags=re.DOTALL)
    return {**entry, "text": " ".join(text.split())}


def on_post_build(*, config: Any) -> None:
    """Give pages of results their posters, for links; write the index of the search anew, smaller."""
    for path in (Path(config["site_dir"]) / "shared").glob("*.html"):
        text = path.read_text("utf-8")
        seen = preview(config, "../", f"posters/{path.stem}_light.webp", {})
        path.write_text(text.replace("<style>", seen + "\n<style>", 1), "utf-8")
    path = Path(config["site_dir"]) / "search" / "search_index.json"
    index = json.loads(path.read_text("utf-8"))
    index["docs"] = [kept for entry in index["docs"] if (kept := searched(entry))]
    text = json.dumps(index, separators=(",", ":"))
    if len(text) >= LARGEST:
        raise PluginError(f"the index of the search has {len(text)} bytes, allowed are {LARGEST}")
    path.write_text(text, encoding="utf-8")
