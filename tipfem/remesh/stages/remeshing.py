"""State that goes through the stages of a remeshing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, TypeVar

import numpy as np

from tipfem.case.boundary.boundary import Boundary
from tipfem.case.fluid import Fluid, ranks
from tipfem.case.grading import Grading
from tipfem.case.numerics import FittedRule
from tipfem.case.particles import Particles
from tipfem.mesh.interface import SharpInterface
from tipfem.mesh.mesh import Mesh
from tipfem.mesh.relabelled import Relabelled
from tipfem.physics.carried import Carried
from tipfem.physics.physics import Moved, Physics
from tipfem.physics.state import EnergyMemory, SharpMaterial, Solved, State, lumped
from tipfem.remesh.energy_balance import EnergyBalance
from tipfem.remesh.repair_account import NoAccount
from tipfem.remesh.target_spacing import graded
from tipfem.remesh.triangles.spray import Spray
from tipfem.typing import Array

Self = TypeVar("Self", bound="Remeshing")


class Labels(NamedTuple):
    """Numbers of fluids from the lightest, 0; where there is empty space, that is the lightest of all."""

    of: Array  # (F + 1,) of each fluid, and of empty space
    fluid: Array  # (L,) of each label
    density: Array  # (L,) the same, 0 for empty space [kg/m^3]


@dataclass(frozen=True)
class Rules:
    """Rules of remeshing in a case with sharp interfaces."""

    fluids: Sequence[Fluid]  # of the case, F of them
    physics: Sequence[Physics[Any]]  # of the case
    fitting: FittedRule  # when the triangulation is changed
    # whether every remeshing restores the volumes that the fluids started with, or only those before that
    # remeshing
    keep: bool
    # of the target spacings; None for the same spacing everywhere and a constant number of particles
    grading: Grading | None = None
    balance: EnergyBalance | None = None  # keeps the energy in each remeshing; None to let it change
    open: bool = False  # whether there is empty space, in 3-D

    @property
    def names(self) -> list[str]:
        """Names of the fluids."""
        return [fluid.name for fluid in self.fluids]

    @property
    def density(self) -> Array:
        """(F,) of the fluids [kg/m^3]."""
        return np.array([fluid.density for fluid in self.fluids], dtype=float)

    @property
    def rank(self) -> Array:
        """(F,) of the fluids from the lightest, 0, to the heaviest."""
        return ranks(self.fluids)

    @cached_property
    def labels(self) -> Labels:
        """Labels of the fluids, in 3-D."""
        of = np.append(self.rank + 1, 0) if self.open else self.rank
        fluid = np.argsort(of).astype(np.int32)
        return Labels(of, fluid, np.append(self.density, 0.0)[fluid])

    def graded(self, particles: Particles, mesh: Mesh, parts: Mapping[str, Carried]) -> Particles:
        """The particles with their target spacings."""
        return graded(particles, mesh, self.names, self.grading, parts.values())

    def material(self, mesh: Mesh) -> tuple[SharpMaterial, Array]:
        """Material of the elements, and the lumped masses (N,) [kg]."""
        fluid = np.asarray(mesh.fluid)
        density, viscosity = SharpInterface().element_properties(mesh, fluid, self.fluids)
        return SharpMaterial(density, viscosity, fluid, len(self.fluids)), lumped(mesh, density)


@dataclass(frozen=True)
class Remeshing:
    """A state that becomes the next one, stage by stage."""

    rules: Rules  # what it goes by
    account: NoAccount  # of what each kind of repair adds
    solved: Solved  # the step
    particles: Particles  # as far as they are; N' once the triangulation is repaired, N before
    mesh: Mesh  # on which the particles moved; once it is repaired, the next one
    parts: Mapping[str, Carried]  # what the physics carry
    wanted: Array  # (F,) volume that each fluid is to have [m^2]
    end: Moved  # what is left of the step when its mesh is repaired
    moved: Particles  # the particles before the repair
    moved_mesh: Mesh  # their mesh, without empty space
    relocated: Array  # (N',) mask of the particles that the repair relocated, or are new
    # boundary, reference, fixed, material, mass, memory: of the next state
    boundary: Boundary
    reference: int
    fixed: Array
    material: Any
    mass: Array
    memory: EnergyMemory
    stored: float = 0.0  # energy of the parts then [J]
    kept: float = 0.0  # see `tipfem.physics.physics.Moved`
    spray: Spray | None = None  # the particles in no cell, where there is empty space; else None
    renumbered: Array | None = None  # (N,) new number of each particle, -1 for those removed; None if no number changes
    relabelled: Relabelled | None = None  # sides of the cells that changed their fluid; None for none

    @classmethod
    def of(cls: type[Self], solved: Solved, rules: Rules, account: NoAccount) -> Self:
        """A remeshing that begins, with all as it was before the step but what the solve has found."""
        before = solved.before
        return cls(
            rules,
            account,
            solved,
            solved.particles,
            before.mesh,
            dict(solved.parts),
            before.wanted_volume,
            end=Moved(before.particles, before.boundary, solved.particles, before.mesh, solved.time, solved.dt),
            moved=solved.particles,
            moved_mesh=before.mesh,
            relocated=np.zeros(len(solved.particles), dtype=bool),
            boundary=before.boundary,
            reference=before.reference,
            fixed=before.fixed,
            material=before.material,
            mass=before.mass,
            memory=before.memory,
        )

    def with_(self: Self, **changes: Any) -> Self:
        """A remeshing with some attributes changed."""
        new = object.__new__(type(self))  # dataclasses.replace takes as long as a stage
        new.__dict__.update(self.__dict__, **changes)
        return new

    @property
    def before(self) -> State:
        """The state at the start of the step."""
        return self.solved.before

    def part(self, physics: Physics[Any]) -> Any:
        """Carried part of a physics; None for nothing."""
        return self.parts.get(physics.name)
