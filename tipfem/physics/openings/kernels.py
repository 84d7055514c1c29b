"""Kernels of openings: the pressures that are given at them, the cells that are near, and places within cells."""

import taichi as ti

from tipfem.backend.array_types import Flags1, Ints1, Ints2, Periods, Reals1, Reals2, Template
from tipfem.backend.launch import kernel
from tipfem.backend.periodic import radius
from tipfem.fem.element import parts_of

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


@kernel
def list_near(cells: Ints2, count: ti.i32, chosen: Flags1, near: Flags1, found: Ints1) -> ti.i32:
    """List in ``found`` (M,) the cells with a corner on a cell that has one of the ``chosen`` (N,); how many.

    near (N,), zero before, is 1 for the corners of the cells that have a chosen one.
    """
    ti.loop_config(serialize=True)
    for c in range(count):
        a, b, other = cells[c, 0], cells[c, 1], cells[c, 2]
        if chosen[a] + chosen[b] + chosen[other] > 0:
            near[a] = ti.i8(1)
            near[b] = ti.i8(1)
            near[other] = ti.i8(1)
    listed = 0
    ti.loop_config(serialize=True)
    for c in range(count):
        if near[cells[c, 0]] + near[cells[c, 1]] + near[cells[c, 2]] > 0:
            found[listed] = c
            listed += 1
    return listed


@kernel
def find_places(
    cells: Ints2,
    among: Ints1,
    count: ti.i32,
    row: Ints1,
    position: Reals2,
    goal: Reals2,
    least: Reals1,
    found: Ints2,
    weight: Reals2,
):
    """Find in which of their own cells places of particles are, or are nearest to: by the largest least coordinate.

    among (C,): numbers of the cells of these particles; row (N,): their numbers among the K, -1 for others; goal (N,
    2): the places [m]. least (K,), minus infinity before: the least barycentric coordinate; found and weight (K, 3):
    the corners of the cell and the barycentric coordinates.
    """
    ti.loop_config(serialize=True)
    for c in range(count):
        corner = ti.Vector([cells[among[c], k] for k in ti.static(range(3))])
        for own in ti.static(range(3)):
            k = row[corner[own]]
            if k >= 0:
                x, y = goal[corner[own], 0], goal[corner[own], 1]
                ax, ay = position[corner[0], 0] - x, position[corner[0], 1] - y
                bx, by = position[corner[1], 0] - x, position[corner[1], 1] - y
                cx, cy = position[corner[2], 0] - x, position[corner[2], 1] - y
                one, other, last = bx * cy - by * cx, cx * ay - cy * ax, ax * by - ay * bx
                total = one + other + last
                one, other, last = one / total, other / total, last / total
                lowest = ti.min(one, other, last)
                if lowest > least[k]:
                    least[k] = lowest
                    found[k, 0], found[k, 1], found[k, 2] = corner[0], corner[1], corner[2]
                    weight[k, 0], weight[k, 1], weight[k, 2] = one, other, last


@kernel
def add_totals(
    cells: Ints2,
    among: Ints1,
    count: ti.i32,
    mass: Reals1,
    lumping: Reals1,
    period: Periods,
    position: Reals2,
    velocity: Reals2,
    gravity: Reals1,
    total: Reals1,
):
    """Add energy [J/m] and momentum [N s/m] of the cells ``among`` (C,), of mass and lumping (C,), to a total (3,)."""
    ti.loop_config(serialize=True)
    for c in range(count):
        own, height = total[0] * 0.0, total[0] * 0.0
        x, y = total[0] * 0.0, total[0] * 0.0
        part = ti.Vector([1.0, 1.0, 1.0])
        if ti.static(len(period.shape) == 3):
            part = parts_of(3.0, position, cells, period, among[c])
        for k in ti.static(range(3)):
            i, weight = cells[among[c], k], part[k]
            x += weight * velocity[i, 0]
            y += weight * velocity[i, 1]
            own += weight * (velocity[i, 0] * velocity[i, 0] + velocity[i, 1] * velocity[i, 1])
            height += weight * (position[i, 0] * gravity[0] + position[i, 1] * gravity[1])
        kinetic = 0.5 * (lumping[c] * own / 3 + (1 - lumping[c]) * (x * x + y * y) / 9)
        total[0] += mass[c] * (kinetic - height / 3)
        total[1] += mass[c] * x / 3
        total[2] += mass[c] * y / 3


@kernel
def add_hull_gradient(one: Ints1, other: Ints1, count: ti.i32, period: Periods, position: Reals2, gradient: Reals2):
    """Add the derivatives (N, 2) of the volume by the ends of its faces to a gradient [m].

    Each face goes from ``one`` to ``other`` (E,), with the volume on the left.
    """
    ti.loop_config(serialize=True)
    for e in range(count):
        i, j = one[e], other[e]
        x, y = 0.5 * (position[j, 0] - position[i, 0]), 0.5 * (position[j, 1] - position[i, 1])
        first, last = 1.0, 1.0
        if ti.static(len(period.shape) == 3):
            first = (2.0 * radius(position, period, i) + radius(position, period, j)) / 3.0
            last = (radius(position, period, i) + 2.0 * radius(position, period, j)) / 3.0
        gradient[i, 0] += first * y
        gradient[j, 0] += last * y
        gradient[i, 1] -= first * x
        gradient[j, 1] -= last * x
