"""Changes to a triangulation in place, as Taichi functions: flips, collapses and splits of edges.

A triangulation is three arrays: ``cells`` (M, 3), corners counter-clockwise; ``neighbours`` (M, 3), the
cell beyond the edge opposite each corner, -1 beyond the hull; ``fluid`` (M,), the fluid of each cell,
-1 for a cell that is gone. ``corner`` (N,) names one cell at each particle. ``x`` (N, >= 2) starts with
the positions. All functions here run in one thread: what they change is shared by neighbours.
"""

import taichi as ti

# More cells than this around one particle are left alone; six is the mean.
STAR = 60


@ti.func
def double_area(x: ti.template(), a, b, c):
    """Twice the signed area of a triangle."""
    return (x[b, 0] - x[a, 0]) * (x[c, 1] - x[a, 1]) - (x[b, 1] - x[a, 1]) * (x[c, 0] - x[a, 0])


@ti.func
def distance(x: ti.template(), a, b):
    """Distance of two particles."""
    return ti.sqrt((x[a, 0] - x[b, 0]) ** 2 + (x[a, 1] - x[b, 1]) ** 2)


@ti.func
def target(x: ti.template(), a, b):
    """Target length of the edge between two particles; column 8 of ``x`` has the particles' target spacings."""
    return 0.5 * (x[a, 8] + x[b, 8])


@ti.func
def in_circle(x: ti.template(), a, b, c, d):
    """How far d lies inside the circle through a, b, c (counter-clockwise), relative to the size of the four.

    The determinant of Guibas & Stolfi (1985), over the square of its largest length squared: > 0 inside.
    """
    ax, ay = x[a, 0] - x[d, 0], x[a, 1] - x[d, 1]
    bx, by = x[b, 0] - x[d, 0], x[b, 1] - x[d, 1]
    cx, cy = x[c, 0] - x[d, 0], x[c, 1] - x[d, 1]
    a2, b2, c2 = ax * ax + ay * ay, bx * bx + by * by, cx * cx + cy * cy
    determinant = a2 * (bx * cy - cx * by) - b2 * (ax * cy - cx * ay) + c2 * (ax * by - bx * ay)
    largest = ti.max(a2, b2, c2)
    return determinant / (largest * largest)


@ti.func
def place(array: ti.template(), row, value):
    """Column (0 to 2) of a row of three that holds ``value``; -1 if none does."""
    column = -1
    for k in ti.static(range(3)):
        if array[row, k] == value:
            column = k
    return column


@ti.func
def link(neighbours: ti.template(), cell, old, new):
    """Where ``cell`` had ``old`` as a neighbour it has ``new``; a cell of -1 is the outside."""
    if cell >= 0:
        k = place(neighbours, cell, old)
        if k >= 0:
            neighbours[cell, k] = new


@ti.func
def set_cell(cells: ti.template(), neighbours: ti.template(), corner: ti.template(), t, a, b, c, na, nb, nc):
    """Cell t = (a, b, c) with the neighbours opposite a, b and c."""
    cells[t, 0], cells[t, 1], cells[t, 2] = a, b, c
    neighbours[t, 0], neighbours[t, 1], neighbours[t, 2] = na, nb, nc
    corner[a] = t
    corner[b] = t
    corner[c] = t


@ti.func
def should_flip(x: ti.template(), cells: ti.template(), neighbours: ti.template(), fluid: ti.template(), t, i, slack):
    """Whether the edge opposite corner i of cell t is neither Delaunay nor part of an interface or the hull."""
    result = False
    o = neighbours[t, i]
    if o >= 0 and fluid[t] >= 0:
        if fluid[o] == fluid[t]:
            a, b, c = cells[t, i], cells[t, (i + 1) % 3], cells[t, (i + 2) % 3]
            d = cells[o, place(neighbours, o, t)]
            if in_circle(x, a, b, c, d) > slack:
                # True of every edge that is not Delaunay, but for round-off: the four are in convex position.
                result = double_area(x, a, b, d) > 0 and double_area(x, a, d, c) > 0
    return result


@ti.func
def touch(neighbours: ti.template(), stale: ti.template(), t):
    """Note in ``stale`` (M,) int8 that a cell and its neighbours have to be looked at again: sets 0 to 1."""
    if stale[t] == 0:
        stale[t] = ti.i8(1)
    for k in ti.static(range(3)):
        o = neighbours[t, k]
        if o >= 0:
            if stale[o] == 0:
                stale[o] = ti.i8(1)


@ti.func
def flip(cells: ti.template(), neighbours: ti.template(), corner: ti.template(), t, i):
    """Turn the edge b-c between cells (a, b, c) and (d, c, b) into a-d."""
    o = neighbours[t, i]
    j = place(neighbours, o, t)
    a, b, c, d = cells[t, i], cells[t, (i + 1) % 3], cells[t, (i + 2) % 3], cells[o, j]
    beyond_ca, beyond_ab = neighbours[t, (i + 1) % 3], neighbours[t, (i + 2) % 3]
    beyond_bd, beyond_dc = neighbours[o, (j + 1) % 3], neighbours[o, (j + 2) % 3]
    set_cell(cells, neighbours, corner, o, a, d, c, beyond_dc, beyond_ca, t)
    set_cell(cells, neighbours, corner, t, a, b, d, beyond_bd, o, beyond_ab)
    link(neighbours, beyond_bd, o, t)
    link(neighbours, beyond_ca, t, o)


@ti.func
def split(
    cells: ti.template(), neighbours: ti.template(), corner: ti.template(), fluid: ti.template(), t, i, n, t2, o2
):
    """Put particle n on the edge b-c opposite corner i of cell t; t2 and o2 are free cells (o2 unused on the hull)."""
    o = neighbours[t, i]
    a, b, c = cells[t, i], cells[t, (i + 1) % 3], cells[t, (i + 2) % 3]
    beyond_ca, beyond_ab = neighbours[t, (i + 1) % 3], neighbours[t, (i + 2) % 3]
    fluid[t2] = fluid[t]
    far, near = -1, -1
    if o >= 0:
        j = place(neighbours, o, t)
        d = cells[o, j]
        beyond_bd, beyond_dc = neighbours[o, (j + 1) % 3], neighbours[o, (j + 2) % 3]
        fluid[o2] = fluid[o]
        set_cell(cells, neighbours, corner, o, d, c, n, t2, o2, beyond_dc)
        set_cell(cells, neighbours, corner, o2, d, n, b, t, beyond_bd, o)
        link(neighbours, beyond_bd, o, o2)
        far, near = o2, o
    set_cell(cells, neighbours, corner, t, a, b, n, far, t2, beyond_ab)
    set_cell(cells, neighbours, corner, t2, a, n, c, near, beyond_ca, t)
    link(neighbours, beyond_ca, t, t2)


@ti.func
def collect_star(cells: ti.template(), neighbours: ti.template(), corner: ti.template(), p, star: ti.template(), base):
    """The cells around particle p, counter-clockwise, from the hull on if p is on it, in ``star[base:]``.

    Returns how many, and 1 if they close a ring or 0 if p is on the hull; (0, 0) if there are too many.
    """
    first = corner[p]
    t, closed, steps = first, 1, 0
    while steps <= STAR:
        before = neighbours[t, (place(cells, t, p) + 2) % 3]
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
            star[base + count] = t
            count += 1
            t = neighbours[t, (place(cells, t, p) + 1) % 3]
            if t < 0 or t == first:
                break
    if count > STAR:
        count = 0
    return count, closed


@ti.func
def ring(cells: ti.template(), star: ti.template(), base, count, p, m):
    """Neighbour m of particle p, where cell m of its star begins (m = count: where the last one ends)."""
    t = star[base + ti.min(m, count - 1)]
    k = place(cells, t, p)
    return cells[t, (k + 1) % 3] if m < count else cells[t, (k + 2) % 3]


@ti.func
def interface_edges(cells: ti.template(), fluid: ti.template(), star: ti.template(), base, count, closed, p):
    """How many interface edges leave particle p, and the far ends of the first two."""
    number, first, second = 0, -1, -1
    for m in range(1 - closed, count):
        before = star[base + (m + count - 1) % count]
        if fluid[before] != fluid[star[base + m]]:
            end = ring(cells, star, base, count, p, m)
            if number == 0:
                first = end
            else:
                second = end
            number += 1
    return number, first, second


@ti.func
def can_collapse(x: ti.template(), cells: ti.template(), star: ti.template(), base, count, p, q, least):
    """Whether p can be moved into its neighbour q: all cells around it keep twice an area of ``least``."""
    result = True
    for m in range(count):
        t = star[base + m]
        if place(cells, t, q) < 0:
            k = place(cells, t, p)
            if double_area(x, q, cells[t, (k + 1) % 3], cells[t, (k + 2) % 3]) < least:
                result = False
    return result


@ti.func
def collapse(
    cells: ti.template(),
    neighbours: ti.template(),
    corner: ti.template(),
    fluid: ti.template(),
    star: ti.template(),
    base,
    count,
    p,
    q,
):
    """Remove particle p by moving its cells' corner to its neighbour q; the one or two cells at p-q vanish."""
    for m in range(count):
        t = star[base + m]
        if place(cells, t, q) >= 0:
            beyond_p = neighbours[t, place(cells, t, p)]
            beyond_q = neighbours[t, place(cells, t, q)]
            link(neighbours, beyond_p, t, beyond_q)
            link(neighbours, beyond_q, t, beyond_p)
            fluid[t] = -1
    for m in range(count):
        t = star[base + m]
        if fluid[t] >= 0:
            cells[t, place(cells, t, p)] = q
            for k in ti.static(range(3)):
                corner[cells[t, k]] = t
    corner[p] = -1


@ti.func
def weigh(x: ti.template(), cells: ti.template(), fluid: ti.template(), density: ti.template(), t, sign):
    """Add (sign 1) or take away (-1) a cell's mass at its particles, a third each; column 7 of ``x`` has the masses.

    Returns the momentum (2) and the mass that this adds.
    """
    change = ti.Vector([0.0, 0.0, 0.0])
    if fluid[t] >= 0:
        share = sign * density[fluid[t]] * double_area(x, cells[t, 0], cells[t, 1], cells[t, 2]) / 6.0
        for k in ti.static(range(3)):
            x[cells[t, k], 7] += share
            change += share * ti.Vector([x[cells[t, k], 2], x[cells[t, k], 3], 1.0])
    return change


@ti.func
def momentum(x: ti.template(), nodes: ti.template(), base, count):
    """Momentum (2,) of the particles ``nodes[base:base + count]``; columns 2 and 3 of ``x`` have the velocities."""
    total = ti.Vector([0.0, 0.0])
    for m in range(count):
        i = nodes[base + m]
        total += x[i, 7] * ti.Vector([x[i, 2], x[i, 3]])
    return total


@ti.func
def give(x: ti.template(), wall: ti.template(), nodes: ti.template(), base, count, lost):
    """Give ``lost`` momentum (2,) back to those of some particles that are no wall's: one velocity for them all."""
    mass = 0.0
    walls = 0
    for m in range(count):
        if wall[nodes[base + m]] == 0:
            mass += x[nodes[base + m], 7]
        else:
            walls += 1
    if mass > 0 and walls == 0:
        for m in range(count):
            i = nodes[base + m]
            if wall[i] == 0:
                x[i, 2] += lost[0] / mass
                x[i, 3] += lost[1] / mass
