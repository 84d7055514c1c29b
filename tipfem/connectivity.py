"""Kernels that find which cells and which neighbours each particle has.

Lists of lists are CSR: ``offsets`` (N + 1,) says where the list of each particle begins. The order
within a list does not depend on the number of threads, so that sums over it are repeatable bit by bit.
"""

import taichi as ti


@ti.kernel
def count_uses(cells: ti.types.ndarray(), count: ti.types.ndarray(), elements: ti.i32, nodes: ti.i32, width: ti.i32):
    """count[i + 1] (N + 1,): in how many cells (M, width) particle i is; count[0] = 0."""
    for i in range(nodes + 1):
        count[i] = 0
    for e in range(elements):
        for a in range(width):
            ti.atomic_add(count[cells[e, a] + 1], 1)


@ti.kernel
def accumulate(count: ti.types.ndarray(), cursor: ti.types.ndarray(), n: ti.i32) -> ti.i32:
    """Running sums of count[:n + 1] in place; ``cursor`` (n,) takes a copy of the first n. Returns the last sum."""
    ti.loop_config(serialize=True)
    for i in range(n):
        cursor[i] = count[i]
        count[i + 1] = count[i] + count[i + 1]
    return count[n]


@ti.kernel
def list_uses(
    cells: ti.types.ndarray(), offsets: ti.types.ndarray(), cursor: ti.types.ndarray(), corners: ti.types.ndarray(),
    elements: ti.i32, nodes: ti.i32, width: ti.i32,
):  # fmt: skip
    """corners: places e * width + a of each particle in ``cells``, in ascending order; see `count_uses`."""
    for e in range(elements):
        for a in range(width):
            slot = ti.atomic_add(cursor[cells[e, a]], 1)
            corners[slot] = e * width + a
    for i in range(nodes):
        insertion_sort(corners, offsets[i], offsets[i + 1])


@ti.func
def insertion_sort(values: ti.template(), first, last):
    """Sort values[first:last] in place; they are few."""
    for s in range(first + 1, last):
        value = values[s]
        t = s
        while t > first and values[ti.max(t - 1, first)] > value:
            values[t] = values[t - 1]
            t -= 1
        values[t] = value


@ti.kernel
def find_neighbours(
    cells: ti.types.ndarray(), offsets: ti.types.ndarray(), corners: ti.types.ndarray(), wide: ti.types.ndarray(),
    count: ti.types.ndarray(), nodes: ti.i32, dim: ti.template(),
):  # fmt: skip
    """count[i + 1]: particles that share a cell with particle i, itself included; ``wide`` lists them with gaps.

    The list of i starts at dim * offsets[i] + i with i itself, the others follow in ascending order.
    """
    for i in range(nodes):
        first = dim * offsets[i] + i
        n = 1
        wide[first] = i
        for c in range(offsets[i], offsets[i + 1]):
            e = corners[c] // (dim + 1)
            for a in ti.static(range(dim + 1)):
                j = cells[e, a]
                known = False
                for s in range(first, first + n):
                    known = known or wide[s] == j
                if not known:
                    wide[first + n] = j
                    n += 1
        insertion_sort(wide, first + 1, first + n)
        count[i + 1] = n
        if i == 0:
            count[0] = 0


@ti.kernel
def list_neighbours(
    cells: ti.types.ndarray(), offsets: ti.types.ndarray(), corners: ti.types.ndarray(), wide: ti.types.ndarray(),
    row_offsets: ti.types.ndarray(), columns: ti.types.ndarray(), places: ti.types.ndarray(), nodes: ti.i32,
    dim: ti.template(),
):  # fmt: skip
    """The lists of `find_neighbours` without gaps, and where in them cells find their particles.

    places (M (d + 1)^2,): of each entry of ``corners`` the places in ``columns`` of all particles of its cell.
    """
    for i in range(nodes):
        start = dim * offsets[i] + i
        for s in range(row_offsets[i], row_offsets[i + 1]):
            columns[s] = wide[start + s - row_offsets[i]]
        for c in range(offsets[i], offsets[i + 1]):
            e = corners[c] // (dim + 1)
            for a in ti.static(range(dim + 1)):
                s = row_offsets[i]
                while columns[s] != cells[e, a]:
                    s += 1
                places[c * (dim + 1) + a] = s
