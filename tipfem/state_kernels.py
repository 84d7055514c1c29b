"""Kernels that take a mesh and the state of its particles into a triangulation, and what particles carry out of it.

Arrays are those of `surgery`; the rows of ``state`` are those of `remeshing_kernels`.
"""

import taichi as ti

from tipfem.array_launch import on_arrays
from tipfem.flip_kernels import note_flips


@on_arrays
@ti.kernel
def gather(
    position: ti.types.ndarray(), velocity: ti.types.ndarray(), acceleration: ti.types.ndarray(),
    pressure: ti.types.ndarray(), wanted: ti.types.ndarray(), cells: ti.types.ndarray(), across: ti.types.ndarray(),
    fluid: ti.types.ndarray(), measure: ti.types.ndarray(), density: ti.types.ndarray(), mass: ti.types.ndarray(),
    state: ti.types.ndarray(), corner: ti.types.ndarray(), stale: ti.types.ndarray(), particles: ti.i32,
    elements: ti.i32, slack: ti.f64, alone: ti.template(),
):  # fmt: skip
    """The rows of ``state`` from the particles' arrays, targets ``wanted`` (N,), and masses; ``corner`` (N,) is the
    last cell at each. ``mass`` (N,) is scratch. ``stale`` (M,), zero before: see `flip_kernels.find_flips`."""
    ti.loop_config(serialize=True)
    for n in range(particles):
        mass[n], corner[n] = 0.0, -1
    ti.loop_config(serialize=True)
    for t in range(elements):
        share = density[fluid[t]] * measure[t] / 3.0
        for k in ti.static(range(3)):
            n = cells[t, k]
            mass[n] = mass[n] + share
            corner[n] = t
    ti.loop_config(serialize=alone)
    for t in range(elements):
        note_flips(position, cells, across, fluid, stale, t, slack)
    ti.loop_config(serialize=alone)
    for n in range(particles):
        for k in ti.static(range(2)):
            state[n, k] = position[n, k]
            state[n, 2 + k] = velocity[n, k]
            state[n, 4 + k] = acceleration[n, k]
        state[n, 6], state[n, 7], state[n, 8] = pressure[n], mass[n], wanted[n]


@on_arrays
@ti.kernel
def scatter(
    state: ti.types.ndarray(), velocity: ti.types.ndarray(), acceleration: ti.types.ndarray(),
    pressure: ti.types.ndarray(), wanted: ti.types.ndarray(), particles: ti.i32,
):  # fmt: skip
    """What `gather` did to the rows, undone."""
    ti.loop_config(serialize=True)
    for n in range(particles):
        for k in ti.static(range(2)):
            velocity[n, k] = state[n, 2 + k]
            acceleration[n, k] = state[n, 4 + k]
        pressure[n], wanted[n] = state[n, 6], state[n, 8]
