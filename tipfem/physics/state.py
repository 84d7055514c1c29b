"""State: a simulation between two steps; Solved: the result of a step's solve, before remeshing.

Both are frozen. A step solves, which gives a `Solved`, and remeshes, which gives the next `State`; neither is
changed in place, so a step that is refused leaves the simulation unchanged.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from tipfem.backend.arrays import sums_by_label
from tipfem.backend.launch import launch
from tipfem.case.boundary.boundary import Boundary
from tipfem.case.particles import Particles
from tipfem.fem import work
from tipfem.fem.mass import product
from tipfem.fem.time_integration import BackwardEuler, TimeScheme
from tipfem.mesh.mesh import Mesh
from tipfem.physics.carried import Carried, HasParts
from tipfem.physics.term import StepWork
from tipfem.physics.walls.step import WallsInStep
from tipfem.scratch import filled
from tipfem.typing import Array


@dataclass(frozen=True)
class Material(ABC):
    """Properties of the fluids in the M elements of a mesh."""

    density: Array  # (M,) [kg/m^3]
    viscosity: Array  # (M,) [Pa s]

    @property
    @abstractmethod
    def fraction(self) -> Array:
        """(M, F) part of each element that each fluid fills."""

    @abstractmethod
    def volumes(self, measure: Array) -> Array:
        """Volumes (F,) of the fluids in elements of ``measure`` (M,) [m^2, or m^3 in 3-D]."""


@dataclass(frozen=True)
class SharpMaterial(Material):
    """Elements of one fluid each."""

    fluid: Array  # (M,) of each element
    count: int  # number of fluids F

    @cached_property
    def fraction(self) -> Array:
        """(M, F) part of each element that each fluid fills: 0 or 1."""
        return np.asarray((self.fluid[:, None] == np.arange(self.count)).astype(float))

    def volumes(self, measure: Array) -> Array:
        """See `Material.volumes`."""
        return sums_by_label(self.fluid, measure, self.count)


@dataclass(frozen=True)
class InterpolatedMaterial(Material):
    """Elements through which interfaces run."""

    parts: Array  # (M, F) part of each element that each fluid fills
    nodal_density: Array  # (N,) density around each particle [kg/m^3], NaN for those in no element

    @property
    def fraction(self) -> Array:
        """(M, F) part of each element that each fluid fills."""
        return self.parts

    def volumes(self, measure: Array) -> Array:
        """See `Material.volumes`."""
        # By einsum, which is serial: a sum by BLAS would depend on the number of threads.
        return np.asarray(np.einsum("k,kn->n", measure, self.parts))


def lumped(mesh: Mesh, density: Array) -> Array:
    """Lumped mass (N,) [kg, per metre of depth in 2-D] from the elements' densities (M,) [kg/m^3]."""
    if mesh.period.axial:
        return np.bincount(mesh.cells.ravel(), mesh.parts_of(density * mesh.measure).ravel(), len(mesh.position))
    mass = filled(0.0, "", len(mesh.position))
    cells = np.ascontiguousarray(mesh.cells)
    launch(work.lump, cells, mesh.measure, density, mass, mesh.dimension)
    return mass


@dataclass(frozen=True)
class EnergyMemory:
    """Memory of the energy balance of remeshing, see `tipfem.remesh.energy_balance` [J, per metre of depth]."""

    owed: float = 0.0  # energy that remeshing has added and not yet taken back; less than 0 for what it has taken
    # what it has lately added to potential energy and may get back; less than 0 for what it has taken
    lent: float = 0.0
    kinetic: float = 0.0  # largest kinetic energy of late, in the frame of the centre of mass


@dataclass(frozen=True, eq=False)
class State(HasParts):
    """All that the flow depends on between two steps, besides the case and the controllers; equal to itself alone."""

    time: float  # [s]
    step: int  # number of steps taken
    particles: Particles  # N particles
    mesh: Mesh  # M cells on their positions
    boundary: Boundary  # which particles lie on which walls
    reference: int  # the particle at which the pressure of a closed tank is zero; -1 for none, where its mean is zero
    fixed: Array  # (N,) mask of the particles that no remeshing relocates or removes, even on walls where others slide
    material: Material  # of the elements
    # (N,) lumped mass of each particle [kg, per metre of depth in 2-D]; particles in no element have their own
    mass: Array
    volume: Array  # (F,) of each fluid [m^2, or m^3 in 3-D], that of particles in no element included
    # (F,) the same that each fluid should have: at the start, what was added and what passed openings
    wanted_volume: Array
    # (2, d) lowest and highest coordinates that the multigrid's grids cover [m]; NaN before the first step
    grid_box: Array
    relocated: Array  # (N,) mask of the particles that the last remeshing relocated or inserted
    relocations: int = 0  # how many particles it relocated because they crowded others, or inserted
    # how many meshes since the start were triangulated anew, because the last mesh could not be repaired
    rebuilt: int = 0
    # what the physics carry from step to step, by their names, see `tipfem.physics.registry`
    parts: Mapping[str, Carried] = field(default_factory=dict)
    memory: EnergyMemory = EnergyMemory()  # of the energy that remeshing has added and taken
    impact: bool = False  # whether velocities jumped in the last step, see `tipfem.step.impacts`

    @property
    def mean_acceleration(self) -> float:
        """Root mean square of the particles' accelerations over their mass [m/s^2]."""
        a = self.particles.acceleration
        return float(np.sqrt(product(self.mass, a, a) / self.mass.sum()))

    def speed_over_spacing(self, step: float) -> float:
        """See `Boundary.speed_over_spacing`; ``step`` is a length of time steps [s]."""
        return self.boundary.speed_over_spacing(self.particles, self.time, step, self.mesh.flies)

    @property
    def volume_error(self) -> float:
        """Largest difference of a fluid's volume from that wanted, relative to it."""
        there = self.wanted_volume > 0
        return float(np.abs(self.volume[there] / self.wanted_volume[there] - 1).max(initial=0.0))


@dataclass(frozen=True)
class Solved(HasParts):
    """A solved step, before its particles are meshed anew."""

    before: State  # the state at the start of the step
    time: float  # at the end of the step [s]
    scheme: TimeScheme  # time integration, with the step's length
    particles: Particles  # the particles of ``before`` at the end of the step
    walls: WallsInStep  # what the walls prescribe in the step
    displacement: Array  # (N, d) in the step [m]
    inertia: Array  # (N, d) a_alpha - b [m/s^2], the acceleration less gravity and body force at the intermediate time
    force: Array  # (N, d) gravity and body force b there [m/s^2]
    growth: Array  # (M,) relative growth of the elements that was prescribed
    grid_box: Array  # (2, d) that the multigrid's grids covered [m]
    work: StepWork  # of the terms of the residual
    acting: tuple[str, ...]  # names of the physics of these terms, but for the elements, in their order
    # newton_iterations, krylov_iterations: how many the solve took
    newton_iterations: int
    krylov_iterations: int
    residual: float  # norm of the scaled residual after Newton's method [spacings]
    # what the physics carry, on the particles of ``before``; where the step has found nothing new, from there
    parts: Mapping[str, Carried] = field(default_factory=dict)
    uniform: bool = False  # whether ``force`` is the same everywhere and at all times, as gravity is
    # (W, d) force of the walls and bodies on each of their particles, at the intermediate time and at the level of
    # pressure of the solve [N, per metre of depth in 2-D]
    reactions: Array = field(default_factory=lambda: np.zeros((0, 0)))
    level: float = 0.0  # what the pressures of the particles are less than those of the solve, in a closed tank [Pa]
    keeps_cells: bool = False  # whether the repair of its cells may wait, see `tipfem.step.solve.steps_between_repairs`
    # of the time integration in the step, see `tipfem.fem.time_integration.local_error` [spacings]; NaN of an impact,
    # whose jump no length of step resolves
    error: float = math.nan

    @property
    def dt(self) -> float:
        """Length of the step [s]."""
        return self.scheme.dt

    @property
    def impact(self) -> bool:
        """Whether velocities jump in the step, so that it was taken with backward Euler's method."""
        return isinstance(self.scheme, BackwardEuler)

    @property
    def acceleration(self) -> Array:
        """(N, d) a_alpha [m/s^2], the acceleration at the intermediate time."""
        return self.inertia + self.force

    @property
    def mesh(self) -> Mesh:
        """The mesh of ``before``, moved with the particles."""
        return self.before.mesh.moved(self.particles.position)

    def at(self, time: float) -> tuple[Particles, Mesh]:
        """The particles and their mesh at a time within the step [s], before any remeshing.

        Positions are the cubic polynomials that have the velocities at both ends of the step, in an impact straight
        lines; velocities and pressures are linear in time. The particles of openings are on their lines.
        """
        old, new, mesh = self.before.particles, self.particles, self.before.mesh
        s = (time - self.before.time) / (self.time - self.before.time)
        moved = mesh.period.shortest(new.position - old.position)
        position = old.position + s * moved
        if not self.impact:
            ends = (1 - s) * (self.dt * old.velocity - moved) - s * (self.dt * new.velocity - moved)
            position += s * (1 - s) * ends
        position = mesh.period.wrapped(self.before.boundary.closed(position, old.position))
        velocity, pressure = (
            (1 - s) * one + s * other for one, other in ((old.velocity, new.velocity), (old.pressure, new.pressure))
        )
        return old.shallow_copy(position=position, velocity=velocity, pressure=pressure), mesh.moved(position)
