"""CavityRemesher: tetrahedra that keep their fluid, repaired in place in rounds; see `tipfem.remesh.cavity`.

Fluids are labelled by their density, from the lightest, 0. Under a free surface empty space is the lightest of all.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from tipfem.arguments import rounded
from tipfem.case.boundary.boundary import Boundary
from tipfem.case.case import Case
from tipfem.case.fluid import Fluid
from tipfem.case.grading import Grading
from tipfem.case.numerics import SurfaceRule
from tipfem.case.particles import Particles
from tipfem.case.region import Filling
from tipfem.errors import Invalid, TriangulationError
from tipfem.geometry.blocks import BlockedBox
from tipfem.geometry.lattice import crossings
from tipfem.geometry.period import no_period
from tipfem.geometry.place import along_curve
from tipfem.geometry.plane.domain import Domain
from tipfem.geometry.polyhedron import Polyhedron
from tipfem.mesh.delaunay import WHOLE, triangulate, wall_fluid
from tipfem.mesh.free_surface import filled_cells
from tipfem.mesh.interface import SharpInterface
from tipfem.mesh.mesh import Mesh, Surface, beyond_faces
from tipfem.physics.carried import Carried, Remap
from tipfem.physics.physics import Physics
from tipfem.physics.registry import physics_of
from tipfem.physics.state import SharpMaterial, Solved, State, lumped
from tipfem.physics.walls.step import WallsInStep
from tipfem.remesh import drops, surface_volumes
from tipfem.remesh.cavity.arrays import ON, SPLIT, SWAP, WALL
from tipfem.remesh.cavity.balance import Wanted, keep_momentum, restore_nearby, restore_volumes
from tipfem.remesh.cavity.cavities import FINE, QUALITY, Cavities, highest, measures, touching
from tipfem.remesh.cavity.empty_cells import NEXT, Slipping, extended, first_nodes, first_on_walls, followed
from tipfem.remesh.cavity.flight import Flight, settled, stopped
from tipfem.remesh.cavity.sheets import stop_flattening
from tipfem.remesh.parts import carried, imposed
from tipfem.remesh.remeshers import OUTSET, Remesher
from tipfem.remesh.repair_account import CAVITIES
from tipfem.remesh.target_spacing import GROWTH, film_targets, limited
from tipfem.remesh.volumes import with_components
from tipfem.timers import timer
from tipfem.typing import Array

AT_REST = 1e-6  # speed of particles at rest, relative to that of a fall through a spacing
FOUND = 4  # times that the targets of a first mesh are found
SORTED = 16  # steps after which cells are sorted by their places, if some have changed: so memory is read in order
CUTS = 4  # rounds in which edges that cross a face between fluids are cut


class CavityRemesher(Remesher):
    """Tetrahedra that keep their fluid.

    Args:
        keep: whether every remeshing restores the volumes that the fluids started with, or only those before that
            remeshing.
        film: height of films that break [spacings].
        walls_have_fluids: whether the first particles' labels hold on the walls, too.
        grading: of the target spacings; None for the same spacing everywhere.
        surface: what are fluids under a free surface, where nothing says what is filled; None for full tanks.
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
        grading: Grading | None = None,
        surface: SurfaceRule | None = None,
        physics: Sequence[Physics[Any]] = (),
        filling: Filling | None = None,
    ) -> None:
        super().__init__(fluids, physics, filling)
        self._keep, self._film, self._walls_have_fluids, self._grading = keep, film, walls_have_fluids, grading
        self._surface, self._open = surface, surface is not None
        # Label of each fluid, and of nothing; and fluid of each label.
        self._label = np.append(self.rank + 1, 0) if self._open else self.rank
        self._fluid = np.argsort(self._label).astype(np.int32)
        self._density = np.append(self.density, 0.0)[self._fluid]

    @staticmethod
    def of(case: Case) -> CavityRemesher:
        """The remesher of a case."""
        return CavityRemesher(
            case.fluids,
            keep=case.numerics.volume_correction > 0,
            film=case.numerics.fitting.thin_film,
            walls_have_fluids=case.walls_have_fluids,
            grading=case.grading,
            surface=case.numerics.surface if case.free_surface else None,
            physics=physics_of(case),
            filling=case.filling,
        )

    def first_volume(self, particles: Particles, boundary: Boundary) -> float:
        """See `Remesher.first_volume`."""
        mesh = self._first_mesh(particles, boundary)
        return float(mesh.measure @ (self._density[np.asarray(mesh.fluid)] > 0))

    def _first_mesh(self, particles: Particles, boundary: Boundary) -> Mesh:
        """Tetrahedra of the first particles, and of nodes in empty space, with the labels of what is filled in there.

        Without a filling a tetrahedron belongs to the lightest fluid among its particles', or is empty if large.
        """
        position, wall, fluid, empty = particles.position, particles.wall, particles.fluid, None
        there = np.arange(len(position))
        if self._open:
            assert isinstance(boundary.domain, Polyhedron)
            assert boundary.planes is not None
            given = particles.spacing, boundary.domain
            nodes, slides = first_nodes(position, fluid >= 0, *given), np.zeros(len(position), dtype=bool)
            slides[boundary.index[boundary.slides]] = self._grading is None and not _slopes(boundary)
            there = first_on_walls(position, fluid >= 0, boundary.planes & slides[:, None], *given)
            there = np.concatenate([there, len(position) + np.arange(len(nodes))])
            position, wall = np.concatenate([position, nodes]), drops.longer(wall, len(position) + len(nodes))
        mesh = _around_blocks(position[there], wall[there], particles.spacing, boundary.domain)
        if len(there) < len(position):
            mesh = Mesh(position, there[mesh.cells].astype(np.int32))
        if self._filling is not None:
            return mesh.relabelled(self._label[self._filling.fluid(mesh.centres())].astype(np.int32))
        if self._surface is not None:
            fluid = np.append(fluid, np.full(len(position) - len(fluid), -1))
            empty = ~filled_cells(
                mesh, particles.shallow_copy(position=position, wall=wall, fluid=fluid), self._surface, None
            )
            fluid = np.maximum(fluid, 0).astype(np.int32)
        if not self._walls_have_fluids:
            fluid = wall_fluid(mesh, fluid, wall)
        label = self._label[fluid][mesh.cells].min(axis=1)
        return mesh.relabelled((label if empty is None else np.where(empty, 0, label)).astype(np.int32))

    def start(
        self, particles: Particles, boundary: Boundary, reference: int, parts: Mapping[str, Carried] | None = None
    ) -> State:
        """See `Remesher.start`; edges from one fluid to another, or to nothing, are cut where the face is."""
        mesh = self._first_mesh(particles, boundary)
        # Before the cells settle: which edges rounds find depends on their order.
        order = np.argsort(along_curve(mesh.centres(), particles.spacing), kind="stable")
        mesh = Mesh(mesh.position, mesh.cells[order], np.asarray(mesh.fluid)[order])
        particles = particles.shallow_copy(fluid=np.maximum(particles.fluid, 0).astype(np.int32))
        nowhere = np.zeros(len(particles), dtype=bool)
        sloping = _slopes(boundary)
        cavities = self._cavities(mesh, particles, boundary, nowhere, free=sloping)
        if (filling := self._filling) is not None:
            box = np.stack([particles.position.min(axis=0), particles.position.max(axis=0)])
            left = self._cut(cavities, filling.fluid, lambda x: filling.part(x, particles.spacing, box))
            if sloping and len(left):
                text = f"{rounded(left[0])} m, as beside a corner; move it by half a spacing, or choose a smaller one"
                raise Invalid("tank", f": no cells fit between walls and the face of what is filled in at {text}")
        self._widen(cavities, particles)
        cavities.run(*QUALITY[3])
        raw = cavities.mesh()
        number, beside = self._fluid[np.asarray(raw.fluid)], raw.neighbours
        faces = ((beside >= 0) & (number[beside] != number[:, None])).any(axis=1)
        self._warn_of_misfit(raw, particles.spacing, np.eye(len(self._fluid))[number], faces)
        if self._open or self._grading is not None:  # the first nodes, and strides, are at no even distances
            stay = np.zeros(0, dtype=np.int32)
            if self._grading is None:
                wet = highest(cavities.cells, cavities.label, len(cavities.x)) > 0
                stay = np.flatnonzero(wet & (cavities.marks & WALL != 0)).astype(np.int32)
            for _ in range(FOUND):
                if not cavities.settle(stay) or self._grading is None:
                    break
                self._widen(cavities, particles)
        particles, mesh, number, _ = self._taken(cavities, particles, Flight(nowhere, np.zeros(len(nowhere)), nowhere))
        absent = np.setdiff1d(np.arange(len(self.fluids)), np.asarray(mesh.fluid))
        if len(absent):
            raise TriangulationError(
                f"fluid {self.fluids[absent[0]].name!r} fills no cell; it is not in the tank, or its part is too small "
                f"for a spacing of {particles.spacing:g} m"
            )
        nowhere = np.zeros(len(particles), dtype=bool)
        if boundary.active:
            boundary = boundary.reassigned(particles, boundary.pose(0.0, OUTSET), np.zeros(len(boundary.offset)))
        else:
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
        solved = surface_volumes.balanced(solved) if self._open else solved
        self.account.start(solved)
        before, walls = solved.before, solved.walls
        moved = walls.imposed(imposed(solved.parts, walls.set_back(solved.particles)))
        if self._open:
            moved = self._kept_in_tank(solved, moved)
        if (measures(moved.position, before.mesh.cells) <= 0).any():
            raise TriangulationError("a tetrahedron was inverted before it could be repaired")
        with timer("empty space"):
            moved, mesh = self._whole(before, moved, solved.walls)
        total = before.wanted_volume if self._keep else before.volume
        moved, mesh, flight, old = self._settled(before, moved, mesh, total)
        with timer("cavities"):
            fall = np.sqrt(np.linalg.norm(solved.force, axis=1).max() * moved.spacing)
            moves = np.linalg.norm(moved.velocity, axis=1) > AT_REST * fall
            cavities = self._cavities(mesh, moved, before.boundary, before.fixed, moves)
            fields = cavities.fields[: len(mesh.position)].copy()
            observed = self._observer(cavities, moved, flight)
            observed("landing")
            cavities.repair(self._film, solved.dt if self._open else 0.0)
            if self._open:
                _wet(cavities, _slipping(before, walls))
                observed("wetting")
        with timer("volumes"):
            restore_nearby(cavities, mesh, self._density)
            repaired = cavities.x.copy()
            restore_volumes(cavities, old, self._open)
            observed("volumes")
        with timer("momentum"):
            keep_momentum(cavities, repaired, mesh, fields, self._density)
            if self._open:
                stop_flattening(cavities, self._density, solved.dt)
        sort = cavities.changes > 0 and before.step % SORTED == SORTED - 1
        particles, mesh, number, relocated = self._taken(cavities, moved, flight, sort=sort)
        mesh = mesh.with_(measure=measures(mesh.position, mesh.cells))
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
        self.account.add("momentum", particles, mesh, material)
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

    def _observer(self, cavities: Cavities, particles: Particles, flight: Flight) -> Callable[[str], None]:
        """A function that books a kind of repair of the cavities, as their observer; of nothing without an account."""
        if not self.account.columns:
            return cavities.observer

        def observed(kind: str) -> None:
            there = np.flatnonzero(cavities.label > 0 if self._open else cavities.label >= 0)
            mesh = Mesh(cavities.x, cavities.cells[there], self._fluid[cavities.label[there]])
            self.account.add_mesh(kind, mesh, np.ascontiguousarray(cavities.fields[:, : cavities.dim]))

        self.account.flies(particles, flight.loose, flight.volume)
        cavities.observer = observed
        return observed

    def with_drop(self, state: State, at: Array, radius: float, fluid: int, acceleration: Array) -> State:
        """See `Remesher.with_drop`: edges are cut by the sphere, and the cells in it change their fluid."""
        state = self._refined(state, at, radius, acceleration)
        particles, mesh, names = state.particles, state.mesh, [f.name for f in self.fluids]
        (_, whole), falls = self._whole(state, particles), not drops.is_inside(mesh, at)
        if not falls:
            near = drops.within(particles, at, radius)
            front = bool(mesh.surface.front[near].any())
            drops.require_room(particles, near, particles.fluid[near], at, radius, fluid, names, at_surface=front)
        else:
            drops.require_empty(particles, mesh.surface, at, radius, drops.is_inside(whole, at))
        spacing, cavities = particles.spacing, self._cavities(whole, particles, state.boundary, state.fixed)

        def inside(x: Array) -> Array:
            return np.asarray(((x - at) ** 2).sum(axis=1) < radius**2).astype(np.int32)

        def part(x: Array) -> Array:
            distance = np.linalg.norm(x - at, axis=1) - radius
            return np.where(np.abs(distance) < 1e-6 * spacing, -1, (distance < 0).astype(np.int32))

        self._cut(cavities, inside, part, fluid)
        cavities.run(*QUALITY[3])
        return self._with_changes(state, cavities, acceleration, falls=falls)

    def _refined(self, state: State, at: Array, radius: float, acceleration: Array) -> State:
        """A state of the same time in which a sphere is resolved, see `with_drop`."""
        if self._grading is None and not self._open:
            return state
        _, whole = self._whole(state, state.particles)
        cavities = self._cavities(whole, state.particles, state.boundary, state.fixed)
        off = np.abs(np.linalg.norm(cavities.x - at, axis=1) - radius) / state.particles.spacing
        growth = GROWTH if self._grading is None else self._grading.growth
        cavities.wide = np.minimum(cavities.wide, 1.0 + growth * np.maximum(off - FINE, 0.0))
        cavities.settle(np.flatnonzero(cavities.marks & WALL), kinds=(SWAP, SPLIT))
        return self._with_changes(state, cavities, acceleration)

    def _with_changes(self, state: State, cavities: Cavities, acceleration: Array, *, falls: bool = False) -> State:
        """A state of the same time with what has changed in its mesh; new particles are at rest where they ``fall``."""
        particles, surface = state.particles, state.mesh.surface
        flight = Flight(surface.loose, surface.volume, np.zeros(len(particles), dtype=bool))
        new, mesh, number, _ = self._taken(cavities, particles, flight)
        if falls:
            added = np.arange(len(new)) >= len(particles)
            new.velocity[added], new.acceleration[added], new.pressure[added] = 0.0, acceleration, 0.0
        remap = Remap(state.mesh, mesh, number, np.arange(len(new)) >= len(particles), acceleration[None])
        parts, new = carried(self._physics, state.parts, new, remap)
        boundary, fixed = _renumbered(state.boundary, number, len(new)), drops.longer(state.fixed, len(new))
        others = {"boundary": boundary, "parts": parts, "fixed": fixed}
        return self._changed(
            state, new, mesh, *self._material(new, mesh), relocated=drops.longer(state.relocated, len(new)), **others
        )

    def _kept_in_tank(self, solved: Solved, particles: Particles) -> Particles:
        """Particles of dry walls go with these, and stop the surface and the spray."""
        before, surface = solved.before, solved.before.mesh.surface
        particles = solved.walls.carry(before.particles, particles, surface.dry(particles.wall))
        assert before.boundary.planes is not None
        may, domain = surface.front | surface.loose, before.boundary.domain
        blocks = domain if isinstance(domain, BlockedBox) else None
        return stopped(particles, may, solved.walls, before.boundary.planes, blocks)

    def _whole(self, state: State, particles: Particles, walls: WallsInStep | None = None) -> tuple[Particles, Mesh]:
        """The cells of fluids, and behind them those of empty space, labelled, where particles have moved to.

        And the particles, of which those of dry walls have slid along these before what comes.
        """
        mesh, surface = state.mesh, state.mesh.surface
        label = self._label[np.asarray(mesh.fluid)].astype(np.int32)
        if surface.empty is None or surface.nodes is None:
            moved = mesh.moved(particles.position, measures(particles.position, mesh.cells))
            return particles, moved.relabelled(label)
        count, fluids, beside = len(particles), len(mesh.cells), surface.beside
        empty = Mesh(np.concatenate([state.particles.position, surface.nodes]), surface.empty)
        if beside is not None:
            empty = empty.with_(neighbours=np.maximum(beside - fluids, -1))
        empty = followed(empty, particles.position, particles.spacing, _slipping(state, walls))
        x, among = empty.position, empty.neighbours
        particles = particles.shallow_copy(position=x[:count].copy())
        cells, label = np.concatenate([mesh.cells, empty.cells]), np.pad(label, (0, len(empty.cells)))
        among = np.concatenate([mesh.neighbours, np.where(among < 0, among, among + fluids)])
        whole = Mesh(x, cells, label).with_(measure=measures(x, cells))
        return particles, whole.with_(neighbours=beyond_faces(cells, among, len(x)))

    def _settled(
        self, before: State, particles: Particles, mesh: Mesh, total: Array
    ) -> tuple[Particles, Mesh, Flight, Wanted]:
        """Particles and mesh with the spray that has flown off or landed in the step, and what pieces are to have."""
        surface = before.mesh.surface
        flight = Flight(surface.loose, surface.volume, np.zeros(len(particles), dtype=bool))
        total = np.append(total - flight.by_fluid(particles.fluid, len(total)), 0.0) if self._open else total
        assert before.mesh.components is not None
        old = Wanted.of_mesh(mesh, total[self._fluid], empty=self._open, known=before.mesh.components.label)
        if self._open:
            label = self._label[particles.fluid]
            way = particles.position - before.particles.position
            mesh, particles, flight, old = settled(mesh, particles, label, flight, old, self._density, way)
        return particles, mesh, flight, old

    def _cavities(
        self,
        mesh: Mesh,
        particles: Particles,
        boundary: Boundary,
        fixed: Array,
        moves: Array | None = None,
        *,
        free: bool = False,
    ) -> Cavities:
        """A labelled mesh as cavities; see `Cavities`. Nodes of empty space are behind the particles.

        Particles of walls along which fluids slide, or of all if they are ``free``, are held in corners alone.
        """
        count, wall, planes = len(mesh.position), particles.wall, boundary.planes
        held = fixed | (wall & (not free))
        held[boundary.index[boundary.slides]] = False
        held |= fixed
        fields = _fields(particles)
        if count > len(particles):
            nothing = np.zeros((count - len(particles), fields.shape[1]))
            nodes = np.arange(len(particles), count, dtype=np.int32)
            around = Mesh(mesh.position, mesh.cells[np.asarray(mesh.fluid) == 0])  # all cells that have nodes
            fields = extended(around, np.concatenate([fields, nothing]), nodes, NEXT)
            fields[len(particles) :, -1] = 0.0
            held, wall = drops.longer(held, count), drops.longer(wall, count)
            moves = None if moves is None else drops.longer(moves, count)
            planes = None if planes is None else np.pad(planes, ((0, len(nothing)), (0, 0)))
        kinds = boundary.domain.kinds if isinstance(boundary.domain, Polyhedron) else None
        cavities = Cavities(mesh, held, particles.spacing, fields, moves, wall, planes, kinds)
        if self._grading is not None:
            self._widen(cavities, particles)
        elif self._open:
            # Contact lines at rest on sloping walls would move as these coarsen.
            cavities.coarsen_empty(walls=not _slopes(boundary))
        return cavities

    def _widen(self, cavities: Cavities, particles: Particles) -> None:
        """Set how far apart particles and nodes are to be by the grading; on dry walls as in the widest fluid."""
        if (grading := self._grading) is None:
            return
        rows, spacing = np.flatnonzero(cavities.marks), particles.spacing
        fine, cells = cavities.marks & ON > 0, cavities.cells[cavities.label >= 0]
        largest = grading.of_fluids([f.name for f in self.fluids], spacing)
        fluid = np.full(len(cavities.x), -1)
        for label in np.flatnonzero(self._density > 0):
            fluid[cavities.cells[cavities.label == label]] = self._fluid[label]
        size = grading.sizing(cavities.x[rows], fluid[rows], fine[rows], largest, spacing)
        cavities.wide[rows] = size
        if grading.film_resolution is not None:
            given = cavities.x, cavities.cells, cavities.across, cavities.label, self._density > 0, fine
            cavities.wide = film_targets(*given, cavities.wide, grading.film_resolution)
        cavities.wide = limited(cavities.x, cells, no_period(3), cavities.wide, grading.growth) / spacing

    def _cut(
        self,
        cavities: Cavities,
        inside: Callable[[Array], Array],
        part: Callable[[Array], Array],
        fluid: int | None = None,
    ) -> Array:
        """Cut edges that cross a face between parts of the tank, and label the cells by the part that they are in.

        Returns places (K, 3) of edges that could not be cut [m].


        ``inside`` returns it for points (K, 3), ``part`` -1 for those on faces. Cells in part 1 get ``fluid``, where
        those in part 0 keep theirs; None where a part is a fluid.
        """
        for _ in range(CUTS):
            used = np.flatnonzero(cavities.label >= 0)
            at = part(cavities.x)
            corner = at[cavities.cells[used]]
            mixed = used[(corner >= 0).any(axis=1) & (corner.max(axis=1) != _least(corner))]
            one, other = np.triu_indices(4, 1)
            ends = np.unique(np.sort(cavities.cells[mixed][:, [one, other]].transpose(0, 2, 1).reshape(-1, 2)), axis=0)
            ends = ends[(at[ends] >= 0).all(axis=1) & (at[ends[:, 0]] != at[ends[:, 1]])]
            start = cavities.x[ends[:, 0]]
            way = cavities.x[ends[:, 1]] - start
            sites = start + crossings(start, way, inside)[:, None] * way
            failed = cavities.insert(ends[:, 0], sites) < 0
            sites = np.asarray(sites[failed])
            if failed.all():
                break
        used = np.flatnonzero(cavities.label >= 0)
        corner = part(cavities.x)[cavities.cells[used]]
        high, low = corner.max(axis=1), _least(corner)
        middle = inside(cavities.x[cavities.cells[used]].mean(axis=1))
        number = np.where((high >= 0) & (high == low), high, middle)
        number = (
            self._label[number] if fluid is None else np.where(number == 1, self._label[fluid], cavities.label[used])
        )
        cavities.label[used] = number
        cavities.mark()
        return np.asarray(sites)

    def _taken(
        self, cavities: Cavities, particles: Particles, flight: Flight, *, sort: bool = False
    ) -> tuple[Particles, Mesh, Array, Array]:
        """Particles and mesh of a repair: the old ones in their order, then new ones. Corners of empty cells are nodes.

        Returns:
            The particles (N'), the mesh, the new number (N,) of each old particle, -1 for those removed, and the mask
            (N',) of those that are new.
        """
        before, raw = len(particles), cavities.mesh(empty=self._open, sort=sort)
        wall, label = (cavities.marks & WALL) != 0, np.asarray(raw.fluid)
        count = np.count_nonzero(label) if self._open else len(label)  # of the cells of fluids, the first ones
        used, dry, flies = np.zeros((3, len(wall)), dtype=bool)
        used[raw.cells[:count]] = True
        dry[raw.cells[count:]] = True
        flies[:before] = flight.loose & ~cavities.is_new[:before]
        stays, is_old = used | (wall & dry) | flies, ~cavities.is_new
        is_old[before:] = False
        old = np.flatnonzero(stays & is_old)
        kept = np.concatenate([old, np.flatnonzero(stays & ~is_old)])
        number, nodes = np.full(len(stays), -1, dtype=np.int32), np.flatnonzero(dry & ~stays)
        number[kept], number[nodes] = np.arange(len(kept)), len(kept) + np.arange(len(nodes))
        result = np.where(number[:before] < len(kept), number[:before], np.int32(-1))
        position, cells, neighbours = np.ascontiguousarray(cavities.x[kept]), number[raw.cells], raw.neighbours[:count]
        mesh = Mesh(position, cells[:count], self._fluid[label[:count]])
        if self._open:
            front, volume = np.zeros(len(stays), dtype=bool), np.zeros(len(stays))
            cell, i = np.divmod(np.flatnonzero(neighbours.ravel() >= count), 4)
            for k in (1, 2, 3):
                front[raw.cells[cell, (i + k) % 4]] = True
            volume[:before][flight.loose] = flight.volume[flight.loose]
            masks = front[kept], ~used[kept], flies[kept] & ~used[kept]
            beside, neighbours = raw.neighbours[count:], np.where(neighbours < count, neighbours, np.int32(-1))
            surface = Surface(*masks, volume[kept], np.zeros(len(kept)), cells[count:], cavities.x[nodes], beside)
            mesh = Mesh(position, mesh.cells, mesh.fluid, surface=surface)
        mesh = with_components(mesh.with_(neighbours=neighbours), len(self.fluids))
        d, fields = particles.dimension, cavities.fields[kept]
        rank = highest(mesh.cells, label[:count], len(kept))
        fluid = np.where(rank >= 0, self._fluid[rank], 0).astype(np.int32)
        flying = np.flatnonzero(flies[old] & (rank[: len(old)] < 0))
        fluid[flying] = particles.fluid[old[flying]]
        pressure = np.where(used[kept], fields[:, -1], 0.0)
        taken = particles.shallow_copy(
            position=mesh.position,
            fluid=fluid,
            wall=wall[kept],
            velocity=np.ascontiguousarray(fields[:, :d]),
            acceleration=np.ascontiguousarray(fields[:, d : 2 * d]),
            pressure=pressure,
            target=particles.spacing * cavities.wide[kept],
        )
        return taken, mesh, result, np.arange(len(kept)) >= len(old)

    def _material(self, particles: Particles, mesh: Mesh) -> tuple[SharpMaterial, Array]:
        """See `Remesher._material`."""
        fluid = np.asarray(mesh.fluid)
        density, viscosity = self.interface.element_properties(mesh, fluid, self.fluids)
        return SharpMaterial(density, viscosity, fluid, len(self.fluids)), lumped(mesh, density)


def _around_blocks(position: Array, wall: Array, spacing: float, domain: Domain | Polyhedron) -> Mesh:
    """Delaunay tetrahedra of points (N, 3) [m], without those in blocks; see `triangulate` for errors."""
    whole = domain.whole if isinstance(domain, Polyhedron) else None
    if not isinstance(domain, BlockedBox):
        return triangulate(position, wall, spacing, volume=whole)
    count, inner = len(position), domain.inner(spacing)
    wall = drops.longer(wall, count + len(inner))
    mesh = triangulate(np.concatenate([position, inner]), wall, spacing, volume=whole)
    there = ~domain.solid(mesh.centres())
    volume = float(mesh.measure[there].sum())
    if abs(volume / domain.volume - 1) > WHOLE or (mesh.cells[there] >= count).any():
        raise TriangulationError(
            f"tetrahedra around the blocks have {volume:.6g} m^3 where there are {domain.volume:.6g} m^3: they do not "
            "follow the blocks' faces; choose another spacing, or less jitter"
        )
    return Mesh(position, np.ascontiguousarray(mesh.cells[there]))


def _slopes(boundary: Boundary) -> bool:
    """Whether a wall is at right angles to no axis."""
    domain = boundary.domain
    return isinstance(domain, Polyhedron) and bool((np.abs(domain.normal).max(axis=1) < 1).any())


def _fields(particles: Particles) -> Array:
    """(N, 7) velocities, accelerations and pressures of particles."""
    return np.concatenate([particles.velocity, particles.acceleration, particles.pressure[:, None]], axis=1)


def _least(corner: Array) -> Array:
    """The least part (M,) at corners (M, 4) that are on no face."""
    return np.asarray(np.where(corner >= 0, corner, np.iinfo(corner.dtype).max).min(axis=1))


def _renumbered(boundary: Boundary, number: Array, count: int) -> Boundary:
    """The same walls and wall particles under new numbers ``number`` (N,) among ``count`` particles."""
    new, there = copy.copy(boundary), number >= 0
    new.index = number[boundary.index].astype(np.int64)
    for name in ("still", "stays", "planes"):
        old = getattr(boundary, name)
        if old is not None:
            mask = np.zeros((count, *old.shape[1:]), dtype=bool)
            mask[number[there]] = old[there]
            setattr(new, name, mask)
    return new


def _slipping(state: State, walls: WallsInStep | None) -> Slipping:
    """Particles of dry walls along which fluids slide; none without ``walls``."""
    domain, planes = state.boundary.domain, state.boundary.planes
    assert planes is not None
    assert isinstance(domain, Polyhedron)
    rows, along = np.zeros(0, dtype=np.int64), np.zeros((0, 3, 3))
    if walls is not None:
        dry = ~state.mesh.surface.used[walls.sliding]
        rows, along = walls.sliding[dry], walls.columns.reshape(-1, 3, 3)[dry]
    return Slipping(rows, along, planes, domain.kinds)


def _wet(cavities: Cavities, slipping: Slipping) -> None:
    """Set rates of particles of dry walls that a fluid has reached to those of its particles beside them; in place.

    Along the walls: there they were at rest, and would stop within a step what meets them.
    """
    new = np.full(len(cavities.x), -1)
    new[slipping.rows] = np.arange(len(slipping.rows))
    new[cavities.is_new] = -1
    cells = cavities.cells[touching(new >= 0, cavities.cells) & (cavities.label > 0)]
    row, corner = np.nonzero(new[cells] >= 0)
    here, rates = new[cells[row, corner]], cavities.fields[:, :6].reshape(-1, 2, 3)
    known = np.where(new[cells[row]] < 0, 1.0, 0.0)
    count = np.bincount(here, known.sum(axis=1), len(slipping.rows))
    total = np.zeros((len(slipping.rows), 2, 3))
    np.add.at(total, here, np.einsum("rk,rkia->ria", known, rates[cells[row]]))
    reached = np.flatnonzero(count)
    i = slipping.rows[reached]
    change = total[reached] / count[reached, None, None] - rates[i]
    cavities.fields[i, :6] += np.einsum("rab,rib->ria", slipping.along[reached], change).reshape(-1, 6)
