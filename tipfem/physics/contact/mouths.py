"""Mouths of closed gaps in tanks that are full: what a gap takes up flows into it there.

Where there is no empty space, the area by which a closed gap grows is missing from the fluids. With N linear along the
gap, 1 at one mouth and 0 at the other, the first gives the sum of N over the gap's cells times their growth. The cells
of the fluid around the mouth lose that volume V, by the source of their continuity.

Where solids float, V depends on their increments q, and with P the mean pressure of those cells the gap acts on them
with P dV/dq, so that both do the same work. Were V given, the solids could not move otherwise than the gap has it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix

from tipfem.backend.launch import launch
from tipfem.geometry.plane.vectors import turned
from tipfem.linalg.parts import parts_of_cells
from tipfem.linalg.sparsity import Csr
from tipfem.mesh.mesh import Mesh, simplex_measure
from tipfem.physics import linear_rows
from tipfem.physics.term import Equations
from tipfem.typing import Array


@dataclass(frozen=True)
class Mouths:
    """M mouths of the closed gaps of a full tank, which have K cells, on E cells of fluids."""

    mesh: Mesh  # at the start of the step
    cells: Array  # (K, 3)
    fluid: Array  # (K,) beside each gap, the last one; -1 for none
    share: csr_matrix  # (M, K) parts of the cells' growth that flow in
    part: csr_matrix  # (M, E) of it that each cell of the fluids loses

    def taken(self, end: Array) -> Array:
        """(K,) growth of the gaps' cells, with particles at ``end`` (N, 2) [m^2]."""
        one, other = (np.abs(simplex_measure(x, self.cells, self.mesh.period)) for x in (end, self.mesh.position))
        return np.asarray(one - other)

    def growth(self, end: Array) -> Array:
        """(E,) relative growth of the cells of fluids, with particles at ``end`` (N, 2)."""
        return np.asarray(-(self.part.T @ (self.share @ self.taken(end))) / self.mesh.measure)

    def taken_up(self, end: Array, fluids: int) -> Array:
        """(F,) volume by which gaps have grown, of the fluids beside them."""
        there = self.fluid >= 0
        return np.bincount(self.fluid[there], self.taken(end)[there], minlength=fluids)

    def slopes(self, x: Array, on: Array, reference: Array) -> Array:
        """(M, 3 S) derivatives of V by the poses of S solids about points (S, 2); particles are ``on`` (N,) them."""
        return np.asarray(self.share @ by_pose(slopes_of_areas(x, self.cells)[0], x, self.cells, on, reference))

    def levels(self, weight: Array) -> Array:
        """(K,) pressures at the middles of the gaps' cells by weights (F, 2), less those where V is taken [Pa]."""
        x, of = self.mesh.position, weight[np.maximum(self.fluid, 0)]
        inside, outside = x[self.cells].mean(axis=1), x[self.mesh.cells].mean(axis=1)
        return np.asarray(((inside - self.share.T @ (self.part @ outside)) * of).sum(axis=1))


def slopes_of_areas(x: Array, cells: Array) -> tuple[Array, Array]:
    """Derivatives (K, 3, 2) of the areas of cells by their corners at x (N, 2), and the areas (K,)."""
    side = np.roll(x[cells], -1, axis=1) - np.roll(x[cells], -2, axis=1)  # opposite to each corner
    area = 0.5 * (side[:, 0, 0] * side[:, 1, 1] - side[:, 0, 1] * side[:, 1, 0])
    slope = 0.5 * np.stack([side[..., 1], -side[..., 0]], axis=2)
    return np.sign(area)[:, None, None] * slope, np.abs(area)


def by_pose(values: Array, x: Array, cells: Array, on: Array, reference: Array) -> Array:
    """(K, 3 S) forces and moments on solids of vectors (K, 3, 2) at corners; see `Mouths.slopes`."""
    of, result = on[cells], np.zeros((len(cells), len(reference), 3))
    cell, i = np.nonzero(of >= 0)
    solid, value = of[cell, i], values[cell, i]
    arm = turned(x[cells[cell, i]] - reference[solid])
    np.add.at(result, (cell, solid), np.append(value, (value * arm).sum(axis=1)[:, None], axis=1))
    return np.asarray(result.reshape(len(cells), 3 * len(reference)))


def mouths(mesh: Mesh, empty: Array | None) -> Mouths | None:
    """The mouths in a full tank, where all empty cells (E, 3) are closed; None without any."""
    if empty is None or not len(empty):
        return None
    fluid, x = np.asarray(mesh.fluid), mesh.position
    count, number = parts_of_cells(empty)
    beside, shares, parts = np.full(len(empty), -1), [], []
    for c in range(count):
        own = number == c
        cells, inside = empty[own], np.zeros(len(x), dtype=bool)
        inside[cells] = True
        around = np.flatnonzero(inside[mesh.cells].any(axis=1))
        if not len(around):
            continue
        beside[own] = fluid[around].max()
        around = around[fluid[around] == fluid[around].max()]
        nodes = np.unique(cells)
        axis = np.linalg.svd(x[nodes] - x[nodes].mean(axis=0), full_matrices=False)[2][0]
        wet = np.zeros(len(x), dtype=bool)
        wet[mesh.cells[around]] = True
        ends = x[nodes[wet[nodes]]] @ axis
        low, high = ends.min(), ends.max()
        of = mesh.cells[around]
        s = np.where(inside[of], x[of] @ axis, 0.0).sum(axis=1) / inside[of].sum(axis=1)
        mean = (x[cells] @ axis).mean(axis=1)
        end = s > 0.5 * (low + high)
        if high - low > 0.5 * np.ptp(x[nodes] @ axis) and end.any() and not end.all():
            along = np.clip((mean - low) / (high - low), 0.0, 1.0)
            found = [(~end, 1 - along), (end, along)]
        else:  # there is one mouth
            found = [(np.ones(len(s), dtype=bool), np.ones(len(cells)))]
        for mine, share in found:
            shares.append(np.zeros(len(empty)))
            shares[-1][own] = share
            parts.append(np.zeros(len(mesh.cells)))
            parts[-1][around[mine]] = mesh.measure[around[mine]] / mesh.measure[around[mine]].sum()
    if not shares:
        return None
    return Mouths(mesh, empty, beside, csr_matrix(np.array(shares)), csr_matrix(np.array(parts)))


class MouthRows:
    """Rows of mouths in a step where B solids float, with two nodes each from ``first`` on.

    Particles are ``on`` (N,) solids, or -1; ``cells`` (E, 3) have the nodes with the pressures of fluids.
    """

    def __init__(self, given: Mouths, on: Array, solids: int, cells: Array, first: int, rows: int) -> None:
        self._mouths, self._on = given, on
        mouth, cell = given.part.nonzero()
        columns = mouth.repeat(3), cells[cell].ravel()
        third = np.asarray(given.part[mouth, cell]).repeat(3) / 3
        # mean: (M, P) of each node's pressure in that of a mouth
        self.mean = coo_matrix((third, columns), shape=(given.part.shape[0], cells.max() + 1)).tocsr()
        at = by_pose(np.ones((len(given.cells), 3, 2)), given.mesh.position, given.cells, on, np.zeros((solids, 2)))
        beside = given.share @ np.abs(at)[:, ::3]  # which mouths have which solids
        self._mouth, self._solid = (index.ravel() for index in np.nonzero(beside))
        entry = self.mean[self._mouth].tocoo()
        self._entry, self._node, self._mean = entry.row, entry.col, entry.data
        node = first + 2 * self._solid[self._entry]
        lists = [self._node, self._node, node, node + 1], [node, node + 1, self._node, self._node]
        self.couplings: tuple[Array, Array] = np.concatenate(lists[0]), np.concatenate(lists[1])
        key, self._place = np.unique(self.couplings[0].astype(np.int64) * rows + self.couplings[1], return_inverse=True)
        row, self._columns = np.divmod(key, rows)
        self._rows, self._starts = np.unique(row, return_index=True)

    def slopes(self, x: Array, reference: Array) -> Array:
        """(M, 3 B) see `Mouths.slopes`."""
        return self._mouths.slopes(x, self._on, reference)

    def swept(self, slopes: Array) -> tuple[Array, Array, Array]:
        """Nodes (E,), numbers of solids (E,), and the parts (E, 3) of ``slopes`` (M, B, 3) in the nodes' continuity."""
        mouth, solid = self._mouth[self._entry], self._solid[self._entry]
        return self._node, solid, slopes[mouth, solid] * self._mean[:, None]

    def put(self, equations: Equations, column: Array, row: Array) -> None:
        """Set the matrix, from derivatives of V by the solids' unknowns (M, B, 3), and in rows by poses."""
        count, blocks = len(self._entry), np.zeros((len(self._place), 3, 3))
        moves, acts = (self.swept(each)[2] for each in (column, row))
        blocks[:count, 2, :2], blocks[count : 2 * count, 2, 0] = moves[:, :2], moves[:, 2]
        blocks[2 * count : 3 * count, :2, 2], blocks[3 * count :, 0, 2] = -acts[:, :2], -acts[:, 2]
        all_of, forces = np.zeros((2, len(self._columns), 3, 3))
        np.add.at(all_of, self._place, blocks)
        np.add.at(forces, self._place[2 * count :], blocks[2 * count :])
        up, self._equations = equations.buffers.upload, equations
        self._pattern = (
            up("mouths.rows", self._rows.astype(np.int32)),
            up("mouths.offsets", np.append(self._starts, len(self._columns)).astype(np.int32)),
            up("mouths.columns", self._columns.astype(np.int32)),
        )
        self._none = up("mouths.none", np.zeros(3 * len(self._rows)))
        self._forces, self._slopes = up("mouths.forces", forces.ravel()), up("mouths.slopes", all_of.ravel())

    def residual(self, x: Any, out: Any) -> None:
        """Add the forces on solids; volumes are in the source."""
        count, e = len(self._rows), self._equations
        arrays = *self._pattern, self._forces, self._none, e.scale, x, out, count, 2
        launch(linear_rows.add_product, *arrays, work=(count, linear_rows.ROW))

    def gather(self, matrix: Csr) -> None:
        """See `Term.gather`."""
        count, e = len(self._rows), self._equations
        arrays = *self._pattern, self._slopes, e.scale, matrix, e.rows, count, 2
        launch(linear_rows.add_blocks, *arrays, work=(count, linear_rows.ROW))
