"""The state of a viewer, its pages, and its loop: what is drawn when, and who is sent what.

A session knows nothing of sockets: a page is a function that takes messages. All runs in one thread, on one asyncio
loop; between two pictures the loop takes in what the pages have sent. Without a page that looks, nothing is drawn and
nothing is computed.
"""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from tipfem.render.colours import COLOUR_MAPS
from tipfem.render.viewer import protocol
from tipfem.render.viewer.packing import png
from tipfem.render.viewer.pane import Pane
from tipfem.render.viewer.probe import pick
from tipfem.render.viewer.protocol import ProtocolError
from tipfem.render.viewer.recording import Recording
from tipfem.render.viewer.series import series_of
from tipfem.render.viewer.showing import Showing
from tipfem.render.viewer.source import Source

STATUS_EVERY = 0.1  # seconds between messages of status while time goes on
SERIES_EVERY = 3.0  # seconds between looks at what a run records over time
HISTORY_EVERY = 0.2  # seconds between parts of a history

_TURNS = 6  # of the loop between two pictures, in which messages come in and go out

Send = Callable[[str | bytes], None]


class Page:
    """A page that is connected; ``send`` takes a message for it, and does not wait."""

    def __init__(self, send: Send) -> None:
        self.send = send
        self.steers = False  # whether it is the one that steers
        self.visible = True  # whether it wants frames
        self.waiting: list[int] = []  # numbers of the frames that it has been sent and has not acknowledged
        self.frame = -1  # number of the last frame that it was sent
        self.histories: dict[int, Iterator[dict[str, Any] | None]] = {}  # by pane

    def say(self, kind: str, **content: Any) -> None:
        """Send a message of a type."""
        self.send(protocol.to_json({"type": kind, **content}))

    def file(self, name: str, mime: str, data: bytes) -> None:
        """Send a file to be kept."""
        self.send(protocol.pack({"type": "file", "name": name, "mime": mime}, [data]))

    @property
    def takes_frames(self) -> bool:
        """Whether another frame may be sent."""
        return self.visible and len(self.waiting) < protocol.AHEAD


class Session:
    """Session of a viewer: its pages, and panes of one source, or of two at equal times.

    Raises:
        ValueError: a source cannot be drawn.
    """

    def __init__(self, sources: Sequence[Source], backend: str = "raster") -> None:
        self.showing = Showing(sources, backend)
        self.pages: list[Page] = []
        self._wake = asyncio.Event()
        self._closing: str | None = None
        self._clock = time.monotonic()
        self._looked = [time.monotonic()] * len(sources)
        self._stale, self._new_status = True, True
        self._told = 0.0
        self._series: tuple[float, Any] = -SERIES_EVERY, None  # when they were read, and of which file
        self._message = 0, b""  # number of the last frame, and the frame
        self._drawn: Any = None  # what was in it
        self._recording: Recording | None = None
        self._poking = False
        self._sharing: asyncio.Task[None] | None = None
        self._preparing: asyncio.Task[None] | None = None
        self._sampling: Iterator[bool] | None = None

    # Pages

    def attach(self, send: Send) -> Page:
        """A page that has come; the first one steers. ``send`` takes a message for it, and does not wait."""
        page = Page(send)
        page.steers = not self.pages
        self.pages.append(page)
        page.say("hello", steers=page.steers, **self.showing.hello())
        page.say("status", **self._status())
        self._series = -SERIES_EVERY, None
        self._clock = time.monotonic()
        self._wake.set()
        return page

    def detach(self, page: Page) -> None:
        """A page has gone; the next one steers."""
        if page not in self.pages:
            return
        self.pages.remove(page)
        if page.steers:
            self._end_poke()
            self._end_recording(None)
            if self.pages:
                self.pages[0].steers = True
                self.pages[0].say("role", steers=True)
            else:
                self.showing.playing = False
        self._wake.set()

    def receive(self, page: Page, text: str | bytes) -> None:
        """Take a page's message; what is wrong with it is told to that page alone."""
        if self._closing is not None:  # what still waits to be answered would keep the viewer from ending
            return
        try:
            message = protocol.parse(text)
            kind = message.pop("type")
            if self.showing.solid and kind in protocol.IN_PLANE:
                text = "a flow in 3-D is seen as the surface of its densest fluid; for a plane, tipfem render --slice"
                raise ProtocolError(f"{kind}: {text}")
            if page.steers or kind in protocol.WATCHERS:
                getattr(self, f"_take_{kind}")(page, **message)
        except (ProtocolError, ValueError, OSError) as error:
            page.say("error", text=str(error))
        self._wake.set()

    def close(self, text: str) -> None:
        """End the loop and say goodbye, with the reason."""
        self._closing = text
        self._wake.set()

    # The loop

    async def run(self) -> None:
        """Draw and send until the session is closed or a source has ended."""
        try:
            while self._closing is None:
                self._wake.clear()
                self._look()
                self._go_on()
                busy = self._draw_if_wanted() or self._work()
                self._tell()
                if busy:
                    for _ in range(_TURNS):
                        await asyncio.sleep(0)
                    continue
                with contextlib.suppress(asyncio.TimeoutError):
                    await asyncio.wait_for(self._wake.wait(), self._pause())
        finally:
            if self._preparing is not None:
                await self._preparing
            for page in list(self.pages):
                page.say("bye", text=self._closing or "the viewer has ended")
            if self._recording is not None:
                self._recording.discard()
            for pane in self.showing.panes:
                pane.close()

    @property
    def _watched(self) -> bool:
        return any(page.visible for page in self.pages)

    def _pause(self) -> float | None:
        """Seconds until there is something to do, or None if only a page can bring it."""
        now, due = time.monotonic(), []
        for pane, looked in zip(self.showing.panes, self._looked, strict=True):
            if pane.source.interval is not None and (self._watched or pane.source.live):
                due.append(looked + pane.source.interval)
        if self._watched and self.showing.playing:
            due.append(now + self.showing.until_next())
        if self._new_status and self.pages:
            due.append(self._told + STATUS_EVERY)
        return max(0.0, min(due) - now) if due else None

    def _look(self) -> None:
        """Ask the sources for new states when they are due."""
        now = time.monotonic()
        for number, pane in enumerate(self.showing.panes):
            source = pane.source
            source.watched = self._watched
            if source.ended:
                self._closing = self._closing or "the run has ended"
            if source.interval is None or now - self._looked[number] < source.interval:
                continue
            if not (self._watched or source.live):
                continue
            self._looked[number] = now
            if source.refresh():
                self.showing.runs[number] = dict(source.status())
                self._new_status = True
                if self.showing.live:
                    self.showing.time = self.showing.ends()[1]
                    self._change()

    def _go_on(self) -> None:
        """Advance the time that is shown with the clock."""
        now = time.monotonic()
        passed, self._clock = now - self._clock, now
        if self.showing.playing and self._watched:
            if self.showing.go_on(passed):
                self._change()
            self._new_status = True
            if not self.showing.playing:
                self._told = 0.0  # the end of playing is told at once: a key would otherwise pause what rests

    def _draw_if_wanted(self) -> bool:
        """Make a frame if something has changed and a page takes it, and send what pages lack; whether one was made."""
        takers = [page for page in self.pages if page.takes_frames]
        drawn = bool(takers) and self._stale and not self._ranging
        if drawn:
            self._draw()
        number, message = self._message
        for page in takers:
            if page.frame != number and message:
                page.frame = number
                page.waiting.append(number)
                page.send(message)
        return drawn

    @property
    def _ranging(self) -> bool:
        """Whether the range of the colours is still looked for, so that no picture has other colours than the next."""
        choices = self.showing.choices
        return self._sampling is not None and choices.field is not None and choices.range_mode == "fixed"

    def _draw(self) -> None:
        self._stale = False
        try:
            found = self.showing.vectors()
            if found == self._drawn:
                return
            self.showing.frames += 1
            head = {**found[0], "frame": self.showing.frames}
            self._message, self._drawn = (self.showing.frames, protocol.pack(head, found[1])), found
            if self._recording is not None:
                self._recording.add(self.showing.framed())
        except (ValueError, OSError) as error:
            self.showing.playing, self._new_status = False, True
            self._complain(error)

    def _work(self) -> bool:
        """A piece of what can wait for the pictures: tracers, ranges, histories; whether there was one."""
        if not self._watched:
            return False
        if self._ranging:
            return self._sample_on()
        try:
            for pane, index in zip(self.showing.panes, self.showing.indices(), strict=True):
                moved = None if pane.source.live else pane.tracing(index, self.showing.choices)
                if moved is not None:
                    if moved:
                        self._change()
                    return True
        except ValueError as error:  # a stored time cannot be read
            self.showing.choices.layers["tracers"] = 0
            self._change()
            self._complain(error)
        for page in self.pages:
            for number, history in page.histories.items():
                try:
                    part = next(history)
                    if part is not None:
                        page.send(protocol.to_json(part))
                except StopIteration:
                    del page.histories[number]
                except ValueError as error:
                    del page.histories[number]
                    page.say("error", text=str(error))
                return True
        if self._sample_on():
            return True
        if not self.showing.live and self._preparing is None:
            panes = zip(self.showing.panes, self.showing.indices(), strict=True)
            make = next(filter(None, (pane.prepare(index) for pane, index in panes)), None)
            if make is not None:
                self._preparing = asyncio.ensure_future(self._prepare(make))
        return False

    async def _prepare(self, make: Callable[[], None]) -> None:
        """Prepare a stored time in another thread, while this one answers pages."""
        with contextlib.suppress(ValueError, OSError):  # it is told when that time is shown
            await asyncio.to_thread(make)
            self._preparing = None  # a time that cannot be read is not tried again
            self._wake.set()

    def _tell(self) -> None:
        """Send the status if it has changed, not too often."""
        now = time.monotonic()
        if self._new_status and now - self._told >= STATUS_EVERY:
            self._told, self._new_status = now, False
            for page in self.pages:
                page.say("status", **self._status())
        self._tell_series(now)
        if self._recording is not None and self._recording.too_long:
            self._end_recording(next((page for page in self.pages if page.steers), None))

    def _tell_series(self, now: float) -> None:
        """Send what the run has recorded over time, if there is more of it; of one result, not of two."""
        source = self.showing.panes[0].source
        folder = getattr(source, "folder", None)
        if not self._watched or folder is None or len(self.showing.panes) > 1 or now - self._series[0] < SERIES_EVERY:
            return
        path = Path(folder) / "history.csv"
        stamp = path.stat().st_mtime_ns if path.is_file() else None
        changed, self._series = stamp != self._series[1], (now, stamp)
        if changed:
            for page in self.pages:
                page.say("series", plots=series_of(Path(folder)))

    # What pages send; each `_take_` is named after its message

    def _take_ack(self, page: Page, frame: int) -> None:
        page.waiting = [number for number in page.waiting if number > frame]

    def _take_alive(self, page: Page) -> None:
        page.say("alive")

    def _take_visible(self, page: Page, on: bool) -> None:
        page.visible = on
        page.waiting.clear()
        self._clock = time.monotonic()

    def _take_size(self, page: Page, width: int, height: int) -> None:
        self.showing.choices.width, self.showing.choices.height = width, height
        self._change()

    def _take_theme(self, page: Page, dark: bool) -> None:
        self.showing.choices.dark = dark

    def _take_play(self, page: Page, on: bool) -> None:
        first, last = self.showing.ends()
        if on and self.showing.time >= last and not self.showing.running:
            self.showing.time = first
        self.showing.playing, self._clock = on and not self.showing.live, time.monotonic()
        self._change()
        self._told = 0.0
        self._tell()

    def _take_speed(self, page: Page, value: float) -> None:
        self.showing.speed = value
        self._new_status = True

    def _take_show(self, page: Page, time: float) -> None:
        if not self.showing.live:
            self.showing.show(time)
            self._change()

    def _take_step(self, page: Page, count: int) -> None:
        if not self.showing.live:
            self.showing.playing = False
            self.showing.step(count)
            self._change()

    def _take_field(self, page: Page, name: str | None) -> None:
        self.showing.choices.field = None if name is None else self._known(name)
        if self.showing.choices.range_mode == "given":
            self.showing.choices.range_mode = "fixed"
        self._sample()
        self._change()

    def _take_range(self, page: Page, mode: str, low: float = 0.0, high: float = 1.0) -> None:
        self.showing.choices.range_mode = mode
        if mode == "given":
            self.showing.choices.given = (low, high)
        self._change()

    def _take_map(self, page: Page, name: str | None) -> None:
        if name is not None and name not in COLOUR_MAPS:
            raise ValueError(f"map: {name!r}, expected one of {', '.join(COLOUR_MAPS)}")
        self.showing.choices.colour_map = name
        self._change()

    def _take_layers(self, page: Page, **layers: Any) -> None:
        if layers.get("contours") is not None:
            self._known(layers["contours"])
        self.showing.choices.layers |= layers
        self._change()

    def _take_window(self, page: Page, window: tuple[float, float, float, float] | None) -> None:
        self.showing.choices.show(window)
        self._change()

    def _take_follow(self, page: Page, what: str | None) -> None:
        kind, _, name = (what or "front").partition(":")
        for pane in self.showing.panes:
            names = pane.source.fluid_names
            if what is not None and not (what == "front" or what in names or (kind == "front" and name in names)):
                known = ", ".join(names)
                raise ValueError(f"follow: {what!r}, expected front, front:NAME or NAME; the fluids are {known}")
        self.showing.choices.follow = what
        self._change()

    def _take_pick(self, page: Page, pane: int, at: tuple[float, float], history: bool = False) -> None:
        if pane >= len(self.showing.panes):
            raise ValueError(f"pick: pane {pane}, there are {len(self.showing.panes)}")
        shown = self.showing.panes[pane]
        assert isinstance(shown, Pane), "a flow in 3-D takes no such message"
        found = pick(shown.source.scene(self.showing.indices()[pane]), at)
        page.say("picked", pane=pane, at=at, pinned=history, **found)
        if history:
            page.histories.pop(pane, None)
            if not self.showing.live:
                page.histories[pane] = _told_at_times(shown.history(at), pane, at)

    def _take_camera(self, page: Page, azimuth: float, elevation: float) -> None:
        if not self.showing.solid:
            raise ValueError("camera: the flow is in 2-D")
        self.showing.choices.camera = azimuth, elevation
        self._new_status = True

    def _take_picture(self, page: Page) -> None:
        name = f"{self.showing.file_name}_{self.showing.time:.4f}s.png"
        page.file(name, "image/png", png(self.showing.framed()))

    def _take_share(self, page: Page) -> None:
        made = self.showing.panes[0].page(self.showing.choices)

        async def send() -> None:
            try:
                data = (await asyncio.to_thread(made)).encode()
            except (ValueError, OSError) as error:
                page.say("error", text=str(error))
                return
            page.file(f"{self.showing.panes[0].source.name}.html", "text/html", data)

        self._sharing = asyncio.ensure_future(send())

    def _take_record(self, page: Page, on: bool) -> None:
        if on and self._recording is None:
            self._recording = Recording(self.showing.framed())
        elif not on:
            self._end_recording(page)
        self._new_status = True

    def _take_command(self, page: Page, name: str, values: dict[str, Any]) -> None:
        source = self.showing.panes[0].source
        if name not in source.commands:
            known = ", ".join(sorted(source.commands)) or "none"
            why = "; flows in 3-D are pushed, dropped into and tilted from Python only" if self.showing.solid else ""
            raise ValueError(f"command {name!r}: it must be one of {known}{why}")
        source.command(name, values)
        if name == "poke":
            self._poking = values["at"] is not None

    # What the rest is made of

    def _change(self) -> None:
        """Mark the view as changed."""
        self._stale = self._new_status = True
        self._wake.set()

    def _known(self, name: str) -> str:
        if name not in self.showing.fields:
            raise ValueError(f"field: {name!r}, expected one of {', '.join(self.showing.fields)}")
        return name

    def _sample(self) -> None:
        def all_panes() -> Iterator[bool]:
            for pane in self.showing.panes:
                yield from pane.sampling()

        self._sampling = all_panes()

    def _sample_on(self) -> bool:
        """Look at a stored time for the ranges of fields; whether there was one."""
        if self._sampling is None:
            return False
        try:
            next(self._sampling)
        except (StopIteration, ValueError):
            self._sampling = None
            self._change()
        return True

    def _end_recording(self, page: Page | None) -> None:
        """End the movie, and send it to a page if there is one."""
        recording, self._recording = self._recording, None
        if recording is None:
            return
        self._new_status = True
        if page is None:
            recording.discard()
            return
        page.file(f"{self.showing.file_name}.mp4", "video/mp4", recording.finish())

    def _complain(self, error: Exception) -> None:
        for page in self.pages:
            page.say("error", text=str(error))

    def _status(self) -> dict[str, Any]:
        return {**self.showing.status(), "recording": self._recording is not None, "pages": len(self.pages)}

    def _end_poke(self) -> None:
        if self._poking:
            self._poking = False
            self.showing.panes[0].source.command("poke", {"at": None})


def _told_at_times(
    parts: Iterator[tuple[list[float], dict[str, list[float | None]], float]], pane: int, at: tuple[float, float]
) -> Iterator[dict[str, Any] | None]:
    """Messages with a growing history, not more often than a page can draw it, and None between them."""
    told = time.monotonic()
    for times, values, done in parts:
        if done >= 1 or time.monotonic() - told > HISTORY_EVERY:
            told = time.monotonic()
            yield {"type": "history", "pane": pane, "at": at, "times": times, "values": values, "done": done}
        else:
            yield None
