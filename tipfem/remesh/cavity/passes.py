"""Kernels that pass over all cells or particles of a mesh: measures, rings of cells, and what spreads along edges."""

import taichi as ti

from tipfem.backend.array_types import Ints1, Ints2, Reals1, Reals2, Template
from tipfem.backend.launch import kernel
from tipfem.fem.element import measure_of

MEASURE, RING, SUM, SPREAD = 15.0, 5.0, 10.0, 120.0  # ns of a thread for each entry


@kernel
def measure(x: Reals2, cells: Ints2, out: Reals1, dim: Template, serial: Template):
    """Set the measure (M,) of each cell (M, d + 1), 0 for rows that never were in use."""
    ti.loop_config(serialize=serial)
    for t in range(cells.shape[0]):
        out[t] = 0.0
        if cells[t, 0] >= 0:
            out[t] = measure_of(x, cells, t, dim)


@kernel
def start_rings(cells: Ints2, label: Ints1, ring: Ints1, serial: Template):
    """Set ring (N,) of the particles in cells with a label above 0 to 0; all of them write the same."""
    ti.loop_config(serialize=serial)
    for t in range(cells.shape[0]):
        if label[t] > 0:
            for k in range(cells.shape[1]):
                ring[cells[t, k]] = 0


@kernel
def next_ring(cells: Ints2, label: Ints1, ring: Ints1, number: ti.i32, serial: Template):
    """Set ring (N,) to ``number`` + 1 where cells have particles in ring ``number`` and others beyond."""
    ti.loop_config(serialize=serial)
    for t in range(cells.shape[0]):
        if label[t] >= 0:
            near = False
            for k in range(cells.shape[1]):
                near = near or ring[cells[t, k]] == number
            if near:
                for k in range(cells.shape[1]):
                    if ring[cells[t, k]] > number + 1:
                        ring[cells[t, k]] = number + 1


@kernel
def sum_corners(cells: Ints2, values: Reals2, out: Reals2, count: ti.i32, width: Template, serial: Template):
    """Set the sums (M, C) of values (N, C) over the corners of ``count`` tetrahedra; C is ``width``."""
    ti.loop_config(serialize=serial)
    for t in range(count):
        for column in ti.static(range(width)):
            total = 0.0
            for k in ti.static(range(4)):
                total += values[cells[t, k], column]
            out[t, column] = total


@kernel
def spread(
    offsets: Ints1,
    corners: Ints1,
    rows: Ints1,
    sums: Reals2,
    before: Reals2,
    after: Reals2,
    count: ti.i32,
    width: Template,
    serial: Template,
):
    """Set after (count, C), of the particles and nodes of some ``rows``, to the mean of before (N + K, C) around each.

    The corners at each are in CSR, see `Mesh.incidence`; a neighbour counts once for each cell of both. ``sums`` are
    those of `sum_corners`.
    """
    ti.loop_config(serialize=serial)
    for i in range(count):
        p = rows[i]
        start, end = offsets[p], offsets[p + 1]
        total = ti.Vector.zero(ti.f64, width)
        for j in range(start, end):
            c = corners[j] // 4
            for column in ti.static(range(width)):
                total[column] += sums[c, column]
        for column in ti.static(range(width)):
            others = total[column] - (end - start) * before[p, column]
            after[i, column] = others / ti.max(3 * (end - start), 1)
