"""Contents of a viewer: one source or two at equal times, and the frames that pages are sent."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from tipfem.render.camera import USUAL
from tipfem.render.colours import COLOUR_MAPS
from tipfem.render.scales import colour_map_of
from tipfem.render.viewer import protocol
from tipfem.render.viewer.choices import Choices
from tipfem.render.viewer.pane import Pane
from tipfem.render.viewer.solid_pane import SolidPane
from tipfem.render.viewer.source import Source

from tipfem.results.fields.catalogue import field_of
from tipfem.typing import Array

STORED_PER_SECOND = 25.0  # stored times played in a second, at the speed that a viewer begins with


class Showing:
    """One source, or two that are compared, at one time.

    Attributes:
        panes: one of each source.
        choices: what is seen of them.
        solid: whether the flows are in 3-D.
        live: whether all sources are simulations that go on.
        fields: names of the fields that all sources have.
        time: that is shown [s]; each pane shows its stored time nearest to it.
        playing: whether it goes on with the clock.
        speed: simulated seconds per second.
        runs: status of each source.
        frames: number of frames drawn.

    Raises:
        ValueError: a source cannot be drawn.
    """

    def __init__(self, sources: Sequence[Source], backend: str) -> None:
        if len(sources) not in (1, 2):
            raise ValueError(f"{len(sources)} results: expected one, or two to compare")
        self.solid = sources[0].dimension == 3
        if self.solid != (sources[-1].dimension == 3):
            raise ValueError("one flow is in 2-D and the other in 3-D; look at them one after the other")
        self.panes: list[Pane | SolidPane] = [
            SolidPane(source) if self.solid else Pane(source, backend) for source in sources
        ]
        for pane, other in zip(self.panes, reversed(self.panes), strict=True):
            if pane is not other and isinstance(pane, Pane) and isinstance(other, Pane):
                pane.share_ranges(other)
        lower, upper = np.min([p.lower for p in self.panes], axis=0), np.max([p.upper for p in self.panes], axis=0)
        self.choices = Choices(tuple(lower.tolist()), tuple(upper.tolist()), camera=USUAL if self.solid else None)
        self.live = all(source.live for source in sources)
        fields = [pane.fields() for pane in self.panes]
        self.fields = [name for name in fields[0] if all(name in names for names in fields)]
        first, last = self.ends()
        self.time = last if self.live else first
        self.playing = False
        self.speed = STORED_PER_SECOND * self.interval()
        self.runs = [dict(source.status()) for source in sources]
        self.frames = 0

    @property
    def running(self) -> bool:
        """Whether a run behind the sources is going on."""
        return any(run.get("state") == "running" for run in self.runs)

    def indices(self) -> list[int]:
        """The numbers of the times shown."""
        if self.live:
            return [len(pane.source.times) - 1 for pane in self.panes]
        return [_nearest(pane.source.times, self.time) for pane in self.panes]

    def ends(self) -> tuple[float, float]:
        """The first and the last time [s]."""
        times = [pane.source.times for pane in self.panes]
        return min(each[0] for each in times), max(each[-1] for each in times)

    @property
    def times(self) -> list[float]:
        """The stored times of all sources, each once [s]."""
        return sorted({time for pane in self.panes for time in pane.source.times})

    def index(self) -> int:
        """The number among `times` of the one that is shown."""
        times = np.asarray(self.times)
        return len(times) - 1 if self.live else int(np.argmin(np.abs(times - self.time)))

    def interval(self) -> float:
        """Usual time between stored times [s]; a second if there is only one."""
        times = self.times
        return float(np.median(np.diff(times))) if len(times) > 1 else 1.0

    def show(self, time: float) -> None:
        """Go to a time [s], or to the end that is nearer."""
        first, last = self.ends()
        self.time = min(max(time, first), last)

    def step(self, count: int) -> None:
        """Go on by a number of stored times, or back."""
        times = self.times
        self.time = times[min(max(self.index() + count, 0), len(times) - 1)]

    def go_on(self, passed: float) -> bool:
        """Advance the time by so much of the clock [s]; returns whether another stored time is to be shown."""
        before, last = self.indices(), self.ends()[1]
        self.time = min(self.time + passed * self.speed, last)
        if self.time >= last and not self.running:
            self.playing = False
        return self.indices() != before

    def until_next(self) -> float:
        """Seconds by the clock until another stored time is to be shown, from a millisecond to a second."""
        wait = 1.0
        for pane in self.panes:
            times, index = pane.source.times, _nearest(pane.source.times, self.time)
            if index + 1 < len(times):
                wait = min(wait, ((times[index] + times[index + 1]) / 2 - self.time) / self.speed)
        return max(wait, 1e-3)

    def vectors(self) -> tuple[dict[str, Any], list[bytes]]:
        """The present frame, without its number; `ValueError` if a stored time cannot be read or drawn."""
        choices, pane = self.choices, self.panes[0]
        found = [pane.vectors(index, choices) for pane, index in zip(self.panes, self.indices(), strict=True)]
        field = choices.field
        low, high = 0.0, 0.0
        if field is not None and isinstance(pane, Pane):
            low, high = pane.field_range(pane.source.scene(self.indices()[0]), choices) or (0.0, 1.0)
        colours = choices.colour_map or (colour_map_of(field) if field else None)
        head = {"type": "frame", "field": field, "low": low, "high": high, "map": colours}
        head["moves"] = self.playing or (self.live and self.running)
        return {**head, "panes": [entry for entry, _ in found]}, [data for _, data in found]

    def framed(self) -> Array:
        """The present picture with axes; two are side by side."""
        images = [pane.framed(index, self.choices) for pane, index in zip(self.panes, self.indices(), strict=True)]
        return np.concatenate(images, axis=1)

    @property
    def file_name(self) -> str:
        """The beginning of the names of files with what is shown."""
        names = [pane.source.name for pane in self.panes]
        name = "_".join([*names, self.choices.field] if self.choices.field else names)
        return "".join(letter if letter.isalnum() or letter in "-_." else "_" for letter in name)

    def hello(self) -> dict[str, Any]:
        """Constants that a page is sent once; see the message `hello`."""
        sources = [pane.source for pane in self.panes]
        return {
            "version": protocol.VERSION,
            "live": self.live,
            "panes": [
                {
                    "name": pane.source.name,
                    "title": pane.source.title,
                    "lower": self.choices.lower,
                    "upper": self.choices.upper,
                    "spacing": pane.source.spacing,
                    **pane.hello(),
                }
                for pane in self.panes
            ],
            "fields": [
                {"name": name, "label": field.label, "unit": field.unit, "positive": field.scale == "positive"}
                for name, field in zip(self.fields, map(field_of, self.fields), strict=True)
            ],
            "maps": COLOUR_MAPS,
            "commands": sorted(sources[0].commands),
            "limits": dict(sources[0].limits),
            "tool": sources[0].tool,
            **{key: list(sources[0].steered.get(command, ())) for key, command in protocol.STEERED.items()},
        }

    def status(self) -> dict[str, Any]:
        """Status that pages are sent repeatedly; see the message `status`."""
        first, last = self.ends()
        return {
            "time": self.time,
            "index": self.index(),
            "times": {"first": first, "last": last, "count": len(self.times), "interval": self.interval()},
            "playing": self.playing,
            "speed": self.speed,
            "runs": self.runs,
            "command": " && ".join(
                self.choices.command(str(folder))
                for folder in (getattr(pane.source, "folder", None) for pane in self.panes)
                if folder is not None
            ),
            **self.choices.report(),
        }


def _nearest(times: Sequence[float], time: float) -> int:
    """The number of the stored time nearest to a time [s]."""
    after = int(np.searchsorted(times, time))
    if after == 0:
        return 0
    if after == len(times):
        return after - 1
    return after if times[after] - time < time - times[after - 1] else after - 1
