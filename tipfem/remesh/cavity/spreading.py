"""Kernel by which what particles at a surface have spreads among the nodes of empty space."""

import taichi as ti

from tipfem.backend.array_types import Ints1, Ints2, Reals2, Template
from tipfem.backend.launch import kernel

SPREAD = 300  # operations for a node


@kernel
def spread(
    cells: Ints2,
    offsets: Ints1,
    corners: Ints1,
    before: Reals2,
    after: Reals2,
    first: ti.i32,
    count: ti.i32,
    width: Template,
    serial: Template,
):
    """Set after (count, C), values of the nodes from ``first`` on, to the mean of before (N + count, C) around each.

    C is ``width``. The corners at each particle are in CSR, see `Mesh.incidence`; a neighbour counts once for each cell
    of both.
    """
    ti.loop_config(serialize=serial)
    for i in range(count):
        start, end = offsets[first + i], offsets[first + i + 1]
        total = ti.Vector.zero(ti.f64, width)
        for j in range(start, end):
            c, local = corners[j] // 4, corners[j] % 4
            for k in ti.static(range(4)):
                if k != local:
                    p = cells[c, k]
                    for column in ti.static(range(width)):
                        total[column] += before[p, column]
        for column in ti.static(range(width)):
            after[i, column] = total[column] / ti.max(3 * (end - start), 1)
