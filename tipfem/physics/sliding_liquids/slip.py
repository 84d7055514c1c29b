"""InterfaceSlip: where two liquids slide along each other, each with its own velocity along the interface.

Liquids of little viscosity slide along each other: at their interface the velocity along it jumps. With one velocity
for each particle the jump takes a layer of cells, and waves between liquids of similar densities are too slow, at first
order in the spacing h. So where liquids slide, the lighter one has a velocity of its own at an interface particle i:
along the tangent t it moves like the particles j of that liquid beside i,

    v = v_i + s t,   s = part (t . sum_j w_j v_j - t . v_i),   sum_j w_j = 1,

and displacements and accelerations alike; in 3-D along each of two tangents at right angles. No unknown is added: the
inertia of the lighter liquid's part of the particle acts, along t, on the particles beside it. The equations are in
`tipfem.physics.sliding_liquids.term`.

What slides is a vortex sheet. Waves of the number k grow on it (Kelvin and Helmholtz) where gravity does not hold the
heavier liquid below strongly enough, for slip s and the component g_n of gravity towards the heavier liquid where

    s^2 > g_n (rho_1^2 - rho_2^2) / (k rho_1 rho_2)

(H. Lamb, Hydrodynamics, 6th ed., 1932, section 232). No mesh could resolve the shortest of these. So liquids slide
where all waves that the mesh resolves are stable, up to k = pi / h: freely up to half of that s^2, and less and less
up to all of it. Elsewhere, where the heavier liquid lies on top or the shear is strong, velocity is continuous.

Surface tension sigma holds the short waves, and these are stable where

    s^2 < (rho_1 + rho_2) / (rho_1 rho_2) (g_n (rho_1 - rho_2) / k + sigma k)

(ibid., section 268). The waves that no mesh could resolve are then those shorter than 8 h, k from pi / (4 h) to pi / h:
longer ones may grow, and that is physics. So liquids slide at every density ratio, equal densities included; of these
the one of the lower rank (`tipfem.case.fluid.ranks`) counts as the lighter one. But what slides is a layer without
thickness, half a cell away from where a layer would be that viscosity has made thick. With its thickness
delta = sqrt(2 nu / omega), nu of both together, the part 1 / (1 + (delta / h)^2) of the slip is let go. The rate omega
of the flow is that of the slips themselves: the root mean square of their accelerations over that of theirs.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from tipfem.backend.launch import launch
from tipfem.case.particles import Particles
from tipfem.mesh.components import ON_INTERFACE
from tipfem.mesh.mesh import Mesh
from tipfem.physics.carried import OwnInertia
from tipfem.physics.sliding_liquids import kernels
from tipfem.typing import Array

# Product of the densities over the square of their sum, 1/4 for equal ones, from which liquids slide. It is a factor of
# what a continuous velocity does to a wave's period, k h rho_1 rho_2 / (rho_1 + rho_2)^2 for the wave number k.
LEAST_PRODUCT = 0.01
FREE = 0.5  # of the largest s^2, up to which they slide freely
STEEPEST = 0.5  # least cosine of the angle between the normal and the direction to the mean place of those beside
LONGEST = 8.0  # wavelength up to which waves must be stable, where tension holds short ones [spacings]
LEAST_WEIGHT = 0.1  # factor that puts the mean place onto the normal


def may_slide(density: Sequence[float]) -> bool:
    """Whether any two fluids of these densities [kg/m^3] may slide along each other."""
    return any(_slides(np.array(a), np.array(b)) for a in density for b in density if a > b)


def _slides(heavy: Array, light: Array) -> Array:
    return np.asarray((light < heavy) & _similar(heavy, light))


def _similar(heavy: Array, light: Array) -> Array:
    return np.asarray(heavy * light >= LEAST_PRODUCT * (heavy + light) ** 2)


class HeldSheets(NamedTuple):
    """Forces that hold vortex sheets beside gravity, of F fluids."""

    rank: Array  # (F,) of the fluids, see `tipfem.case.fluid.ranks`
    sigma: Array  # (F, F) or larger, surface tension between each two of them [N/m]
    viscosity: Array  # (F,) [Pa s]
    rate: float = math.inf  # omega, of the slips in the last steps [1/s]; infinite where there were none

    def similar(self, density: Array) -> bool:
        """Whether any two fluids of densities (F,) [kg/m^3] with tension between them may slide."""
        fluids, count = self.sigma[: len(density), : len(density)], len(density)
        return any(fluids[i, j] > 0 and _similar(density[i], density[j]) for i in range(count) for j in range(i))


Lumping = float | Array  # lambda of all cells, or of each, see `tipfem.fem.mass`


@dataclass(frozen=True)
class InterfaceSlip(OwnInertia):
    """The C slips at interface particles, one along each tangent there, and the K cells of lighter liquids around."""

    owner: Array  # (C,) the particles, in 3-D each twice, ascending
    tangent: Array  # (C, d) t, units; in 2-D the lighter liquid is on the right-hand side
    part: Array  # (C,) of the slip that is let go, more than 0 and at most 1
    offsets: Array  # (C + 1,) of the particles beside each in the next two
    beside: Array  # (D,) their numbers
    weight: Array  # (D,) w
    cell: Array  # (K,) numbers of the cells
    nodes: Array  # (K, d + 1) particles at their corners
    corner: Array  # (K, d + 1, d - 1) which of the C each corner has; -1 for others
    corner_mass: Array  # (K, d + 1) parts of the cells' mass that belong to their corners [kg, in 2-D per metre]
    # (2,) means over the last steps of the squares of the slips and of their accelerations, see `rate`
    squares: Array = field(default_factory=lambda: np.zeros(2))

    @property
    def rate(self) -> float:
        """omega [1/s], see the module; infinite where nothing has slid yet."""
        slip, acceleration = self.squares
        return math.sqrt(acceleration / slip) if slip > 0 else math.inf

    def after(self, slip: Array, acceleration: Array, dt: float) -> InterfaceSlip:
        """The same after a step of length dt [s] with slips (C,) and their accelerations (C,); see `rate`.

        Older ones are forgotten within a period or so.
        """
        kept = math.exp(-min(dt * self.rate, 50.0) / (2 * math.pi)) if self.squares[0] > 0 else 1.0
        more = np.array([(x * x * self.mass).sum() for x in (slip, acceleration)])
        return replace(self, squares=kept * self.squares + dt * more)

    def without(self, left: Array) -> InterfaceSlip:
        """See `OwnInertia.without`."""
        stays, number = ~left[self.cell], np.cumsum(~left) - 1
        return replace(self, cell=number[self.cell] * stays, corner_mass=self.corner_mass * stays[:, None])

    @cached_property
    def mass(self) -> Array:
        """(C,) of the lighter liquids at the particles [kg]."""
        each = np.repeat(self.corner_mass.ravel(), self.corner.shape[2])
        return np.bincount(self.corner.ravel() + 1, each, len(self.owner) + 1)[1:]

    @cached_property
    def cell_mass(self) -> Array:
        """(K,) of the cells [kg]."""
        return np.asarray(self.corner_mass.sum(axis=1))

    @cached_property
    def share(self) -> Array:
        """(K, d + 1) parts of a cell that belong to its corners."""
        whole = self.cell_mass[:, None]
        return np.divide(self.corner_mass, whole, out=np.zeros_like(self.corner_mass), where=whole > 0)

    @cached_property
    def _sliding(self) -> kernels.Sliding:
        return kernels.Sliding(self.owner, self.tangent, self.part, self.offsets, self.beside, self.weight)

    @cached_property
    def _around(self) -> kernels.Around:
        return kernels.Around(self.nodes, self.corner.reshape(len(self.cell), -1), self.share, self.cell_mass)

    def slip(self, field: Array) -> Array:
        """s (C,) of a field of velocities, displacements or accelerations (N, d); more columns are not read."""
        result = np.empty(len(self.owner))
        launch(kernels.find_slips, self._sliding, np.ascontiguousarray(field), result, self.tangent.shape[1])
        return result

    @cached_property
    def _along(self) -> Array:
        """(K, d + 1, d - 1, d) t at the corners that slide, 0 at others."""
        return np.where((self.corner >= 0)[..., None], self.tangent[self.corner], 0.0)

    def slid(self, slip: Array) -> Array:
        """Z s (K, d + 1, d) of a slip (C,): the sum of s t at the corners that slide, 0 at others."""
        return np.asarray((slip[self.corner][..., None] * self._along).sum(axis=2))

    def at_corners(self, field: Array) -> Array:
        """See `OwnInertia.at_corners`."""
        return self.slid(self.slip(field))

    def carried(self, field: Array, lumping: Lumping = 1.0) -> Array:
        """Z^T M of a field (K, d + 1, d) at the cells' corners: what it would carry along t, by mass, (C,).

        M is the mass matrix of the cells with the part ``lumping``, one or (K,), lumped. See also `slid`.
        """
        part = np.reshape(lumping, (-1, 1, 1))
        mixed = part * field + (1 - part) * self._mean(field)[:, None]
        along = np.einsum("ekd,ekrd->ekr", mixed, self._along) * self.corner_mass[:, :, None]
        # The first of the sums is that of the corners that do not slide.
        return np.bincount(self.corner.ravel() + 1, along.ravel(), len(self.owner) + 1)[1:]

    def product(self, a: Array, b: Array, lumping: Lumping = 1.0) -> float:
        """Contribution of slip to a^T M b of two fields (N, d), see `carried`."""
        return self.products(a, b, [lumping])[0]

    def products(self, a: Array, b: Array, lumpings: Sequence[Lumping]) -> list[float]:
        """`product` with several mass matrices."""
        one = np.ascontiguousarray(a)
        other = one if b is a else np.ascontiguousarray(b)
        slips, sums = self.slip(one), np.zeros(len(lumpings))
        given = self._around, self.tangent, one, other, slips, slips if b is a else self.slip(other)
        parts = np.empty((len(lumpings), len(self.cell)))
        for row, part in zip(parts, lumpings, strict=True):
            row[:] = part
        launch(kernels.add_products, *given, parts, sums, self.tangent.shape[1])
        return [float(each) for each in sums]

    def _mean(self, field: Array) -> Array:
        """Means (K, d) of a field (K, d + 1, d) over the cells."""
        return np.asarray((field * self.share[:, :, None]).sum(axis=1))

    def work(self, acceleration: Array, displacement: Array, lumping: Lumping = 1.0) -> float:
        """Work of accelerations (N, d) of the particles' cells by displacements (N, d) on what slides [J]."""
        return float(self.slip(displacement) @ self.carried(acceleration[self.nodes], lumping))

    def total(self, field: Array) -> Array:
        """Contribution of slip to the sum (d,) of mass times a field (N, d): momentum of velocities.

        Of displacements it is what the liquids that slide add to sum m x, as they change the areas of the cells.
        """
        return np.asarray((self.mass * self.slip(field)) @ self.tangent)

    def without_momentum(self, field: Array, mass: Array) -> Array:
        """Changes of velocities (N, d) that leave momentum, sum m field = 0, completed so that slip does, too."""
        result = np.array(field)
        along = -self.mass * self.slip(field) / (mass[self.owner] - self.part * self.mass)
        np.add.at(result, self.owner, along[:, None] * self.tangent)
        return result


def find_slip(
    mesh: Mesh, particles: Particles, density: Array, gravity: Array, held: HeldSheets | None = None
) -> InterfaceSlip | None:
    """Find the particles at which liquids slide along each other; None where nothing does.

    They do at particles between two components of fluids, off walls and free surfaces, with a particle of the lighter
    liquid beside them that is not on any of these; surface tension may have ``held`` vortex sheets, too.
    """
    components, n, cells, position = mesh.components, len(particles), mesh.cells, particles.position
    dim = mesh.dimension
    assert components is not None
    on_interface = (components.mark & ON_INTERFACE) > 0
    free = ~(particles.wall | mesh.surface.front | mesh.surface.loose)
    cell, corner = np.divmod(np.flatnonzero((on_interface & free).take(cells)), dim + 1)
    order = np.argsort(np.argsort(density, kind="stable")) if held is None else held.rank
    at, rank = cells[cell, corner], order.take(np.asarray(mesh.fluid)[cell])
    label = components.label[cell]
    # Where more than two components meet, one is neither the first nor the last.
    first, last = np.full(n, len(components)), np.full(n, -1)
    highest, lowest = np.zeros(n, dtype=np.int64), np.full(n, len(density) - 1)
    np.minimum.at(first, at, label)
    np.maximum.at(last, at, label)
    np.maximum.at(highest, at, rank)
    np.minimum.at(lowest, at, rank)
    of_rank = np.argsort(order)
    heavy, light = (density.take(of_rank.take(place)) for place in (highest, lowest))
    slides, sigma = _slides(heavy, light), np.zeros(n)
    if held is not None:
        sigma = held.sigma[of_rank.take(highest), of_rank.take(lowest)]
        slides |= (sigma > 0) & (lowest < highest) & _similar(heavy, light)
    slides[at[(label != first[at]) & (label != last[at])]] = False
    chosen = slides[at] & (rank == lowest[at])
    cell, corner, at = cell[chosen], corner[chosen], at[chosen]
    if not len(at):
        return None
    chosen = np.zeros(n, dtype=bool)
    chosen[at] = True
    owner, number = np.flatnonzero(chosen), np.cumsum(chosen)[at] - 1
    count = len(owner)
    others = [cells[cell, (corner + k) % (dim + 1)] for k in range(1, dim + 1)]
    tangent, normal = _frames(mesh, others, corner, number, count)
    inside = free & ~on_interface
    pair = np.concatenate([(number * n + other)[inside[other]] for other in others])
    pair.sort()
    of, beside = np.divmod(pair[np.diff(pair, prepend=-1) > 0], n)
    path = mesh.period.shortest(position[beside] - position[owner[of]])
    along = np.stack([(path * t[of]).sum(axis=1) for t in tangent])
    weight, there = _weights(of, along, (path * normal[of]).sum(axis=1), count)
    mean = np.stack([np.bincount(of, weight * particles.velocity[beside, k], count) for k in range(dim)], axis=1)
    slip2 = sum(((mean - particles.velocity[owner]) * t).sum(axis=1) ** 2 for t in tangent)
    pull, spacing = -normal @ gravity, particles.target[owner]
    part = np.where(there, _part(slip2, heavy[owner], light[owner], pull, spacing, sigma[owner]), 0.0)
    if held is not None:
        viscosity = held.viscosity.take(of_rank)
        both = (viscosity.take(highest[owner]) + viscosity.take(lowest[owner])) / (heavy[owner] + light[owner])
        thick = 2 * both / (held.rate * spacing**2)  # (delta / h)^2
        part = np.where(sigma[owner] > 0, part / (1 + thick), part)
    there = part > 0
    if not there.any():
        return None
    kept, new = there[of], np.where(there, np.cumsum(there) - 1, -1)
    number = new[number]
    sliding = number >= 0
    cell, corner, number = cell[sliding], corner[sliding], number[sliding]
    new_cell, ways = np.diff(cell, prepend=-1) > 0, dim - 1
    around, corner_of = cell[new_cell], np.full((np.count_nonzero(new_cell), dim + 1, ways), -1)
    corner_of[np.cumsum(new_cell) - 1, corner] = number[:, None] * ways + np.arange(ways)
    length = np.bincount(of, minlength=count)[there]
    # One list of those beside after another, each once a tangent.
    first, times = np.cumsum(length) - length, np.repeat(length, ways)
    row = np.repeat(np.repeat(first, ways) - (np.cumsum(times) - times), times) + np.arange(times.sum())
    ints = np.repeat(owner[there], ways), np.concatenate([[0], np.cumsum(times)]), beside[kept][row], around, corner_of
    owners, offsets, listed, around, corner_of = (each.astype(np.int32) for each in ints)
    return InterfaceSlip(
        owner=owners,
        tangent=np.stack(tangent, axis=1)[there].reshape(-1, dim),
        part=np.repeat(part[there], ways),
        offsets=offsets,
        beside=listed,
        weight=weight[kept][row],
        cell=around,
        nodes=cells[around],
        corner=corner_of,
        corner_mass=mesh.parts_of(density.take(np.asarray(mesh.fluid)) * mesh.measure)[around],
    )


def _frames(mesh: Mesh, others: Sequence[Array], corner: Array, number: Array, count: int) -> tuple[list[Array], Array]:
    """The d - 1 tangents (C, d) of interfaces at C particles, at right angles, and the normals into lighter liquids.

    The interface's area vector at a particle is that of the faces opposite it, of the lighter liquid's J cells there,
    of which it is the ``corner`` (J,), the particle with this ``number`` (J,).
    """
    sides = [mesh.period.shortest(mesh.position[other] - mesh.position[others[0]]) for other in others[1:]]
    if mesh.dimension == 2:  # from one of its neighbours on the interface to the other
        tangent = _summed_units(sides[0], number, count)
        return [tangent], np.stack([tangent[:, 1], -tangent[:, 0]], axis=1)
    turned = np.where(corner % 2 == 0, 1.0, -1.0)[:, None]
    normal = _summed_units(np.cross(sides[0], sides[1]) * turned, number, count)
    axis = np.eye(3)[np.abs(normal).argmin(axis=1)]
    first = np.cross(normal, axis)
    first /= np.maximum(np.linalg.norm(first, axis=1), 1e-300)[:, None]
    return [first, np.cross(normal, first)], normal


def _summed_units(vectors: Array, number: Array, count: int) -> Array:
    """Units (C, d) along the sums of the vectors (J, d) of each ``number`` (J,)."""
    total = np.stack([np.bincount(number, part, count) for part in vectors.T], axis=1)
    return np.asarray(total / np.maximum(np.linalg.norm(total, axis=1), 1e-300)[:, None])


def _weights(of: Array, along: Array, across: Array, count: int) -> tuple[Array, Array]:
    """Weights (D,) of the particles beside, and whether (C,) there are any and their mean lies across the interface.

    They go with the inverse of the squared distance, changed so that the mean place lies on the normal where that
    leaves all of them positive. Each is beside one ``of`` the C, ``along`` (d - 1, D) and ``across`` (D,) into the
    lighter liquid [m].
    """
    weight = 1 / ((along**2).sum(axis=0) + across**2)
    first = [np.bincount(of, weight * one, count) for one in along]
    second = [[np.bincount(of, weight * (one * other), count) for other in along] for one in along]
    factor = 1 - sum(slope[of] * one for slope, one in zip(_solved(second, first), along, strict=True))
    least = np.full(count, np.inf)
    np.minimum.at(least, of, factor)
    weight = np.where(least[of] > LEAST_WEIGHT, weight * factor, weight)
    weight /= np.bincount(of, weight, count)[of]
    *away, ahead = (np.bincount(of, weight * path, count) for path in (*along, across))
    return weight, ahead > STEEPEST * np.sqrt(sum(path**2 for path in away) + ahead**2)


def _solved(matrix: Sequence[Sequence[Array]], right: Sequence[Array]) -> list[Array]:
    """Solutions of C symmetric systems of one or two equations; 0 where their matrix is singular."""
    if len(right) == 1:
        ((a,),), (r,) = matrix, right
        return [np.divide(r, a, out=np.zeros(len(r)), where=a > 0)]
    ((a, b), (_, c)), (r, s) = matrix, right
    determinant = a * c - b * b
    there = determinant > 1e-9 * a * c
    parts = c * r - b * s, a * s - b * r
    return [np.divide(part, determinant, out=np.zeros(len(r)), where=there) for part in parts]


def _part(slip2: Array, heavy: Array, light: Array, gravity: Array, spacing: Array, tension: Array) -> Array:
    """Part (C,) of the slip that is let go, from s^2, both densities, g_n towards the heavier liquid, and sigma."""
    largest = np.maximum(gravity, 0.0) * spacing / math.pi * (heavy / light - light / heavy)
    if tension.any():
        weight, shortest = gravity * (heavy - light), math.pi / spacing
        sigma = np.maximum(tension, 1e-300)
        # The least of g_n (rho_1 - rho_2) / k + sigma k for these k.
        k = np.clip(np.sqrt(np.maximum(weight, 0.0) / sigma), 2 / LONGEST * shortest, shortest)
        hold = np.maximum(weight / k + sigma * k, 0.0) * (heavy + light) / (heavy * light)
        largest = np.where(tension > 0, hold, largest)
    used = np.divide(slip2, largest, out=np.ones_like(slip2), where=largest > 0)
    return np.asarray(np.clip((1 - used) / (1 - FREE), 0.0, 1.0))
