"""Arrays of a mesh of simplices that is changed in place, and of the changes that are proposed; measures of cells.

A change is a cavity: some cells, joined by faces, which are filled anew. A row of a table holds each proposal.
"""

from typing import NamedTuple

import taichi as ti

from tipfem.backend.array_types import Ints1, Ints2, Reals1, Reals2, Template

# Bits of the marks of particles: in the mesh, not to be moved or removed, on an interface, not at rest, on a wall.
USED, FIXED, ON, MOVES, WALL = 1, 2, 4, 8, 16
# Kinds of changes; the tasks that `rounds` finds and proposes are the first of them, by these numbers.
NONE, SWAP, COLLAPSE, SPLIT, SMOOTH, RELABEL, CURE, LAND = range(8)
# Sizes: most cells of a cavity, around an edge that is split, and around one that is removed; most new cells.
MOST, RING, SWAPPED, FILLED_MOST = 96, 16, 7, 32
# Columns of a row (R, WIDTH), each the first of its group. Groups of one number: the cell that proposes and what is
# wrong there, the kind, particles, how many cells, new cells and outer faces there are, states of claims, and what a
# winner gets.
CELL, CODE, KIND, P, Q, COUNT, FILLED, OUTERS, FIRST, WON, FREE_CELL, NEW_PARTICLE = range(12)
CAVITY = 16
AROUND = CAVITY + MOST  # particles around an edge
NEW = AROUND + RING  # four particles of each new cell
SEEN = NEW  # where cells are collected, none of which are new
NEW_LABEL = NEW + 4 * FILLED_MOST
SLOT = NEW_LABEL + FILLED_MOST  # the numbers of new cells
STACK = SLOT
OUTER = SLOT + FILLED_MOST  # three particles of each outer face, and the cell beyond
CHOICE = OUTER
WIDTH = OUTER + 4 * FILLED_MOST
# Columns of the reals of a row: urgency, three coordinates, qualities.
URGENCY, PLACE, BEST, REALS = 0, 1, 4, 4 + 2 * 64
# Limits of `rounds`: spacing [m], and those of its tasks, see there.
SPACING, LIMIT, LONGEST, LEAST, GAIN, BEND, AHEAD, LIMITS = range(8)
DONE = 1 << 15  # beside the bits of tasks for which a cell was looked at: it has got another label
LATER = -2  # of a new cell: the particle that is new


class Simplices(NamedTuple):
    """The arrays of a mesh; unused rows stay in them."""

    x: "Reals2"  # (N, d) positions [m]
    cells: "Ints2"  # (M, d + 1) particles, of positive measure
    across: "Ints2"  # (M, d + 1) the cell beyond the face opposite each corner, -1 - w beyond face w of the boundary
    label: "Ints1"  # (M,) of each cell, 0 to 7; -1 for none
    marks: "Ints1"  # (N,) bits of the particles
    wide: "Reals1"  # (N,) how far apart particles are to be around each [spacings]
    dim: "Template"  # d


class Proposals(NamedTuple):
    """The rows of proposals: their numbers (R, `WIDTH`) and reals (R, `REALS`)."""

    row: "Ints2"
    real: "Reals2"


@ti.func
def position(mesh: Template, p):
    """(d,) of a particle."""
    return ti.Vector([mesh.x[p, k] for k in ti.static(range(mesh.dim))])


@ti.func
def cell(mesh: Template, t):
    """(d + 1,) the particles of a cell."""
    return ti.Vector([mesh.cells[t, i] for i in ti.static(range(mesh.dim + 1))])


@ti.func
def index(mesh: Template, t, p):
    """The corner of a cell that is particle p; -1 for none."""
    k = -1
    for i in ti.static(range(mesh.dim + 1)):
        if mesh.cells[t, i] == p:
            k = i
    return k


@ti.func
def distance(mesh: Template, a, b):
    """Distance of two particles [m]."""
    return (position(mesh, a) - position(mesh, b)).norm()


@ti.func
def wanted(mesh: Template, a, b):
    """Length that the edge between two particles is to have [spacings]."""
    return 0.5 * (mesh.wide[a] + mesh.wide[b])


@ti.func
def finest_at(mesh: Template, limits: Template, t):
    """The least distance that particles of cell t are to have, at most the spacing [m]: films are measured by it."""
    finest = 1.0
    for i in ti.static(range(mesh.dim + 1)):
        finest = ti.min(finest, mesh.wide[mesh.cells[t, i]])
    return finest * limits[SPACING]


@ti.func
def has_mark(mesh: Template, p, bit: Template):
    """Whether a particle has a mark."""
    return mesh.marks[p] & bit != 0


@ti.func
def determinant(mesh: Template, one, two, three):
    """Determinant of the sides of a simplex from a corner, d! times its measure; ``three`` is not used in 2-D."""
    result = 0.0
    if ti.static(mesh.dim == 2):
        result = one[0] * two[1] - one[1] * two[0]
    else:
        result = one.cross(two).dot(three)
    return result


@ti.func
def measure(mesh: Template, c):
    """d! times the signed measure of a cell of particles c (d + 1,)."""
    a = position(mesh, c[0])
    return determinant(
        mesh, position(mesh, c[1]) - a, position(mesh, c[2]) - a, position(mesh, c[ti.static(mesh.dim)]) - a
    )


@ti.func
def quality_with(mesh: Template, c, i, place):
    """Quality of a cell of particles c with corner i at a place: 1 if regular, 0 if flat, below if inverted.

    In 3-D 6 sqrt(2) V / l^3, with the root mean square l of the edges; in 2-D 4 sqrt(3) A over their squares' sum.
    """
    y = ti.Matrix.rows([position(mesh, c[k]) for k in ti.static(range(mesh.dim + 1))])
    for k in ti.static(range(mesh.dim + 1)):
        if k == i:
            for a in ti.static(range(mesh.dim)):
                y[k, a] = place[a]
    squares = 0.0
    for j in ti.static(range(mesh.dim + 1)):
        for k in ti.static(range(j)):
            for a in ti.static(range(mesh.dim)):
                squares += (y[j, a] - y[k, a]) ** 2
    side = ti.Matrix.rows(
        [[y[k, a] - y[0, a] for a in ti.static(range(mesh.dim))] for k in ti.static(range(1, mesh.dim + 1))]
    )
    result = 0.0
    if ti.static(mesh.dim == 2):
        result = 3.4641016151377544 * side.determinant() / (squares + 1e-300)
    else:
        squares /= 6.0
        result = 1.4142135623730951 * side.determinant() / (squares * ti.sqrt(squares) + 1e-300)
    return result


@ti.func
def quality_of(mesh: Template, c):
    """Quality of a cell of particles c (d + 1,)."""
    return quality_with(mesh, c, -1, position(mesh, c[0]))


@ti.func
def quality(mesh: Template, t):
    """Quality of cell t."""
    return quality_of(mesh, cell(mesh, t))


@ti.func
def gradient(mesh: Template, t, k):
    """(d,) the derivative of d! times the measure of cell t with respect to its corner k."""
    g = ti.Vector.zero(ti.f64, mesh.dim)
    if ti.static(mesh.dim == 2):
        e = position(mesh, mesh.cells[t, (k + 2) % 3]) - position(mesh, mesh.cells[t, (k + 1) % 3])
        g = ti.Vector([-e[1], e[0]])
    else:
        a = position(mesh, mesh.cells[t, (k + 1) % 4])
        b, c = position(mesh, mesh.cells[t, (k + 2) % 4]), position(mesh, mesh.cells[t, (k + 3) % 4])
        g = (b - a).cross(c - a)
        if g.dot(position(mesh, mesh.cells[t, k]) - a) < 0:
            g = -g
    return g


@ti.func
def in_cavity(rows: Template, r, m):
    """Cell m of the cavity of row r."""
    return rows.row[r, CAVITY + m]


@ti.func
def new_cell(mesh: Template, rows: Template, r, m):
    """(d + 1,) the particles of new cell m of row r."""
    return ti.Vector([rows.row[r, NEW + 4 * m + i] for i in ti.static(range(mesh.dim + 1))])


@ti.func
def set_new_cell(mesh: Template, rows: Template, r, m, c, label):
    """Write new cell m of row r."""
    for i in ti.static(range(mesh.dim + 1)):
        rows.row[r, NEW + 4 * m + i] = c[i]
    rows.row[r, NEW_LABEL + m] = label


@ti.func
def set_place(mesh: Template, rows: Template, r, place):
    """Write where the particle of row r is to be."""
    for a in ti.static(range(mesh.dim)):
        rows.real[r, PLACE + a] = place[a]


@ti.func
def place_of(mesh: Template, rows: Template, r):
    """(d,) where the particle of row r is to be."""
    return ti.Vector([rows.real[r, PLACE + a] for a in ti.static(range(mesh.dim))])
