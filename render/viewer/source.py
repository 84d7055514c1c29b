"""Sources of states that a viewer shows, such as a results folder or a simulation that is running."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

from tipfem.render import Results, ResultsError, Scene, Volume

from tipfem.results.folder_lock import LOCK
from tipfem.results.reader import RunResults

PICTURE = (1280, 720)  # a picture or a movie to keep [px]
PREPARED = 50  # stored times after the one that is shown, which are made ready
KEPT = 64  # scenes that are kept with their geometry, to go back and forth in time
# Seconds between looks at a results folder to which a run may be adding.
FOLLOWED_EVERY = 1.0


class Source(Protocol):
    """States of a flow by time, and what may be asked of the simulation behind them.

    The viewer calls a source from one thread, that which draws. Nothing may wait for long: `refresh` and `command` are
    called between pictures.

    Attributes:
        name: short, such as that of a results folder.
        title: of the case, or "".
        fluid_names: names of the F fluids.
        fluid_densities: (F,) [kg/m^3].
        spacing: of the particles [m].
        dimension: of the flow; in 3-D it has volumes and no scenes.
        times: of the states that `scene` returns [s], growing; a simulation without stored states has one, its
            present time.
        live: whether a simulation is behind it that is going on, or paused, in step with the viewer.
        commands: names of the commands that `command` takes; see `tipfem.render.viewer.protocol`. None for results.
        limits: the largest values that `command` takes, by name, for the page's controls: "gravity" [m/s^2],
            "poke_acceleration" [m/s^2], "poke_radius" [m], "drop_radius" [m]; and the smallest,
            "least_poke_radius" [m] and "least_drop_radius" [m].
        tool: what the pointer does at first: "look" moves the picture, "poke" pushes the fluids.
        steered: what commands act on, by their names; see the message `hello` of `tipfem.render.viewer.protocol`.
        interval: seconds after which `refresh` is to be called again; None when nothing will change.
        watched: whether a page looks; the viewer sets it before it asks for anything.
        ended: whether the viewer is to say goodbye to its clients and end, with the run that it shows.
    """

    name: str
    title: str
    fluid_names: tuple[str, ...]
    fluid_densities: tuple[float, ...]
    spacing: float
    dimension: int
    live: bool
    commands: frozenset[str]
    limits: Mapping[str, float]
    tool: str
    steered: Mapping[str, Sequence[Any]]
    watched: bool

    @property
    def times(self) -> Sequence[float]:
        """See the attributes."""

    @property
    def interval(self) -> float | None:
        """See the attributes."""

    @property
    def ended(self) -> bool:
        """See the attributes."""

    def refresh(self) -> bool:
        """Look for new states; returns whether there are any, or the status has changed."""

    def scene(self, index: int) -> Scene:
        """The state at one of the times, from 0, or -1 for the latest; `ValueError` if it cannot be read."""

    def volume(self, index: int) -> Volume:
        """The state of a flow in 3-D, see `scene`."""

    def status(self) -> Mapping[str, Any]:
        """Status of the run for the page, as JSON.

        "state", such as running, paused or complete; for a simulation "step", "gravity" (2,) [m/s^2] and
        "steps_per_second"; and "message" for a line of text.
        """

    def command(self, name: str, values: Mapping[str, Any]) -> None:
        """Pass a command on to the simulation, without waiting for what comes of it.

        Its values, in SI units, are checked for their form: numbers are finite, points have two. `ValueError` if one is
        not possible; the message, which the page shows, says what would be.
        """

    def close(self) -> None:
        """Free what the source holds."""


class ResultsSource:
    """The stored times of a results folder, of a run that has ended or is still going; see `Source`.

    Raises:
        ValueError: it cannot be read; the message names the file.
    """

    live = False
    watched = False
    commands: frozenset[str] = frozenset()
    limits: Mapping[str, float] = {}
    tool = "look"
    steered: Mapping[str, Sequence[Any]] = {}
    ended = False
    interval: float | None = FOLLOWED_EVERY

    def __init__(self, out: str | Path) -> None:
        self.folder = Path(out)
        self._results = Results(self.folder, keep=KEPT, solid=True)
        self.dimension = self._results.dimension
        self._run = RunResults(self.folder)
        self._seen = self._stamp()
        self.name = self.folder.resolve().name
        self.title = self._results.title
        self.fluid_names = self._results.fluid_names
        self.fluid_densities = self._results.fluid_densities
        self.spacing = self._results.spacing

    @property
    def times(self) -> Sequence[float]:
        """Stored times [s]."""
        return list(self._results.times)

    def refresh(self) -> bool:
        """Read the list of stored times again if it has changed."""
        stamp = self._stamp()
        if stamp == self._seen:
            return False
        try:
            self._results.refresh()
        except ResultsError:  # a run that begins anew removes its files first
            return False
        self._seen = stamp
        return True

    def scene(self, index: int) -> Scene:
        """One of the stored times; see `Source.scene`."""
        return self._results.scene(index)

    def volume(self, index: int) -> Volume:
        """One of the stored times; see `Source.volume`."""
        return self._results.volume(index)

    def reading(self, index: int) -> Callable[[], Scene]:
        """Function that reads one of the stored times, see `scene`, in another thread, and keeps nothing."""
        results = copy.copy(self._results)  # with a list of scenes of its own
        results.forget()
        return lambda: results.scene(index)

    def status(self) -> Mapping[str, Any]:
        """The status of the run that wrote the results: running, complete, interrupted and others."""
        return {"state": self._run.refresh().status}

    def command(self, name: str, values: Mapping[str, Any]) -> None:
        """`ValueError`: results take no commands."""
        raise ValueError(f"command {name!r}: stored results take none")

    def close(self) -> None:
        """Nothing is held."""

    def _stamp(self) -> list[int]:
        """Times of change of the files that list the stored times."""
        paths = (self.folder / name for name in ("case.json", "fields.pvd", "fields.vtkhdf", "summary.json", LOCK))
        return [path.stat().st_mtime_ns if path.is_file() else 0 for path in paths]
