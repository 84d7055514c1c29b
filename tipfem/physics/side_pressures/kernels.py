"""Kernels of particles on interfaces and their copies, see `tipfem.physics.side_pressures.term`.

``ties`` has the tied particles and their copies as in `tipfem.linalg.multigrid.mesh_transfer`.
"""

import taichi as ti

from tipfem.backend.array_types import Ints1, Reals1, Template
from tipfem.backend.launch import kernel
from tipfem.linalg.multigrid.mesh_transfer import copies_of, tied_node

TIE = 10.0  # nanoseconds of one thread for a tied particle


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


@kernel
def copy_scales(ties: Ints1, scale: Reals1, count: ti.i32, dim: Template, serial: Template):
    """Give the momentum rows of copies the scale of their particles'."""
    ti.loop_config(serialize=serial)
    for t in range(count):
        first, last = copies_of(ties, t)
        for j in range(first, last):
            for k in ti.static(range(dim)):
                scale[j * (dim + 1) + k] = scale[tied_node(ties, t) * (dim + 1) + k]
