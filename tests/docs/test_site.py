"""The documentation is complete: public names, folders, demos, glossary, references."""

from __future__ import annotations

import importlib.util
import json
import re
import shutil
import subprocess
from pathlib import Path

import pytest
from PIL import Image, ImageSequence, ImageStat

from tipfem.app.application import find_demos

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
    assert found <= listed


def test_what_is_generated_is_up_to_date(monkeypatch):
    """The picture and the maps of the folders, and tables of measurements: run python docs/write_generated.py."""
    monkeypatch.syspath_prepend(DOCS)
    write = module_at(DOCS / "write_generated.py")
    contract = (ROOT / "pyproject.toml").read_text("utf-8")
    assert write.PICTURE.read_text("utf-8") == write.picture(write.layers(contract))
    for page in write.pages():
        text = page.read_text("utf-8")
        assert text == write.renewed(text), page
    assert set(write.folders()) >= {"linalg", "linalg/multigrid", "case"}


def test_measurements_name_their_commit_and_how_they_were_made(monkeypatch):
    monkeypatch.syspath_prepend(DOCS)
    write = module_at(DOCS / "write_generated.py")
    pages = "".join(page.read_text("utf-8") for page in write.pages())
    drawn = (DOCS / "draw_theory.py").read_text("utf-8")
    for path in (DOCS / "data").iterdir():
        notes, rows = write.read_data(path.stem)
        assert re.fullmatch(r"[0-9a-f]{7} \(\d{4}-\d\d-\d\d\)", notes["commit"][0]), path
        assert notes.get("command") or notes.get("note"), path
        assert len({len(row) for row in rows}) == 1, path
        assert f"generated: table {path.stem} -->" in pages or f'"{path.stem}"' in drawn, f"{path} is not shown"


def test_formulas_are_typeset(tmp_path):
    """KaTeX, as the site loads it, takes every formula of the documentation, without a warning."""
    node = shutil.which("node")
    if node is None:
        pytest.skip("no node")
    found = []
    for page in DOCS.rglob("*.md"):
        text = re.sub(r"^ *```.*?^ *```$|`[^`\n]*`", "", page.read_text("utf-8"), flags=re.MULTILINE | re.DOTALL)
        found += re.findall(r"\$\$(.+?)\$\$", text, re.DOTALL)
        found += re.findall(
            r"(?<![\w$])\$(?!\s)([^$]+?)(?<!\s)\$(?![\w$])", re.sub(r"\$\$.+?\$\$", "", text, flags=re.DOTALL)
        )
    assert len(found) > 100
    formulas = tmp_path / "formulas.json"
    formulas.write_text(json.dumps(found))
    script = (
        "const katex = require(process.argv[1]); const found = JSON.parse(require('fs').readFileSync(process.argv[2]));"
        "for (const f of found) katex.renderToString(f, {throwOnError: true, strict: 'error'});"
    )
    command = [node, "-e", script, str(DOCS / "assets" / "katex" / "katex.min.js"), str(formulas)]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_the_gallery_has_all_demos():
    page = "".join((DOCS / f"{name}.md").read_text("utf-8") for name in ("gallery", "comparisons"))
    for scripts in find_demos().values():
        for name in scripts:
            assert f"python -m tipfem demo {name}" in page, name


@pytest.mark.slow(but=("dark",))
@pytest.mark.parametrize("theme", ["light", "dark"])
def test_the_first_picture_of_readme_begins_where_most_happens(theme):
    """Who sees no movement sees its first frame alone, which must not be a dull one."""
    with Image.open(DOCS / "images" / f"obstacle_{theme}.webp") as movie:
        frames = [ImageStat.Stat(frame.convert("L")).stddev[0] for frame in ImageSequence.Iterator(movie)]
    assert frames[0] > 0.75 * max(frames)


def test_pictures_are_used_and_are_there():
    used = set()
    for page in [*DOCS.rglob("*.md"), ROOT / "README.md", ROOT / "CONTRIBUTING.md"]:
        for target in re.findall(
            r"(?:\]\(|(?:src|srcset|data-page)=\")([^)\"]+\.(?:png|svg|webp|html))", page.read_text("utf-8")
        ):
            assert (page.parent / target).is_file(), f"{page}: {target}"
            used.add((page.parent / target).resolve())
    kept = {path.resolve() for folder in ("images", "shared") for path in (DOCS / folder).rglob("*.*")}
    assert kept - used == {DOCS / "images" / "logo.svg"}


def test_pages_say_how_large_shared_pages_are_which_are_small():
    sizes = {path.stem: round(path.stat().st_size / 1000) for path in (DOCS / "shared").glob("*.html")}
    assert f"in one file of {sizes['splash']} kB" in (DOCS / "index.md").read_text("utf-8")
    assert f"takes {sizes['dam_break']} kB" in (DOCS / "howto" / "view.md").read_text("utf-8")
    assert f"{sizes['dam_break']} kB" in (ROOT / "README.md").read_text("utf-8")
    assert sizes["dam_break"] <= 250


def test_the_reference_of_case_files_has_all_keys_and_its_examples_are_valid(monkeypatch):
    """Every key of every table of the schema, with a value that the schema takes."""
    validator = pytest.importorskip("jsonschema").Draft202012Validator
    monkeypatch.syspath_prepend(DOCS)
    keys = module_at(DOCS / "case_keys.py")
    page = (DOCS / "reference" / "case-keys.md").read_text("utf-8")
    reached = keys.tables()
    assert set(reached) == set(keys.SCHEMA["$defs"])
    known = keys.examples()
    assert len(known) > 60
    validator.check_schema(keys.SCHEMA)  # once, not with each key
    for name in ["", *reached]:
        schema = keys.SCHEMA["$defs"][name] if name else keys.SCHEMA
        for key, value in schema.get("properties", {}).items():
            if name or not any(keys.inner(value)):
                assert f"| `{key}` |" in page, (name, key)
            if (name, key) not in known:
                validator({**value, "$defs": keys.SCHEMA["$defs"]}).validate(keys.made(value))


def test_names_that_recur_do():
    """Names of the glossary are parameters of many functions."""
    _, _, text = (DOCS / "conventions.md").read_text("utf-8").partition("## Names that recur")
    names = [name for row in re.findall(r"^\| (`.*?) \|", text, re.MULTILINE) for name in re.findall(r"`(\w+)`", row)]
    sources = "".join(path.read_text("utf-8") for path in (ROOT / "tipfem").rglob("*.py"))
    assert len(names) >= 30
    for name in names:
        assert len(re.findall(rf"[(,]\s*{name}\s*[:,=)]", sources)) > 20, name


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
