"""Kernels that find which cells and which neighbours each particle has.

Lists of lists are CSR: ``offsets`` (N + 1,) says where the list of each particle begins. The order
within a list does not depend on the number of threads, so that sums over it are repeatable bit by bit.
"""

import taichi as ti

from tipfem.backend.launch import kernel


@ti.func
def take(cursor: ti.template(), i, serial: ti.template()):
    """Count cursor[i] up by one; what it was. Not an atomic operation where one thread does the loop."""
    value = 0
    if ti.static(serial):
        value = cursor[i]
        cursor[i] = value + 1
    else:
        value = ti.atomic_add(cursor[i], 1)
    return value


@kernel
def list_uses(
    cells: ti.types.ndarray(),
    offsets: ti.types.ndarray(),
    cursor: ti.types.ndarray(),
    corners: ti.types.ndarray(),
    elements: ti.i32,
    nodes: ti.i32,
    width: ti.i32,
    one_counts: ti.template(),
):
    """corners: places e * width + a of each particle in ``cells`` (M, width), in ascending order; ``offsets``.

    ``cursor`` (N,) is scratch.
    """
    ti.loop_config(serialize=one_counts)
    for i in range(nodes + 1):
        offsets[i] = 0
    ti.loop_config(serialize=one_counts)
    for e in range(elements):
        for a in range(width):
            take(offsets, cells[e, a] + 1, one_counts)
    ti.loop_config(serialize=True)
    for i in range(nodes):
        cursor[i] = offsets[i]
        offsets[i + 1] = offsets[i] + offsets[i + 1]
    ti.loop_config(serialize=one_counts)
    for e in range(elements):
        for a in range(width):
            corners[take(cursor, cells[e, a], one_counts)] = e * width + a
    if ti.static(not one_counts):
        for i in range(nodes):
            insertion_sort(corners, offsets[i], offsets[i + 1])


@kernel
def accumulate(
    count: ti.types.ndarray(),
    cursor: ti.types.ndarray(),
    n: ti.i32,
) -> ti.i32:
    """Running sums of count[:n + 1] in place; ``cursor`` (n,) takes a copy of the first n. Returns the last sum."""
    ti.loop_config(serialize=True)
    for i in range(n):
        cursor[i] = count[i]
        count[i + 1] = count[i] + count[i + 1]
    return count[n]


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


@ti.func
def behind(own, other: ti.template(), dim: ti.template()):
    """The corner of a cell that comes ``other`` behind ``own``, round and round."""
    b = own + other
    return b - ti.select(b > dim, dim + 1, 0)


@kernel
def find_neighbours(
    cells: ti.types.ndarray(),
    offsets: ti.types.ndarray(),
    corners: ti.types.ndarray(),
    wide: ti.types.ndarray(),
    count: ti.types.ndarray(),
    places: ti.types.ndarray(),
    nodes: ti.i32,
    dim: ti.template(),
    serial: ti.template(),
):
    """count[i + 1]: particles that share a cell with particle i, itself included; ``wide`` lists them with gaps.

    The list of i starts at dim * offsets[i] + i with i itself; the others follow as they are met in its cells.
    places (M (d + 1) d,): of each entry c of ``corners`` where in that list the other particles of its cell are, the
    one `behind` it by k at c * d + k - 1.
    """
    ti.loop_config(serialize=serial)
    for i in range(nodes):
        first = dim * offsets[i] + i
        n = 1
        wide[first] = i
        for c in range(offsets[i], offsets[i + 1]):
            e = corners[c] // (dim + 1)
            own = corners[c] - e * (dim + 1)
            for other in ti.static(range(1, dim + 1)):
                j = cells[e, behind(own, other, dim)]
                wide[first + n] = j  # so that the search ends
                s = 1
                while wide[first + s] != j:
                    s += 1
                if s == n:
                    n += 1
                places[c * dim + other - 1] = s
        count[i + 1] = n
        if i == 0:
            count[0] = 0
