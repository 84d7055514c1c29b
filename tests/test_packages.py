"""The packages of the wheel: every folder with Python files, and the data they need."""

from __future__ import annotations

import ast
import importlib
import subprocess
import sys
from pathlib import Path

import pytest

import tipfem

ROOT = Path(__file__).resolve().parents[1]
# Folders beside tipfem/ that are imported as parts of it.
BESIDE = {"render": "tipfem.render", "demos": "tipfem.demos"}


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """Files (paths in the wheel) that the build back end takes from the tree."""
    folder = tmp_path_factory.mktemp("built")
    build = ["egg_info", "--egg-base", folder, "build", "--build-base", folder, "--build-lib", folder / "lib"]
    subprocess.run([sys.executable, "setup.py", "-q", *map(str, build)], cwd=ROOT, check=True, capture_output=True)
    return {path.relative_to(folder / "lib").as_posix() for path in (folder / "lib").rglob("*.*") if path.is_file()}


def in_wheel(suffixes):
    """Files of the tree with one of these suffixes, as they are named in the wheel."""
    found = set()
    for folder, base in {"tipfem": "tipfem", **BESIDE}.items():
        there = [p.relative_to(ROOT / folder) for p in (ROOT / folder).rglob("*.*") if p.suffix in suffixes]
        found |= {f"{base.replace('.', '/')}/{path.as_posix()}" for path in there}
    return found


def test_all_packages_are_in_the_wheel(built):
    python = {path for path in built if path.endswith(".py")}
    assert len(python) > 400
    assert python == in_wheel([".py"])


def test_the_data_of_the_packages_are_in_the_wheel(built):
    """Every file of demos/ and tipfem/ but Python's own and pictures, which READMEs show on the web."""
    suffixes = (".csv", ".toml", ".md", ".json", ".typed", ".html", ".css", ".js", ".svg", ".pyi")
    assert in_wheel(suffixes) == {path for path in built if not path.endswith(".py") and "/kernels/" not in path}


def test_public_names_are_found():
    """Each by its line in the stub, and no other."""
    stub = ast.parse((ROOT / "tipfem" / "__init__.pyi").read_text("utf-8"))
    lines = [line for line in stub.body if isinstance(line, ast.ImportFrom)]
    assert tipfem.__all__ == sorted(each.name for line in lines for each in line.names)
    for line in lines:
        for each in line.names:
            found = importlib.import_module(line.module)
            assert getattr(tipfem, each.name) is getattr(found, each.name), each.name
    with pytest.raises(AttributeError, match="module 'tipfem' has no attribute 'Tanks'"):
        _ = tipfem.Tanks
