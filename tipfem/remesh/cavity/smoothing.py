"""Other places for particles, where no change of cells is left."""

import taichi as ti

from tipfem.backend.array_types import Template
from tipfem.remesh.cavity.arrays import (
    COUNT,
    FIXED,
    GAIN,
    KIND,
    SMOOTH,
    SPACING,
    P,
    cell,
    gradient,
    has_mark,
    in_cavity,
    index,
    position,
    quality,
    quality_with,
    set_place,
)
from tipfem.remesh.cavity.stars import BOUNDARY, add_star, labels_at

OTHER = 0.1  # sine of the angle between the planes of different walls, at least
TRIALS, TO_MIDDLE = 8, 3  # places that are tried, and how many of them on the way to the middle of the star
PART, STEP = 0.25, 0.02  # the first, in parts of that way, and in spacings along a gradient; each is twice the last


@ti.func
def without(v, direction):
    """A vector without its part along a direction."""
    return v - direction * (direction.dot(v) / (direction.norm_sqr() + 1e-300))


@ti.func
def directions_of_labels(mesh: Template, rows: Template, r, count, t, p, bits):
    """(d,) the gradients of one label's measure by the place of p, and of another's at right angles; how many labels.

    Moves at right angles to both keep the volumes of two or of three labels ``bits`` around p, those of row r.
    """
    first, second = ti.Vector.zero(ti.f64, mesh.dim), ti.Vector.zero(ti.f64, mesh.dim)
    number, another = 0, -1
    for b in ti.static(range(8)):
        if (bits >> b) & 1:
            number += 1
            if b != mesh.label[t]:
                another = b
    if number > 1:
        for m in range(count):
            c = in_cavity(rows, r, m)
            if mesh.label[c] == mesh.label[t]:
                first += gradient(mesh, c, index(mesh, c, p))
            elif number == 3 and mesh.label[c] == another:
                second += gradient(mesh, c, index(mesh, c, p))
        second = without(second, first)
    return first, second, number


@ti.func
def normals_at(mesh: Template, rows: Template, r, count, p):
    """(d,) the normal of a wall at p among the cells of row r, and of another one at right angles; zero for none."""
    first, second = ti.Vector.zero(ti.f64, mesh.dim), ti.Vector.zero(ti.f64, mesh.dim)
    for m in range(count):
        c = in_cavity(rows, r, m)
        for i in range(mesh.dim + 1):
            if mesh.across[c, i] < 0 and mesh.cells[c, i] != p:
                n = gradient(mesh, c, i)
                n /= n.norm() + 1e-300
                other = without(n, first)
                if first.norm_sqr() == 0.0:
                    first = n
                elif second.norm_sqr() == 0.0 and other.norm() > OTHER:
                    second = other
    return first, second


@ti.func
def propose_smoothing(mesh: Template, rows: Template, limits: Template, r, t):
    """Propose the best move of a particle of cell t that raises the smallest quality around it; whether there is one.

    To the middle of its star, or along the gradient of the worst cell there, as far as the labels keep their volumes,
    and along walls.
    """
    best, pick, where = 0.0, -1, position(mesh, mesh.cells[t, 0])
    for k in range(mesh.dim + 1):
        p = mesh.cells[t, k]
        if not has_mark(mesh, p, FIXED):
            count = add_star(mesh, rows, r, 0, t, p)
            bits = labels_at(mesh, rows, r, count, p, -1, -1)
            first, second, number = directions_of_labels(mesh, rows, r, count, t, p, bits)
            third = ti.Vector.zero(ti.f64, mesh.dim)
            if bits >= 1 << BOUNDARY:
                along = first
                first, second = normals_at(mesh, rows, r, count, p)
                third = without(without(along, first), second)
                number += ti.select(number > 2, mesh.dim, 0)
            if count > 0 and number <= mesh.dim:
                old, lowest, total, corners = 1e30, t, ti.Vector.zero(ti.f64, mesh.dim), 0
                for m in range(count):
                    c = in_cavity(rows, r, m)
                    q = quality(mesh, c)
                    if q < old:
                        old, lowest = q, c
                    for w in ti.static(range(mesh.dim + 1)):
                        if mesh.cells[c, w] != p:
                            total += position(mesh, mesh.cells[c, w])
                            corners += 1
                up = gradient(mesh, lowest, index(mesh, lowest, p))
                up *= limits[SPACING] / (up.norm() + 1e-300)
                for way in range(TRIALS):
                    move = up * STEP * (1 << ti.max(way - TO_MIDDLE, 0))
                    if way < TO_MIDDLE:
                        move = (total / corners - position(mesh, p)) * PART * (1 << way)
                    y = position(mesh, p) + without(without(without(move, first), second), third)
                    low = 1e30
                    for m in range(count):
                        if low > best:
                            c = in_cavity(rows, r, m)
                            low = ti.min(low, quality_with(mesh, cell(mesh, c), index(mesh, c, p), y))
                    if low > best and low > old + limits[GAIN]:
                        best, pick, where = low, p, y
    if pick >= 0:
        rows.row[r, COUNT] = add_star(mesh, rows, r, 0, t, pick)
        rows.row[r, KIND], rows.row[r, P] = SMOOTH, pick
        set_place(mesh, rows, r, where)
    return pick >= 0
