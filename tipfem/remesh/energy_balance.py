"""Energy that remeshing adds is taken back, where it changed the mesh.

A repair of the mesh changes the velocity field between the particles, and an interface that moves lifts fluid. Either
sign occurs, and without viscosity what is gained stays. What is lost is lost: it was energy of differences between
neighbours, and to make others larger by as much would be noise.

Potential energy comes and goes: a wave lends and gets back each half period what the cells' areas and the restored
volumes change of it. Were each rise taken and each fall lost, this would damp waves as dry friction does. So an account
is kept of it, which forgets within the period of the case's longest wave, and only what it forgets is a gain or a loss.
It holds no more than 20 % of the kinetic energy of that time: flows have never more than a quarter too much.

The lumped energy sum m v^2 / 2 would be a bad measure of that: even where the velocity is linear in space, it depends
on the cells, a collapse raises it and a split lowers it. So the energy of the field itself, int rho v^2 / 2, is not to
rise, which no repair in a linear field changes; nor is that of the case's mass matrix, which the solve conserves and
the history has.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from tipfem.backend.arrays import partials, tallies
from tipfem.backend.launch import launch
from tipfem.case.case import Case
from tipfem.case.particles import Particles, largest_length
from tipfem.fem.mass import consistent_part, lumped_part
from tipfem.mesh.mesh import Mesh
from tipfem.physics.carried import OwnInertia
from tipfem.physics.state import EnergyMemory
from tipfem.remesh import energy_kernels as kernels
from tipfem.scratch import filled, scratch
from tipfem.typing import Array

LEAST_GAIN = 1e-7  # of the energies: less is left to later steps, for every change of velocities costs iterations
STRONGEST = 0.5  # largest factor of `Exchange`, with which no two particles exchange more than their difference
# Of what viscosity takes: how much may come and go without a balance, and how much of what is owed is remitted.
VISCOUS, REMITTED = 0.01, 1e-3
LENT = 0.2  # largest part of the kinetic energy that is lent to or by potential energy
# Rounds in which roughness is reduced, with the cells around added after each; and in which strain is, too, before the
# rest of a gain is left to the next step.
ROUGH_ROUNDS, ROUNDS = 4, 8
SAME = 1e-9  # of the largest speed: by less do velocities differ that were computed anew, as those of bodies
FIELD, CASE, POTENTIAL = 0, 1, 2  # energies: kinetic of the field, and by the case's mass matrix; potential


@dataclass(frozen=True)
class Change:
    """A remeshing, from N particles to N'."""

    # before, mesh: the particles that have moved, and the triangles with their fluids at the start of the step,
    # with whose masses it was solved
    before: Particles
    mesh: Mesh
    renumbered: Array | None  # (N,) new number of each particle, -1 for those removed; None if no number changes
    relocated: Array  # (N',) mask of the particles that were relocated or are new
    own: Sequence[OwnInertia] = ()  # parts of the state before it with inertia of their own
    dissipated: float = 0.0  # by viscosity and friction in the step before it [J, per metre of depth]
    dt: float = 0.0  # length of that step [s]
    passed: float = 0.0  # work of the weight of volumes that have passed thin edges [J, per metre of depth]

    @cached_property
    def fastest(self) -> float:
        """Largest speed about the particles' mean [m/s]."""
        velocity = self.before.velocity
        about = scratch("fastest.about", velocity.shape)
        for k, mean in enumerate(velocity.mean(axis=0)):
            np.subtract(velocity[:, k], mean, out=about[:, k])
        return largest_length(about)

    @property
    def unnoticed(self) -> float:
        """Energy [J] that is left to later steps: a part of what is dissipated while a particle moves by a spacing."""
        speed = self.fastest
        return VISCOUS * self.dissipated * self.before.spacing / (speed * self.dt) if speed * self.dt > 0 else 0.0


class EnergyBalance:
    """Takes back the energy that remeshing adds.

    Args:
        density: (F,) of the fluids [kg/m^3].
        mass: the mass matrix, see `tipfem.Numerics`.
        extent: of the case, by which the longest of its waves is known [m]; 0 to lend nothing.
    """

    def __init__(self, density: Sequence[float], gravity: Array, mass: str, extent: float = 0.0) -> None:
        self._density, self.gravity, self._mass = np.array(density, dtype=float), gravity, mass
        self._uniform = np.zeros(0)
        strength = math.hypot(*gravity)
        self.period = 2 * math.pi * math.sqrt(extent / strength) if strength > 0 else 0.0

    @staticmethod
    def of(case: Case, *, passed: bool = False) -> EnergyBalance | None:
        """Balance of a case; None if its numerics want none. Where fluids are ``passed`` on it lends nothing."""
        if not case.numerics.energy_balance:
            return None
        density, extent = [f.density for f in case.fluids], 0.0 if passed else math.hypot(*case.extent)
        return EnergyBalance(density, case.potential_gravity, case.numerics.mass, extent)

    def keep(
        self,
        change: Change,
        particles: Particles,
        mesh: Mesh,
        mass: Array,
        memory: EnergyMemory,
        own: Sequence[OwnInertia] = (),
        stored: float = 0.0,
    ) -> tuple[Particles, EnergyMemory]:
        """Remeshed particles with no more energy than those before.

        Relative velocities of the particles of changed cells are reduced, see `Exchange`, until neither the energy of
        the field nor that of the case's mass matrix has risen. The roughness is reduced first, by which their velocity
        gradients differ from those beside them: an exchange in a few cells of a smooth strain would make it rough.
        Where these cells have too little, the cells around are taken as well, and then the strain itself. A gain that
        is left then is owed by the next step.

        Little energy, by that of the flow or by what viscosity dissipates, is owed too, and changes no velocity; so is
        a loss, but no more than that. For which flips fall into one step is chance, and in a resolved flow these
        changes would be the largest error. In each step a part of what viscosity dissipates is remitted.

        Args:
            change: what was remeshed.
            particles: the N' particles after it.
            mesh: their triangles, with fluids.
            mass: (N',) lumped masses [kg].
            memory: of the steps before.
            own: parts of the state after it with inertia of their own.
            stored: energy that it has added to parts of the state, see `tipfem.physics.carried.Carried.energy` [J].

        Returns:
            The particles, with other velocities; and the memory of the next step.
        """
        lumping = self._lumping(mesh)
        now = self._energy(particles, mesh, lumping, own)
        before = self._energy(change.before, change.mesh, self._lumping(change.mesh), change.own)
        for part in change.own:
            path = change.mesh.period.shortest(change.before.position - change.mesh.position)
            before[POTENTIAL] -= part.total(path) @ self.gravity
        before[POTENTIAL] -= change.passed
        more = now - before
        kinetic, scale = self._scale(particles, mass, now[FIELD], own)
        memory, risen = self._lending(memory, more[POTENTIAL], kinetic, change.dt)
        more[POTENTIAL] = risen + stored
        gained, rise = more[FIELD] + more[POTENTIAL] + memory.owed, more[CASE] + more[POTENTIAL]
        unnoticed = change.unnoticed
        left = min(max(gained, -unnoticed), unnoticed)
        gained, rise = max(gained - left, 0.0), rise - unnoticed
        left = math.copysign(max(abs(left) - REMITTED * change.dissipated, 0.0), left)
        if max(gained, rise) <= LEAST_GAIN * scale:
            return particles, replace(memory, owed=gained + left)
        assert mesh.fluid is not None
        velocity, changed = np.array(particles.velocity), changed_cells(change, particles, mesh)
        exchange = Exchange(particles.wall, mesh, self._density, mass, changed, everywhere=bool(own))
        for count in range(ROUNDS):
            if count:
                exchange.widen()
            rate = exchange.rates(velocity, rough=count < ROUGH_ROUNDS)
            for part in own:
                rate = part.without_momentum(rate, mass)
            factor, taken, lowered = _factor(exchange, velocity, rate, lumping, gained, rise, own)
            exchange.add(velocity, rate, factor)
            gained, rise = gained - taken, rise - lowered
            if max(gained, rise) <= LEAST_GAIN * scale:
                break
        return particles.shallow_copy(velocity=velocity), replace(memory, owed=max(gained, 0.0) + left)

    def kinetic(self, particles: Particles, mesh: Mesh, own: Sequence[OwnInertia] = ()) -> float:
        """Kinetic energy by the case's mass matrix [J, per metre of depth]; see `keep`."""
        return float(self._energy(particles, mesh, self._lumping(mesh), own)[CASE])

    def _lending(self, memory: EnergyMemory, rise: float, kinetic: float, dt: float) -> tuple[EnergyMemory, float]:
        """The memory with a rise of potential energy in a step of length ``dt``, and what of it all is due [J].

        Less than 0 is due where a loss is forgotten, and then it is lost.
        """
        kept = math.exp(-dt / self.period) if self.period > 0 else 0.0
        largest = max(kinetic, kept * memory.kinetic)
        account = memory.lent + rise
        lent = min(max(kept * account, -LENT * largest), LENT * largest)
        return replace(memory, lent=lent, kinetic=largest), account - lent

    def _scale(
        self, particles: Particles, mass: Array, energy: float, own: Sequence[OwnInertia]
    ) -> tuple[float, float]:
        """Kinetic energy [J] in the frame of the centre of mass, of the whole ``energy``; and what energies scale with.

        This is with it how much energy the particles have by the distances of their heights from the centre's: neither
        depends on where the flow is, or how fast it all moves.
        """
        whole = max(float(mass.sum()), 1e-300)
        height = np.dot(particles.position, self.gravity, out=scratch("balance.height", len(mass)))
        momentum = np.einsum("i,ij->j", mass, particles.velocity) + sum(part.total(particles.velocity) for part in own)
        kinetic = max(energy - 0.5 * float((momentum**2).sum()) / whole, 0.0)
        height -= np.einsum("i,i", mass, height) / whole
        return kinetic, kinetic + float(np.einsum("i,i", mass, np.abs(height, out=height)))

    def _lumping(self, mesh: Mesh) -> Array:
        """lambda (M,) of the cells, see `tipfem.fem.mass`."""
        if self._mass != "interfaces":
            if len(self._uniform) < len(mesh.cells):
                size = len(mesh.cells) + len(mesh.cells) // 8
                self._uniform = np.full(size, 1.0 if self._mass == "lumped" else consistent_part(2))
            return self._uniform[: len(mesh.cells)]
        assert mesh.fluid is not None
        fluids = np.eye(len(self._density))[mesh.fluid]
        return lumped_part(self._mass, mesh.cells, fluids, len(mesh.position))

    def _energy(self, particles: Particles, mesh: Mesh, lumping: Array, own: Sequence[OwnInertia]) -> Array:
        """Energies (3,) `FIELD`, `CASE` and `POTENTIAL` of a mesh with particles that may have moved since [J]."""
        result = np.zeros(3)
        assert mesh.fluid is not None
        launch(
            kernels.field_energy,
            _triangles(mesh, self._density),
            *map(np.ascontiguousarray, (particles.position, particles.velocity)),
            self.gravity,
            lumping,
            partials(3),
            result,
            work=(len(mesh.cells), kernels.ENERGY),
        )
        v = particles.velocity
        for part in own:
            result[[FIELD, CASE]] += 0.5 * np.array(part.products(v, v, (consistent_part(2), lumping[part.cell])))
        return result


def _triangles(mesh: Mesh, density: Array) -> kernels.Triangles:
    assert mesh.fluid is not None
    position, cells, fluid = map(np.ascontiguousarray, (mesh.position, mesh.cells, mesh.fluid))
    return kernels.Triangles(position, cells, mesh.period.array, fluid, density, mesh.measure)


def _labelled(mesh: Mesh, velocity: Array) -> kernels.Labelled:
    assert mesh.fluid is not None
    return kernels.Labelled(*map(np.ascontiguousarray, (mesh.cells, mesh.fluid, velocity)))


def changed_cells(change: Change, particles: Particles, mesh: Mesh) -> Array:
    """(M',) mask of the cells that are new, have another fluid, or a particle whose velocity has changed."""
    number = np.zeros(0) if change.renumbered is None else change.renumbered
    result = np.empty(len(mesh.cells), dtype=bool)
    following, listed = scratch("changed.lists", (2, len(change.mesh.cells)), np.int32)
    launch(
        kernels.mark_changed,
        _labelled(change.mesh, change.before.velocity),
        np.ascontiguousarray(number, dtype=np.int32),
        _labelled(mesh, particles.velocity),
        SAME * change.fastest,
        change.relocated.copy().view(np.int8),
        kernels.Buckets(scratch("changed.first", len(particles), np.int32), following),
        listed,
        result.view(np.int8),
        tallies("changed.found"),
        work=(len(result), kernels.CHANGED),
    )
    return result


class Exchange:
    """Changes of velocities that reduce how fast the particles of some cells approach or leave each other.

    Along each edge between two particles off the walls, they exchange the momentum of 1/6 of the cell's mass with
    the difference of their velocities in the edge's direction. So no momentum and no angular momentum is made, and a
    rigid motion is left as it is.

    Args:
        wall: (N,) mask of the particles on walls.
        density: (F,) of the fluids [kg/m^3].
        mass: (N,) lumped, of the particles [kg].
        cells: (M,) mask of the triangles.
        everywhere: whether velocities may change at other particles, too, by what `rates` returns.
    """

    def __init__(
        self, wall: Array, mesh: Mesh, density: Array, mass: Array, cells: Array, *, everywhere: bool = False
    ) -> None:
        count, elements = len(mass), len(cells)
        self._triangles, neighbours = _triangles(mesh, density), np.ascontiguousarray(mesh.neighbours)
        self._given = neighbours, np.ascontiguousarray(mass), wall.view(np.int8)
        self._everywhere, self._changed = everywhere, cells.view(np.int8)
        self._near, self._rate = filled(0, "exchange.near", count, np.int8), filled(0.0, "exchange.rate", (count, 2))
        particles = scratch("exchange.particles", count, np.int32)
        active, beside = scratch("exchange.cells", (2, elements), np.int32)
        self._lists = kernels.Lists(active, beside, particles, np.zeros(3, dtype=np.int32))
        self._term = scratch("exchange.term", (elements, 6))
        self._list(grow=False)

    def _list(self, *, grow: bool) -> None:
        cells, found = self._triangles.cells, tallies("exchange.found")
        given = cells, grow, self._everywhere, self._changed, self._near, self._lists, found
        launch(kernels.list_cells, *given, work=(len(cells), kernels.LISTED))

    def widen(self) -> None:
        """Add the cells that have a corner in common with these."""
        if not self._everywhere:  # they are listed already
            lists = self._lists
            self._lists = lists._replace(active=lists.beside, beside=lists.active)
            lists.counts[kernels.ACTIVE] = lists.counts[kernels.BESIDE]
        self._list(grow=True)

    def rates(self, velocity: Array, *, rough: bool) -> Array:
        """The changes (N, 2) of velocities (N, 2), with a factor of 1; they are overwritten by the next ones.

        Args:
            velocity: of the particles [m/s].
            rough: whether the difference is that by the cell's velocity gradient less its mean with the cells of its
                fluid beside it, so that a velocity that is linear in space is left as it is.
        """
        given = self._triangles, *self._given, np.ascontiguousarray(velocity), self._lists, rough, self._term
        work = int(self._lists.counts[kernels.ACTIVE]), kernels.PUSHED
        launch(kernels.exchange_momentum, *given, self._rate, work=work)
        return self._rate

    def energies(self, velocity: Array, rate: Array, lumping: Array) -> tuple[list[float], list[float]]:
        """v^T M u and u^T M u of velocities v (N, 2) and rates u (N, 2), with two mass matrices M.

        The consistent one, and that of which the part ``lumping`` (M,) is lumped in each cell.
        """
        sums, part = np.zeros(4), consistent_part(2)
        given = self._triangles, velocity, rate, lumping, part, self._lists, self._term, sums
        work = int(self._lists.counts[kernels.BESIDE]), kernels.EXCHANGED
        launch(kernels.exchanged_energy, *given, tallies("exchange.found"), work=work)
        return sums[:2].tolist(), sums[2:].tolist()

    def add(self, velocity: Array, rate: Array, factor: float) -> None:
        """Add a factor times the rates (N, 2) to velocities (N, 2)."""
        if self._everywhere:
            velocity += factor * rate
        else:
            launch(kernels.add_rates, velocity, rate, factor, self._lists)


def _factor(
    exchange: Exchange,
    velocity: Array,
    rate: Array,
    lumping: Array,
    gained: float,
    rise: float,
    own: Sequence[OwnInertia],
) -> tuple[float, float, float]:
    """The factor of a ``rate`` (N, 2) with which velocities lose at least ``gained`` and ``rise``, or its limit.

    Also what they lose of the kinetic energies of the field and by the case's mass matrix [J].
    """
    field, case = exchange.energies(velocity, rate, lumping)
    for part in own:
        lumpings = consistent_part(2), lumping[part.cell]
        added = part.products(velocity, rate, lumpings), part.products(rate, rate, lumpings)
        field, case = (
            [slope + first, curvature + second]
            for (slope, curvature), first, second in zip((field, case), *added, strict=True)
        )
    if field[0] >= 0 or case[0] >= 0:
        return 0.0, 0.0, 0.0
    factor = min(STRONGEST, max(_root(field[0], field[1], gained), _root(case[0], case[1], max(rise, 0.0))))
    lost = [-(slope + 0.5 * curvature * factor) * factor for slope, curvature in (field, case)]
    return factor, lost[0], lost[1]


def _root(slope: float, curvature: float, energy: float) -> float:
    """The factor f with slope f + curvature f^2 / 2 = -energy, or of the minimum; beyond it energy would rise again."""
    return (-slope - math.sqrt(max(slope * slope - 2 * curvature * energy, 0.0))) / curvature
