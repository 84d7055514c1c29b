"""Splits of edges, by a particle in the middle or at a site."""

import taichi as ti

from tipfem.backend.array_types import Template
from tipfem.remesh.cavity.arrays import (
    CODE,
    COUNT,
    FILLED,
    KIND,
    LATER,
    SPACING,
    SPLIT,
    P,
    Q,
    cell,
    distance,
    in_cavity,
    index,
    position,
    quality,
    quality_with,
    set_new_cell,
    set_place,
    wanted,
)
from tipfem.remesh.cavity.stars import add_star, around_edge, is_interface

LONGEST_WALK = 30  # cells around a particle of an interface in 2-D
NEAR = 0.2  # of the edge: a neighbour on the interface that is nearer tells nothing of its curvature
GOOD, FAIR = 0.1, 0.01  # qualities that suffice after a split for a better mesh, and after one that must be
ON_EDGE = 1e-9  # of its length: how far beside an edge a place may be by round-off
APART = 0.75  # of what is wanted, below which particles are joined
BULGE = 0.15  # largest distance of a new particle from its edge, in lengths of that


@ti.func
def next_on_interface(mesh: Template, t, a, b):
    """The particle after a on the interface that comes from b along the label of triangle t; -1 if none."""
    at, last, result, steps = t, b, -1, 0
    while steps < LONGEST_WALK:
        s = -1
        for i in ti.static(range(mesh.dim + 1)):
            w = mesh.cells[at, i]
            if w != a and w != last:
                s = w
        o = mesh.across[at, index(mesh, at, last)]
        steps += 1
        if o < 0:
            steps = LONGEST_WALK
        elif mesh.label[o] != mesh.label[t]:
            result, steps = s, LONGEST_WALK
        else:
            last, at = s, o
    return result


@ti.func
def middle(mesh: Template, t, a, b, interface):
    """(d,) where the edge a-b of cell t is split: its middle; of an interface in 2-D on the mean of two parabolas."""
    m = 0.5 * (position(mesh, a) + position(mesh, b))
    if ti.static(mesh.dim == 2):
        if interface:
            total, number = ti.Vector.zero(ti.f64, mesh.dim), 0
            for way in range(2):
                p, q = ti.select(way == 0, a, b), ti.select(way == 0, b, a)
                z = next_on_interface(mesh, t, p, q)
                if z >= 0 and z != q:
                    s = distance(mesh, z, p) / distance(mesh, p, q)
                    if s > NEAR:
                        total += -0.25 / (s * (s + 1)) * position(mesh, z) + (s + 0.5) * 0.5 / s * position(mesh, p)
                        total += 0.5 * (0.5 + s) / (1 + s) * position(mesh, q)
                        number += 1
            if number > 0:
                d = total / number - m
                most = BULGE * distance(mesh, a, b)
                if d.norm() > most:
                    d *= most / d.norm()
                m += d
    return m


@ti.func
def propose_split(mesh: Template, rows: Template, r, t, i, j, place, least: Template):
    """Propose to put a particle at a place on the edge of corners i, j of cell t; whether that is possible.

    Not where a cell would have a quality below ``least`` and far below that of before, nor between particles of the
    boundary that are held, nor in 2-D on the boundary.
    """
    count, inside = around_edge(mesh, rows, r, t, i, j)
    good, m = count > 0, 0
    for k in range(count):
        c = in_cavity(rows, r, k)
        for way in range(2):
            w = index(mesh, c, mesh.cells[t, ti.select(way == 0, i, j)])
            if quality_with(mesh, cell(mesh, c), w, place) < ti.min(least, 0.3 * quality(mesh, c)):
                good = False
            new = cell(mesh, c)
            for z in ti.static(range(mesh.dim + 1)):
                if z == w:
                    new[z] = LATER
            set_new_cell(mesh, rows, r, m, new, mesh.label[c])
            m += 1
    if good:
        rows.row[r, KIND], rows.row[r, COUNT], rows.row[r, FILLED] = SPLIT, count, m
        rows.row[r, P], rows.row[r, Q] = mesh.cells[t, i], mesh.cells[t, j]
        rows.row[r, CODE] = ti.select(inside, 0, 1)
        set_place(mesh, rows, r, place)
    return good


@ti.func
def propose_split_in_middle(mesh: Template, rows: Template, limits: Template, r, t, i, j):
    """`propose_split` at the `middle` of an edge; where distances grow not beside a particle that it would go into."""
    count, _ = around_edge(mesh, rows, r, t, i, j)
    interface = is_interface(mesh, rows, r, count)
    a, b = mesh.cells[t, i], mesh.cells[t, j]
    place = middle(mesh, t, a, b, interface)
    good, least = True, APART * wanted(mesh, a, b)
    if least > APART:
        for k in range(count * (mesh.dim + 1)):
            w = mesh.cells[in_cavity(rows, r, k // (mesh.dim + 1)), k % (mesh.dim + 1)]
            if (position(mesh, w) - place).norm() < least * limits[SPACING]:
                good = False
    if good:
        good = propose_split(mesh, rows, r, t, i, j, place, GOOD)
    return good


@ti.func
def propose_insertion(mesh: Template, rows: Template, r, t, a, place):
    """Propose to put a particle at a place on an edge from a, a particle of cell t; whether there is one under it."""
    count, at, end = add_star(mesh, rows, r, 0, t, a), -1, -1
    to_place = place - position(mesh, a)
    for k in range(count * (mesh.dim + 1)):
        c = in_cavity(rows, r, k // (mesh.dim + 1))
        w = mesh.cells[c, k % (mesh.dim + 1)]
        side = position(mesh, w) - position(mesh, a)
        along = side.dot(to_place)
        beside = to_place - side * (along / (side.norm_sqr() + 1e-300))
        if w != a and beside.norm() < ON_EDGE * to_place.norm() and 0 < along and along < side.norm_sqr():
            at, end = c, w
    good = at >= 0
    if good:
        good = propose_split(mesh, rows, r, at, index(mesh, at, a), index(mesh, at, end), place, FAIR)
    return good
