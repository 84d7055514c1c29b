"""InterfaceSlip: where two liquids slide along each other, each with its own velocity along the interface.

Liquids of little viscosity slide along each other: at their interface the velocity along it jumps. With one velocity
for each particle the jump takes a layer of cells, and waves between liquids of similar densities are too slow, at first
order in the spacing h. So where liquids slide, the lighter one has a velocity of its own at an interface particle i:
along the tangent t it moves like the particles j of that liquid beside i,

    v = v_i + s t,   s = part (t . sum_j w_j v_j - t . v_i),   sum_j w_j = 1,

and displacements and accelerations alike. No unknown is added: the inertia of the lighter liquid's part of the
particle acts, along t, on the particles beside it. The equations are in `tipfem.physics.sliding_liquids.term`.

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

from tipfem.case.particles import Particles
from tipfem.mesh.components import ON_INTERFACE
from tipfem.mesh.mesh import Mesh
from tipfem.physics.carried import OwnInertia
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
    """The C interface particles at which liquids slide, and the K cells of the lighter liquids around them."""

    owner: Array  # (C,) the particles
    tangent: Array  # (C, 2) t, units, the lighter liquid on the right-hand side
    part: Array  # (C,) of the slip that is let go, more than 0 and at most 1
    offsets: Array  # (C + 1,) of the particles beside each in the next two
    beside: Array  # (D,) their numbers
    weight: Array  # (D,) w
    cell: Array  # (K,) numbers of the cells
    nodes: Array  # (K, 3) particles at their corners
    corner: Array  # (K, 3) at which of the C each corner is; -1 for others
    cell_mass: Array  # (K,) [kg, per metre of depth]
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
        return replace(self, cell=number[self.cell] * stays, cell_mass=self.cell_mass * stays)

    @cached_property
    def mass(self) -> Array:
        """(C,) of the lighter liquids at the particles, thirds of their cells' [kg]."""
        return np.bincount(self.corner.ravel() + 1, np.repeat(self.cell_mass / 3, 3), len(self.owner) + 1)[1:]

    def slip(self, field: Array) -> Array:
        """s (C,) of a field of velocities, displacements or accelerations (N, 2)."""
        weighted = self.weight[:, None] * field[self.beside]
        mean = np.add.reduceat(weighted, self.offsets[:-1])
        return np.asarray(self.part * ((mean - field[self.owner]) * self.tangent).sum(axis=1))

    @cached_property
    def _along(self) -> Array:
        """(K, 3, 2) t at the corners that slide, 0 at others."""
        return np.where((self.corner >= 0)[:, :, None], self.tangent[self.corner], 0.0)

    def slid(self, slip: Array) -> Array:
        """Z s (K, 3, 2) of a slip (C,): s t at the corners that slide, 0 at others."""
        return np.asarray(slip[self.corner][:, :, None] * self._along)

    def at_corners(self, field: Array) -> Array:
        """See `OwnInertia.at_corners`."""
        return self.slid(self.slip(field))

    def carried(self, field: Array, lumping: Lumping = 1.0) -> Array:
        """Z^T M of a field (K, 3, 2) at the cells' corners: what it would carry along t, by mass, (C,).

        M is the mass matrix of the cells with the part ``lumping``, one or (K,), lumped. See also `slid`.
        """
        part = np.reshape(lumping, (-1, 1, 1))
        mixed = part * field + (1 - part) / 3 * (field[:, :1] + field[:, 1:2] + field[:, 2:])
        along = np.einsum("ekd,ekd->ek", mixed, self._along) * (self.cell_mass / 3)[:, None]
        # The first of the sums is that of the corners that do not slide.
        return np.bincount(self.corner.ravel() + 1, along.ravel(), len(self.owner) + 1)[1:]

    def product(self, a: Array, b: Array, lumping: Lumping = 1.0) -> float:
        """Contribution of slip to a^T M b of two fields (N, 2), see `carried`."""
        return self.products(a, b, [lumping])[0]

    def products(self, a: Array, b: Array, lumpings: Sequence[Lumping]) -> list[float]:
        """`product` with several mass matrices."""
        slid = self.slid(self.slip(a))
        one, other = a[self.nodes], b[self.nodes]
        with_slip = other + (slid if b is a else self.slid(self.slip(b)))
        own = np.einsum("ekd,ekd->e", slid, with_slip) + np.einsum("ekd,ekd->e", one, with_slip - other)
        first, second, third, last = (x[:, 0] + x[:, 1] + x[:, 2] for x in (slid, with_slip, one, with_slip - other))
        mean = (np.einsum("ed,ed->e", first, second) + np.einsum("ed,ed->e", third, last)) / 3
        return [float(self.cell_mass @ (part * own + (1 - part) * mean)) / 3 for part in lumpings]

    def work(self, acceleration: Array, displacement: Array, lumping: Lumping = 1.0) -> float:
        """Work of accelerations (N, 2) of the particles' cells by displacements (N, 2) on what slides [J]."""
        return float(self.slip(displacement) @ self.carried(acceleration[self.nodes], lumping))

    def total(self, field: Array) -> Array:
        """Contribution of slip to the sum (2,) of mass times a field (N, 2): momentum of velocities.

        Of displacements it is what the liquids that slide add to sum m x, as they change the areas of the cells.
        """
        return np.asarray((self.mass * self.slip(field)) @ self.tangent)

    def without_momentum(self, field: Array, mass: Array) -> Array:
        """Changes of velocities (N, 2) that leave momentum, completed by changes at the owners so that slip does, too.

        Args:
            field: sum m field is 0.
        """
        result = np.array(field)
        along = -self.mass * self.slip(field) / (mass[self.owner] - self.part * self.mass)
        result[self.owner] += along[:, None] * self.tangent
        return result


def find_slip(
    mesh: Mesh, particles: Particles, density: Array, gravity: Array, held: HeldSheets | None = None
) -> InterfaceSlip | None:
    """Find the particles at which liquids slide along each other; None where nothing does.

    They do at particles between two components of fluids, off walls and free surfaces, with a particle of the lighter
    liquid beside them that is not on any of these.

    Args:
        mesh: 2-D, with the components of its fluids.
        held: where surface tension holds vortex sheets, too.
    """
    components, n, cells, position = mesh.components, len(particles), mesh.cells, particles.position
    assert components is not None
    on_interface = (components.mark & ON_INTERFACE) > 0
    free = ~(particles.wall | mesh.surface.front | mesh.surface.loose)
    cell, corner = np.divmod(np.flatnonzero((on_interface & free).take(cells)), 3)
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
    # The sides opposite a particle lead from one of its neighbours on the interface to the other.
    first, last = cells[cell, (corner + 1) % 3], cells[cell, (corner + 2) % 3]
    side = mesh.period.shortest(position[last] - position[first])
    chord = np.stack([np.bincount(number, side[:, k], count) for k in range(2)], axis=1)
    tangent = chord / np.maximum(np.linalg.norm(chord, axis=1), 1e-300)[:, None]
    normal = np.stack([tangent[:, 1], -tangent[:, 0]], axis=1)
    inside = free & ~on_interface
    pair = np.concatenate([(number * n + other)[inside[other]] for other in (first, last)])
    pair.sort()
    of, beside = np.divmod(pair[np.diff(pair, prepend=-1) > 0], n)
    path = mesh.period.shortest(position[beside] - position[owner[of]])
    weight, there = _weights(of, (path * tangent[of]).sum(axis=1), (path * normal[of]).sum(axis=1), count)
    mean = np.stack([np.bincount(of, weight * particles.velocity[beside, k], count) for k in range(2)], axis=1)
    slip = ((mean - particles.velocity[owner]) * tangent).sum(axis=1)
    pull, spacing = -normal @ gravity, particles.target[owner]
    part = np.where(there, _part(slip, heavy[owner], light[owner], pull, spacing, sigma[owner]), 0.0)
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
    new_cell = np.diff(cell, prepend=-1) > 0
    around, corner_of = cell[new_cell], np.full((np.count_nonzero(new_cell), 3), -1)
    corner_of[np.cumsum(new_cell) - 1, corner] = number
    return InterfaceSlip(
        owner=owner[there],
        tangent=tangent[there],
        part=part[there],
        offsets=np.concatenate([[0], np.cumsum(np.bincount(of, minlength=count)[there])]),
        beside=beside[kept],
        weight=weight[kept],
        cell=around,
        nodes=cells[around],
        corner=corner_of,
        cell_mass=density.take(np.asarray(mesh.fluid)[around]) * mesh.measure[around],
    )


def _weights(of: Array, along: Array, across: Array, count: int) -> tuple[Array, Array]:
    """Weights (D,) of the particles beside, and whether (C,) there are any and their mean lies across the interface.

    They go with the inverse of the squared distance, changed so that the mean place lies on the normal where that
    leaves all of them positive.

    Args:
        of: (D,) which of the C each is beside.
        along: (D,) distance along the interface [m].
        across: (D,) into the lighter liquid [m].
    """
    weight = 1 / (along**2 + across**2)
    first, second = (np.bincount(of, weight * along**k, count) for k in (1, 2))
    factor = 1 - np.divide(first, second, out=np.zeros(count), where=second > 0)[of] * along
    least = np.full(count, np.inf)
    np.minimum.at(least, of, factor)
    weight = np.where(least[of] > LEAST_WEIGHT, weight * factor, weight)
    weight /= np.bincount(of, weight, count)[of]
    along, across = (np.bincount(of, weight * path, count) for path in (along, across))
    return weight, across > STEEPEST * np.hypot(along, across)


def _part(slip: Array, heavy: Array, light: Array, gravity: Array, spacing: Array, tension: Array) -> Array:
    """Part (C,) of the slip that is let go.

    Args:
        slip: s [m/s].
        heavy: density of the heavier liquid [kg/m^3], and
        light: of the lighter one.
        gravity: g_n towards the heavier liquid [m/s^2].
        tension: sigma [N/m].
    """
    largest = np.maximum(gravity, 0.0) * spacing / math.pi * (heavy / light - light / heavy)
    if tension.any():
        weight, shortest = gravity * (heavy - light), math.pi / spacing
        sigma = np.maximum(tension, 1e-300)
        # The least of g_n (rho_1 - rho_2) / k + sigma k for these k.
        k = np.clip(np.sqrt(np.maximum(weight, 0.0) / sigma), 2 / LONGEST * shortest, shortest)
        hold = np.maximum(weight / k + sigma * k, 0.0) * (heavy + light) / (heavy * light)
        largest = np.where(tension > 0, hold, largest)
    used = np.divide(slip**2, largest, out=np.ones_like(slip), where=largest > 0)
    return np.asarray(np.clip((1 - used) / (1 - FREE), 0.0, 1.0))
