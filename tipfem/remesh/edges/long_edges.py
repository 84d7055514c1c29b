"""Kernels that find long edges; arrays are those of `edge_operations` and `coarsen_refine`.

An edge has one name, 3 * cell + opposite corner, from the cell of the lower number. Its key is its length over its
target; to edges of interfaces and of the hull that are longer than ``long``, ``FIRST * long`` is added.
"""

import taichi as ti

from tipfem.backend.launch import kernel
from tipfem.remesh.edges.edge_operations import distance, target

FIRST = 1e3
ROUND_OFF = 1e-12  # of comparisons that only save work


@ti.func
def key_of(
    x: ti.template(),
    cells: ti.template(),
    neighbours: ti.template(),
    fluid: ti.template(),
    t,
    i: ti.template(),
    long,
    least,
):
    """Key of the edge opposite corner i of cell t; -1 if it is below ``least``, or the edge another cell's to name."""
    key = -1.0
    o = neighbours[t, i]
    if o < 0 or o > t:
        b, c = cells[t, ti.static((i + 1) % 3)], cells[t, ti.static((i + 2) % 3)]
        border = o < 0
        if not border:
            border = fluid[o] != fluid[t]
        bound = ti.min(least, long) if border else least
        wanted = target(x, b, c)
        dx, dy = x[b, 0] - x[c, 0], x[b, 1] - x[c, 1]
        if dx * dx + dy * dy > bound * bound * wanted * wanted * (1 - ROUND_OFF):
            key = distance(x, b, c) / wanted
            if border and key > long:
                key += FIRST * long
    return key


@ti.func
def comes_after(key: ti.template(), edge: ti.template(), m, n):
    """Whether the edge at m of a heap comes after that at n: shorter, or of the same length and a higher name."""
    return key[m] < key[n] or (key[m] == key[n] and edge[m] > edge[n])


@ti.func
def exchange(key: ti.template(), edge: ti.template(), m, n):
    """Exchange two entries of a heap."""
    k, e = key[m], edge[m]
    key[m], edge[m] = key[n], edge[n]
    key[n], edge[n] = k, e


@ti.func
def keep_longest(edge: ti.template(), key: ti.template(), count: ti.template(), found, name, bound, needed, most):
    """Put an edge of key ``found`` above ``bound`` into a heap of the ``most`` edges of the largest keys, count[1] of
    them with the last on top. count[2]: how many keys are above ``needed``."""
    if found > needed:
        count[2] = count[2] + 1
    if found > bound and most > 0:
        m = 0
        if count[1] < most:
            m = count[1]
            count[1] = m + 1
            key[m], edge[m] = found, name
            while m > 0 and comes_after(key, edge, m, (m - 1) // 2):
                exchange(key, edge, m, (m - 1) // 2)
                m = (m - 1) // 2
        else:
            key[0], edge[0] = found, name
            going = True
            while going:
                last = m
                for side in ti.static(range(1, 3)):
                    if 2 * m + side < most:
                        if comes_after(key, edge, 2 * m + side, last):
                            last = 2 * m + side
                going = last != m
                if going:
                    exchange(key, edge, m, last)
                    m = last


@kernel
def longest_edges(
    x: ti.types.ndarray(),
    cells: ti.types.ndarray(),
    neighbours: ti.types.ndarray(),
    fluid: ti.types.ndarray(),
    edge: ti.types.ndarray(),
    key: ti.types.ndarray(),
    count: ti.types.ndarray(),
    elements: ti.i32,
    long: ti.f64,
    least: ti.f64,
    needed: ti.f64,
    most: ti.i32,
):
    """edge, key (most,): the ``most`` edges of the largest keys above ``least``, unsorted.

    count: [1] how many there are, [2] how many keys are above ``needed``.
    """
    ti.loop_config(serialize=True)
    for t in range(elements):
        if fluid[t] >= 0:
            for i in ti.static(range(3)):
                # A heap with the last edge on top: once it is full, no shorter one is asked for more.
                bound = least
                if count[1] == most and most > 0:
                    bound = ti.max(bound, key[0])
                found = key_of(x, cells, neighbours, fluid, t, i, long, ti.min(bound, needed))
                keep_longest(edge, key, count, found, 3 * t + i, bound, needed, most)


@kernel
def long_edges(
    x: ti.types.ndarray(),
    cells: ti.types.ndarray(),
    neighbours: ti.types.ndarray(),
    fluid: ti.types.ndarray(),
    edge: ti.types.ndarray(),
    key: ti.types.ndarray(),
    elements: ti.i32,
    long: ti.f64,
    least: ti.f64,
) -> ti.i32:
    """edge, key (3 M,): all edges of keys above ``least``, in the order of their names; returns how many."""
    count = 0
    ti.loop_config(serialize=True)
    for t in range(elements):
        if fluid[t] >= 0:
            for i in ti.static(range(3)):
                found = key_of(x, cells, neighbours, fluid, t, i, long, least)
                if found > least:
                    edge[count], key[count] = 3 * t + i, found
                    count += 1
    return count
