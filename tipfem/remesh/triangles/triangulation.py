"""Triangulation: triangles on moving particles, changed in place by the kernels of remeshing."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from tipfem.backend.launch import is_serial, launch
from tipfem.case.particles import Particles
from tipfem.errors import TriangulationError
from tipfem.geometry.period import Period, no_period
from tipfem.mesh.mesh import Mesh, simplex_measure
from tipfem.mesh.relabelled import SideEnergies
from tipfem.remesh.claims import Claims
from tipfem.remesh.triangles import coarsen_refine, films_contacts, flips, refining, removing
from tipfem.remesh.triangles import long_edges as edge_kernels
from tipfem.remesh.triangles.edge_operations import COLUMNS, CURRENT, MASS, STALE, TARGET, VELOCITY, TriangleArrays
from tipfem.remesh.triangles.long_edges import NEEDED, REMOVED, STORED
from tipfem.remesh.triangles.queue import Queue
from tipfem.remesh.volumes import label_components
from tipfem.scratch import copied, filled, owned, scratch
from tipfem.typing import Array

MUCH_LONGER = coarsen_refine.MUCH_LONGER
FORCED = 0.3  # of the thickness at which films break: thinner ones do whatever their energy
ROUND_OFF = 1e-9  # of the energy of a side


class Crowding(NamedTuple):
    """Limits below which particles crowd others, in target spacings; in the order of the kernel's constants."""

    too_close: float  # distance inside a fluid
    along_interface: float  # distance along an interface or a wall
    to_interface: float  # distance of a particle inside a fluid to an edge of an interface or a wall
    film: float  # distance of an interface to a wall, and of a contact to the next particle on the wall
    least_area: float  # twice the area that a collapse must leave each cell, in target spacings squared
    long_edge: float = 0.0  # length above which edges are long; 0 if they are not wanted


@dataclass
class Triangulation:
    """A triangulation of N particles and M cells that can be changed in place."""

    # (N, COLUMNS) position, velocity, acceleration, pressure, lumped mass and target spacing of the particles;
    # see `edge_operations` for the columns
    state: Array
    # cells, neighbours, fluid, corner: see `edge_operations.TriangleArrays`
    cells: Array
    neighbours: Array
    fluid: Array
    corner: Array
    wall: Array  # (N,) see `edge_operations.TriangleArrays`; by default, walls hold all of their particles
    density: Array  # (F,) of the fluids [kg/m^3]
    period: Period = field(default_factory=lambda: no_period(2))  # of the positions
    # free list: the particles that were removed and have not been inserted again
    removed: Array = field(default_factory=lambda: np.zeros(0, dtype=np.int32))
    # told after each kind of repair that changed something, by its name; or None
    observer: Callable[[str, Triangulation], None] | None = None
    _stale: Array = field(default_factory=lambda: np.zeros(0, np.int8))  # (M,), see `edge_operations.TriangleArrays`
    _marks: Array | None = field(init=False, default=None)  # valid through flips and motion, reset by other changes

    def __post_init__(self) -> None:
        if not len(self._stale):
            self._stale = np.full(len(self.cells), STALE, dtype=np.int8)

    @classmethod
    def of(cls, particles: Particles, mesh: Mesh, density: Array, measure: Array, tolerance: float) -> Triangulation:
        """A copy of a mesh at its particles' positions, with room for some more cells.

        Its cells are marked stale where `make_delaunay` with ``tolerance`` may flip edges.

        Args:
            particles: the N particles, with target spacings.
            mesh: M triangles, which have fluids.
            density: (F,) of the fluids [kg/m^3].
            measure: (M,) areas of the triangles at the particles' positions [m^2].
            tolerance: see `make_delaunay`.
        """
        assert mesh.fluid is not None
        count, elements = len(particles), len(mesh.cells)
        state, corner = scratch("repair.state", (count, COLUMNS)), scratch("repair.corner", count, np.int32)
        room = elements + elements // 64 + 64
        cells, neighbours = owned((room, 3), np.int32), owned((room, 3), np.int32)
        fluid, stale = filled(-1, "", room, np.int32), filled(CURRENT, "repair.stale", room, np.int8)
        cells[:elements], neighbours[:elements], fluid[:elements] = mesh.cells, mesh.neighbours, mesh.fluid
        wall = copied(particles.wall, "repair.wall", np.int32)
        t = cls(state, cells, neighbours, fluid, corner, wall, density, mesh.period, _stale=stale)
        fields = flips.ParticleArrays(
            *map(np.ascontiguousarray, (particles.position, particles.velocity, particles.acceleration)),
            *map(np.ascontiguousarray, (particles.pressure, particles.target)),
        )
        mass = scratch("repair.density", count)
        launch(flips.gather, fields, t._arrays, measure, mass, tolerance, work=(elements, flips.GATHER))
        t._marks = None if mesh.components is None else copied(mesh.components.mark, "repair.marks")
        return t

    def particle_fields(self) -> dict[str, Array]:
        """The particles' fields by the names of `Particles`: all of `state` but positions and masses."""
        count = len(self.state)
        velocity, acceleration, pressure, spacing = (owned(size) for size in ((count, 2), (count, 2), count, count))
        launch(flips.scatter, self.state, velocity, acceleration, pressure, spacing)
        return {"velocity": velocity, "acceleration": acceleration, "pressure": pressure, "target": spacing}

    @property
    def _arrays(self) -> TriangleArrays:
        mesh = self.state, self.cells, self.neighbours, self.fluid, self.period.array
        return TriangleArrays(*mesh, self.corner, self.wall, self.density, self._stale)

    def make_delaunay(self, tolerance: float, *, stale_only: bool = False) -> int:
        """Flip edges that are not Delaunay, and return the number of flips.

        Args:
            tolerance: how far a particle may be inside a circumcircle, see `flips.excess`.
            stale_only: examine only cells that were marked or changed since the last call.

        Raises:
            TriangulationError: flipping did not terminate.
        """
        elements = len(self.cells)
        if not stale_only:
            self._stale = np.full(elements, CURRENT, dtype=np.int8)
            launch(flips.find_flips, self._arrays, tolerance, work=(elements, flips.FIND_FLIPS))
        most, count = 3 * elements, len(self.state)
        counters = np.zeros(flips.COUNTERS, dtype=np.int32)
        edges = flips.Edges(
            scratch("flips.edges", (2, most), np.int32),
            scratch("flips.keys", (2, most)),
            scratch("flips.list", 4 * most, np.int32),
            counters,
        )
        arrays = self._arrays, edges, Claims(*scratch("flips.claims", (2, count), np.int64)), tolerance
        launch(flips.make_delaunay, *arrays, work=(elements, flips.LIST_EDGES))
        row = 0
        while listed := int(counters[flips.LISTED + row]):
            if is_serial(listed, flips.ROUND):
                launch(flips.flip_rounds, *arrays, row)
            else:
                launch(flips.flip_round, *arrays, row, listed)
                counters[flips.ENDLESS] |= counters[flips.FLIPS] > flips.MOST_FLIPS * elements
            if counters[flips.ENDLESS]:
                break
            row = 1 - row
        flipped = int(counters[flips.FLIPS])
        if counters[flips.ENDLESS]:
            raise TriangulationError(f"flipping edges does not terminate ({flipped} flips)")
        self._observed("flips", flipped)
        return flipped

    def _observed(self, kind: str, changes: int) -> None:
        if self.observer and changes:
            self.observer(kind, self)

    def marks(self) -> Array:
        """(N,) of the particles, see `tipfem.mesh.components.Components.mark`."""
        if self._marks is None:
            nowhere, fluids = np.zeros((len(self.state), 2)), int(self.fluid.max()) + 1
            self._marks = label_components(nowhere, self.cells, self.neighbours, self.fluid, fluids)[0].mark
        return self._marks

    def compact(self) -> None:
        """Drop the removed cells."""
        removed = self._removed_cells()
        if not len(removed):
            return
        # The last cells replace removed ones.
        count = len(self.cells) - len(removed)
        last = np.arange(count, len(self.cells))
        source, goal = last[self.fluid[count:] >= 0], removed[removed < count]
        if not len(source):
            self.cells, self.neighbours, self.fluid = self.cells[:count], self.neighbours[:count], self.fluid[:count]
            self._stale = self._stale[:count]
            return
        number = filled(-1, "repair.number", len(self.cells) + 1, np.int32)  # the last one is for -1, beyond the hull
        number[source] = goal
        for array in (self.cells, self.neighbours, self.fluid):
            array[goal] = array[source]
        self.cells, self.neighbours, self.fluid = self.cells[:count], self.neighbours[:count], self.fluid[:count]
        self._stale = filled(STALE, "repair.stale", count, np.int8)
        for array in (self.neighbours, self.corner):
            far = np.greater_equal(array, count, out=scratch("repair.far", array.shape, bool))
            array[far] = number[array[far]]

    def _removed_cells(self) -> Array:
        return np.flatnonzero(np.less(self.fluid, 0, out=scratch("repair.removed", len(self.fluid), bool)))

    def longest_edges(self, long: float, most: int | None = None) -> tuple[Array, int]:
        """The longest edges, relative to their targets; those of interfaces and hull longer than ``long`` come first.

        Args:
            long: in target spacings.
            most: how many edges are wanted; all by default.

        Returns:
            Names of edges, see `long_edges`; and how many edges are too long: those of interfaces and hull longer than
            ``long``, others longer than `MUCH_LONGER` times that.
        """
        size = 3 * len(self.cells) if most is None else most
        edges, keys, counters = np.empty(size, dtype=np.int32), np.empty(size), np.zeros(3, dtype=np.int32)
        launch(
            edge_kernels.longest_edges,
            self._arrays,
            edges,
            keys,
            counters,
            long,
            0.0 if most is None else 0.5 * long,
            MUCH_LONGER * long,
        )
        return _sorted(edges, keys, int(counters[STORED])), int(counters[NEEDED])

    def long_edges(self, long: float) -> Array:
        """Names of all edges longer than ``long`` targets, in the order of `longest_edges`."""
        size = 3 * len(self.cells)
        edges, keys = np.empty(size, dtype=np.int32), np.empty(size)
        count = launch(edge_kernels.long_edges, self._arrays, edges, keys, long, long)
        return _sorted(edges, keys, count)

    def repair_interfaces(
        self,
        held: Array,
        displacement: Array,
        *,
        reach: float,
        gap: float,
        least_area: float,
        film: float,
        sliver: float,
        energies: SideEnergies | None = None,
        still: Array | None = None,
        closed: Callable[[Array, Array, Array], Array] | None = None,
    ) -> tuple[int, int]:
        """Slide contacts along walls in the direction of their interfaces, break films, absorb slivers at interfaces.

        Args:
            held: (N,) mask of contacts that do not slide along their wall.
            displacement: (N, 2) of the particles in the step [m].
            reach: largest displacement of a contact; this and the other limits as in `films_contacts`.
            gap: distance of a contact to the next particles on its wall.
            least_area: twice the area that every cell must keep.
            film: height below which a film breaks.
            sliver: height below which a cell at an interface is absorbed.
            energies: of the sides of cells. Then a film stays whose break would raise them, unless it is thinner than
                `FORCED` of its limit.
            still: (M,) mask of cells that stay though they are films; none by default.
            closed: which cells are no films for the sake of closed gaps, see `Physics.closed`; None for none.

        Returns:
            How many cells changed their fluid because films broke, and because they were slivers.
        """
        elements = len(self.cells)
        flag, counters = scratch("films.flag", elements, np.int32), np.zeros(films_contacts.COUNTERS, dtype=np.int32)
        limits = np.array([reach, gap, least_area, film, sliver, 1.0])
        fixed, displacement = copied(held, "films.held", np.int32), np.ascontiguousarray(displacement)
        most = max(3 * elements, len(self.state))
        queue = Queue(scratch("films.keys", (most, 2)), scratch("films.names", most, np.int32))
        stays = np.zeros(elements, dtype=np.int8) if still is None else still
        if closed is not None:
            rows = np.flatnonzero(self.fluid >= 0)
            empty = self.fluid[rows] == len(self.density) - 1
            stays[rows[empty]] = 0
            stays[rows[closed(np.ascontiguousarray(self.state[:, :2]), self.cells[rows], empty)]] = 1

        def repair(slide: int, limits: Array) -> None:
            launch(
                films_contacts.repair_interfaces,
                self._arrays,
                fixed,
                self.marks(),
                displacement,
                counters,
                limits,
                np.empty(films_contacts.SCRATCH, dtype=np.int32),
                flag,
                stays,
                queue,
                slide,
                work=(elements, films_contacts.CELL),
            )

        broken, before, slide = 0, -1, 1
        if self.observer or energies:  # contacts alone, with the same results
            repair(slide, np.where(np.arange(films_contacts.LIMITS) < films_contacts.FILM, limits, 0.0))
            self._observed("contacts", 1)
            slide = 0
        while counters[films_contacts.ABSORBED] != before:  # the parts of an edge may be long, too
            before = int(counters[films_contacts.ABSORBED])
            start = (self.state.copy(), self.fluid.copy(), self._stale.copy()) if energies else None
            repair(slide, limits)
            if start is not None and energies and counters[films_contacts.BROKEN]:
                refused = self._refused(start[1], energies, FORCED * limits[films_contacts.FILM])
                if len(refused):
                    self.state, self.fluid, self._stale = start
                    stays[refused], counters[films_contacts.BROKEN], before = 1, 0, -1
                    continue
            slide, limits[films_contacts.FILM] = 0, 0.0
            if counters[films_contacts.BROKEN]:
                broken, before = int(counters[films_contacts.BROKEN]), -1
                counters[films_contacts.BROKEN] = 0
                self._changed(broken, of_fluids=True)
                self._observed("films", broken)
            else:
                self._observed("slivers", int(counters[films_contacts.ABSORBED]) - before)
        absorbed = int(counters[films_contacts.ABSORBED])
        self._changed(absorbed, of_fluids=True)
        return broken, absorbed

    def _refused(self, fluid: Array, energies: SideEnergies, forced: float) -> Array:
        """Cells that had another ``fluid`` (M,), in patches that raise the energy and are higher than ``forced``."""
        mesh = Mesh(self.state[:, :2], self.cells, self.fluid, period=self.period).with_(neighbours=self.neighbours)
        cell, patch, more = energies.raised(mesh, fluid)
        one, other = (self.cells[cell][:, order].ravel() for order in ([1, 2, 0], [2, 0, 1]))
        sides = mesh.sides(one, other).reshape(-1, 3, 2)
        area = np.abs(sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0])
        target = self.state[self.cells[cell], TARGET].mean(axis=1)
        height = area / np.linalg.norm(sides, axis=2).max(axis=1) / target
        lowest = np.full(len(more), np.inf)
        np.minimum.at(lowest, patch, height)
        raised = more > ROUND_OFF * energies.sigma.max() * target.max()
        return np.asarray(cell[(raised & (lowest > forced))[patch]])

    def coarsen(self, held: Array, limits: Crowding, *, most: int, every_edge: bool = False) -> tuple[Array, int]:
        """Remove up to ``most`` particles that crowd others, into `removed`; see `coarsen_refine.coarsen`.

        Args:
            held: (N,) mask of particles that stay.
            limits: when a particle crowds others, and which edges are long.
            most: number of particles.
            every_edge: whether all long edges are wanted.

        Returns:
            The same as `longest_edges` afterwards, with as many edges as are wanted; or as `long_edges` if
            ``every_edge``; no edges if limits.long_edge is 0.
        """
        elements, count = len(self.cells), len(self.state)
        counters, size = np.zeros(coarsen_refine.COUNTERS, dtype=np.int32), 3 * elements if limits.long_edge else 1
        removed, edges = scratch("coarsen.removed", count, np.int32), scratch("coarsen.edges", size, np.int32)
        keys = scratch("coarsen.keys", size)
        launch(
            coarsen_refine.coarsen,
            self._arrays,
            copied(held, "coarsen.held", np.int32),
            removed,
            coarsen_refine.LongEdges(edges, keys),
            counters,
            np.array(limits),
            np.array([most, len(self.removed), every_edge], dtype=np.int32),
            np.empty(coarsen_refine.SCRATCH, dtype=np.int32),
            scratch("coarsen.head", count, np.int32),
            scratch("coarsen.heights", elements),
            Queue(scratch("coarsen.points", (count, 2)), scratch("coarsen.rank", count, np.int32)),
            work=(elements, coarsen_refine.CELL),
        )
        self.removed = np.concatenate([self.removed, removed[: counters[REMOVED]]])
        self._changed(counters[REMOVED])
        self._observed("collapses", counters[REMOVED])
        return _sorted(edges, keys, int(counters[STORED])), int(counters[NEEDED])

    def provide(self, count: int) -> None:
        """Create particles until `removed` holds at least ``count``."""
        more = count - len(self.removed)
        if more > 0:
            first = len(self.state)
            self.state = np.concatenate([self.state, np.zeros((more, COLUMNS))])
            self.corner = np.concatenate([self.corner, np.full(more, -1, dtype=np.int32)])
            self.wall = np.concatenate([self.wall, np.zeros(more, dtype=np.int32)])
            self.removed = np.concatenate([self.removed, np.arange(first, first + more, dtype=np.int32)])
            self._marks = None

    def middles(self, cells: Array) -> Array:
        """(K, 2) middles of K cells, given by their numbers."""
        corner = self.state[self.cells[cells], :VELOCITY]
        return np.asarray(corner[:, 0] + self.period.shortest(corner - corner[:, :1]).mean(axis=1))

    def sort_cells(self, order: Array) -> None:
        """Sort the cells by the first of their particles in an ``order`` (N,) of all particles."""
        place = np.empty(len(order), dtype=np.int32)
        place[order] = np.arange(len(order), dtype=np.int32)
        old = np.argsort(place[self.cells].min(axis=1), kind="stable")
        number = np.full(len(old) + 1, -1, dtype=np.int32)  # the last one is for -1, beyond the hull
        number[old] = np.arange(len(old), dtype=np.int32)
        self.cells, self.fluid = self.cells.take(old, axis=0), self.fluid.take(old)
        self.neighbours, self.corner = number[self.neighbours.take(old, axis=0)], number[self.corner]
        self._stale = np.full(len(old), STALE, dtype=np.int8)

    def drop_removed(self, order: Array | None = None) -> tuple[Array, Array]:
        """Drop the particles of `removed` from all arrays and renumber the others, in the ``order`` (N,) given if any.

        Returns:
            The new numbers (N,) of all particles, -1 of those dropped, and the old ones of those that stay.
        """
        keep = np.ones(len(self.state), dtype=bool)
        keep[self.removed] = False
        kept = keep.nonzero()[0] if order is None else order[keep[order]]
        number = np.full(len(keep), -1, dtype=np.int32)
        number[kept] = np.arange(len(kept), dtype=np.int32)
        self.state = self.state.take(kept, axis=0)
        self.corner, self.wall = self.corner.take(kept), self.wall.take(kept)
        self.cells = number.take(self.cells)
        self.removed = self.removed[:0]
        self._marks = None
        return number, kept

    def _changed(self, count: int, *, of_fluids: bool = False) -> None:
        """Reset the data that ``count`` changes have made invalid."""
        if count:
            self._marks = None
            if of_fluids:
                self._stale = np.full(len(self.cells), STALE, dtype=np.int8)

    def take_out(self, particles: Array) -> Array:
        """Take particles (K,), by their numbers, out of empty space; (K,) mask of those for which that was possible."""
        done = np.zeros(len(particles), dtype=np.int8)
        launch(
            removing.remove_from_cells,
            self._arrays,
            particles.astype(np.int32),
            np.empty(removing.SCRATCH, dtype=np.int32),
            done,
        )
        self._changed(int(done.sum()))
        return done > 0

    def relabel(self, cells: Array, fluid: int) -> None:
        """Move cells, by their numbers, to another fluid, with their masses."""
        area = simplex_measure(np.ascontiguousarray(self.state[:, :2]), self.cells[cells], self.period)
        change = (self.density[fluid] - self.density[self.fluid[cells]]) * area
        mesh = Mesh(np.ascontiguousarray(self.state[:, :2]), self.cells[cells], period=self.period)
        np.add.at(self.state[:, MASS], self.cells[cells], mesh.parts_of(change))
        self.fluid[cells] = fluid
        self._changed(len(cells), of_fluids=True)

    def candidates(self) -> int:
        """Number of edges examined for insertion sites of the particles of `removed`."""
        return int(coarsen_refine.insertion_candidates(len(self.removed)))

    def refine(self, edges: Array, room: float) -> None:
        """Insert particles of `removed` in the middle of edges; those inserted leave the list.

        Args:
            edges: names as of `long_edges`, in the order in which they are split.
            room: distance to other particles that an insertion site must have, in target spacings.
        """
        most = len(self.removed)
        cells = self._removed_cells().astype(np.int32)
        short = 2 * most + 1 - len(cells)
        if short > 0:  # an edge of the hull has one cell, others two: collapses may have left too few
            first = len(self.cells)
            self.cells = np.concatenate([self.cells, np.zeros((short, 3), dtype=np.int32)])
            self.neighbours = np.concatenate([self.neighbours, np.full((short, 3), -1, dtype=np.int32)])
            self.fluid = np.concatenate([self.fluid, np.full(short, -1, dtype=np.int32)])
            self._stale = np.concatenate([self._stale, np.full(short, CURRENT, dtype=np.int8)])
            cells = np.concatenate([cells, np.arange(first, first + short, dtype=np.int32)])
        counters, touched = np.zeros(2, dtype=np.int32), filled(0, "refine.touched", len(self.cells), np.int8)
        launch(refining.refine, self._arrays, edges[: self.candidates()], cells, self.removed, touched, counters, room)
        new = np.flatnonzero(touched)
        beside = self.neighbours[new]
        self._stale[new] = self._stale[beside[beside >= 0]] = STALE
        inserted = int(counters[refining.INSERTED])
        self.removed = self.removed[inserted:]
        self._changed(inserted)
        self._observed("splits", inserted)


def _sorted(edges: Array, keys: Array, count: int) -> Array:
    """The first ``count`` edges, the largest keys first, those of the same key by name."""
    edges, keys = edges[:count], keys[:count]
    return edges[np.lexsort((edges, -keys))]
