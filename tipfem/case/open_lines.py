"""Lines of openings: where they are on the walls of a case, and what is prescribed along them."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tipfem.arguments import meant, numbers
from tipfem.case.openings import PARTS, Inlet, Opening, Reservoir, Strength
from tipfem.case.walls import Wall
from tipfem.errors import Invalid, refuse_all
from tipfem.geometry.period import Period
from tipfem.geometry.plane.domain import Domain
from tipfem.typing import Array

# Spacings across an opening, at least: its ends are at rest, and a profile needs some particles between them.
LEAST_SPACINGS = 4
APART = 3  # spacings between two openings, at least: the cells at a particle belong to one of them
RAMP_POINTS, RAMP_WEIGHTS = np.polynomial.legendre.leggauss(4)  # of integrals over a step
ENTERS = 1e-3  # part of the mean speed below which nothing is said to enter


@dataclass(frozen=True)
class OpenLine:
    """An opening on the walls of a case."""

    opening: Opening  # as given
    side: int  # number of the straight side of the domain
    a: Array  # (2,) its ends, with the fluid on the left from a to b [m]
    b: Array  # (2,) its ends, with the fluid on the left from a to b [m]
    period: Period  # of the case. In an axisymmetric flow the line is a ring, or a disc
    # whether the fluid slides, at a and at b, along another wall that ends there in a corner; or the wall that goes on
    # there, beside empty space
    slips: tuple[bool, bool] = (False, False)
    beside: tuple[bool, bool] = (False, False)  # whether it is the latter
    wet: Array | None = None  # (K - 1,) mask of the edges between its K particles that have a fluid; None if all have

    @cached_property
    def length(self) -> float:
        """Distance of its ends [m]."""
        return float(np.linalg.norm(self.b - self.a))

    @cached_property
    def size(self) -> float:
        """Its length [m], or the area of its ring [m^2]."""
        return self.length * float(self.period.radius(0.5 * (self.a + self.b)))

    @property
    def begins_on_axis(self) -> bool:
        """Whether it is a disc, or a cone, around the axis."""
        return self.period.axial and min(self.a[0], self.b[0]) == 0

    @property
    def unit(self) -> str:
        """Unit of discharges."""
        return "m^3/s" if self.period.axial else "m^2/s"

    @cached_property
    def along(self) -> Array:
        """(2,) unit vector from a to b."""
        return np.asarray((self.b - self.a) / self.length)

    @cached_property
    def inwards(self) -> Array:
        """(2,) unit normal into the fluid."""
        return np.array([-self.along[1], self.along[0]])

    def coordinates(self, x: Array) -> Array:
        """Distances (K,) from a along the line of positions (K, 2) [m]."""
        return np.asarray((x - self.a) @ self.along)

    def edge_means(self, x: Array, values: Array) -> Array:
        """Means (K - 1,) over the edges between particles (K, 2) of values (K,), linear in between, times 2 pi r."""
        if not self.period.axial:
            return np.asarray(0.5 * (values[1:] + values[:-1]))
        r, s = self.period.radius(x), 0.5 * (values[1:] + values[:-1])
        return np.asarray(s * 0.5 * (r[1:] + r[:-1]) + np.diff(values) * np.diff(r) / 12)

    def mean(self, x: Array, values: Array) -> float:
        """Mean over the opening of values (K,) at its particles (K, 2)."""
        return float(self.edge_means(x, values) @ np.diff(self.coordinates(x)) / self.size)

    def narrowed(self, x: Array, moves: Array) -> Array:
        """Moves (K,) inwards scaled to sweep the volume of their product with the opening: pi n_r m^2 for a ring."""
        across = np.diff(self.coordinates(x)) if self.wet is None else np.diff(self.coordinates(x)) * self.wet
        wanted = float((self.edge_means(x, moves) * across).sum())
        squares = (moves[1:] ** 2 + moves[1:] * moves[:-1] + moves[:-1] ** 2) / 3
        more = 0.5 * self.period.turn * float(self.inwards[0] * (squares * across).sum())
        return moves * (2 / (1 + math.sqrt(1 + 4 * more / wanted))) if more and wanted else moves

    def speeds(self, x: Array, time: float) -> Array:
        """Speeds (K,) into the tank at the particles (K, 2) of an inlet, from a to b, at a time [s] [m/s]."""
        return self.course(x)(time)

    def course(self, x: Array, given: Strength | None = None) -> Callable[[float], Array]:
        """The `speeds` at x (K, 2) [m] by time, for a discharge ``given`` or its own; steady profiles are kept."""
        inlet = self.opening
        assert isinstance(inlet, Inlet)
        s = np.clip(self.coordinates(x), 0.0, self.length)
        across = np.diff(s) if self.wet is None else np.diff(s) * self.wet
        # Users count from the lower or the left end, or from the axis.
        turned = self.b[0] == 0 if self.begins_on_axis else (self.b - self.a) @ (1.0, 1.0 + 1e-9) < 0

        def profile(time: float) -> tuple[Array, float, bool]:
            v = inlet.shape(self.length - s if turned else s, self.length, time, round_axis=self.begins_on_axis)
            for end, slips in zip((0, -1), self.slips, strict=True):
                v[end] = v[end] if slips else 0.0
            flux = float((self.edge_means(x, v) * across).sum())
            return v, flux, abs(flux) > ENTERS * np.abs(v).max(initial=0.0) * self.size

        steady = None
        if not callable(inlet.profile):
            # It is asked for again and again: the particles of an inlet stay where they are.
            known, key = self.__dict__.setdefault("_steady", {}), s.tobytes()
            steady = known.get(key) or profile(0.0)
            self.__dict__["_steady"] = {key: steady}

        def at(time: float) -> Array:
            v, flux, enters = steady or profile(time)
            wanted = inlet.strength(time, self.size) if given is None else given(time)
            if math.isnan(wanted):
                return np.asarray(v * inlet.begun(time))
            if wanted and not enters:
                text = f"at t = {time:g} s lets nothing in, and {wanted:g} {self.unit} are to enter"
                raise inlet.invalid("profile", text)
            return np.asarray(v * (wanted / flux if flux else 0.0))

        return at

    def passed(self, course: Callable[[float], Array], start: float, end: float) -> Array:
        """Integral (K,) of a `course` over a time [m]."""
        assert isinstance(self.opening, Inlet)
        total, stops = np.zeros_like(course(start)), [start, *self.opening.turns(start, end), end]
        for one, other in itertools.pairwise(stops):
            middle, half = 0.5 * (one + other), 0.5 * (other - one)
            for point, weight in zip(RAMP_POINTS.tolist(), RAMP_WEIGHTS.tolist(), strict=True):
                total += weight * half * course(middle + half * point)
        return total

    def rates(self, course: Callable[[float], Array], time: float, step: float) -> tuple[Array, Array]:
        """Speeds (K,) and their derivatives, by differences over ``step`` [s]; 0 beside a jump of a valve."""
        assert isinstance(self.opening, Inlet)
        now, early = course(time), max(time - step, 0.0)
        if self.opening.ramp == 0 and self.opening.open and self.opening.turns(early - step, time + 2 * step):
            return now, np.zeros_like(now)
        return now, (course(time + step) - course(early)) / (time + step - early)


def line_of(
    opening: Opening, domain: Domain, position: Array, named: dict[str, Array], spacing: float, period: Period
) -> OpenLine:
    """An opening on the boundary of a domain, with its ends at wall particles ``position`` (W, 2) [m].

    ``named`` has edges (E,) of the domain by names of walls; `Invalid` if there is no such straight part, or it is too
    narrow.
    """
    slack = 0.5 * spacing
    if opening.wall and opening.wall not in named:
        text = f"is {opening.wall!r}; the tank has {', '.join(named)}{meant(opening.wall, list(named))}"
        raise opening.invalid("wall", text)
    edges = named[opening.wall] if opening.wall else np.arange(len(domain))
    if opening.between is None:
        if len(edges) > 1 and np.ptp(domain.direction[edges], axis=0).max() > 1e-9:
            raise opening.invalid("wall", f"is {opening.wall!r}, which is not straight; openings are straight")
        side = int(edges[0])
        ends = np.stack([domain.start[side], domain.end[side]])
    else:
        ends = numbers(opening.between)
        apart, _ = domain.distances(ends, edges)
        on = (apart < slack).all(axis=0)
        if not on.any():
            where = f"wall {opening.wall!r}" if opening.wall else "walls"
            raise opening.invalid("between", f"is {ends.tolist()}; it is not on one straight part of the {where}")
        side = int(edges[np.argmax(on)])
    if domain.curve[side] >= 0:
        raise opening.invalid("", ": it is on an arc; openings are straight")
    if period.axial and domain.start[side][0] == domain.end[side][0] == 0:
        raise opening.invalid("", ": it is on the axis, which is no wall; openings are in walls")
    if (ends[1] - ends[0]) @ domain.direction[side] < 0:
        ends = ends[::-1]
    here = np.flatnonzero(np.abs((position - domain.start[side]) @ domain.normal[side]) < 1e-6 * spacing)
    along = position[here] @ domain.direction[side]
    first, last = (int(here[np.argmin(np.abs(along - end @ domain.direction[side]))]) for end in ends)
    line = OpenLine(opening.in_steps(), side, position[first], position[last], period)
    count = int(((along > along[here == first]) & (along <= along[here == last])).sum())
    if count < LEAST_SPACINGS:
        text = f": {count} spacings wide; its profile needs {LEAST_SPACINGS} or more"
        raise opening.invalid("", f"{text}: a finer spacing or a wider opening")
    return line


def lines_of(
    openings: Sequence[Opening],
    domain: Domain,
    position: Array,
    named: dict[str, Array],
    spacing: float,
    period: Period,
    walls: Sequence[tuple[int, Wall]],
) -> list[OpenLine]:
    """Openings on a domain, see `line_of`, checked against each other and ``walls`` with something given, by side.

    `Invalid`, or `Several`, if they have no such straight part, are too narrow or in a wall that moves, have one name,
    overlap or are too close.
    """
    lines, wrong = list[OpenLine](), list[Invalid]()
    for opening in openings:
        try:
            line = line_of(opening, domain, position, named, spacing, period)
            for wall in (wall for side, wall in walls if side == line.side):
                for what in (what for what in ("motion", "velocity") if getattr(wall, what) is not None):
                    raise opening.invalid("wall", f"is {wall.name!r}, which has a {what}; openings stand still")
            for other in lines:
                _check_apart(line, other, spacing)
            lines.append(line)
        except Invalid as error:
            wrong.append(error)
    refuse_all(wrong)
    return lines


def _check_apart(line: OpenLine, other: OpenLine, spacing: float) -> None:
    one, two = line.opening, other.opening
    if one.name == two.name:
        raise one.invalid("name", f"is {one.name!r}, the name of another opening; give it one of its own")
    s = sorted(line.coordinates(np.stack([other.a, other.b])).tolist())
    if line.side == other.side and s[0] < line.length + APART * spacing and s[1] > -APART * spacing:
        text = f": from {np.round(line.a, 6).tolist()} to {np.round(line.b, 6).tolist()}; {two.name} is from"
        text += f" {np.round(other.a, 6).tolist()} to {np.round(other.b, 6).tolist()} m, closer than {APART}"
        raise one.invalid("", f"{text} spacings")


def check_layers(lines: Sequence[OpenLine], places: Sequence[Array], names: Sequence[str]) -> None:
    """Refuse inlets of several fluids of which one has no edge between places (K, 2) by which it enters at first."""
    for line, x in zip(lines, places, strict=True):
        inlet = line.opening
        if isinstance(inlet, Inlet) and callable(inlet.fluid):
            s = line.coordinates(x)
            part = np.diff(s)[:, None] / PARTS
            at = s[:-1, None] + part * (np.arange(PARTS) + 0.5)
            fluid = inlet.entering(line.a + at.reshape(-1, 1) * line.along, 0.0, names)
            layer = np.cumsum(np.diff(fluid, prepend=fluid[0]) != 0).reshape(at.shape)
            thin = np.setdiff1d(layer, layer[:, PARTS // 2])
            if len(thin):
                here = layer == thin[0]
                name, place = names[fluid[here.ravel()][0]], np.round(line.a + at[here].mean() * line.along, 6).tolist()
                text = f"has a layer of {name} of {(here * part).sum():.3g} m around {place}, thinner than the spacing"
                text += f" of {np.diff(s).mean():.3g} m: it cannot enter; thicken it, or refine"
                raise inlet.invalid("fluid", text)


def entering_speed(lines: Sequence[OpenLine], places: Sequence[Array], fluids: Array, gravity: Array) -> float:
    """The largest speed with which fluids enter or are drawn off, as given for the start [m/s].

    That of what comes from a reservoir, or is pumped from an outlet, is not given: it is at most that of a free fall
    from its level, or from the highest fluid down to the outlet, or that of all of the pump's head. ``places`` (K, 2)
    are of particles on each opening, ``fluids`` (N, 2) of those of all fluids [m].
    """
    strength, found, by_name = float(np.linalg.norm(gravity)), [0.0], {line.opening.name: line for line in lines}
    up = -gravity / (strength or 1.0)

    def falls(height: float, line: OpenLine) -> float:
        return math.sqrt(2 * strength * max(height - float(min(line.a @ up, line.b @ up)), 0.0))

    for line, x in zip(lines, places, strict=True):
        opening = line.opening
        if isinstance(opening, Reservoir):
            found.append(falls(opening.level_at(0.0), line))
        if isinstance(opening, Inlet):
            begins = [0.0] if opening.open is None else [start for start, _ in opening.open]
            times = [begin + opening.ramp for begin in begins]
            if not opening.pump:
                found += [float(np.abs(line.speeds(x, time)).max()) for time in times]
                continue
            drain = by_name[opening.pump]
            if isinstance(drain.opening, Inlet):
                passes = max(abs(drain.opening.strength(time, drain.size)) for time in times)
            elif opening.head is not None:
                passes = math.sqrt(2 * strength * max(opening.raised(0.0, times[0]), 0.0)) * drain.size
            else:
                passes = falls(float((fluids @ up).max()), drain) * drain.size
            found.append(passes / min(line.size, drain.size))
    return max(found)
