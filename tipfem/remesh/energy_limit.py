"""Energy that remeshing has added is taken back, where it changed the mesh.

A repair of the mesh changes the velocity field between the particles, and an interface that moves lifts fluid. Either
sign occurs, and without viscosity what is gained stays. A limit for the lumped energy sum m v^2 / 2 would spoil even a
velocity that is linear in space, for its lumped energy depends on the cells: a collapse raises it, a split lowers it.
So the measure is the energy of the field itself, int rho v^2 / 2, which no repair in a linear field changes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from tipfem.backend.arrays import partials
from tipfem.backend.launch import launch
from tipfem.case.particles import Particles
from tipfem.mesh.mesh import Mesh
from tipfem.remesh.energy_kernels import consistent_energy
from tipfem.typing import Array

ROUND_OFF = 1e-13  # of the energies: a gain below it is none
STRONGEST = 0.5  # largest factor of `damping`, with which no two particles exchange more than their difference
RINGS = 4  # how often the cells around are added before the rest of a gain is left to the next step


@dataclass(frozen=True)
class Change:
    """A remeshing, from N particles to N'.

    Attributes:
        before, mesh: the particles that have moved, and the triangles with their fluids that they moved with.
        renumbered: (N,) new number of each particle, -1 for those removed; None if no number changes.
        relocated: (N',) mask of the particles that were relocated or are new.
    """

    before: Particles
    mesh: Mesh
    renumbered: Array | None
    relocated: Array


def without_gain(
    change: Change, particles: Particles, mesh: Mesh, mass: Array, density: Array, gravity: Array, owed: float
) -> tuple[Particles, float]:
    """Remeshed particles with no more energy than those before.

    Relative velocities of the particles of changed cells are reduced, see `damping`, by the factor that takes back what
    was gained. What this cannot pay is taken from the cells around, and what those cannot pay is owed by the next step.

    Args:
        change: what was remeshed.
        particles: the N' particles after it.
        mesh: their triangles, with fluids.
        mass: (N',) lumped masses [kg].
        density: (F,) of the fluids [kg/m^3].
        gravity: (2,) [m/s^2].
        owed: by the steps before [J, per metre of depth].

    Returns:
        The particles, with other velocities if they gained energy; and what is still owed [J].
    """
    was, now = _energy(change.before, change.mesh, density, gravity), _energy(particles, mesh, density, gravity)
    gained = float((now - was).sum()) + owed
    if gained <= ROUND_OFF * np.abs(now).sum():
        return particles, max(gained, 0.0)
    changed, taken, velocity = changed_cells(change, particles, mesh), 0.0, particles.velocity
    assert mesh.fluid is not None
    cell_mass = density[mesh.fluid] * mesh.measure
    for _ in range(RINGS):
        rate = damping(particles, mesh, cell_mass, mass, np.flatnonzero(changed))
        factor, taken = _factor(particles.velocity, rate, mesh.cells, cell_mass, gained)
        velocity = particles.velocity + factor * rate
        if taken >= gained * (1 - 1e-9):
            break
        near = np.zeros(len(particles), dtype=bool)
        near[mesh.cells[changed]] = True
        changed = np.asarray(near.take(mesh.cells).any(axis=1))
    return particles.shallow_copy(velocity=velocity), max(gained - taken, 0.0)


def _energy(particles: Particles, mesh: Mesh, density: Array, gravity: Array) -> Array:
    """Kinetic and potential energy (2,) of the triangles of a mesh at the positions of its particles [J]."""
    result = np.zeros(2)
    launch(
        consistent_energy,
        *map(np.ascontiguousarray, (particles.position, particles.velocity, mesh.cells, mesh.fluid)),
        mesh.period.array,
        density,
        gravity,
        partials(2),
        result,
    )
    return result


def changed_cells(change: Change, particles: Particles, mesh: Mesh) -> Array:
    """(M',) mask of the cells that are new, have another fluid, or a particle whose velocity has changed."""
    assert mesh.fluid is not None
    assert change.mesh.fluid is not None
    cells, before, other = change.mesh.cells, change.before.velocity, change.relocated.copy()
    if change.renumbered is None:
        other |= (before != particles.velocity).any(axis=1)
    else:
        kept, cells = change.renumbered >= 0, change.renumbered.take(cells)
        number = change.renumbered[kept]
        other[number] |= (before[kept] != particles.velocity[number]).any(axis=1)
    both = min(len(cells), len(mesh.cells))
    same = (cells[:both] == mesh.cells[:both]).all(axis=1) & (change.mesh.fluid[:both] == mesh.fluid[:both])
    result = np.append(~same, np.ones(len(mesh.cells) - both, dtype=bool))
    # Some rows hold a cell that another row held before.
    gone, new = np.append(~same, np.ones(len(cells) - both, dtype=bool)), np.flatnonzero(result)
    old = np.column_stack([np.sort(cells[gone], axis=1), change.mesh.fluid[gone]])
    rows = np.concatenate([old, np.column_stack([np.sort(mesh.cells[new], axis=1), mesh.fluid[new]])])
    number = np.unique(rows, axis=0, return_inverse=True)[1].ravel()
    result[new] = ~np.isin(number[len(old) :], number[: len(old)])
    return np.asarray(result | other.take(mesh.cells).any(axis=1))


def damping(particles: Particles, mesh: Mesh, cell_mass: Array, mass: Array, cells: Array) -> Array:
    """Change (N, 2) of the velocities that reduces how fast the particles of some cells approach or leave each other.

    Along each edge between two particles off the walls, they exchange the momentum of a sixth of the cell's mass with
    the difference of their velocities in the edge's direction. So no momentum and no angular momentum is made, and a
    rigid motion is left as it is.

    Args:
        particles: N of them.
        mesh: their triangles.
        cell_mass: (M,) of the triangles [kg].
        mass: (N,) lumped, of the particles [kg].
        cells: (K,) numbers of the triangles.
    """
    corners, wall = mesh.cells[cells], particles.wall
    one, other = corners.T.ravel(), corners[:, (1, 2, 0)].T.ravel()
    share = np.tile(cell_mass[cells] / 6, 3)
    free = ~(wall[one] | wall[other])
    one, other, share = one[free], other[free], share[free]
    edge = mesh.sides(one, other)
    along = ((particles.velocity[other] - particles.velocity[one]) * edge).sum(axis=1) / (edge**2).sum(axis=1)
    momentum = (share * along)[:, None] * edge
    count, result = len(wall), np.zeros((len(wall), 2))
    for k in range(2):
        result[:, k] = np.bincount(one, momentum[:, k], count) - np.bincount(other, momentum[:, k], count)
    return np.asarray(result / np.maximum(mass, 1e-300)[:, None])


def _factor(velocity: Array, rate: Array, cells: Array, cell_mass: Array, gained: float) -> tuple[float, float]:
    """The factor of a ``rate`` (N, 2) with which velocities lose ``gained``, or its limit; and what they lose [J]."""
    near = np.flatnonzero(rate.any(axis=1).take(cells).any(axis=1))
    v, u, m = velocity[cells[near]], rate[cells[near]], cell_mass[near]

    def product(one: Array, two: Array) -> float:
        """int rho one . two of linear fields."""
        total = (one * two).sum(axis=(1, 2)) + (one.sum(axis=1) * two.sum(axis=1)).sum(axis=1)
        return float((m * total).sum() / 12)

    slope, curvature = product(v, u), product(u, u)
    if slope >= 0:
        return 0.0, 0.0
    # The energy changes by slope f + curvature f^2 / 2; beyond the minimum it would rise again.
    root = slope * slope - 2 * curvature * gained
    factor = min(STRONGEST, (-slope - math.sqrt(max(root, 0.0))) / curvature)
    return factor, -(slope + 0.5 * curvature * factor) * factor
