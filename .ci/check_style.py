"""Check the English of docstrings and pages: how docstrings begin, and no fractions in words.

`make lint` and pre-commit run ``python .ci/check_style.py [ROOT]``.
"""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Iterator
from pathlib import Path

OPENERS = ("What", "How", "Where", "Of", "Those", "Which", "That", "Let", "Say", "Give", "Tell")
# Halves, thirds and quarters read well; finer parts are numbers.
FRACTIONS = re.compile(
    r"\b(?:an?|one|two|three|four|five|six|seven|eight|nine|half\s+an?)\s+(?:fif|six|seven|eigh|nin|ten|eleven|twelf|"
    r"fifteen|sixteen|twentie|thirtie|fortie|fiftie|sixtie|hundred|thousand|million)ths?\b|\b(?:half\s+an?|one|two|three|four|five|ten|\d+)\s+per\s?cent\b",
    re.IGNORECASE,
)
CODE = re.compile(r"^```.*?^```|`[^`\n]*`", re.DOTALL | re.MULTILINE)
PAGES = ("README.md", "CONTRIBUTING.md", "docs/**/*.md", "demos/**/*.md")
SOURCES = ("tipfem/**/*.py", "render/**/*.py")


def fractions(text: str) -> Iterator[tuple[int, str]]:
    """Lines from 1, and messages for fractions in words; code is skipped."""
    text = CODE.sub(lambda code: re.sub(r"[^\n]", " ", code[0]), text)
    for match in FRACTIONS.finditer(text):
        found = " ".join(match[0].split())
        yield 1 + text.count("\n", 0, match.start()), f"write {found!r} in figures, as 5 %, 1/20 or 0.05"


def docstrings(source: str) -> Iterator[tuple[int, str]]:
    """First lines and texts of the docstrings of a module."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            text = ast.get_docstring(node, clean=False)
            if text:
                yield node.body[0].lineno, text


def in_source(source: str) -> Iterator[tuple[int, str]]:
    """Lines and messages for the docstrings of a module."""
    for line, text in docstrings(source):
        opener = text.split()[0].rstrip(",.:")
        if opener in OPENERS:
            yield line, f"begin the docstring with a noun or a verb, not with {opener!r}"
        yield from ((line + offset - 1, message) for offset, message in fractions(text))


def unreleased(changes: str) -> str:
    """The part of a change log up to the first release."""
    return re.split(r"^## \[?\d", changes, maxsplit=1, flags=re.MULTILINE)[0]


def findings(root: Path) -> Iterator[str]:
    """Findings in a tree, as ``path:line: message``."""
    texts = [(path, in_source) for glob in SOURCES for path in root.glob(glob)]
    texts += [(path, fractions) for glob in PAGES for path in root.glob(glob)]
    for path, check in [*texts, (root / "CHANGELOG.md", lambda text: fractions(unreleased(text)))]:
        for line, message in check(path.read_text("utf-8")):
            yield f"{path.relative_to(root)}:{line}: {message}"


if __name__ == "__main__":
    found = sorted(findings(Path(sys.argv[1] if len(sys.argv) > 1 else ".")))
    print(*found, sep="\n", end="\n" * bool(found))
    sys.exit(bool(found))
