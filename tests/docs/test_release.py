"""One version in the package, the change log and the citation; the change log can be read."""

from __future__ import annotations

import re
from pathlib import Path

import tipfem

ROOT = Path(__file__).resolve().parents[2]


def changes() -> list[str]:
    """The sections of the change log, the topmost first."""
    return re.split(r"^## ", (ROOT / "CHANGELOG.md").read_text("utf-8"), flags=re.MULTILINE)[1:]


def test_one_version():
    version = re.search(r'^version = "(.*)"$', (ROOT / "pyproject.toml").read_text("utf-8"), re.MULTILINE)[1]
    assert tipfem.__version__ == version
    citation = (ROOT / "CITATION.cff").read_text("utf-8")
    released = re.search(r"^date-released: (\S+)$", citation, re.MULTILINE)[1]
    assert f"\nversion: {version}\n" in citation
    named = [section for section in changes() if not section.startswith("[Unreleased]")]
    assert named[0].startswith(f"[{version}] - {released}\n")


def test_an_entry_is_a_line_below_100_characters():
    entries = [line for section in changes()[:-1] for line in section.splitlines()[1:] if line]
    assert len(entries) > 50
    for line in entries:
        assert len(line) < 100, line
        assert not line.startswith("  "), f"goes on from the line before: {line}"


def test_all_extras_of_users_are_in_one():
    section = (ROOT / "pyproject.toml").read_text("utf-8").split("[project.optional-dependencies]")[1].split("\n[")[0]
    extras = set(re.findall(r"^(\w+) = \[", section, re.MULTILINE)) - {"all", "test", "lint", "docs", "performance"}
    assert set(re.search(r'^all = \["tipfem\[(.*)\]"\]$', section, re.MULTILINE)[1].split(",")) == extras
