"""Displays for notebooks: short tables of facts, and movies in the page."""

from __future__ import annotations

import base64
import html
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

_TYPES = {".mp4": "video/mp4", ".gif": "image/gif", ".webp": "image/webp"}


def facts(title: str, rows: Mapping[str, object]) -> str:
    """A title and a small table of names and values, as HTML."""
    lines = "".join(
        f'<tr><th style="text-align: left">{html.escape(name)}</th>'
        f'<td style="text-align: left">{html.escape(str(value))}</td></tr>'
        for name, value in rows.items()
    )
    return f"<p><b>{html.escape(title)}</b></p><table>{lines}</table>"


def in_notebook() -> bool:
    """Whether the process is the kernel of a notebook."""
    ipython = sys.modules.get("IPython")
    shell: Any = ipython.get_ipython() if ipython is not None else None
    return shell is not None and getattr(shell, "kernel", None) is not None


class Movie:
    """A movie, .mp4, .gif or .webp, that notebooks show in the page, and keep when they are saved."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __repr__(self) -> str:
        return f"Movie({str(self.path)!r})"

    def _repr_html_(self) -> str:
        kind = _TYPES[self.path.suffix.lower()]
        source = f"data:{kind};base64,{base64.b64encode(self.path.read_bytes()).decode()}"
        if kind.startswith("video"):
            return f'<video controls loop style="max-width: 100%" src="{source}"></video>'
        return f'<img style="max-width: 100%" src="{source}">'


class NotebookProgress:
    """A progress bar in the output of a notebook's cell."""

    def __init__(self) -> None:
        self._handle: Any = None

    def show(self, fraction: float, text: str) -> None:
        """Show how much is done, from 0 to 1, and a line of text."""
        display: Any = sys.modules["IPython"].display
        content = display.HTML(
            f'<progress value="{fraction:.4f}" max="1" style="width: 20em"></progress> {html.escape(text)}'
        )
        if self._handle is None:
            self._handle = display.display(content, display_id=True)
        else:
            self._handle.update(content)
