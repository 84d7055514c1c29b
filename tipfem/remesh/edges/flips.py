"""Kernels that make a triangulation Delaunay by flips; arrays are those of `edge_operations.TriangleArrays`.

Edges between cells of two fluids, the interface, are never flipped; nor is the hull. A flip changes the masses of
particles; the change of momentum is distributed to the particles around it, unless one belongs to a wall.
"""

import taichi as ti

from tipfem.backend.array_types import Flags1, Ints1, Ints2, Periods, Reals1, Reals2, Template
from tipfem.backend.launch import kernel
from tipfem.remesh.edges.edge_operations import (
    ACCELERATION,
    CURRENT,
    FAR,
    MASS,
    PRESSURE,
    STALE,
    TARGET,
    VELOCITY,
    Segment,
    TriangleArrays,
    add_mass,
    circle_determinant,
    column_of,
    distribute_momentum,
    double_area,
    flip,
    mark_stale,
    momentum_of,
    set_entry,
    square_distance,
)
from tipfem.remesh.edges.queue import Queue, drop_first, place, push

# Counters of `make_delaunay`.
FLIPS, ENDLESS, QUEUE_FULL, COUNTERS = 0, 1, 2, 3
# Nanoseconds of one thread for a cell in `gather` and in `find_flips`.
GATHER, FIND_FLIPS = 20.0, 40.0
MOST_FLIPS = 40  # for each cell, on average: far more than needed
MARGIN = 0.9  # of the tolerance of flips, for round-off
# The excess of a queued edge, computed again, differs no more than that: relative, and absolute.
SAME, ROUND_OFF = 1e-6, 1e-12


@ti.func
def excess(mesh: Template, a, b, c, d):
    """How far the edge b-c between cells (a, b, c) and (d, c, b) is from Delaunay, > 0 if it is not.

    `edge_operations.circle_determinant` over the square of the largest squared distance from d, or from a where that is
    smaller: the same for both cells.
    """
    inside, ad, bd, cd = circle_determinant(mesh, a, b, c, d)
    beside_d, beside_a = ti.max(bd, cd), ti.max(square_distance(mesh, a, b), square_distance(mesh, a, c))
    largest = ti.max(ad, ti.min(beside_d, beside_a))
    return inside / (largest * largest)


@ti.func
def excess_of_edge(mesh: Template, t, i, tolerance):
    """The `excess` of the edge opposite corner i of cell t; 0 if it is not to be flipped.

    Edges are flipped where the excess is above ``tolerance``, unless they are part of an interface or the hull.
    """
    cells = ti.static(mesh.cells)
    result = 0.0
    o = mesh.neighbours[t, i]
    if o >= 0 and mesh.fluid[t] >= 0:
        if mesh.fluid[o] == mesh.fluid[t]:
            a, b, c = cells[t, i], cells[t, (i + 1) % 3], cells[t, (i + 2) % 3]
            d = cells[o, column_of(mesh.neighbours, o, t)]
            found = excess(mesh, a, b, c, d)
            # Up to round-off, the four are in convex position for every edge that is not Delaunay.
            if found > tolerance and double_area(mesh, a, b, d) > 0 and double_area(mesh, a, d, c) > 0:
                result = found
    return result


@ti.func
def mark_flips(mesh: Template, t, tolerance):
    """Mark cell t and a neighbour of a higher number as stale if the edge between them may have to be flipped."""
    cells = ti.static(mesh.cells)
    for i in ti.static(range(3)):
        o = mesh.neighbours[t, i]
        if o > t:
            if mesh.fluid[o] == mesh.fluid[t]:
                b, c = cells[t, ti.static((i + 1) % 3)], cells[t, ti.static((i + 2) % 3)]
                d = cells[o, 0] + cells[o, 1] + cells[o, 2] - b - c
                if excess(mesh, cells[t, i], b, c, d) > MARGIN * tolerance:
                    mesh.stale[t] = ti.i8(STALE)
                    mesh.stale[o] = ti.i8(STALE)


@ti.func
def flip_conserving_momentum(mesh: Template, four: Template, t, i):
    """Flip the edge opposite corner i of cell t; ``four`` is a `Segment` for the particles around it."""
    o = mesh.neighbours[t, i]
    for k in ti.static(range(3)):
        set_entry(four, k, mesh.cells[t, k])
    set_entry(four, 3, mesh.cells[o, column_of(mesh.neighbours, o, t)])
    before = momentum_of(mesh.state, four, 4)
    add_mass(mesh, t, -1)
    add_mass(mesh, o, -1)
    flip(mesh, t, i)
    add_mass(mesh, t, 1)
    add_mass(mesh, o, 1)
    distribute_momentum(mesh, four, 4, before - momentum_of(mesh.state, four, 4), FAR)
    mark_stale(mesh, t)
    mark_stale(mesh, o)


@ti.func
def queue_edge(mesh: Template, queue: Template, counters: Template, size, t, i, tolerance):
    """Queue the edge opposite corner i of cell t, if it is to be flipped; returns the new size of the queue."""
    found, grown = excess_of_edge(mesh, t, i, tolerance), size
    if found > 0:
        if size == queue.names.shape[0]:
            counters[QUEUE_FULL] = 1
        else:
            b, c = mesh.cells[t, (i + 1) % 3], mesh.cells[t, (i + 2) % 3]
            grown = push(queue, size, found, place(mesh.state, b) + place(mesh.state, c), 3 * t + i)
    return grown


@ti.func
def flip_first(mesh: Template, queue: Template, four: Template, counters: Template, size, tolerance):
    """Flip the first edge of a queue of ``size`` and queue those around it; returns the new size."""
    expected, name = queue.keys[0, 0], queue.names[0]
    left = drop_first(queue, size)
    t, i = name // 3, name % 3
    found = excess_of_edge(mesh, t, i, tolerance)
    # If cell t was changed in the meantime, its edges were queued again, each with its own excess.
    if found > 0 and ti.abs(found - expected) <= SAME * expected + ROUND_OFF:
        o = mesh.neighbours[t, i]
        flip_conserving_momentum(mesh, four, t, i)
        counters[FLIPS] += 1
        # The four edges around: opposite a and the second particle of either cell.
        for k in ti.static(range(4)):
            cell = t if ti.static(k < 2) else o
            left = queue_edge(mesh, queue, counters, left, cell, ti.static((0, 2, 0, 1)[k]), tolerance)
        if counters[FLIPS] > MOST_FLIPS * mesh.cells.shape[0]:
            counters[ENDLESS] = 1
            left = 0
    return left


@kernel
def find_flips(
    state: Reals2,
    cells: Ints2,
    neighbours: Ints2,
    fluid: Ints1,
    period: Periods,
    stale: Flags1,
    tolerance: ti.f64,
    serial: Template,
):
    """`mark_flips` of all cells; stale (M,) is zero before."""
    mesh = ti.static(TriangleArrays(state, cells, neighbours, fluid, period, stale=stale))
    ti.loop_config(serialize=serial)
    for t in range(cells.shape[0]):
        if fluid[t] >= 0:
            mark_flips(mesh, t, tolerance)


@kernel
def make_delaunay(
    state: Reals2,
    cells: Ints2,
    neighbours: Ints2,
    fluid: Ints1,
    period: Periods,
    corner: Ints1,
    wall: Ints1,
    density: Reals1,
    stale: Flags1,
    keys: Reals2,
    names: Ints1,
    scratch: Ints1,
    counters: Ints1,
    tolerance: ti.f64,
):
    """Lawson's flips until every edge off interfaces and hull is Delaunay within ``tolerance``, see `excess`.

    The edge with the largest excess is flipped first. Only stale cells are examined; afterwards the cells that changed
    are stale, and their neighbours. keys (S, 2), names (S,), for three edges a cell at least, and scratch (4,) are for
    this kernel's use. counters: [FLIPS] made, [ENDLESS] set to 1 if they did not terminate, [QUEUE_FULL] set to 1 if
    the queue was too small, so that the kernel must run again.
    """
    mesh = ti.static(TriangleArrays(state, cells, neighbours, fluid, period, corner, wall, density, stale))
    four, queue = ti.static(Segment(scratch), Queue(keys, names))
    size = 0
    ti.loop_config(serialize=True)
    for t in range(cells.shape[0]):
        if stale[t] != CURRENT:
            for i in ti.static(range(3)):
                o = neighbours[t, i]
                examined = False
                if 0 <= o < t:
                    examined = stale[o] != CURRENT
                if not examined:
                    size = queue_edge(mesh, queue, counters, size, t, i, tolerance)
    ti.loop_config(serialize=True)
    for t in range(cells.shape[0]):
        stale[t] = ti.i8(CURRENT)
    ti.loop_config(serialize=True)
    for _ in range(1):
        while size > 0:
            size = flip_first(mesh, queue, four, counters, size, tolerance)


@kernel
def gather(
    position: Reals2,
    velocity: Reals2,
    acceleration: Reals2,
    pressure: Reals1,
    spacing: Reals1,
    cells: Ints2,
    neighbours: Ints2,
    fluid: Ints1,
    period: Periods,
    measure: Reals1,
    density: Reals1,
    mass: Reals1,
    state: Reals2,
    corner: Ints1,
    stale: Flags1,
    tolerance: ti.f64,
    serial: Template,
):
    """The rows of ``state`` from the particles' arrays, target ``spacing`` (N,), and masses.

    measure (M,): areas of the cells; ``cells`` may have room for more. corner (N,) is the last cell at each particle.
    mass (N,) is scratch. stale (M,), zero before: see `find_flips`.
    """
    mesh = ti.static(TriangleArrays(position, cells, neighbours, fluid, period, stale=stale))
    ti.loop_config(serialize=True)
    for n in range(position.shape[0]):
        mass[n], corner[n] = 0.0, -1
    ti.loop_config(serialize=True)
    for t in range(measure.shape[0]):
        share = density[fluid[t]] * measure[t] / 3.0
        for k in ti.static(range(3)):
            n = cells[t, k]
            mass[n] = mass[n] + share
            corner[n] = t
    ti.loop_config(serialize=serial)
    for t in range(measure.shape[0]):
        mark_flips(mesh, t, tolerance)
    ti.loop_config(serialize=serial)
    for n in range(position.shape[0]):
        for k in ti.static(range(2)):
            state[n, k] = position[n, k]
            state[n, VELOCITY + k] = velocity[n, k]
            state[n, ACCELERATION + k] = acceleration[n, k]
        state[n, PRESSURE], state[n, MASS], state[n, TARGET] = pressure[n], mass[n], spacing[n]


@kernel
def scatter(state: Reals2, velocity: Reals2, acceleration: Reals2, pressure: Reals1, spacing: Reals1):
    """The particles' arrays from the rows of ``state``, except positions and masses; see `gather`."""
    ti.loop_config(serialize=True)
    for n in range(state.shape[0]):
        for k in ti.static(range(2)):
            velocity[n, k] = state[n, VELOCITY + k]
            acceleration[n, k] = state[n, ACCELERATION + k]
        pressure[n], spacing[n] = state[n, PRESSURE], state[n, TARGET]
