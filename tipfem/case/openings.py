"""Openings: straight parts of the walls of a tank in 2-D through which fluids enter and leave."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

import numpy as np
from annotated_types import Ge, Len, MinLen

from tipfem.arguments import is_number, meant, numbers
from tipfem.case.declaration import Unit, require
from tipfem.case.fluid import Fluid
from tipfem.errors import Invalid
from tipfem.typing import Array

PROFILES = Literal["plug", "parabola", "power"]
Strength = Callable[[float], float]  # discharge over time
Pair = Annotated[Sequence[float], Len(2, 2)]
OfPlace = Callable[[Array, float], Array]
LIQUID = 50.0  # density over that of the lightest fluid above which a fluid is no gas beside it
BACK = 0.05  # part of what left by an outlet above which its coming back is told
PARTS = 65  # of an edge in which the fluids of a layered inlet are asked for; one is in its middle


def default_name(kind: str, wall: str) -> str:
    """Name of an opening of a kind that has none."""
    return f"{kind}_{wall}" if wall else kind


@dataclass(frozen=True, kw_only=True)
class Opening:
    """A straight part of a wall that is open.

    Attributes:
        wall: name of the wall: left, right, bottom or top of a box, or a straight side of a shape. It may be left out
            where ``between`` is given.
        between: ((x, y), (x, y)) its two ends; by default the whole wall. They are moved to the nearest particles.
        name: of its columns in the history; by default the kind and the wall, as in "inlet_left".
        open: a valve: ((start, end), ...) times in which it is open, and closed in all others; always by default.
            Fluids are at rest at an opening that is closed, as at a wall.
    """

    wall: str = ""
    between: Annotated[Sequence[Pair], Len(2, 2), Unit("m")] | None = None
    name: str = ""
    open: Annotated[Sequence[Pair], MinLen(1), Unit("s")] | None = None
    kind: ClassVar[str] = "opening"

    def __post_init__(self) -> None:
        require(self, self.path, self._here)
        if not self.wall and self.between is None:
            raise self.invalid("wall", "is left out; give the name of a wall, or the two ends, between")
        if self.between is not None:
            ends = numbers(self.between)
            if ends.shape != (2, 2) or not np.isfinite(ends).all() or (ends[0] == ends[1]).all():
                raise self.invalid("between", f"is {self.between!r}; it must be two different points (x, y) in m")
        if self.open is not None:
            times = numbers(self.open)
            if times.ndim != 2 or times.shape[1:] != (2,) or not (np.diff(times.ravel()) > 0).all():
                text = f"is {self.open!r}; it must be pairs of times (start, end) in s, each later than the one before"
                raise self.invalid("open", text)
            object.__setattr__(self, "open", tuple(map(tuple, times.tolist())))
        if not self.name:
            object.__setattr__(self, "name", default_name(self.kind, self.wall))

    @property
    def path(self) -> tuple[str, ...]:
        """Keys that lead to it in a case file."""
        return f"{self.kind}s", self.name

    def invalid(self, key: str, text: str) -> Invalid:
        """Error that one of its keys, or all of it, is wrong as the text says."""
        return Invalid((*self.path, *((key,) if key else ())), text, self._here)

    @property
    def _here(self) -> str:
        return f"{self.kind} {self.name or self.wall!r}"

    @property
    def velocities(self) -> bool:
        """Whether it prescribes velocities; the others prescribe a pressure."""
        return False

    def normal(self, fluids: int) -> bool:
        """Whether pressures are given, and fluids cross at right angles only, in a case of a number of fluids."""
        return False

    def in_steps(self) -> Opening:
        """The opening as steps treat it."""
        return self

    def is_open(self, time: float) -> bool:
        """Whether its valve is open at a time [s]."""
        return self.open is None or any(start <= time < end for start, end in self.open)

    def fluids(self, names: Sequence[str]) -> None:
        """Check the fluids that it names against those of the case."""

    def _index(self, key: str, fluid: Fluid | str, names: Sequence[str]) -> int:
        name = fluid.name if isinstance(fluid, Fluid) else fluid
        if name not in names:
            raise self.invalid(key, f"is {name!r}; the case has {', '.join(names)}{meant(name, names)}")
        return list(names).index(name)


@dataclass(frozen=True, kw_only=True)
class Inlet(Opening):
    """Opening where a fluid enters normal to its wall, with a given discharge or velocity, or from a reservoir.

    Every opening has ``wall``, the name of its wall; ``between``, its two ends [m], if not all of the wall is open;
    ``name``, for its columns in the history; and ``open``, a valve: ((start, end), ...) [s] when it is open.

    Attributes:
        fluid: name of the fluid that enters; in Python also the `Fluid`, or a function of positions (K, 2) [m] and time
            [s] to the names or numbers (K,) of fluids in the case, for an inlet of several.
        discharge: that enters [m^2/s], around an axis [m^3/s], a number or a function of time [s]; less than 0 for what
            is drawn off.
        velocity: mean speed into the tank [m/s], in place of the discharge, a number or a function of time [s].
        level: height of the surface of a reservoir of the fluid outside [m], in place of the discharge, a number or a
            function of time. Its fluid enters below the level; above it stands the lightest fluid of the case, as at an
            `Outlet` with a level; and what flows back leaves.
        profile: how the speed varies over the part r of the width: "plug", not at all; "parabola", as r (1 - r);
            "power", of a turbulent flow over a bottom at the lower end, r to the power of 1/7. From the axis of an
            axisymmetric flow to a wall, as 1 - r^2 and (1 - r) to the power of 1/7. Where a no-slip wall ends at it the
            speed is zero; in Python also a function of the distances (K,) from the lower or left end [m]
            and of time [s] to speeds (K,), which discharge or velocity scales, and which are in m/s where neither is
            given.
        ramp: time [s] in which discharge or velocity rise smoothly from zero, at the start and where a valve opens, and
            fall where it closes.
        pump: name of another opening, in place of discharge and velocity: what leaves by that enters here. From an
            inlet that draws off at the same time, so that a closed tank keeps its volume; from an outlet by the mean of
            what has left in the last steps.
        head: by which a pump raises the total head p / (rho g) + z + v^2 / (2 g) from an outlet to here [m of its
            fluid], a number or a function of the discharge [m^2/s], as a pump's curve. It sets the pressure of that
            outlet, by the mean pressure here in the last steps.
    """

    fluid: Fluid | str | OfPlace = ""
    discharge: Annotated[float | Strength | None, Unit("m^2/s")] = None
    velocity: Annotated[float | Strength | None, Unit("m/s")] = None
    level: Annotated[float | Strength | None, Unit("m")] = None
    profile: PROFILES | OfPlace = "plug"
    ramp: Annotated[float, Ge(0), Unit("s")] = 0.0
    pump: str = ""
    head: Annotated[float | Strength | None, Unit("m")] = None
    kind: ClassVar[str] = "inlet"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.fluid == "":
            raise self.invalid("fluid", f"is {self.fluid!r}; it must be a fluid of the case")
        given = [key for key in ("discharge", "velocity", "level") if getattr(self, key) is not None]
        if len(given) > 1:
            raise self.invalid("", f": {' and '.join(given)} are given; give one, and profile for its shape")
        if self.pump and given:
            raise self.invalid("", f": {given[0]} is given beside pump; the opening that it names says what enters")
        if not (given or callable(self.profile) or self.pump):
            raise self.invalid("", ": give discharge, velocity or level, or a profile in m/s")
        if self.head is not None and (not self.pump or callable(self.fluid)):
            raise self.invalid("head", "is that of a pump of one fluid; name the outlet that it draws from, pump")
        plain = {"profile": self.profile == "plug", "ramp": self.ramp == 0, "fluid": not callable(self.fluid)}
        if self.level is not None and not all(plain.values()):
            key = next(key for key, is_plain in plain.items() if not is_plain)
            raise self.invalid(key, "goes with a discharge or a velocity; from a level its pressure says what enters")

    @property
    def velocities(self) -> bool:
        """See `Opening.velocities`."""
        return self.level is None

    def normal(self, fluids: int) -> bool:
        """See `Opening.normal`."""
        return self.level is not None

    def in_steps(self) -> Opening:
        """See `Opening.in_steps`: with a level it is an outlet."""
        if self.level is None:
            return self
        assert not callable(self.fluid)
        same = {key: getattr(self, key) for key in ("wall", "between", "name", "open", "level")}
        return Reservoir(**same, fluid=self.fluid, direction="normal")

    def fluids(self, names: Sequence[str]) -> None:
        """See `Opening.fluids`."""
        if not callable(self.fluid):
            self._index("fluid", self.fluid, names)

    def entering(self, position: Array, time: float, names: Sequence[str]) -> Array:
        """Numbers (K,) of the fluids that enter at positions (K, 2) [m]."""
        if not callable(self.fluid):
            return np.full(len(position), self._index("fluid", self.fluid, names), dtype=np.int32)
        value = np.asarray(self.fluid(position.copy(), time))
        if value.dtype.kind == "U":
            found, of = np.unique(value, return_inverse=True)
            value = np.array([self._index("fluid", str(name), names) for name in found])[of]
        if (
            value.shape != (len(position),)
            or value.dtype.kind not in "iub"
            or (value < 0).any()
            or (value.max(initial=0) >= len(names))
        ):
            text = f"at t = {time:g} s gave {value!r}; it must be {len(position)} names of fluids, or numbers 0 to"
            raise self.invalid("fluid", f"{text} {len(names) - 1}")
        return value.astype(np.int32)

    def strength(self, time: float, size: float) -> float:
        """Prescribed discharge at a time, for an opening of a size [m^2/s]; NaN where the profile has it.

        Around an axis the size is an area, and the discharge in m^3/s.
        """
        given = self.discharge if self.discharge is not None else self.velocity
        if given is None:
            return 0.0 if self.pump else math.nan
        value = given(time) if callable(given) else given
        if not is_number(value):
            key, unit = ("discharge", "m^2/s") if self.discharge is not None else ("velocity", "m/s")
            raise self.invalid(key, f"at t = {time:g} s gave {value!r}; it must be a number in {unit}")
        return float(value) * (1.0 if self.discharge is not None else size) * self.begun(time)

    def raised(self, discharge: float, time: float) -> float:
        """Head of the pump at a discharge [m^2/s] and a time, with ramp and valve [m]."""
        value = self.head(discharge) if callable(self.head) else self.head
        if not is_number(value):
            raise self.invalid("head", f"at {discharge:g} m^2/s gave {value!r}; it must be a number in m")
        return float(value) * self.begun(time)  # type: ignore[arg-type]

    def begun(self, time: float) -> float:
        """Factor from 0 to 1 of ramp and valve at a time [s]."""
        if self.open is None:
            return self._risen(time)
        return sum(self._risen(time - start) - self._risen(time - end) for start, end in self.open)

    def _risen(self, time: float) -> float:
        """The ramp from 0 to 1, a time after its start [s]."""
        part = min(max(time / self.ramp, 0.0), 1.0) if self.ramp > 0 else float(time >= 0)
        return part * part * (3 - 2 * part)

    def turns(self, start: float, end: float) -> list[float]:
        """Times between two at which ramp or valve have a kink or a jump [s]."""
        edges = {0.0} if self.open is None else {time for pair in self.open for time in pair}
        return sorted(time for edge in edges for time in {edge, edge + self.ramp} if start < time < end)

    def shape(self, s: Array, width: float, time: float, *, round_axis: bool) -> Array:
        """Speeds (K,) at distances (K,) from the first end, before they are scaled; ``round_axis`` if that is on it."""
        r = s / width
        if callable(self.profile):
            value = np.asarray(self.profile(s.copy(), time), dtype=float)
            value = np.broadcast_to(value, s.shape).copy() if value.ndim == 0 else value
            if value.shape != s.shape or not np.isfinite(value).all():
                raise self.invalid("profile", f"at t = {time:g} s gave {value!r}; it must be {len(s)} finite speeds")
            return np.asarray(value)
        if self.profile == "parabola":
            return np.asarray(1 - r * r if round_axis else 6 * r * (1 - r))
        return np.ones_like(r) if self.profile == "plug" else np.asarray((1 - r if round_axis else r) ** (1 / 7))


@dataclass(frozen=True, kw_only=True)
class Outlet(Opening):
    """Opening where fluids leave, and enter if they are drawn in, at a given pressure.

    What flows in comes from a reservoir at rest: its pressure at the opening is less than that given by rho v^2 / 2.

    Every opening has ``wall``, the name of its wall; ``between``, its two ends [m], if not all of the wall is open;
    ``name``, for its columns in the history; and ``open``, a valve: ((start, end), ...) [s] when it is open.

    Attributes:
        pressure: on the opening [Pa]; "hydrostatic": the weight of what stands in the opening below its upper end, for
            flows that are slower than their waves; in Python also a function of positions (K, 2) [m] and time [s] to
            (K,).
        level: height of the surface of ``fluid`` outside [m], in place of the pressure, a number or a function of time;
            above it stands the lightest fluid of the case, whose pressure is 0 at the upper end of the opening. What
            flows in is ``fluid`` below the level, and the lightest one above.
        fluid: that the level belongs to.
        direction: "normal", fluids cross at right angles to the wall, or "free", as for jets. By default normal in a
            case of one fluid, free in others.
    """

    pressure: Annotated[float | Literal["hydrostatic"] | OfPlace | None, Unit("Pa")] = None
    level: Annotated[float | Strength | None, Unit("m")] = None
    fluid: Fluid | str | None = None
    direction: Literal["normal", "free"] | None = None
    kind: ClassVar[str] = "outlet"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.level is not None and self.pressure is not None:
            raise self.invalid("", ": level and pressure are given; give one of the two")
        if (self.level is None) != (self.fluid is None):
            said, missing = ("level", "fluid") if self.fluid is None else ("fluid", "level")
            raise self.invalid(missing, f"is left out; {said} is given, and a level needs both")

    def fluids(self, names: Sequence[str]) -> None:
        """See `Opening.fluids`."""
        if self.fluid is not None:
            self._index("fluid", self.fluid, names)

    def normal(self, fluids: int) -> bool:
        """See `Opening.normal`."""
        return self.direction == "normal" or (self.direction is None and fluids == 1)

    def level_at(self, time: float) -> float:
        """The level at a time [m]."""
        value = self.level(time) if callable(self.level) else self.level
        if not is_number(value):
            raise self.invalid("level", f"at t = {time:g} s gave {value!r}; it must be a height in m")
        return float(value)  # type: ignore[arg-type]

    def level_fluid(self, names: Sequence[str]) -> int:
        """Number of the fluid of the level."""
        assert self.fluid is not None
        return self._index("fluid", self.fluid, names)

    def pressure_at(self, position: Array, time: float) -> Array:
        """Pressures (K,) at positions (K, 2) [Pa], where it is a number or a function."""
        if not callable(self.pressure):
            return np.full(len(position), float(self.pressure or 0.0))
        value = np.asarray(self.pressure(position.copy(), time), dtype=float)
        value = np.broadcast_to(value, len(position)) if value.ndim == 0 else value
        if value.shape != (len(position),) or not np.isfinite(value).all():
            text = f"at t = {time:g} s gave {value!r}; it must be {len(position)} finite pressures in Pa"
            raise self.invalid("pressure", text)
        return np.asarray(value)


@dataclass(frozen=True, kw_only=True)
class Reservoir(Outlet):
    """An inlet with a level, in steps."""

    kind: ClassVar[str] = "inlet"


@dataclass(frozen=True, kw_only=True)
class Vent(Outlet):
    """An outlet of pressure 0 where fluids cross at right angles, so that a gas can leave a tank that is filled.

    ``wall``, ``between``, ``name`` and ``open`` are as of `Outlet`.
    """

    kind: ClassVar[str] = "vent"

    def __post_init__(self) -> None:
        super().__post_init__()
        for key in ("pressure", "level", "direction"):
            if getattr(self, key) is not None:
                raise self.invalid(key, f"is {getattr(self, key)!r}; a vent has the pressure 0, an outlet any other")

    def normal(self, fluids: int) -> bool:
        """See `Outlet.normal`."""
        return True


def check_balance(openings: Sequence[Opening], room: bool) -> None:
    """Check that pumps draw from other openings, and that what enters can leave, or has ``room``; else `Invalid`."""
    if room and (vents := [opening for opening in openings if isinstance(opening, Vent)]):
        raise vents[0].invalid("", ": there is a free surface, beyond which nothing needs to leave; leave the vent out")
    by_name = {opening.name: opening for opening in openings}
    driven = {name: o for name, o in by_name.items() if isinstance(o, Inlet) and o.pump}
    pumps = {name: o.pump for name, o in driven.items()}
    for name, drain in pumps.items():
        others = ", ".join(other for other in by_name if other not in pumps) or "none"
        if drain not in by_name or drain in pumps:
            raise by_name[name].invalid("pump", f"is {drain!r}; it must be the name of another opening: {others}")
        if list(pumps.values()).count(drain) > 1:
            raise by_name[name].invalid("pump", f"is {drain!r}, from which another inlet is pumped, too")
        source = by_name[drain]
        if isinstance(source, Inlet) and source.discharge is source.velocity is source.level is None:
            raise by_name[name].invalid("pump", f"is {drain!r}, which has neither discharge nor velocity")
        if driven[name].head is not None:
            given = [key for key in ("pressure", "level") if getattr(source, key, None) is not None]
            if given or source.velocities or isinstance(source, Vent):
                why = f"has a {given[0]}" if given else "is no outlet"
                raise by_name[name].invalid("pump", f"is {drain!r}, which {why}; a head sets the pressure of an outlet")
    unpaired = [o for o in openings if o.velocities and o.name not in pumps and o.name not in pumps.values()]
    unpaired += [by_name[name] for name, drain in pumps.items() if not by_name[drain].velocities]
    if unpaired and not room and not any(not o.velocities and o.name not in pumps.values() for o in openings):
        raise unpaired[0].invalid("", f": {_flows(unpaired[0])}; add a vent or an outlet to the tank")


def _flows(opening: Opening) -> str:
    """Flow by an inlet of a tank from which nothing can leave, in or out, in words."""
    assert isinstance(opening, Inlet)
    rate, unit = (opening.velocity, "m/s") if opening.discharge is None else (opening.discharge, "m^2/s")
    if rate is None or callable(rate):
        return "what flows in cannot leave"
    way = "flow in, and nothing can leave" if rate > 0 else "are drawn off, and nothing can enter"
    return f"{abs(rate):g} {unit} {way}"


def came_back(
    openings: Sequence[Opening], history: Sequence[Mapping[str, float]], liquids: Sequence[str] = (), least: float = 0.0
) -> dict[str, str]:
    """Lines, by names of openings, on outlets by which more than `BACK` comes back, and vents by which liquids leave.

    Not on reservoirs, from which fluids may come, nor on outlets by which more comes than leaves, or up to ``least``.
    """
    found = dict[str, str]()
    for one in openings:
        columns = {name: name.removeprefix(f"through_{one.name}_") for name in (history[-1] if history else {})}
        passed = {fluid: np.array([row[name] for row in history]) for name, fluid in columns.items() if name != fluid}
        left = {fluid: -np.minimum(values, 0.0).sum() for fluid, values in passed.items()}
        back, all_left = sum(np.maximum(values, 0.0).sum() for values in passed.values()), sum(left.values())
        if isinstance(one, Vent):
            liquid = [name for name in liquids if left.get(name, 0.0) > least]
            wrong = bool(liquid)
            text = f"{' and '.join(liquid)} left by {one.name}, a vent: put it where the gas stands, or let in less"
        else:
            wrong = isinstance(one, Outlet) and one.level is None and max(BACK * all_left, least) < back < all_left
            text = f"{100 * back / (all_left or 1.0):.0f} % of what left by {one.name} came back: put it further"
            text += ' downstream, or give it a level or direction = "normal"'
        if wrong:
            found[one.name] = text
    return found
