"""CavityRemesher: tetrahedra that keep their fluid, repaired in place in rounds; see `tipfem.remesh.cavity`."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from tipfem.case.boundary.boundary import Boundary
from tipfem.case.case import Case
from tipfem.case.fluid import Fluid
from tipfem.case.particles import Particles
from tipfem.case.region import Filling
from tipfem.errors import TriangulationError
from tipfem.geometry.lattice import crossings
from tipfem.mesh.delaunay import triangulate, wall_fluid
from tipfem.mesh.interface import SharpInterface
from tipfem.mesh.mesh import Mesh
from tipfem.physics.carried import Carried, Remap
from tipfem.physics.physics import Physics
from tipfem.physics.registry import physics_of
from tipfem.physics.state import SharpMaterial, Solved, State, lumped
from tipfem.remesh import drops
from tipfem.remesh.cavity.arrays import WALL
from tipfem.remesh.cavity.balance import keep_momentum, restore_volumes, with_components
from tipfem.remesh.cavity.cavities import QUALITY, Cavities
from tipfem.remesh.parts import carried, imposed
from tipfem.remesh.remeshers import Remesher
from tipfem.remesh.repair_account import CAVITIES
from tipfem.timers import timer
from tipfem.typing import Array

AT_REST = 1e-6  # speed of particles at rest, relative to that of a fall through a spacing
CUTS = 4  # rounds in which edges that cross a face between fluids are cut


class CavityRemesher(Remesher):
    """Tetrahedra that keep their fluid, in tanks that are full.

    Args:
        fluids: of the case.
        keep: whether every remeshing restores the volumes that the fluids started with, or only those before that
            remeshing.
        film: height of films that break [spacings].
        walls_have_fluids: whether the first particles' labels hold on the walls, too.
        physics: of the case.
        filling: see `Remesher`.
    """

    interface = SharpInterface()
    keeps_volumes = True
    repairs = CAVITIES

    def __init__(
        self,
        fluids: Sequence[Fluid],
        *,
        keep: bool,
        film: float,
        walls_have_fluids: bool,
        physics: Sequence[Physics[Any]] = (),
        filling: Filling | None = None,
    ) -> None:
        super().__init__(fluids, physics, filling)
        self._keep, self._film, self._walls_have_fluids = keep, film, walls_have_fluids

    @staticmethod
    def of(case: Case) -> CavityRemesher:
        """The remesher of a case."""
        return CavityRemesher(
            case.fluids,
            keep=case.numerics.volume_correction > 0,
            film=case.numerics.fitting.thin_film,
            walls_have_fluids=case.walls_have_fluids,
            physics=physics_of(case),
            filling=case.filling,
        )

    def first_volume(self, particles: Particles, boundary: Boundary) -> float:
        """See `Remesher.first_volume`."""
        return float(triangulate(particles.position, particles.wall, particles.spacing).measure.sum())

    def start(
        self, particles: Particles, boundary: Boundary, reference: int, parts: Mapping[str, Carried] | None = None
    ) -> State:
        """See `Remesher.start`; a tetrahedron belongs to the fluid that is filled in around it.

        Edges from one fluid to another are cut where the face between them is; without a filling a tetrahedron belongs
        to the lightest fluid among its particles'.
        """
        mesh = triangulate(particles.position, particles.wall, particles.spacing)
        if self._filling is not None:
            mesh = mesh.relabelled(self._filling.fluid(mesh.centres()).astype(np.int32))
        else:
            fluid = particles.fluid
            if not self._walls_have_fluids:
                fluid = wall_fluid(mesh, fluid, particles.wall)
            mesh = mesh.relabelled(np.argsort(self.rank)[self.rank[fluid[mesh.cells]].min(axis=1)].astype(np.int32))
        cavities = self._cavities(mesh, particles, boundary, np.zeros(len(particles), dtype=bool))
        if (filling := self._filling) is not None:
            self._cut(cavities, filling.fluid, lambda x: filling.part(x, particles.spacing))
        cavities.run(*QUALITY[3])
        particles, mesh, number, _ = self._taken(cavities, particles)
        absent = np.setdiff1d(np.arange(len(self.fluids)), np.asarray(mesh.fluid))
        if len(absent):
            raise TriangulationError(
                f"fluid {self.fluids[absent[0]].name!r} fills no cell; it is not in the tank, or its part is too small "
                f"for a spacing of {particles.spacing:g} m"
            )
        nowhere = np.zeros(len(particles), dtype=bool)
        boundary = _renumbered(boundary, number, len(particles))
        parts, particles = carried(self._physics, parts or {}, particles, Remap.none(mesh))
        return self._state(
            particles,
            mesh,
            *self._material(particles, mesh),
            time=0.0,
            step=0,
            boundary=boundary,
            reference=int(number[reference]) if reference >= 0 else -1,
            fixed=nowhere,
            relocated=nowhere,
            parts=parts,
        )

    @timer("remeshing")
    def remesh(self, solved: Solved) -> State:
        """See `Remesher.remesh`."""
        self.account.start(solved)
        before, walls = solved.before, solved.walls
        moved = walls.imposed(imposed(solved.parts, walls.set_back(solved.particles)))
        mesh = before.mesh.moved(moved.position)
        if (mesh.measure <= 0).any():
            raise TriangulationError("a tetrahedron was inverted before it could be repaired")
        with timer("cavities"):
            fall = np.sqrt(np.linalg.norm(solved.force, axis=1).max() * moved.spacing)
            moves = np.linalg.norm(moved.velocity, axis=1) > AT_REST * fall
            cavities = self._cavities(mesh, moved, before.boundary, before.fixed, moves)
            cavities.repair(self._film)
        with timer("volumes"):
            total = before.wanted_volume if self._keep else before.material.volumes(before.mesh.measure)
            ranked = mesh.relabelled(self.rank[np.asarray(mesh.fluid)].astype(np.int32))
            repaired = cavities.x.copy()
            restore_volumes(ranked, cavities, total[np.argsort(self.rank)])
        with timer("momentum"):
            keep_momentum(cavities, repaired, ranked, _fields(moved), self.density[np.argsort(self.rank)])
        particles, mesh, number, relocated = self._taken(cavities, moved)
        if (mesh.measure <= 0).any():
            raise TriangulationError("a tetrahedron has no volume after the repair")
        force = solved.force[:1] if solved.uniform else solved.force
        remap = Remap(before.mesh, mesh, number, relocated, force)
        parts, particles = carried(self._physics, solved.parts, particles, remap)
        if before.boundary.active:
            particles, boundary = walls.reassign(particles, mesh, None)
        else:
            boundary = _renumbered(before.boundary, number, len(particles))
        fixed = np.zeros(len(particles), dtype=bool)
        fixed[number[before.fixed]] = True
        material, mass = self._material(particles, mesh)
        self.account.add("cavities", particles, mesh, material)
        return self._ended(
            solved,
            particles,
            mesh,
            material,
            mass,
            boundary=boundary,
            reference=int(number[before.reference]) if before.reference >= 0 else -1,
            fixed=fixed,
            relocated=relocated,
            relocations=int(np.count_nonzero(relocated)),
            parts=parts,
        )

    def with_drop(self, state: State, at: Array, radius: float, fluid: int, acceleration: Array) -> State:
        """See `Remesher.with_drop`: edges are cut by the sphere, and the cells in it change their fluid."""
        particles, mesh, names = state.particles, state.mesh, [f.name for f in self.fluids]
        near = drops.within(particles, at, radius)
        drops.require_room(particles, near, particles.fluid[near], at, radius, fluid, names)
        spacing, cavities = particles.spacing, self._cavities(mesh, particles, state.boundary, state.fixed)

        def inside(x: Array) -> Array:
            return np.asarray(((x - at) ** 2).sum(axis=1) < radius**2).astype(np.int32)

        def part(x: Array) -> Array:
            distance = np.linalg.norm(x - at, axis=1) - radius
            return np.where(np.abs(distance) < 1e-6 * spacing, -1, (distance < 0).astype(np.int32))

        self._cut(cavities, inside, part, fluid)
        cavities.run(*QUALITY[3])
        new, mesh, number, _ = self._taken(cavities, particles)
        remap = Remap(state.mesh, mesh, number, np.arange(len(new)) >= len(particles), acceleration[None])
        parts, new = carried(self._physics, state.parts, new, remap)
        boundary, fixed = _renumbered(state.boundary, number, len(new)), drops.longer(state.fixed, len(new))
        others = {"boundary": boundary, "parts": parts, "fixed": fixed}
        return self._changed(
            state, new, mesh, *self._material(new, mesh), relocated=drops.longer(state.relocated, len(new)), **others
        )

    def _cavities(
        self, mesh: Mesh, particles: Particles, boundary: Boundary, fixed: Array, moves: Array | None = None
    ) -> Cavities:
        """The mesh as cavities, whose labels are the ranks of the fluids; see `Cavities`.

        Particles of walls along which fluids slide are held in corners alone.
        """
        ranked = mesh.relabelled(self.rank[np.asarray(mesh.fluid)].astype(np.int32))
        wall, held = particles.wall, fixed | particles.wall
        held[boundary.index[boundary.slides]] = False
        held |= fixed
        return Cavities(ranked, held, particles.spacing, _fields(particles), moves, wall, boundary.planes)

    def _cut(
        self,
        cavities: Cavities,
        inside: Callable[[Array], Array],
        part: Callable[[Array], Array],
        fluid: int | None = None,
    ) -> None:
        """Cut edges that cross a face between parts of the tank, and label the cells by the part that they are in.

        Args:
            cavities: the mesh.
            inside: function of points (K, 3) [m] to the number (K,) of the part that they are in.
            part: the same, with -1 for points on faces up to round-off.
            fluid: of the cells in part 1, where those in part 0 keep theirs; None where a part is a fluid.
        """
        for _ in range(CUTS):
            used = np.flatnonzero(cavities.label >= 0)
            at = part(cavities.x)
            corner = at[cavities.cells[used]]
            mixed = used[(corner >= 0).any(axis=1) & (corner.max(axis=1) != _least(corner))]
            one, other = np.triu_indices(4, 1)
            ends = np.unique(np.sort(cavities.cells[mixed][:, [one, other]].transpose(0, 2, 1).reshape(-1, 2)), axis=0)
            ends = ends[(at[ends] >= 0).all(axis=1) & (at[ends[:, 0]] != at[ends[:, 1]])]
            if not len(ends):
                break
            start = cavities.x[ends[:, 0]]
            way = cavities.x[ends[:, 1]] - start
            if (cavities.insert(ends[:, 0], start + crossings(start, way, inside)[:, None] * way) < 0).all():
                break
        used = np.flatnonzero(cavities.label >= 0)
        corner = part(cavities.x)[cavities.cells[used]]
        high, low = corner.max(axis=1), _least(corner)
        middle = inside(cavities.x[cavities.cells[used]].mean(axis=1))
        number = np.where((high >= 0) & (high == low), high, middle)
        number = self.rank[number] if fluid is None else np.where(number == 1, self.rank[fluid], cavities.label[used])
        cavities.label[used] = number
        cavities.mark()

    def _taken(self, cavities: Cavities, particles: Particles) -> tuple[Particles, Mesh, Array, Array]:
        """Particles and mesh of a repair: the old ones in their order, then new ones.

        Returns:
            The particles (N'), the mesh, the new number (N,) of each old particle, -1 for those removed, and the mask
            (N',) of those that are new.
        """
        before = len(particles)
        there = cavities.marks != 0
        old = np.flatnonzero(there[:before] & ~cavities.is_new[:before])
        kept = np.concatenate([old, np.flatnonzero(there & cavities.is_new)])
        number = np.full(len(there), -1)
        number[kept] = np.arange(len(kept))
        raw = cavities.mesh()
        cells = np.ascontiguousarray(number[raw.cells].astype(np.int32))
        label = np.argsort(self.rank).astype(np.int32)[np.asarray(raw.fluid)]
        mesh = Mesh(np.ascontiguousarray(cavities.x[kept]), cells, label).with_(neighbours=raw.neighbours)
        mesh = with_components(mesh, len(self.fluids))
        d, fields = particles.dimension, cavities.fields[kept]
        fluid, wall = np.zeros(len(kept), dtype=np.int32), (cavities.marks[kept] & WALL) != 0
        for f in np.argsort(self.rank):
            fluid[cells[np.asarray(mesh.fluid) == f]] = f
        is_new = np.arange(len(kept)) >= len(old)
        taken = particles.shallow_copy(
            position=mesh.position,
            fluid=fluid,
            wall=wall,
            velocity=np.ascontiguousarray(fields[:, :d]),
            acceleration=np.ascontiguousarray(fields[:, d : 2 * d]),
            pressure=np.ascontiguousarray(fields[:, -1]),
            target=np.full(len(kept), float(particles.spacing)),
        )
        return taken, mesh, number[:before], is_new

    def _material(self, particles: Particles, mesh: Mesh) -> tuple[SharpMaterial, Array]:
        """See `Remesher._material`."""
        fluid = np.asarray(mesh.fluid)
        density, viscosity = self.interface.element_properties(mesh, fluid, self.fluids)
        return SharpMaterial(density, viscosity, fluid, len(self.fluids)), lumped(mesh, density)


def _fields(particles: Particles) -> Array:
    """(N, 7) velocities, accelerations and pressures of particles."""
    return np.concatenate([particles.velocity, particles.acceleration, particles.pressure[:, None]], axis=1)


def _least(corner: Array) -> Array:
    """The least part (M,) at corners (M, 4) that are on no face."""
    return np.asarray(np.where(corner >= 0, corner, np.iinfo(corner.dtype).max).min(axis=1))


def _renumbered(boundary: Boundary, number: Array, count: int) -> Boundary:
    """The same walls and wall particles under new numbers ``number`` (N,) among ``count`` particles."""
    new, there = copy.copy(boundary), number >= 0
    new.index = number[boundary.index]
    for name in ("still", "stays", "planes"):
        old = getattr(boundary, name)
        if old is not None:
            mask = np.zeros((count, *old.shape[1:]), dtype=bool)
            mask[number[there]] = old[there]
            setattr(new, name, mask)
    return new
