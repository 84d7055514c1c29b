"""Condensation: displacements that follow others are eliminated from the linear systems of a step.

A node whose displacement is not an unknown of its own follows others: the copy of a particle on an interface its
particle, a particle on a body the body's motion, a particle that slides on a wall itself, but for what is normal to the
wall. With the corrections q of the unknowns that are left, all displacements are u = R q, and the sums of forces that
act on q are L^T r. L is R but where forces act at other positions than those of the end of the step, as on walls that
turn. So the matrix of the unknowns is L^T K R: formed once in a linearisation, for the Krylov iteration it is a matrix
like any other (multi-point constraints; J. F. Abel & M. S. Shephard, An algorithm for multipoint constraints in finite
element analysis, Int. J. Numer. Meth. Eng. 14, 1979).

Vectors and matrices keep the entries of followers: in corrections they are those of R q, in residuals and in the
matrix zero.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from tipfem.backend.arrays import Buffers
from tipfem.backend.launch import launch
from tipfem.fem import condensation_kernels as kernels
from tipfem.linalg.sparsity import Csr
from tipfem.scratch import scratch
from tipfem.typing import Array


class Follows(NamedTuple):
    """K relations of nodes and those that they follow, the nodes ascending."""

    node: Array  # (K,) that follows,
    parent: Array  # (K,) one that it follows
    row: Array  # (K, d, d) of L: the node's force f is L^T f on the parent
    column: Array  # (K, d, d) of R: the parent's displacement u is R u at the node

    @staticmethod
    def together(parts: list[Follows], dimension: int) -> Follows:
        """The relations of several constraints."""
        nowhere, nothing = np.zeros(0, dtype=np.int64), np.zeros((0, dimension, dimension))
        if len(parts) == 1:
            return parts[0]
        columns = zip(Follows(nowhere, nowhere, nothing, nothing), *parts, strict=True)
        node, parent, row, column = (np.concatenate(column) for column in columns)
        order = np.argsort(node, kind="stable")
        return Follows(node[order], parent[order], row[order], column[order])


class Condensation:
    """The followers among P nodes, on the device: ``count`` of them.

    ``owner`` (P,) is the node whose displacement each has, itself or the one that it is a copy of; ``follows`` has the
    relations of nodes that are no copies.
    """

    def __init__(self, owner: Array, follows: Follows, buffers: Buffers) -> None:
        self._buffers, self._nodes, self._dimension = buffers, len(owner), follows.row.shape[1]
        lists = owner, follows.node, follows.parent
        owner, given, parent = (np.ascontiguousarray(values, dtype=np.int32) for values in lists)
        per_node = scratch("condensed.per_node", (3, self._nodes), np.int32)
        entries = launch(kernels.count_relations, owner, given, parent, *per_node)
        followers, counts = scratch("condensed.lists", (6, self._nodes + 1), np.int32), np.empty(5, dtype=np.int32)
        relations = np.empty((5, entries), dtype=np.int32)
        launch(kernels.list_relations, owner, parent, *per_node, followers, relations, counts)
        self._own, self._partly, self.count, self._others, self._parents = counts.tolist()
        self._numbers, self._followers = followers[0, :-1], followers[1, : self.count]
        self._starts, (_, self._parent, self._source, by_parent, of) = followers[2, : self.count + 1], relations
        self._counts = kernels.Counts(self._partly, self.count, self._others, self._parents)
        if not self.count:
            return
        put = buffers.upload
        self._of_followers = (
            put("condensed.node", self._followers),
            put("condensed.starts", self._starts),
            put("condensed.parent", self._parent),
        )
        self._follower = put("condensed.follower", self._numbers)
        self._of_parents = kernels.Parents(
            put("condensed.parents", followers[3, : self._parents]),
            put("condensed.lists", followers[4, : self._parents + 1]),
            put("condensed.entry", by_parent),
            put("condensed.of", of),
        )
        self.set(follows)

    def set(self, follows: Follows) -> None:
        """Set the matrices of the relations, which are those given at first."""
        if self.count:
            self._row = self._taken("condensed.row", follows.row)
            self._column = self._taken("condensed.column", follows.column)

    def _taken(self, name: str, matrices: Array) -> Any:
        """Device array (E, d * d) of the matrices of all relations, from those given (K, d, d)."""
        d = self._dimension
        given = np.ascontiguousarray(matrices).reshape(-1, d * d)
        taken = scratch("condensed.taken", (len(self._source), d * d))
        launch(kernels.take_matrices, self._source, given, taken, d)
        return self._buffers.upload(name, taken)

    def couplings(self, one: Array, other: Array, cells: Array) -> tuple[Array, Array]:
        """Couplings of nodes that the condensed matrix has beside those of the mesh, without repetition, in CSR.

        They are offsets (P + 1,) and columns, ascending in each row, int32. ``cells`` (M, d + 1) have nodes of the
        mesh; ``one`` and ``other`` (K,) are rows and columns of further couplings, as of terms that couple nodes
        without a common cell.
        """
        near, most = cells[:0], 1
        if self.count > self._own:
            cells, listed = np.ascontiguousarray(cells), scratch("condensed.near", len(cells), np.int32)
            number = launch(kernels.list_followers, cells, self._numbers, self._own, listed)
            near = cells.take(listed[:number], axis=0)
            most = 1 + int(np.diff(self._starts).max())
        # A node and those that it follows are coupled with another and those; a table that is half full at most.
        size = 1 << (2 * (near.size * near.shape[1] * most**2 + len(one)) + 1).bit_length()
        table = scratch("condensed.table", (size, 2), np.int32)
        offsets, cursor = counts = scratch("condensed.counts", (2, self._nodes + 1), np.int32)
        counts.fill(0)
        columns = scratch("condensed.columns", size // 2, np.int32)
        given = one.astype(np.int32), other.astype(np.int32)
        launch(
            kernels.list_couplings,
            np.ascontiguousarray(near, dtype=np.int32),
            self._numbers,
            self._starts,
            self._parent,
            *given,
            table,
            cursor,
            offsets,
            columns,
            self._own,
        )
        return offsets, columns[: offsets[-1]]

    def spread(self, x: Any) -> None:
        """Set the followers' displacements in a vector (P (d + 1),): x = R x."""
        if self.count:
            counts, work = (self._own, self._partly, self.count, self._dimension), (self.count, kernels.FOLLOWER)
            launch(kernels.spread, *self._of_followers, self._column, x, *counts, work=work)

    def collect(self, r: Any) -> None:
        """Add the momentum rows of followers in a vector (P (d + 1),) to those of their parents: r = L^T r."""
        if self.count:
            work = self.count, kernels.FOLLOWER
            given = self._of_parents, self._of_followers[0], self._row, r, self._counts
            launch(kernels.collect, *given, self._dimension, work=work)

    def condense(self, matrix: Csr, *, full: bool = True) -> None:
        """K = L^T K R in place, of a matrix with the columns of `couplings`; ``full`` as in `jacobian.gather_rows`."""
        if not self.count:
            return
        launch(
            kernels.condense_columns,
            self._follower,
            *self._of_followers[1:],
            self._column,
            matrix,
            self._nodes,
            self._dimension,
            full,
            work=(self._nodes, kernels.ROW),
        )
        launch(
            kernels.condense_rows,
            self._of_parents,
            self._of_followers[0],
            self._row,
            matrix,
            self._nodes,
            self._counts,
            self._dimension,
            full,
            work=(self._parents, kernels.PARENT),
        )
