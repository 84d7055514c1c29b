"""The theory pages name functions, tests and demos: all exist, and their numbers are the defaults."""

from __future__ import annotations

import importlib
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
THEORY = ROOT / "docs" / "theory"
TEXT = "".join(page.read_text("utf-8") for page in sorted(THEORY.glob("*.md")))
FOLDERS = {path.parent.name for path in (ROOT / "tipfem").glob("*/__init__.py")}
NAMES = sorted({m for m in re.findall(r"`((?:[a-z_]+\.)+[A-Za-z_]+)`", TEXT) if m.split(".")[0] in FOLDERS})


@pytest.mark.parametrize("name", NAMES)
def test_what_it_names_exists(name):
    """A module, function or class of tipfem/, by its folder and module."""
    module, _, attribute = name.rpartition(".")
    try:
        assert hasattr(importlib.import_module(f"tipfem.{module}"), attribute)
    except AssertionError:
        importlib.import_module(f"tipfem.{name}")


def test_it_names_the_equations():
    """Each of the paper's equations that the solver discretises has its function."""
    for name in (
        "fem.element.cauchy_stress",
        "fem.residual.residual",
        "fem.time_integration.GeneralizedAlpha",
        "linalg.newton.newton",
    ):
        assert name in NAMES
    for equation in ("eqs. 3 and 4", "eq. 5", "eq. 6"):
        assert equation in TEXT


def test_its_files_exist():
    """Commands and links point to files of the repository."""
    files = {ROOT / name for name in re.findall(r"(?:tests|demos)/[\w/]+\.py", TEXT)}
    links = {THEORY / target for target in re.findall(r"\]\(([\w./-]+)\)", TEXT)}
    assert len(files) > 3
    assert len(links) > 4
    for file in files | links:
        assert file.is_file(), file


def test_its_settings_are_the_defaults():
    """The numbers it gives for the method's choices."""
    import tipfem as tp

    numerics = tp.Numerics()
    assert (numerics.rho_inf, numerics.stabilisation) == (0.0, 0.25)
    assert (numerics.newton_tolerance, numerics.acceleration_tolerance) == (2.5e-5, 1e-2)
    assert numerics.newton_iterations == 12
    rule = numerics.relocation
    assert (rule.too_close, rule.too_close_to_wall, rule.long_mixed_edge) == (0.6, 0.4, 1.8)
    fitting = numerics.fitting
    lengths = (fitting.too_close, fitting.too_close_to_interface, fitting.too_close_along_interface)
    assert (*lengths, fitting.long_edge, fitting.thin_film, fitting.contact_reach) == (0.6, 0.4, 0.55, 1.5, 0.3, 0.8)
