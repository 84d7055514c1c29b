"""A flow in 3-D in a viewer: the surface of its densest fluid, which each page turns."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from tipfem.render import Results, View
from tipfem.render.solid import SolidRenderer
from tipfem.render.viewer.choices import Choices
from tipfem.render.viewer.packing import fluid_looks
from tipfem.render.viewer.share import SOLID, STATES_PER_SECOND, assembled
from tipfem.render.viewer.solid_share import SolidState, solid_state, space_of, surface_page, told_of_surfaces
from tipfem.render.viewer.source import PICTURE, PREPARED, Source

from tipfem.typing import Array

MOST_SEEN = 400  # states of a run that are kept to be shared, of some 100 kB each


class SolidPane:
    """One source in 3-D in a viewer; as `tipfem.render.viewer.pane.Pane`, without fields and layers.

    Raises:
        ValueError: there are more than two fluids.
    """

    def __init__(self, source: Source) -> None:
        if len(source.fluid_names) > 2:
            raise ValueError(f"{', '.join(source.fluid_names)}: flows of three fluids or more in 3-D cannot be viewed")
        self.source = source
        self._space = space_of(source.volume(0))
        self.lower, self.upper = np.array(self._space["lower"]), np.array(self._space["upper"])
        self._kept: dict[tuple[int, float], SolidState] = {}  # by the number and the time of stored states
        self._seen: deque[SolidState] = deque(maxlen=MOST_SEEN)  # of a run
        self._renderers: dict[bool, SolidRenderer] = {}

    def hello(self) -> dict[str, Any]:
        """Facts of the flow for the message `hello`."""
        fluids = fluid_looks(self.source.fluid_names, self.source.fluid_densities)
        return {"solid": self._space, "fluids": fluids, "solids": []}

    def vectors(self, index: int, choices: Choices) -> tuple[dict[str, Any], bytes]:
        """Entry of a stored time in the frame's message, and bytes from which a page draws it."""
        state = self._state(index)
        if self.source.live:
            while self._seen and self._seen[-1].time >= state.time:
                self._seen.pop()  # the run has gone back
            self._seen.append(state)
        entry = {"time": state.time, "index": index, "counts": state.counts, "edges": state.edges, "notes": []}
        return {**entry, "muted": [], "smooth": False, "bytes": len(state.data)}, state.data

    def framed(self, index: int, choices: Choices) -> Array:
        """The picture of a stored time from the side that is seen, to keep; (H, W, 3) uint8."""
        if choices.dark not in self._renderers:
            self._renderers[choices.dark] = SolidRenderer(PICTURE, dark=choices.dark)
        picture = self._renderers[choices.dark].frame(self.source.volume(index), View(camera=choices.camera))
        return np.asarray(picture)

    def page(self, choices: Choices) -> Callable[[], str]:
        """Function that makes the page to share, of a results folder, or of the states seen; it may take a while."""
        folder = getattr(self.source, "folder", None)
        if not self.source.live and folder is not None:
            return lambda: _page(*surface_page(Results(folder, solid=True), STATES_PER_SECOND))
        seen, latest, title = list(self._seen), self.source.volume(-1), self.source.title or self.source.name
        if not seen:
            raise ValueError("share: nothing has been seen of the run yet")
        passed = seen[-1].time - seen[0].time
        rate = (len(seen) - 1) / passed if passed > 0 else STATES_PER_SECOND
        return lambda: _page(*told_of_surfaces(latest, seen, title, rate))

    def prepare(self, index: int) -> Callable[[], None] | None:
        """Function that makes the surface at one of the times to be shown next; see `Pane.prepare`."""
        times = self.source.times
        missing = (k for k in range(index, min(index + PREPARED, len(times))) if (k, times[k]) not in self._kept)
        found = next(missing, None)
        return None if found is None else lambda: self._keep(found)

    def tracing(self, index: int, choices: Choices) -> bool | None:
        """There are no tracers."""
        return None

    def sampling(self) -> Iterator[bool]:
        """There are no ranges."""
        return iter(())

    def fields(self) -> list[str]:
        """There are no fields to be seen."""
        return []

    def close(self) -> None:
        """Free the buffers and the source."""
        for renderer in self._renderers.values():
            renderer.close()
        self.source.close()

    def _state(self, index: int) -> SolidState:
        if self.source.live:
            return solid_state(self.source.volume(index), self.lower, self.upper)
        return self._kept.get((index, self.source.times[index])) or self._keep(index)

    def _keep(self, index: int) -> SolidState:
        made = solid_state(self.source.volume(index), self.lower, self.upper)
        self._kept[index, self.source.times[index]] = made
        return made


def _page(facts: dict[str, Any], poster: str, data: bytes) -> str:
    page: str = assembled([facts], poster, data, SOLID)
    return page
