"""Kernels that make a triangulation Delaunay again by flips; arrays as in `edge_operations` and `coarsen_refine`.

Edges between cells of two fluids, the interface, are never flipped; nor is the hull. A flip that would change momentum,
for it deals out masses anew, gives the difference back to the particles around that no wall holds.
"""

import taichi as ti

from tipfem.backend.launch import kernel
from tipfem.remesh.edges.edge_operations import flip, give, momentum, place, should_flip, touch, weigh


@ti.func
def note_flips(
    x: ti.template(),
    cells: ti.template(),
    neighbours: ti.template(),
    fluid: ti.template(),
    stale: ti.template(),
    t,
    slack,
):
    """Set ``stale`` (M,) to 1 where an edge of cell t may have to be flipped: both cells of it, but by one of them.

    The edge is looked at once, with a margin for round-off.
    """
    f = fluid[t]
    if f >= 0:
        for i in ti.static(range(3)):
            o = neighbours[t, i]
            if o > t:
                if fluid[o] == f:
                    a, b, c = cells[t, i], cells[t, ti.static((i + 1) % 3)], cells[t, ti.static((i + 2) % 3)]
                    d = cells[o, 0] + cells[o, 1] + cells[o, 2] - b - c
                    ax, ay = x[a, 0] - x[d, 0], x[a, 1] - x[d, 1]
                    bx, by = x[b, 0] - x[d, 0], x[b, 1] - x[d, 1]
                    cx, cy = x[c, 0] - x[d, 0], x[c, 1] - x[d, 1]
                    a2, b2, c2 = ax * ax + ay * ay, bx * bx + by * by, cx * cx + cy * cy
                    inside = a2 * (bx * cy - cx * by) - b2 * (ax * cy - cx * ay) + c2 * (ax * by - bx * ay)
                    if inside > 0.0:
                        # From d the largest distance is one, from a another.
                        ab = (ax - bx) * (ax - bx) + (ay - by) * (ay - by)
                        ac = (ax - cx) * (ax - cx) + (ay - cy) * (ay - cy)
                        largest = ti.max(a2, ti.min(ti.max(b2, c2), ti.max(ab, ac)))
                        if inside > 0.9 * slack * largest * largest:
                            stale[t] = ti.i8(1)
                            stale[o] = ti.i8(1)


@kernel
def find_flips(
    x: ti.types.ndarray(),
    cells: ti.types.ndarray(),
    neighbours: ti.types.ndarray(),
    fluid: ti.types.ndarray(),
    stale: ti.types.ndarray(),
    elements: ti.i32,
    slack: ti.f64,
    serial: ti.template(),
):
    """`note_flips` of all cells; ``serial``: by one thread."""
    ti.loop_config(serialize=serial)
    for t in range(elements):
        note_flips(x, cells, neighbours, fluid, stale, t, slack)


@kernel
def make_delaunay(
    x: ti.types.ndarray(),
    cells: ti.types.ndarray(),
    neighbours: ti.types.ndarray(),
    fluid: ti.types.ndarray(),
    corner: ti.types.ndarray(),
    wall: ti.types.ndarray(),
    density: ti.types.ndarray(),
    stack: ti.types.ndarray(),
    stale: ti.types.ndarray(),
    star: ti.types.ndarray(),
    count: ti.types.ndarray(),
    elements: ti.i32,
    slack: ti.f64,
):
    """Lawson's flips until every edge but interfaces and hull is Delaunay.

    ``x`` is the state; density (F,) of the fluids. ``stale`` (M,): 1 for cells that are to be looked at; afterwards
    for those that have changed, and their neighbours. ``stack`` (S,) and ``star`` are scratch.
    count: [0] flips made, [1] set to 1 if the flips did not come to an end, [2] set to 1 if the stack was full,
    so that the kernel must run again.
    """
    ti.loop_config(serialize=True)
    for t in range(elements):
        if stale[t] != 0:
            found = 0
            for i in ti.static(range(3)):
                if should_flip(x, cells, neighbours, fluid, t, i, slack):
                    found = 2
            stale[t] = ti.cast(found, ti.i8)
    ti.loop_config(serialize=True)
    for t in range(elements):
        if stale[t] == 2:
            stale[t] = ti.i8(0)
            height = 3
            if count[1] != 0:
                height = 0
            for i in ti.static(range(3)):
                stack[i] = 3 * t + i
            while height > 0:
                height -= 1
                s, i = stack[height] // 3, stack[height] % 3
                if should_flip(x, cells, neighbours, fluid, s, i, slack):
                    o = neighbours[s, i]
                    for k in ti.static(range(3)):
                        star[k] = cells[s, k]
                    star[3] = cells[o, place(neighbours, o, s)]
                    before = momentum(x, star, 0, 4)
                    weigh(x, cells, fluid, density, s, -1)
                    weigh(x, cells, fluid, density, o, -1)
                    flip(cells, neighbours, corner, s, i)
                    weigh(x, cells, fluid, density, s, 1)
                    weigh(x, cells, fluid, density, o, 1)
                    give(x, wall, star, 0, 4, before - momentum(x, star, 0, 4))
                    touch(neighbours, stale, s)
                    touch(neighbours, stale, o)
                    count[0] += 1
                    if height + 4 > stack.shape[0]:
                        count[2] = 1
                    else:
                        # The four edges around: opposite a and the second particle of either cell.
                        stack[height] = 3 * s
                        stack[height + 1] = 3 * s + 2
                        stack[height + 2] = 3 * o
                        stack[height + 3] = 3 * o + 1
                        height += 4
                    if count[0] > 40 * elements:
                        count[1] = 1
                        height = 0


@kernel
def gather(
    position: ti.types.ndarray(),
    velocity: ti.types.ndarray(),
    acceleration: ti.types.ndarray(),
    pressure: ti.types.ndarray(),
    wanted: ti.types.ndarray(),
    cells: ti.types.ndarray(),
    neighbours: ti.types.ndarray(),
    fluid: ti.types.ndarray(),
    measure: ti.types.ndarray(),
    density: ti.types.ndarray(),
    mass: ti.types.ndarray(),
    state: ti.types.ndarray(),
    corner: ti.types.ndarray(),
    stale: ti.types.ndarray(),
    particles: ti.i32,
    elements: ti.i32,
    slack: ti.f64,
    serial: ti.template(),
):
    """The rows of ``state`` from the particles' arrays, targets ``wanted`` (N,), and masses; ``corner`` (N,) is the
    last cell at each. ``mass`` (N,) is scratch. ``stale`` (M,), zero before: see `flips.find_flips`."""
    ti.loop_config(serialize=True)
    for n in range(particles):
        mass[n], corner[n] = 0.0, -1
    ti.loop_config(serialize=True)
    for t in range(elements):
        share = density[fluid[t]] * measure[t] / 3.0
        for k in ti.static(range(3)):
            n = cells[t, k]
            mass[n] = mass[n] + share
            corner[n] = t
    ti.loop_config(serialize=serial)
    for t in range(elements):
        note_flips(position, cells, neighbours, fluid, stale, t, slack)
    ti.loop_config(serialize=serial)
    for n in range(particles):
        for k in ti.static(range(2)):
            state[n, k] = position[n, k]
            state[n, 2 + k] = velocity[n, k]
            state[n, 4 + k] = acceleration[n, k]
        state[n, 6], state[n, 7], state[n, 8] = pressure[n], mass[n], wanted[n]


@kernel
def scatter(
    state: ti.types.ndarray(),
    velocity: ti.types.ndarray(),
    acceleration: ti.types.ndarray(),
    pressure: ti.types.ndarray(),
    wanted: ti.types.ndarray(),
    particles: ti.i32,
):
    """What `gather` did to the rows, undone."""
    ti.loop_config(serialize=True)
    for n in range(particles):
        for k in ti.static(range(2)):
            velocity[n, k] = state[n, 2 + k]
            acceleration[n, k] = state[n, 4 + k]
        pressure[n], wanted[n] = state[n, 6], state[n, 8]
