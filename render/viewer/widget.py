"""A viewer in the output of a notebook's cell: the page's own code as a widget, its session in the kernel."""

from __future__ import annotations

import asyncio
import base64
import html
import re
import tempfile
from pathlib import Path
from typing import Any

from tipfem.render.viewer.packing import png
from tipfem.render.viewer.page_files import page_file
from tipfem.render.viewer.session import Page, Session
from tipfem.render.viewer.share import share
from tipfem.render.viewer.source import ResultsSource, Source

from tipfem.results.reader import RunResults

# In the order in which each uses only what comes before it.
_NAMES = "numbers plots outlines motion cells lines stage solid solid_stage steering viewer widget"
_SCRIPTS = tuple(f"{name}.js" for name in _NAMES.split())


class View:
    """Results, or a running simulation, to look at in a notebook; or two at equal times.

    It is the page of `tipfem view` in the output of a cell, and needs `pip install "tipfem[notebook]"`. Pictures are
    drawn by the notebook's kernel, and while a cell runs it draws none. Without anywidget the output is the page of
    `tipfem share`.

    Args:
        first: a results folder, what `read_results` returns, or a `Source`.
        second: another one, shown beside it.
        height: of the widget [CSS px].

    Attributes:
        session: what is shown; pages are added to it by the notebook.

    Raises:
        ValueError: a folder cannot be read; the message names the file.
    """

    def __init__(
        self,
        first: str | Path | RunResults | Source,
        second: str | Path | RunResults | Source | None = None,
        height: int = 720,
    ) -> None:
        if not 300 <= height <= 4000:
            raise ValueError(f"height {height}: expected 300 to 4000 CSS pixels")
        self.sources = [_source(given) for given in (first, second) if given is not None]
        self.session = Session(self.sources)
        self.height = height
        self._widget: Any = None
        self._page: Page | None = None
        self._running: asyncio.Task[None] | None = None

    def close(self) -> None:
        """End the viewer; its output no longer answers."""
        self.session.close("the viewer was closed")
        if self._widget is not None:
            self._widget.close()

    def __repr__(self) -> str:
        return f"View({', '.join(source.name for source in self.sources)})"

    def _repr_mimebundle_(self, **_: Any) -> dict[str, Any] | tuple[dict[str, Any], dict[str, Any]]:
        if self._widget is None:
            try:
                self._widget = self._make_widget()
            except ImportError:
                return {"text/plain": repr(self), "text/html": self._shared()}
        bundle = self._widget._repr_mimebundle_()
        data, more = bundle if isinstance(bundle, tuple) else (bundle, {})
        # For readers of notebooks that show no widgets.
        return {**data, "text/plain": repr(self), "image/png": png(self.session.showing.framed())}, more

    def _shared(self) -> str:
        """Shared pages of results, and a picture of the present state of a run that has no results folder to read."""
        parts = ["<p>For controls: <code>pip install 'tipfem[notebook]'</code> and start the kernel again.</p>"]
        for source in self.sources:
            folder = getattr(source, "folder", None)
            if folder is None:
                picture = base64.b64encode(png(self.session.showing.framed())).decode()
                parts.append(f'<p>{html.escape(source.name)}</p><img src="data:image/png;base64,{picture}">')
            else:
                with tempfile.TemporaryDirectory() as place:
                    page = share(folder, Path(place) / "page.html").read_text(encoding="utf-8")
                frame = f'<iframe srcdoc="{html.escape(page)}" style="width: 100%; height: 560px; border: 0"></iframe>'
                parts.append(f"<p>{html.escape(source.name)}</p>{frame}")
        return "".join(parts)

    def _make_widget(self) -> Any:
        import anywidget
        import traitlets

        class Widget(anywidget.AnyWidget):
            _esm = widget_script()
            _css = page_file("viewer.css").decode()
            markup = traitlets.Unicode(widget_markup()).tag(sync=True)
            height = traitlets.Int(self.height).tag(sync=True)

        widget = Widget()
        widget.on_msg(self._receive)
        return widget

    def _receive(self, _: Any, content: Any, buffers: Any) -> None:
        """A message from the notebook's page; the first one says that it is there."""
        text = content.get("text") if isinstance(content, dict) else None
        if text == "ready":
            if self._running is None:
                self._running = asyncio.ensure_future(self.session.run())
            if self._page is not None:
                self.session.detach(self._page)
            self._page = self.session.attach(self._send)
        elif self._page is not None:
            self.session.receive(self._page, text if isinstance(text, str) else b"")

    def _send(self, message: str | bytes) -> None:
        if isinstance(message, str):
            self._widget.send({"text": message})
        else:
            self._widget.send({}, [message])


def widget_markup() -> str:
    """The viewer's part of the page."""
    found = re.search(r"<!-- viewer -->(.*)<!-- /viewer -->", page_file("index.html").decode(), re.DOTALL)
    assert found is not None, "the page has these marks"
    return found[1]


def widget_script() -> str:
    """The page's scripts as one module, for notebooks take one file."""
    parts = []
    for name in _SCRIPTS:
        text = re.sub(r"^import .*;\n", "", page_file(name).decode(), flags=re.MULTILINE)
        last = name == _SCRIPTS[-1]
        parts.append(text if last else re.sub(r"^export ", "", text, flags=re.MULTILINE))
    return "\n".join(parts)


def _source(given: str | Path | RunResults | Source) -> Source:
    if isinstance(given, (str, Path)):
        return ResultsSource(given)
    return ResultsSource(given.folder) if isinstance(given, RunResults) else given
