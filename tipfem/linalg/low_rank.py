"""A preconditioner's solution corrected for what is coupled to it by few unknowns, by the Woodbury identity.

A cycle gives y = S^-1 r approximately. Where K unknowns with the matrix B are coupled to the rows by the columns W, as
what floats is to the pressure, (S + W B^-1 W^T)^-1 r = y - Y (B + W^T Y)^-1 W^T y with Y = S^-1 W.

Two arrays hold it, for kernels take long to start with many: ``lists`` has K, where the entries of each column begin,
and their nodes; ``values`` has the inverse of B + W^T Y (K, K), room for 2 K sums, the entries of W, and Y (K, nodes).
"""

from collections.abc import Callable
from typing import Any

import numpy as np
import taichi as ti

from tipfem.backend.array_types import Ints1, Reals1, Template
from tipfem.backend.arrays import Buffers, download
from tipfem.backend.launch import kernel, launch
from tipfem.linalg.multigrid.grid_hierarchy import RHS, SOLUTION
from tipfem.typing import Array


@ti.func
def set_sum(lists: Template, values: Template, vectors: Template, k, nodes):
    """Put W^T y of column ``k``, y the solution in ``vectors``, where `respond` finds it."""
    total, rank = 0.0, lists[0]
    for s in range(lists[1 + k], lists[2 + k]):
        total += values[rank * (rank + 2) + s] * vectors[SOLUTION * nodes + lists[2 + rank + s]]
    values[rank * rank + k] = total


@ti.func
def respond(lists: Template, values: Template, k):
    """Entry ``k`` of (B + W^T Y)^-1 W^T y, after `set_sum` of all columns."""
    total, rank = 0.0, lists[0]
    for m in range(rank):
        total += values[k * rank + m] * values[rank * rank + m]
    values[rank * (rank + 1) + k] = total


@ti.func
def correct_at(lists: Template, values: Template, vectors: Template, i, nodes):
    """y -= Y (B + W^T Y)^-1 W^T y at node ``i``, after `respond` of all columns."""
    change, rank = 0.0, lists[0]
    response = rank * (rank + 2) + lists[1 + rank]
    for k in range(rank):
        change += values[response + k * nodes + i] * values[rank * (rank + 1) + k]
    vectors[SOLUTION * nodes + i] = vectors[SOLUTION * nodes + i] - change


@kernel
def correct(lists: Ints1, values: Reals1, vectors: Reals1, nodes: ti.i32):
    """Correct the solution in ``vectors``."""
    for k in range(lists[0]):
        set_sum(lists, values, vectors, k, nodes)
    for k in range(lists[0]):
        respond(lists, values, k)
    for i in range(nodes):
        correct_at(lists, values, vectors, i, nodes)


@kernel
def set_column(lists: Ints1, values: Reals1, vectors: Reals1, k: ti.i32, nodes: ti.i32):
    """Column ``k`` of W as the right-hand side in ``vectors``."""
    for i in range(nodes):
        vectors[RHS * nodes + i] = 0.0
    for s in range(lists[1 + k], lists[2 + k]):
        vectors[RHS * nodes + lists[2 + lists[0] + s]] = values[lists[0] * (lists[0] + 2) + s]


@kernel
def store_response(lists: Ints1, values: Reals1, vectors: Reals1, k: ti.i32, solved: ti.i32, nodes: ti.i32):
    """Column ``k`` of Y from the solution in ``vectors``, and of W^T Y; zeros if it has not been ``solved`` for."""
    for i in range(nodes):
        at = lists[0] * (lists[0] + 2) + lists[1 + lists[0]] + k * nodes + i
        values[at] = ti.select(solved == 1, vectors[SOLUTION * nodes + i], 0.0)
    for m in range(lists[0]):
        set_sum(lists, values, vectors, m, nodes)
        total = values[lists[0] * lists[0] + m]
        values[m * lists[0] + k] = ti.select(solved == 1, total, 0.0)


class LowRank:
    """The correction by K columns of W, beginning at ``starts`` (K + 1,): ``weights`` (E,) at nodes ``index`` (E,)."""

    def __init__(self, starts: Array, index: Array, weights: Array, nodes: int, buffers: Buffers) -> None:
        self._rank, self._nodes, self._buffers = len(starts) - 1, nodes, buffers
        first = self._rank * (self._rank + 2)
        buffers.get("low_rank.values", first + len(weights) + self._rank * nodes)
        lists = np.concatenate([[self._rank], starts, index]).astype(np.int32)
        values = np.concatenate([np.zeros(first), weights])
        self.arrays = buffers.upload("low_rank.lists", lists), buffers.upload("low_rank.values", values)

    def solve(self, solved: Array, matrix: Array, cycle: Callable[[], None], vectors: Any) -> Array:
        """Find Y by the cycle, and the inverse; B + W^T Y (K, K) is returned.

        ``matrix`` (K, K) is B, ``solved`` (K,) masks the columns that have an effect; Y is 0 for the others. ``cycle``
        goes from the right-hand side to the solution in ``vectors``, those of the multigrid.
        """
        for k, there in enumerate(solved.tolist()):
            if there:
                launch(set_column, *self.arrays, vectors, k, self._nodes)
                cycle()
            launch(store_response, *self.arrays, vectors, k, int(there), self._nodes)
        total = matrix + download(self.arrays[1], self._rank**2).astype(float).reshape(matrix.shape)
        self._buffers.upload("low_rank.values", np.linalg.inv(total).ravel())
        return np.asarray(total)

    def correct(self, vectors: Any) -> None:
        """Correct the multigrid's solution in ``vectors``."""
        launch(correct, *self.arrays, vectors, self._nodes)
