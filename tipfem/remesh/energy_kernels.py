"""Kernels that sum energy and momentum over the cells of a mesh."""

import taichi as ti

from tipfem.backend.array_types import Ints2, Reals1, Reals2, Template
from tipfem.backend.launch import kernel, part_of
from tipfem.fem.element import row


@kernel
def cell_sums(
    position: Reals2,
    velocity: Reals2,
    cells: Ints2,
    mass: Reals2,
    lumping: Reals1,
    gravity: Reals1,
    partial: Reals2,
    result: Reals1,
    dim: Template,
    parts: ti.i32,
    stride: Template,
):
    """Sums over the cells, for each fluid in turn 2 + d of them added to result (F (2 + d),).

    mass (M, F) of each cell by fluid [kg]; lumping (M,), see `tipfem.fem.mass.lumped_part`. The sums are the kinetic
    energy and -m x . gravity [J], and m v in each direction [N s].
    """
    for t in range(parts * stride):
        width = 2 + dim
        if t % stride == 0:
            for k in range(mass.shape[1] * width):
                partial[t // stride, k] = 0.0
        first, last = part_of(t, parts, stride, cells.shape[0])
        for c in range(first, last):
            energy, height, momentum = 0.0, 0.0, ti.Vector.zero(float, dim)
            for a in ti.static(range(dim + 1)):
                x, v = row(position, cells[c, a], dim), row(velocity, cells[c, a], dim)
                energy += 0.5 * v.dot(v) / (dim + 1)
                momentum += v / (dim + 1)
                for k in ti.static(range(dim)):
                    height -= gravity[k] * x[k] / (dim + 1)
            for a in ti.static(range(dim + 1)):
                apart = row(velocity, cells[c, a], dim) - momentum
                energy -= (1.0 - lumping[c]) * 0.5 * apart.dot(apart) / (dim + 1)
            for f in range(mass.shape[1]):
                partial[t // stride, f * width] += mass[c, f] * energy
                partial[t // stride, f * width + 1] += mass[c, f] * height
                for k in ti.static(range(dim)):
                    partial[t // stride, f * width + 2 + k] += mass[c, f] * momentum[k]
    ti.loop_config(serialize=True)
    for c in range(parts):
        for k in range(result.shape[0]):
            result[k] = result[k] + partial[c, k]


@kernel
def field_energy(
    position: Reals2,
    velocity: Reals2,
    cells: Ints2,
    mass: Reals1,
    gravity: Reals1,
    lumping: Reals1,
    partial: Reals2,
    result: Reals1,
    parts: ti.i32,
    stride: Template,
):
    """Energies of triangles of mass (M,), added to result (3,) [J, per metre of depth].

    int rho |v|^2 / 2 of the velocity that is linear in each triangle; v^T M v / 2 with the part lumping (M,) of the
    mass matrix lumped, see `tipfem.fem.mass`; and -m x . gravity.
    """
    for t in range(parts * stride):
        kinetic, of_matrix, potential = 0.0, 0.0, 0.0
        first, last = part_of(t, parts, stride, cells.shape[0])
        for c in range(first, last):
            squares, total = 0.0, ti.Vector.zero(float, 2)
            for a in ti.static(range(3)):
                x, v = row(position, cells[c, a], 2), row(velocity, cells[c, a], 2)
                squares += v.dot(v)
                total += v
                potential -= mass[c] * (gravity[0] * x[0] + gravity[1] * x[1]) / 3.0
            mean = total.dot(total) / 3.0
            kinetic += mass[c] * (0.25 * squares + 0.75 * mean) / 6.0
            of_matrix += mass[c] * (lumping[c] * squares + (1.0 - lumping[c]) * mean) / 6.0
        if t % stride == 0:
            partial[t // stride, 0], partial[t // stride, 1], partial[t // stride, 2] = kinetic, of_matrix, potential
    ti.loop_config(serialize=True)
    for c in range(parts):
        for k in ti.static(range(3)):
            result[k] = result[k] + partial[c, k]
