"""Kernel of the pressures that are given at openings, see `tipfem.physics.openings.term`."""

import taichi as ti

from tipfem.backend.array_types import Ints1, Reals1, Reals2, Template
from tipfem.backend.launch import kernel

FORCE = 5.0  # nanoseconds of one thread for a particle in `add_forces`


@kernel
def add_forces(
    particles: Ints1, force: Reals2, scale: Reals1, out: Reals1, count: ti.i32, dim: Template, serial: Template
):
    """Subtract forces (count, d) on some particles from their scaled momentum rows."""
    ti.loop_config(serialize=serial)
    for s in range(count):
        for k in ti.static(range(dim)):
            row = particles[s] * (dim + 1) + k
            out[row] = out[row] - scale[row] * force[s, k]
