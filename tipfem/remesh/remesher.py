"""Remesher: what makes the first state of a simulation, and the next one from a solved step."""

from __future__ import annotations

import dataclasses
import warnings
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from tipfem.case.boundary.boundary import Boundary
from tipfem.case.fluid import Fluid, ranks
from tipfem.case.particles import Particles
from tipfem.case.region import Filling
from tipfem.errors import StartWarning
from tipfem.mesh.free_surface import spray_volumes
from tipfem.mesh.interface import InterfaceRule
from tipfem.mesh.mesh import Mesh
from tipfem.physics.carried import Carried, Remap
from tipfem.physics.physics import Physics
from tipfem.physics.state import Material, Solved, State
from tipfem.remesh import drops
from tipfem.remesh.parts import carried
from tipfem.remesh.repair_account import NoAccount
from tipfem.typing import Array


class Remesher(ABC):
    """Makes the first state, and the next one from a solved step.

    Args:
        fluids: of the case.
        physics: of the case.
        filling: what the first mesh is to be filled with; None if nobody can say.

    Attributes:
        interface: the rule for the properties of elements between fluids.
        keeps_volumes: whether remeshing restores the volumes of the fluids, so that no source is needed.
        repairs: kinds of repair, see `RepairAccount`.
        account: of what each of them adds in the last remeshing, with a detailed budget.
    """

    interface: InterfaceRule
    keeps_volumes: bool
    repairs: tuple[str, ...]
    account: NoAccount

    def __init__(
        self, fluids: Sequence[Fluid], physics: Sequence[Physics[Any]] = (), filling: Filling | None = None
    ) -> None:
        self.fluids, self.account, self._physics, self._filling = list(fluids), NoAccount(), physics, filling
        self.density, self.rank = np.array([f.density for f in fluids], dtype=float), ranks(fluids)

    @abstractmethod
    def start(
        self, particles: Particles, boundary: Boundary, reference: int, parts: Mapping[str, Carried] | None = None
    ) -> State:
        """The first state.

        Args:
            particles: the initial ones; they become the state's.
            boundary: of the case.
            reference: the particle at which the pressure of a closed tank is zero; -1 for none.
            parts: what the physics carry before there is a mesh; nothing by default.

        Raises:
            TriangulationError: the particles cannot be meshed.
        """

    @abstractmethod
    def first_volume(self, particles: Particles, boundary: Boundary) -> float:
        """Volume of all fluids in the first state [m^2, or m^3 in 3-D], found without Taichi; see `start`."""

    @abstractmethod
    def remesh(self, solved: Solved) -> State:
        """The state after a step.

        Raises:
            TriangulationError: the particles cannot be meshed.
        """

    @abstractmethod
    def with_drop(self, state: State, at: Array, radius: float, fluid: int, acceleration: Array) -> State:
        """A state with a drop of a fluid added, see `tipfem.Drop`; the volumes of the start change with it.

        Args:
            state: between two steps.
            at: (d,) centre of the drop [m].
            radius: of the drop [m].
            fluid: index of the fluid.
            acceleration: (d,) with which a drop in empty space begins to fall [m/s^2].

        Raises:
            ValueError: there is no room for it.
        """

    def _changed(self, state: State, particles: Particles, mesh: Mesh, *of_cells: Any, **others: Any) -> State:
        """A state of the same time with other particles, cells and their properties (material and masses)."""
        kept = {field.name: getattr(state, field.name) for field in dataclasses.fields(state)}
        for name in ("particles", "mesh", "material", "mass", "volume"):
            del kept[name]
        new = self._state(particles, mesh, *of_cells, **{**kept, **others})
        return dataclasses.replace(new, wanted_volume=state.wanted_volume + new.volume - state.volume)

    def _with_more(self, state: State, particles: Particles, mesh: Mesh, acceleration: Array) -> State:
        """A state of the same time with particles (N,) of which those after the state's are new."""
        before, count = len(state.particles), len(particles)
        remap = Remap(state.mesh, mesh, np.arange(before), np.arange(count) >= before, acceleration[None])
        parts, particles = carried(self._physics, state.parts, particles, remap)
        longer = {name: drops.longer(getattr(state, name), count) for name in ("fixed", "relocated")}
        boundary = drops.boundary_of_more(state.boundary, count)
        return self._changed(
            state, particles, mesh, *self._material(particles, mesh), boundary=boundary, parts=parts, **longer
        )

    def _warn_of_misfit(self, mesh: Mesh, spacing: float, share: Array, faces: Array) -> None:
        """Warn of a fluid that the first mesh has more or less of than was filled in; see `Filling.misfit`."""
        if self._filling is None:
            return
        found = self._filling.misfit(mesh.corners(), share, faces, mesh.measure, mesh.period)
        if found is not None:
            (number, there, asked), unit = found, "m^3" if mesh.period.axial else "m^2"
            warnings.warn(
                f"{self.fluids[number].name!r} begins with {there:.3g} {unit}, but {asked:.3g} {unit} are filled in: "
                f"what is thinner than the spacing, {spacing:g} m, is left out; choose a smaller one, or other faces",
                StartWarning,
                stacklevel=5,
            )

    @abstractmethod
    def _material(self, particles: Particles, mesh: Mesh) -> tuple[Material, Array]:
        """Material of the elements, and the lumped masses (N,) [kg]."""

    def _ended(self, solved: Solved, *values: Any, **others: Any) -> State:
        """The `_state` after a step's remeshing, with which its account ends."""
        step, wanted = solved.before.step + 1, {"wanted_volume": solved.before.wanted_volume}
        others = wanted | others | {"time": solved.time, "step": step, "grid_box": solved.grid_box}
        state = self._state(*values, impact=solved.impact, **others)
        self.account.add(self.repairs[-1], state.particles, state.mesh, state.material)
        return state

    def _state(self, particles: Particles, mesh: Mesh, material: Material, mass: Array, **others: Any) -> State:
        """A state from the lumped ``mass`` (N,) of its elements; ``others`` are further attributes."""
        # A mesh that was made without it would be planar, and nothing else would tell.
        assert "boundary" not in others or mesh.period == others["boundary"].period
        volume = material.volumes(mesh.measure) + spray_volumes(mesh, particles.fluid, len(self.fluids))
        if mesh.surface.loose.any():
            mass = mass + self.density[particles.fluid] * mesh.surface.volume
        others = {"wanted_volume": volume, "grid_box": np.full((2, mesh.dimension), np.nan), **others}
        return State(particles=particles, mesh=mesh, material=material, mass=mass, volume=volume, **others)
