"""The code blocks of a page of Markdown, and how to run those in Python as a reader would: in order, in one session.

    python tests/docs/blocks.py docs/tutorial.md FOLDER

runs a page in a folder, which then has what the page makes.
"""

from __future__ import annotations

import os
import re
import sys
from pathlib import Path
from typing import NamedTuple

FENCE = re.compile(
    r"^(?P<indent> *)```(?P<language>\w*)[^\n]*\n(?P<code>.*?)^(?P=indent)```$", re.MULTILINE | re.DOTALL
)


class Block(NamedTuple):
    """A fenced block: its language, its text, and the line of the page that it begins at."""

    language: str
    code: str
    line: int


def blocks(text: str) -> list[Block]:
    """All fenced blocks of a page, in order."""
    found = []
    for match in FENCE.finditer(text):
        code = re.sub(f"^{match['indent']}", "", match["code"], flags=re.MULTILINE)
        found.append(Block(match["language"], code, text[: match.start("code")].count("\n") + 1))
    return found


def run_page(page: Path, replace: dict[str, str] | None = None) -> dict[str, object]:
    """Run the Python blocks of a page in order in one namespace, in the present folder.

    Args:
        page: a file of Markdown.
        replace: pieces of code that are exchanged, to make a run shorter; each must be there.

    Returns:
        The namespace at the end. An error in a block names the page and its line.
    """
    namespace: dict[str, object] = {"__name__": "__main__"}
    replace = dict(replace or {})
    used = set()
    for block in blocks(page.read_text("utf-8")):
        if block.language != "python":
            continue
        code = block.code
        for old, new in replace.items():
            used |= {old} if old in code else set()
            code = code.replace(old, new)
        exec(compile("\n" * (block.line - 1) + code, str(page), "exec"), namespace)
    if used != set(replace):
        raise ValueError(f"{page} does not have {sorted(set(replace) - used)}")
    return namespace


if __name__ == "__main__":
    source, folder = Path(sys.argv[1]).resolve(), Path(sys.argv[2])
    folder.mkdir(parents=True, exist_ok=True)
    os.chdir(folder)
    run_page(source)
