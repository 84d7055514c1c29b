"""The check of docstrings and pages that `make lint` runs."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import pytest

SCRIPT = Path(__file__).resolve().parents[1] / ".ci" / "check_style.py"
SPEC = importlib.util.spec_from_file_location("check_style", SCRIPT)
style = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(style)


@pytest.mark.parametrize(
    ("docstring", "line"),
    [
        ("What a run has left.", 2),
        ("How many rows there are.", 2),
        ("Of the waves [m].", 2),
        ("Height [m].\n\n    A twelfth of the width.", 4),
        ("Height [m], half\n    a percent too large.", 2),
    ],
)
def test_finds_openers_and_fractions_in_docstrings(docstring, line):
    assert [at for at, _ in style.in_source(f'def f():\n    """{docstring}"""\n')] == [line]


@pytest.mark.parametrize("text", ["Whatever is left.", "Often 8 %.", "A third, 1/12 or a few percent.", "A tent."])
def test_passes_other_words(text):
    assert not list(style.in_source(f'"""{text}"""\nx = "What"\n'))


def test_skips_code_and_released_changes(tmp_path):
    page = "A tenth.\n\n```python\na = 'a tenth'\n```\n\n`a tenth`, three\ntenths.\n"
    assert [line for line, _ in style.fractions(page)] == [1, 7]
    (tmp_path / "CHANGELOG.md").write_text("## [Unreleased]\n- A tenth.\n\n## [0.1.0]\n- A tenth.\n")
    (tmp_path / "docs").mkdir()
    (tmp_path / "docs" / "page.md").write_text("Half a per cent.\n")
    found = [text.rpartition(": ")[0] for text in style.findings(tmp_path)]
    assert sorted(found) == ["CHANGELOG.md:2", "docs/page.md:1"]
