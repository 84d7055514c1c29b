"""Pressures on walls, and the walls that probes know: straight ones, and sides of shapes with their holes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from tipfem.arguments import numbers
from tipfem.case.case import Case
from tipfem.case.walls import Wall
from tipfem.errors import Invalid
from tipfem.geometry.box_sides import SIDES as BOX_SIDES
from tipfem.geometry.plane.domain import Domain
from tipfem.probes.forces_in_space import plane_at, pressure_on_side, require_sharp_in_space
from tipfem.probes.impulses import LoadProbe
from tipfem.probes.probe import Place, Probe, pose_of, pressure_in, require_plane
from tipfem.typing import Array

if TYPE_CHECKING:
    from tipfem.physics.state import State  # which starts Taichi
    from tipfem.step.stepper import Stepper

SIDES = ("left", "right", "bottom", "top")  # of a rectangle of walls


ON_WALL = 1e-4  # distance from a wall's line below which a face of the mesh lies on it [spacings]
CHORDS = 45.0  # edges of one side of a mesh that turn by less are chords of a curve [degrees]
ON_ARC = 0.1  # the same for an arc, whose particles may be anywhere on it


@dataclass(frozen=True, kw_only=True)
class WallPressure(LoadProbe, kind="wall pressure"):
    """Pressure at a point of a wall, linear between the wall's particles. The point moves with the wall.

    Further columns and their attributes are those of `LoadProbe`.

    Attributes:
        wall: name of a `tipfem.Wall`, of a side of the tank's shape or of its holes, or left, right, bottom or top of
            a rectangle of walls; in 3-D also front and back.
        at: (d,) place on the wall at t = 0 [m].

    Raises:
        ValueError: see `Probe`; no such wall, or the place is not on it.
    """

    wall: str
    at: Place

    def loads(self, case: Case) -> list[tuple[str, str]]:
        """Names and units of what is measured; raises ValueError if the probe does not fit the case."""
        if case.particles.dimension == 3:
            plane_at(self, case, self.wall, self._point(case, "at", self.at))
            require_sharp_in_space(self, case)
            return [("pressure", "Pa")]
        wall, place = wall_of(self, case, self.wall), self._point(case, "at", self.at)
        if not wall.holds(place, case.particles.spacing):
            text = f"is {place.tolist()} m, which is not on the wall {self.wall!r}, {wall.describe()}"
            raise self.invalid("at", text)
        return [("pressure", "Pa")]

    def sample(self, simulation: Stepper) -> list[float]:
        """The pressure at the present time; zero where there is no fluid, as at a free surface."""
        case = simulation.case
        if case.particles.dimension == 3:
            plane = plane_at(self, case, self.wall, self._point(case, "at", self.at))
            pressure = pressure_on_side(simulation, plane, self.at)
        else:
            pressure = self._in_plane(simulation)
        if pressure is None:
            return [0.0 if case.free_surface else math.nan]
        return [pressure]

    def _in_plane(self, simulation: Stepper) -> float | None:
        """The pressure in 2-D; None with no face of a fluid at the place."""
        case, particles = simulation.case, simulation.particles
        wall = wall_of(self, case, self.wall)
        a, b, cell = wall.faces(case, simulation.state)
        y = pose_of(case, simulation.time).origin(particles.position)
        at, period = wall.place(np.asarray(self.at, dtype=float), simulation.state), simulation.mesh.period
        one, other = y[a], y[b]
        if period:  # the images beside the place
            one = at + period.shortest(one - at)
            other = one + simulation.mesh.sides(a, b)
        found = wall.locate(at, one, other, particles.spacing) if len(a) else None
        if found is None:
            return None
        face, weight = found
        start, end = (pressure_in(simulation.state, simulation.mesh, node[[face]], cell[[face]])[0] for node in (a, b))
        return float((1 - weight) * start + weight * end)


@dataclass(frozen=True)
class WallLine:
    """A straight wall of a 2-D tank as it stands at t = 0."""

    start: Array  # (2,) one end [m]
    tangent: Array  # (2,) unit vector towards the other end
    length: float  # between the ends [m]
    outward: Array  # (2,) unit normal out of the fluid
    wall: Wall | None = None  # what the user said of it, or None
    # whether it ends in a corner at its start, and at its other end, beyond which nothing is on its line
    closed: tuple[bool, bool] = (True, True)

    def describe(self) -> str:
        """The two ends, for messages."""
        return f"from {self.start.round(9).tolist()} to {(self.start + self.length * self.tangent).round(9).tolist()}"

    def coordinates(self, y: Array) -> tuple[Array, Array]:
        """Along the wall and out of the fluid (K,) [m], of points (K, 2) in the tank's frame."""
        return (y - self.start) @ self.tangent, (y - self.start) @ self.outward

    def holds(self, place: Array, spacing: float) -> bool:
        """Whether a point (2,) [m] is on the wall at t = 0, for particles of a spacing [m]."""
        along, height = self.coordinates(place[None])
        slack = ON_WALL * spacing
        return bool(abs(height[0]) <= slack and -slack <= along[0] <= self.length + slack)

    def place(self, at: Array, state: State) -> Array:
        """Position in a state of a point (2,) of the wall at t = 0, in the tank's frame, as `locate` takes it [m]."""
        del state  # a place along the line is enough
        return at

    def locate(self, place: Array, a: Array, b: Array, spacing: float) -> tuple[int, float] | None:
        """The face that a ``place`` (2,) on the wall [m] is on, and the part of the way along it; None if on none.

        ``a`` and ``b`` (K, 2) are the ends of the faces in the tank's frame [m].
        """
        at = self.coordinates(place[None])[0][0]
        first, second = self.coordinates(a)[0], self.coordinates(b)[0]
        slack = ON_WALL * spacing
        k = np.flatnonzero((np.minimum(first, second) - slack <= at) & (at <= np.maximum(first, second) + slack))
        if not len(k):
            return None
        face = int(k[0])
        return face, float(np.clip((at - first[face]) / (second[face] - first[face]), 0.0, 1.0))

    def lies_on(self, other: WallLine) -> bool:
        """Whether it is all or a part of another straight wall."""
        height = np.stack([self.start, self.start + self.length * self.tangent]) - other.start
        return bool((np.abs(height @ other.outward) < 1e-6 * other.length).all())

    def faces(self, case: Case, state: State) -> tuple[Array, Array, Array]:
        """The faces of the mesh on the wall: particles (K,) and (K,), and cells (K,), in the order of the cells."""
        a, b, cell = _wall_faces(state)
        on = self._on(case, state, a) & self._on(case, state, b)
        return a[on], b[on], cell[on]

    def touches(self, case: Case, state: State, particle: Array) -> tuple[Array, Array]:
        """Find the wall particles (K,) on the wall, and its outward normals (K, 2) there, zero for the others."""
        on = self._on(case, state, particle)
        return on, on[:, None] * (pose_of(case, state.time).rotation @ self.outward)

    def _on(self, case: Case, state: State, particle: Array) -> Array:
        """Mask of the wall particles (K,) on the wall."""
        y = pose_of(case, state.time).origin(state.particles.position[particle])
        slack = ON_WALL * state.particles.spacing
        along, height = self.coordinates(y)
        walls = [wall for wall in state.boundary.walls if self.wall is not None and wall.name == self.wall.name]
        displacement = sum(float(wall.displacement(state.time)) for wall in walls)  # as steering may have changed it
        on = np.abs(height + displacement) < slack
        # A part of a side may be a wall of its own; in a corner another wall may have moved.
        on &= (along > -slack) | self.closed[0]
        on &= (along < self.length + slack) | self.closed[1]
        return np.asarray(on)


@dataclass(frozen=True)
class WallSide:
    """A side of a shape: straight edges and arcs of the domain that bounds the fluids."""

    domain: Domain  # at t = 0
    edges: Array  # (E,) numbers of its edges

    def describe(self) -> str:
        """The two ends, for messages."""
        start, end = self.domain.start[self.edges[0]], self.domain.end[self.edges[-1]]
        return f"from {start.round(9).tolist()} to {end.round(9).tolist()}"

    def _bend(self) -> Array:
        """Angle (E,) by which a curve turns along each edge [rad], 0 where straight; chords turn at their ends."""
        domain = self.domain
        turn = np.abs(domain.turn)
        smooth = (turn < math.radians(CHORDS)) & (domain.side == domain.side[domain.following])
        at_end = np.where(smooth, turn, 0.0)
        at_start = np.zeros(len(domain))
        at_start[domain.following] = at_end
        radius = np.linalg.norm(domain.start - domain.centre, axis=1)
        arc = domain.length / np.where(domain.curve >= 0, radius, 1.0)
        return np.asarray(np.where(domain.curve >= 0, arc, np.maximum(at_start, at_end))[self.edges])

    def _reach(self, spacing: float) -> Array:
        """(E,) distance from each edge below which a point is on it: of curves, what is between chord and arc [m]."""
        return np.asarray(ON_WALL * spacing + 1.2 * self.domain.length[self.edges] * self._bend() / 8)

    def place(self, at: Array, state: State) -> Array:
        """See `WallLine.place`."""
        edge = self.edges[np.argmin(self.domain.distances(at[None], self.edges)[0][0])]
        return np.asarray(at + self._moves(state)[edge] * self.domain.normal[edge])

    def _moves(self, state: State) -> Array:
        """(S,) displacement of the domain's edges along their normals in a state [m]."""
        return state.boundary.displacements(state.time, 1e-6)[0][: len(self.domain)]

    def _domain_at(self, state: State) -> Domain:
        """The domain with its walls where they are in a state, in the tank's frame."""
        moves = self._moves(state)
        return self.domain.moved(moves) if moves.any() else self.domain

    def holds(self, place: Array, spacing: float) -> bool:
        """See `WallLine.holds`."""
        return bool((self.domain.distances(place[None], self.edges)[0][0] <= self._reach(spacing)).any())

    def locate(self, place: Array, a: Array, b: Array, spacing: float) -> tuple[int, float] | None:
        """See `WallLine.locate`; of an arc, the face nearest to the place."""
        edge = b - a
        part = np.clip(((place - a) * edge).sum(axis=1) / (edge**2).sum(axis=1), 0.0, 1.0)
        distance = np.linalg.norm(a + part[:, None] * edge - place, axis=1)
        face = int(np.argmin(distance))
        arcs = (self.domain.curve[self.edges] >= 0).any()
        if distance[face] > max((ON_ARC if arcs else ON_WALL) * spacing, 0.0 if arcs else self._reach(spacing).max()):
            return None
        return face, float(part[face])

    def faces(self, case: Case, state: State) -> tuple[Array, Array, Array]:
        """See `WallLine.faces`."""
        a, b, cell = _wall_faces(state)
        y = pose_of(case, state.time).origin(state.particles.position)
        distance = self._domain_at(state).distances(0.5 * (y[a] + y[b]))[0]
        nearest = np.argmin(distance, axis=1)
        close = distance[np.arange(len(a)), nearest] < self._slack(nearest, state.particles.spacing)
        on = np.isin(nearest, self.edges) & close  # the others are off the walls
        return a[on], b[on], cell[on]

    def touches(self, case: Case, state: State, particle: Array) -> tuple[Array, Array]:
        """See `WallLine.touches`."""
        pose = pose_of(case, state.time)
        y = pose.origin(state.particles.position[particle])
        distance = self._domain_at(state).distances(y, self.edges)[0]
        edge = self.edges[np.argmin(distance, axis=1)]
        on = distance.min(axis=1) < self._slack(edge, state.particles.spacing)
        side = self.domain.end[edge] - self.domain.start[edge]
        normal = np.stack([side[:, 1], -side[:, 0]], axis=1) / self.domain.length[edge][:, None]
        return on, on[:, None] * (normal @ pose.rotation.T)

    def _slack(self, edge: Array, spacing: float) -> Array:
        return np.asarray(np.where(self.domain.curve[edge] >= 0, ON_ARC, ON_WALL) * spacing)


def _wall_faces(state: State) -> tuple[Array, Array, Array]:
    """The faces of the mesh between two wall particles (K,) and (K,), and their cells (K,), all of them closed."""
    a, b, cell, opening = _hull_faces(state)
    on = state.particles.wall[a] & state.particles.wall[b] & (opening < 0)
    return a[on], b[on], cell[on]


def _hull_faces(state: State) -> tuple[Array, Array, Array, Array]:
    """The faces (K,), (K,) of the hull of a mesh, their cells (K,), and the number (K,) of their opening, or -1."""
    cell, _, a, b = state.mesh.hull
    of = state.boundary.line_of(len(state.mesh.position))
    return a, b, cell, np.where(of[a] == of[b], of[a], -1)


def inlet_faces(state: State) -> tuple[Array, Array, Array]:
    """The faces of the mesh on inlets, as of `WallLine.faces`."""
    a, b, cell, opening = _hull_faces(state)
    velocities = np.array([line.opening.velocities for line in state.boundary.lines] + [False])
    on = velocities[opening]
    return a[on], b[on], cell[on]


def side_names(case: Case) -> list[str]:
    """The sides that together are the boundary of a 2-D case; of particles given as arrays, those of their box."""
    walls = case.boundary.tank
    if case.domain is not None and isinstance(walls, Domain) and (case.tank is None or not case.tank.is_box):
        return list(dict.fromkeys(walls.sides[side] for side in walls.side.tolist()))
    if not case.particles.wall.any():
        return []
    return ["bottom", "top"] if case.period else list(SIDES)


def wall_of(probe: Probe, case: Case, name: str) -> WallLine | WallSide:
    """The wall of that name of a 2-D case, or a side of its shape; `ValueError` if there is none."""
    require_plane(probe, case)
    domain = case.domain
    if domain is None or (case.tank is not None and case.tank.is_box):
        return wall_line(probe, case, name)
    sides = side_names(case)
    given = {wall.name: wall.side for wall in case.walls}
    side = given.get(name) or name
    if side in sides:
        return WallSide(domain, np.flatnonzero(domain.side == domain.sides.index(side)))
    if name in given or (name in SIDES and case.tank is None):
        return wall_line(probe, case, name)
    raise _no_wall(probe, case, name, sides)


def _no_wall(probe: Probe, case: Case, name: str, sides: Sequence[str]) -> Invalid:
    """The error on the name of no wall, for a case with these sides."""
    if case.domain is not None and name in case.domain.sides and name not in sides:
        return probe.invalid("wall", f": {name!r} is a body; the force of the fluids on it is in the history")
    names = [*sides, *(wall.name for wall in case.walls if wall.name not in sides)]
    return probe.invalid("wall", f": there is no wall {name!r} in this case; it has {names or 'none'}")


def wall_line(probe: Probe, case: Case, name: str) -> WallLine:
    """The straight wall of that name of a 2-D case; `ValueError` if there is none."""
    position, of_walls = case.particles.position, case.particles.wall
    if not of_walls.any():
        raise _no_wall(probe, case, name, [])
    lower, upper = position[of_walls].min(axis=0), position[of_walls].max(axis=0)
    if case.period:
        lower[0], upper[0] = 0.0, case.period.width[0]
    box, centre = np.stack([lower, upper]), position.mean(axis=0)
    for wall in case.walls:
        if wall.name == name:
            if wall.between is not None:
                start, end = numbers(wall.between)
            else:
                mine = position[np.asarray(wall.particles)]
                far = mine[np.argmax(((mine - mine.mean(axis=0)) ** 2).sum(axis=1))]
                start, end = far, mine[np.argmax(((mine - far) ** 2).sum(axis=1))]
            if case.period:  # a whole side
                start, end = np.array([lower[0], start[1]]), np.array([upper[0], start[1]])
            return _line(start, end, centre, box, wall)
    sides = side_names(case)
    if name not in sides:
        raise _no_wall(probe, case, name, sides)
    axis, upper_side = BOX_SIDES[name]
    start, end = box.copy()
    start[axis] = end[axis] = box[int(upper_side), axis]
    return _line(start, end, centre, box, None)


def _line(start: Array, end: Array, inside: Array, box: Array, wall: Wall | None) -> WallLine:
    """The wall between two points (2,) of a box (2, 2) of walls, with the fluids on the side of ``inside``."""
    length = float(np.linalg.norm(end - start))
    tangent = (end - start) / length
    outward = np.array([tangent[1], -tangent[0]])
    if (inside - start) @ outward > 0:
        outward = -outward
    in_corner = [bool((np.abs(box - point) < 1e-9 * length).any(axis=0).all()) for point in (start, end)]
    return WallLine(start, tangent, length, outward, wall, (in_corner[0], in_corner[1]))
