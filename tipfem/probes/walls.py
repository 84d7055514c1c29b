"""Pressures, forces and moments on straight walls."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from tipfem.arguments import numbers
from tipfem.case.case import Case
from tipfem.case.particles import Particles
from tipfem.case.walls import Wall
from tipfem.mesh.mesh import Mesh
from tipfem.probes.probe import Probe, Sampled, require_plane, tank_pose
from tipfem.typing import Array

SIDES = ("left", "right", "bottom", "top")  # of a rectangle of walls


ON_WALL = 1e-4  # distance from a wall's line below which a face of the mesh lies on it [spacings]


@dataclass(frozen=True, kw_only=True)
class WallPressure(Probe):
    """Pressure at a point of a wall, linear between the wall's particles; 2-D. The point moves with the wall.

    Attributes:
        wall: name of a `tipfem.Wall`, or left, right, bottom or top of a rectangle of walls.
        at: (2,) place on the wall at t = 0 [m].

    Raises:
        ValueError: see `Probe`; no such wall, or the place is not on it.
    """

    wall: str
    at: Sequence[float]

    def columns(self, case: Case) -> list[tuple[str, str]]:
        """Names and units of the values; raises ValueError if the probe does not fit the case."""
        line, place = wall_line(self, case, self.wall), self._point(case, "at", self.at)
        along, height = line.coordinates(place[None])
        slack = ON_WALL * case.particles.spacing
        if abs(height[0]) > slack or not -slack <= along[0] <= line.length + slack:
            raise ValueError(f"{self}: at {place.tolist()} is not on the wall {self.wall!r}, {line.describe()}")
        return [("pressure", "Pa")]

    def sample(self, simulation: Sampled) -> list[float]:
        """The pressure at the present time; zero where there is no fluid, as at a free surface."""
        case, particles = simulation.case, simulation.particles
        line = wall_line(self, case, self.wall)
        place = line.coordinates(np.asarray(self.at, dtype=float)[None])[0][0]
        a, b, _, _ = line.faces(simulation)
        if not len(a):
            return [0.0 if case.free_surface else math.nan]
        y = tank_pose(simulation).origin(particles.position)
        first, second = line.coordinates(y[a])[0], line.coordinates(y[b])[0]
        low, high = np.minimum(first, second), np.maximum(first, second)
        slack = ON_WALL * particles.spacing
        k = np.flatnonzero((low - slack <= place) & (place <= high + slack))
        if not len(k):
            return [0.0 if case.free_surface else math.nan]
        face = k[0]
        weight = np.clip((place - first[face]) / (second[face] - first[face]), 0.0, 1.0)
        return [float((1 - weight) * particles.pressure[a[face]] + weight * particles.pressure[b[face]])]


@dataclass(frozen=True, kw_only=True)
class WallForce(Probe):
    """Force and moment of the fluids on a wall, pressure and viscous stress apart; 2-D, per metre of depth.

    The force on the wall is the integral of p n - mu (grad v + grad v^T) n over its faces, n out of the fluid; its
    pressure, linear on each face, is integrated exactly.

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

    def columns(self, case: Case) -> list[tuple[str, str]]:
        """Names and units of the values; raises ValueError if the probe does not fit the case."""
        wall_line(self, case, self.wall)
        self._point(case, "about", self.about)
        if self.fluid is not None:
            self._fluid(case, self.fluid)
        names = ("pressure_force_x", "pressure_force_y", "viscous_force_x", "viscous_force_y")
        return [*((name, "N/m") for name in names), ("moment", "N")]

    def sample(self, simulation: Sampled) -> list[float]:
        """Force and moment at the present time."""
        case, particles, mesh = simulation.case, simulation.particles, simulation.mesh
        a, b, cell, normal = wall_line(self, case, self.wall).faces(simulation)
        x, p = particles.position, particles.pressure
        share = np.ones((len(a), 2))  # of each half of a face: whether it counts
        if self.fluid is not None:
            index = case.fluid_index(self.fluid)
            if mesh.fluid is not None:
                share[:] = (mesh.fluid[cell] == index)[:, None]
            else:
                share = np.stack([particles.fluid[a] == index, particles.fluid[b] == index], axis=1).astype(float)
        middle_x, middle_p = 0.5 * (x[a] + x[b]), 0.5 * (p[a] + p[b])
        force, moment = np.zeros(2), 0.0
        for half, (x0, p0) in enumerate(((x[a], p[a]), (x[b], p[b]))):
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

    def faces(self, simulation: Sampled) -> tuple[Array, Array, Array, Array]:
        """The faces of the mesh on the wall.

        Their two particles (K,), the cell (K,), and the outward normal times the length (K, 2) [m].
        """
        particles, mesh = simulation.particles, simulation.mesh
        cell, i = np.nonzero(mesh.neighbours < 0)
        a, b = mesh.cells[cell, (i + 1) % 3], mesh.cells[cell, (i + 2) % 3]
        y = tank_pose(simulation).origin(particles.position)
        displacement = 0.0 if self.wall is None else float(self.wall.displacement(simulation.time))
        slack = ON_WALL * particles.spacing
        on = particles.wall[a] & particles.wall[b]
        for end in (a, b):
            along, height = self.coordinates(y[end])
            on &= np.abs(height + displacement) < slack
            if self.wall is not None:  # a part of a side may be a wall of its own
                on &= (along > -slack) & (along < self.length + slack)
        a, b, cell = a[on], b[on], cell[on]
        edge = particles.position[b] - particles.position[a]
        return a, b, cell, np.stack([edge[:, 1], -edge[:, 0]], axis=1)  # cells are positively oriented


def wall_line(probe: Probe, case: Case, name: str) -> WallLine:
    """The wall of that name of a 2-D case.

    Raises:
        ValueError: there is none, or the case is not 2-D.
    """
    require_plane(probe, case)
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
            return _line(start, end, centre, wall)
    lower, upper = position[of_walls].min(axis=0), position[of_walls].max(axis=0)
    if name in SIDES:
        corner = {
            "left": (lower, (lower[0], upper[1])),
            "right": ((upper[0], lower[1]), upper),
            "bottom": (lower, (upper[0], lower[1])),
            "top": ((lower[0], upper[1]), upper),
        }[name]
        return _line(np.asarray(corner[0]), np.asarray(corner[1]), centre, None)
    names = [*SIDES, *(wall.name for wall in case.walls if wall.name not in SIDES)]
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
    x, v = particles.position[corners], particles.velocity[corners]
    sides, change = x[:, 1:] - x[:, :1], v[:, 1:] - v[:, :1]
    gradient = np.linalg.solve(sides, change).transpose(0, 2, 1)  # d v_i / d x_j
    mu = viscosity[mesh.fluid[cell]] if mesh.fluid is not None else viscosity[particles.fluid[corners]].mean(axis=1)
    return np.asarray(mu[:, None, None] * (gradient + gradient.transpose(0, 2, 1)))
