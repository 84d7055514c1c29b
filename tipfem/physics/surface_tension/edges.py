"""TensionEdges: the edges of a mesh that have surface tension, with their energy and its forces; 2-D.

    E = sum_e sigma_e |x_b - x_a|    over the edges e = (a, b) between two fluids, or between a fluid and empty space

With the unit vector t from a to b the forces on the fluids are sigma t on a and -sigma t on b. They are dE / dx with
the other sign, so no momentum and no angular momentum is made, and their work is what E loses.

In an axisymmetric flow the edges are cones, and E has in addition what arcs through their ends would have, less the
work of the pressure sigma (1 / R_1 + 1 / R_2) on the volumes between arcs and cones: - sigma 2 pi r L^3 / (24 R_1^2) an
edge, to second order. By particles i with the unit vectors t and t' along their two edges of the lengths L and L' it is

    - sum_i sigma 2 pi r_i l_i (1 - t . t') / 12,    l = 2 L L' / (L + L')

where r_i is that of the particle, and half that of a contact at the other end in addition, which has no such part.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from tipfem.case.boundary.boundary import Boundary
from tipfem.case.particles import Particles
from tipfem.case.surface_tension import wall_energies
from tipfem.geometry.period import Period
from tipfem.mesh.mesh import Mesh
from tipfem.mesh.relabelled import FILM
from tipfem.physics.surface_tension.tension import Tension
from tipfem.typing import Array

# An interface with tension that turns by more than this along a spacing is to have edges on which it turns by this
# [radians], but none shorter than a part of the spacing.
TURN, SHORTEST = 0.5, 0.8


@dataclass(frozen=True)
class TensionEdges(Tension):
    """The E edges that have tension, on N particles; see `Tension`."""

    # one, other: (E,) the particles at their ends
    one: Array
    other: Array
    sigma: Array  # (E,) surface tension [N/m]
    table: Array
    period: Period  # of the positions
    films: Array = field(default_factory=lambda: np.zeros((0, len(FILM))))
    entered: float = 0.0
    strain: Array | None = None

    @property
    def tense(self) -> Array:  # type: ignore[override]
        """See `Carried.tense`: the ends of the edges."""
        return np.concatenate([self.one, self.other])

    def energy(self, position: Array) -> float:
        """E at positions (N, 2) [J, per metre of depth where the flow is planar]."""
        side = self.period.shortest(position[self.other] - position[self.one])
        radii = self.period.radius(position)
        cones = self.sigma @ (0.5 * (radii[self.one] + radii[self.other]) * np.hypot(side[:, 0], side[:, 1]))
        return float(cones + (self._arc_energy(position) if self.period.axial else 0.0))

    def gradient(self, position: Array) -> Array:
        """dE / dx (N, 2) of straight edges at positions (N, 2) [N, per metre of depth where the flow is planar]."""
        side = self.period.shortest(position[self.other] - position[self.one])
        length, radii = np.hypot(side[:, 0], side[:, 1]), self.period.radius(position)
        pull = (self.sigma * 0.5 * (radii[self.one] + radii[self.other]) / length)[:, None] * side
        count = len(position)
        result = np.stack([np.bincount(self.other, p, count) - np.bincount(self.one, p, count) for p in pull.T], axis=1)
        if self.period.axial:
            hoop = 0.5 * self.period.turn * self.sigma * length
            result[:, 0] += np.bincount(self.one, hoop, count) + np.bincount(self.other, hoop, count)
        return result

    @cached_property
    def _bends(self) -> tuple[Array, Array, Array]:
        """Particles with two edges (M,) between two others as (3, M), tension over 12 (M,), shares of radii (3, M)."""
        ends, other = np.concatenate([self.one, self.other]), np.concatenate([self.other, self.one])
        order, degree = np.argsort(ends, kind="stable"), np.bincount(ends)
        middle = np.flatnonzero(degree == 2)
        first = np.searchsorted(ends[order], middle)
        pair = np.stack([order[first], order[first + 1]])
        chain = np.stack([other[pair[0]], middle, other[pair[1]]])
        return chain, np.tile(self.sigma, 2)[pair].min(axis=0) / 12, np.where(degree[chain] == 2, [[0], [1], [0]], 0.5)

    def _bent(self, position: Array) -> tuple[Array, Array, Array, Array]:
        """Sides (2, M, 2), lengths (2, M), cosines (M,) and shared radii times 2 pi (M,) of the bends."""
        chain, _, shares = self._bends
        x = position[chain]
        side = x[1:] - x[:-1]
        length = np.maximum(np.hypot(side[..., 0], side[..., 1]), 1e-300)
        cosine = (side[0] * side[1]).sum(axis=1) / (length[0] * length[1])
        return side, length, cosine, (shares * self.period.radius(x)).sum(axis=0)

    def _arc_energy(self, position: Array) -> float:
        """Energy that arcs add to cones [J], see the module."""
        _, length, cosine, radii = self._bent(position)
        mean = 2 * length[0] * length[1] / length.sum(axis=0)
        return -float(self._bends[1] @ (mean * radii * (1 - cosine)))

    def arc_gradient(self, position: Array) -> Array:
        """dE / dx (N, 2) of what arcs add to cones around an axis at positions (N, 2) [N]."""
        (chain, sigma, shares), count = self._bends, len(position)
        side, length, cosine, radii = self._bent(position)
        unit, total = side / length[..., None], length.sum(axis=0)
        mean, rest = 2 * length[0] * length[1] / total, sigma * (1 - cosine)
        turned = (sigma * mean * radii / length)[..., None] * (unit[::-1] - cosine[:, None] * unit)
        pull = turned - (2 * rest * radii * (length[::-1] / total) ** 2)[..., None] * unit  # dE by the sides
        by_place = np.stack([-pull[0], pull[0] - pull[1], pull[1]])
        by_place[..., 0] -= self.period.turn * rest * mean * shares
        return np.stack([np.bincount(chain.ravel(), by_place[..., k].ravel(), count) for k in range(2)], axis=1)

    def pressed_along(self, position: Array) -> Array:
        """Forces (N, 2) along a meridian of the pressures whose forces at right angles to it are dE / dx [N].

        Those pressures are linear along edges; where they are all the same they have no such part.
        """
        (chain, sigma, _), count = self._bends, len(position)
        x, r = position[chain], self.period.radius(position)[chain]
        side = x[1:] - x[:-1]
        across = np.stack([side[..., 1], -side[..., 0]], axis=-1)
        normal = ((2 * r[1] + r[[0, 2]])[..., None] * across / 6).sum(axis=0)
        size = np.maximum((normal * normal).sum(axis=1), 1e-300)
        force = (self.gradient(position) + self.arc_gradient(position))[chain[1]]
        length = np.hypot(side[..., 0], side[..., 1])
        largest = 96 * sigma / length.sum(axis=0)  # where the meridian folds
        own = np.clip((force * normal).sum(axis=1) / size, -largest, largest)
        pressures = np.full(count, np.nan)
        for _ in range(3):  # pressures whose force is that across the meridian, not only beside it
            pressures[chain[1]] = own
            ends = pressures[chain[::2]]
            ends = np.where(np.isnan(ends), own, ends)  # at a pole by symmetry
            weights = (own * (3 * r[1] + r[::2]) + ends * (r[1] + r[::2])) / 12
            pressed = (weights[..., None] * across).sum(axis=0)
            own = np.clip(own + ((force - pressed) * normal).sum(axis=1) / size, -largest, largest)
        inside = ~(np.isnan(pressures[chain[::2]]) & (r[::2] > 0)).any(axis=0)  # beside contacts it is not known
        result = np.zeros((count, 2))
        along = pressed - ((pressed * normal).sum(axis=1) / size)[:, None] * normal
        result[chain[1]] = np.where(inside[:, None], along, 0.0)
        return result

    def curvature(self, position: Array) -> Array:
        """Curvature (N,) of the interface at particles with two edges at positions (N, 2), 0 at others [1/m]."""
        side, count = self.period.shortest(position[self.other] - position[self.one]), len(position)
        length, ends = np.hypot(side[:, 0], side[:, 1]), np.concatenate([self.one, self.other])
        # The sum of the two unit vectors away from a particle is twice the sine of half the angle between them.
        away = np.concatenate([side, -side]) / np.tile(length, 2)[:, None]
        total = np.hypot(*(np.bincount(ends, each, count) for each in away.T))
        turn = 2 * np.arcsin(np.minimum(0.5 * total, 1.0))
        around = np.bincount(ends, np.tile(length, 2), count)
        return np.where(np.bincount(ends, minlength=count) == 2, 2 * turn / np.maximum(around, 1e-300), 0.0)

    def targets(self, position: Array, spacing: float) -> Array | None:
        """See `Carried.targets`: shorter ones where the interface is curved, so that its edges are split there."""
        curvature = self.curvature(position)
        curved = curvature * spacing > TURN
        if not curved.any():
            return None
        result = np.full(len(position), np.inf)
        result[curved] = np.maximum(TURN / curvature[curved], SHORTEST * spacing)
        return result

    def wetting_forces(
        self, mesh: Mesh, particles: Particles, cosines: Sequence[Any], on: Callable[[Array, Array], Array]
    ) -> Array | None:
        """See `Carried.wetting_forces`: those of Young."""
        energies = np.stack([*(wall_energies(each, self.table) for each in cosines), np.zeros(len(self.table))])
        return -_wetting_gradient(self, mesh, particles, lambda one, other: energies[on(one, other)])


def find_edges(mesh: Mesh, particles: Particles, table: Array) -> TensionEdges:
    """The edges that have tension: those between fluids, or with cells of several fluids those of the free surface."""
    found = [] if mesh.fluid is None else [_of_interfaces(mesh, table)]
    if table[-1].any():
        found.append(_of_surface(mesh, particles, table))
    one, other, sigma = (np.concatenate(parts) for parts in zip(*found, strict=True))
    return TensionEdges(one, other, sigma, table, mesh.period)


def _of_interfaces(mesh: Mesh, table: Array) -> tuple[Array, Array, Array]:
    """Ends (E,) and (E,), and tension (E,) [N/m], of the edges between fluids."""
    fluid = np.asarray(mesh.fluid)
    # The last one stands for no neighbour, and is never the higher one: each edge once.
    across = np.append(fluid, -1).take(mesh.neighbours)
    cell, corner = np.divmod(np.flatnonzero(fluid[:, None] < across), 3)
    sigma = table[fluid[cell], across[cell, corner]]
    there = np.flatnonzero(sigma)
    one, other = (mesh.cells[cell[there], (corner[there] + k) % 3] for k in (1, 2))
    return one, other, sigma[there]


def _of_surface(mesh: Mesh, particles: Particles, table: Array) -> tuple[Array, Array, Array]:
    """The same of the edges of one cell that are not on walls.

    An edge has the tension of its cell's fluid, or else the lesser of those of its particles; one between two
    particles of walls lies on the wall.
    """
    cell, _, one, other = mesh.hull
    sigma = table[-1].take(particles.fluid)
    sigma = np.minimum(sigma[one], sigma[other]) if mesh.fluid is None else table[-1].take(mesh.fluid[cell])
    there = np.flatnonzero((sigma > 0) & ~(particles.wall[one] & particles.wall[other]))
    return one[there], other[there], sigma[there]


def young_forces(
    edges: TensionEdges, mesh: Mesh, particles: Particles, boundary: Boundary, energies: Sequence[Array]
) -> Array:
    """Forces (N, 2) of the wetting of walls at contacts, 0 elsewhere; with the other sign [N, per metre of depth].

    They are the derivatives of sum_f gamma_f |x_b - x_a| over the faces f = (a, b) of walls, by the places of contacts:
    on a straight wall (gamma_1 - gamma_2) t, t along the wall out of fluid 1, that is -sigma cos(theta) t. Contacts are
    ends of the edges on walls; ``energies`` are gamma (F + 1,) of each fluid on each wall, see `wall_energies` [N/m].
    """
    if not any(energy.any() for energy in energies):
        return np.zeros((len(particles), 2))
    count = len(particles)
    return _wetting_gradient(edges, mesh, particles, lambda *ends: wetting(ends, count, boundary, energies))


def _wetting_gradient(
    edges: TensionEdges, mesh: Mesh, particles: Particles, gamma_of: Callable[[Array, Array], Array]
) -> Array:
    """`young_forces` by a function of the ends of sides of the hull to the energies of each fluid there [N/m]."""
    count, result = len(particles), np.zeros((len(particles), 2))
    contact = np.zeros(count, dtype=bool)
    contact[edges.one], contact[edges.other] = True, True
    contact &= particles.wall
    cell, _, one, other = mesh.hull
    there = np.flatnonzero(contact[one] | contact[other])
    cell, one, other = cell[there], one[there], other[there]
    fluid = particles.fluid[one] if mesh.fluid is None else np.asarray(mesh.fluid)[cell]
    gamma = gamma_of(one, other)
    gamma = (gamma - gamma[:, -1:])[np.arange(len(cell)), fluid]  # over that of a dry wall, 0 without empty space
    side, radii = mesh.sides(one, other), mesh.period.radius(mesh.position)
    length = np.hypot(side[:, 0], side[:, 1])
    pull = (gamma * 0.5 * (radii[one] + radii[other]) / length)[:, None] * side
    for k in range(2):
        result[:, k] = np.bincount(other, pull[:, k], count) - np.bincount(one, pull[:, k], count)
    if mesh.period.axial:
        hoop = 0.5 * mesh.period.turn * gamma * length
        result[:, 0] += np.bincount(one, hoop, count) + np.bincount(other, hoop, count)
    result[~contact] = 0.0
    return result


def wetting(ends: Sequence[Array], count: int, boundary: Boundary, energies: Sequence[Array]) -> Array:
    """Energies (K, F + 1) per area [N/m] of fluids on faces of walls, of d particles (K,); see `young_forces`."""
    result, on = np.zeros((len(ends[0]), len(energies[0]))), np.zeros(count, dtype=bool)
    parts = [(wall, members) for wall, _, members in boundary.members]
    parts += [(curve.wall, np.flatnonzero(boundary.on_curve == k)) for k, curve in enumerate(boundary.curves)]
    for wall, members in parts:
        on[:] = False
        on[boundary.index[members]] = True
        result[np.logical_and.reduce([on[end] for end in ends])] = energies[wall]
    return result
