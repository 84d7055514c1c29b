"""Kernels that take particles out of a triangulation and put some in: in place, on the arrays of `edge_operations`.

A look at all cells runs in parallel and flags what needs attention; the few changes that follow run in one thread.
``state`` (N, 9) holds position, velocity, acceleration, pressure, lumped mass and target spacing; thresholds are
relative to the targets where they are applied. A change that would change momentum, for it deals out masses anew,
gives the difference back to the particles around that no wall holds.
"""

import taichi as ti

from tipfem.backend.launch import kernel
from tipfem.remesh.edges.edge_operations import (
    STAR,
    can_collapse,
    collapse,
    collect_star,
    distance,
    double_area,
    give,
    interface_edges,
    momentum,
    place,
    ring,
    split,
    target,
    touch,
    weigh,
)
from tipfem.remesh.edges.long_edges import keep_longest, key_of


@ti.func
def keep_area(
    state: ti.template(),
    cells: ti.template(),
    fluid: ti.template(),
    density: ti.template(),
    star: ti.template(),
    a,
    p,
    q,
    b,
    count,
    base,
    least,
):
    """Move q between p and q, where the interface a-q-b encloses what a-p-q-b did; not if it spoils a cell."""
    ex, ey = state[b, 0] - state[a, 0], state[b, 1] - state[a, 1]
    wanted = double_area(state, a, p, q) + double_area(state, a, q, b)
    mx, my = 0.5 * (state[p, 0] + state[q, 0]), 0.5 * (state[p, 1] + state[q, 1])
    has = ex * (my - state[a, 1]) - ey * (mx - state[a, 0])
    # double_area(a, x, b) = (x - a) x (b - a) = -e x (x - a)
    shift = (wanted + has) / (ex * ex + ey * ey)
    old = ti.Vector([state[q, 0], state[q, 1]])
    change = ti.Vector([0.0, 0.0, 0.0])
    for m in range(count):
        change += weigh(state, cells, fluid, density, star[base + m], -1)
    state[q, 0], state[q, 1] = mx + shift * ey, my - shift * ex
    good = True
    for m in range(count):
        t = star[base + m]
        if double_area(state, cells[t, 0], cells[t, 1], cells[t, 2]) < least:
            good = False
    if not good:
        state[q, 0], state[q, 1] = old[0], old[1]
    for m in range(count):
        change += weigh(state, cells, fluid, density, star[base + m], 1)
    return change


@kernel
def coarsen(
    state: ti.types.ndarray(),
    cells: ti.types.ndarray(),
    neighbours: ti.types.ndarray(),
    fluid: ti.types.ndarray(),
    corner: ti.types.ndarray(),
    fixed: ti.types.ndarray(),
    wall: ti.types.ndarray(),
    density: ti.types.ndarray(),
    star: ti.types.ndarray(),
    flag: ti.types.ndarray(),
    stale: ti.types.ndarray(),
    freed: ti.types.ndarray(),
    span: ti.types.ndarray(),
    edges: ti.types.ndarray(),
    keys: ti.types.ndarray(),
    count: ti.types.ndarray(),
    elements: ti.i32,
    particles: ti.i32,
    close: ti.f64,
    chain: ti.f64,
    edge: ti.f64,
    film: ti.f64,
    least: ti.f64,
    most: ti.i32,
    long: ti.f64,
    every: ti.i32,
    waiting: ti.i32,
    serial: ti.template(),
):
    """Take out particles that crowd others: by collapsing the edge to a neighbour.

    Off interfaces and walls: closer than ``close`` to another, or than ``edge`` to an edge of interface or wall.
    On an interface: closer than ``chain`` to the next on it, and the area enclosed is kept; or closer than
    ``film`` to a wall, which the interface then meets; where interfaces touch, only this. On a wall: closer than
    ``chain`` to the next on it, or than ``film`` where an interface meets the wall. ``fixed`` (N,) stay. No cell is
    left with less than twice the area ``least``; at most ``most`` go. All in target spacings, squared for the area.
    freed[:count[0]]: who went. ``stale`` (M,): see `edge_operations.touch`. ``star`` is scratch. ``serial``: one thread
    looks at all cells.

    Afterwards, where ``long`` > 0: the edges and keys (E,) of `long_edges.longest_edges` for the particles freed and
    ``waiting``, in no order, or of `long_edges.long_edges` if it is to be ``every`` one. count[1]: how many there
    are; count[2]: how many are needed. ``span`` (M,) is scratch: squares of the cells' longest edges over their
    targets, before.
    """
    ti.loop_config(serialize=serial)
    for i in range(particles):
        flag[i] = 0
    ti.loop_config(serialize=serial)
    for t in range(elements):
        if fluid[t] >= 0:
            longest = 0.0
            for i in ti.static(range(3)):
                o = neighbours[t, i]
                border = o < 0
                if not border:
                    border = fluid[o] != fluid[t]
                if border or o > t:
                    b, c = cells[t, ti.static((i + 1) % 3)], cells[t, ti.static((i + 2) % 3)]
                    wanted = target(state, b, c)
                    reach = ti.max(close, chain) * wanted * (1 + 1e-12)
                    square = (state[b, 0] - state[c, 0]) ** 2 + (state[b, 1] - state[c, 1]) ** 2
                    longest = ti.max(longest, square / (wanted * wanted))
                    if square < reach * reach or border:
                        length = distance(state, b, c)
                        if length < ti.max(close, chain) * wanted:
                            ti.atomic_or(flag[b], 1)
                            ti.atomic_or(flag[c], 1)
                        if border:
                            height = double_area(state, cells[t, 0], cells[t, 1], cells[t, 2])
                            if height < edge * wanted * length:
                                ti.atomic_or(flag[cells[t, i]], 2)
                            if o < 0 and height < film * wanted * length:
                                ti.atomic_or(flag[cells[t, i]], 4)
            span[t] = longest
    ti.loop_config(serialize=True)
    for p in range(particles):
        if flag[p] > 0 and fixed[p] == 0 and corner[p] >= 0 and count[0] < most:
            n, closed = collect_star(cells, neighbours, corner, p, star, 0)
            if n > 1:
                number, first, second = interface_edges(cells, fluid, star, 0, n, closed, p)
                q, gap = -1, 1e30
                along = False
                smallest = least * state[p, 8] ** 2
                if closed == 0 and number <= 1:
                    one, other = ring(cells, star, 0, n, p, 0), ring(cells, star, 0, n, p, n)
                    q = one if distance(state, p, one) < distance(state, p, other) else other
                    if distance(state, p, q) >= (chain if number == 0 else film) * target(state, p, q):
                        q = -1
                elif closed == 1 and number >= 2:
                    q = first if distance(state, p, first) < distance(state, p, second) else second
                    if number > 2 or distance(state, p, q) >= chain * target(state, p, q) or first == second:
                        q = -1
                    along = q >= 0
                    if q < 0 and flag[p] >= 4:
                        for m in range(n):
                            r = ring(cells, star, 0, n, p, m)
                            length = distance(state, p, r)
                            ends = r == first or r == second
                            nearer = wall[r] == 1 and (number > 2 or not ends) and length < gap
                            if nearer and can_collapse(state, cells, star, 0, n, p, r, smallest):
                                q, gap = r, length
                elif closed == 1 and number == 0:
                    for m in range(n):
                        r = ring(cells, star, 0, n, p, m)
                        length = distance(state, p, r)
                        wanted = length < close * target(state, p, r) or flag[p] >= 2
                        if wanted and length < gap and can_collapse(state, cells, star, 0, n, p, r, smallest):
                            q, gap = r, length
                if q >= 0:
                    if can_collapse(state, cells, star, 0, n, p, q, smallest):
                        a = second if q == first else first
                        base = 2 * (STAR + 1)
                        around = n + 1 - closed
                        for m in range(around):
                            star[base + m] = ring(cells, star, 0, n, p, m)
                        star[base + around] = p
                        total = 0.0
                        for m in range(around + 1):
                            total += state[star[base + m], 7]
                        mean = momentum(state, star, base, around + 1) / total
                        change = ti.Vector([0.0, 0.0, 0.0])
                        for m in range(n):
                            change += weigh(state, cells, fluid, density, star[m], -1)
                        collapse(cells, neighbours, corner, fluid, star, 0, n, p, q)
                        for m in range(n):
                            change += weigh(state, cells, fluid, density, star[m], 1)
                        state[p, 7] = 0.0
                        freed[count[0]] = p
                        count[0] += 1
                        flag[q] = 0  # it has room now; without this, whole rows would follow
                        if along and wall[q] == 0 and fixed[q] == 0:
                            n2, closed2 = collect_star(cells, neighbours, corner, q, star, STAR + 1)
                            if n2 > 0 and closed2 == 1:
                                number2, c1, c2 = interface_edges(cells, fluid, star, STAR + 1, n2, closed2, q)
                                if number2 == 2 and (c1 == a or c2 == a) and c1 != c2:
                                    b = c2 if c1 == a else c1
                                    change += keep_area(
                                        state, cells, fluid, density, star, a, p, q, b, n2, STAR + 1, smallest
                                    )
                                    for m in range(n2):
                                        touch(neighbours, stale, star[STAR + 1 + m])
                        for m in range(n):
                            if fluid[star[m]] >= 0:
                                touch(neighbours, stale, star[m])
                        lost = change[2] * mean - ti.Vector([change[0], change[1]])
                        give(state, wall, star, base, around, lost)
    ti.loop_config(serialize=True)
    for t in range(elements):
        if long > 0 and fluid[t] >= 0:
            wanted = ti.min(8 * (count[0] + waiting) + 32, edges.shape[0])
            bound = long if every != 0 else 0.5 * long
            if every == 0 and count[1] == wanted:
                bound = ti.max(bound, keys[0])
            lowest = ti.min(bound, long)
            if stale[t] != 0 or span[t] * (1 + 1e-9) > lowest * lowest:
                for i in ti.static(range(3)):
                    if every == 0 and count[1] == wanted:
                        bound = ti.max(bound, keys[0])
                    needed = 1.4 * long
                    found = key_of(state, cells, neighbours, fluid, t, i, long, ti.min(bound, needed))
                    if every == 0:
                        keep_longest(edges, keys, count, found, 3 * t + i, bound, needed, wanted)
                    elif found > long:
                        edges[count[1]], keys[count[1]] = 3 * t + i, found
                        count[1] = count[1] + 1


@kernel
def refine(
    state: ti.types.ndarray(),
    cells: ti.types.ndarray(),
    neighbours: ti.types.ndarray(),
    fluid: ti.types.ndarray(),
    corner: ti.types.ndarray(),
    wall: ti.types.ndarray(),
    density: ti.types.ndarray(),
    touched: ti.types.ndarray(),
    edges: ti.types.ndarray(),
    candidates: ti.i32,
    free: ti.types.ndarray(),
    freed: ti.types.ndarray(),
    count: ti.types.ndarray(),
    room: ti.f64,
    wanted: ti.i32,
):
    """Put the particles freed[count[0]:wanted] on the middle of edges, in the order given.

    edges (K,): 3 * cell + corner opposite. An edge is passed over if a cell beside it was changed already or if a
    particle stands closer than ``room`` target spacings to its middle. ``free``: cells that are gone; count[1] of
    them are used. A new particle takes the mean of the two states, which changes no momentum; on the edge of a
    wall it belongs to the wall.
    """
    ti.loop_config(serialize=True)
    for k in range(candidates):
        if count[0] < wanted:
            t, i = edges[k] // 3, edges[k] % 3
            o = neighbours[t, i]
            usable = touched[t] == 0
            if o >= 0 and usable:
                usable = touched[o] == 0
            n = freed[count[0]]
            if usable:
                b, c = cells[t, (i + 1) % 3], cells[t, (i + 2) % 3]
                for s in range(7):
                    state[n, s] = 0.5 * (state[b, s] + state[c, s])
                state[n, 8] = target(state, b, c)
                free_way = room * state[n, 8]
                usable = distance(state, n, cells[t, i]) > free_way and distance(state, n, b) > 0.8 * free_way
                if o >= 0:
                    usable = usable and distance(state, n, cells[o, place(neighbours, o, t)]) > free_way
            if usable:
                t2, o2 = free[count[1]], free[count[1] + 1]
                weigh(state, cells, fluid, density, t, -1)
                if o >= 0:
                    weigh(state, cells, fluid, density, o, -1)
                split(cells, neighbours, corner, fluid, t, i, n, t2, o2)
                weigh(state, cells, fluid, density, t, 1)
                weigh(state, cells, fluid, density, t2, 1)
                if o >= 0:
                    weigh(state, cells, fluid, density, o, 1)
                    weigh(state, cells, fluid, density, o2, 1)
                touched[t] = 1
                touched[t2] = 1
                count[1] += 1
                wall[n] = 1
                if o >= 0:
                    wall[n] = 0
                    touched[o] = 1
                    touched[o2] = 1
                    count[1] += 1
                count[0] += 1
