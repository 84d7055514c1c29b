"""LiveSource: a running simulation as a source of the viewer."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

import numpy as np

from tipfem.render import Scene, Volume
from tipfem.render.blocks import Blocks
from tipfem.render.bodies import BodyOutline
from tipfem.render.mirror import mirrored_outline
from tipfem.render.openings import gaps_of, seen_of
from tipfem.render.tank import TankOutline
from tipfem.render.volume import upwards
from tipfem.results.fields.catalogue import Flow, drawn_fields
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


class Scenes:
    """Scenes, or volumes, of the states of a run of a case with the facts of `describe`."""

    def __init__(self, facts: Mapping[str, Any]) -> None:
        self.title = str(facts["title"])
        self.fluid_names = tuple(str(name) for name in facts["fluid_names"])
        self.fluid_densities = tuple(float(value) for value in facts["fluid_densities"])
        self.spacing = float(facts["spacing"])
        self._lower, self._upper = np.array(facts["lower"]), np.array(facts["upper"])
        self._period = None if facts["period"] is None else np.array(facts["period"])
        self._bodies = [BodyOutline(body) for body in facts["bodies"]]
        self._openings = gaps_of(facts["openings"])
        tank, self._axial = facts["tank"], bool(facts.get("axial"))
        tank = mirrored_outline(tank) if tank and self._axial else tank
        self._tank = None if tank is None else TankOutline(tank, self.spacing)
        self._blocks = Blocks.of(facts["blocks"])
        self._up, self.dimension = upwards(facts["gravity"]), len(self._lower)

    def of(self, state: Snapshot) -> Scene | Volume:
        """A state as it is drawn, as a volume in 3-D."""
        velocity = state.velocity.astype(np.float64)
        data = {"velocity": velocity, "pressure": state.pressure.astype(np.float64)}
        data["density"] = np.take(self.fluid_densities, state.fluid)
        data["fluid"] = state.fluid
        laws, place = state.laws if len(state.laws) else None, (state.position, state.cells, state.cell_fluid)
        flow = Flow(data, *place, self.fluid_densities, laws, self._period, self.spacing, self._axial)
        fields, cell_fields = drawn_fields(flow)
        lower, upper = self._box(state)
        shared: dict[str, Any] = dict(position=state.position, cells=state.cells, fluid=state.fluid, fields=fields)
        shared |= dict(cell_fields=cell_fields, time=state.time, cell_fluid=state.cell_fluid, title=self.title)
        shared |= dict(fluid_names=self.fluid_names, fluid_densities=self.fluid_densities, spacing=self.spacing)
        shared |= dict(lower=lower, upper=upper)
        if self.dimension == 3:
            return Volume(**shared, wall=state.wall != 0, up=self._up, blocks=self._blocks, pose=state.bodies.ravel())
        shut = [self._openings[k].name for k in state.shut]
        return Scene(
            **shared,
            wall=state.wall,
            bodies=tuple(
                body.placed(*(float(value) for value in pose))
                for body, pose in zip(self._bodies, state.bodies[:-1], strict=True)
            ),
            tank=None if self._tank is None else self._tank.placed(*(float(value) for value in state.bodies[-1])),
            openings=seen_of(self._openings, shut, state.position, velocity),
            period=self._period,
            axial=self._axial,
        )

    def _box(self, state: Snapshot) -> tuple[Any, Any]:
        """The box of the walls, which may have moved."""
        walls = state.position[state.wall > 0]
        lower, upper = walls.min(axis=0, initial=np.inf), walls.max(axis=0, initial=-np.inf)  # there may be none
        return np.minimum(self._lower, lower), np.maximum(self._upper, upper)


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
        self.viscosities: Sequence[float] = facts["viscosities"]
        self.floating: Sequence[int] = facts["floating"]
        self.openings: Sequence[Mapping[str, str]] = [
            {"name": str(one["name"]), "kind": str(one["kind"])} for one in facts["openings"]
        ]
        kinds = {one["kind"] for one in self.openings}
        self.tool = "poke" if facts.get("hand") else "look"
        more = {"again": facts.get("again"), "undo": facts.get("undo"), "valve": kinds, "discharge": "inlet" in kinds}
        self.walls: Sequence[Mapping[str, Any]] = facts["walls"]
        self.tensions: Sequence[Mapping[str, Any]] = facts["tensions"]
        more |= {"viscosity": self.viscosities, "tension": self.tensions, "wall": self.walls}
        self._axial = bool(facts.get("axial"))
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
