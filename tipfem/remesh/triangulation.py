"""Triangulation: triangles on moving particles, changed in place by the kernels of remeshing."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from tipfem.backend.launch import launch
from tipfem.case.particles import Particles
from tipfem.mesh.delaunay import TriangulationError
from tipfem.mesh.mesh import Mesh
from tipfem.remesh.edges import coarsen_refine, films_contacts, flips
from tipfem.remesh.edges import long_edges as edge_kernels
from tipfem.remesh.edges.edge_operations import STAR
from tipfem.remesh.volumes import label_components
from tipfem.typing import Array


@dataclass
class Triangulation:
    """A triangulation that can be changed in place.

    Attributes:
        state: (N, 9) position, velocity, acceleration, pressure, lumped mass and target spacing of the particles.
        cells, neighbours, fluid, corner: see `edge_operations`.
        wall: (N,) 1 for wall particles.
        density: (F,) of the fluids [kg/m^3].
        freed: particles that have been taken out and not been placed elsewhere yet.
    """

    state: Array
    cells: Array
    neighbours: Array
    fluid: Array
    corner: Array
    wall: Array
    density: Array
    freed: Array = field(default_factory=lambda: np.zeros(0, dtype=np.int32))
    _stale: Array = field(init=False)  # (M,) see `flips`
    _marks: Array | None = field(init=False, default=None)  # flips and motion leave them; all else forgets them

    def __post_init__(self) -> None:
        self._stale = np.ones(len(self.cells), dtype=np.int8)

    @classmethod
    def of(cls, particles: Particles, mesh: Mesh, density: Array, measure: Array, slack: float) -> Triangulation:
        """A copy of ``mesh``, which must know its fluids of ``density`` (F,), moved to where ``particles`` are.

        ``measure`` (M,) are the triangles' areas there [m^2]. It has been looked through for what `make_delaunay` has
        to do ``again``, and has some room for more cells.
        """
        assert mesh.fluid is not None
        count = len(particles)
        state, corner = np.empty((count, 9)), np.empty(count, dtype=np.int32)
        elements = len(mesh.cells)
        room = elements + elements // 64 + 64  # for cells to come
        cells, neighbours = np.empty((room, 3), dtype=np.int32), np.empty((room, 3), dtype=np.int32)
        fluid, stale = np.full(room, -1, dtype=np.int32), np.zeros(room, dtype=np.int8)
        cells[:elements], neighbours[:elements], fluid[:elements] = mesh.cells, mesh.neighbours, mesh.fluid
        launch(
            flips.gather,
            *map(np.ascontiguousarray, (particles.position, particles.velocity, particles.acceleration)),
            *map(np.ascontiguousarray, (particles.pressure, particles.target)),
            cells,
            neighbours,
            fluid,
            measure,
            density,
            np.empty(count),
            state,
            corner,
            stale,
            count,
            elements,
            slack,
            work=(elements, 20.0),
        )
        wall = particles.wall.astype(np.int32)
        t = cls(state, cells, neighbours, fluid, corner, wall, density)
        t._stale = stale
        t._marks = None if mesh.components is None else mesh.components.mark.copy()
        return t

    def carried(self) -> dict[str, Array]:
        """What particles carry, by the names of `Particles`: all of `state` but positions and masses."""
        count = len(self.state)
        velocity, acceleration, pressure, wanted = np.empty((count, 2)), np.empty((count, 2)), *np.empty((2, count))
        launch(flips.scatter, self.state, velocity, acceleration, pressure, wanted, count)
        return {"velocity": velocity, "acceleration": acceleration, "pressure": pressure, "target": wanted}

    def make_delaunay(self, slack: float, *, again: bool = False) -> int:
        """Flip what is not Delaunay; how many flips it took.

        ``again``: but for this object's own changes, all was as it had to be after the last time.

        Raises:
            TriangulationError: the flips did not come to an end.
        """
        elements = len(self.cells)
        if not again:
            self._stale = np.zeros(elements, dtype=np.int8)
            launch(
                flips.find_flips,
                self.state,
                self.cells,
                self.neighbours,
                self.fluid,
                self._stale,
                elements,
                slack,
                work=(elements, 40.0),
            )
        count, stack = np.zeros(3, dtype=np.int32), np.empty(max(8 * elements, 64), dtype=np.int32)
        while True:
            count[2] = 0
            launch(
                flips.make_delaunay,
                self.state,
                self.cells,
                self.neighbours,
                self.fluid,
                self.corner,
                self.wall,
                self.density,
                stack,
                self._stale,
                np.empty(4, dtype=np.int32),
                count,
                elements,
                slack,
            )
            if count[1]:
                raise TriangulationError(f"flipping edges does not come to an end ({count[0]} flips)")
            if not count[2]:
                return int(count[0])

    def marks(self) -> Array:
        """(N,) 1 for particles on an interface, 2 for those on the hull, 3 for both, 0 for others."""
        if self._marks is None:
            nowhere, fluids = np.zeros((len(self.state), 2)), int(self.fluid.max()) + 1
            self._marks = label_components(nowhere, self.cells, self.neighbours, self.fluid, fluids)[0].mark
        return self._marks

    def compact(self) -> None:
        """Drop the cells that are gone."""
        gone = np.flatnonzero(self.fluid < 0)
        if not len(gone):
            return
        # The last cells take the places of those that are gone.
        count = len(self.cells) - len(gone)
        last = np.arange(count, len(self.cells))
        source, target = last[self.fluid[count:] >= 0], gone[gone < count]
        if not len(source):
            self.cells, self.neighbours, self.fluid = self.cells[:count], self.neighbours[:count], self.fluid[:count]
            self._stale = self._stale[:count]
            return
        number = np.full(len(self.cells) + 1, -1, dtype=np.int32)  # beyond the hull stays -1
        number[source] = target
        for array in (self.cells, self.neighbours, self.fluid):
            array[target] = array[source]
        self.cells, self.neighbours, self.fluid = self.cells[:count], self.neighbours[:count], self.fluid[:count]
        self._stale = np.ones(count, dtype=np.int8)
        for array in (self.neighbours, self.corner):
            far = array >= count
            array[far] = number[array[far]]

    def longest_edges(self, long: float, most: int | None = None) -> tuple[Array, int]:
        """Edges by name (see `long_edges`), the longest first, but those of interfaces and hull that are longer
        than ``long`` before all others, ``most`` of them; and how many are longer, of those inside a fluid than 1.4
        times that.
        """
        size = 3 * len(self.cells) if most is None else most
        edge, key, count = np.empty(size, dtype=np.int32), np.empty(size), np.zeros(3, dtype=np.int32)
        launch(
            edge_kernels.longest_edges,
            self.state,
            self.cells,
            self.neighbours,
            self.fluid,
            edge,
            key,
            count,
            len(self.cells),
            long,
            0.0 if most is None else 0.5 * long,
            1.4 * long,
            size,
        )
        return _sorted(edge, key, int(count[1])), int(count[2])

    def long_edges(self, long: float) -> Array:
        """All edges longer than ``long`` targets, in the order of `longest_edges`."""
        size = 3 * len(self.cells)
        edge, key = np.empty(size, dtype=np.int32), np.empty(size)
        count = launch(
            edge_kernels.long_edges,
            self.state,
            self.cells,
            self.neighbours,
            self.fluid,
            edge,
            key,
            len(self.cells),
            long,
            long,
        )
        return _sorted(edge, key, count)

    def tidy(
        self, held: Array, way: Array, reach: float, gap: float, least: float, thin: float, sliver: float
    ) -> tuple[int, int]:
        """Interfaces meet walls where they point to, those ``held`` (N,) excepted; films break, particles that lie as
        good as on an interface are taken in; see `films_contacts.tidy`. How many broke, and how many were taken in.
        """
        elements = len(self.cells)
        flag, count = np.empty(elements, dtype=np.int32), np.zeros(2, dtype=np.int32)
        fixed, contacts, before, way = held.astype(np.int32), len(self.state), -1, np.ascontiguousarray(way)
        broken = 0
        while count[1] != before:  # the parts of an edge may be long, too
            before = int(count[1])
            launch(
                films_contacts.tidy,
                self.state,
                self.cells,
                self.neighbours,
                self.fluid,
                self.corner,
                fixed,
                self.density,
                self.marks(),
                way,
                _scratch(),
                self._stale,
                flag,
                count,
                contacts,
                elements,
                reach,
                gap,
                least,
                thin,
                sliver,
                1.0,
                work=(elements, 10.0),
            )
            contacts, thin = 0, 0.0
            if count[0]:
                broken, before, count[0] = int(count[0]), -1, 0
                self._changed(broken, of_fluids=True)
        self._changed(count[1], of_fluids=True)
        return broken, int(count[1])

    def coarsen(
        self,
        held: Array,
        close: float,
        chain: float,
        edge: float,
        film: float,
        least: float,
        most: int,
        *,
        long: float = 0.0,
        every: bool = False,
    ) -> tuple[Array, int]:
        """Take out up to ``most`` particles that crowd others, into `freed`; see `coarsen_refine.coarsen`.

        What `longest_edges` returns then of as many as are wanted, or `long_edges` if it is ``every`` one, where
        ``long`` is not 0.
        """
        count, elements = np.zeros(3, dtype=np.int32), len(self.cells)
        freed, size = np.empty(len(self.state), dtype=np.int32), 3 * elements if long else 1
        edges, keys, span = np.empty(size, dtype=np.int32), np.empty(size), np.empty(elements)
        launch(
            coarsen_refine.coarsen,
            self.state,
            self.cells,
            self.neighbours,
            self.fluid,
            self.corner,
            held.astype(np.int32),
            self.wall,
            self.density,
            _scratch(),
            np.empty(max(elements, len(self.state)), dtype=np.int32),
            self._stale,
            freed,
            span,
            edges,
            keys,
            count,
            elements,
            len(self.state),
            close,
            chain,
            edge,
            film,
            least,
            most,
            long,
            int(every),
            len(self.freed),
            work=(elements, 15.0),
        )
        self.freed = np.concatenate([self.freed, freed[: count[0]]])
        self._changed(count[0])
        return _sorted(edges, keys, int(count[1])), int(count[2])

    def provide(self, count: int) -> None:
        """Let `freed` hold ``count`` particles, new ones if need be."""
        more = count - len(self.freed)
        if more > 0:
            first = len(self.state)
            self.state = np.concatenate([self.state, np.zeros((more, self.state.shape[1]))])
            self.corner = np.concatenate([self.corner, np.full(more, -1, dtype=np.int32)])
            self.wall = np.concatenate([self.wall, np.zeros(more, dtype=np.int32)])
            self.freed = np.concatenate([self.freed, np.arange(first, first + more, dtype=np.int32)])
            self._marks = None

    def drop(self) -> tuple[Array, Array]:
        """Drop the particles of `freed`, for good; the new numbers (N,) of all, -1 of those dropped, and the old ones
        of those that stay.
        """
        keep = np.ones(len(self.state), dtype=bool)
        keep[self.freed] = False
        kept, number = keep.nonzero()[0], np.full(len(keep), -1, dtype=np.int32)
        number[kept] = np.arange(len(kept), dtype=np.int32)
        self.state = self.state.take(kept, axis=0)
        self.corner, self.wall = self.corner.take(kept), self.wall.take(kept)
        self.cells = number.take(self.cells)
        self.freed = self.freed[:0]
        self._marks = None
        return number, kept

    def _changed(self, count: int, *, of_fluids: bool = False) -> None:
        """Forget what so many changes have made wrong."""
        if count:
            self._marks = None
            if of_fluids:
                self._stale = np.ones(len(self.cells), dtype=np.int8)

    def wanted_edges(self) -> int:
        """How many edges are looked at for places for the particles of `freed`."""
        return 8 * len(self.freed) + 32

    def refine(self, edges: Array, room: float) -> None:
        """Put particles of `freed` on the middle of ``edges``; those placed leave it. See its kernel."""
        wanted = len(self.freed)
        free = np.flatnonzero(self.fluid < 0).astype(np.int32)
        short = 2 * wanted + 1 - len(free)
        if short > 0:  # an edge of the hull has one cell, others two: collapses may have left too few
            first = len(self.cells)
            self.cells = np.concatenate([self.cells, np.zeros((short, 3), dtype=np.int32)])
            self.neighbours = np.concatenate([self.neighbours, np.full((short, 3), -1, dtype=np.int32)])
            self.fluid = np.concatenate([self.fluid, np.full(short, -1, dtype=np.int32)])
            self._stale = np.concatenate([self._stale, np.zeros(short, dtype=np.int8)])
            free = np.concatenate([free, np.arange(first, first + short, dtype=np.int32)])
        count = np.zeros(2, dtype=np.int32)
        candidates, touched = edges[: self.wanted_edges()], np.zeros(len(self.cells), dtype=np.int8)
        launch(
            coarsen_refine.refine,
            self.state,
            self.cells,
            self.neighbours,
            self.fluid,
            self.corner,
            self.wall,
            self.density,
            touched,
            candidates,
            len(candidates),
            free,
            self.freed,
            count,
            room,
            wanted,
        )
        new = np.flatnonzero(touched)
        beyond = self.neighbours[new]
        self._stale[new] = self._stale[beyond[beyond >= 0]] = 1
        self.freed = self.freed[count[0] :]
        self._changed(count[0])


def _sorted(edge: Array, key: Array, count: int) -> Array:
    """The first ``count`` names ``edge``, the largest keys first, those of the same key by name."""
    edge, key = edge[:count], key[:count]
    return edge[np.lexsort((edge, -key))]


def _scratch() -> Array:
    """Room for the stars of two particles, and more."""
    return np.empty(4 * (STAR + 1), dtype=np.int32)
