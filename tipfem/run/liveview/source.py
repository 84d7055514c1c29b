"""LiveSource: a running simulation as a source of the viewer."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

import numpy as np

from tipfem.render import Scene, Volume
from tipfem.render.setting import Setting
from tipfem.results.fields.catalogue import Flow
from tipfem.run.liveview.memory import Snapshot

LOOKED_EVERY = 0.02  # seconds between looks at a run that somebody watches
IDLE = 1.0  # seconds between looks at one that nobody watches
COMMANDS = frozenset({"pause", "go", "step", "stop", "gravity", "poke", "drop"})
IN_PLANE = frozenset({"gravity", "poke", "drop"})  # commands for which a page needs a plane


class Feed(Protocol):
    """Source of the states of a run, ``published`` so far; see `tipfem.run.liveview.memory.StateMemory`."""

    wanted: bool

    @property
    def published(self) -> int:
        """See the attributes."""

    @property
    def ended(self) -> bool:
        """See the attributes."""

    @property
    def paused(self) -> bool:
        """See the attributes."""

    def latest(self) -> Snapshot | None:
        """The latest state."""


class Scenes(Setting):
    """Scenes, or volumes, of the states of a run of a case with the facts of `describe`."""

    def of(self, state: Snapshot) -> Scene | Volume:
        """A state as it is drawn, as a volume in 3-D."""
        data = {"velocity": state.velocity.astype(np.float64), "pressure": state.pressure.astype(np.float64)}
        data |= {"density": np.take(self.fluid_densities, state.fluid), "fluid": state.fluid}
        laws, place = state.laws if len(state.laws) else None, (state.position, state.cells, state.cell_fluid)
        flow = Flow(data, *place, self.fluid_densities, laws, self.period, self.spacing, self.axial)
        walls = state.position[state.wall > 0]  # which may have moved; there may be none
        box = {"lower": np.minimum(self.lower, walls.min(axis=0, initial=np.inf))}
        box["upper"] = np.maximum(self.upper, walls.max(axis=0, initial=-np.inf))
        if self.dimension == 3:
            return self.volume_of(flow, state.time, state.wall != 0, state.poses.ravel(), **box)
        poses = [tuple(map(float, pose)) for pose in state.poses]
        return self.scene_of(flow, state.time, state.wall, poses, self.names_of(state.shut), **box)


class LiveSource:
    """A running simulation, with the facts of `describe` and a feed of states; see `tipfem.render.viewer.Source`.

    ``send`` takes a command's name and values, ``messages`` gives the latest line about one that was refused, or "".
    """

    live = True

    def __init__(
        self,
        facts: Mapping[str, Any],
        feed: Feed,
        send: Callable[[str, Mapping[str, Any]], None],
        messages: Callable[[], str] = lambda: "",
    ) -> None:
        self._scenes = scenes = Scenes(facts)
        self.name, self.title = str(facts["name"]), scenes.title
        self.folder: str | None = facts["folder"]  # of the results, for the command that draws them
        self.fluid_names, self.fluid_densities = scenes.fluid_names, scenes.fluid_densities
        self.spacing, self.dimension = scenes.spacing, scenes.dimension
        self.limits: Mapping[str, float] = dict(facts["limits"])
        self.steered: Mapping[str, Sequence[Any]] = facts["steered"]
        self.tool = "poke" if facts.get("hand") else "look"
        more = {**self.steered, "again": facts.get("again"), "undo": facts.get("undo")}
        self._axial = scenes.axial
        without = IN_PLANE if self.dimension == 3 else {"drop"} if self._axial else set()
        self.commands = COMMANDS - without | {name for name, there in more.items() if there}
        self._feed, self._send, self._messages = feed, send, messages
        self._seen: tuple[Any, ...] = ()
        self._shown: tuple[Snapshot, Scene | Volume] | None = None
        first = feed.latest()
        if first is None:
            raise ValueError("the run has no state to show yet")
        self._latest = first

    @property
    def watched(self) -> bool:
        """Whether a page looks; said by the viewer."""
        return self._feed.wanted

    @watched.setter
    def watched(self, watched: bool) -> None:
        self._feed.wanted = watched

    @property
    def times(self) -> Sequence[float]:
        """The present time [s]."""
        return [self._latest.time]

    @property
    def interval(self) -> float | None:
        """Seconds after which `refresh` is to be called again."""
        return LOOKED_EVERY if self.watched else IDLE

    @property
    def ended(self) -> bool:
        """Whether the run has ended."""
        return self._feed.ended

    def refresh(self) -> bool:
        """Take the latest state; see `Source.refresh`."""
        seen = self._feed.published, self._feed.paused, self._messages()
        if seen == self._seen:
            return False
        self._seen = seen
        self._latest = self._feed.latest() or self._latest
        return True

    def scene(self, index: int) -> Scene:
        """The latest state; see `Source.scene`."""
        drawn = self._drawn()
        assert isinstance(drawn, Scene), "the flow is in 2-D"
        return drawn

    def volume(self, index: int) -> Volume:
        """The latest state; see `Source.volume`."""
        drawn = self._drawn()
        assert isinstance(drawn, Volume), "the flow is in 3-D"
        return drawn

    def _drawn(self) -> Scene | Volume:
        latest = self._latest
        if self._shown is None or self._shown[0] is not latest:
            self._shown = latest, self._scenes.of(latest)
        return self._shown[1]

    def status(self) -> Mapping[str, Any]:
        """See `Source.status`."""
        latest = self._latest
        state = "complete" if self._feed.ended else "paused" if self._feed.paused else "running"
        found: dict[str, Any] = {"state": state, "step": latest.step, "gravity": list(latest.gravity)}
        if state == "running" and math.isfinite(latest.speed):
            found["steps_per_second"] = latest.speed
            if math.isfinite(latest.pace):
                found["pace"] = latest.pace
        if message := self._messages():
            found["message"] = message
        return found

    def command(self, name: str, values: Mapping[str, Any]) -> None:
        """Pass a command on; see `Source.command`."""
        if name not in self.commands:
            raise ValueError(f"command {name!r}: it must be one of {', '.join(sorted(self.commands))}")
        for key, most in (("acceleration", "poke_acceleration"), ("value", "gravity")):
            if (
                name in ("poke", "gravity")
                and key in values
                and math.hypot(*values[key]) > self.limits[most] * (1 + 1e-6)
            ):
                raise ValueError(f"{name}: {key} must be at most {self.limits[most]:g} m/s^2")
        self._send(name, on_computed_side(values) if self._axial and name == "poke" else values)

    def close(self) -> None:
        """Nothing is held."""


def on_computed_side(values: Mapping[str, Any]) -> dict[str, Any]:
    """The values of a poke of a picture with both sides of an axis, on the side that is computed."""
    mirrored = dict(values)
    if values.get("at") and values["at"][0] < 0:
        for key in {"at", "acceleration"} & set(values):
            mirrored[key] = [-values[key][0], values[key][1]]
    return mirrored
