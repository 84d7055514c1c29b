"""A queue of changes to a triangulation, the most urgent first, so that what is done does not depend on any numbering.

Kernels that change a triangulation do so one change after the other, and a change may prevent another one. In the order
of the particles' or the cells' numbers, what they do would depend on the order in which a user lists the particles.
Instead each candidate has two keys, numbers of its geometry, and that with the largest first key comes first; of equal
ones that with the larger second key.
"""

from typing import NamedTuple

import taichi as ti

from tipfem.backend.array_types import Ints1, Reals2, Template
from tipfem.geometry.place import DIRECTION


class Queue(NamedTuple):
    """A binary heap in arrays; its size is kept by the caller."""

    keys: "Reals2"  # (S, 2) of the entries
    names: "Ints1"  # (S,) numbers that the caller gave them


@ti.func
def place(x: Template, n):
    """`tipfem.geometry.place.places` of particle n; the first two columns of x (N, 2 or more) are its position."""
    return DIRECTION[0] * x[n, 0] + DIRECTION[1] * x[n, 1]


@ti.func
def is_before(queue: Template, m, n):
    """Whether entry m comes before entry n."""
    one, other = queue.keys[m, 0], queue.keys[n, 0]
    return one > other or (one == other and queue.keys[m, 1] > queue.keys[n, 1])


@ti.func
def exchange(queue: Template, m, n):
    """Exchange two entries."""
    first, second, name = queue.keys[m, 0], queue.keys[m, 1], queue.names[m]
    queue.keys[m, 0], queue.keys[m, 1], queue.names[m] = queue.keys[n, 0], queue.keys[n, 1], queue.names[n]
    queue.keys[n, 0], queue.keys[n, 1], queue.names[n] = first, second, name


@ti.func
def push(queue: Template, size, key, second, name):
    """Add an entry to a queue of ``size`` entries that has room for it; returns its new size."""
    m = size
    queue.keys[m, 0], queue.keys[m, 1], queue.names[m] = key, second, name
    while m > 0 and is_before(queue, m, (m - 1) // 2):
        exchange(queue, m, (m - 1) // 2)
        m = (m - 1) // 2
    return size + 1


@ti.func
def drop_first(queue: Template, size):
    """Remove entry 0, the first of a queue of ``size`` > 0 entries; returns its new size."""
    left = size - 1
    exchange(queue, 0, left)
    m = 0
    going = True
    while going:
        first = m
        for side in ti.static(range(1, 3)):
            if 2 * m + side < left:
                if is_before(queue, 2 * m + side, first):
                    first = 2 * m + side
        going = first != m
        if going:
            exchange(queue, m, first)
            m = first
    return left
