"""Cells around particles and edges, in rows of proposals, and the labels there."""

import taichi as ti

from tipfem.backend.array_types import Template
from tipfem.remesh.cavity.arrays import AROUND, CAVITY, FIXED, MOST, RING, SEEN, has_mark, in_cavity, index, quality

BOUNDARY = 16  # the first of the bits of faces of the boundary in a set of labels


@ti.func
def is_in(rows: Template, r, count, t):
    """Whether cell t is one of the first ``count`` of row r."""
    found = False
    for m in range(count):
        if in_cavity(rows, r, m) == t:
            found = True
    return found


@ti.func
def add_star(mesh: Template, rows: Template, r, before, t, p):
    """Add the cells around p, one of which is t, to the ``before`` cells of row r; how many there are then.

    0 if there are too many.
    """
    n, k, full = before, before, 0
    if is_in(rows, r, before, t):
        k = 0
    else:
        rows.row[r, CAVITY + n] = t
        n += 1
    while k < n and full == 0:
        c = in_cavity(rows, r, k)
        if index(mesh, c, p) >= 0:
            for i in range(mesh.dim + 1):
                o = mesh.across[c, i]
                if mesh.cells[c, i] != p and o >= 0:
                    if not is_in(rows, r, n, o):
                        if n < MOST:
                            rows.row[r, CAVITY + n] = o
                            n += 1
                        else:
                            full = 1
        k += 1
    return 0 if full == 1 else n


@ti.func
def labels_at(mesh: Template, rows: Template, r, count, p, q, s):
    """The labels, as bits, of the cells of row r at particles p, q, s (-1: any), and from `BOUNDARY` on its faces."""
    bits = 0
    for m in range(count):
        c = in_cavity(rows, r, m)
        if index(mesh, c, p) >= 0 and (q < 0 or index(mesh, c, q) >= 0) and (s < 0 or index(mesh, c, s) >= 0):
            bits |= 1 << mesh.label[c]
            for i in range(mesh.dim + 1):
                w = mesh.cells[c, i]
                if mesh.across[c, i] < 0 and w != p and w != q and w != s:
                    bits |= 1 << (BOUNDARY - 1 - mesh.across[c, i])
    return bits


@ti.func
def has_several(bits):
    """Whether a set has more than one element."""
    return bits & (bits - 1) != 0


@ti.func
def next_around(mesh: Template, o, a, b, last):
    """The particle of tetrahedron o that is none of a, b and ``last``."""
    new = -1
    for m in ti.static(range(mesh.dim + 1)):
        w = mesh.cells[o, m]
        if w != a and w != b and w != last:
            new = w
    return new


@ti.func
def ring_of(mesh: Template, rows: Template, r, t, i, j):
    """Write cells and particles around the edge of corners i, j of tetrahedron t to row r, in order.

    How many cells there are, 0 for too many; and how many particles: as many, or one more where the edge is on the
    boundary, from one of its faces there to the other.
    """
    a, b, k = mesh.cells[t, i], mesh.cells[t, j], 0
    while k == i or k == j:
        k += 1
    leave, last = mesh.cells[t, k], mesh.cells[t, 6 - i - j - k]
    at, cells, particles, going = t, 0, 0, 2
    while going > 0:
        rows.row[r, AROUND], rows.row[r, AROUND + 1], rows.row[r, CAVITY] = leave, last, at
        start, n, again = at, 1, 0
        while again == 0:
            o = mesh.across[at, index(mesh, at, leave)]
            if o == start:
                cells, particles, going, again = n, n, 0, 1
            elif o < 0:
                # From here the other way.
                leave, last, again, going = last, leave, 1, going - 1
                if going == 0:
                    cells, particles = n, n + 1
            elif n + 1 >= RING:
                going, again = 0, 1
            else:
                new = next_around(mesh, o, a, b, last)
                rows.row[r, CAVITY + n], rows.row[r, AROUND + n + 1] = o, new
                n += 1
                leave, last, at = last, new, o
    return cells, particles


@ti.func
def boundary_between(mesh: Template, rows: Template, r, count):
    """The boundary faces at either end of ``count`` cells around an edge of the boundary, in order."""
    first, end = in_cavity(rows, r, 0), in_cavity(rows, r, count - 1)
    one = mesh.across[first, index(mesh, first, rows.row[r, AROUND + 1])]
    other = mesh.across[end, index(mesh, end, rows.row[r, AROUND + count - 1])]
    return one, other


@ti.func
def around_edge(mesh: Template, rows: Template, r, t, i, j):
    """Write the cells around the edge of corners i, j of cell t to row r; how many, 0 for none, and if it is inside.

    There are none for edges of the boundary in 2-D, and for those between particles that are held.
    """
    n, inside = 0, True
    if ti.static(mesh.dim == 2):
        o = mesh.across[t, 3 - i - j]
        if o >= 0:
            rows.row[r, CAVITY], rows.row[r, CAVITY + 1] = t, o
            n = 2
    else:
        cells, particles = ring_of(mesh, rows, r, t, i, j)
        inside = particles == cells
        if inside or not (has_mark(mesh, mesh.cells[t, i], FIXED) and has_mark(mesh, mesh.cells[t, j], FIXED)):
            n = cells
    return n, inside


@ti.func
def owns(mesh: Template, t, i, j):
    """Whether cell t has the smallest number of those around the edge of its corners i and j.

    No cell has of an edge of the boundary in 2-D, or between particles that are held.
    """
    own = True
    if ti.static(mesh.dim == 2):
        own = mesh.across[t, 3 - i - j] > t
    else:
        a, b, k = mesh.cells[t, i], mesh.cells[t, j], 0
        while k == i or k == j:
            k += 1
        leave, last = mesh.cells[t, k], mesh.cells[t, 6 - i - j - k]
        at, going = t, 2
        while going > 0:
            o = mesh.across[at, index(mesh, at, leave)]
            if o == t:
                going = 0
            elif o < 0:
                # Round the other way, from t again.
                at, leave, last, going = t, mesh.cells[t, 6 - i - j - k], mesh.cells[t, k], going - 1
                if has_mark(mesh, a, FIXED) and has_mark(mesh, b, FIXED):
                    going, own = 0, False
            elif o < t:
                going, own = 0, False
            else:
                new = next_around(mesh, o, a, b, last)
                leave, last, at = last, new, o
    return own


@ti.func
def is_interface(mesh: Template, rows: Template, r, count):
    """Whether the cells of row r have more than one label."""
    other = False
    for m in range(count):
        if mesh.label[in_cavity(rows, r, m)] != mesh.label[in_cavity(rows, r, 0)]:
            other = True
    return other


@ti.func
def worst(mesh: Template, rows: Template, r, count):
    """The smallest quality of the cells of row r."""
    q = 1e30
    for m in range(count):
        q = ti.min(q, quality(mesh, in_cavity(rows, r, m)))
    return q


@ti.func
def is_manifold(mesh: Template, rows: Template, r, count, p):
    """Whether the cells of each label around p, those of row r, are joined by faces: none meet in p only."""
    parts, labels = 0, 0
    for m in range(count):
        rows.row[r, SEEN + m] = 0
    for m in range(count):
        if rows.row[r, SEEN + m] == 0:
            parts += 1
            labels |= 1 << mesh.label[in_cavity(rows, r, m)]
            rows.row[r, SEEN + m] = 1
            going = 1
            while going == 1:
                going = 0
                for w in range(count):
                    if rows.row[r, SEEN + w] == 1:
                        rows.row[r, SEEN + w] = 2
                        c = in_cavity(rows, r, w)
                        for i in range(mesh.dim + 1):
                            o = mesh.across[c, i]
                            if o >= 0 and mesh.cells[c, i] != p:
                                if mesh.label[o] == mesh.label[c]:
                                    for z in range(count):
                                        if in_cavity(rows, r, z) == o and rows.row[r, SEEN + z] == 0:
                                            rows.row[r, SEEN + z] = 1
                                            going = 1
    number = 0
    for b in ti.static(range(8)):
        number += (labels >> b) & 1
    return parts == number
