"""The viewer in a window of its own, where there is a display: the same pictures and commands as on the page.

Its keys are those of the page where they are letters, the space or Escape. GGUI tells of no digits and no signs; in
their place are the arrows, Enter, Tab and Backspace.
"""

from __future__ import annotations

import asyncio
import io
import json
import math
import textwrap
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np
from PIL import Image

from tipfem.typing import Array
from tipfem.viewer import protocol
from tipfem.viewer.session import Session
from tipfem.viewer.source import Source

SIZE = (1280, 720)  # [px]
ZOOM, SHIFT = 1.3, 0.12  # as of the page
TILT = 5.0  # degrees a key
TILT_HOLDS = 0.8  # seconds for which the last tilt by a key is taken for the present one
PUSHED = 0.4  # seconds that a push by a key takes
REACH = 0.15  # of the picture's width, at which a push is as hard as it gets
# Shares of what a run allows, as the page begins with.
STRENGTH, RADIUS, DROP = 0.4, 0.4, 0.5
_EVERY = 1 / 60  # seconds between looks at keys and the pointer


class ScreenLike(Protocol):
    """What a window does; see `tipfem.render.screen.Screen`."""

    size: tuple[int, int]

    @property
    def open(self) -> bool:
        """Whether nobody has closed it."""

    @property
    def pointer(self) -> tuple[float, float]:
        """Place of the pointer in the window."""

    def keys(self) -> list[tuple[str, bool]]:
        """What has been pressed or let go."""

    def show(
        self, image: Array | None, lines: Sequence[str], legend: Sequence[tuple[str, str]], panel: Sequence[str] = ()
    ) -> None:
        """Show a picture and text."""

    def close(self) -> None:
        """Close the window."""


class Key(NamedTuple):
    """A key: what it says in the list of keys, what it does, and the command that the source must take for it."""

    key: str
    says: str
    do: Callable[[], None]
    needs: str = ""


class NativePage:
    """A page that is a window: it takes the messages of a session, and sends what keys and the pointer do.

    Args:
        session: what is shown.
        screen: the window.
        say: takes lines of text for the terminal.
    """

    def __init__(self, session: Session, screen: ScreenLike, say: Callable[[str], None]) -> None:
        self._session, self._screen, self._say = session, screen, say
        self._image: Array | None = None
        self._new = False
        self._hello: dict[str, Any] = {}
        self._status: dict[str, Any] = {}
        self._frame: dict[str, Any] = {}
        self._text, self._listed = "", False
        self._grabbed: tuple[str, tuple[float, float], tuple[float, ...]] | None = None
        self._release_at = math.inf
        self._tilted = (0.0, 0.0), -math.inf
        self._pushed: list[float] | None = None
        self._page = session.attach(self._take)
        self.keys = self._bindings()
        width, height = screen.size
        self._send("size", width=width, height=height, ratio=1)

    async def run(self) -> None:
        """Show and listen until the window is closed, or the session ends."""
        try:
            while self._screen.open:
                self.look()
                await asyncio.sleep(_EVERY)
            self._session.close("the window was closed")
        finally:
            self._session.detach(self._page)
            self._screen.close()

    def look(self) -> None:
        """Take what keys and the pointer have done, and show the latest picture."""
        for key, pressed in self._screen.keys():
            if key in ("LMB", "RMB"):
                self._grab(key) if pressed else self._let_go()
            elif pressed:
                self._press(key)
        self._drag()
        if time.monotonic() > self._release_at:
            self._release_at = math.inf
            self._command("poke", at=None)
        panel = [f"{_called(key.key):>9}   {key.says}" for key in self.keys if self._has(key)] if self._listed else []
        legend = [(fluid["name"], fluid["colour"]) for fluid in self._hello["panes"][0]["fluids"]]
        self._screen.show(self._image if self._new else None, self._lines(), legend, panel)
        self._new = False

    # Messages

    def _take(self, message: str | bytes) -> None:
        """A message of the session."""
        if isinstance(message, str):
            found = json.loads(message)
            kind = found.pop("type")
            if kind == "hello":
                self._hello = found
            elif kind == "status":
                self._status = found
                if run := found["runs"][0].get("message"):
                    self._text = run
            elif kind == "picked":
                values = ", ".join(f"{name} {value:.4g}" for name, value in found.get("values", {}).items())
                self._text = f"at {found['at'][0]:.4g}, {found['at'][1]:.4g} m: {values or 'no fluid'}"
            elif kind in ("error", "bye"):
                self._text = found["text"]
            return
        head, rest = protocol.unpack(message)
        if head["type"] == "frame":
            self._frame, pane = head, head["panes"][0]
            self._image = np.asarray(Image.open(io.BytesIO(rest[: pane["bytes"]])).convert("RGB"))
            self._new = True
            self._send("ack", frame=head["frame"])
        elif head["type"] == "file":
            Path(head["name"]).write_bytes(rest)
            self._text = f"{head['name']} is written"
            self._say(self._text)

    def _send(self, kind: str, **content: Any) -> None:
        self._session.receive(self._page, protocol.to_json({"type": kind, **content}))

    def _command(self, name: str, **values: Any) -> None:
        if name in self._hello["commands"]:
            self._send("command", name=name, **values)

    # What is shown

    def _lines(self) -> list[str]:
        run = self._status.get("runs", [{}])[0]
        facts = [run.get("state", ""), f"t = {self._status.get('time', 0.0):.4f} s"]
        if "step" in run:
            facts.append(f"step {run['step']}")
        if "steps_per_second" in run:
            facts.append(f"{run['steps_per_second']:.3g} steps/s")
        if self._frame.get("field"):
            facts.append(f"{self._frame['field']} {self._frame['low']:.4g} to {self._frame['high']:.4g}")
        lines = ["   ".join([*(fact for fact in facts if fact), "keys: tab"])]
        return [*lines, *textwrap.wrap(self._text, 90, max_lines=3)]

    # Keys

    def _bindings(self) -> list[Key]:
        """The keys: those of the page, where they are letters; windows are not told of digits and signs."""
        live = self._hello["live"]

        def layer(name: str) -> Callable[[], None]:
            return lambda: self._send("layers", **{name: not self._status["layers"][name]})

        def shift(x: float, y: float) -> Callable[[], None]:
            return lambda: self._shift(x * SHIFT, y * SHIFT)

        def push(x: float, y: float) -> Callable[[], None]:
            return lambda: self._nudge(x, y)

        times = [
            Key("ArrowRight", "next time", lambda: self._send("step", count=1)),
            Key("ArrowLeft", "previous time", lambda: self._send("step", count=-1)),
            Key("Q", "faster", lambda: self._send("speed", value=2 * self._status["speed"])),
            Key("q", "slower", lambda: self._send("speed", value=0.5 * self._status["speed"])),
        ]
        return [
            Key(" ", "pause, go on" if live else "play, pause", self._play),
            *([] if live else times),
            Key("Enter", "one step of the simulation", lambda: self._command("step", count=1), "step"),
            Key("ArrowLeft", "tilt gravity one way", lambda: self._tilt(-TILT), "gravity"),
            Key("ArrowRight", "tilt gravity the other way", lambda: self._tilt(TILT), "gravity"),
            Key("J", "push to the left, at the pointer", push(-1, 0), "poke"),
            Key("L", "push to the right", push(1, 0), "poke"),
            Key("I", "push up", push(0, 1), "poke"),
            Key("K", "push down", push(0, -1), "poke"),
            Key("n", "add a drop at the pointer", self._drop, "drop"),
            Key("X", "stop the simulation", lambda: self._command("stop"), "stop"),
            Key("ArrowUp", "zoom in", lambda: self._zoom(1 / ZOOM)),
            Key("ArrowDown", "zoom out", lambda: self._zoom(ZOOM)),
            Key("w", "move up", shift(0, 1)),
            Key("a", "move left", shift(-1, 0)),
            Key("s", "move down", shift(0, -1)),
            Key("d", "move right", shift(1, 0)),
            Key("Backspace", "show all", lambda: self._send("window", window=None)),
            Key("f", "next field", lambda: self._next_field(1)),
            Key("F", "previous field", lambda: self._next_field(-1)),
            Key("u", "range of the colours", self._next_range),
            Key("m", "mesh", layer("mesh")),
            Key("p", "particles", layer("particles")),
            Key("v", "arrows", layer("arrows")),
            Key("l", "streamlines", layer("streamlines")),
            Key("t", "tracers", lambda: self._send("layers", tracers=0 if self._status["layers"]["tracers"] else 60)),
            Key("o", "fill", layer("fill")),
            Key("b", "colour all fluids", layer("colour_all")),
            Key("k", "values at the pointer", lambda: self._send("pick", pane=0, at=list(self._at()))),
            Key("g", "take a picture", lambda: self._send("picture")),
            Key("r", "record, end recording", lambda: self._send("record", on=not self._status["recording"])),
            Key("h", "light or dark", lambda: self._send("theme", dark=not self._frame.get("dark", False))),
            Key("Tab", "these keys", self._list),
        ]

    def _has(self, key: Key) -> bool:
        return not key.needs or key.needs in self._hello["commands"]

    def _press(self, key: str) -> None:
        self._text = ""
        for each in self.keys:
            if self._has(each) and each.key == key:
                each.do()
                return
        if key == "Escape":
            self._listed = False

    def _list(self) -> None:
        self._listed = not self._listed

    def _play(self) -> None:
        if self._hello["live"]:
            self._command("pause" if self._status["runs"][0].get("state") == "running" else "go")
        else:
            self._send("play", on=not self._status["playing"])

    def _next_field(self, by: int) -> None:
        names = [None, *(field["name"] for field in self._hello["fields"])]
        self._send("field", name=names[(names.index(self._status["field"]) + by) % len(names)])

    def _next_range(self) -> None:
        if self._status["field"] is not None:
            self._send("range", mode="frame" if self._status["range"]["mode"] == "fixed" else "fixed")

    # The pointer

    def _window(self) -> tuple[float, float, float, float]:
        """The part shown [m]."""
        if self._frame:
            x0, y0, x1, y1 = self._frame["panes"][0]["window"]
            return float(x0), float(y0), float(x1), float(y1)
        pane = self._hello["panes"][0]
        return (*pane["lower"], *pane["upper"])

    def _at(self) -> tuple[float, float]:
        """The point under the pointer [m]."""
        (x0, y0, x1, y1), (x, y) = self._window(), self._screen.pointer
        return x0 + x * (x1 - x0), y0 + y * (y1 - y0)

    def _grab(self, button: str) -> None:
        pushes = button == "LMB" and "poke" in self._hello["commands"]
        self._grabbed = "push" if pushes else "move", self._at() if pushes else self._screen.pointer, self._window()

    def _let_go(self) -> None:
        if self._grabbed and self._grabbed[0] == "push":
            self._command("poke", at=None)
        self._grabbed = self._pushed = None

    def _drag(self) -> None:
        """Push from where the pointer was pressed to where it is, or move the picture with it."""
        if self._grabbed is None:
            return
        what, start, (x0, y0, x1, y1) = self._grabbed
        if what == "push":
            to = self._at()
            self._push(start, to[0] - start[0], to[1] - start[1])
            return
        x, y = self._screen.pointer
        dx, dy = (start[0] - x) * (x1 - x0), (start[1] - y) * (y1 - y0)
        window = [x0 + dx, y0 + dy, x1 + dx, y1 + dy]
        if (dx or dy) and window != self._status.get("window"):
            self._send("window", window=window)

    def _push(self, at: tuple[float, float], dx: float, dy: float) -> None:
        x0, _, x1, _ = self._window()
        length, limits = math.hypot(dx, dy), self._hello["limits"]
        hard = STRENGTH * limits["poke_acceleration"] * min(1.0, length / (REACH * (x1 - x0)))
        push = [hard * dx / length, hard * dy / length] if length else [0.0, 0.0]
        if push != self._pushed or self._grabbed is None:
            self._pushed = push
            self._command("poke", at=list(at), acceleration=push, radius=self._radius("poke", RADIUS))

    def _nudge(self, x: float, y: float) -> None:
        """A short push by a key."""
        x0, _, x1, _ = self._window()
        self._push(self._at(), x * REACH * (x1 - x0), y * REACH * (x1 - x0))
        self._release_at = time.monotonic() + PUSHED

    def _radius(self, command: str, share: float) -> float:
        """Radius of a push or a drop: a share of the largest that the run takes, no less than the smallest [m]."""
        limits: dict[str, float] = self._hello["limits"]
        return max(share * limits[f"{command}_radius"], limits.get(f"least_{command}_radius", 0.0))

    def _drop(self) -> None:
        fluid = self._hello["panes"][0]["fluids"][0]["name"]
        self._command("drop", at=list(self._at()), radius=self._radius("drop", DROP), fluid=fluid)

    def _tilt(self, degrees: float) -> None:
        # The status comes later than the next key.
        told, when = self._tilted
        x, y = told if time.monotonic() - when < TILT_HOLDS else self._status["runs"][0]["gravity"]
        angle, length = math.atan2(y, x) + math.radians(degrees), math.hypot(x, y)
        value = [round(length * math.cos(angle), 4), round(length * math.sin(angle), 4)]
        self._tilted = (value[0], value[1]), time.monotonic()
        self._command("gravity", value=value)

    def _zoom(self, factor: float) -> None:
        x0, y0, x1, y1 = self._window()
        x, y, w, h = (x0 + x1) / 2, (y0 + y1) / 2, factor * (x1 - x0) / 2, factor * (y1 - y0) / 2
        self._send("window", window=[x - w, y - h, x + w, y + h])

    def _shift(self, x: float, y: float) -> None:
        x0, y0, x1, y1 = self._window()
        dx, dy = x * (x1 - x0), y * (y1 - y0)
        self._send("window", window=[x0 + dx, y0 + dy, x1 + dx, y1 + dy])


def show_window(
    sources: Sequence[Source],
    say: Callable[[str], None] = print,
    backend: str = "raster",
    open_screen: Callable[[str, tuple[int, int]], ScreenLike] | None = None,
) -> None:
    """Show a source in a window of its own, until it is closed or the source ends.

    Args:
        sources: one.
        say: takes lines of text.
        backend: of the pictures, see `tipfem.render.Renderer`.
        open_screen: function of a title and a size [px] to a window; by default GGUI's.

    Raises:
        ValueError: there is no display, or the source cannot be drawn.
        DriverError: no Vulkan driver can draw in a window.
    """
    if len(sources) != 1:
        raise ValueError("a window shows one results folder; a browser compares two")
    if open_screen is None:
        from tipfem.render.screen import Screen, has_display

        if not has_display():
            raise ValueError("a window needs a display: DISPLAY is not set; a browser needs none")
        open_screen = Screen
    asyncio.run(_show(sources, say, backend, open_screen))


async def _show(
    sources: Sequence[Source],
    say: Callable[[str], None],
    backend: str,
    open_screen: Callable[[str, tuple[int, int]], ScreenLike],
) -> None:
    session = Session(sources, backend)
    page = NativePage(session, open_screen(sources[0].title or sources[0].name, SIZE), say)
    say("Open in a window; its keys are listed by Tab")
    shown, drawn = asyncio.ensure_future(page.run()), asyncio.ensure_future(session.run())
    await asyncio.wait([shown, drawn], return_when=asyncio.FIRST_COMPLETED)
    shown.cancel()
    session.close("the window was closed")  # also when it has failed
    await asyncio.gather(shown, drawn, return_exceptions=True)
    for task in (shown, drawn):
        if not task.cancelled() and (error := task.exception()):
            raise error


def _called(key: str) -> str:
    """A key's name in the list."""
    shifted = len(key) == 1 and key != key.lower()
    return "space" if key == " " else f"shift {key.lower()}" if shifted else key.removeprefix("Arrow").lower()
