"""CavityRemesher: tetrahedra that keep their fluid, repaired in place in rounds; see `tipfem.remesh.cavity`.

Fluids are labelled by their density, from the lightest, 0. Under a free surface empty space is the lightest of all.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from tipfem.arguments import rounded
from tipfem.case.boundary.boundary import Boundary
from tipfem.case.case import Case
from tipfem.case.fluid import Fluid
from tipfem.case.grading import Grading
from tipfem.case.numerics import FittedRule, SurfaceRule
from tipfem.case.particles import Particles
from tipfem.case.region import Filling
from tipfem.errors import Invalid, TriangulationError
from tipfem.geometry.blocks import BlockedBox
from tipfem.geometry.lattice import crossings
from tipfem.geometry.place import along_curve
from tipfem.geometry.plane.domain import Domain
from tipfem.geometry.polyhedron import Polyhedron
from tipfem.mesh.delaunay import WHOLE, triangulate, wall_fluid
from tipfem.mesh.free_surface import filled_cells
from tipfem.mesh.interface import SharpInterface
from tipfem.mesh.mesh import Mesh
from tipfem.physics.carried import Carried, Remap
from tipfem.physics.physics import Physics
from tipfem.physics.registry import physics_of
from tipfem.physics.state import SharpMaterial, Solved, State
from tipfem.remesh import drops, surface_volumes
from tipfem.remesh.cavity.arrays import SPLIT, SWAP, WALL
from tipfem.remesh.cavity.cavities import FINE, QUALITY, Cavities, highest
from tipfem.remesh.cavity.empty_cells import first_nodes, first_on_walls
from tipfem.remesh.cavity.flight import Flight
from tipfem.remesh.parts import carried
from tipfem.remesh.remeshers import OUTSET, Remesher
from tipfem.remesh.repair_account import CAVITIES
from tipfem.remesh.stages.conversion import cavities_of, flight_of, renumbered, slopes, taken, whole, widen
from tipfem.remesh.stages.in_space import RemeshingInSpace
from tipfem.remesh.stages.order import STAGES_IN_SPACE
from tipfem.remesh.stages.remeshing import Rules
from tipfem.remesh.target_spacing import GROWTH
from tipfem.timers import timer
from tipfem.typing import Array

FOUND = 4  # times that the targets of a first mesh are found
CUTS = 4  # rounds in which edges that cross a face between fluids are cut


class CavityRemesher(Remesher):
    """Tetrahedra that keep their fluid.

    Args:
        rule: when cells are changed; see `Rules` for this and what follows.
        keep: whether every remeshing restores the volumes that the fluids started with.
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
        rule: FittedRule,
        *,
        keep: bool,
        walls_have_fluids: bool,
        grading: Grading | None = None,
        surface: SurfaceRule | None = None,
        physics: Sequence[Physics[Any]] = (),
        filling: Filling | None = None,
    ) -> None:
        super().__init__(fluids, physics, filling)
        self._rule, self._keep, self._walls_have_fluids, self._grading = rule, keep, walls_have_fluids, grading
        self._surface, self._open = surface, surface is not None

    @staticmethod
    def of(case: Case) -> CavityRemesher:
        """The remesher of a case."""
        return CavityRemesher(
            case.fluids,
            case.numerics.fitting,
            keep=case.numerics.volume_correction > 0,
            walls_have_fluids=case.walls_have_fluids,
            grading=case.grading,
            surface=case.numerics.surface if case.free_surface else None,
            physics=physics_of(case),
            filling=case.filling,
        )

    def first_volume(self, particles: Particles, boundary: Boundary) -> float:
        """See `Remesher.first_volume`."""
        mesh = self._first_mesh(particles, boundary)
        return float(mesh.measure @ (self._rules.labels.density[np.asarray(mesh.fluid)] > 0))

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
            slides[boundary.index[boundary.slides]] = self._grading is None and not slopes(boundary)
            there = first_on_walls(position, fluid >= 0, boundary.planes & slides[:, None], *given)
            there = np.concatenate([there, len(position) + np.arange(len(nodes))])
            position, wall = np.concatenate([position, nodes]), drops.longer(wall, len(position) + len(nodes))
        mesh = _around_blocks(position[there], wall[there], particles.spacing, boundary.domain)
        if len(there) < len(position):
            mesh = Mesh(position, there[mesh.cells].astype(np.int32))
        if self._filling is not None:
            return mesh.relabelled(self._rules.labels.of[self._filling.fluid(mesh.centres())].astype(np.int32))
        if self._surface is not None:
            fluid = np.append(fluid, np.full(len(position) - len(fluid), -1))
            empty = ~filled_cells(
                mesh, particles.shallow_copy(position=position, wall=wall, fluid=fluid), self._surface, None
            )
            fluid = np.maximum(fluid, 0).astype(np.int32)
        if not self._walls_have_fluids:
            fluid = wall_fluid(mesh, fluid, wall)
        label = self._rules.labels.of[fluid][mesh.cells].min(axis=1)
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
        sloping = slopes(boundary)
        cavities = cavities_of(self._rules, mesh, particles, boundary, nowhere, free=sloping)
        if (filling := self._filling) is not None:
            box = np.stack([particles.position.min(axis=0), particles.position.max(axis=0)])
            left = self._cut(cavities, filling.fluid, lambda x: filling.part(x, particles.spacing, box))
            if sloping and len(left):
                text = f"{rounded(left[0])} m, as beside a corner; move it by half a spacing, or choose a smaller one"
                raise Invalid("tank", f": no cells fit between walls and the face of what is filled in at {text}")
        widen(self._rules, cavities, particles)
        cavities.run(*QUALITY[3])
        raw = cavities.mesh()
        number, beside = self._rules.labels.fluid[np.asarray(raw.fluid)], raw.neighbours
        faces = ((beside >= 0) & (number[beside] != number[:, None])).any(axis=1)
        self._warn_of_misfit(raw, particles.spacing, np.eye(len(self._rules.labels.fluid))[number], faces)
        if self._open or self._grading is not None:  # the first nodes, and strides, are at no even distances
            stay = np.zeros(0, dtype=np.int32)
            if self._grading is None:
                wet = highest(cavities.cells, cavities.label, len(cavities.x)) > 0
                stay = np.flatnonzero(wet & (cavities.marks & WALL != 0)).astype(np.int32)
            for _ in range(FOUND):
                if not cavities.settle(stay) or self._grading is None:
                    break
                widen(self._rules, cavities, particles)
        nothing = Flight(nowhere, np.zeros(len(nowhere)), particles.fluid)
        particles, mesh, number, _ = taken(self._rules, cavities, particles, nothing)
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
            boundary = renumbered(boundary, number, len(particles))
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
        """See `Remesher.remesh`: the `STAGES_IN_SPACE`."""
        solved = surface_volumes.balanced(solved) if self._open else solved
        self.account.start(solved)
        return self._through(STAGES_IN_SPACE, RemeshingInSpace.of(solved, self._rules, self.account))

    def with_drop(self, state: State, at: Array, radius: float, fluid: int, acceleration: Array) -> State:
        """See `Remesher.with_drop`: edges are cut by the sphere, and the cells in it change their fluid."""
        state = self._refined(state, at, radius, acceleration)
        particles, mesh, names = state.particles, state.mesh, [f.name for f in self.fluids]
        (_, everywhere), falls = whole(self._rules, state, particles), not drops.is_inside(mesh, at)
        if not falls:
            near = drops.within(particles, at, radius)
            front = bool(mesh.surface.front[near].any())
            drops.require_room(particles, near, particles.fluid[near], at, radius, fluid, names, at_surface=front)
        else:
            drops.require_empty(particles, mesh.surface, at, radius, drops.is_inside(everywhere, at))
        spacing, cavities = (
            particles.spacing,
            cavities_of(self._rules, everywhere, particles, state.boundary, state.fixed),
        )

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
        _, everywhere = whole(self._rules, state, state.particles)
        cavities = cavities_of(self._rules, everywhere, state.particles, state.boundary, state.fixed)
        off = np.abs(np.linalg.norm(cavities.x - at, axis=1) - radius) / state.particles.spacing
        growth = GROWTH if self._grading is None else self._grading.growth
        cavities.wide = np.minimum(cavities.wide, 1.0 + growth * np.maximum(off - FINE, 0.0))
        cavities.settle(np.flatnonzero(cavities.marks & WALL), kinds=(SWAP, SPLIT))
        return self._with_changes(state, cavities, acceleration)

    def _with_changes(self, state: State, cavities: Cavities, acceleration: Array, *, falls: bool = False) -> State:
        """A state of the same time with what has changed in its mesh; new particles are at rest where they ``fall``."""
        particles = state.particles
        flight = flight_of(state, self._rules.labels)
        new, mesh, number, _ = taken(self._rules, cavities, particles, flight)
        if falls:
            added = np.arange(len(new)) >= len(particles)
            new.velocity[added], new.acceleration[added], new.pressure[added] = 0.0, acceleration, 0.0
        remap = Remap(state.mesh, mesh, number, np.arange(len(new)) >= len(particles), acceleration[None])
        parts, new = carried(self._physics, state.parts, new, remap)
        boundary, fixed = renumbered(state.boundary, number, len(new)), drops.longer(state.fixed, len(new))
        others = {"boundary": boundary, "parts": parts, "fixed": fixed}
        return self._changed(
            state, new, mesh, *self._material(new, mesh), relocated=drops.longer(state.relocated, len(new)), **others
        )

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
            self._rules.labels.of[number]
            if fluid is None
            else np.where(number == 1, self._rules.labels.of[fluid], cavities.label[used])
        )
        cavities.label[used] = number
        cavities.mark()
        return np.asarray(sites)

    def _material(self, particles: Particles, mesh: Mesh) -> tuple[SharpMaterial, Array]:
        """See `Remesher._material`."""
        return self._rules.material(mesh)

    @property
    def _rules(self) -> Rules:
        """By the fluids as they are now."""
        given = self.fluids, self._physics, self._rule, self._keep, self._grading
        return Rules(*given, open=self._open)


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


def _least(corner: Array) -> Array:
    """The least part (M,) at corners (M, 4) that are on no face."""
    return np.asarray(np.where(corner >= 0, corner, np.iinfo(corner.dtype).max).min(axis=1))
