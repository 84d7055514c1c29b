"""Swaps: the same particles in other cells. Flips in 2-D; in 3-D removal of edges, 2-3 swaps, turns of interface edges.

No swap crosses an interface, but for turns: where it is flat, an edge a-b of it between two labels gives way to the
other diagonal s-s' of its two faces there.
"""

import taichi as ti

from tipfem.backend.array_types import Template
from tipfem.remesh.cavity.arrays import (
    AROUND,
    BEND,
    BEST,
    CAVITY,
    CHOICE,
    COUNT,
    FILLED,
    FIXED,
    GAIN,
    KIND,
    SPACING,
    STACK,
    SWAP,
    SWAPPED,
    P,
    Q,
    has_mark,
    in_cavity,
    index,
    measure,
    position,
    quality,
    quality_of,
    set_new_cell,
    wanted,
)
from tipfem.remesh.cavity.stars import add_star, boundary_between, has_several, ring_of, worst

EDGES, WAYS = 6, 10  # edges of a tetrahedron, and with its faces the swaps that are tried


@ti.func
def around(rows: Template, r, m, count):
    """Particle m of the ring of ``count`` in row r, counted on from its end."""
    return rows.row[r, AROUND + m % count]


@ti.func
def opposite(mesh: Template, o, t):
    """The particle of cell o that is not in its neighbour t."""
    d = -1
    for m in ti.static(range(mesh.dim + 1)):
        if mesh.across[o, m] == t:
            d = mesh.cells[o, m]
    return d


@ti.func
def in_circle(mesh: Template, a, b, c, d):
    """Relative depth of d inside the circle through a, b and c: > 0 inside."""
    x = position(mesh, d)
    one, two, three = position(mesh, a) - x, position(mesh, b) - x, position(mesh, c) - x
    a2, b2, c2 = one.norm_sqr(), two.norm_sqr(), three.norm_sqr()
    inside = a2 * two.cross(three) - b2 * one.cross(three) + c2 * one.cross(two)
    return inside / ti.max(a2, ti.max(b2, c2)) ** 2


@ti.func
def flip_excess(mesh: Template, t, i):
    """`in_circle` of the particle beyond face i of triangle t, from its cell of the lower number; 0 if it must stay."""
    o, result = mesh.across[t, i], 0.0
    if o > t:
        if mesh.label[o] == mesh.label[t]:
            d = opposite(mesh, o, t)
            a, b, c = mesh.cells[t, i], mesh.cells[t, (i + 1) % 3], mesh.cells[t, (i + 2) % 3]
            if measure(mesh, ti.Vector([a, b, d])) > 0 and measure(mesh, ti.Vector([a, d, c])) > 0:
                result = in_circle(mesh, a, b, c, d)
    return result


@ti.func
def propose_flip(mesh: Template, rows: Template, r, t, i):
    """Propose to flip the edge opposite corner i of triangle t."""
    o = mesh.across[t, i]
    d = opposite(mesh, o, t)
    a, b, c = mesh.cells[t, i], mesh.cells[t, (i + 1) % 3], mesh.cells[t, (i + 2) % 3]
    set_new_cell(mesh, rows, r, 0, ti.Vector([a, b, d]), mesh.label[t])
    set_new_cell(mesh, rows, r, 1, ti.Vector([a, d, c]), mesh.label[t])
    rows.row[r, CAVITY], rows.row[r, CAVITY + 1] = t, o
    rows.row[r, KIND], rows.row[r, COUNT], rows.row[r, FILLED] = SWAP, 2, 2


@ti.func
def fill_polygon(mesh: Template, rows: Template, r, g, count, first, last, a, b):
    """The smallest quality of the best cells over a polygon of the ring, closed by the edge of its ends, at a and b.

    Klincsek's dynamic programming, for side g (0 or 1) of row r, whose ring has ``count`` particles; the choices stay
    in the row.
    """
    size = last - first
    for i in range(size):
        rows.real[r, BEST + 64 * g + 8 * i + i + 1] = 1e30
    for span in range(2, size + 1):
        for i in range(size - span + 1):
            j = i + span
            top, pick = -1e30, i + 1
            vi, vj = around(rows, r, first + i, count), around(rows, r, first + j, count)
            for k in range(i + 1, j):
                vk = around(rows, r, first + k, count)
                q = ti.min(rows.real[r, BEST + 64 * g + 8 * i + k], rows.real[r, BEST + 64 * g + 8 * k + j])
                if q > top:
                    for apex in range(2):
                        c = ti.Vector(
                            [ti.select(apex == 0, vi, vk), ti.select(apex == 0, vk, vi), vj, ti.select(apex == 0, b, a)]
                        )
                        q = ti.min(q, quality_of(mesh, c))
                if q > top:
                    top, pick = q, k
            rows.real[r, BEST + 64 * g + 8 * i + j], rows.row[r, CHOICE + 64 * g + 8 * i + j] = top, pick
    return rows.real[r, BEST + 64 * g + size]


@ti.func
def write_polygon(mesh: Template, rows: Template, r, g, count, first, last, a, b, label, number):
    """Write the cells that `fill_polygon` chose as new ones from ``number`` on; the next number."""
    m, top = number, 1
    rows.row[r, STACK], rows.row[r, STACK + 1] = 0, last - first
    while top > 0:
        top -= 1
        i, j = rows.row[r, STACK + 2 * top], rows.row[r, STACK + 2 * top + 1]
        if j - i >= 2:
            k = rows.row[r, CHOICE + 64 * g + 8 * i + j]
            vi, vk = around(rows, r, first + i, count), around(rows, r, first + k, count)
            vj = around(rows, r, first + j, count)
            set_new_cell(mesh, rows, r, m, ti.Vector([vi, vk, vj, b]), label)
            set_new_cell(mesh, rows, r, m + 1, ti.Vector([vk, vi, vj, a]), label)
            m += 2
            rows.row[r, STACK + 2 * top], rows.row[r, STACK + 2 * top + 1] = i, k
            rows.row[r, STACK + 2 * top + 2], rows.row[r, STACK + 2 * top + 3] = k, j
            top += 2
    return m


@ti.func
def sides(mesh: Template, rows: Template, r, count):
    """Two places where the label changes in the ring of row r, (0, count - 1) for none; and the number of changes."""
    one, other, number = 0, count - 1, 0
    for m in range(count):
        if mesh.label[in_cavity(rows, r, m)] != mesh.label[in_cavity(rows, r, (m + count - 1) % count)]:
            if number == 0:
                one = m
            else:
                other = m
            number += 1
    return one, other, number


@ti.func
def may_turn(mesh: Template, rows: Template, r, count, one, other):
    """Whether particles ``one`` and ``other`` of row r may be joined by an interface edge.

    They are not yet by an edge outside the row, or by one inside a label.
    """
    both = add_star(mesh, rows, r, count, in_cavity(rows, r, 0), one)
    bits, outside = 0, 0
    for m in range(both):
        c = in_cavity(rows, r, m)
        if index(mesh, c, one) >= 0 and index(mesh, c, other) >= 0:
            bits |= 1 << mesh.label[c]
            if m >= count:
                outside += 1
    return both > 0 and (outside == 0 or not has_several(bits))


@ti.func
def is_flat(mesh: Template, limits: Template, a, b, one, other):
    """Whether four particles of an interface, two edges that cross, are in a plane up to limits[BEND]."""
    u, w = position(mesh, b) - position(mesh, a), position(mesh, other) - position(mesh, one)
    volume = ti.abs(u.cross(w).dot(position(mesh, one) - position(mesh, a)))
    length = 0.5 * ti.min(1.0, wanted(mesh, a, b)) * limits[SPACING]
    return volume < limits[BEND] * (u.norm_sqr() + w.norm_sqr()) * length


@ti.func
def face_swap(mesh: Template, rows: Template, r, t, i, write):
    """The smallest quality after a 2-3 swap of face i of tetrahedron t, and before; `write` its cells if asked."""
    q, old = -1.0, 0.0
    o = mesh.across[t, i]
    if o >= 0:
        if mesh.label[o] == mesh.label[t]:
            a, d = mesh.cells[t, i], opposite(mesh, o, t)
            b, c, e = mesh.cells[t, (i + 1) % 4], mesh.cells[t, (i + 2) % 4], mesh.cells[t, (i + 3) % 4]
            if quality_of(mesh, ti.Vector([b, c, e, a])) < 0:
                b, c = c, b
            old, q = ti.min(quality(mesh, t), quality(mesh, o)), 1e30
            for m in range(3):
                f, g = ti.select(m == 0, b, ti.select(m == 1, c, e)), ti.select(m == 0, c, ti.select(m == 1, e, b))
                new = ti.Vector([d, a, f, g])
                q = ti.min(q, quality_of(mesh, new))
                if write:
                    set_new_cell(mesh, rows, r, m, new, mesh.label[t])
            if write:
                rows.row[r, CAVITY], rows.row[r, CAVITY + 1] = t, o
                rows.row[r, COUNT], rows.row[r, FILLED] = 2, 3
    return q, old


@ti.func
def edge_swap(mesh: Template, rows: Template, limits: Template, r, t, e, write):
    """The smallest quality after edge e of tetrahedron t is removed or turned, and before; written if asked.

    -1 where that is not possible.
    """
    i = ti.select(e < 3, 0, ti.select(e < 5, 1, 2))
    j = ti.select(e < 3, e + 1, ti.select(e < 5, e - 1, 3))
    q, old = -1.0, 0.0
    cells, count = ring_of(mesh, rows, r, t, i, j)
    if count >= 3 and count <= SWAPPED:
        old = worst(mesh, rows, r, cells)
        a, b = mesh.cells[t, i], mesh.cells[t, j]
        if quality_of(mesh, ti.Vector([a, b, rows.row[r, AROUND], rows.row[r, AROUND + 1]])) < 0:
            a, b = b, a
        one, other, number = sides(mesh, rows, r, cells)
        s, end = around(rows, r, one, count), around(rows, r, other, count)
        good = number == 0
        if count > cells:
            # On the boundary an edge gives way to the other diagonal of its two faces, which are of one wall.
            face, beyond = boundary_between(mesh, rows, r, cells)
            held = has_mark(mesh, a, FIXED) and has_mark(mesh, b, FIXED)
            good = good and face == beyond and not (held and has_mark(mesh, rows.row[r, AROUND], FIXED))
        elif number == 2 and limits[BEND] > 0:
            good = is_flat(mesh, limits, a, b, s, end)
        if good:
            q = 1e30
            m = 0
            for g in range(ti.select(number == 0, 1, 2)):
                first = ti.select(number == 0, 0, ti.select(g == 0, one, other))
                last = ti.select(number == 0, count - 1, ti.select(g == 0, other, one + count))
                q = ti.min(q, fill_polygon(mesh, rows, r, g, count, first, last, a, b))
                if write and last - first >= 2:
                    label = mesh.label[in_cavity(rows, r, first)]
                    m = write_polygon(mesh, rows, r, g, count, first, last, a, b, label, m)
            if write:
                rows.row[r, COUNT], rows.row[r, FILLED] = cells, m
                rows.row[r, P], rows.row[r, Q] = a, b
            elif number == 2 and q > old:
                if not may_turn(mesh, rows, r, count, s, end):
                    q = -1.0
    return q, old


@ti.func
def propose_swap(mesh: Template, rows: Template, limits: Template, r, t):
    """Propose the best swap of an edge or a face of tetrahedron t that raises the smallest quality; whether there is.

    All are tried in one loop, whose last pass repeats the best one and writes its cells.
    """
    best, pick = 0.0, -1
    for k in range(WAYS + 1):
        e = ti.select(k < WAYS, k, pick)
        last = k == WAYS
        q, old = -1.0, 0.0
        if 0 <= e and e < EDGES:
            q, old = edge_swap(mesh, rows, limits, r, t, e, last)
        elif e >= EDGES:
            q, old = face_swap(mesh, rows, r, t, e - EDGES, last)
        if not last and q > best and q > old + ti.min(limits[GAIN], 0.25 * ti.abs(old) + 1e-4):
            best, pick = q, e
    if pick >= 0:
        rows.row[r, KIND] = SWAP
    return pick >= 0
