"""Kernels of linear equations of a term: a matrix of few rows, added to the residual and the Jacobian.

The matrix is in CSR by blocks of d + 1 rows and columns, with the rows of R nodes, ``rows``, alone. Unknowns are
interleaved as in `tipfem.fem.residual`, and so are the rows of each block: d of momentum, one of continuity.
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
    dim: Template,
    serial: Template,
):
    """Add the matrix to a Jacobian in rows of ``nodes`` that has its columns, scaled."""
    ti.loop_config(serialize=serial)
    for r in range(count):
        i, couplings = rows[r], matrix.row_offsets[nodes]
        for s in range(offsets[r], offsets[r + 1]):
            at = find_column(matrix.columns, matrix.row_offsets[i], matrix.row_offsets[i + 1], columns[s])
            for k in ti.static(range(dim + 1)):
                for m in ti.static(range(dim + 1)):
                    place = block_entry(couplings, at, k, m, dim)
                    value = scale[(dim + 1) * i + k] * values[(dim + 1) ** 2 * s + (dim + 1) * k + m]
                    matrix.values[place] = matrix.values[place] + value


@kernel
def add_diagonal(
    rows: Ints1,
    offsets: Ints1,
    columns: Ints1,
    values: Reals1,
    scale: Reals1,
    count: ti.i32,
    dim: Template,
    serial: Template,
):
    """Make the scale of momentum rows one over the sum of 1 / scale and the diagonal of the matrix."""
    ti.loop_config(serialize=serial)
    for r in range(count):
        i = rows[r]
        at = find_column(columns, offsets[r], offsets[r + 1], i)
        for k in ti.static(range(dim)):
            row = (dim + 1) * i + k
            if at < offsets[r + 1] and scale[row] > 0.0:
                scale[row] = 1.0 / (1.0 / scale[row] + values[(dim + 1) ** 2 * at + (dim + 2) * k])


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
    dim: Template,
    serial: Template,
):
    """Add the matrix times ``x`` and a constant ((d + 1) R,) to ``out``, scaled."""
    ti.loop_config(serialize=serial)
    for r in range(count):
        i = rows[r]
        for k in ti.static(range(dim + 1)):
            total = constant[(dim + 1) * r + k]
            for s in range(offsets[r], offsets[r + 1]):
                for m in ti.static(range(dim + 1)):
                    entry = (dim + 1) ** 2 * s + (dim + 1) * k + m
                    total += values[entry] * x[(dim + 1) * columns[s] + m]
            row = (dim + 1) * i + k
            out[row] = out[row] + scale[row] * total
