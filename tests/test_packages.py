"""The packages of the wheel: pyproject.toml lists every folder with Python files, and the data they need."""

from __future__ import annotations

import sys
from pathlib import Path

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).resolve().parents[1]
# Folders beside tipfem/ that are imported as parts of it.
BESIDE = {"render": "tipfem.render", "demos": "tipfem.demos"}
SETUPTOOLS = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["tool"]["setuptools"]


def packages_of(folder: str, package: str) -> set[str]:
    """Names of the packages in a folder: it and all below it that have an __init__.py."""
    found = set()
    for init in (ROOT / folder).rglob("__init__.py"):
        parts = init.parent.relative_to(ROOT / folder).parts
        found.add(".".join((package, *parts)))
    return found


def test_all_packages_are_in_the_wheel():
    there = packages_of("tipfem", "tipfem").union(*(packages_of(*item) for item in BESIDE.items()))
    assert set(SETUPTOOLS["packages"]) == there
    assert SETUPTOOLS["package-dir"] == {"tipfem": "tipfem", **{v: k for k, v in BESIDE.items()}}


def test_every_folder_with_python_files_is_a_package():
    for folder in ("tipfem", *BESIDE):
        for path in (ROOT / folder).rglob("*.py"):
            assert (path.parent / "__init__.py").exists(), f"{path.relative_to(ROOT)} is in no package"


def test_the_data_of_the_packages_are_in_the_wheel():
    """Every file of demos/ and tipfem/ but Python's own and pictures, which READMEs show on the web."""
    wanted, listed = set(), set()
    for folder in ("tipfem", *BESIDE):
        suffixes = (".csv", ".toml", ".md", ".json", ".typed", ".html", ".css", ".js", ".svg")
        wanted |= {p for p in (ROOT / folder).rglob("*.*") if p.suffix in suffixes}
    for package, patterns in SETUPTOOLS["package-data"].items():
        base = next((b for b, name in BESIDE.items() if package.split(".")[:2] == name.split(".")), "tipfem")
        below = package.split(".")[2 if base in BESIDE else 1 :]
        for pattern in patterns:
            found = set(ROOT.joinpath(base, *below).glob(pattern))
            if pattern == "kernels/*/*":  # made by `make wheel`: a tree from which none was built has none
                continue
            assert found, f"{package} has no {pattern}"
            listed |= found
    assert wanted == listed
