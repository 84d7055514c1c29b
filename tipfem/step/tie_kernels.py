"""Kernels that tie the copies of particles on interfaces to their particles, see `tipfem.step.interface_ties`.

Vectors of unknowns are laid out as in `tipfem.fem.residual`, on the nodes of a cut mesh: the ``particles``, of which
there are that many, and behind them their copies. ``count`` particles have copies, those in ``tied``; the copies of
tied[t] are the nodes from particles + copies[t] on, before particles + copies[t + 1].
"""

import taichi as ti

from tipfem.backend.array_types import Ints1, Reals1, Template
from tipfem.backend.launch import kernel

TIE, ROW = 10.0, 20.0  # nanoseconds of one thread for a tied particle, and for a row of the Laplacian


@kernel
def join_scales(
    tied: Ints1, copies: Ints1, scale: Reals1, particles: ti.i32, count: ti.i32, dim: Template, serial: Template
):
    """The scale of the momentum rows of ``count`` tied particles and their copies: one over the sum of 1 / scale.

    Rows of particles whose displacement is prescribed have the scale 0, and keep it.
    """
    ti.loop_config(serialize=serial)
    for t in range(count):
        for k in ti.static(range(dim)):
            own = tied[t] * (dim + 1) + k
            if scale[own] > 0.0:
                diagonal = 1.0 / scale[own]
                for j in range(particles + copies[t], particles + copies[t + 1]):
                    diagonal += 1.0 / scale[j * (dim + 1) + k]
                scale[own] = 1.0 / diagonal


@kernel
def spread(tied: Ints1, copies: Ints1, x: Reals1, particles: ti.i32, count: ti.i32, dim: Template, serial: Template):
    """Give copies the displacements of their particles: x = T x."""
    ti.loop_config(serialize=serial)
    for t in range(count):
        for j in range(particles + copies[t], particles + copies[t + 1]):
            for k in ti.static(range(dim)):
                x[j * (dim + 1) + k] = x[tied[t] * (dim + 1) + k]


@kernel
def collect(tied: Ints1, copies: Ints1, x: Reals1, particles: ti.i32, count: ti.i32, dim: Template, serial: Template):
    """Add the copies' momentum rows to those of their particles, and make them zero: x = T^T x."""
    ti.loop_config(serialize=serial)
    for t in range(count):
        for k in ti.static(range(dim)):
            own = tied[t] * (dim + 1) + k
            total = x[own]
            for j in range(particles + copies[t], particles + copies[t + 1]):
                total += x[j * (dim + 1) + k]
                x[j * (dim + 1) + k] = 0.0
            x[own] = total


@kernel
def clear(copies: Ints1, x: Reals1, particles: ti.i32, count: ti.i32, dim: Template, serial: Template):
    """Zero displacements of the copies."""
    ti.loop_config(serialize=serial)
    for j in range(particles, particles + copies[count]):
        for k in ti.static(range(dim)):
            x[j * (dim + 1) + k] = 0.0


@kernel
def add_springs(
    row_offsets: Ints1,
    columns: Ints1,
    values: Reals1,
    spring_offsets: Ints1,
    spring_columns: Ints1,
    stiffness: Reals1,
    new_offsets: Ints1,
    new_columns: Ints1,
    new_values: Reals1,
    nodes: ti.i32,
    serial: Template,
):
    """A Laplacian in CSR with springs between its nodes; those of row i are from spring_offsets[i] on.

    The first entry of each row is that on the diagonal, and stays so; the springs become the last ones.
    """
    ti.loop_config(serialize=serial)
    for i in range(nodes):
        if i == 0:
            new_offsets[0] = 0
        new_offsets[i + 1] = row_offsets[i + 1] + spring_offsets[i + 1]
        first = row_offsets[i] + spring_offsets[i]
        number = row_offsets[i + 1] - row_offsets[i]
        for s in range(number):
            new_columns[first + s] = columns[row_offsets[i] + s]
            new_values[first + s] = values[row_offsets[i] + s]
        for s in range(spring_offsets[i], spring_offsets[i + 1]):
            new_columns[first + number + s - spring_offsets[i]] = spring_columns[s]
            new_values[first + number + s - spring_offsets[i]] = -stiffness[s]
            new_values[first] = new_values[first] + stiffness[s]
