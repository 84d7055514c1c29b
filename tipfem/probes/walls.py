"""Pressures, forces and moments on walls: straight ones, and sides of shapes with their holes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from tipfem.arguments import numbers
from tipfem.case.case import Case
from tipfem.case.domain import Domain
from tipfem.case.particles import Particles
from tipfem.case.shaped_tank import ShapedTank
from tipfem.case.walls import Wall
from tipfem.mesh.mesh import Mesh
from tipfem.probes.impulses import LoadProbe
from tipfem.probes.probe import Probe, Sampled, pressure_in, require_plane, tank_pose
from tipfem.typing import Array

SIDES = ("left", "right", "bottom", "top")  # of a rectangle of walls


ON_WALL = 1e-4  # distance from a wall's line below which a face of the mesh lies on it [spacings]
ON_ARC = 0.1  # the same for an arc, whose particles may be anywhere on it


@dataclass(frozen=True, kw_only=True)
class WallPressure(LoadProbe):
    """Pressure at a point of a wall, linear between the wall's particles; 2-D. The point moves with the wall.

    Further columns and their attributes are those of `LoadProbe`.

    Attributes:
        wall: name of a `tipfem.Wall`, of a side of the tank's shape or of its holes, or left, right, bottom or top of
            a rectangle of walls.
        at: (2,) place on the wall at t = 0 [m].

    Raises:
        ValueError: see `Probe`; no such wall, or the place is not on it.
    """

    wall: str
    at: Sequence[float]

    def loads(self, case: Case) -> list[tuple[str, str]]:
        """Names and units of what is measured; raises ValueError if the probe does not fit the case."""
        wall, place = wall_of(self, case, self.wall), self._point(case, "at", self.at)
        if not wall.holds(place, case.particles.spacing):
            raise ValueError(f"{self}: at {place.tolist()} is not on the wall {self.wall!r}, {wall.describe()}")
        return [("pressure", "Pa")]

    def sample(self, simulation: Sampled) -> list[float]:
        """The pressure at the present time; zero where there is no fluid, as at a free surface."""
        case, particles = simulation.case, simulation.particles
        wall = wall_of(self, case, self.wall)
        a, b, cell, _ = wall.faces(simulation)
        y = tank_pose(simulation).origin(particles.position)
        at, period = np.asarray(self.at, dtype=float), simulation.mesh.period
        one, other = y[a], y[b]
        if period:  # the images beside the place
            one = at + period.shortest(one - at)
            other = one + simulation.mesh.sides(a, b)
        found = wall.locate(at, one, other, particles.spacing) if len(a) else None
        if found is None:
            return [0.0 if case.free_surface else math.nan]
        face, weight = found
        start, end = (pressure_in(simulation, node[[face]], cell[[face]])[0] for node in (a, b))
        return [float((1 - weight) * start + weight * end)]


@dataclass(frozen=True, kw_only=True)
class WallForce(LoadProbe):
    """Force and moment of the fluids on a wall, pressure and viscous stress apart; 2-D, per metre of depth.

    The force on the wall is the integral of p n - mu (grad v + grad v^T) n over its faces, n out of the fluid; its
    pressure, linear on each face, is integrated exactly. Further columns and their attributes are those of `LoadProbe`.
    On walls that slip, grad v is still that in the cells: the friction by which ``slip_length`` or the law "layer"
    stands for a thinner layer is not in it.

    Attributes:
        wall: see `WallPressure`.
        fluid: name of the fluid whose force is measured; of all together by default.
        about: (2,) point about which the moment is taken [m].

    Raises:
        ValueError: see `Probe`; no such wall or fluid.
    """

    wall: str
    fluid: str | None = None
    about: Sequence[float] = (0.0, 0.0)

    def loads(self, case: Case) -> list[tuple[str, str]]:
        """Names and units of what is measured; raises ValueError if the probe does not fit the case."""
        wall_of(self, case, self.wall)
        self._point(case, "about", self.about)
        if self.fluid is not None:
            self._fluid(case, self.fluid)
        names = ("pressure_force_x", "pressure_force_y", "viscous_force_x", "viscous_force_y")
        return [*((name, "N/m") for name in names), ("moment", "N")]

    def sample(self, simulation: Sampled) -> list[float]:
        """Force and moment at the present time."""
        case, particles, mesh = simulation.case, simulation.particles, simulation.mesh
        a, b, cell, normal = wall_of(self, case, self.wall).faces(simulation)
        p_a, p_b = (pressure_in(simulation, node, cell) for node in (a, b))
        start = particles.position[a]
        end = start + mesh.sides(a, b) if mesh.period else particles.position[b]
        share = np.ones((len(a), 2))  # of each half of a face: whether it counts
        if self.fluid is not None:
            index = case.fluid_index(self.fluid)
            if mesh.fluid is not None:
                share[:] = (mesh.fluid[cell] == index)[:, None]
            else:
                share = np.stack([particles.fluid[a] == index, particles.fluid[b] == index], axis=1).astype(float)
        middle_x, middle_p = 0.5 * (start + end), 0.5 * (p_a + p_b)
        force, moment = np.zeros(2), 0.0
        for half, (x0, p0) in enumerate(((start, p_a), (end, p_b))):
            weight = 0.5 * share[:, half]
            force += ((weight * 0.5 * (p0 + middle_p))[:, None] * normal).sum(axis=0)
            arm = (2 * p0 + middle_p)[:, None] * x0 + (p0 + 2 * middle_p)[:, None] * middle_x
            arm = weight[:, None] * (arm / 6 - (0.5 * (p0 + middle_p))[:, None] * np.asarray(self.about, dtype=float))
            moment += float((arm[:, 0] * normal[:, 1] - arm[:, 1] * normal[:, 0]).sum())
        stress = _viscous_stress(case, particles, mesh, cell)
        traction = -share.mean(axis=1)[:, None] * np.einsum("kij,kj->ki", stress, normal)
        arm = middle_x - np.asarray(self.about, dtype=float)
        moment += float((arm[:, 0] * traction[:, 1] - arm[:, 1] * traction[:, 0]).sum())
        return [*force.tolist(), *traction.sum(axis=0).tolist(), moment]


@dataclass(frozen=True)
class WallLine:
    """A straight wall of a 2-D tank as it stands at t = 0.

    Attributes:
        start: (2,) one end [m].
        tangent: (2,) unit vector towards the other end.
        length: between the ends [m].
        outward: (2,) unit normal out of the fluid.
        wall: what the user said of it, or None.
    """

    start: Array
    tangent: Array
    length: float
    outward: Array
    wall: Wall | None = field(default=None)

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

    def locate(self, place: Array, a: Array, b: Array, spacing: float) -> tuple[int, float] | None:
        """The face that a place of the wall is on.

        Args:
            place: (2,) on the wall at t = 0 [m].
            a: (K, 2) first ends of the faces in the tank's frame [m].
            b: (K, 2) their second ends [m].
            spacing: of the particles [m].

        Returns:
            The number of the face, and the part of the way from a to b, from 0 to 1; None if it is on none.
        """
        at = self.coordinates(place[None])[0][0]
        first, second = self.coordinates(a)[0], self.coordinates(b)[0]
        slack = ON_WALL * spacing
        k = np.flatnonzero((np.minimum(first, second) - slack <= at) & (at <= np.maximum(first, second) + slack))
        if not len(k):
            return None
        face = int(k[0])
        return face, float(np.clip((at - first[face]) / (second[face] - first[face]), 0.0, 1.0))

    def faces(self, simulation: Sampled) -> tuple[Array, Array, Array, Array]:
        """The faces of the mesh on the wall.

        Their two particles (K,), the cell (K,), and the outward normal times the length (K, 2) [m].
        """
        particles, (a, b, cell) = simulation.particles, _wall_faces(simulation)
        y = tank_pose(simulation).origin(particles.position)
        displacement = 0.0 if self.wall is None else float(self.wall.displacement(simulation.time))
        slack = ON_WALL * particles.spacing
        on = np.ones(len(a), dtype=bool)
        for end in (a, b):
            along, height = self.coordinates(y[end])
            on &= np.abs(height + displacement) < slack
            if self.wall is not None:  # a part of a side may be a wall of its own
                on &= (along > -slack) & (along < self.length + slack)
        return _with_normals(simulation.mesh, a[on], b[on], cell[on])


@dataclass(frozen=True)
class WallSide:
    """A side of a shape: straight edges and arcs of the domain that bounds the fluids.

    Attributes:
        domain: at t = 0.
        edges: (E,) numbers of its edges.
    """

    domain: Domain
    edges: Array

    def describe(self) -> str:
        """The two ends, for messages."""
        start, end = self.domain.start[self.edges[0]], self.domain.end[self.edges[-1]]
        return f"from {start.round(9).tolist()} to {end.round(9).tolist()}"

    def _reach(self, spacing: float) -> Array:
        """(E,) distance from each edge below which a point is on it: of arcs, what is between chord and arc [m]."""
        radius = np.linalg.norm(self.domain.start - self.domain.centre, axis=1)[self.edges]
        arc = self.domain.curve[self.edges] >= 0
        height = self.domain.length[self.edges] ** 2 / (8 * np.where(arc, radius, 1.0))
        return ON_WALL * spacing + np.where(arc, 1.2 * height, 0.0)

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
        if distance[face] > (ON_ARC if arcs else ON_WALL) * spacing:
            return None
        return face, float(part[face])

    def faces(self, simulation: Sampled) -> tuple[Array, Array, Array, Array]:
        """See `WallLine.faces`."""
        particles, (a, b, cell) = simulation.particles, _wall_faces(simulation)
        y = tank_pose(simulation).origin(particles.position)
        middle = 0.5 * (y[a] + y[b])
        distance = self.domain.distances(middle)[0]
        nearest = np.argmin(distance, axis=1)
        slack = np.where(self.domain.curve[nearest] >= 0, ON_ARC, ON_WALL) * particles.spacing
        on = np.isin(nearest, self.edges) & (distance[np.arange(len(a)), nearest] < slack)  # the others are on bodies
        return _with_normals(simulation.mesh, a[on], b[on], cell[on])


def _wall_faces(simulation: Sampled) -> tuple[Array, Array, Array]:
    """The faces of the mesh between two wall particles (K,) and (K,), and their cells (K,); on bodies, too."""
    mesh, wall = simulation.mesh, simulation.particles.wall
    cell, i = np.nonzero(mesh.neighbours < 0)
    a, b = mesh.cells[cell, (i + 1) % 3], mesh.cells[cell, (i + 2) % 3]
    on = wall[a] & wall[b]
    return a[on], b[on], cell[on]


def _with_normals(mesh: Mesh, a: Array, b: Array, cell: Array) -> tuple[Array, Array, Array, Array]:
    """Faces with the outward normal times the length (K, 2) [m]."""
    edge = mesh.sides(a, b)
    return a, b, cell, np.stack([edge[:, 1], -edge[:, 0]], axis=1)  # cells are positively oriented


def wall_of(probe: Probe, case: Case, name: str) -> WallLine | WallSide:
    """The wall of that name of a 2-D case; a side of its shape, if it has one of that name.

    Raises:
        ValueError: there is none, or the case is not 2-D.
    """
    require_plane(probe, case)
    domain = case.domain
    if domain is None or (case.tank is not None and not isinstance(case.tank, ShapedTank)):
        return wall_line(probe, case, name)
    of_walls = domain.loop.max() + 1 - len(case.bodies)  # the loops of the bodies are the last ones
    sides = list(dict.fromkeys(domain.sides[side] for side in domain.side[domain.loop < of_walls].tolist()))
    given = {wall.name: wall.side for wall in case.walls}
    side = given.get(name) or name
    if side in sides:
        return WallSide(domain, np.flatnonzero(domain.side == domain.sides.index(side)))
    if name in given or (name in SIDES and case.tank is None):
        return wall_line(probe, case, name)
    if name in [body.name for body in case.bodies]:
        raise ValueError(f"{probe}: {name!r} is a body; the force of the fluids on it is in the history")
    names = [*sides, *(wall for wall in given if wall not in sides)]
    raise ValueError(f"{probe}: there is no wall {name!r} in this case; it has {names}")


def wall_line(probe: Probe, case: Case, name: str) -> WallLine:
    """The straight wall of that name of a 2-D case.

    Raises:
        ValueError: there is none.
    """
    position, of_walls = case.particles.position, case.particles.wall
    centre = position.mean(axis=0)
    for wall in case.walls:
        if wall.name == name:
            if wall.between is not None:
                start, end = numbers(wall.between)
            else:
                mine = position[np.asarray(wall.particles)]
                far = mine[np.argmax(((mine - mine.mean(axis=0)) ** 2).sum(axis=1))]
                start, end = far, mine[np.argmax(((mine - far) ** 2).sum(axis=1))]
            if case.period:  # a whole side
                start, end = np.array([0.0, start[1]]), np.array([case.period.width[0], start[1]])
            return _line(start, end, centre, wall)
    if not of_walls.any():
        raise ValueError(f"{probe}: there is no wall {name!r} in this case; it has none")
    lower, upper = position[of_walls].min(axis=0), position[of_walls].max(axis=0)
    sides: tuple[str, ...] = SIDES
    if case.period:
        lower[0], upper[0], sides = 0.0, case.period.width[0], ("bottom", "top")
    if name in sides:
        corner = {
            "left": (lower, (lower[0], upper[1])),
            "right": ((upper[0], lower[1]), upper),
            "bottom": (lower, (upper[0], lower[1])),
            "top": ((lower[0], upper[1]), upper),
        }[name]
        return _line(np.asarray(corner[0]), np.asarray(corner[1]), centre, None)
    names = [*sides, *(wall.name for wall in case.walls if wall.name not in sides)]
    raise ValueError(f"{probe}: there is no wall {name!r} in this case; it has {names}")


def _line(start: Array, end: Array, inside: Array, wall: Wall | None) -> WallLine:
    length = float(np.linalg.norm(end - start))
    tangent = (end - start) / length
    outward = np.array([tangent[1], -tangent[0]])
    if (inside - start) @ outward > 0:
        outward = -outward
    return WallLine(start, tangent, length, outward, wall)


def _viscous_stress(case: Case, particles: Particles, mesh: Mesh, cell: Array) -> Array:
    """(K, 2, 2) mu (grad v + grad v^T) in the cells ``cell`` (K,) [Pa]."""
    viscosity = np.array([fluid.viscosity for fluid in case.fluids])
    corners = mesh.cells[cell]
    x, v = mesh.corners(cell), particles.velocity[corners]
    sides, change = x[:, 1:] - x[:, :1], v[:, 1:] - v[:, :1]
    gradient = np.linalg.solve(sides, change).transpose(0, 2, 1)  # d v_i / d x_j
    mu = viscosity[mesh.fluid[cell]] if mesh.fluid is not None else viscosity[particles.fluid[corners]].mean(axis=1)
    return np.asarray(mu[:, None, None] * (gradient + gradient.transpose(0, 2, 1)))
