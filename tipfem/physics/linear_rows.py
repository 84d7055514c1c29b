"""Kernels of linear equations of a term: a matrix of few rows, added to the residual and the Jacobian; 2-D.

The matrix is in CSR by blocks of 3 x 3, with the rows of R nodes, ``rows``, alone. Unknowns are interleaved as in
`tipfem.fem.residual`, and so are the rows of each block: two of momentum, one of continuity.
"""

import taichi as ti

from tipfem.backend.array_types import Ints1, Reals1, Template
from tipfem.backend.launch import kernel
from tipfem.fem.jacobian import block_entry
from tipfem.linalg.sparsity import Csr, find_column

ROW = 60.0  # nanoseconds of one thread for a row


@kernel
def add_blocks(
    rows: Ints1,
    offsets: Ints1,
    columns: Ints1,
    values: Reals1,
    scale: Reals1,
    matrix: Csr,
    nodes: ti.i32,
    count: ti.i32,
    serial: Template,
):
    """Add the matrix to a Jacobian in rows of ``nodes`` that has its columns, scaled."""
    ti.loop_config(serialize=serial)
    for r in range(count):
        i, couplings = rows[r], matrix.row_offsets[nodes]
        for s in range(offsets[r], offsets[r + 1]):
            at = find_column(matrix.columns, matrix.row_offsets[i], matrix.row_offsets[i + 1], columns[s])
            for k in ti.static(range(3)):
                for m in ti.static(range(3)):
                    place = block_entry(couplings, at, k, m, 2)
                    matrix.values[place] = matrix.values[place] + scale[3 * i + k] * values[9 * s + 3 * k + m]


@kernel
def add_diagonal(
    rows: Ints1,
    offsets: Ints1,
    columns: Ints1,
    values: Reals1,
    scale: Reals1,
    count: ti.i32,
    serial: Template,
):
    """Make the scale of momentum rows one over the sum of 1 / scale and the diagonal of the matrix."""
    ti.loop_config(serialize=serial)
    for r in range(count):
        i = rows[r]
        at = find_column(columns, offsets[r], offsets[r + 1], i)
        for k in ti.static(range(2)):
            if at < offsets[r + 1] and scale[3 * i + k] > 0.0:
                scale[3 * i + k] = 1.0 / (1.0 / scale[3 * i + k] + values[9 * at + 4 * k])


@kernel
def add_product(
    rows: Ints1,
    offsets: Ints1,
    columns: Ints1,
    values: Reals1,
    constant: Reals1,
    scale: Reals1,
    x: Reals1,
    out: Reals1,
    count: ti.i32,
    serial: Template,
):
    """Add the matrix times ``x`` and a constant (3 R,) to ``out``, scaled."""
    ti.loop_config(serialize=serial)
    for r in range(count):
        i = rows[r]
        for k in ti.static(range(3)):
            total = constant[3 * r + k]
            for s in range(offsets[r], offsets[r + 1]):
                for m in ti.static(range(3)):
                    total += values[9 * s + 3 * k + m] * x[3 * columns[s] + m]
            out[3 * i + k] = out[3 * i + k] + scale[3 * i + k] * total
