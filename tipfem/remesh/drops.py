"""Drops added to a state: where there is room for one, and the particles and cells it consists of."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tipfem.case.boundary.boundary import Boundary
from tipfem.case.particles import Particles
from tipfem.linalg.parts import connected_parts
from tipfem.mesh.delaunay import delaunay
from tipfem.mesh.mesh import Mesh, Surface
from tipfem.typing import Array

# Least distance between a drop and all that is not the fluid around it, in spacings: walls, interfaces, surfaces.
MARGIN = 1.5
# A particle is moved onto the circle only as far as each of its cells keeps this part of its area.
KEPT_AREA = 0.3
HALVINGS = 20  # of the moves of particles that go too far; then none is moved
WALL_FACE = 1.5  # longest distance of two wall particles between which there is wall, in spacings
ROUNDS = 4  # in which cells that stick out of a drop, or into it, change sides


def place(at: Array) -> str:
    """A point (d,) [m] in a message."""
    return f"({', '.join(f'{x:.4g}' for x in at)})"


def require_walls(mesh: Mesh) -> None:
    """Raise ValueError where sides are periodic: there no drop can be added yet."""
    if mesh.period:
        raise ValueError("drop: a drop cannot be added to a tank with periodic sides")


def with_fluid_in_circle(
    particles: Particles, mesh: Mesh, at: Array, radius: float, fluid: int, names: Sequence[str]
) -> tuple[Particles, Mesh]:
    """Particles and cells, with fluids, of which those in a circle are a drop's and its outline is moved onto it.

    `ValueError` unless the circle, about ``at`` (2,) [m], is within one fluid of the tank.
    """
    require_walls(mesh)
    if not is_inside(mesh, at):
        raise ValueError(f"drop: at is {place(at)} m, outside the tank")
    near, among = within(particles, at, radius), np.zeros(len(particles), dtype=bool)
    among[near] = True
    of_cells = np.asarray(mesh.fluid)
    if mesh.surface.front[near].any():
        raise ValueError(f"drop: at {place(at)} m, of radius {radius:g} m it would reach the free surface")
    require_room(particles, near, of_cells[among[mesh.cells].any(axis=1)], at, radius, fluid, names)
    inside = cells_in_circle(mesh, at, radius)
    particles = rounded(particles, mesh, inside, at, radius)
    given = np.where(inside, fluid, of_cells).astype(of_cells.dtype)
    changed = Mesh(particles.position, mesh.cells, given, surface=mesh.surface, period=mesh.period)
    return particles, changed.with_(neighbours=mesh.neighbours)


def is_inside(mesh: Mesh, at: Array) -> bool:
    """Whether a point (d,) [m] is in a cell of a mesh."""
    return bool((barycentric(mesh, np.arange(len(mesh.cells)), at[None])[0] > -1e-9).all(axis=1).any())


def barycentric(mesh: Mesh, cells: Array, points: Array) -> Array:
    """Barycentric coordinates (P, K, d + 1) of ``points`` (P, d) in ``cells`` (K,) of a mesh."""
    corner = mesh.position[mesh.cells[cells]]
    sides = (corner[:, 1:] - corner[:, :1]).transpose(0, 2, 1)
    inverse = np.linalg.inv(sides)
    inner = np.einsum("kij,pkj->pki", inverse, points[:, None] - corner[:, 0])
    return np.concatenate([1.0 - inner.sum(axis=2, keepdims=True), inner], axis=2)


def require_room(
    particles: Particles,
    near: Array,
    near_fluids: Array,
    at: Array,
    radius: float,
    fluid: int,
    names: Sequence[str],
    at_surface: bool = False,
) -> None:
    """Raise `ValueError` unless a drop is inside one other fluid, of ``near`` particles, with a margin to walls."""
    here = f"drop: at {place(at)} m, of radius {radius:g} m"
    there = f"walls, interfaces and surfaces must be {MARGIN:g} spacings from it or more"
    if particles.wall[near].any():
        distance = np.linalg.norm(particles.position[near][particles.wall[near]] - at, axis=1).min()
        raise ValueError(f"{here} it would be too close to a wall, {distance:.3g} m from its centre; {there}")
    if at_surface:
        raise ValueError(f"{here} it would reach the free surface; {there}")
    found = np.unique(near_fluids)
    if (found == fluid).any():
        alone = "it would be inside the same fluid" if len(found) == 1 else f"there is {names[fluid]} nearby already"
        raise ValueError(f"{here} {alone}; a drop must lie in another fluid; {there}")
    if len(found) > 1:
        listed = " and ".join(names[int(f)] for f in found)
        raise ValueError(f"{here} it would lie in {listed}; it must lie in one fluid; {there}")


def within(particles: Particles, at: Array, radius: float) -> Array:
    """(K,) particles within a radius [m] and the margin around a point (d,) [m]."""
    distance = np.linalg.norm(particles.position - at, axis=1)
    return np.flatnonzero(distance < radius + MARGIN * np.minimum(particles.target, particles.spacing))


def cells_in_circle(mesh: Mesh, at: Array, radius: float) -> Array:
    """(M,) mask of the triangles whose centroid is in a circle, without those that stick out, and with gaps filled.

    A triangle with two sides on the outline would have almost no area once its corners are moved onto the circle.
    """
    middle = mesh.position[mesh.cells].mean(axis=1)
    inside = ((middle - at) ** 2).sum(axis=1) < radius**2
    for fills in (True, False) * ROUNDS:
        beside = (inside[mesh.neighbours] & (mesh.neighbours >= 0)).sum(axis=1)
        inside = inside | (beside >= 2) if fills else inside & (beside >= 2)
    return np.asarray(inside)


def rounded(particles: Particles, mesh: Mesh, inside: Array, at: Array, radius: float) -> Particles:
    """The particles, those on the outline of a drop moved onto its circle, or as far as their cells allow.

    ``inside`` (M,) masks the cells of the drop. Velocities, accelerations and pressures of moved particles are
    interpolated where they were moved to.
    """
    of_drop, of_others = np.zeros((2, len(particles)), dtype=bool)
    of_drop[mesh.cells[inside]] = True
    of_others[mesh.cells[~inside]] = True
    outline = np.flatnonzero(of_drop & of_others)
    radial = particles.position[outline] - at
    wanted = at + radius * radial / np.linalg.norm(radial, axis=1, keepdims=True)
    part = np.ones(len(outline))
    position = particles.position
    for _ in range(HALVINGS):
        position = particles.position.copy()
        position[outline] += part[:, None] * (wanted - position[outline])
        bad = mesh.moved(position).measure < KEPT_AREA * mesh.measure
        if not bad.any():
            break
        touched = np.zeros(len(particles), dtype=bool)
        touched[mesh.cells[bad]] = True
        part[touched[outline]] *= 0.5
    else:
        return particles
    # Each moved particle is in one of the cells around it, or of those around these.
    near = np.zeros(len(particles), dtype=bool)
    for _ in range(2):
        near[mesh.cells[near[mesh.cells].any(axis=1)] if near.any() else outline] = True
    cells = np.flatnonzero(near[mesh.cells].any(axis=1))
    weights = barycentric(mesh, cells, position[outline])
    best = np.argmax(weights.min(axis=2), axis=1)
    weight = weights[np.arange(len(outline)), best]
    corner = mesh.cells[cells[best]]
    fields = {}
    for name in ("velocity", "acceleration", "pressure"):
        values = getattr(particles, name).copy()
        values[outline] = np.einsum("pk,pk...->p...", weight, values[corner])
        fields[name] = values
    return particles.shallow_copy(position=position, **fields)


def disc(at: Array, radius: float, spacing: float) -> tuple[Array, Array]:
    """Positions (K, 2) on rings around the centre of a disc, the outermost last, and cells (L, 3)."""
    rings = max(round(radius / spacing), 2)
    points = [np.zeros((1, 2))]
    for ring in range(1, rings + 1):
        count = 6 * ring
        angle = 2 * np.pi * (np.arange(count) + 0.5 * (ring % 2)) / count
        points.append(ring / rings * np.stack([np.cos(angle), np.sin(angle)], axis=1))
    position = at + radius * np.concatenate(points)
    cells, measure, _ = delaunay(position, spacing)
    return position, cells[measure > 1e-6]


def require_empty(
    particles: Particles, surface: Surface, at: Array, radius: float, reached: bool | None = None
) -> None:
    """Raise `ValueError` unless a drop fits into the empty space between walls.

    ``reached``: whether no wall divides it from the fluids; in 2-D this is found if it is None.
    """
    here = f"drop: at {place(at)} m, of radius {radius:g} m"
    if not surface.exists:
        raise ValueError(f"{here} its centre is outside the fluids")
    if not (_is_reached(particles, at) if reached is None else reached):
        raise ValueError(f"{here} its centre is outside the walls")
    near = within(particles, at, radius)
    if len(near):
        what = "a wall" if particles.wall[near].all() else "the fluids"
        distance = np.linalg.norm(particles.position[near] - at, axis=1).min()
        raise ValueError(
            f"{here} it would be too close to {what}, {distance:.3g} m from its centre; they must be {MARGIN:g} "
            "spacings from it or more"
        )


def _is_reached(particles: Particles, at: Array) -> bool:
    """Whether a point (2,) [m] off the fluids is connected with them by space that no wall divides."""
    x, wall, h = particles.position, particles.wall, particles.spacing
    cells, measure, neighbours = delaunay(x, h)
    solid = np.flatnonzero(measure > 1e-9)
    inside = (barycentric(Mesh(x, cells), solid, at[None])[0] > -1e-9).all(axis=1)
    if not inside.any():
        return False
    joined = []
    for i in range(3):
        one, other = cells[:, (i + 1) % 3], cells[:, (i + 2) % 3]
        face = wall[one] & wall[other] & (np.linalg.norm(x[one] - x[other], axis=1) < WALL_FACE * h)
        cell = np.flatnonzero(~face & (neighbours[:, i] >= 0))
        joined.append(np.stack([cell, neighbours[cell, i]]))
    start, end = np.concatenate(joined, axis=1)
    label = connected_parts(len(cells), start, end)[1]
    wet = label[~wall[cells].all(axis=1)]
    return bool(np.isin(label[solid[inside]], wet).all())


def with_disc(
    particles: Particles, mesh: Mesh, at: Array, radius: float, fluid: int, acceleration: Array
) -> tuple[Particles, Mesh]:
    """The particles and cells below a free surface, and those of a drop at rest beside them, which begins to fall."""
    position, cells = disc(at, radius, particles.spacing)
    count, before = len(position), len(particles)
    nothing = np.zeros(count)
    grown = particles.shallow_copy(
        position=np.concatenate([particles.position, position]),
        velocity=np.concatenate([particles.velocity, np.zeros((count, 2))]),
        acceleration=np.concatenate([particles.acceleration, np.tile(acceleration, (count, 1))]),
        pressure=np.concatenate([particles.pressure, nothing]),
        fluid=np.concatenate([particles.fluid, np.full(count, fluid, dtype=particles.fluid.dtype)]),
        wall=np.concatenate([particles.wall, nothing.astype(bool)]),
        target=np.concatenate([particles.target, np.full(count, particles.spacing)]),
    )
    surface = replace(mesh.surface.longer(len(grown)), empty=None)
    surface.front[before:] = np.linalg.norm(position - at, axis=1) > radius * (1 - 1e-9)
    joined = np.concatenate([mesh.cells, (cells + before).astype(mesh.cells.dtype)])
    return grown, Mesh(grown.position, joined, surface=surface)


def longer(mask: Array, count: int) -> Array:
    """A mask of particles with False for those added since, ``count`` in all."""
    return np.concatenate([mask, np.zeros(count - len(mask), dtype=bool)])


def boundary_of_more(boundary: Boundary, count: int) -> Boundary:
    """The same walls where particles off the walls were added behind the others, ``count`` in all."""
    new = copy.copy(boundary)
    new.still, new.stays = longer(boundary.still, count), longer(boundary.stays, count)
    return new
