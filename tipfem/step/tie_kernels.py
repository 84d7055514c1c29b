"""Kernels that tie the copies of particles on interfaces to their particles, see `tipfem.step.interface_ties`.

Vectors of unknowns are laid out as in `tipfem.fem.residual`, on the nodes of a cut mesh: the N particles, and behind
them their copies. ``ties`` has the tied particles and their copies as in `tipfem.linalg.multigrid.mesh_transfer`. A
vector may begin at ``start`` in its array.
"""

import taichi as ti

from tipfem.backend.array_types import Ints1, Reals1, Template
from tipfem.backend.launch import kernel
from tipfem.linalg.multigrid.mesh_transfer import copies_of, tied_node

TIE, ROW = 10.0, 20.0  # nanoseconds of one thread for a tied particle, and for a row of the Laplacian


@ti.func
def spread_tie(ties: Template, t, x: Template, start, dim: Template):
    """Give the copies of tied particle number ``t`` its displacement."""
    own = start + tied_node(ties, t) * (dim + 1)
    first, last = copies_of(ties, t)
    for j in range(first, last):
        for k in ti.static(range(dim)):
            x[start + j * (dim + 1) + k] = x[own + k]


@ti.func
def collect_tie(ties: Template, t, x: Template, start, dim: Template):
    """Add the momentum rows of the copies of tied particle number ``t`` to its own, and make them zero."""
    own = start + tied_node(ties, t) * (dim + 1)
    first, last = copies_of(ties, t)
    for k in ti.static(range(dim)):
        total = x[own + k]
        for j in range(first, last):
            total += x[start + j * (dim + 1) + k]
            x[start + j * (dim + 1) + k] = 0.0
        x[own + k] = total


@ti.func
def clear_tie(ties: Template, t, x: Template, start, dim: Template):
    """Set the displacements of the copies of tied particle number ``t`` to zero."""
    first, last = copies_of(ties, t)
    for j in range(first, last):
        for k in ti.static(range(dim)):
            x[start + j * (dim + 1) + k] = 0.0


@kernel
def join_scales(ties: Ints1, scale: Reals1, count: ti.i32, dim: Template, serial: Template):
    """The scale of the momentum rows of ``count`` tied particles and their copies: one over the sum of 1 / scale.

    Rows of particles whose displacement is prescribed have the scale 0, and keep it.
    """
    ti.loop_config(serialize=serial)
    for t in range(count):
        first, last = copies_of(ties, t)
        for k in ti.static(range(dim)):
            own = tied_node(ties, t) * (dim + 1) + k
            if scale[own] > 0.0:
                diagonal = 1.0 / scale[own]
                for j in range(first, last):
                    diagonal += 1.0 / scale[j * (dim + 1) + k]
                scale[own] = 1.0 / diagonal
        spread_tie(ties, t, scale, 0, dim)


@kernel
def spread(ties: Ints1, x: Reals1, count: ti.i32, dim: Template, serial: Template):
    """Give copies the displacements of their particles: x = T x."""
    ti.loop_config(serialize=serial)
    for t in range(count):
        spread_tie(ties, t, x, 0, dim)


@kernel
def collect(ties: Ints1, x: Reals1, count: ti.i32, dim: Template, serial: Template):
    """Add the copies' momentum rows to those of their particles, and make them zero: x = T^T x."""
    ti.loop_config(serialize=serial)
    for t in range(count):
        collect_tie(ties, t, x, 0, dim)


@kernel
def clear(ties: Ints1, x: Reals1, count: ti.i32, dim: Template, serial: Template):
    """Zero displacements of the copies."""
    ti.loop_config(serialize=serial)
    for t in range(count):
        clear_tie(ties, t, x, 0, dim)


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
    serial: Template,
):
    """count[i + 1] (N + 1,): number of columns of row i of the sum of two matrices in CSR; see `merge_rows`."""
    ti.loop_config(serialize=serial)
    for i in range(nodes):
        if i == 0:
            count[0] = 0
        last = row_offsets[i + 1]
        number = last - row_offsets[i]
        for s in range(added_offsets[i], added_offsets[i + 1]):
            if find_column(columns, row_offsets[i], last, added_columns[s]) == last:
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
    serial: Template,
):
    """The sum of two matrices in CSR: columns of the first keep their order, those of the second alone follow.

    ``new_offsets`` as from `count_merged`.
    """
    ti.loop_config(serialize=serial)
    for i in range(nodes):
        first, own = new_offsets[i], row_offsets[i]
        end = first + row_offsets[i + 1] - own
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
