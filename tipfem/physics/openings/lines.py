"""Openings of a case in a step: what they prescribe at the particles on them."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from tipfem.case.boundary.passages import Passages
from tipfem.case.case import Case
from tipfem.case.open_lines import OpenLine
from tipfem.case.openings import PARTS, Inlet, Outlet, Strength
from tipfem.case.particles import Particles
from tipfem.mesh.mesh import Mesh
from tipfem.physics.openings.passed import Passed
from tipfem.typing import Array

ON_LINE = 1e-9  # distance from an opening of what is on its wall [widths]


@dataclass(frozen=True)
class Rates:
    """Motion that inlets prescribe in a step, at K particles."""

    particles: Array  # (K,)
    displacement: Array  # (K, 2) [m]
    # velocity, acceleration: (2, K, 2) at its start and at its end [m/s, m/s^2]
    velocity: Array
    acceleration: Array


@dataclass(frozen=True)
class Setting:
    """Setting of the K openings in a step."""

    lines: Sequence[OpenLine]  # the openings, their valves as they were told to be
    given: Sequence[Strength | None]  # discharges of inlets in place of their own [m^2/s]; None for those of the case
    closed: Array  # (K,) mask of the outlets and vents that are closed
    # (K,) pressures in the middle of the outlets from which pumps with a head draw [Pa], NaN for all others
    drawn: Array
    room: bool  # whether the tank has empty space, so that more may enter than leaves

    @property
    def held(self) -> Array:
        """(K,) mask of the openings whose particles have displacements that are prescribed."""
        return np.array([line.opening.velocities for line in self.lines]) | self.closed

    def discharge(self, k: int) -> Strength:
        """Discharge of an inlet over time, in the unit of its line."""
        given, line = self.given[k], self.lines[k]
        assert isinstance(line.opening, Inlet)
        return given or partial(line.opening.strength, size=line.size)

    def reservoir(self, k: int) -> bool:
        """Whether an opening lets in what stands beside it up to a level."""
        opening = self.lines[k].opening
        return isinstance(opening, Outlet) and opening.level is not None and not self.closed[k]

    def speeds(self, k: int, x: Array, time: float) -> Array:
        """Speeds (K,) into the tank at the particles (K, 2) of an inlet at a time [s] [m/s]."""
        return self.lines[k].course(x, self.given[k])(time)

    def unbalanced(self, time: float) -> str:
        """Error if all outlets are closed at a time [s], and inlets do not let out what they let in; or ""."""
        if self.room or not self.held.all():
            return ""
        flows = [self.discharge(k)(time) for k, line in enumerate(self.lines) if line.opening.velocities]
        if not abs(sum(flows)) > 1e-9 * max(map(abs, flows), default=0.0):
            return ""
        names = ", ".join(line.opening.name for line in self.lines if not line.opening.velocities)
        text = f"{sum(flows):g} {self.lines[0].unit} enter by inlets, and all that can leave is closed: {names}"
        return f"{text}; open a valve, or close the inlets"


class OpeningLines:
    """The openings of a case, with names of its fluids and their densities (F,) [kg/m^3]."""

    def __init__(self, case: Case) -> None:
        self.lines = case.boundary.lines
        self.names = [fluid.name for fluid in case.fluids]
        self.density = np.array([fluid.density for fluid in case.fluids], dtype=float)
        self._room = case.has_room
        self._gravity = np.asarray(case.gravity, dtype=float)
        self._lightest = int(np.argmin(self.density))
        self._strength = strength = float(np.linalg.norm(self._gravity))
        self._up = -self._gravity / strength if strength else np.zeros(2)

    def setting(self, part: Passed, time: float) -> Setting:
        """Setting of the openings at a time [s], by the case and by the commands given."""
        lines, closed = list(map(_beside_fluid, self.lines, part.wet.tolist())), np.zeros(len(self.lines), dtype=bool)
        given: list[Strength | None] = [None] * len(lines)
        drawn = np.full(len(lines), np.nan)
        setting = Setting(lines, given, closed, drawn, self._room)
        drains = {line.opening.name: k for k, line in enumerate(self.lines)}
        for k, line in enumerate(lines):
            valve, told, opening = int(part.valve[k]), float(part.discharge[k]), line.opening
            if not isinstance(opening, Inlet):
                closed[k] = valve == 0 or (valve < 0 and not opening.is_open(time))
                continue
            if valve == 1 and opening.open is not None:
                opening = dataclasses.replace(opening, open=None)
                lines[k] = dataclasses.replace(line, opening=opening)
            if valve == 0:
                given[k] = partial(_steady, opening, 0.0)
            elif not math.isnan(told):
                given[k] = partial(_steady, opening, told)
        for k, line in enumerate(lines):
            if isinstance(line.opening, Inlet) and line.opening.pump and given[k] is None:
                drain = drains[line.opening.pump]
                if lines[drain].opening.velocities:
                    given[k] = partial(_less, setting.discharge(drain))
                else:
                    rate, head = -float(part.rate[drain]), line.opening.head
                    given[k] = partial(_steady, line.opening, rate if head is not None else max(rate, 0.0))
                    if head is not None:
                        drawn[drain] = part.pressure[k] - self._raised(line, self.lines[drain], rate, time)
                        # In the first step no pressure is known yet.
                        closed[drain] |= math.isnan(drawn[drain])
        return setting

    def _raised(self, line: OpenLine, drain: OpenLine, discharge: float, time: float) -> float:
        """By how much the pressure rises by a pump from a drain to its inlet, for its head [Pa]."""
        inlet = line.opening
        assert isinstance(inlet, Inlet)
        assert not callable(inlet.fluid)
        density = float(self.density[inlet._index("fluid", inlet.fluid, self.names)])
        weight = float(self._gravity @ (0.5 * (line.a + line.b - drain.a - drain.b)))  # less than 0 upwards
        speeds = (discharge / line.size) ** 2 - (discharge / drain.size) ** 2
        return density * (self._strength * inlet.raised(discharge, time) + weight - 0.5 * speeds)

    def prescribed(self, nodes: list[Array], mesh: Mesh, time: float, dt: float, setting: Setting, dry: Array) -> Rates:
        """Motion that inlets, and outlets where they are closed or ``dry``, prescribe in a step from ``time`` [s]."""
        parts = [(dry, np.zeros((5, len(dry), 2)))]
        for k, (line, on) in enumerate(zip(setting.lines, nodes, strict=True)):
            if not line.opening.velocities:
                if setting.closed[k]:
                    on = on[~np.isin(on, dry)]
                    parts.append((on, np.zeros((5, len(on), 2))))
                continue
            x, step, given = mesh.position[on], 0.25 * dt, setting.given[k]
            if self._room and not (wet := edge_fluids(mesh, on) >= 0).all():
                line = dataclasses.replace(line, wet=wet)
            at = line.course(x, given)
            moves = line.narrowed(x, line.passed(at, time, time + dt))
            values = [moves, *line.rates(at, time, step), *line.rates(at, time + dt, step)]
            parts.append((on, np.stack(values)[:, :, None] * line.inwards))
        particles, vectors = np.concatenate([p for p, _ in parts]), np.concatenate([v for _, v in parts], axis=1)
        return Rates(particles, vectors[0], vectors[[1, 3]], vectors[[2, 4]])

    def imposed(self, particles: Particles, passages: Passages, time: float, step: float, part: Passed) -> Particles:
        """Particles with what openings, their ``passages`` among them, prescribe at a time."""
        setting = self.setting(part, time)
        done = particles.shallow_copy(velocity=particles.velocity.copy(), acceleration=particles.acceleration.copy())
        crossing, across = passages.crossing, passages.across
        for values in (done.velocity, done.acceleration):
            values[crossing] = np.einsum("ki,ki->k", values[crossing], across)[:, None] * across
        for line, on, given in zip(setting.lines, passages.nodes, setting.given, strict=True):
            if line.opening.velocities:
                v, rate = line.rates(line.course(particles.position[on], given), time, step)
                done.velocity[on], done.acceleration[on] = v[:, None] * line.inwards, rate[:, None] * line.inwards
        return done

    def tractions(
        self,
        nodes: list[Array],
        particles: Particles,
        mesh: Mesh,
        time: float,
        moved: Callable[[Array, Array], Array],
        setting: Setting,
    ) -> Array:
        """(N, 2) forces of the pressures that are given at openings on the particles there [N/m].

        What flows in comes from fluid at rest: on the edges where it does, the pressure is less by rho v^2 / 2.
        ``moved``: by how much particles of velocities (K, 2) and accelerations (K, 2) will have left the line at
        ``time`` (K, 2) [m]; there the pressure differs from that given by the weight of the fluid between.
        """
        result = np.zeros_like(particles.position)
        for k, (line, on) in enumerate(zip(self.lines, nodes, strict=True)):
            outlet = line.opening
            if not isinstance(outlet, Outlet) or setting.closed[k]:
                continue
            x, fluid = particles.position[on], edge_fluids(mesh, on)
            wet = fluid >= 0
            density = np.where(wet, self.density[fluid], 0.0)
            ends, middle = self._pressures(line, x, density, time, float(setting.drawn[k]))
            leaves = moved(particles.velocity[on], particles.acceleration[on])
            beyond = (leaves @ line.inwards) * float(line.inwards @ self._gravity)
            weight = 0.5 * density * (beyond[1:] + beyond[:-1])
            v = np.maximum(particles.velocity[on] @ line.inwards, 0.0)
            head = 0.5 * density * (0.5 * (v[1:] + v[:-1])) ** 2
            # Simpson's rule on each edge: exact for pressures that are quadratic in place.
            length = np.where(wet, np.diff(line.coordinates(x)) / 6, 0.0)
            first, last, both = (
                ends[:-1] + density * beyond[:-1],
                ends[1:] + density * beyond[1:],
                2 * (middle + weight),
            )
            force, one, other = np.zeros(len(on)), 3 * head, 3 * head
            if line.period.axial:  # at the radii to which they will have moved
                r = line.period.radius(x + leaves)
                first, last, both = first * r[:-1], last * r[1:], both * 0.5 * (r[:-1] + r[1:])
                one, other = head * (2 * r[:-1] + r[1:]), head * (r[:-1] + 2 * r[1:])
            force[:-1] += length * (first + both - one)
            force[1:] += length * (last + both - other)
            result[on] += force[:, None] * line.inwards
        return result

    def _pressures(self, line: OpenLine, x: Array, density: Array, time: float, drawn: float) -> tuple[Array, Array]:
        """Pressures (K,) at the particles (K, 2) of an outlet, and (K - 1,) in the middle of its edges [Pa].

        Their mean is that to which a pump draws, where that is given.
        """
        outlet, between, pumped = line.opening, 0.5 * (x[1:] + x[:-1]), not math.isnan(drawn)
        assert isinstance(outlet, Outlet)
        if outlet.pressure == "hydrostatic" or pumped:
            # From the weight of what stands there, edge by edge, 0 at the upper end.
            p = np.append(0.0, np.cumsum(density * (np.diff(x, axis=0) @ self._gravity)))
            if (x[-1] - x[0]) @ self._gravity < 0:
                p = p - p[-1]
            p = p + (drawn - line.mean(x, p) if pumped else 0.0)
            return p, 0.5 * (p[1:] + p[:-1])
        if outlet.level is None:
            return outlet.pressure_at(x, time), outlet.pressure_at(between, time)
        top, level = float((x @ self._up).max()), outlet.level_at(time)
        below = self.density[outlet.level_fluid(self.names)]
        above = 0.0 if self._room else self.density[self._lightest]

        def at(place: Array) -> Array:
            height = place @ self._up
            light = above * (top - np.maximum(height, min(level, top)))
            return np.asarray(self._strength * (light + below * np.maximum(level - height, 0.0)))

        return at(x), at(between)

    def wet_beyond(self, nodes: list[Array], mesh: Mesh) -> Array:
        """(K, 2) whether the walls in which openings end are wet beyond these ends."""
        found = np.zeros((len(nodes), 2), dtype=bool)
        if not any(any(line.beside) for line in self.lines):
            return found
        _, _, one, other = mesh.hull
        for number, (line, on) in enumerate(zip(self.lines, nodes, strict=True)):
            for at, (end, mine, next_one) in enumerate(((on[0], other, one), (on[-1], one, other))):
                there = mesh.position[next_one[mine == end]] - line.a
                found[number, at] = (np.abs(there @ line.inwards) < ON_LINE * line.length).any()
        return found

    def fluids_in(self, line: OpenLine, x: Array, time: float, speed: Array) -> Array:
        """Numbers (K,) of the fluids that enter at places (K, 2) near a line [m], -1 for what stands there already.

        By an inlet its fluid enters, and what stands there leaves. Beside a reservoir of a level its fluid enters below
        and the lightest one above, wherever something enters; its own is there before it does. ``speed`` (K,) of the
        fluids is into the tank [m/s]; of an inlet only its sign counts.
        """
        opening = line.opening
        if isinstance(opening, Inlet):
            entering = opening.entering(line.a + line.coordinates(x)[:, None] * line.along, time, self.names)
            return np.where(speed > 0, entering, -1)
        assert isinstance(opening, Outlet)
        below = x @ self._up < opening.level_at(time)
        air = -1 if self._room else self._lightest
        return np.where(below & (speed >= 0), opening.level_fluid(self.names), np.where(~below & (speed > 0), air, -1))

    def swept(self, line: OpenLine, x: Array, moves: Array, stands: Array, time: float) -> Array:
        """Volumes (F,) of the fluids that enter where the K particles of a line move inwards by ``moves`` (K,) [m^2].

        Fluids whose bounds are within edges enter by their own widths, to a part of an edge. ``stands`` (K - 1,):
        fluids of the cells at the edges, -1 for none; so leaves what is drawn off.
        """
        inlet, result = line.opening, np.zeros(len(self.names))
        parts = PARTS if isinstance(inlet, Inlet) and callable(inlet.fluid) else 1
        r = ((np.arange(parts) + 0.5) / parts)[:, None]
        step = (1 - r) * moves[:-1] + r * moves[1:]
        enters = np.broadcast_to(stands, step.shape)
        if isinstance(inlet, Inlet):
            places = (1 - r)[..., None] * x[:-1] + r[..., None] * x[1:]
            found = self.fluids_in(line, places.reshape(-1, 2), time, step.ravel()).reshape(step.shape)
            enters = np.where((found < 0) | (stands < 0), stands, found)
        if line.period.axial:  # exact for moves and radii that are linear along an edge
            radius, turn = line.period.radius(x), line.period.turn * line.inwards[0]
            dm, dr = np.diff(moves) / parts, np.diff(radius) / parts
            step = (
                step * ((1 - r) * radius[:-1] + r * radius[1:] + 0.5 * turn * step) + dm * (dr + 0.5 * turn * dm) / 12
            )
        volume = step * np.diff(line.coordinates(x)) / parts
        np.add.at(result, enters[enters >= 0], volume[enters >= 0])
        return result


def _beside_fluid(line: OpenLine, wet: Sequence[bool]) -> OpenLine:
    """A line whose ends in walls move with what enters only where nothing stands beyond them."""
    if not any(line.beside):
        return line
    first, last = (s and not (b and w) for s, b, w in zip(line.slips, line.beside, wet, strict=True))
    return dataclasses.replace(line, slips=(first, last))


def _steady(inlet: Inlet, discharge: float, time: float) -> float:
    """A discharge that an inlet was told to have, with its ramp and valve [m^2/s]."""
    return discharge * inlet.begun(time)


def _less(discharge: Strength, time: float) -> float:
    """Discharge of a pump from an opening with a discharge, less than 0 for what that draws off [m^2/s]."""
    return -discharge(time)


def edge_fluids(mesh: Mesh, on: Array) -> Array:
    """Numbers (K - 1,) of the fluids of the cells between the K particles of an opening in their order, -1 for none."""
    assert mesh.fluid is not None
    cell, _, start, end = mesh.hull
    # The cell of each face on the line, by the particle where it begins: the fluid is on the left.
    following = np.full(len(mesh.position), -1, dtype=np.int64)
    following[on[:-1]] = on[1:]
    here = following[start] == end
    at = np.full(len(mesh.position), -1, dtype=np.int64)
    at[start[here]] = cell[here]
    return np.where(at[on[:-1]] >= 0, mesh.fluid[at[on[:-1]]], -1)
