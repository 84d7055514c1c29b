"""Kernels for what particles take along from cells, and where they land: serial, in the order of the cells."""

import taichi as ti

from tipfem.backend.array_types import Flags1, Ints1, Ints2, Periods, Reals1, Reals2, Template
from tipfem.backend.launch import kernel
from tipfem.backend.periodic import difference


@kernel
def carry(
    cells: Ints2,
    share: Reals2,
    measure: Reals1,
    mass: Reals1,
    per_mass: Reals2,
    leaves: Flags1,
    total: Reals2,
    lost: Ints1,
    columns: Template,
    corners: Template,
) -> ti.i32:
    """Add to total (N, 1 + columns), zero before, the measure of the cells and quantities ``per_mass`` (N, columns).

    Each corner has its ``share`` (M, corners) of a cell; those that leave give theirs to the others. ``lost`` (M,):
    cells whose corners all leave. Returns how many these are.
    """
    count = 0
    ti.loop_config(serialize=True)
    for e in range(cells.shape[0]):
        stay = 0
        left = ti.Vector.zero(ti.f64, 1 + columns)
        for k in ti.static(range(corners)):
            p = cells[e, k]
            if leaves[p] == 0:
                stay += 1
            else:
                left[0] += measure[e] * share[e, k]
                for j in ti.static(range(columns)):
                    left[1 + j] += mass[e] * per_mass[p, j] * share[e, k]
        if stay == 0:
            lost[count] = e
            count += 1
        for k in ti.static(range(corners)):
            p = cells[e, k]
            if leaves[p] == 0:
                total[p, 0] += measure[e] * share[e, k] + left[0] / stay
                for j in ti.static(range(columns)):
                    total[p, 1 + j] += mass[e] * per_mass[p, j] * share[e, k] + left[1 + j] / stay
    return count


@kernel
def find_fallen(x: Reals2, cells: Ints2, fluid: Ints1, period: Periods, fluids: ti.i32, flying: Ints1, found: Ints1):
    """found (K,), -1 before: the first cell of a fluid, below ``fluids``, in which each particle ``flying`` (K,) is.

    These ascend by their first coordinate; x (N, .) begins with the positions.
    """
    ti.loop_config(serialize=True)
    for e in range(cells.shape[0]):
        if 0 <= fluid[e] and fluid[e] < fluids:
            k, end, last = 0, flying.shape[0], 1e30
            if ti.static(len(period.shape) != 2):
                a, b, c = x[cells[e, 0], 0], x[cells[e, 1], 0], x[cells[e, 2], 0]
                last = ti.max(a, b, c)
                while k < end:  # the first one that is not on the left of the cell
                    middle = (k + end) // 2
                    if x[flying[middle], 0] < ti.min(a, b, c):
                        k = middle + 1
                    else:
                        end = middle
            while k < flying.shape[0] and x[flying[k], 0] <= last:
                p, inside = flying[k], 1
                for i in ti.static(range(3)):
                    one, other = cells[e, i], cells[e, (i + 1) % 3]
                    ax, ay = difference(x, period, one, p, 0), difference(x, period, one, p, 1)
                    bx, by = difference(x, period, other, p, 0), difference(x, period, other, p, 1)
                    if ax * by - ay * bx < 0:
                        inside = 0
                if inside == 1 and found[k] < 0:
                    found[k] = e
                k += 1
