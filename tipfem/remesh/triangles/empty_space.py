"""Empty space beyond a free surface, as cells of a fluid without density, for repairs in place.

A free surface is an interface with nothing on the other side. Its cells beyond are re-triangulated as those of a fluid
are, so a film of empty space breaks where two surfaces, or a surface and a wall, meet, and contacts slide along walls.
A step has no equations for them: `beyond` puts them behind the cells of the fluids, and `without` takes them away.
"""

from __future__ import annotations

import numpy as np

from tipfem.case.particles import Particles
from tipfem.errors import TriangulationError
from tipfem.geometry.period import Period
from tipfem.mesh.constrained import cells_inside
from tipfem.mesh.delaunay import SLIVER, delaunay
from tipfem.mesh.mesh import Mesh, Surface, simplex_measure
from tipfem.remesh.triangles.edge_operations import COLUMNS
from tipfem.remesh.triangles.triangulation import Triangulation
from tipfem.remesh.volumes import with_components
from tipfem.typing import Array

SHORTEST = 2.0**-7  # part of a step in which its cells follow the motion at least
TIES = 1e-12  # tolerance of its flips
LEAST = 1e-9  # area of a cell, in spacings squared, below which it has turned over


def spray_energy(particles: Particles, surface: Surface, density: Array, gravity: Array) -> float:
    """Kinetic and potential energy of the particles in no cell [J, per metre of depth]."""
    i = np.flatnonzero(surface.loose)
    v, mass = particles.velocity[i], density[particles.fluid[i]] * surface.volume[i]
    return float(mass @ (0.5 * (v**2).sum(axis=1) - particles.position[i] @ gravity))


def beyond(mesh: Mesh, cells: Array, fluids: int) -> Mesh:
    """A mesh of ``fluids`` fluids with the ``cells`` (V, 3) of empty space, of fluid number ``fluids``, behind all."""
    fluid = np.concatenate([np.asarray(mesh.fluid), np.full(len(cells), fluids, dtype=np.int32)])
    whole = Mesh(mesh.position, np.concatenate([mesh.cells, cells]), fluid, period=mesh.period)
    neighbours = mesh.neighbours_with(cells)
    return whole if neighbours is None else whole.with_(neighbours=neighbours)


def without(whole: Mesh, wall: Array, fluids: int, loose_volume: Array) -> Mesh:
    """The cells of the fluids alone, with their free surface, which keeps those of empty space.

    Args:
        whole: cells of fluids and of empty space.
        wall: (N,) mask of the wall particles.
        fluids: F.
        loose_volume: (N,) volume of fluid that particles in no cell of a fluid carry [m^2].
    """
    assert whole.fluid is not None
    keep = whole.fluid < fluids
    kept, gone = np.flatnonzero(keep), np.flatnonzero(~keep)
    number = np.full(len(keep) + 1, -1, dtype=np.int32)  # the last one is for -1, beyond the hull
    number[kept], number[gone] = np.arange(len(kept)), np.arange(len(kept), len(keep))
    neighbours, beside = (number.take(whole.neighbours.take(of, axis=0)) for of in (kept, gone))
    cell, i = np.nonzero(neighbours >= len(kept))
    neighbours[cell, i] = -1
    cells, empty = (whole.cells.take(of, axis=0) for of in (kept, gone))
    front, used = np.zeros((2, len(wall)), dtype=bool)
    front[cells[cell, (i + 1) % 3]] = front[cells[cell, (i + 2) % 3]] = True
    used[cells] = True
    loose = ~used & ~wall
    surface = Surface(
        front, ~used, loose, np.where(loose, loose_volume, 0.0), np.zeros(len(wall)), empty, beside=beside
    )
    mesh = Mesh(whole.position, cells, whole.fluid[kept], surface=surface, period=whole.period)
    return with_components(mesh.with_(measure=whole.measure[kept], neighbours=neighbours), fluids)


def followed(cells: Array, before: Array, after: Array, spacing: float, period: Period) -> Array:
    """The cells (V, 3) of empty space after a motion of their particles, with an area again by flips on the way.

    Args:
        cells: before the motion, all with an area.
        before: (N, 2) positions before it [m].
        after: (N, 2) positions after it; particles move on straight lines [m].

    Raises:
        TriangulationError: parts of the surface, or the surface and a wall, have passed through each other.
    """
    least = LEAST * spacing**2
    if not len(cells) or simplex_measure(after, cells, period.planar).min() > least:
        return cells
    shift, count = period.shortest(after - before), len(before)
    state = np.zeros((count, COLUMNS))
    state[:, :2] = before
    t = Triangulation(
        state,
        cells.copy(),
        Mesh(before, cells, period=period).neighbours.copy(),
        np.zeros(len(cells), dtype=np.int32),
        _corners(cells, count),
        np.zeros(count, dtype=np.int32),
        np.zeros(1),
        period,
    )
    t.make_delaunay(TIES)
    done, part = 0.0, 1.0
    while done < 1.0:
        place = before + min(1.0, done + part) * shift
        area = simplex_measure(place, t.cells, period.planar)
        if area.min() > least:
            done = min(1.0, done + part)
            t.state[:, :2] = place
            t.make_delaunay(TIES)
        else:
            part *= 0.5
            if part < SHORTEST:
                where = place[t.cells[np.argmin(area), 0]].tolist()
                raise TriangulationError(
                    f"at {where} two parts of the free surface, or the surface and a wall, meet in the step"
                )
    return t.cells


def _corners(cells: Array, count: int) -> Array:
    """(N,) one cell at each of ``count`` particles, -1 for those in none."""
    corner = np.full(count, -1, dtype=np.int32)
    corner[cells.ravel()] = np.arange(cells.size, dtype=np.int32) // 3
    return corner


def around(mesh: Mesh, empty: Array, first: int, spacing: float) -> Array:
    """The cells of empty space when a component of a fluid was added in it.

    Args:
        mesh: cells of the fluids, those added with particles from ``first`` on.
        empty: (V, 3) cells of empty space before that.
        first: number of the first particle that was added.

    Raises:
        TriangulationError: there is no room.
    """
    space = Mesh(mesh.position, empty)
    cell, i = np.nonzero(space.neighbours < 0)
    edges = [np.stack([empty[cell, (i + 1) % 3], empty[cell, (i + 2) % 3]], axis=1)]
    cell, i = np.nonzero((mesh.neighbours < 0) & (mesh.cells[:, :1] >= first))
    edges.append(np.stack([mesh.cells[cell, (i + 2) % 3], mesh.cells[cell, (i + 1) % 3]], axis=1))
    particles, numbers = np.unique(np.concatenate(edges), return_inverse=True)
    place = mesh.position[particles]
    cells, measure, neighbours = delaunay(place, spacing)
    kept = cells_inside(place, cells, neighbours, numbers.reshape(-1, 2), measure < SLIVER)
    return np.asarray(particles[cells[kept]].astype(np.int32))
