"""Remeshers: from a solved step to the next state, one for each interface rule.

All that depends on the interface rule is in a remesher: how particles are meshed, the properties of the elements,
whether it keeps the fluids' volumes, and velocities and walls after remeshing. `tipfem.remesh.choice` chooses one.
"""

from __future__ import annotations

import dataclasses
import warnings
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from tipfem.case.boundary.boundary import Boundary
from tipfem.case.case import Case
from tipfem.case.fluid import Fluid, ranks
from tipfem.case.grading import Grading
from tipfem.case.mesh_file import MeshTank
from tipfem.case.numerics import FittedRule, RelocationRule, SurfaceRule
from tipfem.case.particles import Particles
from tipfem.case.region import Filling
from tipfem.errors import StartWarning, TriangulationError
from tipfem.mesh.constrained import without_crossings
from tipfem.mesh.delaunay import triangulate, wall_fluid
from tipfem.mesh.free_surface import Filled, SurfaceMesher, filled_cells, spray_volumes
from tipfem.mesh.interface import InterfaceRule, InterpolatedInterface, SharpInterface
from tipfem.mesh.mesh import Mesh
from tipfem.physics.carried import Carried, Remap, sliding
from tipfem.physics.physics import Physics
from tipfem.physics.registry import physics_of
from tipfem.physics.state import InterpolatedMaterial, Material, SharpMaterial, Solved, State, lumped
from tipfem.remesh import drops, surface_volumes
from tipfem.remesh.energy_balance import EnergyBalance
from tipfem.remesh.meshers import FreeSurfaceMesher, Mesher, TankMesher
from tipfem.remesh.momentum_transfer import conserve_along_period, nodal_density, transfer_momentum
from tipfem.remesh.parts import carried, imposed
from tipfem.remesh.relocation import relocate
from tipfem.remesh.repair_account import INTERPOLATED, SHARP, NoAccount
from tipfem.remesh.stages.order import STAGES
from tipfem.remesh.stages.remeshing import Remeshing, Rules
from tipfem.remesh.triangles import empty_space
from tipfem.remesh.triangles.fitted import hull_corners, particle_fluid, refined, with_fluids
from tipfem.remesh.volumes import with_components
from tipfem.timers import timer
from tipfem.typing import Array

OUTSET = 1e-6  # of the differences for rates that are prescribed at the start [s]


class Remesher(ABC):
    """Makes the first state, and the next one from a solved step.

    ``interface`` is the rule for the properties of elements between fluids, ``keeps_volumes`` whether remeshing
    restores those of the fluids, so that no source is needed; ``repairs`` are kinds of repair, and ``account`` is of
    what each adds in the last remeshing, with a detailed budget. The first mesh has a ``filling``, None if nobody can
    say.
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
        """The first state, with what ``parts`` the physics carry before there is a mesh.

        The pressure of a closed tank is zero at the particle ``reference``; -1 for none. `TriangulationError` if the
        particles cannot be meshed.
        """

    @abstractmethod
    def first_volume(self, particles: Particles, boundary: Boundary) -> float:
        """Volume of all fluids in the first state [m^2, or m^3 in 3-D], found without Taichi; see `start`."""

    @abstractmethod
    def remesh(self, solved: Solved) -> State:
        """The state after a step; `TriangulationError` if the particles cannot be meshed."""

    @abstractmethod
    def with_drop(self, state: State, at: Array, radius: float, fluid: int, acceleration: Array) -> State:
        """A state with a drop of a fluid added, see `tipfem.Drop`; the volumes of the start change with it.

        In empty space it begins to fall with the acceleration; `ValueError` if there is no room for it.
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
            (number, there, asked), unit = found, "m^3" if mesh.period.axial or mesh.dimension == 3 else "m^2"
            warnings.warn(
                f"{self.fluids[number].name!r} begins with {there:.3g} {unit}, but {asked:.3g} {unit} are filled in: "
                f"what is thinner than the spacing, {spacing:g} m, is left out, and faces are flat from particle to "
                "particle; choose a smaller one, or other faces",
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

    def _through(self, stages: Sequence[Callable[[Any], Any]], done: Remeshing) -> State:
        """The state at the end of a remeshing's stages."""
        for stage in stages:
            done = stage(done)
        return self._ended(
            done.solved,
            done.particles,
            done.mesh,
            done.material,
            done.mass,
            boundary=done.boundary,
            reference=done.reference,
            fixed=done.fixed,
            relocated=done.relocated,
            relocations=int(np.count_nonzero(done.relocated)),
            parts=done.parts,
            memory=done.memory,
            wanted_volume=done.wanted,
        )

    def _state(self, particles: Particles, mesh: Mesh, material: Material, mass: Array, **others: Any) -> State:
        """A state from the lumped ``mass`` (N,) of its elements; ``others`` are further attributes."""
        # A mesh that was made without it would be planar, and nothing else would tell.
        assert "boundary" not in others or mesh.period == others["boundary"].period
        volume = material.volumes(mesh.measure) + spray_volumes(mesh, particles.fluid, len(self.fluids))
        if mesh.surface.loose.any():
            mass = mass + self.density[particles.fluid] * mesh.surface.volume
        others = {"wanted_volume": volume, "grid_box": np.full((2, mesh.dimension), np.nan), **others}
        return State(particles=particles, mesh=mesh, material=material, mass=mass, volume=volume, **others)


class DelaunayRemesher(Remesher):
    """Relocation fluid by fluid, and a new Delaunay triangulation (Carvalho & Sanches).

    ``momentum_transfer``: whether momentum is transferred to particles that became heavier.
    """

    interface = InterpolatedInterface()
    keeps_volumes = False
    repairs = INTERPOLATED

    def __init__(
        self,
        fluids: Sequence[Fluid],
        rule: RelocationRule,
        mesher: Mesher,
        *,
        momentum_transfer: bool = True,
        physics: Sequence[Physics[Any]] = (),
        filling: Filling | None = None,
    ) -> None:
        super().__init__(fluids, physics, filling)
        # Of one fluid with a free surface; what two of them exchange is left to the source.
        self.keeps_volumes = isinstance(mesher, FreeSurfaceMesher) and len(fluids) == 1
        self.rule, self.mesher, self.momentum_transfer = rule, mesher, momentum_transfer

    @staticmethod
    def of(case: Case) -> DelaunayRemesher:
        """The remesher of a case."""
        numerics = case.numerics
        if not case.free_surface:
            mesher: Mesher = TankMesher(repairs=numerics.triangulation == "repair")
        else:
            mesher = FreeSurfaceMesher(SurfaceMesher(numerics.surface, case.filled))
        return DelaunayRemesher(
            case.fluids,
            numerics.relocation,
            mesher,
            momentum_transfer=numerics.momentum_transfer,
            physics=physics_of(case),
            filling=case.filling,
        )

    def start(
        self, particles: Particles, boundary: Boundary, reference: int, parts: Mapping[str, Carried] | None = None
    ) -> State:
        """See `Remesher.start`."""
        mesh = self.mesher.start(particles, boundary)
        particles = self._labelled(particles, mesh)
        nowhere = np.zeros(len(particles), dtype=bool)
        parts, particles = carried(self._physics, parts or {}, particles, Remap.none(mesh))
        material, mass = self._material(particles, mesh)
        if mesh.dimension == 2 and not mesh.surface.exists:
            self._warn_of_misfit(mesh, particles.spacing, material.fraction, np.zeros(len(mesh.cells), dtype=bool))
        return self._state(
            particles,
            mesh,
            material,
            mass,
            time=0.0,
            step=0,
            boundary=boundary,
            reference=reference,
            fixed=nowhere,
            relocated=nowhere,
            parts=parts,
        )

    def first_volume(self, particles: Particles, boundary: Boundary) -> float:
        """See `Remesher.first_volume`."""
        mesh = self.mesher.start(particles.copy(), boundary)
        return float(mesh.measure.sum() + mesh.surface.spray.sum())

    @timer("remeshing")
    def remesh(self, solved: Solved) -> State:
        """See `Remesher.remesh`."""
        self.account.start(solved)
        solved = surface_volumes.balanced(solved) if solved.before.mesh.surface.exists else solved
        before, walls, account = solved.before, solved.walls, self.account
        convex = before.boundary.convex and before.mesh.surface.exists
        start = surface_volumes.kept_inside(solved.particles) if convex else solved.particles
        with timer("relocation"):
            stopped = before.boundary.stopped(start, before.mesh.surface.loose, solved.time)
            for physics in self._physics:
                stopped = physics.stopped(solved.parts.get(physics.name), stopped, before.mesh.surface.loose)
            particles, moves = relocate(stopped, before.mesh, self.rule)
            particles, of_walls = walls.space(particles, before.mesh)
            particles = imposed(solved.parts, particles)
        with timer("triangulation"):
            mesh, rebuilt = self.mesher.remesh(solved, particles, moves)
        if account.columns:
            labelled = self._labelled(particles, mesh)
            account.add("triangulation", labelled, mesh, self._material(labelled, mesh)[0])
        relocated = (particles.position != start.position).any(axis=1)
        kept = None
        if before.mesh.surface.exists or mesh.surface.exists:
            with timer("volumes"):
                kept = surface_volumes.carried_through(
                    solved, start, surface_volumes.leave(mesh, start.wall, relocated)
                )
                mesh = surface_volumes.restore_volumes(mesh, particles.wall, kept.volume, particles.spacing)
                particles = particles.shallow_copy(position=mesh.position)
        particles = self._labelled(particles, mesh)
        material, mass = self._material(particles, mesh)
        if kept is not None:
            particles = surface_volumes.with_momenta(solved, kept, particles, mesh, material.density, mass)
        account.add("volumes", particles, mesh, material)
        if self.momentum_transfer:
            assert isinstance(before.material, InterpolatedMaterial)
            around = np.where(relocated, np.nan, before.material.nodal_density)
            particles = transfer_momentum(particles, mesh, around, material.nodal_density, before.boundary.still)
            account.add("transfer", particles, mesh, material)
        remap = Remap(before.mesh, mesh, None, relocated, solved.force[:1] if solved.uniform else solved.force)
        parts, particles = carried(self._physics, solved.parts, particles, remap)
        particles = imposed(parts, walls.imposed(particles))
        return self._ended(
            solved,
            conserve_along_period(solved, particles, mass, parts),
            mesh,
            material,
            mass,
            boundary=before.boundary,
            reference=before.reference,
            fixed=before.fixed,
            relocated=relocated,
            relocations=len(moves) + of_walls,
            rebuilt=before.rebuilt + rebuilt,
            parts=parts,
        )

    def with_drop(self, state: State, at: Array, radius: float, fluid: int, acceleration: Array) -> State:
        """See `Remesher.with_drop`: particles change their fluid, or in empty space are added."""
        particles, mesh, names = state.particles, state.mesh, [f.name for f in self.fluids]
        drops.require_walls(mesh)
        if drops.is_inside(mesh, at):
            near = drops.within(particles, at, radius)
            if mesh.surface.front[near].any():
                raise ValueError(
                    f"drop: at {drops.place(at)} m, of radius {radius:g} m it would reach the free surface"
                )
            drops.require_room(particles, near, particles.fluid[near], at, radius, fluid, names)
            in_drop = np.linalg.norm(particles.position - at, axis=1) < radius
            particles = particles.shallow_copy(fluid=np.where(in_drop, fluid, particles.fluid).astype(np.int32))
            return self._changed(state, particles, mesh, *self._material(particles, mesh))
        drops.require_empty(particles, mesh.surface, at, radius)
        particles, mesh = drops.with_disc(particles, mesh, at, radius, fluid, acceleration)
        return self._with_more(state, particles, mesh, acceleration)

    def _labelled(self, particles: Particles, mesh: Mesh) -> Particles:
        """The particles, with fluids for wall particles, and zero pressure at a free surface."""
        particles = particles.shallow_copy(fluid=wall_fluid(mesh, particles.fluid, particles.wall))
        if mesh.surface.pinned.any():
            particles = particles.shallow_copy(pressure=np.where(mesh.surface.pinned, 0.0, particles.pressure))
        return particles

    def _material(self, particles: Particles, mesh: Mesh) -> tuple[InterpolatedMaterial, Array]:
        """Material of the elements, and the lumped masses (N,) [kg]."""
        density, viscosity = self.interface.element_properties(mesh, particles.fluid, self.fluids)
        mass = lumped(mesh, density)
        around = nodal_density(mass, lumped(mesh, np.ones(len(density))))
        fraction = self.interface.fluid_fraction(mesh, particles.fluid, len(self.fluids))
        factor = surface_volumes.mass_factor(mesh)
        if factor is not None:
            density = factor * density
            mass = lumped(mesh, density)
        return InterpolatedMaterial(density, viscosity, fraction, around), mass


class FittedRemesher(Remesher):
    """Triangles that keep their fluid, repaired in place; see `fitted`.

    If ``walls_have_fluids``, the first particles' labels hold on the walls, too; if ``keep``, every remeshing restores
    the volumes that the fluids started with, else those before it. Target spacings have a ``grading``, else they are
    the same everywhere with a constant number of particles. ``first`` has cells and fluids of the first mesh;
    ``balance`` keeps the energy in each remeshing; ``surface`` is what fluids are under a free surface, and where at
    the start.
    """

    interface = SharpInterface()
    keeps_volumes = True
    repairs = SHARP

    def __init__(
        self,
        fluids: Sequence[Fluid],
        rule: FittedRule,
        *,
        walls_have_fluids: bool,
        keep: bool,
        grading: Grading | None = None,
        first: tuple[Array, Array] | None = None,
        physics: Sequence[Physics[Any]] = (),
        balance: EnergyBalance | None = None,
        surface: tuple[SurfaceRule, Filled | None] | None = None,
        filling: Filling | None = None,
    ) -> None:
        super().__init__(fluids, physics, filling)
        self._surface = surface
        self.rule, self._balance = rule, balance
        self._first, self._names = first, [f.name for f in fluids]
        self._keep, self._walls_have_fluids, self._grading = keep, walls_have_fluids, grading

    @staticmethod
    def of(case: Case) -> FittedRemesher:
        """The remesher of a case."""
        return FittedRemesher(
            case.fluids,
            case.numerics.fitting,
            walls_have_fluids=case.walls_have_fluids,
            keep=case.numerics.volume_correction > 0,
            grading=case.grading,
            first=case.tank.first_cells(case.fluids) if isinstance(case.tank, MeshTank) else None,
            physics=physics_of(case),
            balance=EnergyBalance.of(case, passed=any(physics.open for physics in physics_of(case))),
            surface=(case.numerics.surface, case.filled) if case.free_surface else None,
            filling=case.filling,
        )

    def _first_mesh(self, particles: Particles, boundary: Boundary) -> tuple[Mesh, Array | None]:
        """Triangles of the first particles, and the mask of those that are fluid; None without a free surface."""
        if self._first is None:
            edges = boundary.edges(particles, 0.0)
            mesh = triangulate(particles.position, particles.wall, particles.spacing, edges, boundary.period)
            if self._filling is not None and not boundary.period:
                box = np.stack([mesh.position.min(axis=0), mesh.position.max(axis=0)])
                part = self._filling.part(mesh.position, particles.spacing, box)
                cells = without_crossings(mesh.position, mesh.cells, mesh.neighbours, part)
                mesh = Mesh(mesh.position, cells, period=mesh.period)
        else:
            mesh = Mesh(particles.position, self._first[0], period=boundary.period)
        return mesh, filled_cells(mesh, particles, *self._surface) if self._surface is not None else None

    def first_volume(self, particles: Particles, boundary: Boundary) -> float:
        """See `Remesher.first_volume`."""
        mesh, filled = self._first_mesh(particles, boundary)
        if filled is None:
            return float(mesh.measure.sum())
        alone = ~particles.wall
        alone[mesh.cells[filled]] = False
        rings = mesh.period.radius(particles.position[alone])
        return float(mesh.measure[filled].sum() + rings.sum() * particles.spacing**2)

    def start(
        self, particles: Particles, boundary: Boundary, reference: int, parts: Mapping[str, Carried] | None = None
    ) -> State:
        """See `Remesher.start`; a triangle belongs to the lightest fluid among its particles'."""
        mesh, filled = self._first_mesh(particles, boundary)
        if filled is not None:
            particles = particles.shallow_copy(fluid=np.maximum(particles.fluid, 0).astype(np.int32))
        if not self._walls_have_fluids:
            particles = particles.shallow_copy(fluid=wall_fluid(mesh, particles.fluid, particles.wall))
        if self._first is None:
            mesh = with_fluids(mesh, particles, self.rank)
        else:
            mesh = Mesh(mesh.position, mesh.cells, self._first[1], period=mesh.period)
        if filled is not None:
            mesh = mesh.relabelled(np.where(filled, np.asarray(mesh.fluid), len(self.rank)).astype(np.int32))
        fluid, beside = np.asarray(mesh.fluid), mesh.neighbours
        faces = ((beside >= 0) & (fluid[beside] != fluid[:, None])).any(axis=1)
        self._warn_of_misfit(mesh, particles.spacing, np.eye(len(self.rank) + 1)[fluid], faces)
        for physics in self._physics:
            mesh = physics.flooded((parts or {}).get(physics.name), mesh, boundary, mesh.position, OUTSET)
        if filled is None:
            mesh = with_components(mesh, len(self.rank))
        else:
            filled = np.asarray(mesh.fluid) < len(self.rank)
        there = np.asarray(mesh.fluid) if filled is None else particles.fluid[~particles.wall]
        absent = np.setdiff1d(np.arange(len(self.density)), there)
        if len(absent):
            raise TriangulationError(
                f"fluid {self._names[absent[0]]!r} fills no triangle; it is not in the tank, or its part is too small "
                f"for a spacing of {particles.spacing:g} m"
            )
        fixed = hull_corners(mesh)
        if filled is not None:
            count = len(self.density)
            whole = with_components(empty_space.beyond(mesh.only(filled), mesh.cells[~filled], count), count + 1)
            alone = particles.spacing**2 * mesh.period.radius(particles.position)
            mesh = empty_space.without(whole, particles.wall, count, alone)
        fixed[boundary.index[boundary.slides]] = False  # which slide on curves
        fixed[sliding(parts or {}, len(fixed))] = False
        fixed[reference] |= reference >= 0
        if boundary.passages is not None:
            fixed[boundary.passages.ends] = True
        particles = particles.shallow_copy(
            fluid=particle_fluid(mesh, len(particles), self.rank),
            target=np.full(len(particles), float(particles.spacing)),
        )
        particles = self._rules.graded(particles, mesh, {})
        parts, particles = carried(self._physics, parts or {}, particles, Remap.none(mesh))
        for physics in self._physics:
            particles = physics.imposed(parts.get(physics.name), particles, boundary, 0.0, OUTSET)
        return self._state(
            particles,
            mesh,
            *self._material(particles, mesh),
            time=0.0,
            step=0,
            boundary=boundary,
            reference=reference,
            fixed=fixed,
            relocated=np.zeros(len(particles), dtype=bool),
            parts=parts,
        )

    @timer("remeshing")
    def remesh(self, solved: Solved) -> State:
        """See `Remesher.remesh`: the `STAGES`."""
        if solved.before.mesh.surface.empty is not None:
            solved = surface_volumes.balanced(solved)
        self.account.start(solved)
        return self._through(STAGES, Remeshing.of(solved, self._rules, self.account))

    def with_drop(self, state: State, at: Array, radius: float, fluid: int, acceleration: Array) -> State:
        """See `Remesher.with_drop`: cells change their fluid, and the drop's outline is moved onto its circle.

        In empty space it has particles and cells of its own.
        """
        if state.mesh.surface.empty is not None and not drops.is_inside(state.mesh, at):
            return self._with_disc(state, at, radius, fluid, acceleration)
        if self._grading is not None:
            state = self._refined(state, at, radius, acceleration, self._grading.growth)
        particles, mesh = drops.with_fluid_in_circle(state.particles, state.mesh, at, radius, fluid, self._names)
        mesh = with_components(mesh, len(self.density))
        particles = particles.shallow_copy(fluid=particle_fluid(mesh, len(particles), self.rank))
        remap = Remap(state.mesh, mesh, None, np.zeros(len(particles), dtype=bool), acceleration[None])
        parts, particles = carried(self._physics, state.parts, particles, remap)
        return self._changed(state, particles, mesh, *self._material(particles, mesh), parts=parts)

    def _refined(self, state: State, at: Array, radius: float, acceleration: Array, growth: float) -> State:
        """A state of the same time in which a circle is resolved, see `with_drop`."""
        particles, mesh = state.particles, state.mesh
        off = np.abs(np.linalg.norm(particles.position - at, axis=1) - radius)
        finer = particles.shallow_copy(target=np.minimum(particles.target, particles.spacing + growth * off))
        new, finer_mesh = refined(finer, mesh, self.density, self.rule)
        if len(new) == len(particles):
            return state
        new = new.shallow_copy(fluid=particle_fluid(finer_mesh, len(new), self.rank))
        whole = dataclasses.replace(finer_mesh, surface=mesh.surface.longer(len(new)))
        return self._with_more(state, new, whole.with_(neighbours=finer_mesh.neighbours), acceleration)

    def _with_disc(self, state: State, at: Array, radius: float, fluid: int, acceleration: Array) -> State:
        """`with_drop` in empty space."""
        empty, count = state.mesh.surface.empty, len(self.density)
        assert empty is not None
        drops.require_walls(state.mesh)
        drops.require_empty(state.particles, state.mesh.surface, at, radius)
        particles, mesh = drops.with_disc(state.particles, state.mesh, at, radius, fluid, acceleration)
        added = np.full(len(mesh.cells) - len(state.mesh.cells), fluid, dtype=np.int32)
        mesh = dataclasses.replace(mesh, fluid=np.append(np.asarray(state.mesh.fluid), added))
        cells = empty_space.around(mesh, empty, len(state.particles), particles.spacing)
        whole = with_components(empty_space.beyond(mesh, cells, count), count + 1)
        mesh = empty_space.without(whole, particles.wall, count, mesh.surface.volume)
        return self._with_more(state, particles, mesh, acceleration)

    def _material(self, particles: Particles, mesh: Mesh) -> tuple[SharpMaterial, Array]:
        """See `Remesher._material`."""
        return self._rules.material(mesh)

    @property
    def _rules(self) -> Rules:
        """By the fluids as they are now."""
        return Rules(self.fluids, self._physics, self.rule, self._keep, self._grading, self._balance)
