"""The connected parts of a graph."""

import numpy as np
import taichi as ti

from tipfem.backend.array_types import Ints1
from tipfem.backend.launch import kernel, launch
from tipfem.typing import Array


@ti.func
def _root(label: ti.template(), i):
    """Lowest node so far of the part of node ``i``, to which the nodes on the way are made to point."""
    while label[i] != label[label[i]]:
        label[i] = label[label[i]]
    return label[i]


@kernel
def _join(one: Ints1, other: Ints1, label: Ints1) -> ti.i32:
    """label (N,), the nodes' numbers before: the parts that edges join, by their lowest nodes. Returns how many."""
    count = 0
    ti.loop_config(serialize=True)
    for _ in range(1):
        for k in range(one.shape[0]):
            a, b = _root(label, one[k]), _root(label, other[k])
            label[ti.max(a, b)] = ti.min(a, b)
        for i in range(label.shape[0]):
            if label[i] == i:
                label[i] = -1 - count  # done; lower nodes are first
                count += 1
            else:
                label[i] = label[label[i]]
        for i in range(label.shape[0]):
            label[i] = -1 - label[i]
    return count


def connected_parts(count: int, one: Array, other: Array) -> tuple[int, Array]:
    """The parts of ``count`` nodes with edges from ``one`` (E,) to ``other`` (E,): how many, and each node's, int32.

    They are numbered by their lowest nodes.
    """
    label = np.arange(count, dtype=np.int32)
    ends = (np.ascontiguousarray(each, dtype=np.int32) for each in (one, other))
    return launch(_join, *ends, label), label


def parts_of_cells(cells: Array) -> tuple[int, Array]:
    """Parts of the cells (M, k) that share particles: how many, and each cell's (M,); numbered by their first cells."""
    _, number = np.unique(cells, return_inverse=True)
    number = number.reshape(cells.shape) + len(cells)
    row = np.repeat(np.arange(len(cells)), cells.shape[1])
    parts, label = connected_parts(number.max(initial=-1) + 1, row, number.ravel())
    return parts, label[: len(cells)]
