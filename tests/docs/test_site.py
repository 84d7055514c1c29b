"""The documentation is complete: public names, folders, demos, glossary, references."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path

from tipfem.commands import find_demos

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"


def module_at(path: Path):
    """A module loaded from a file that is in no package."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_reference_has_all_public_names():
    import tipfem.render

    page = (DOCS / "api" / "index.md").read_text("utf-8")
    assert re.findall(r"^::: tipfem\.(\w+)$", page, re.MULTILINE)
    assert set(tipfem.__all__) == set(re.findall(r"^::: tipfem\.(\w+)$", page, re.MULTILINE))
    page = (DOCS / "api" / "render.md").read_text("utf-8")
    assert set(tipfem.render.__all__) == set(re.findall(r"^::: tipfem\.render\.(\w+)$", page, re.MULTILINE))


def test_the_reference_has_all_modules():
    """Folders with their modules, and files, of tipfem/ itself."""
    pages = "".join(path.read_text("utf-8") for path in (DOCS / "api").glob("*.md"))
    listed = set(re.findall(r"^::: tipfem\.(\w+)$", pages, re.MULTILINE))
    found = {path.parent.name for path in (ROOT / "tipfem").glob("*/__init__.py")}
    found |= {path.stem for path in (ROOT / "tipfem").glob("[a-z]*.py")}
    assert found - {"commands"} <= listed


def test_the_picture_of_the_folders_is_that_of_the_contract():
    draw = module_at(DOCS / "draw_layers.py")
    expected = draw.picture(draw.layers((ROOT / "pyproject.toml").read_text("utf-8")))
    assert draw.PICTURE.read_text("utf-8") == expected, "run python docs/draw_layers.py"


def test_the_gallery_has_all_demos():
    page = (DOCS / "gallery.md").read_text("utf-8")
    for scripts in find_demos().values():
        for name in scripts:
            assert f"python -m tipfem demo {name}" in page, name


def test_pictures_are_used_and_are_there():
    used = set()
    for page in [*DOCS.rglob("*.md"), ROOT / "README.md", ROOT / "CONTRIBUTING.md"]:
        for target in re.findall(r"(?:\]\(|src=\")([^)\"]+\.(?:png|svg))", page.read_text("utf-8")):
            assert (page.parent / target).is_file(), f"{page}: {target}"
            used.add((page.parent / target).resolve())
    kept = {path.resolve() for path in (DOCS / "images").iterdir()}
    assert kept - used == {DOCS / "images" / "logo.svg"}


def test_references_are_those_of_the_bibliography():
    """The same DOIs on the page and in the file for BibTeX."""
    page = (DOCS / "references.md").read_text("utf-8")
    file = (DOCS / "references.bib").read_text("utf-8")
    dois = re.findall(r"doi = \{(.*?)\}", file)
    assert len(dois) > 10
    assert sorted(dois) == sorted(re.findall(r"\[(10\.[^\]]+)\]", page))


def test_nothing_is_loaded_from_other_hosts():
    """The theme's fonts, style sheets and scripts are local."""
    settings = (ROOT / "mkdocs.yml").read_text("utf-8")
    assert "font: false" in settings
    assert not re.search(r"https?://", settings)
