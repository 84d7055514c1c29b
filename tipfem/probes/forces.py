"""Forces and moments on walls: what the equations of the step need to hold the fluids at them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, NamedTuple

import numpy as np
from annotated_types import Len

from tipfem.case.case import Case
from tipfem.case.declaration import Unit
from tipfem.geometry.plane.vectors import cross
from tipfem.mesh.measures import wall_faces
from tipfem.probes.forces_in_space import ANY_DIRECTION, force_on_sides, planes_of, require_sharp_in_space
from tipfem.probes.impulses import LoadProbe
from tipfem.probes.probe import pressure_in
from tipfem.probes.walls import WallLine, WallSide, inlet_faces, side_names, wall_line, wall_of
from tipfem.typing import Array

if TYPE_CHECKING:
    from tipfem.physics.state import Solved  # which starts Taichi
    from tipfem.step.stepper import Stepper


@dataclass(frozen=True, kw_only=True)
class WallForce(LoadProbe, kind="wall force"):
    """Force and moment of the fluids on a wall, per metre of depth in 2-D; of a side of a tank in 3-D.

    They are the reactions of the step's equations: the momentum equation of a particle on a wall, with its inertia and
    weight, holds with a force of the wall, and the force of the fluids is the opposite one. So the forces on all walls,
    and on what is rigid between them, are the momentum that the fluids lose, less what gravity and body force give
    them, to the tolerance of the solver. They are exact for a fluid at rest, and include all friction: by viscosity, by
    ``slip_length`` and by the law "layer"; on a no-slip wall also the momentum that the row of particles held at the
    wall does not have.

    The pressure force is the part along the wall's normal, the viscous force that along the wall. On curved walls the
    first is the integral of p n over the faces, and what the rest has along the normal of a particle. A particle in a
    corner, or where fluids meet, loads each face by the integral of the pressure; the rest, a part in proportion to
    the spacing squared, is divided among the walls by the directions of their normals, and among fluids by the lengths
    of their faces.

    Forces are those of the last step, at its intermediate time, with the default ``rho_inf`` at its end; there are none
    before the first step. Further columns and their attributes are those of `LoadProbe`.

    Attributes:
        wall: name of a wall, see `WallPressure`.
        fluid: name of the fluid whose force is measured; of all together by default.
        about: (d,) point about which the moment is taken [m]; the origin by default.

    Raises:
        ValueError: see `Probe`; no such wall or fluid.
    """

    wall: str
    fluid: str | None = None
    about: Annotated[Sequence[float], Len(2, 3), Unit("m")] | None = None

    def loads(self, case: Case) -> list[tuple[str, str]]:
        """Names and units of what is measured; raises ValueError if the probe does not fit the case."""
        if self.about is not None:
            self._point(case, "about", self.about)
        if self.fluid is not None:
            self._fluid(case, self.fluid)
        if case.particles.dimension == 3:
            planes_of(self, case, self.wall)
            require_sharp_in_space(self, case)
            forces = [f"{kind}_force_{axis}" for kind in ("pressure", "viscous") for axis in "xyz"]
            return [*((name, "N") for name in forces), *((f"moment_{axis}", "N m") for axis in "xyz")]
        wall_of(self, case, self.wall)
        names = ("pressure_force_x", "pressure_force_y", "viscous_force_x", "viscous_force_y")
        return [*((name, "N/m") for name in names), ("moment", "N")]

    def sample(self, simulation: Stepper) -> list[float]:
        """Force and moment in the last step; NaN before the first."""
        case, solved = simulation.case, simulation.solved
        if solved is None:
            return [math.nan] * (5 if case.particles.dimension == 2 else 9)
        index = None if self.fluid is None else case.fluid_index(self.fluid)
        about = np.zeros(case.particles.dimension) if self.about is None else np.asarray(self.about, dtype=float)
        if case.particles.dimension == 3:
            mesh, of_walls = solved.before.mesh, wall_faces(solved.before.mesh)
            corners, cell = of_walls
            pressures = np.stack([pressure_in(solved, mesh, corner, cell) for corner in corners.T], axis=1)
            planes = planes_of(self, case, self.wall)
            values: list[float] = force_on_sides(solved, planes, of_walls, pressures, about, index).tolist()
            return values
        walls, wall = self._walls(case), wall_of(self, case, self.wall)
        faces, mine = _faces(case, solved, walls), _faces(case, solved, [wall])
        rest, nodes = _rest(solved, faces), np.flatnonzero(solved.before.particles.wall)
        share = _of_fluid(solved, mine, index)
        force, moment = _by_pressure(mine, share, about)
        part, normal = _share(case, solved, nodes, (faces, walls), (mine, wall, share), rest, index)
        along = (part * normal).sum(axis=1)[:, None] * normal
        arm = faces.place[nodes] - about
        moment += float(cross(arm, part).sum())
        return [*(force + along.sum(axis=0)).tolist(), *(part - along).sum(axis=0).tolist(), moment]

    def _walls(self, case: Case) -> list[WallLine | WallSide]:
        """All walls of a case, each part of the boundary in one of them."""
        walls = [wall_of(self, case, name) for name in side_names(case)]
        box = [wall for wall in walls if isinstance(wall, WallLine)]
        if walls and not box:  # a shape
            return walls
        # Walls of particles given as arrays may stand inside of their box.
        lines = [wall_line(self, case, wall.name) for wall in case.walls]
        return [*box, *(line for line in lines if not any(line.lies_on(wall) for wall in box))]


class _Faces(NamedTuple):
    """F faces of walls in a step, at its intermediate positions; N particles."""

    a: Array  # (F,) particles
    b: Array  # (F,) particles
    cell: Array  # (F,) the cells beside them
    edge: Array  # (F, 2) from a to b [m]
    normal: Array  # (F, 2) out of the fluid, as long as the face [m]
    pressure: Array  # (F, 2) at both ends [Pa]
    place: Array  # (N, 2) of all particles [m]


def _faces(case: Case, solved: Solved, walls: Sequence[WallLine | WallSide]) -> _Faces:
    """The faces of the step's mesh on walls."""
    state = solved.before
    parts = [wall.faces(case, state) for wall in walls]
    return _of_faces(solved, *(np.concatenate([part[k] for part in parts]) for k in range(3)))


def _of_faces(solved: Solved, a: Array, b: Array, cell: Array) -> _Faces:
    """Faces (F,), (F,) with their cells (F,) at the intermediate positions of a step."""
    state, cf = solved.before, solved.scheme.cf
    u = solved.displacement
    edge = state.mesh.sides(a, b) + cf * (u[b] - u[a])
    normal = np.stack([edge[:, 1], -edge[:, 0]], axis=1)  # cells are positively oriented
    pressure = np.stack([pressure_in(solved, state.mesh, end, cell) for end in (a, b)], axis=1)
    return _Faces(a, b, cell, edge, normal, pressure, state.particles.position + cf * u)


def _rest(solved: Solved, faces: _Faces) -> Array:
    """(W, 2) force of the fluids on each wall particle, less the integral of the pressure over the faces there [N/m].

    That integral has the weights of the particle's shape function, as the momentum equation has. At the ends of inlets
    it is that over the inlet's face, too, which is no load on the wall.
    """
    result = -solved.reactions - _by_particle(solved, faces)
    state = solved.before
    if state.boundary.is_open:
        held = np.isin(np.flatnonzero(state.particles.wall), state.boundary.index)
        result -= held[:, None] * _by_particle(solved, _of_faces(solved, *inlet_faces(state)))
    return np.asarray(result)


def _by_particle(solved: Solved, faces: _Faces) -> Array:
    """(W, 2) integral of the pressure on faces with the shape function of each wall particle [N/m]."""
    p = faces.pressure + solved.level  # the reactions are those of the solve's own pressures
    count, nodes = len(faces.place), np.flatnonzero(solved.before.particles.wall)
    result = np.zeros((len(nodes), 2))
    for end, weight in ((faces.a, p @ (1 / 3, 1 / 6)), (faces.b, p @ (1 / 6, 1 / 3))):
        for k in range(2):
            result[:, k] += np.bincount(end, weight * faces.normal[:, k], minlength=count)[nodes]
    return result


def _of_fluid(solved: Solved, faces: _Faces, index: int | None) -> Array:
    """(F, 2) of each half of a face: 1 where it has the fluid of a number, else 0."""
    share = np.ones((len(faces.a), 2))
    if index is None:
        return share
    mesh, fluid = solved.before.mesh, solved.before.particles.fluid
    if mesh.fluid is not None:
        share[:] = (mesh.fluid[faces.cell] == index)[:, None]
        return share
    return np.stack([fluid[faces.a] == index, fluid[faces.b] == index], axis=1).astype(float)


def _by_pressure(faces: _Faces, share: Array, about: Array) -> tuple[Array, float]:
    """Force (2,) and moment of the pressure on faces, of whose halves only those with ``share`` (F, 2) count."""
    start, (p_a, p_b) = faces.place[faces.a], faces.pressure.T
    end = start + faces.edge
    middle_x, middle_p = 0.5 * (start + end), 0.5 * (p_a + p_b)
    force, moment = np.zeros(2), 0.0
    for half, (x0, p0) in enumerate(((start, p_a), (end, p_b))):
        weight = 0.5 * share[:, half]
        mean = 0.5 * (p0 + middle_p)
        force += ((weight * mean)[:, None] * faces.normal).sum(axis=0)
        arm = (2 * p0 + middle_p)[:, None] * x0 + (p0 + 2 * middle_p)[:, None] * middle_x
        arm = weight[:, None] * (arm / 6 - mean[:, None] * about)
        moment += float(cross(arm, faces.normal).sum())
    return force, moment


def _share(
    case: Case,
    solved: Solved,
    nodes: Array,
    every: tuple[_Faces, Sequence[WallLine | WallSide]],
    own: tuple[_Faces, WallLine | WallSide, Array],
    rest: Array,
    index: int | None,
) -> tuple[Array, Array]:
    """Share (W, 2) of a wall in a ``rest`` (W, 2) of the load [N/m], and its unit normals (W, 2) out of the fluid.

    A wall k with the length L of faces and the normal n bears W_k S^-1 r of a rest r, W_k = L (n n^T + eps I) and S the
    sum of all W_k. So in a corner, of two walls, where normals have any angle, each wall bears a force along its
    normal, all but a part eps, and where they have nearly the same direction, a part by its length.
    """
    count = len(solved.before.particles)
    (faces, walls), (mine, wall, share) = every, own
    total, _ = _weights(faces, np.ones((len(faces.a), 2)), count, nodes)
    part, normal = _weights(mine, share, count, nodes)
    # Particles that touch a wall with a corner of a cell have no face on it.
    lone = np.flatnonzero((total[:, 0, 0] + total[:, 1, 1] == 0) & rest.any(axis=1))
    if len(lone):
        counts = index is None or solved.before.particles.fluid[nodes[lone]] == index
        for other in (*walls, wall):
            on, n = other.touches(case, solved.before, nodes[lone])
            both = on[:, None, None] * (n[:, :, None] * n[:, None, :] + ANY_DIRECTION * np.eye(2))
            if other is wall:
                part[lone], normal[lone] = both * np.reshape(counts, (-1, 1, 1)), n
            else:
                total[lone] += both
    inverse = np.linalg.pinv(total, hermitian=True)
    bears = np.einsum("wij,wjk,wk->wi", part, inverse, rest)
    size = np.linalg.norm(normal, axis=1)[:, None]
    return bears, np.divide(normal, size, out=np.zeros_like(normal), where=size > 0)


def _weights(faces: _Faces, share: Array, count: int, nodes: Array) -> tuple[Array, Array]:
    """W (K, 2, 2) and the sum (K, 2) of the normals at the particles ``nodes`` (K,) of ``count``, see `_share`."""
    length = np.maximum(np.linalg.norm(faces.normal, axis=1), 1e-300)[:, None, None]
    both = faces.normal[:, :, None] * faces.normal[:, None, :] / length + ANY_DIRECTION * length * np.eye(2)
    values = np.concatenate([both.reshape(-1, 4), faces.normal], axis=1)
    sums = [
        sum(
            np.bincount(end, share[:, half] * column, minlength=count)[nodes]
            for half, end in enumerate((faces.a, faces.b))
        )
        for column in values.T
    ]
    table = np.stack(sums, axis=1).astype(float)  # of integers where there are no faces
    return table[:, :4].reshape(-1, 2, 2), table[:, 4:]
