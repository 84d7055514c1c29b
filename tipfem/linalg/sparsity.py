"""Kernels that list the cells and the neighbours of each particle.

Lists of lists are CSR: ``offsets`` (N + 1,) says where the list of each particle begins. The order within a list does
not depend on the number of threads, so that sums over it are repeatable bit by bit.
"""

from typing import Any, NamedTuple

import numpy as np
import taichi as ti

from tipfem.backend.array_types import Ints1, Ints2, Longs1, Reals1, Reals2, Template
from tipfem.backend.arrays import Buffers, download
from tipfem.backend.launch import FEW_PARTS, kernel, launch, part_of, parts, shared_by_gpu
from tipfem.backend.runtime import on_gpu
from tipfem.typing import Array

# Nanoseconds of one thread for a particle in `find_neighbours`.
NEIGHBOURS = 80.0
MERGED_ROW = 20.0  # and for a row in `count_merged` and `merge_rows`
SUMMED = 1.0  # and for an entry in `running_sums`


@kernel
def _add_runs(values: Reals2, order: Longs1, first: Longs1, sums: Reals2):
    """Add to sums (F, c), zero before, rows (E, c) of values; see `sums_of_runs`."""
    ti.loop_config(serialize=True)
    for f in range(first.shape[0]):
        end = order.shape[0]
        if f + 1 < first.shape[0]:
            end = first[f + 1]
        for j in range(first[f], end):
            for k in range(values.shape[1]):
                sums[f, k] += values[order[j], k]


def sums_of_runs(values: Array, order: Array, first: Array) -> Array:
    """Sums (F, c) of the rows (E, c) with numbers ``order`` (E,) from each of the places ``first`` (F,) to the next."""
    sums = np.zeros((len(first), values.shape[1]))
    launch(_add_runs, values, order, first, sums)
    return sums


def run_starts(values: Array) -> Array:
    """First indices of runs of equal values (K,), ascending."""
    begins = np.ones(len(values), dtype=bool)
    np.not_equal(values[1:], values[:-1], out=begins[1:])
    return begins.nonzero()[0]


class Csr(NamedTuple):
    """A matrix in CSR on the device."""

    row_offsets: "Ints1"  # (N + 1,): where the rows begin
    columns: "Ints1"  # (K,)
    values: "Reals1"  # (K,), or (K b,) for a matrix of blocks of b values, block after block


@ti.func
def post_increment(cursor: Template, i, serial: Template):
    """Add one to cursor[i], and return its value before; atomic unless the loop is ``serial``."""
    value = 0
    if ti.static(serial):
        value = cursor[i]
        cursor[i] = value + 1
    else:
        value = ti.atomic_add(cursor[i], 1)
    return value


@ti.func
def _sum_counts(counts: Template, first, last):
    """Sum of counts[first + 1:last + 1]."""
    total = 0
    for i in range(first, last):
        total += counts[i + 1]
    return total


@kernel
def sum_up(
    counts: Ints1,
    cursor: Ints1,
    partial: Ints1,
    last_sum: Ints1,
    n: ti.i32,
    parts: ti.i32,
    stride: Template,
    serial: Template,
):
    """See `running_sums`; ``partial`` (parts + FEW_PARTS,) is scratch."""
    ti.loop_config(serialize=serial)
    for t in range(parts * stride):
        first, last = part_of(t, parts, stride, n)
        if t % stride == 0:
            partial[t // stride] = _sum_counts(counts, first, last)
    if ti.static(shared_by_gpu(stride, serial)):  # so that no thread adds up thousands of parts
        for block in range(FEW_PARTS):
            first, last = part_of(block, FEW_PARTS, 1, parts)
            partial[parts + block] = _sum_counts(partial, first - 1, last - 1)
    ti.loop_config(serialize=serial)
    for t in range(parts * stride):
        first, last = part_of(t, parts, stride, n)
        if first < last:
            total, own = counts[0], 0
            if ti.static(shared_by_gpu(stride, serial)):
                block = t // ((parts + FEW_PARTS - 1) // FEW_PARTS)
                total += _sum_counts(partial, parts - 1, parts + block - 1)
                own = block * ((parts + FEW_PARTS - 1) // FEW_PARTS)
            total += _sum_counts(partial, own - 1, t // stride - 1)
            for i in range(first, last):
                cursor[i] = total
                total += counts[i + 1]
                counts[i + 1] = total
            if last == n:
                last_sum[0] = total
        if t == 0 and n == 0:
            last_sum[0] = counts[0]


def running_sums(counts: Any, n: int, buffers: Buffers, cursor: Any = None, most: int | None = None) -> int:
    """Replace counts[:n + 1] on the device by its running sums, and return the last.

    So numbers of entries become the places where lists end, each behind that where it begins. ``cursor`` (n,) takes all
    sums but the last. A GPU returns ``most`` instead of the last, which the host would wait to read.
    """
    cursor = buffers.get("running_sums.cursor", n, integer=True) if cursor is None else cursor
    partial = buffers.get("running_sums.partial", parts() + FEW_PARTS, integer=True)
    last_sum = buffers.get("running_sums.last", 1, integer=True)
    launch(sum_up, counts, cursor, partial, last_sum, n, work=(n, SUMMED))
    return int(download(last_sum, 1)[0]) if most is None or not on_gpu() else most


@kernel
def count_corners(cells: Ints2, counts: Ints1, elements: ti.i32, nodes: ti.i32, width: ti.i32, one_counts: Template):
    """counts[i + 1] (N + 1,): of how many cells particle i is a corner; counts[0] = 0. Cells may have gaps, -1."""
    ti.loop_config(serialize=one_counts)
    for i in range(nodes + 1):
        counts[i] = 0
    ti.loop_config(serialize=one_counts)
    for e in range(elements):
        for a in range(width):
            if cells[e, a] >= 0:
                post_increment(counts, cells[e, a] + 1, one_counts)


@kernel
def place_corners(
    cells: Ints2,
    offsets: Ints1,
    cursor: Ints1,
    corners: Ints1,
    elements: ti.i32,
    nodes: ti.i32,
    width: ti.i32,
    one_counts: Template,
):
    """See `list_corners`; ``cursor`` (N,): where the lists begin."""
    ti.loop_config(serialize=one_counts)
    for e in range(elements):
        for a in range(width):
            if cells[e, a] >= 0:
                corners[post_increment(cursor, cells[e, a], one_counts)] = e * width + a
    if ti.static(not one_counts):
        for i in range(nodes):
            insertion_sort(corners, offsets[i], offsets[i + 1])


def list_corners(cells: Any, offsets: Any, corners: Any, shape: tuple[int, int], nodes: int, buffers: Buffers) -> None:
    """For each particle the corners e * width + a of cells e (M, width) that it is, in ascending order.

    Entries of the cells that are -1 are no corners. ``offsets`` (N + 1,) takes the beginnings of the lists, ``corners``
    (M width,) the lists.
    """
    (elements, width), cursor = shape, buffers.get("running_sums.cursor", nodes, integer=True)
    launch(count_corners, cells, offsets, elements, nodes, width)
    running_sums(offsets, nodes, buffers, cursor, most=elements * width)
    launch(place_corners, cells, offsets, cursor, corners, elements, nodes, width)


@ti.func
def insertion_sort(values: Template, first, last):
    """Sort values[first:last] in place; for short ranges."""
    for s in range(first + 1, last):
        value = values[s]
        t = s
        while t > first and values[ti.max(t - 1, first)] > value:
            values[t] = values[t - 1]
            t -= 1
        values[t] = value


def most_neighbours(nodes: int, dim: int) -> int | None:
    """Bound on what `find_neighbours` finds: in 2-D three edges per node, also on cylinders and tori; None in 3-D."""
    return 7 * nodes if dim == 2 else None


@ti.func
def corner_after(own, k, dim: Template):
    """The corner of a cell that follows corner ``own`` by ``k``, cyclically."""
    b = own + k
    return b - ti.select(b > dim, dim + 1, 0)


@kernel
def find_neighbours(
    cells: Ints2,
    offsets: Ints1,
    corners: Ints1,
    padded: Ints1,
    count: Ints1,
    slots: Ints1,
    nodes: ti.i32,
    dim: Template,
    serial: Template,
):
    """The particles that share a cell with each particle, itself included.

    count[i + 1] (N + 1,): how many there are. ``padded``: the lists with gaps between them; that of particle i starts
    at dim * offsets[i] + i with i itself, and the others follow in the order of its cells. slots (M (d + 1) d,): for
    each entry c of ``corners``, where in that list the other particles of its cell are; entry c * d + k - 1
    is for the particle at `corner_after` by k. ``offsets`` and ``corners`` as from `list_corners`.
    """
    ti.loop_config(serialize=serial)
    for i in range(nodes):
        first = dim * offsets[i] + i
        n = 1
        padded[first] = i
        for c in range(offsets[i], offsets[i + 1]):
            e = corners[c] // (dim + 1)
            own = corners[c] - e * (dim + 1)
            for k in ti.static(range(1, dim + 1)):
                j = cells[e, corner_after(own, k, dim)]
                padded[first + n] = j  # so that the search ends
                s = 1
                while padded[first + s] != j:
                    s += 1
                if s == n:
                    n += 1
                slots[c * dim + k - 1] = s
        count[i + 1] = n
        if i == 0:
            count[0] = 0


@ti.func
def find_column(columns: Template, first, last, column):
    """Place of ``column`` in columns[first:last]; ``last`` if it is not there."""
    s = first
    while s < last:
        if columns[s] == column:
            break
        s += 1
    return s


@kernel
def count_merged(
    row_offsets: Ints1,
    columns: Ints1,
    added_offsets: Ints1,
    added_columns: Ints1,
    count: Ints1,
    nodes: ti.i32,
    rows: ti.i32,
    serial: Template,
):
    """count[i + 1] (R + 1,): number of columns of row i of the sum of two matrices in CSR; see `merge_rows`."""
    ti.loop_config(serialize=serial)
    for i in range(rows):
        if i == 0:
            count[0] = 0
        first, last = row_offsets[ti.min(i, nodes)], row_offsets[ti.min(i + 1, nodes)]
        number = last - first
        for s in range(added_offsets[i], added_offsets[i + 1]):
            if find_column(columns, first, last, added_columns[s]) == last:
                number += 1
        count[i + 1] = number


@kernel
def merge_rows(
    row_offsets: Ints1,
    columns: Ints1,
    values: Reals1,
    added_offsets: Ints1,
    added_columns: Ints1,
    added: Reals1,
    new_offsets: Ints1,
    new_columns: Ints1,
    new_values: Reals1,
    nodes: ti.i32,
    rows: ti.i32,
    serial: Template,
):
    """The sum of two matrices in CSR: columns of the first keep their order, those of the second alone follow.

    The first has ``nodes`` rows, the second and the sum have ``rows``. ``new_offsets`` as from `count_merged`.
    """
    ti.loop_config(serialize=serial)
    for i in range(rows):
        first, own = new_offsets[i], row_offsets[ti.min(i, nodes)]
        end = first + row_offsets[ti.min(i + 1, nodes)] - own
        for s in range(first, end):
            new_columns[s] = columns[own + s - first]
            new_values[s] = values[own + s - first]
        for s in range(added_offsets[i], added_offsets[i + 1]):
            at = find_column(new_columns, first, end, added_columns[s])
            if at == end:
                end += 1
                new_columns[at] = added_columns[s]
                new_values[at] = 0.0
            new_values[at] = new_values[at] + added[s]


@kernel
def merge_columns(
    row_offsets: Ints1,
    columns: Ints1,
    added_offsets: Ints1,
    added_columns: Ints1,
    new_offsets: Ints1,
    new_columns: Ints1,
    nodes: ti.i32,
    rows: ti.i32,
    serial: Template,
):
    """The columns of `merge_rows`."""
    ti.loop_config(serialize=serial)
    for i in range(rows):
        first, own = new_offsets[i], row_offsets[ti.min(i, nodes)]
        end = first + row_offsets[ti.min(i + 1, nodes)] - own
        for s in range(first, end):
            new_columns[s] = columns[own + s - first]
        for s in range(added_offsets[i], added_offsets[i + 1]):
            at = find_column(new_columns, first, end, added_columns[s])
            if at == end:
                end += 1
                new_columns[at] = added_columns[s]
