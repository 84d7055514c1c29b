"""Collapses of edges, by one rule for the inside, interfaces, curves where they meet, and walls."""

import taichi as ti

from tipfem.backend.array_types import Template
from tipfem.remesh.cavity.arrays import (
    CAVITY,
    COLLAPSE,
    COUNT,
    FIXED,
    GAIN,
    KIND,
    LEAST,
    LONGEST,
    MOST,
    ON,
    SPACING,
    WALL,
    P,
    Q,
    cell,
    distance,
    finest_at,
    gradient,
    has_mark,
    in_cavity,
    index,
    measure,
    place_of,
    position,
    quality,
    quality_with,
    set_place,
    wanted,
)
from tipfem.remesh.cavity.stars import BOUNDARY, add_star, has_several, is_in, is_manifold, labels_at, worst

# Quality below which a cell may leave longer edges, and how much longer; and touch from how much farther.
DIRE, LONGER, FARTHER = 0.05, 1.5, 6.0
STILL = 0.8  # part of a quality as bad as that which a collapse on a wall has to keep
TOUCH = 0.2  # distance at which an interface touches a particle of a wall [spacings]


@ti.func
def keeps_topology(mesh: Template, rows: Template, r, count, both, p, q, bits):
    """Whether the labels let p be moved into q; row r has the star of p, of ``count`` cells, and with q's ``both``.

    The set ``bits`` of labels and boundary faces at p must be that at the edge p-q: {A} inside, {A, B} along an
    interface, {A, B, C} along a curve. And for a particle s beside the edge, p-s may be interface only if the face
    p-q-s is, or q-s is not: else two interfaces would touch (the link condition).
    """
    good = not has_mark(mesh, p, FIXED) and bits == labels_at(mesh, rows, r, count, p, q, -1)
    if good and has_several(bits):
        good = is_manifold(mesh, rows, r, count, p)
        for m in range(count):
            c = in_cavity(rows, r, m)
            if good and index(mesh, c, q) >= 0:
                for i in range(mesh.dim + 1):
                    s = mesh.cells[c, i]
                    if s != p and s != q:
                        if has_several(labels_at(mesh, rows, r, count, p, s, -1)):
                            if ti.static(mesh.dim == 2):
                                o = mesh.across[c, index(mesh, c, p)]
                                if o < 0:
                                    good = False
                                elif mesh.label[o] != mesh.label[c]:
                                    good = False
                            elif not has_several(labels_at(mesh, rows, r, count, p, q, s)):
                                unknown = both == count and has_mark(mesh, s, ON)
                                if unknown or has_several(labels_at(mesh, rows, r, both, q, s, -1)):
                                    good = False
    return good


@ti.func
def quality_after(mesh: Template, rows: Template, r, count, p, q, place, longest, least):
    """The smallest quality of row r after p is moved into q, at a place; -1 for an edge ``longest`` times too long.

    Of cells behind one that is not above the ``least`` that is asked for, nothing is known.
    """
    low = 1e30
    for m in range(count):
        c = in_cavity(rows, r, m)
        i, j = index(mesh, c, p), index(mesh, c, q)
        if (i < 0 or j < 0) and low > least:
            k = ti.max(i, j)
            low = ti.min(low, quality_with(mesh, cell(mesh, c), k, place))
            if i >= 0 and low > least:
                for w in ti.static(range(mesh.dim + 1)):
                    if w != k and is_too_long(mesh, mesh.cells[c, w], q, place, longest):
                        low = -1.0
    return low


@ti.func
def is_too_long(mesh: Template, w, q, place, longest):
    """Whether the edge from particle w to q at a place would be ``longest`` times too long."""
    unit = wanted(mesh, w, q)
    if has_mark(mesh, w, FIXED) and has_mark(mesh, q, FIXED):
        unit = ti.min(unit, 1.0)  # where targets fall, edges between particles that are held stay
    return (position(mesh, w) - place).norm_sqr() > (longest * unit) ** 2


@ti.func
def add_star_to_join(mesh: Template, rows: Template, r, t, p, q, longest, least):
    """`add_star` of p as the only cells of row r; none if one would spoil that p goes to q, see `quality_after`."""
    n, k, place = 1, 0, position(mesh, q)
    rows.row[r, CAVITY] = t
    while k < n:
        c = in_cavity(rows, r, k)
        i = index(mesh, c, p)
        if i >= 0:
            if index(mesh, c, q) < 0:
                if quality_with(mesh, cell(mesh, c), i, place) <= least:
                    n = 0
                for w in ti.static(range(mesh.dim + 1)):
                    if w != i and is_too_long(mesh, mesh.cells[c, w], q, place, longest):
                        n = 0
            for w in range(mesh.dim + 1):
                o = mesh.across[c, w]
                if n > 0 and w != i and o >= 0:
                    if not is_in(rows, r, n, o):
                        n = ti.select(n < MOST, n + 1, 0)
                        if n > 0:
                            rows.row[r, CAVITY + n - 1] = o
        k += 1
    return n


@ti.func
def merged_place(mesh: Template, rows: Template, r, count, p, q):
    """(d,) where q must be after p is moved into it so that each of two labels keeps its volume; row r has both stars.

    A cell's measure is linear in the place y of its corner: over the cells of one label, the sum of g . (y - x) is what
    is missing.
    """
    label, start = mesh.label[in_cavity(rows, r, 0)], 0.5 * (position(mesh, p) + position(mesh, q))
    old, now, g = 0.0, 0.0, ti.Vector.zero(ti.f64, mesh.dim)
    for m in range(count):
        c = in_cavity(rows, r, m)
        if mesh.label[c] == label:
            old += measure(mesh, cell(mesh, c))
            i, j = index(mesh, c, p), index(mesh, c, q)
            if i < 0 or j < 0:
                k = ti.max(i, j)
                of_corner = gradient(mesh, c, k)
                now += measure(mesh, cell(mesh, c)) + of_corner.dot(start - position(mesh, mesh.cells[c, k]))
                g += of_corner
    return start + (old - now) * g / (g.norm_sqr() + 1e-300)


@ti.func
def may_leave(mesh: Template, p, q):
    """Whether p may go to q as far as marks tell: from no wall to the inside, nor from an interface to a label."""
    lost = mesh.marks[p] & ~mesh.marks[q]
    return lost & WALL == 0 and (lost & ON == 0 or has_mark(mesh, q, WALL))


@ti.func
def propose_collapse(mesh: Template, rows: Template, limits: Template, r, t, code, cure: Template):
    """Propose the best collapse of the edge ``code`` of cell t, or to ``cure`` t of any of its edges; whether there is.

    The last pass of the loop collects the stars of the best once more. A particle so close to one of a wall that it
    touches it goes there, with its fluids.
    """
    edges = ti.static(mesh.dim * (mesh.dim + 1) // 2)
    tries = ti.static(2 * edges if cure else 2)
    best = quality(mesh, t) if ti.static(cure) else 0.0
    longest, ready = limits[LONGEST] * limits[SPACING], False
    reach = TOUCH * finest_at(mesh, limits, t)
    if ti.static(cure):
        if best < DIRE:
            longest *= LONGER
            reach *= FARTHER
    for k in range(tries + 1):
        e, i, j = k // 2, code // 4, code % 4
        if ti.static(cure):
            i = ti.select(e < mesh.dim, 0, ti.select(e < 2 * mesh.dim - 1, 1, 2))
            j = ti.select(e < mesh.dim, e + 1, ti.select(e < 2 * mesh.dim - 1, e - mesh.dim + 2, 3))
        p, q = mesh.cells[t, i % (mesh.dim + 1)], mesh.cells[t, j % (mesh.dim + 1)]
        if k % 2 == 1:
            p, q = q, p
        last = k == tries
        going = ready
        if last:
            p, q = rows.row[r, P], rows.row[r, Q]
        else:
            going = not has_mark(mesh, p, FIXED) and may_leave(mesh, p, q)
        if going:
            touch, count = distance(mesh, p, q) < reach, 0
            most = ti.select(touch, 1e15, longest)
            if not last and (not has_mark(mesh, p, ON) or has_mark(mesh, q, FIXED)):
                count = add_star_to_join(mesh, rows, r, t, p, q, most, best)
            else:
                count = add_star(mesh, rows, r, 0, t, p)
            bits = labels_at(mesh, rows, r, count, p, -1, -1)
            both = count
            with_q = count != rows.row[r, COUNT]
            if not last:
                with_q = has_mark(mesh, p, ON) and not has_mark(mesh, q, FIXED) and bits < 1 << BOUNDARY
            if count > 0 and with_q:
                both = add_star(mesh, rows, r, count, t, q)
            if count > 0 and both > 0 and not last:
                good = keeps_topology(mesh, rows, r, count, both, p, q, bits)
                if not good and has_mark(mesh, q, WALL) and touch:
                    good = bits >> BOUNDARY == labels_at(mesh, rows, r, count, p, q, -1) >> BOUNDARY
                if good:
                    place = position(mesh, q)
                    if with_q:
                        if labels_at(mesh, rows, r, both, q, -1, -1) == bits:
                            place = merged_place(mesh, rows, r, both, p, q)
                        else:
                            both = count
                    low = quality_after(mesh, rows, r, both, p, q, place, most, best)
                    enough = low > best
                    if enough and low <= limits[LEAST]:
                        # On walls what is bad already may stay so: the next collapse may need this one.
                        old = worst(mesh, rows, r, both)
                        stays = bits >= 1 << BOUNDARY and old < DIRE and low > STILL * old
                        enough = low > old + limits[GAIN] or stays
                    if enough:
                        best, ready = low, True
                        rows.row[r, KIND], rows.row[r, P], rows.row[r, Q], rows.row[r, COUNT] = COLLAPSE, p, q, both
                        set_place(mesh, rows, r, place)
    return ready


@ti.func
def propose_removal(mesh: Template, rows: Template, r, t, p):
    """Propose to move p, a particle of cell t, into the neighbour that leaves the best cells; whether there is one."""
    best, pick = 0.0, -1
    count = add_star(mesh, rows, r, 0, t, p)
    bits = labels_at(mesh, rows, r, count, p, -1, -1)
    for k in range(count * (mesh.dim + 1)):
        q = mesh.cells[in_cavity(rows, r, k // (mesh.dim + 1)), k % (mesh.dim + 1)]
        if q != p and q != pick:
            low = quality_after(mesh, rows, r, count, p, q, position(mesh, q), 1e15, best)
            if low > best:
                if keeps_topology(mesh, rows, r, count, count, p, q, bits):
                    best, pick = low, q
    if pick >= 0:
        rows.row[r, KIND], rows.row[r, P], rows.row[r, Q], rows.row[r, COUNT] = COLLAPSE, p, pick, count
        set_place(mesh, rows, r, position(mesh, pick))
    return pick >= 0


@ti.func
def merge(mesh: Template, rows: Template, r):
    """Move p of row r into q: cells of both vanish, and their neighbours meet."""
    p, q = rows.row[r, P], rows.row[r, Q]
    place = place_of(mesh, rows, r)
    for m in range(rows.row[r, COUNT]):
        c = in_cavity(rows, r, m)
        i, j = index(mesh, c, p), index(mesh, c, q)
        if i >= 0 and j >= 0:
            a, b = mesh.across[c, i], mesh.across[c, j]
            for z in ti.static(range(mesh.dim + 1)):
                if a >= 0:
                    if mesh.across[a, z] == c:
                        mesh.across[a, z] = b
            for z in ti.static(range(mesh.dim + 1)):
                if b >= 0:
                    if mesh.across[b, z] == c:
                        mesh.across[b, z] = a
            mesh.label[c] = -1
    for m in range(rows.row[r, COUNT]):
        c = in_cavity(rows, r, m)
        if mesh.label[c] >= 0:
            for z in ti.static(range(mesh.dim + 1)):
                if mesh.cells[c, z] == p:
                    mesh.cells[c, z] = q
    for a in ti.static(range(mesh.dim)):
        mesh.x[q, a] = place[a]
    mesh.marks[p] = 0
