"""A mesh of simplices that follows its particles and is repaired in place, in two and three dimensions."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree

from tipfem.backend.launch import launch
from tipfem.errors import TriangulationError
from tipfem.geometry.period import no_period
from tipfem.geometry.place import along_curve
from tipfem.mesh.mesh import Mesh
from tipfem.remesh.cavity import arrays, passes, rounds
from tipfem.remesh.cavity.arrays import (
    COLLAPSE,
    CURE,
    DONE,
    FIXED,
    MOVES,
    ON,
    RELABEL,
    SMOOTH,
    SPLIT,
    SWAP,
    USED,
    WALL,
)
from tipfem.remesh.target_spacing import limited
from tipfem.scratch import scratch
from tipfem.typing import Array

DIRECTIONS = 14  # of faces of the boundary, which have bits in sets of labels, see `stars.BOUNDARY`
ROOM = 0.25  # of the arrays' lengths, for particles and cells that come
SHARE = 6  # cells for each row of proposals at most; what finds no row waits for the next round
FILMS, AGAIN = 8, 2  # rounds in which the cells of a film break; and how often, with other cells around
# How far empty space is as fine as fluids, how its edges grow from there, and to which length [spacings].
FINE, COARSENING, COARSEST = 2.0, 0.4, 4.0
SETTLING = 16  # repairs of a first mesh, until nothing changes
RESTORED, TIMES = 1e-14, 12  # relative error of a volume that is left, and rounds for it
NEARBY, FARTHEST = 1.5, 0.2  # where a volume is given back, and by which distance of a face [spacings]
NOWHERE = 1e-9  # area [spacings^(d - 1)] of a vector that is left of one across the walls: round-off, no direction
KEPT = 0.3  # part of its volume that a cell keeps in them


class Task(NamedTuple):
    """Rounds of one kind of change; lengths in spacings, see `rounds`."""

    kind: int  # of the change
    most: int  # rounds
    limit: float  # below or above which something is wrong
    longest: float = 1.5  # edge that a collapse may leave
    least: float = 0.2  # quality that suffices after a collapse
    gain: float = 0.02  # of quality that a change must bring
    bend: float = 0.0  # of an interface where its edges turn
    ahead: float = 0.0  # time within which empty space closes that goes to a fluid now [s]


_FLIPS, _SWAPS = Task(SWAP, 12, 1e-3), Task(SWAP, 12, 0.3, bend=0.1)
_CURE = Task(CURE, 6, 0.15, longest=1.9, least=1e30)
# What a repair does, in this order, by dimension; and after films have broken.
REPAIR = {
    2: (
        _FLIPS,
        Task(COLLAPSE, 9, 0.66, longest=1.6, least=0.3),
        Task(SPLIT, 6, 1.7),
        _FLIPS,
        Task(CURE, 6, 0.3, longest=1.6, least=1e30),
        _FLIPS,
    ),
    3: (
        _SWAPS,
        Task(COLLAPSE, 9, 0.75, longest=1.9, least=0.15),
        Task(SPLIT, 6, 1.95),
        _SWAPS,
        _CURE,
        Task(SMOOTH, 6, 0.15, gain=0.01),
        _SWAPS,
    ),
}
NAMES = {SWAP: "swaps", COLLAPSE: "collapses", SPLIT: "splits", CURE: "cures", SMOOTH: "smoothing"}
KINDS = tuple(NAMES)
BROKEN = {2: (_FLIPS,), 3: (_SWAPS, _CURE)}
QUALITY = {2: (_FLIPS,), 3: (_SWAPS,)}  # where particles are neither removed nor new


class Cavities:
    """A mesh that is changed in place, in rounds, see `rounds`.

    Rows that are not in use stay in the arrays: particles keep their numbers.

    Args:
        mesh: of cells that all have a measure; their fluids are the labels, one for all if they have none.
        fixed: (N,) mask of the particles that stay where they are.
        wall: (N,) mask of the particles on walls; by default the fixed ones.
        planes: (N, S) mask of the planes of the boundary that particles are on; by default all on walls are held.
        kinds: (S,) numbers of the planes' directions, for planes that may have the same; each its own by default.
        fields: (N, K) of the particles, which those that are new or moved take from the cells there; none by default.
        moves: (N,) mask of the particles that are not at rest, among which films break; all by default.

    Attributes:
        x, cells, across, label, marks, wide: see `arrays.Simplices`.
        fields: (N, K) of the particles.
        is_new: (N,) mask of the particles that were not there at the start.
        spacing: of the particles [m].
        rounds, changes: how many there were.
        observer: called with the name of each kind of repair that has changed something.
    """

    def __init__(
        self,
        mesh: Mesh,
        fixed: Array,
        spacing: float,
        fields: Array | None = None,
        moves: Array | None = None,
        wall: Array | None = None,
        planes: Array | None = None,
        kinds: Array | None = None,
    ) -> None:
        self.dim, self.spacing, self.rounds = mesh.dimension, spacing, 0
        self._projectors: tuple[Array, Array] | None = None
        self.changes = 0
        self.observer: Callable[[str], None] = lambda kind: None
        count, particles = len(mesh.cells), len(mesh.position)
        label = np.zeros(count, dtype=np.int32) if mesh.fluid is None else mesh.fluid
        self.x = np.array(mesh.position, dtype=float)
        self.cells, self.across = mesh.cells.astype(np.int32), mesh.neighbours.astype(np.int32)
        self._planes = 0
        if planes is not None:
            of_plane = np.append(np.arange(planes.shape[1]) if kinds is None else kinds, -1).astype(np.int32)
            self._planes = int(of_plane.max()) + 2  # one more for faces on no plane, of cells that end at others
            if self._planes > DIRECTIONS:
                text = f"the walls have {self._planes - 1} directions; the mesh tells {DIRECTIONS - 1} apart"
                raise TriangulationError(text)
            of_plane[-1] = self._planes - 1
        self.label, self.tried = label.astype(np.int32), np.zeros(count, dtype=np.int32)
        self.marks = np.where(fixed, USED | FIXED, USED).astype(np.int32)
        self.marks |= np.where(fixed if wall is None else wall, WALL, 0).astype(np.int32)
        self.marks |= MOVES if moves is None else np.where(moves, MOVES, 0).astype(np.int32)
        self.fields = np.zeros((particles, self.dim)) if fields is None else np.array(fields, dtype=float)
        self.is_new, self.wide = np.zeros(particles, dtype=bool), np.ones(particles)
        if planes is not None:
            given = self.simplices, np.ascontiguousarray(planes).view(np.int8), of_plane
            launch(passes.name_walls, *given, work=(count, passes.FACES))
        self._grow(particles // 8 + 8, count // 8 + 8)
        self.mark()

    @property
    def simplices(self) -> arrays.Simplices:
        """All of its arrays."""
        return arrays.Simplices(self.x, self.cells, self.across, self.label, self.marks, self.wide, self.dim)

    def _grow(self, particles: int, cells: int) -> None:
        """Add unused rows to the arrays."""
        self.x = np.concatenate([self.x, np.zeros((particles, self.dim))])
        self.marks = np.concatenate([self.marks, np.zeros(particles, dtype=np.int32)])
        self.fields = np.concatenate([self.fields, np.zeros((particles, self.fields.shape[1]))])
        self.is_new = np.concatenate([self.is_new, np.zeros(particles, dtype=bool)])
        self.wide = np.concatenate([self.wide, np.ones(particles)])
        rows = np.full((cells, self.dim + 1), -1, dtype=np.int32)
        self.cells, self.across = np.concatenate([self.cells, rows]), np.concatenate([self.across, rows])
        self.label = np.concatenate([self.label, rows[:, 0]])
        self.tried = np.concatenate([self.tried, np.zeros(cells, dtype=np.int32)])

    def mark(self) -> None:
        """Mark the particles on interfaces."""
        launch(passes.mark_interfaces, self.simplices, work=(len(self.cells), passes.FACES))

    def coarsen_empty(self, *, walls: bool) -> None:
        """Set targets of nodes of empty space, label 0, and on ``walls``, that grow with the distance from fluids."""
        wide = np.where(highest(self.cells, self.label, len(self.x)) > 0, 1.0 - COARSENING * FINE, COARSEST)
        empty = self.cells[self.label == 0]
        wide = limited(self.x, empty, no_period(self.dim), wide, COARSENING / self.spacing)
        self.wide = np.maximum(wide, 1.0)
        if not walls:
            self.wide[self.marks & WALL != 0] = 1.0

    def round(self, task: Task) -> int:
        """One round of a task; how many cavities it changed."""
        return self._round(task, np.arange(len(self.cells), dtype=np.int32))[0]

    def _round(self, task: Task, some: Array) -> tuple[int, Array]:
        """A round at some cells; how many cavities it changed, and the cells at which the next finds anything."""
        self.rounds += 1
        limits = np.array([self.spacing, task.limit, task.longest, task.least, task.gain, task.bend, task.ahead])
        code, size = scratch("cavities.code", len(some), np.int32), len(self.cells)
        launch(
            rounds.find,
            self.simplices,
            self.tried,
            self.fields,
            limits,
            some,
            code,
            task.kind,
            work=(len(some), rounds.FIND),
        )
        at = np.flatnonzero(code != 0)  # masks are faster than numbers
        found, count = some[at], min(len(at), size // SHARE + 64)
        if not count:
            return 0, found
        rows = _rows(found[:count], code[at[:count]])
        given = self.simplices, self.tried, self.fields, limits, rows, count, task.kind
        launch(rounds.propose, *given, work=(count, rounds.PROPOSE))
        changed, again = self._change(rows)
        again[found] = True
        return changed, np.flatnonzero(again).astype(np.int32)

    def run(self, *tasks: Task) -> int:
        """Rounds of each task in turn, until nothing changes; how many cavities they changed."""
        total = 0
        for task in tasks:
            some = np.arange(len(self.cells), dtype=np.int32)
            before = total
            for _ in range(task.most):
                changed, some = self._round(task, some)
                total += changed
                if not changed:
                    break
            if total > before:
                self.observer(NAMES[task.kind])
        return total

    def leave_alone(self, cells: Array) -> None:
        """Do not look at some cells in rounds, unless something changes beside them."""
        self.tried[cells] = DONE - 1

    def settle(self, stay: Array, kinds: tuple[int, ...] = KINDS) -> int:
        """All rounds of some ``kinds`` until nothing changes, or for long; how many cavities they changed.

        Particles on interfaces stay, and those with the numbers ``stay`` (K,).
        """
        self.mark()
        held = self.marks & ON != 0
        held[stay] = True
        held = np.flatnonzero(held & (self.marks & FIXED == 0))
        self.marks[held] |= FIXED
        tasks, total = [task for task in REPAIR[self.dim] if task.kind in kinds], 0
        for _ in range(SETTLING):
            self.tried[:] = 0
            changed = self.run(*tasks)
            total += changed
            if not changed:
                break
        self.marks[held] &= ~FIXED
        return total

    def repair(self, film: float = 0.0, ahead: float = 0.0) -> None:
        """All rounds after the particles have moved; films lower than ``film`` break, and what closes ``ahead`` [s]."""
        self.mark()
        self.tried[:] = 0
        self.run(*REPAIR[self.dim])
        near = np.arange(len(self.cells), dtype=np.int32)
        for _ in range(AGAIN if film else 0):
            label, broken, task = self.label.copy(), 0, Task(RELABEL, 1, film, ahead=ahead)
            while broken < FILMS:
                changed, again = self._round(task, near)
                if not changed:
                    break
                broken += 1
                self.mark()
                near = np.union1d(self._beside(label), again)
            if not broken:
                break
            self.observer("films")
            self.tried[near] &= DONE
            label = self.label.copy()
            self.run(*BROKEN[self.dim])
            self.mark()
            near = np.union1d(near, self._beside(label))
            self.tried[near] &= DONE

    def _beside(self, label: Array) -> Array:
        """The cells that share particles with those that have got another label than before, or are gone."""
        changed = self.cells[np.flatnonzero(label != self.label[: len(label)])]
        near = np.zeros(len(self.x), dtype=bool)
        near[changed[changed >= 0]] = True
        return self.around(near)

    def _change(self, rows: arrays.Proposals) -> tuple[int, Array]:
        """Make those of the proposed changes that win; how many, and a mask (M,) of the cells that they touch."""
        count = len(rows.row)
        urgency, tie = scratch("cavities.claims", (2, len(self.x)), np.int64)
        launch(rounds.stake, self.simplices, rows, urgency, tie, count, work=(count, rounds.STAKE * arrays.MOST))
        while True:
            touched, free = np.zeros(len(self.cells), dtype=bool), scratch("cavities.free", len(self.cells), np.int32)
            total = np.empty(6, dtype=np.int32)
            flags = self.is_new.view(np.int8), touched.view(np.int8)
            launch(rounds.allot, self.simplices, rows, *flags, free, total, count)
            won, refilled, *wanted = total.tolist()
            if wanted[:2] == wanted[2:]:
                break
            more = wanted[1] - wanted[3], wanted[0] - wanted[2]
            self._grow(more[0] + int(ROOM * len(self.x)), more[1] + int(ROOM * len(self.cells)))
        if won:
            self._projectors = None
            self.changes += won
            given = self.simplices, self.tried, self.fields, rows, free, count
            launch(rounds.apply, *given, work=(count, rounds.APPLY))
        if refilled:
            work = (count * arrays.FILLED_MOST, rounds.LINK / arrays.FILLED_MOST)
            launch(rounds.link, self.simplices, rows, count, work=work)
        return won, touched

    def relocate(self, moves: Array, sites: Array) -> bool:
        """Move particles into edges; whether all could be.

        Those that cannot be taken out of the cells around them are tried again after swaps.

        Args:
            moves: (K, 3) particles, and the two ends of the edge that each goes to.
            sites: (K, d) where they are to be [m].
        """
        new = self.insert(moves[:, 1], sites)
        if (new < 0).any():
            return False
        left, swapped = np.arange(len(moves)), False
        while len(left):
            won = self._moved(moves[left, 0], moves[left], sites[left], insert=False)[:, arrays.WON] == 1
            if not won.any():
                if swapped or not self.run(*QUALITY[self.dim]):
                    return False
                swapped = True
            left = left[~won]
        number = np.arange(len(self.x), dtype=np.int32)
        number[new] = moves[:, 0]
        self.cells = number[self.cells]
        self.x[moves[:, 0]], self.marks[moves[:, 0]], self.marks[new] = sites, self.marks[new], 0
        return True

    def _moved(self, at: Array, moves: Array, sites: Array, *, insert: bool) -> Array:
        """The rows of a round that inserts K particles or removes them; ``at`` (K,): a particle of the cell of each."""
        rows = _rows(self._cells_at(at), np.zeros(len(at), dtype=np.int32))
        these, work = (moves.astype(np.int32), np.ascontiguousarray(sites)), (len(at), rounds.PROPOSE)
        launch(rounds.propose_moves, self.simplices, *these, rows, insert, work=work)
        self._change(rows)
        return np.asarray(rows.row)

    def _cells_at(self, particles: Array) -> Array:
        """A cell (K,) at each of K particles, -1 for none."""
        used = np.flatnonzero(self.label >= 0)
        corner = np.full(len(self.x), -1)
        for column in self.cells[used].T:
            corner[column] = used
        return np.asarray(corner[particles])

    def mesh(self, *, empty: bool = False, sort: bool = False) -> Mesh:
        """The mesh as it is, with its labels and all rows of particles, the unused ones too.

        Cells of ``empty`` space, label 0, come last; others are as they were, or where they ``sort`` by their places.
        """
        used = np.flatnonzero(self.label >= 0)
        last = (self.label[used] == 0) & empty
        if sort:
            middle = sum(self.x[column] for column in self.cells[used].T) / (self.dim + 1)
            order = np.lexsort((along_curve(np.asarray(middle), self.spacing), last))
            used = used[order]
        elif empty:
            used = np.concatenate([used[~last], used[last]])
        number = np.full(len(self.cells), -1, dtype=np.int32)
        number[used] = np.arange(len(used), dtype=np.int32)
        cells, across = np.empty((2, len(used), self.dim + 1), dtype=np.int32)
        label, used = np.empty(len(used), dtype=np.int32), used.astype(np.int32)
        launch(passes.take, self.simplices, used, number, cells, across, label, work=(len(used), passes.FACES))
        return Mesh(self.x.copy(), cells, label).with_(neighbours=across)

    def insert(self, start: Array, sites: Array) -> Array:
        """Put new particles at sites (K, d) [m] on edges from particles ``start`` (K,).

        Returns:
            (K,) the new particles; -1 where there could be none, as between particles of walls that are held.
        """
        new, moves, left = np.full(len(start), -1, dtype=np.int32), np.stack([start] * 3, axis=1), np.arange(len(start))
        while len(left):
            row = self._moved(start[left], moves[left], sites[left], insert=True)
            won = row[:, arrays.WON] == 1
            if not won.any():
                break
            new[left[won]], left = row[won, arrays.NEW_PARTICLE], left[~won]
        return new

    def copied(self, particles: Array) -> Array:
        """New particles (K,) with the places, fields and targets of some, in no cell."""
        rows = np.flatnonzero(self.marks == 0)
        if len(rows) < len(particles):
            self._grow(len(particles) + int(ROOM * len(self.x)), 0)
            rows = np.flatnonzero(self.marks == 0)
        rows = rows[: len(particles)]
        for values in (self.x, self.fields, self.wide):
            values[rows] = values[particles]
        self.marks[rows], self.is_new[rows] = USED, True
        return rows

    def volumes(self, of: Array, count: int) -> Array:
        """(count,) volumes of the cells with each number in ``of`` (M,), which is -1 in unused rows [m^d]."""
        return np.bincount(of + 1, measures(self.x, self.cells), count + 1)[1:]

    def restore_volumes(self, wanted: Array, of: Array, free: Array | None = None) -> None:
        """Move interfaces along their normals until parts of the mesh have the volumes that are wanted.

        Args:
            wanted: (K,) volumes of the parts [m^d].
            of: (M,) part of each cell, -1 in unused rows; parts end at interfaces.
            free: (K,) mask of the parts that may have any volume; none by default.
        """
        # What all others have is not the largest one's.
        rest, moves = np.delete(np.arange(len(wanted)), np.argmax(wanted)), (self.marks & (ON | FIXED)) == ON
        if free is not None and free.any():
            rest, of = np.flatnonzero(~free), np.where((of >= 0) & ~free[of], of, -1)
        if not self._planes:
            moves &= (self.marks & WALL) == 0
        at = self.around(moves)
        cells, there = self.cells[at], self.volumes(of, len(wanted))
        own, row = measures(self.x, cells), np.full(len(wanted), -1)
        row[rest] = np.arange(len(rest))
        areas, least = self._areas(of, moves, at), KEPT * own
        for _ in range(TIMES):
            missing = (wanted - there)[rest]
            if (np.abs(missing) < RESTORED * wanted[rest]).all():
                break
            self._shift(areas.of_parts(self._area_vectors(areas, moves), row), missing, moves, cells, least)
            now = measures(self.x, cells)
            there += np.bincount(of[at] + 1, now - own, len(wanted) + 1)[1:]
            own = now

    def restore_near(self, labels: Array, part: Array, near: Array, missing: Array) -> None:
        """Move interfaces close to some particles, so that labels gain what is missing there.

        Args:
            labels: (R,) label of each part.
            part: (S,) of particles.
            near: (S,) these particles.
            missing: (R,) volume that each part is to gain [m^d].
        """
        moves = (self.marks & (ON | FIXED)) == ON
        if not self._planes:
            moves &= (self.marks & WALL) == 0
        index = np.flatnonzero(moves)
        if not len(index):
            return
        trees, reach = (cKDTree(self.x[near]), cKDTree(self.x[index])), NEARBY * self.spacing
        pairs = trees[0].sparse_distance_matrix(trees[1], reach, output_type="ndarray")
        row, there = np.divmod(np.unique(part[pairs["i"]] * len(index) + pairs["j"]), len(index))
        particle = index[there]
        moves[:] = False
        moves[particle] = True
        at = self.around(moves)
        cells = self.cells[at]
        areas, wanted = self._areas(self.label, moves, at), labels[row] * len(self.x) + particle
        vectors, place = self._area_vectors(areas, moves), np.searchsorted(areas.key, wanted)
        known = np.append(areas.key, -1)[place] == wanted
        given = Vectors(row[known], particle[known], vectors[place[known]])
        self._shift(given, missing, moves, cells, KEPT * measures(self.x, cells), FARTHEST * self.spacing)

    def _shift(
        self, vectors: Vectors, missing: Array, moves: Array, cells: Array, least: Array, most: float = np.inf
    ) -> None:
        """Move particles along vectors of parts of the mesh, so that these gain what is ``missing`` (R,).

        To first order, and as far as ``cells`` (K, d + 1) keep their ``least`` (K,) measure; by ``most`` at most [m].
        """
        sizes = np.linalg.norm(vectors.value, axis=1)
        known = sizes > NOWHERE * self.spacing ** (self.dim - 1)
        units = np.divide(vectors.value, sizes[:, None], out=np.zeros_like(vectors.value), where=known[:, None])
        count, place = len(missing), (vectors.particle[:, None] * self.dim + np.arange(self.dim)).ravel()
        first = self.dim * np.searchsorted(vectors.part, np.arange(count + 1))
        one, other = (
            sparse.csr_matrix((values.ravel(), place, first), shape=(count, self.x.size))
            for values in (vectors.value, units)
        )
        matrix = (one @ other.T).toarray()
        distances = np.clip(np.linalg.lstsq(matrix, missing, rcond=1e-10)[0], -most, most)
        along = units * distances[vectors.part, None]
        way = np.stack([np.bincount(vectors.particle, each, len(self.x)) for each in along.T], axis=1)
        while (spoilt := measures(self.x + way, cells) < least).any():
            moves[cells[spoilt]] = False
            way = np.where(moves[:, None], way, 0.0)
        self.x += way

    def around(self, some: Array) -> Array:
        """The cells in use that have particles of a mask (N,)."""
        return np.flatnonzero(touching(some, self.cells) & (self.label >= 0)).astype(np.int32)

    def _areas(self, of: Array, on: Array, at: Array) -> Areas:
        """Pairs of a part ``of`` (M,) of the mesh and a particle ``on`` (N,) at it, of cells ``at`` (K,)."""
        used = at[of[at] >= 0]
        cells = self.cells[used]
        corner = np.flatnonzero(on[cells].ravel())
        key = of[used].astype(np.int64)[corner // (self.dim + 1)] * len(self.x) + cells.ravel()[corner]
        key, number = np.unique(key, return_inverse=True)
        return Areas(key, len(self.x), used, corner, number)

    def _area_vectors(self, areas: Areas, on: Array) -> Array:
        """(P, d) derivatives of the parts' volumes by the places of particles ``on`` (N,), see `Areas`."""
        turn, along = np.where(on, 0, -1).astype(np.int32), np.eye(self.dim)[None]
        if self._planes:
            which, along = self.along_walls()
            turn = np.where(on, which, -1).astype(np.int32)
        each = np.empty((len(areas.cells), (self.dim + 1) * self.dim))
        given = self.simplices, areas.cells, turn, along.reshape(len(along), -1), each
        launch(passes.measure_gradients, *given, work=(len(each), passes.VECTORS))
        values = each.reshape(-1, self.dim)[areas.corner]
        return np.stack([np.bincount(areas.number, axis, len(areas.key)) for axis in values.T], axis=1)

    def along_walls(self) -> tuple[Array, Array]:
        """The row (N,) of each particle among the projectors (A, d, d) on walls; the same until cells change."""
        if self._projectors is not None:
            return self._projectors
        cell, i = np.divmod(np.flatnonzero(self.across.ravel() < -1), self.dim + 1)
        cell, i = cell[self.label[cell] >= 0], i[self.label[cell] >= 0]
        corner = np.stack([self.cells[cell, (i + k) % (self.dim + 1)] for k in range(1, self.dim + 1)])
        bits, plane = np.zeros(len(self.x), dtype=np.int32), -2 - self.across[cell, i]
        for each in corner:
            np.bitwise_or.at(bits, each, np.int32(1) << plane)
        one, other = self.x[corner[1]] - self.x[corner[0]], self.x[corner[-1]] - self.x[corner[0]]
        normals, across = np.zeros((self._planes, self.dim)), np.cross(one, other)
        size = (across**2).sum(axis=1)
        for k in range(self._planes):
            largest = np.argmax((plane == k) * size)
            normals[k] = across[largest] / np.linalg.norm(across[largest])
        bits[(self.marks & WALL) == 0] = 0
        there = np.bincount(bits) > 0
        sets, which = np.flatnonzero(there), (np.cumsum(there) - 1)[bits]
        held = np.where((sets[:, None, None] >> np.arange(self._planes)[:, None]) & 1, normals, 0.0)
        along = np.eye(self.dim) - np.linalg.pinv(held) @ held
        self._projectors = which, along
        return self._projectors


class Vectors(NamedTuple):
    """(P, d) vectors of parts, sorted by these, at particles."""

    part: Array
    particle: Array
    value: Array


class Areas(NamedTuple):
    """Pairs of a part of a mesh and a particle at its surface, where its volume changes as the particle moves."""

    key: Array  # (P,) part times the number of particles, plus the particle; ascending
    particles: int  # their count
    cells: Array  # that have such particles
    corner: Array  # (C,) their corners that are ones
    number: Array  # (C,) of the pair of each

    def of_parts(self, vectors: Array, row: Array) -> Vectors:
        """Vectors (P, d) under new numbers ``row`` (K,) of the parts; without those of -1."""
        part, particle = np.divmod(self.key, self.particles)
        known = row[part] >= 0
        return Vectors(row[part[known]], particle[known], vectors[known])


def highest(cells: Array, label: Array, count: int) -> Array:
    """The highest label (M,) of the cells that each of ``count`` particles is in; -1 in none."""
    found = np.full(count, -1, dtype=np.int32)
    launch(passes.raise_corners, cells, label, found, work=(len(cells), passes.RAISE))
    return found


def measures(x: Array, cells: Array) -> Array:
    """Measures (M,) of cells (M, d + 1) of particles at x (N, d); of rows that are not in use, any."""
    out = np.empty(len(cells))
    launch(passes.measure, x, cells, out, x.shape[1], work=(len(cells), passes.MEASURE))
    return out


def touching(some: Array, cells: Array) -> Array:
    """(M,) mask of the cells (M, d + 1) that have one of ``some`` particles (N,)."""
    out = np.empty(len(cells), dtype=bool)
    launch(passes.touch, cells, some.view(np.int8), out.view(np.int8), work=(len(cells), passes.RAISE))
    return out


def _rows(cells: Array, code: Array) -> arrays.Proposals:
    """Rows for proposals at cells (K,) with what is wrong there (K,), until the next ones are made."""
    row = scratch("cavities.row", (len(cells), arrays.WIDTH), np.int32)
    real = scratch("cavities.real", (len(cells), arrays.REALS))
    row[:, arrays.CELL], row[:, arrays.CODE] = cells, code
    return arrays.Proposals(row, real)
