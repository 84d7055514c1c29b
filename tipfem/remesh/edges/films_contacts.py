"""Kernel for interfaces that run along edges: films that break, what is taken in, and where they meet walls.

Arrays are those of `coarsen_refine`; marks of particles those of `volume_kernels.take_stock`.
"""

import taichi as ti

from tipfem.backend.launch import kernel
from tipfem.remesh.edges.edge_operations import (
    STAR,
    collect_star,
    distance,
    double_area,
    interface_edges,
    ring,
    target,
    touch,
    weigh,
)


@kernel
def tidy(
    state: ti.types.ndarray(),
    cells: ti.types.ndarray(),
    neighbours: ti.types.ndarray(),
    fluid: ti.types.ndarray(),
    corner: ti.types.ndarray(),
    fixed: ti.types.ndarray(),
    density: ti.types.ndarray(),
    mark: ti.types.ndarray(),
    way: ti.types.ndarray(),
    star: ti.types.ndarray(),
    stale: ti.types.ndarray(),
    flag: ti.types.ndarray(),
    count: ti.types.ndarray(),
    particles: ti.i32,
    elements: ti.i32,
    reach: ti.f64,
    gap: ti.f64,
    least: ti.f64,
    thin: ti.f64,
    low: ti.f64,
    long: ti.f64,
    serial: ti.template(),
):
    """Let interfaces meet walls where they point to, break films, and take in what all but lies on an interface.

    Contacts slide along walls: the line through the last two particles of the interface off the wall, A and B, is
    carried on to the wall, at most ``reach`` from the foot of A. In a step it goes at most twice as far as A did
    (``way`` (N, 2) is the particles' [m]): the fluid wets walls by its motion, and does not creep along them. The
    particle stays ``gap`` away from the next ones on the wall, and no cell is left with less than twice the area
    ``least``. ``stale`` (M,): see `edge_operations.touch`. None slides where ``particles`` is 0.

    Films go to the fluid beside them: cells with no particle inside their fluid, lower than ``thin``. A film that thin
    is about to let two surfaces meet, or a filament to break. Its cells go to the fluid beyond their longest edge at an
    interface. count[0]: how many.

    If no film breaks, for then the marks are wrong: a cell lower than ``low`` over an interface's edge longer than
    ``long`` goes to the fluid beyond the edge, if its third particle is neither on an interface nor on the hull: there
    is no room on such an edge for another one, and that one cannot be taken out where others lie as close. count[1]:
    how many cells; ``mark`` (N,) is kept.

    All lengths are relative to the targets. ``flag`` (M,), ``star``: scratch. ``serial``: one thread looks at cells.
    """
    ti.loop_config(serialize=True)
    for w in range(particles):
        if mark[w] == 3 and fixed[w] == 0 and corner[w] >= 0:
            n, closed = collect_star(cells, neighbours, corner, w, star, 0)
            if n > 1 and closed == 0:
                number, a, _none = interface_edges(cells, fluid, star, 0, n, closed, w)
                if number == 1 and mark[a] == 1:
                    n2, closed2 = collect_star(cells, neighbours, corner, a, star, STAR + 1)
                    number2, c1, c2 = interface_edges(cells, fluid, star, STAR + 1, n2, closed2, a)
                    one, other = ring(cells, star, 0, n, w, 0), ring(cells, star, 0, n, w, n)
                    # The wall's direction; the fluid is on its left.
                    length = distance(state, one, other)
                    tx, ty = (state[one, 0] - state[other, 0]) / length, (state[one, 1] - state[other, 1]) / length
                    wx, wy = state[w, 0], state[w, 1]
                    ax, ay = state[a, 0] - wx, state[a, 1] - wy
                    foot = ax * tx + ay * ty
                    height = ti.abs(ax * ty - ay * tx)
                    far, near, smallest = reach * state[w, 8], gap * state[w, 8], least * state[w, 8] ** 2
                    goal = ti.max(foot - far, ti.min(foot + far, 0.0))
                    if n2 > 0 and number2 == 2:
                        b = c2 if c1 == w else c1
                        bx, by = state[b, 0] - wx, state[b, 1] - wy
                        above = ti.abs(bx * ty - by * tx)
                        if above > 1.05 * height:
                            goal = foot + (foot - bx * tx - by * ty) * height / (above - height)
                            goal = ti.max(foot - far, ti.min(foot + far, goal))
                    moved = 2 * ti.sqrt((way[a, 0] - way[w, 0]) ** 2 + (way[a, 1] - way[w, 1]) ** 2)
                    goal = ti.max(-moved, ti.min(moved, goal))
                    # ``one`` lies ahead (in the direction of t), ``other`` behind.
                    ahead = distance(state, w, one) - near
                    behind = distance(state, w, other) - near
                    goal = ti.max(-ti.max(behind, 0.0), ti.min(ti.max(ahead, 0.0), goal))
                    for m in range(n):
                        weigh(state, cells, fluid, density, star[m], -1)
                    tries = 0
                    while tries < 3:
                        state[w, 0], state[w, 1] = wx + goal * tx, wy + goal * ty
                        good = True
                        for m in range(n):
                            t = star[m]
                            if double_area(state, cells[t, 0], cells[t, 1], cells[t, 2]) < smallest:
                                good = False
                        tries += 1
                        if good:
                            tries = 10
                        else:
                            goal *= 0.3
                            state[w, 0], state[w, 1] = wx, wy
                    for m in range(n):
                        weigh(state, cells, fluid, density, star[m], 1)
                        touch(neighbours, stale, star[m])
    ti.loop_config(serialize=serial)
    for t in range(elements):
        flag[t] = 0
        if fluid[t] >= 0:
            bits = 0
            for i in ti.static(range(3)):
                o = neighbours[t, i]
                if o >= 0:
                    if fluid[o] != fluid[t]:
                        bits = 2
            a, b, c = cells[t, 0], cells[t, 1], cells[t, 2]
            if mark[a] > 0 and mark[b] > 0 and mark[c] > 0:
                longest = ti.max(distance(state, a, b), distance(state, b, c), distance(state, c, a))
                if double_area(state, a, b, c) < thin * (state[a, 8] + state[b, 8] + state[c, 8]) / 3.0 * longest:
                    bits += 1
            flag[t] = bits
    ti.loop_config(serialize=True)
    for t in range(elements):
        if flag[t] & 1 > 0:
            best, taker = 0.0, -1
            for i in ti.static(range(3)):
                o = neighbours[t, i]
                if o >= 0:
                    length = distance(state, cells[t, (i + 1) % 3], cells[t, (i + 2) % 3])
                    if fluid[o] != fluid[t] and length > best:
                        best, taker = length, fluid[o]
            if taker >= 0:
                weigh(state, cells, fluid, density, t, -1)
                fluid[t] = taker
                weigh(state, cells, fluid, density, t, 1)
                count[0] = count[0] + 1
    ti.loop_config(serialize=True)
    for t in range(elements):
        if flag[t] & 2 > 0 and count[0] == 0:
            for i in ti.static(range(3)):
                o = neighbours[t, i]
                if o >= 0:
                    if fluid[o] != fluid[t]:
                        b, c = cells[t, (i + 1) % 3], cells[t, (i + 2) % 3]
                        length, wanted = distance(state, b, c), target(state, b, c)
                        flat = double_area(state, cells[t, i], b, c)
                        on_edge = length > long * wanted and flat < low * wanted * length
                        if on_edge and mark[cells[t, i]] == 0:
                            weigh(state, cells, fluid, density, t, -1)
                            fluid[t] = fluid[o]
                            weigh(state, cells, fluid, density, t, 1)
                            mark[cells[t, i]] = 1
                            count[1] = count[1] + 1
                            for k in ti.static(range(3)):
                                if neighbours[t, k] >= 0:
                                    flag[neighbours[t, k]] = flag[neighbours[t, k]] | 2
