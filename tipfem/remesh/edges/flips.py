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
    MASS,
    PRESSURE,
    STALE,
    TARGET,
    TO_FLIP,
    VELOCITY,
    Segment,
    TriangleArrays,
    add_mass,
    circle_determinant,
    column_of,
    distribute_momentum,
    flip,
    mark_stale,
    momentum_of,
    set_entry,
    should_flip,
    square_distance,
)

# Counters of `make_delaunay`.
FLIPS, ENDLESS, STACK_FULL, COUNTERS = 0, 1, 2, 3
# Nanoseconds of one thread for a cell in `gather` and in `find_flips`.
GATHER, FIND_FLIPS = 20.0, 40.0
MOST_FLIPS = 40  # for each cell, on average: far more than needed
MARGIN = 0.9  # of the tolerance of flips, for round-off


@ti.func
def may_flip(mesh: Template, a, b, c, d, tolerance):
    """Whether the edge b-c between cells (a, b, c) and (d, c, b) may not be Delaunay, by the test from either cell.

    The length that `edge_operations.in_circle` divides by depends on the cell. The smaller of the two is used, with a
    margin for round-off.
    """
    inside, ad, bd, cd = circle_determinant(mesh, a, b, c, d)
    result = False
    if inside > 0.0:
        beside_d, beside_a = ti.max(bd, cd), ti.max(square_distance(mesh, a, b), square_distance(mesh, a, c))
        largest = ti.max(ad, ti.min(beside_d, beside_a))
        result = inside > MARGIN * tolerance * largest * largest
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
                if may_flip(mesh, cells[t, i], b, c, d, tolerance):
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
    distribute_momentum(mesh, four, 4, before - momentum_of(mesh.state, four, 4))
    mark_stale(mesh, t)
    mark_stale(mesh, o)


@ti.func
def flip_from(mesh: Template, stack: Template, four: Template, counters: Template, start, tolerance):
    """Lawson's flips: flip the edges of cell ``start`` that are not Delaunay, and those around each flipped edge."""
    height = 3 if counters[ENDLESS] == 0 else 0
    for i in ti.static(range(3)):
        stack[i] = 3 * start + i
    while height > 0:
        height -= 1
        t, i = stack[height] // 3, stack[height] % 3
        if should_flip(mesh, t, i, tolerance):
            o = mesh.neighbours[t, i]
            flip_conserving_momentum(mesh, four, t, i)
            counters[FLIPS] += 1
            if height + 4 > stack.shape[0]:
                counters[STACK_FULL] = 1
            else:
                # The four edges around: opposite a and the second particle of either cell.
                stack[height] = 3 * t
                stack[height + 1] = 3 * t + 2
                stack[height + 2] = 3 * o
                stack[height + 3] = 3 * o + 1
                height += 4
            if counters[FLIPS] > MOST_FLIPS * mesh.cells.shape[0]:
                counters[ENDLESS] = 1
                height = 0


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
    stack: Ints1,
    scratch: Ints1,
    counters: Ints1,
    tolerance: ti.f64,
):
    """Lawson's flips until every edge off interfaces and hull is Delaunay within ``tolerance``, see `in_circle`.

    Only stale cells are examined; afterwards the cells that changed are stale, and their neighbours. stack (S,)
    and scratch (4,) are for this kernel's use. counters: [FLIPS] made, [ENDLESS] set to 1 if they did not
    terminate, [STACK_FULL] set to 1 if the stack was too small, so that the kernel must run again.
    """
    mesh = ti.static(TriangleArrays(state, cells, neighbours, fluid, period, corner, wall, density, stale))
    four = ti.static(Segment(scratch))
    ti.loop_config(serialize=True)
    for t in range(cells.shape[0]):
        if stale[t] != CURRENT:
            found = CURRENT
            for i in ti.static(range(3)):
                if should_flip(mesh, t, i, tolerance):
                    found = TO_FLIP
            stale[t] = ti.cast(found, ti.i8)
    ti.loop_config(serialize=True)
    for t in range(cells.shape[0]):
        if stale[t] == TO_FLIP:
            stale[t] = ti.i8(CURRENT)
            flip_from(mesh, stack, four, counters, t, tolerance)


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
