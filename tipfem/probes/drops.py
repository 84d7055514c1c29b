"""Shape and motion of drops and bubbles."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import numpy as np
from annotated_types import Ge, Len

from tipfem.case.case import Case
from tipfem.case.declaration import Unit
from tipfem.mesh.measures import area_vectors
from tipfem.mesh.mesh import Mesh
from tipfem.mesh.relabelled import FILM
from tipfem.probes.probe import Probe, require_inside
from tipfem.typing import Array

if TYPE_CHECKING:
    from tipfem.step.stepper import Stepper  # which starts Taichi


NO_ARC = 0.05  # distance of an interface from the circle fitted to it, over sqrt(area), above which it is none


@dataclass(frozen=True, kw_only=True)
class DropProbe(Probe, kind="drops"):
    """Number of drops of a fluid, and the place, velocity and shape of one of them; sharp interface.

    A drop is a connected part of the fluid. Where there are several, all but their number is of the
    largest by area, of another one in the order of areas, or of the one nearest to a place; after a break-up or a
    merging that may be another one than before.

    The velocity is that of the centre of the area in the last step, NaN before the first one. (The mean of the
    particles' velocities would be another, where liquids slide.) The circularity is the circumference of the circle of
    the same area over the length of the outline, 1 for a circle. The contact angle is that of the circle fitted to
    the interface at the line through the two contacts with walls, through the fluid. That of a lens between two others
    is the angle between its two interfaces, of a circle each. It is NaN unless there are two contacts, and where an
    interface is no arc, off its circle by more than 0.05 sqrt(area) in the mean square. Where there is none
    of the fluid, the number is 0 and all else NaN.

    In an axisymmetric flow its place and velocity are those along the axis. In place of circularity and area are, there
    and in 3-D, the sphericity, the surface of the sphere of the same volume over that of the drop off walls, the
    volume, and the diameter of that sphere. There is no contact angle in 3-D.

    Attributes:
        fluid: name of the fluid.
        rank: which one by area: 1 for the largest, 2 for the next.
        at: (d,) place [m]; the drop whose centre is nearest to it, in place of one by its rank.
        off_walls: whether only drops that touch no wall are counted and measured.

    Raises:
        ValueError: see `Probe`; no such fluid; both a rank and a place are given; the case is periodic, or has no sharp
            interface.
    """

    fluid: str
    rank: Annotated[int, Ge(1)] = 1
    at: Annotated[Sequence[float], Len(2, 3), Unit("m")] | None = None
    off_walls: bool = False

    def columns(self, case: Case) -> list[tuple[str, str]]:
        """Names and units of the values; raises ValueError if the probe does not fit the case."""
        self._fluid(case, self.fluid)
        if self.at is not None:
            require_inside(self, case, "at", self._point(case, "at", self.at))
            if self.rank != 1:
                raise self.invalid("rank", f"is {self.rank}, and at is given; give one of the two")
        if case.interface != "sharp" or case.period:
            why = "between periodic sides" if case.period else f"with interface = {case.interface!r}"
            raise self.invalid("fluid", f": drops are not measured {why}")
        if case.period.axial:
            shape = [("sphericity", ""), ("contact_angle", "degrees"), ("volume", "m3"), ("diameter", "m")]
            return [("number", ""), ("z", "m"), ("velocity_z", "m/s"), *shape]
        axes = "xyz"[: case.particles.dimension]
        place = [*((axis, "m") for axis in axes), *((f"velocity_{axis}", "m/s") for axis in axes)]
        if len(axes) == 3:
            return [("number", ""), *place, ("sphericity", ""), ("volume", "m3"), ("diameter", "m")]
        return [("number", ""), *place, ("circularity", ""), ("contact_angle", "degrees"), ("area", "m^2")]

    def sample(self, simulation: Stepper) -> list[float]:
        """The values at the present time."""
        mesh, index = simulation.mesh, simulation.case.fluid_index(self.fluid)
        axial, walls = mesh.period.axial, simulation.particles.wall
        cells, number = self._chosen(mesh, index, walls)
        if not len(cells):
            return [float(number), *[math.nan] * (len(self.columns(simulation.case)) - 1)]
        area, centre = _centre(mesh, cells)
        velocity, solved = np.full(mesh.dimension, math.nan), simulation.solved
        if solved is not None and len(moved := self._chosen(solved.mesh, index, solved.before.particles.wall)[0]):
            ends = (_centre(each, moved)[1] for each in (solved.before.mesh, solved.mesh))
            velocity = np.subtract(*reversed(list(ends))) / solved.dt
        if mesh.dimension == 3:
            diameter = (6 * area / math.pi) ** (1 / 3)
            sphericity = math.pi * diameter**2 / _surface(mesh, cells, walls)
            return [float(number), *centre.tolist(), *velocity.tolist(), sphericity, area, diameter]
        one, other, beside = _outline(mesh, cells, simulation.particles.wall)
        surface = float(mesh.side_measure(one, other)[beside >= 0 if axial else slice(None)].sum())
        kinds = np.unique(beside)
        if axial:
            on = beside >= 0
            angle = _contact_angle(mesh, one[on], other[on], area ** (2 / 3)) if on.any() else math.nan
            diameter = (6 * area / math.pi) ** (1 / 3)
            return [float(number), centre[1], velocity[1], math.pi * diameter**2 / surface, angle, area, diameter]
        if kinds[0] < 0:  # at a wall
            angle = _contact_angle(mesh, one[beside >= 0], other[beside >= 0], area)
        else:
            arcs = (_contact_angle(mesh, one[beside == k], other[beside == k], area) for k in kinds)
            angle = sum(arcs) if len(kinds) == 2 else math.nan
        circularity = 2 * math.sqrt(math.pi * area) / surface
        return [float(number), *centre.tolist(), *velocity.tolist(), circularity, angle, area]

    def _chosen(self, mesh: Mesh, index: int, wall: Array) -> tuple[Array, int]:
        """The cells of the drop that is measured, and the number of drops; ``wall`` (N,) is a mask of particles."""
        assert mesh.components is not None
        label, count = mesh.components.label, len(mesh.components)
        area = np.bincount(label, np.abs(mesh.measure), count)
        counted = (mesh.components.fluid == index) & (area > 0)
        if self.off_walls:
            wall = wall & (mesh.position[:, 0] > 0) if mesh.period.axial else wall  # but for the axis
            counted[label[wall[mesh.cells].any(axis=1)]] = False
        own = np.flatnonzero(counted)
        if self.at is None:
            order = own[np.argsort(-area[own], kind="stable")]
            chosen = order[self.rank - 1 : self.rank]
        else:
            sums = [np.bincount(label, np.abs(mesh.measure) * x, count) for x in mesh.centres().T]
            away = np.stack(sums, axis=1)[own] / area[own, None] - np.asarray(self.at, dtype=float)
            chosen = own[np.argsort((away**2).sum(axis=1), kind="stable")[:1]]
        return np.flatnonzero(np.isin(label, chosen)), len(own)


@dataclass(frozen=True, kw_only=True)
class FilmProbe(Probe, kind="films"):
    """Each film that breaks, where interfaces have a tension: a break-up of its fluid, a merging of what is beside it.

    A row for each, with the time of the end of the step: the place of its middle, the number of its fluid and of the
    one that took its cells, in the order of the case, one more for empty space; the area of these cells, the length of
    interfaces that is gone, and the energy released.

    Raises:
        ValueError: see `Probe`; the case is 3-D or has no tension; an interval is given, for films break in between.
    """

    def columns(self, case: Case) -> list[tuple[str, str]]:
        """Names and units of the values; raises ValueError if the probe does not fit the case."""
        if case.particles.dimension == 3:
            raise self.invalid("name", ": films that break are told in 2-D only")
        if self.interval is not None:
            raise self.invalid("interval", f"is {self.interval:g}; films that break between samples would be left out")
        from tipfem.physics.registry import physics_of  # here, since Taichi comes with it

        if not any("broken_films" in physics.columns for physics in physics_of(case)):
            raise self.invalid("name", ": no interface of the case has a tension; films that break are told with it")
        units = {"x": "m", "y": "m", "area": "m^2", "length": "m", "energy": "J/m"}
        return [(name, units.get(name, "")) for name in FILM]

    def rows(self, simulation: Stepper) -> list[list[float]]:
        """Rows of the drops that broke in the step."""
        films = [part.films for part in simulation.state.parts.values() if part.films is not None]
        return [film for each in films for film in each.tolist()]


def _centre(mesh: Mesh, cells: Array) -> tuple[float, Array]:
    """Measure of some cells [m^2, or m^3] and its centre (d,) [m]."""
    measure = mesh.measure[cells]
    return float(measure.sum()), measure @ mesh.centres(cells) / measure.sum()


def _surface(mesh: Mesh, cells: Array, wall: Array) -> float:
    """Area of the faces of tetrahedra to what they are not, but for those with all corners on walls (N,) [m^2]."""
    inside = np.zeros(len(mesh.cells) + 1, dtype=bool)  # the last one for no neighbour
    inside[cells] = True
    row, corner = np.nonzero(~inside[mesh.neighbours[cells]])
    faces = mesh.cells[cells[row][:, None], (corner[:, None] + [1, 2, 3]) % 4]
    vectors = area_vectors(mesh.position, faces[~wall[faces].all(axis=1)])
    return float(np.linalg.norm(vectors, axis=1).sum())


def _outline(mesh: Mesh, cells: Array, wall: Array) -> tuple[Array, Array, Array]:
    """Ends (E,) and (E,) of the outline of cells, on its left, and the numbers (E,) of the fluids beside it.

    Beside it is -1 at walls, on which the mask ``wall`` (N,) of particles has both ends, and a number above those of
    all fluids at empty space.
    """
    inside = np.zeros(len(mesh.cells) + 1, dtype=bool)  # the last one for no neighbour
    inside[cells] = True
    row, corner = np.nonzero(~inside[mesh.neighbours[cells]])
    cell = cells[row]
    one, other = (mesh.cells[cell, (corner + k) % 3] for k in (1, 2))
    neighbour, fluid = mesh.neighbours[cell, corner], np.asarray(mesh.fluid)
    outside = np.where(wall[one] & wall[other], -1, fluid.max() + 1)
    return one, other, np.where(neighbour < 0, outside, fluid[neighbour])


def _contact_angle(mesh: Mesh, one: Array, other: Array, area: float) -> float:
    """Angle of the circle fitted to an interface at its ends [degrees]; NaN unless there are two.

    ``one`` and ``other`` (E,) are the ends of its sides, the fluid on the left, with the ``area`` [m^2].
    """
    first, last = np.setdiff1d(one, other), np.setdiff1d(other, one)
    if len(first) != 1 or len(last) != 1 or len(one) < 3:
        return math.nan
    x, ends = mesh.position[np.unique(np.concatenate([one, other]))], mesh.position[[first[0], last[0]]]
    if mesh.period.axial:  # with the other half of the meridian, which ends on the axis once
        if (ends[:, 0] == 0).sum() != 1:
            return math.nan
        x = np.concatenate([x, x * (-1.0, 1.0)])
        ends = np.where(ends[:, :1] == 0, ends[::-1] * (-1.0, 1.0), ends)
    # x^2 = 2 x . c + (R^2 - c^2), by least squares
    unknown = np.linalg.lstsq(np.column_stack([2 * x, np.ones(len(x))]), (x**2).sum(axis=1), rcond=None)[0]
    centre = unknown[:2]
    radius = math.sqrt(unknown[2] + centre @ centre)
    if np.mean((np.linalg.norm(x - centre, axis=1) - radius) ** 2) > NO_ARC**2 * area:
        return math.nan
    chord = ends[1] - ends[0]
    # From the first contact to the last, the fluid between the interface and the chord lies on the left of the former.
    normal = np.array([chord[1], -chord[0]]) / np.linalg.norm(chord)
    height = float(normal @ (centre - ends[0]))
    return math.degrees(math.acos(min(max(-height / radius, -1.0), 1.0)))
