"""Kernels that make a triangulation Delaunay by flips; arrays are those of `edge_operations.TriangleArrays`.

Edges between cells of two fluids, the interface, are never flipped; nor is the hull. A flip changes the masses of
particles; the change of momentum is distributed to the particles around it, unless one belongs to a wall.

Flips are made in rounds, see `claims`, each of which takes those edges that have the largest excess around.
"""

from typing import NamedTuple

import taichi as ti

from tipfem.backend.array_types import Ints1, Ints2, Reals1, Reals2, Template
from tipfem.backend.launch import kernel
from tipfem.fem.element import parts_of
from tipfem.remesh.claims import Claims, holds_all, is_first, release, stake, stake_tie, whole_place
from tipfem.remesh.triangles.edge_operations import (
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
    entry,
    flip,
    mark_stale,
    momentum_of,
    set_entry,
    square_distance,
)
from tipfem.remesh.triangles.queue import place

# Counters of `make_delaunay`; [LISTED] and the next one: how many edges are listed, see `Edges`.
FLIPS, ENDLESS, LISTED, COUNTERS = 0, 1, 2, 4
# Nanoseconds of one thread for a cell in `gather`, `find_flips` and `make_delaunay`, and for an edge in a loop of
# `flip_round`.
GATHER, FIND_FLIPS, LIST_EDGES, ROUND = 20.0, 40.0, 3.0, 100.0
MOST_FLIPS = 40  # for each cell, on average: far more than needed
MARGIN = 0.9  # of the tolerance of flips, for round-off


class Edges(NamedTuple):
    """The edges that are to be flipped.

    A round takes them from one row and lists those of the next round in the other one. Each is listed once; their order
    has no influence.
    """

    names: "Ints2"  # (2, S) 3 * cell + the corner opposite each edge, S >= 3 M
    excess: "Reals2"  # (2, S) see `excess_of_edge`
    around: "Ints1"  # (4 * S,) the particles around each edge of the present row
    counters: "Ints1"  # (COUNTERS,)


class ParticleArrays(NamedTuple):
    """Particles, from which the rows of a triangulation's state are made."""

    position: "Reals2"
    velocity: "Reals2"
    acceleration: "Reals2"
    pressure: "Reals1"
    spacing: "Reals1"  # target


@ti.func
def excess(mesh: Template, a, b, c, d):
    """Measure of how far the edge b-c between cells (a, b, c) and (d, c, b) is from Delaunay, > 0 if it is not.

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
    """Flip the edge opposite corner i of cell t; ``four``: a `Segment` with the particles around it."""
    o = mesh.neighbours[t, i]
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
def list_edge(edges: Template, row, name, urgency):
    """List an edge in a row."""
    m = ti.atomic_add(edges.counters[LISTED + row], 1)
    edges.names[row, m], edges.excess[row, m] = name, urgency


@ti.func
def list_if_to_flip(mesh: Template, edges: Template, row, t, i, tolerance):
    """List the edge opposite corner i of cell t, if it is to be flipped."""
    found = excess_of_edge(mesh, t, i, tolerance)
    if found > 0:
        list_edge(edges, row, 3 * t + i, found)


@ti.func
def particle_around(mesh: Template, name, k: Template):
    """Particle k of the four around an edge: those of its cell, beginning opposite of it, and the one beyond; or -1."""
    t, i = name // 3, name % 3
    result = -1
    if ti.static(k < 3):
        result = mesh.cells[t, (i + k) % 3]
    else:
        o = mesh.neighbours[t, i]
        if o >= 0:
            result = mesh.cells[o, column_of(mesh.neighbours, o, t)]
    return result


@ti.func
def tie_of(mesh: Template, edges: Template, row, m):
    """Key that decides between edges with the same excess."""
    b, c = edges.around[4 * m + 1], edges.around[4 * m + 2]
    return whole_place(place(mesh.state, b) + place(mesh.state, c), edges.names[row, m])


@ti.func
def begin_round(mesh: Template, edges: Template, claims: Template, row, m):
    """Find the particles around edge m of a row, and drop claims on them."""
    four = ti.static(Segment(edges.around, 4 * m))
    for k in ti.static(range(4)):
        set_entry(four, k, particle_around(mesh, edges.names[row, m], k))
    release(claims, four, 4)


@ti.func
def stake_edge(edges: Template, claims: Template, row, m, alone: Template):
    """Claim these particles."""
    stake(claims, ti.static(Segment(edges.around, 4 * m)), 4, edges.excess[row, m], alone)


@ti.func
def stake_first_edge(mesh: Template, edges: Template, claims: Template, row, m, alone: Template):
    """Claim them among edges with the same excess, if none of them is claimed by one with a larger."""
    four = ti.static(Segment(edges.around, 4 * m))
    if is_first(claims, four, 4, edges.excess[row, m]):
        stake_tie(claims, four, 4, tie_of(mesh, edges, row, m), alone)


@ti.func
def flip_edge(mesh: Template, edges: Template, claims: Template, row, m, tolerance):
    """Flip edge m of a row if it has all of its particles, and list what is then to be flipped around."""
    four = ti.static(Segment(edges.around, 4 * m))
    if is_first(claims, four, 4, edges.excess[row, m]):
        if holds_all(claims, four, 4, tie_of(mesh, edges, row, m)):
            t, i = edges.names[row, m] // 3, edges.names[row, m] % 3
            o = mesh.neighbours[t, i]
            flip_conserving_momentum(mesh, four, t, i)
            edges.counters[FLIPS] += 1
            # The four edges around: opposite a and the second particle of either cell.
            for k in ti.static(range(4)):
                cell = t if ti.static(k < 2) else o
                list_if_to_flip(mesh, edges, 1 - row, cell, ti.static((0, 2, 0, 1)[k]), tolerance)


@ti.func
def keep_edge(mesh: Template, edges: Template, row, m):
    """List edge m of a row again unless its cells have changed: then those around a flip were listed."""
    four = ti.static(Segment(edges.around, 4 * m))
    same = True
    for k in ti.static(range(4)):
        same = same and entry(four, k) == particle_around(mesh, edges.names[row, m], k)
    if same:
        list_edge(edges, 1 - row, edges.names[row, m], edges.excess[row, m])


@ti.func
def flip_all(mesh: Template, edges: Template, claims: Template, first_row, tolerance):
    """Rounds by one thread until no edge is left; the first takes those of ``first_row``."""
    counters = ti.static(edges.counters)
    row = first_row
    count = counters[LISTED + row]
    while count > 0:
        counters[LISTED + 1 - row] = 0
        for m in range(count):
            begin_round(mesh, edges, claims, row, m)
        for m in range(count):
            stake_edge(edges, claims, row, m, True)
        for m in range(count):
            stake_first_edge(mesh, edges, claims, row, m, True)
        for m in range(count):
            flip_edge(mesh, edges, claims, row, m, tolerance)
        for m in range(count):
            keep_edge(mesh, edges, row, m)
        row = 1 - row
        count = counters[LISTED + row]
        if counters[FLIPS] > MOST_FLIPS * mesh.cells.shape[0]:
            counters[ENDLESS] = 1
            count = 0
    counters[LISTED], counters[LISTED + 1] = 0, 0


@kernel
def find_flips(mesh: TriangleArrays, tolerance: ti.f64, serial: Template):
    """`mark_flips` of all cells; stale (M,) is zero before."""
    ti.loop_config(serialize=serial)
    for t in range(mesh.cells.shape[0]):
        if mesh.fluid[t] >= 0:
            mark_flips(mesh, t, tolerance)


@kernel
def make_delaunay(mesh: TriangleArrays, edges: Edges, claims: Claims, tolerance: ti.f64, serial: Template):
    """Lawson's flips until every edge off interfaces and hull is Delaunay within ``tolerance``, see `excess`.

    Those with the largest excess around are flipped first. Only stale cells are examined; afterwards the cells that
    changed are stale, and their neighbours. edges.counters, zero before: [FLIPS] made, [ENDLESS] set to 1 if they did
    not terminate. Many threads only list the edges to begin with, for `flip_round` and `flip_rounds`.
    """
    ti.loop_config(serialize=serial)
    for t in range(mesh.cells.shape[0]):
        if mesh.stale[t] != CURRENT:
            for i in ti.static(range(3)):
                o = mesh.neighbours[t, i]
                examined = False
                if 0 <= o < t:
                    examined = mesh.stale[o] != CURRENT
                if not examined:
                    list_if_to_flip(mesh, edges, 0, t, i, tolerance)
    ti.loop_config(serialize=serial)
    for t in range(mesh.cells.shape[0]):
        mesh.stale[t] = ti.i8(CURRENT)
    if ti.static(serial):
        ti.loop_config(serialize=True)
        for _ in range(1):
            flip_all(mesh, edges, claims, 0, tolerance)


@kernel
def flip_round(mesh: TriangleArrays, edges: Edges, claims: Claims, tolerance: ti.f64, row: ti.i32, count: ti.i32):
    """A round of `make_delaunay`: flips among the first ``count`` edges of a row, the only ones there."""
    for _ in range(1):
        edges.counters[LISTED + 1 - row] = 0
    for m in range(count):
        begin_round(mesh, edges, claims, row, m)
    for m in range(count):
        stake_edge(edges, claims, row, m, False)
    for m in range(count):
        stake_first_edge(mesh, edges, claims, row, m, False)
    for m in range(count):
        flip_edge(mesh, edges, claims, row, m, tolerance)
    for m in range(count):
        keep_edge(mesh, edges, row, m)


@kernel
def flip_rounds(mesh: TriangleArrays, edges: Edges, claims: Claims, tolerance: ti.f64, row: ti.i32):
    """All further rounds of `make_delaunay` by one thread."""
    ti.loop_config(serialize=True)
    for _ in range(1):
        flip_all(mesh, edges, claims, row, tolerance)


@kernel
def gather(
    fields: ParticleArrays, mesh: TriangleArrays, measure: Reals1, mass: Reals1, tolerance: ti.f64, serial: Template
):
    """The rows of mesh.state from the particles' arrays and masses; mesh.corner is the last cell at each particle.

    measure (M,): areas of the cells; mesh.cells may have room for more. mass (N,) is scratch. mesh.stale, zero before:
    see `find_flips`.
    """
    cells, period, state = ti.static(mesh.cells, mesh.period, mesh.state)
    placed = ti.static(TriangleArrays(fields.position, cells, mesh.neighbours, mesh.fluid, period, stale=mesh.stale))
    ti.loop_config(serialize=True)
    for n in range(fields.position.shape[0]):
        mass[n], mesh.corner[n] = 0.0, -1
    ti.loop_config(serialize=True)
    for t in range(measure.shape[0]):
        shares = parts_of(mesh.density[mesh.fluid[t]] * measure[t], fields.position, cells, period, t)
        for k in ti.static(range(3)):
            n = cells[t, k]
            mass[n] = mass[n] + shares[k]
            mesh.corner[n] = t
    ti.loop_config(serialize=serial)
    for t in range(measure.shape[0]):
        mark_flips(placed, t, tolerance)
    ti.loop_config(serialize=serial)
    for n in range(fields.position.shape[0]):
        for k in ti.static(range(2)):
            state[n, k] = fields.position[n, k]
            state[n, VELOCITY + k] = fields.velocity[n, k]
            state[n, ACCELERATION + k] = fields.acceleration[n, k]
        state[n, PRESSURE], state[n, MASS], state[n, TARGET] = fields.pressure[n], mass[n], fields.spacing[n]


@kernel
def scatter(state: Reals2, velocity: Reals2, acceleration: Reals2, pressure: Reals1, spacing: Reals1):
    """The particles' arrays from the rows of ``state``, except positions and masses; see `gather`."""
    ti.loop_config(serialize=True)
    for n in range(state.shape[0]):
        for k in ti.static(range(2)):
            velocity[n, k] = state[n, VELOCITY + k]
            acceleration[n, k] = state[n, ACCELERATION + k]
        pressure[n], spacing[n] = state[n, PRESSURE], state[n, TARGET]
