"""Remeshers: from particles that have moved to the mesh of the next step, one for each interface rule."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np

from tipfem.backend.launch import launch
from tipfem.case.case import Case
from tipfem.case.fluid import Fluid
from tipfem.case.grading import Grading
from tipfem.case.numerics import FittedRule, RelocationRule
from tipfem.case.particles import Particles
from tipfem.mesh.components import ON_INTERFACE
from tipfem.mesh.delaunay import TriangulationError, triangulate, wall_fluid
from tipfem.mesh.free_surface import SurfaceMesher
from tipfem.mesh.mesh import Mesh
from tipfem.remesh.delaunay_repair import repaired
from tipfem.remesh.fitted import hull_corners, particle_fluid, repair, with_fluids
from tipfem.remesh.relocation import relocate
from tipfem.remesh.sizing import limit_gradation
from tipfem.remesh.volumes import with_components
from tipfem.timers import timer
from tipfem.typing import Array
from tipfem.walls.step import WallStep


class Remeshed(NamedTuple):
    """Particles on a new mesh.

    Attributes:
        particles: the state.
        mesh: its simplices.
        relocated: (N,) which of them were set elsewhere, or are new.
        number: how many of those crowded others, or are new.
        renumbered: what number each particle of the mesh before has now, -1 for those that are gone; None if all have
            kept theirs.
    """

    particles: Particles
    mesh: Mesh
    relocated: Array
    number: int
    renumbered: Array | None = None


class Remesher(Protocol):
    """What a simulation asks of a remesher.

    Attributes:
        rebuilt: how many meshes, after the first, could not be had by repairing the last one.
    """

    rebuilt: int

    def start(self, particles: Particles) -> Remeshed:
        """The first mesh.

        Raises:
            TriangulationError: the particles cannot be meshed.
        """

    def remesh(self, particles: Particles, mesh: Mesh, walls: WallStep | None) -> Remeshed:
        """The mesh after a step, in which ``particles`` moved with ``mesh`` between ``walls``.

        Raises:
            TriangulationError: the particles cannot be meshed.
        """


class DelaunayRemesher:
    """Relocation fluid by fluid, and a new Delaunay triangulation (Carvalho & Sanches).

    Args:
        rule: of relocation.
        surface: what finds a free surface; None where walls surround the fluids.
        repairs: whether the last mesh is repaired where that can be done (see `delaunay_repair`), or every mesh made
            by Qhull. In 2-D and between walls only.
    """

    def __init__(self, rule: RelocationRule, surface: SurfaceMesher | None = None, *, repairs: bool = True) -> None:
        self.rule, self.surface, self.repairs = rule, surface, repairs
        self.rebuilt = 0

    def start(self, particles: Particles) -> Remeshed:
        """See `Remesher.start`."""
        if self.surface is None:
            mesh = triangulate(particles.position, particles.wall, particles.spacing)
        else:
            mesh = self.surface.start(particles)
        return self._labelled(particles, mesh, np.zeros(len(particles), dtype=bool), 0)

    def remesh(self, particles: Particles, mesh: Mesh, walls: WallStep | None) -> Remeshed:
        """See `Remesher.remesh`."""
        with timer("relocation"):
            state, moves = relocate(particles, mesh, self.rule)
            state, of_walls = walls.space(state, mesh.surface) if walls else (state, 0)
        relocated, moved = (state.position != particles.position).any(axis=1), mesh.moved(particles.position)
        with timer("triangulation"):
            if self.surface is not None:
                new = self.surface.remesh(state, moved, relocated)
            else:
                found = repaired(mesh, moved.position, state.position, moves) if self.repairs else None
                self.rebuilt += found is None
                new = found or triangulate(state.position, state.wall, state.spacing)
        return self._labelled(state, new, relocated, len(moves) + of_walls)

    def _labelled(self, particles: Particles, mesh: Mesh, relocated: Array, count: int) -> Remeshed:
        if mesh.surface is not None:
            particles.pressure = np.where(mesh.surface.pinned, 0.0, particles.pressure)
        particles.fluid = wall_fluid(mesh, particles.fluid, particles.wall)
        return Remeshed(particles, mesh, relocated, count)


class FittedRemesher:
    """Triangles that keep their fluid, repaired in place; see `fitted`.

    Args:
        fluids: of the case.
        fixed: indices of particles that must keep their place, as that of the pressure's reference.
        rule: when the triangulation is changed.
        walls_have_fluids: whether the first particles' labels hold on the walls, too.
        keep: whether every remeshing gives the fluids back the volumes they started with, not only those that
            it found.
        grading: of the target spacings; None where they are the same everywhere, and as many particles as at the start.
    """

    def __init__(
        self,
        fluids: Sequence[Fluid],
        fixed: Sequence[int],
        rule: FittedRule,
        *,
        walls_have_fluids: bool,
        keep: bool,
        grading: Grading | None = None,
    ) -> None:
        self.density = np.array([f.density for f in fluids])
        self._names = [f.name for f in fluids]
        self.rule = rule
        self._fixed_particles = list(fixed)
        self._fixed = np.zeros(0, dtype=bool)
        self._keep, self._walls_have_fluids, self._grading = keep, walls_have_fluids, grading
        self._volumes: Array | None = None
        self.rebuilt = 0

    def start(self, particles: Particles) -> Remeshed:
        """See `Remesher.start`; a triangle belongs to the lightest fluid among its particles'."""
        mesh = triangulate(particles.position, particles.wall, particles.spacing)
        if not self._walls_have_fluids:
            particles.fluid = wall_fluid(mesh, particles.fluid, particles.wall)
        mesh = with_fluids(mesh, particles, self.density)
        absent = np.setdiff1d(np.arange(len(self.density)), np.asarray(mesh.fluid))
        if len(absent):
            raise TriangulationError(
                f"fluid {self._names[absent[0]]!r} fills no triangle; it is not in the tank, or its part is too small "
                f"for a spacing of {particles.spacing:g} m"
            )
        self._fixed = hull_corners(mesh)
        self._fixed[self._fixed_particles] = True
        if self._keep:
            self._volumes = np.bincount(np.asarray(mesh.fluid), weights=mesh.measure, minlength=len(self.density))
        first = self._labelled(particles, mesh, np.zeros(len(particles), dtype=bool))
        particles.target = np.full(len(particles), float(particles.spacing))
        if self._grading:
            particles.target = self._targets(particles, mesh, self._grading)
        return first

    def remesh(self, particles: Particles, mesh: Mesh, walls: WallStep | None) -> Remeshed:
        """See `Remesher.remesh`."""
        fixed, slippery = self._fixed, None
        if walls:
            particles = walls.set_back(particles)
            boundary = walls.boundary
            fixed = fixed.copy()
            fixed[boundary.index[boundary.pinned]] = True
            slippery = np.zeros(len(fixed), dtype=np.int32)
            slippery[boundary.index[boundary.slides]] = 1
        if self._grading:
            with timer("grading"):
                particles = particles.shallow_copy(target=self._targets(particles, mesh, self._grading))
        state, mesh, relocated, renumbered = repair(
            particles,
            mesh,
            self.density,
            fixed,
            self.rule,
            slippery=slippery,
            total=self._volumes,
            graded=self._grading is not None,
        )
        if renumbered is not None:
            held = renumbered[self._fixed]
            self._fixed = np.zeros(len(state), dtype=bool)
            self._fixed[held] = True
        return self._labelled(state, mesh, relocated, renumbered)

    def _labelled(
        self, particles: Particles, mesh: Mesh, relocated: Array, renumbered: Array | None = None
    ) -> Remeshed:
        particles.fluid = particle_fluid(mesh, len(particles), self.density)
        return Remeshed(particles, mesh, relocated, int(relocated.sum()), renumbered)

    def _targets(self, particles: Particles, mesh: Mesh, grading: Grading) -> Array:
        """(N,) target spacings of the particles, which moved with a mesh [m]."""
        largest = grading.of_fluids(self._names, particles.spacing)
        components = with_components(mesh, len(self.density)).components
        assert components is not None
        at_interface = components.mark & ON_INTERFACE > 0
        target = grading.sizing(particles.position, particles.fluid, at_interface, largest, particles.spacing)
        lowered = np.zeros(len(target), dtype=np.int32)
        launch(limit_gradation, particles.position, mesh.cells, target, lowered, grading.growth)
        return target


def remesher_for(case: Case, reference: int) -> Remesher:
    """The remesher of a case's interface rule; ``reference`` is the particle at which pressure is fixed."""
    numerics = case.numerics
    if case.interface == "sharp":
        return FittedRemesher(
            case.fluids,
            [reference],
            numerics.fitting,
            walls_have_fluids=case.walls_have_fluids,
            keep=numerics.volume_correction > 0,
            grading=case.grading,
        )
    if case.closed:
        repairs = numerics.triangulation == "repair" and case.particles.dimension == 2
        return DelaunayRemesher(numerics.relocation, repairs=repairs)
    slippery = np.zeros(len(case.particles), dtype=bool)
    slippery[case.boundary.index[case.boundary.slides]] = True
    return DelaunayRemesher(numerics.relocation, SurfaceMesher(numerics.surface, slippery, case.filled))
