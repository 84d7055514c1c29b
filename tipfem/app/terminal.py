"""Terminal: an output whose long lines are broken between words, at the width of the terminal."""

from __future__ import annotations

import os
import re
import shutil
import textwrap
from typing import Any

COLOURS = {"error:": "31", "warning:": "33", "note:": "36"}  # of what lines begin with
_COLUMN = re.compile(r"\s*\S+(?: \S+)*? {2,}(?=\S)")  # what stands before the text of a row, as in a list of names
_WIDEST = 0.45  # share of the terminal that this may take


class Terminal:
    """An output on a terminal; lines drawn by others, with control characters, are passed on as they are."""

    def __init__(self, stream: Any) -> None:
        self._stream, self._line = stream, ""
        self._coloured = "NO_COLOR" not in os.environ and os.environ.get("TERM") != "dumb"

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        """Write a text; what follows the last line's end waits for its own, or for `flush`."""
        *lines, self._line = (self._line + text).split("\n")
        if lines:
            self._stream.write("".join(f"{self._broken(line)}\n" for line in lines))
        return len(text)

    def flush(self) -> None:
        """Write what is kept."""
        line, self._line = self._line, ""
        if line:
            self._stream.write(line)
        self._stream.flush()

    def _broken(self, line: str) -> str:
        if not line.isprintable():
            return line
        width = shutil.get_terminal_size().columns
        if len(line) > width:
            column = _COLUMN.match(line)
            indent = len(line) - len(line.lstrip()) + 2
            if column and column.end() < _WIDEST * width:
                indent = column.end()
            parts = textwrap.wrap(
                line, width, subsequent_indent=" " * indent, break_long_words=False, break_on_hyphens=False
            )
            line = "\n".join(parts)
        head = next((head for head in COLOURS if line.startswith(head)), "")
        return f"\x1b[{COLOURS[head]}m{head}\x1b[0m{line[len(head) :]}" if head and self._coloured else line
