"""Pressures, forces and moments on the plane sides of tanks in 3-D; see `tipfem.probes.forces` for those in 2-D."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from tipfem.case.case import Case
from tipfem.geometry.blocks import BlockedBox
from tipfem.geometry.box_sides import SIDES
from tipfem.geometry.plane.vectors import cross
from tipfem.geometry.polyhedron import Polyhedron
from tipfem.mesh.measures import area_vectors, wall_faces
from tipfem.probes.probe import Probe, pose_of, pressure_in
from tipfem.typing import Array

if TYPE_CHECKING:
    from tipfem.physics.state import Solved, State  # which starts Taichi
    from tipfem.step.stepper import Stepper

ON_PLANE = 1e-6  # distance of a side's particles from its plane [spacings]
ON_FACE = 1e-6  # least barycentric coordinate of a place on a face, with the other sign
# Part of a load at a corner that a wall bears in any direction, where it bears all along its normal.
ANY_DIRECTION = 0.01


def planes_of(probe: Probe, case: Case, name: str) -> list[int]:
    """Planes of the boundary of a side of a box, a wall of its name, or of a block; `ValueError` if there is none."""
    domain = case.boundary.domain
    if isinstance(domain, BlockedBox):
        if joined := {name, name.rpartition(" ")[0]} & domain.joined:
            text = (
                f"is {name!r}; sides of {joined.pop()!r} go on in those of another block: measure blocks that are apart"
            )
            raise probe.invalid("wall", text)
        found = [plane for plane, side in enumerate(domain.names) if name in (side, side.rpartition(" ")[0])]
        if not found:
            raise probe.invalid("wall", f": there is no wall {name!r} in this case; it has {', '.join(domain.names)}")
        return found
    assert isinstance(domain, Polyhedron)
    apart = case.particles.position[_side_particles(probe, case, name)] @ domain.normal.T - domain.offset
    return [int(np.argmin(np.abs(apart).max(axis=0)))]


def _side_particles(probe: Probe, case: Case, name: str) -> Array:
    """Mask (N,) of the first particles of a side of a box, or of a wall of its name; `ValueError` if there is none."""
    x, of_walls = case.particles.position, case.particles.wall
    for wall in case.walls:
        if wall.name == name and wall.particles is not None:
            mine = np.zeros(len(x), dtype=bool)
            mine[np.asarray(wall.particles)] = True
            return mine
    if name not in SIDES or not of_walls.any():
        names = [*SIDES, *(wall.name for wall in case.walls if wall.name not in SIDES)]
        raise probe.invalid("wall", f": there is no wall {name!r} in this case; it has {', '.join(names)}")
    axis, upper = SIDES[name]
    end = x[of_walls, axis].max() if upper else x[of_walls, axis].min()
    return np.asarray(of_walls & (np.abs(x[:, axis] - end) < ON_PLANE * case.particles.spacing))


def require_sharp_in_space(probe: Probe, case: Case) -> None:
    """Raise `ValueError` unless the interface of a 3-D case is sharp."""
    if case.interface != "sharp":
        raise probe.invalid("wall", f": in 3-D it needs interface = 'sharp', and that is {case.interface!r}")


def plane_at(probe: Probe, case: Case, name: str, place: Array) -> int:
    """The plane of a side of a tank, or of a block, that a place (3,) is on [m]; `ValueError` if it is on none."""
    slack, domain = ON_PLANE * case.particles.spacing, case.boundary.domain
    assert isinstance(domain, Polyhedron)
    planes, x = planes_of(probe, case, name), case.particles.position[case.particles.wall]
    on, ends = domain.on_edges(np.concatenate([place[None], x]), slack)[:, planes], []
    for plane, here in zip(planes, on.T, strict=True):
        lower, upper = x[here[1:]].min(axis=0), x[here[1:]].max(axis=0)
        if here[0] and (place >= lower - slack).all() and (place <= upper + slack).all():
            return plane
        ends.append(f"from {lower.tolist()} to {upper.tolist()}")
    raise probe.invalid("at", f"is {place.tolist()} m, which is not on the wall {name!r}, {', or '.join(ends)}")


def pressure_on_side(simulation: Stepper, plane: int, at: Sequence[float]) -> float | None:
    """Pressure at a place (3,) of a side at t = 0 [Pa]; None with no face of a fluid there.

    The place [m] goes with the tank, and with the side along its normal; for ``plane`` see `plane_at`.
    """
    case, state = simulation.case, simulation.state
    corners, cell = wall_faces(state.mesh)
    domain, on = state.boundary.domain, _planes_under(state, corners)
    assert isinstance(domain, Polyhedron)
    normal = domain.normal[plane]
    corners, cell = corners[on[:, plane]], cell[on[:, plane]]
    y = pose_of(case, simulation.time).origin(state.particles.position)[corners]
    tangents = np.linalg.svd(normal[None])[2][1:]
    one, other, place = ((y[:, k] - y[:, 0]) @ tangents.T if k else (at - y[:, 0]) @ tangents.T for k in (1, 2, 0))
    area = cross(one, other)
    second, third = cross(place, other) / area, cross(one, place) / area
    weight = np.stack([1 - second - third, second, third], axis=1)
    within = weight.min(axis=1, initial=np.inf)
    if not len(weight) or within.max() < -ON_FACE:
        return None
    k = int(within.argmax())
    return float(weight[k] @ pressure_in(simulation.state, simulation.mesh, corners[k], np.repeat(cell[k], 3)))


def _planes_under(state: State, corners: Array) -> Array:
    """Mask (K, S) of the planes that the faces with these corners (K, 3) are on."""
    assert state.boundary.planes is not None
    return np.asarray(state.boundary.planes[corners].all(axis=1))


def force_on_sides(
    solved: Solved,
    planes: Sequence[int],
    faces: tuple[Array, Array],
    pressures: Array,
    about: Array,
    index: int | None,
) -> Array:
    """Sums (9,) over sides of a step: force by pressure, the rest of it [N], and moment [N m] of the fluids.

    For ``planes`` see `planes_of`, for ``faces`` `wall_faces`, at whose corners are pressures (K, 3) [Pa]. The moment
    is about a point (3,) [m]; ``index`` is of the fluid whose force is measured, None for all.
    """
    state, (corners, cell) = solved.before, faces
    count, on = len(state.particles), _planes_under(state, corners)
    x = state.particles.position + solved.scheme.cf * solved.displacement
    area = area_vectors(x, corners)  # out of the fluid
    weights = np.full((3, 3), 1 / 12) + np.eye(3) / 12  # integrals of products of shape functions over the area
    loads = (pressures @ weights)[:, :, None] * area[:, None]  # (K, 3, 3) at each corner
    every = np.any(on, axis=1)
    counted = every if index is None else np.asarray(state.mesh.fluid)[cell] == index

    def at_particles(values: Array, here: Array) -> Array:
        """(N, C) sums of values (K, 3, C) at corners of some faces."""
        flat = values[here].reshape(-1, values.shape[2])
        return np.stack([np.bincount(corners[here].ravel(), column, count) for column in flat.T], axis=1)

    nodes = np.flatnonzero(state.particles.wall)
    # The reactions are those of the solve's own pressures.
    own_level = ((pressures + solved.level) @ weights)[:, :, None] * area[:, None]
    rest = -solved.reactions - at_particles(own_level, every)[nodes]
    size = np.maximum(np.linalg.norm(area, axis=1), 1e-300)
    bears = area[:, :, None] * area[:, None, :] / size[:, None, None] + ANY_DIRECTION * size[:, None, None] * np.eye(3)
    bears = np.repeat(bears.reshape(-1, 1, 9), 3, axis=1)
    borne = np.linalg.pinv(at_particles(bears, every)[nodes].reshape(-1, 3, 3), hermitian=True)
    borne = np.einsum("nij,nj->ni", borne, rest)
    sums = np.zeros((3, 3))
    for plane in planes:
        mine = on[:, plane] & counted
        share = np.einsum("nij,nj->ni", at_particles(bears, mine)[nodes].reshape(-1, 3, 3), borne)
        normal = area[mine].sum(axis=0)
        normal = normal / max(float(np.linalg.norm(normal)), 1e-300)
        along = (share @ normal)[:, None] * normal
        sums[0] += loads[mine].sum(axis=(0, 1)) + along.sum(axis=0)
        sums[1] += (share - along).sum(axis=0)
        # What shape functions give to the corners of a face has the moment of the pressure on it.
        sums[2] += np.cross(x[nodes] - about, at_particles(loads, mine)[nodes] + share).sum(axis=0)
    return sums.ravel()
