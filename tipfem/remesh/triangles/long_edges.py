"""Long edges of a triangulation, the longest first; arrays are those of `edge_operations.TriangleArrays`.

An edge has one name, 3 * cell + opposite corner, from its cell of the lower number. Its key is its length over its
target; to edges of interfaces and of the hull that are longer than ``long``, ``FIRST * long`` is added.
"""

import taichi as ti

from tipfem.backend.array_types import Ints1, Reals1, Template
from tipfem.backend.launch import kernel
from tipfem.remesh.triangles.edge_operations import TriangleArrays, distance, is_border, side, target

FIRST = 1e3
ROUND_OFF = 1e-12  # of comparisons that only save work
# Counters that `coarsen_refine.coarsen` shares: particles removed, edges stored, and keys above ``needed``.
REMOVED, STORED, NEEDED = 0, 1, 2


@ti.func
def in_empty_space(mesh: Template, t, o):
    """Whether the edge between cells t and o is in empty space, whose cells have no density and need no particles."""
    empty = mesh.density[mesh.fluid[t]] == 0.0
    if empty and o >= 0:
        empty = mesh.density[mesh.fluid[o]] == 0.0
    return empty and o >= 0


@ti.func
def edge_key(mesh: Template, t, i: Template, long, least):
    """Key of the edge opposite corner i of cell t; -1 if it is below ``least``, or named by the other cell."""
    x = ti.static(mesh.state)
    key = -1.0
    o = mesh.neighbours[t, i]
    if (o < 0 or o > t) and not in_empty_space(mesh, t, o):
        b, c = mesh.cells[t, ti.static((i + 1) % 3)], mesh.cells[t, ti.static((i + 2) % 3)]
        border = is_border(mesh, t, i)
        bound = ti.min(least, long) if border else least
        wanted = target(x, b, c)
        cb = side(mesh, c, b)
        if cb[0] * cb[0] + cb[1] * cb[1] > bound * bound * wanted * wanted * (1 - ROUND_OFF):
            key = distance(mesh, b, c) / wanted
            if border and key > long:
                key += FIRST * long
    return key


@ti.func
def comes_after(keys: Template, edges: Template, m, n):
    """Whether the edge at m of a heap comes after that at n: shorter, or of the same length and a higher name."""
    return keys[m] < keys[n] or (keys[m] == keys[n] and edges[m] > edges[n])


@ti.func
def exchange(keys: Template, edges: Template, m, n):
    """Exchange two entries of a heap."""
    k, e = keys[m], edges[m]
    keys[m], edges[m] = keys[n], edges[n]
    keys[n], edges[n] = k, e


@ti.func
def sift_up(keys: Template, edges: Template, last):
    """Re-establish the order of a heap to which entry ``last`` was added."""
    m = last
    while m > 0 and comes_after(keys, edges, m, (m - 1) // 2):
        exchange(keys, edges, m, (m - 1) // 2)
        m = (m - 1) // 2


@ti.func
def sift_down(keys: Template, edges: Template, size):
    """Re-establish the order of a heap of ``size`` entries whose top was replaced."""
    m = 0
    going = True
    while going:
        last = m
        for child in ti.static(range(1, 3)):
            if 2 * m + child < size:
                if comes_after(keys, edges, 2 * m + child, last):
                    last = 2 * m + child
        going = last != m
        if going:
            exchange(keys, edges, m, last)
            m = last


@ti.func
def keep_longest(edges: Template, keys: Template, counters: Template, found, name, bound, needed, most):
    """Put an edge of key ``found`` above ``bound`` into a heap of the ``most`` edges of the largest keys.

    The shortest is on top. counters: [STORED] in the heap; [NEEDED] keys above ``needed``, stored or not.
    """
    if found > needed:
        counters[NEEDED] = counters[NEEDED] + 1
    if found > bound and most > 0:
        if counters[STORED] < most:
            m = counters[STORED]
            counters[STORED] = m + 1
            keys[m], edges[m] = found, name
            sift_up(keys, edges, m)
        else:
            keys[0], edges[0] = found, name
            sift_down(keys, edges, most)


@kernel
def longest_edges(
    mesh: TriangleArrays, edges: Ints1, keys: Reals1, counters: Ints1, long: ti.f64, least: ti.f64, needed: ti.f64
):
    """edges, keys (E,): the E edges of the largest keys above ``least``, in no order.

    counters, zero before: [STORED] how many there are, [NEEDED] how many keys are above ``needed``.
    """
    most = edges.shape[0]
    ti.loop_config(serialize=True)
    for t in range(mesh.cells.shape[0]):
        if mesh.fluid[t] >= 0:
            for i in ti.static(range(3)):
                # Once the heap is full, only edges longer than its shortest one are of interest.
                bound = least
                if counters[STORED] == most and most > 0:
                    bound = ti.max(bound, keys[0])
                found = edge_key(mesh, t, i, long, ti.min(bound, needed))
                keep_longest(edges, keys, counters, found, 3 * t + i, bound, needed, most)


@kernel
def long_edges(mesh: TriangleArrays, edges: Ints1, keys: Reals1, long: ti.f64, least: ti.f64) -> ti.i32:
    """edges, keys (3 M,): all edges of keys above ``least``, in the order of their names; returns how many."""
    count = 0
    ti.loop_config(serialize=True)
    for t in range(mesh.cells.shape[0]):
        if mesh.fluid[t] >= 0:
            for i in ti.static(range(3)):
                found = edge_key(mesh, t, i, long, least)
                if found > least:
                    edges[count], keys[count] = 3 * t + i, found
                    count += 1
    return count
