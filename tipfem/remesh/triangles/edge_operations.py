"""Changes to a triangulation in place, as Taichi functions: flips, collapses and splits of edges.

All functions here are serial, because neighbouring cells share what they change.
"""

from typing import Any, NamedTuple

import taichi as ti

from tipfem.backend.array_types import Flags1, Ints1, Ints2, Periods, Reals1, Reals2, Template
from tipfem.backend.periodic import difference
from tipfem.fem.element import area_of, parts_of

# Largest number of cells around one particle that is collected; six is the mean.
STAR = 60
# Columns of the particles' state, and how many there are: `POSITION`, `VELOCITY` and `ACCELERATION` begin two each.
POSITION, VELOCITY, ACCELERATION, PRESSURE, MASS, TARGET, COLUMNS = 0, 2, 4, 6, 7, 8, 9
INTERPOLATED = MASS  # the columns before this one are interpolated linearly to a new particle
# Values of ``stale``.
CURRENT, STALE = 0, 1
FAR = 1e30
# Values of ``wall``: of particles off the walls, of those whose velocity a wall prescribes, and of those that slide.
OFF_WALLS, HELD, SLIDES = 0, 1, 2


class TriangleArrays(NamedTuple):
    """The arrays of a triangulation of N particles and M cells.

    A kernel that has only some of them makes one by ``ti.static(TriangleArrays(...))``; those that the functions called
    do not use may be None.
    """

    state: "Reals2"  # (N, COLUMNS) of the particles; (N, 2) positions where only these are used
    cells: "Ints2"  # (M, 3) particles at the corners of each cell, counter-clockwise
    neighbours: "Ints2"  # (M, 3) the cell beyond the edge opposite each corner, -1 beyond the hull
    fluid: "Ints1"  # (M,) of each cell; -1 for a removed cell
    period: "Periods"  # of the positions, see `tipfem.backend.periodic`
    corner: "Ints1" = None  # (N,) one cell at each particle, -1 for a removed particle
    wall: "Ints1" = None  # (N,) `OFF_WALLS`, or for wall particles `HELD` or `SLIDES`
    density: "Reals1" = None  # (F,) of the fluids [kg/m^3]
    stale: "Flags1" = None  # (M,) `STALE` for cells that may have an edge to flip, else `CURRENT`


class Segment(NamedTuple):
    """Part of a scratch array, grouped in a kernel by ``ti.static(Segment(store, first))``.

    It holds the cells around a particle, its star, for which `STAR` + 1 entries are enough, or some particles.
    """

    store: Any  # (S,) the array
    first: int = 0  # number of the first entry


@ti.func
def entry(segment: Template, m):
    """Entry m of a `Segment`."""
    return segment.store[segment.first + m]


@ti.func
def set_entry(segment: Template, m, value):
    """Set entry m of a `Segment`."""
    segment.store[segment.first + m] = value


@ti.func
def side(mesh: Template, a, b):
    """The vector (2,) from particle a to particle b, see `periodic.difference`."""
    return ti.Vector([difference(mesh.state, mesh.period, b, a, k) for k in ti.static(range(2))])


@ti.func
def double_area(mesh: Template, a, b, c):
    """Twice the signed area of a triangle."""
    x, period = ti.static(mesh.state, mesh.period)
    return difference(x, period, b, a, 0) * difference(x, period, c, a, 1) - difference(
        x, period, b, a, 1
    ) * difference(x, period, c, a, 0)


@ti.func
def double_cell_area(mesh: Template, t):
    """Twice the signed area of a cell."""
    return double_area(mesh, mesh.cells[t, 0], mesh.cells[t, 1], mesh.cells[t, 2])


@ti.func
def distance(mesh: Template, a, b):
    """Distance of two particles."""
    dx, dy = difference(mesh.state, mesh.period, a, b, 0), difference(mesh.state, mesh.period, a, b, 1)
    return ti.sqrt(dx**2 + dy**2)


@ti.func
def square_distance(mesh: Template, a, b):
    """Squared distance of two particles."""
    dx, dy = difference(mesh.state, mesh.period, a, b, 0), difference(mesh.state, mesh.period, a, b, 1)
    return dx * dx + dy * dy


@ti.func
def beside(mesh: Template, a, point):
    """The vector (2,) from particle a to a point (2,), with periodic sides to its nearest image."""
    d = ti.Vector([point[0] - mesh.state[a, 0], point[1] - mesh.state[a, 1]])
    if ti.static(len(mesh.period.shape) == 2):
        for k in ti.static(range(2)):
            d[k] -= mesh.period[0, k] * ti.floor(d[k] * mesh.period[1, k] + 0.5)
    return d


@ti.func
def target(x: Template, a, b):
    """Target length of the edge between two particles."""
    return 0.5 * (x[a, TARGET] + x[b, TARGET])


@ti.func
def circle_determinant(mesh: Template, a, b, c, d):
    """The determinant of Guibas & Stolfi (1985): > 0 for d inside the circle through a, b, c (counter-clockwise).

    Returns it and the squares of the distances of a, b and c from d.
    """
    x, period = ti.static(mesh.state, mesh.period)
    ax, ay = difference(x, period, a, d, 0), difference(x, period, a, d, 1)
    bx, by = difference(x, period, b, d, 0), difference(x, period, b, d, 1)
    cx, cy = difference(x, period, c, d, 0), difference(x, period, c, d, 1)
    a2, b2, c2 = ax * ax + ay * ay, bx * bx + by * by, cx * cx + cy * cy
    return a2 * (bx * cy - cx * by) - b2 * (ax * cy - cx * ay) + c2 * (ax * by - bx * ay), a2, b2, c2


@ti.func
def column_of(array: Template, row, value):
    """Column (0 to 2) of a row of three that holds ``value``; -1 if none does."""
    column = -1
    for k in ti.static(range(3)):
        if array[row, k] == value:
            column = k
    return column


@ti.func
def is_border(mesh: Template, t, i: Template):
    """Whether the edge opposite corner i of cell t is part of an interface or of the hull."""
    o = mesh.neighbours[t, i]
    border = o < 0
    if not border:
        border = mesh.fluid[o] != mesh.fluid[t]
    return border


@ti.func
def replace_neighbour(mesh: Template, cell, old, new):
    """Replace the neighbour ``old`` of ``cell`` by ``new``; a cell of -1 is the outside."""
    if cell >= 0:
        k = column_of(mesh.neighbours, cell, old)
        if k >= 0:
            mesh.neighbours[cell, k] = new


@ti.func
def set_cell(mesh: Template, t, a, b, c, na, nb, nc):
    """Cell t = (a, b, c) with the neighbours opposite a, b and c."""
    mesh.cells[t, 0], mesh.cells[t, 1], mesh.cells[t, 2] = a, b, c
    mesh.neighbours[t, 0], mesh.neighbours[t, 1], mesh.neighbours[t, 2] = na, nb, nc
    mesh.corner[a] = t
    mesh.corner[b] = t
    mesh.corner[c] = t


@ti.func
def mark_stale(mesh: Template, t):
    """Mark a cell and its neighbours, which may have an edge to flip."""
    if mesh.stale[t] == CURRENT:
        mesh.stale[t] = ti.i8(STALE)
    for k in ti.static(range(3)):
        o = mesh.neighbours[t, k]
        if o >= 0:
            if mesh.stale[o] == CURRENT:
                mesh.stale[o] = ti.i8(STALE)


@ti.func
def flip(mesh: Template, t, i):
    """Replace the edge b-c between cells (a, b, c) and (d, c, b) by a-d; i is the corner of cell t that is a."""
    cells, neighbours = ti.static(mesh.cells, mesh.neighbours)
    o = neighbours[t, i]
    j = column_of(neighbours, o, t)
    a, b, c, d = cells[t, i], cells[t, (i + 1) % 3], cells[t, (i + 2) % 3], cells[o, j]
    cell_ca, cell_ab = neighbours[t, (i + 1) % 3], neighbours[t, (i + 2) % 3]
    cell_bd, cell_dc = neighbours[o, (j + 1) % 3], neighbours[o, (j + 2) % 3]
    set_cell(mesh, o, a, d, c, cell_dc, cell_ca, t)
    set_cell(mesh, t, a, b, d, cell_bd, o, cell_ab)
    replace_neighbour(mesh, cell_bd, o, t)
    replace_neighbour(mesh, cell_ca, t, o)


@ti.func
def split(mesh: Template, t, i, n, t2, o2):
    """Put particle n on the edge b-c opposite corner i of cell t; t2 and o2 are unused cells (o2 not for the hull)."""
    cells, neighbours = ti.static(mesh.cells, mesh.neighbours)
    o = neighbours[t, i]
    a, b, c = cells[t, i], cells[t, (i + 1) % 3], cells[t, (i + 2) % 3]
    cell_ca, cell_ab = neighbours[t, (i + 1) % 3], neighbours[t, (i + 2) % 3]
    mesh.fluid[t2] = mesh.fluid[t]
    beside_t, beside_t2 = -1, -1
    if o >= 0:
        j = column_of(neighbours, o, t)
        d = cells[o, j]
        cell_bd, cell_dc = neighbours[o, (j + 1) % 3], neighbours[o, (j + 2) % 3]
        mesh.fluid[o2] = mesh.fluid[o]
        set_cell(mesh, o, d, c, n, t2, o2, cell_dc)
        set_cell(mesh, o2, d, n, b, t, cell_bd, o)
        replace_neighbour(mesh, cell_bd, o, o2)
        beside_t, beside_t2 = o2, o
    set_cell(mesh, t, a, b, n, beside_t, t2, cell_ab)
    set_cell(mesh, t2, a, n, c, beside_t2, cell_ca, t)
    replace_neighbour(mesh, cell_ca, t, t2)


@ti.func
def collect_star(mesh: Template, star: Template, p):
    """Store the cells around particle p, counter-clockwise, in a `Segment`; of a particle on the hull from there on.

    Returns how many, and 1 if they surround p or 0 if p is on the hull; (0, 0) if there are too many.
    """
    cells, neighbours = ti.static(mesh.cells, mesh.neighbours)
    first = mesh.corner[p]
    t, closed, steps = first, 1, 0
    while steps <= STAR:
        before = neighbours[t, (column_of(cells, t, p) + 2) % 3]
        steps += 1
        if before < 0:
            closed, first = 0, t
        if before < 0 or before == first:
            break
        t = before
    count = 0
    if steps <= STAR:
        t = first
        while count <= STAR:
            set_entry(star, count, t)
            count += 1
            t = neighbours[t, (column_of(cells, t, p) + 1) % 3]
            if t < 0 or t == first:
                break
    if count > STAR:
        count = 0
    return count, closed


@ti.func
def ring(mesh: Template, star: Template, count, p, m):
    """Particle m of the link of p, with which cell m of its star begins (m = count: with which the last one ends)."""
    t = entry(star, ti.min(m, count - 1))
    k = column_of(mesh.cells, t, p)
    return mesh.cells[t, (k + 1) % 3] if m < count else mesh.cells[t, (k + 2) % 3]


@ti.func
def interface_edges(mesh: Template, star: Template, count, closed, p):
    """Number of interface edges that leave particle p, and the far ends of the first two, -1 for none."""
    number, first, second = 0, -1, -1
    for m in range(1 - closed, count):
        before = entry(star, (m + count - 1) % count)
        if mesh.fluid[before] != mesh.fluid[entry(star, m)]:
            end = ring(mesh, star, count, p, m)
            if number == 0:
                first = end
            else:
                second = end
            number += 1
    return number, first, second


@ti.func
def can_collapse(mesh: Template, star: Template, count, p, q, least):
    """Whether p can be moved into its neighbour q: all cells around it keep twice an area of ``least``."""
    result = True
    for m in range(count):
        t = entry(star, m)
        if column_of(mesh.cells, t, q) < 0:
            k = column_of(mesh.cells, t, p)
            if double_area(mesh, q, mesh.cells[t, (k + 1) % 3], mesh.cells[t, (k + 2) % 3]) < least:
                result = False
    return result


@ti.func
def collapse(mesh: Template, star: Template, count, p, q):
    """Remove particle p by moving its cells' corner to its neighbour q; the one or two cells at p-q are removed."""
    for m in range(count):
        t = entry(star, m)
        if column_of(mesh.cells, t, q) >= 0:
            opposite_p = mesh.neighbours[t, column_of(mesh.cells, t, p)]
            opposite_q = mesh.neighbours[t, column_of(mesh.cells, t, q)]
            replace_neighbour(mesh, opposite_p, t, opposite_q)
            replace_neighbour(mesh, opposite_q, t, opposite_p)
            mesh.fluid[t] = -1
    for m in range(count):
        t = entry(star, m)
        if mesh.fluid[t] >= 0:
            mesh.cells[t, column_of(mesh.cells, t, p)] = q
            for k in ti.static(range(3)):
                mesh.corner[mesh.cells[t, k]] = t
    mesh.corner[p] = -1


@ti.func
def mass_parts(mesh: Template, t, density):
    """Masses (3,) of cell ``t``, with a ``density``, at its corners."""
    share = density * double_cell_area(mesh, t) / 6.0
    result = ti.Vector([share, share, share])
    if ti.static(len(mesh.period.shape) == 3):
        whole = density * area_of(mesh.state, mesh.cells, mesh.period, t)
        result = parts_of(whole, mesh.state, mesh.cells, mesh.period, t)
    return result


@ti.func
def add_mass(mesh: Template, t, sign):
    """Add (sign 1) or subtract (-1) a cell's mass at its particles, see `mass_parts`.

    Returns the momentum (2) and the mass that this adds.
    """
    change = ti.Vector([0.0, 0.0, 0.0])
    if mesh.fluid[t] >= 0:
        shares = mass_parts(mesh, t, sign * mesh.density[mesh.fluid[t]])
        for k in ti.static(range(3)):
            i, share = mesh.cells[t, k], shares[k]
            mesh.state[i, MASS] += share
            change += share * ti.Vector([mesh.state[i, VELOCITY], mesh.state[i, VELOCITY + 1], 1.0])
    return change


@ti.func
def momentum_of(x: Template, group: Template, count):
    """Momentum (2,) of the first ``count`` particles of a `Segment`."""
    total = ti.Vector([0.0, 0.0])
    for m in range(count):
        i = entry(group, m)
        total += x[i, MASS] * ti.Vector([x[i, VELOCITY], x[i, VELOCITY + 1]])
    return total


@ti.func
def share_rates(mesh: Template, i, part, rates):
    """Set velocity and acceleration of a ``part`` of the mass of particle i to ``rates`` (4,); the rest keeps its own.

    A particle that a wall holds keeps its own.
    """
    if mesh.wall[i] != HELD:
        for c in ti.static(range(4)):
            mesh.state[i, VELOCITY + c] += part * (rates[c] - mesh.state[i, VELOCITY + c])


@ti.func
def distribute_momentum(mesh: Template, group: Template, count, lost, limit):
    """Add ``lost`` momentum (2,) to the first ``count`` particles of a `Segment`.

    All of them change by one velocity, ``limit`` at most. No velocity changes if a wall holds one of them, which takes
    up the momentum. Those that slide along a wall take part; what they gain at right angles to it, the wall takes up.
    """
    mass = 0.0
    held = 0
    for m in range(count):
        mass += mesh.state[entry(group, m), MASS]
        if mesh.wall[entry(group, m)] == HELD:
            held += 1
    if mass > 0 and held == 0:
        part = ti.min(1.0, limit * mass / ti.max(lost.norm(), 1e-300))
        for m in range(count):
            for k in ti.static(range(2)):
                mesh.state[entry(group, m), VELOCITY + k] += part * lost[k] / mass
