"""Kernels that remove particles from a triangulation, in place, on `edge_operations.TriangleArrays`.

All cells are examined and flagged in parallel; the few changes that follow are made serially.
Limits are relative to the target spacings where they are applied, those of areas to the squares. A collapse changes the
masses of particles; the change of momentum is distributed to the particles around, unless one belongs to a wall.
"""

from typing import Any, NamedTuple

import taichi as ti

from tipfem.backend.array_types import Ints1, Reals1, Template
from tipfem.backend.launch import kernel
from tipfem.backend.periodic import difference, middle
from tipfem.remesh.triangles.edge_operations import (
    FAR,
    HELD,
    MASS,
    OFF_WALLS,
    PRESSURE,
    SLIDES,
    STAR,
    TARGET,
    VELOCITY,
    Segment,
    TriangleArrays,
    add_mass,
    beside,
    can_collapse,
    collapse,
    collect_star,
    column_of,
    distance,
    distribute_momentum,
    double_area,
    double_cell_area,
    entry,
    flip,
    interface_edges,
    is_border,
    mark_stale,
    momentum_of,
    ring,
    set_entry,
    share_rates,
    square_distance,
    target,
)
from tipfem.remesh.triangles.long_edges import REMOVED, STORED, edge_key, keep_longest
from tipfem.remesh.triangles.queue import Queue, drop_first, push

# Limits of `coarsen`, see there.
TOO_CLOSE, ALONG_INTERFACE, TO_INTERFACE, FILM, LEAST_AREA, LONG_EDGE, LIMITS = 0, 1, 2, 3, 4, 5, 6
# Options of `coarsen`, see there.
MOST, WAITING, EVERY_EDGE, OPTIONS = 0, 1, 2, 3
COUNTERS = 3  # of `coarsen`: REMOVED, STORED, NEEDED
# Bits of the flags of particles that crowd others: what is near.
NEAR_PARTICLE, NEAR_BORDER, NEAR_HULL = 1, 2, 4
SCRATCH = 3 * (STAR + 1) + 1  # entries: two stars, and the particles of one
MUCH_LONGER = 1.4  # factor on the limit of long edges, above which edges inside a fluid need a particle
CELL = 15.0  # nanoseconds of one thread for a cell in `coarsen`
BESIDE = 2.0  # targets: in empty space, edges may be as long as the tank
ROUND_OFF = 1e-12


class Room(NamedTuple):
    """Segments of scratch: the cells around two particles, and the particles around the first, itself the last."""

    star: Segment
    other_star: Segment
    group: Segment


class LongEdges(NamedTuple):
    """Long edges of a triangulation, see `long_edges`."""

    names: "Ints1"  # (E,)
    keys: "Reals1"  # (E,)


def room_in(scratch: Any) -> Room:
    """The segments of a scratch array (SCRATCH,) in a kernel."""
    return Room(Segment(scratch, 0), Segment(scratch, STAR + 1), Segment(scratch, 2 * (STAR + 1)))


@ti.func
def flag_height(mesh: Template, limits: Template, flag: Template, t, i: Template, wanted, length):
    """Flag the particle at corner i of cell t if it is near the border opposite, of this length and target [m]."""
    height = double_cell_area(mesh, t)
    if height < limits[TO_INTERFACE] * wanted * length:
        ti.atomic_or(flag[mesh.cells[t, i]], NEAR_BORDER)
    if mesh.neighbours[t, i] < 0 and height < limits[FILM] * wanted * length:
        ti.atomic_or(flag[mesh.cells[t, i]], NEAR_HULL)


@ti.func
def flag_crowding(mesh: Template, limits: Template, flag: Template, t):
    """Flag the particles of cell t that are near each other or a border: an edge of an interface or the hull.

    Examines the edges that the cell names (see `long_edges`) and its borders; returns the square of the largest ratio
    of their lengths to their targets.
    """
    x, cells = ti.static(mesh.state, mesh.cells)
    longest = 0.0
    for i in ti.static(range(3)):
        border = is_border(mesh, t, i)
        if border or mesh.neighbours[t, i] > t:
            b, c = cells[t, ti.static((i + 1) % 3)], cells[t, ti.static((i + 2) % 3)]
            wanted, close = target(x, b, c), ti.max(limits[TOO_CLOSE], limits[ALONG_INTERFACE])
            reach = close * wanted * (1 + ROUND_OFF)
            square = square_distance(mesh, b, c)
            longest = ti.max(longest, square / (wanted * wanted))
            if square < reach * reach or border:
                length = distance(mesh, b, c)
                if length < close * wanted:
                    ti.atomic_or(flag[b], NEAR_PARTICLE)
                    ti.atomic_or(flag[c], NEAR_PARTICLE)
                if border:
                    flag_height(mesh, limits, flag, t, i, wanted, length)
    return longest


@ti.func
def target_on_hull(mesh: Template, limits: Template, star: Template, count, p, contact):
    """The nearer neighbour on the hull of a particle p on it; -1 if it is not close.

    ``contact``: whether an interface ends at p.
    """
    x = ti.static(mesh.state)
    one, other = ring(mesh, star, count, p, 0), ring(mesh, star, count, p, count)
    q = one if distance(mesh, p, one) < distance(mesh, p, other) else other
    near = limits[FILM] if contact else limits[ALONG_INTERFACE]
    return q if distance(mesh, p, q) < near * target(x, p, q) else -1


@ti.func
def target_on_interface(mesh: Template, limits: Template, p, number, first, second):
    """The nearer neighbour on the interface that passes through particle p; -1 if it is not close.

    Also -1 where interfaces touch, so that more than two (``number``) of their edges leave p.
    """
    x = ti.static(mesh.state)
    q = first if distance(mesh, p, first) < distance(mesh, p, second) else second
    apart = distance(mesh, p, q) >= limits[ALONG_INTERFACE] * target(x, p, q)
    return -1 if number > 2 or apart or first == second else q


@ti.func
def target_on_wall(mesh: Template, star: Template, count, p, number, first, second, least):
    """The nearest wall particle around an interface's particle p that it can be moved into; -1 for none.

    It is not the next on the interface, unless interfaces touch at p. ``least``: see `can_collapse`.
    """
    q, gap = -1, FAR
    for m in range(count):
        r = ring(mesh, star, count, p, m)
        length = distance(mesh, p, r)
        usable = mesh.wall[r] != OFF_WALLS and (number > 2 or (r != first and r != second))
        usable = usable and length < BESIDE * target(mesh.state, p, r)
        if usable and length < gap and can_collapse(mesh, star, count, p, r, least):
            q, gap = r, length
    return q


@ti.func
def meets_wall(mesh: Template, limits: Template, star: Template, count, p):
    """Whether a wall particle is closer than a film to p, in its closed star, across empty space.

    A corner of a wall or body has no face opposite to p that would tell.
    """
    meets = False
    for m in range(count):
        r = ring(mesh, star, count, p, m)
        if mesh.wall[r] != OFF_WALLS and distance(mesh, p, r) < limits[FILM] * target(mesh.state, p, r):
            one, other = mesh.fluid[entry(star, m)], mesh.fluid[entry(star, (m + count - 1) % count)]
            if mesh.density[one] == 0.0 and mesh.density[other] == 0.0:
                meets = True
    return meets


@ti.func
def target_inside(mesh: Template, limits: Template, star: Template, count, p, near_border, least):
    """The nearest neighbour that a particle p inside a fluid can be moved into; -1 for none.

    One too close to p, unless p is ``near_border``. ``least``: see `can_collapse`.
    """
    x = ti.static(mesh.state)
    q, gap = -1, FAR
    for m in range(count):
        r = ring(mesh, star, count, p, m)
        length = distance(mesh, p, r)
        usable = length < limits[TOO_CLOSE] * target(x, p, r) or near_border
        if usable and length < gap and can_collapse(mesh, star, count, p, r, least):
            q, gap = r, length
    return q


@ti.func
def collapse_target(mesh: Template, limits: Template, flag: Template, star: Template, count, closed, p):
    """The neighbour into which a flagged particle p is to be moved, -1 for none.

    Also the interface's particle on the other side of p; and whether both are on it, so that the interface is to keep
    the area that it encloses. ``limits`` are those of `coarsen`; ``count`` cells are around p, closed 1 if they
    surround it.
    """
    number, first, second = interface_edges(mesh, star, count, closed, p)
    least = limits[LEAST_AREA] * mesh.state[p, TARGET] ** 2
    q, along = -1, False
    if closed == 0 and number <= 1:
        q = target_on_hull(mesh, limits, star, count, p, number == 1)
    elif closed == 0 and number == 2 and mesh.wall[p] == SLIDES:
        # The tip of a jet that touches a wall in one particle, and runs along it into a corner.
        q = target_on_hull(mesh, limits, star, count, p, True)
        if q >= 0 and mesh.wall[q] != HELD:
            q = -1
    elif closed == 1 and number >= 2:
        q = target_on_interface(mesh, limits, p, number, first, second)
        along = q >= 0
        if q < 0 and (flag[p] >= NEAR_HULL or meets_wall(mesh, limits, star, count, p)):
            q = target_on_wall(mesh, star, count, p, number, first, second, least)
    elif closed == 1 and number == 0:
        q = target_inside(mesh, limits, star, count, p, flag[p] >= NEAR_BORDER, least)
    if q >= 0:
        if not can_collapse(mesh, star, count, p, q, least):
            q = -1
    return q, second if q == first else first, along


@ti.func
def keep_enclosed_area(mesh: Template, star: Template, count, a, p, q, b, least):
    """Move q, into which p was moved, so that the interface a-q-b encloses what a-p-q-b did; not if it spoils a cell.

    It then stands beside the middle of p and q, and has the mean of their velocities and accelerations. ``star`` has
    the cells around q, which keep twice the area ``least``. Returns the momentum (2) and the mass that particles gain.
    """
    x = ti.static(mesh.state)
    ex, ey = difference(x, mesh.period, b, a, 0), difference(x, mesh.period, b, a, 1)
    wanted = double_area(mesh, a, p, q) + double_area(mesh, a, q, b)
    mx, my = middle(x, mesh.period, q, p, 0), middle(x, mesh.period, q, p, 1)
    am = beside(mesh, a, ti.Vector([mx, my]))
    has = ex * am[1] - ey * am[0]
    # double_area(a, m, b) = (m - a) x (b - a) = -e x (m - a)
    shift = (wanted + has) / (ex * ex + ey * ey)
    old = ti.Vector([x[q, 0], x[q, 1]])
    change = ti.Vector([0.0, 0.0, 0.0])
    for m in range(count):
        change += add_mass(mesh, entry(star, m), -1)
    x[q, 0], x[q, 1] = mx + shift * ey, my - shift * ex
    good = True
    for m in range(count):
        if double_cell_area(mesh, entry(star, m)) < least:
            good = False
    if good:
        for s in ti.static(range(VELOCITY, PRESSURE)):  # those that the interface has in the middle of q and p
            x[q, s] = 0.5 * (x[q, s] + x[p, s])
    else:
        x[q, 0], x[q, 1] = old[0], old[1]
    for m in range(count):
        change += add_mass(mesh, entry(star, m), 1)
    return change


@ti.func
def straighten_interface(mesh: Template, star: Template, a, p, q, least):
    """`keep_enclosed_area` of the interface through a and q, if it passes through q and on; ``star`` is for q's."""
    change = ti.Vector([0.0, 0.0, 0.0])
    count, closed = collect_star(mesh, star, q)
    if count > 0 and closed == 1:
        number, first, second = interface_edges(mesh, star, count, closed, q)
        if number == 2 and (first == a or second == a) and first != second:
            b = second if first == a else first
            change += keep_enclosed_area(mesh, star, count, a, p, q, b, least)
            for m in range(count):
                mark_stale(mesh, entry(star, m))
    return change


@ti.func
def collapse_conserving_momentum(mesh: Template, room: Template, count, closed, p, q, a, closes, least):
    """Move particle p into q and give the momentum that this changes to the particles around p.

    ``a``: the interface's particle beside p, if q is to move so that the area enclosed stays, else -1. ``closes``:
    whether the interface through p closes a gap to the wall of q. The mass that q gains then moves with p: water that
    meets a wall slides along it, with its own speed and not with that of the air there.
    """
    star, group = ti.static(room.star, room.group)
    around = count + 1 - closed
    for m in range(around):
        set_entry(group, m, ring(mesh, star, count, p, m))
    set_entry(group, around, p)
    total, squares = 0.0, 0.0
    for m in range(around + 1):
        i = entry(group, m)
        total += mesh.state[i, MASS]
        squares += mesh.state[i, MASS] * (mesh.state[i, VELOCITY] ** 2 + mesh.state[i, VELOCITY + 1] ** 2)
    mean = momentum_of(mesh.state, group, around + 1) / total
    spread = ti.sqrt(ti.max(squares / total - mean.dot(mean), 0.0))
    change, had = ti.Vector([0.0, 0.0, 0.0]), mesh.state[q, MASS]
    for m in range(count):
        change += add_mass(mesh, entry(star, m), -1)
    collapse(mesh, star, count, p, q)
    for m in range(count):
        change += add_mass(mesh, entry(star, m), 1)
    mesh.state[p, MASS] = 0.0
    gain = mesh.state[q, MASS] - had
    if closes and gain > 0.0:
        x = ti.static(mesh.state)
        before = ti.Vector([x[q, VELOCITY], x[q, VELOCITY + 1], 0.0])
        rates = ti.Vector([x[p, VELOCITY + c] for c in ti.static(range(4))])
        share_rates(mesh, q, gain / x[q, MASS], rates)
        change += x[q, MASS] * (ti.Vector([x[q, VELOCITY], x[q, VELOCITY + 1], 0.0]) - before)
    if a >= 0:
        change += straighten_interface(mesh, room.other_star, a, p, q, least)
    for m in range(count):
        if mesh.fluid[entry(star, m)] >= 0:
            mark_stale(mesh, entry(star, m))
    # Mass that the triangles gain or lose has the mean velocity of the particles around.
    lost = change[2] * mean - ti.Vector([change[0], change[1]])
    distribute_momentum(mesh, group, around, lost, spread)


@ti.func
def queue_crowding(mesh: Template, queue: Template, star: Template, size, p):
    """Put particle p into a queue of ``size``: those closest to another come first; returns the new size.

    Of two that are the nearest to each other, the one whose next neighbour is nearer comes first. Distances are in
    targets.
    """
    nearest, second = FAR, FAR
    count, closed = collect_star(mesh, star, p)
    for m in range(count + 1 - closed):
        r = ring(mesh, star, count, p, m)
        ratio = distance(mesh, p, r) / target(mesh.state, p, r)
        second = ti.min(second, ti.max(nearest, ratio))
        nearest = ti.min(nearest, ratio)
    return push(queue, size, -nearest, -second, p)


@ti.func
def open_fan(mesh: Template, star: Template, count, p, least):
    """Flip edges at p in empty space that keep p from the nearest wall particle; returns how many cells are around p.

    Empty space may be as wide as the tank. From p just above a wall a fan of needles then leads to all of its
    particles, which flips leave there: beside such lengths they are Delaunay within the tolerance.
    """
    q, gap, cells = -1, FAR, count
    for m in range(count):
        r = ring(mesh, star, count, p, m)
        if mesh.wall[r] != OFF_WALLS and distance(mesh, p, r) < gap:
            q, gap = r, distance(mesh, p, r)
    found = q >= 0 and mesh.wall[p] == OFF_WALLS
    while found:
        found = False
        for m in range(cells):
            t, o = entry(star, m), entry(star, (m + 1) % cells)
            if not found and mesh.density[mesh.fluid[t]] == 0.0 and mesh.density[mesh.fluid[o]] == 0.0:
                a, b = ring(mesh, star, cells, p, m), ring(mesh, star, cells, p, (m + 1) % cells)
                c = ring(mesh, star, cells, p, (m + 2) % cells)
                flat = ti.min(double_area(mesh, q, a, b), double_area(mesh, q, b, c)) < least
                good = ti.min(double_area(mesh, p, a, c), double_area(mesh, a, b, c)) >= least
                if q != a and q != b and q != c and flat and good:
                    flip(mesh, t, column_of(mesh.cells, t, a))
                    mark_stale(mesh, t)
                    mark_stale(mesh, o)
                    cells, _ = collect_star(mesh, star, p)
                    found = True
    return cells


@ti.func
def remove_crowding(mesh: Template, limits: Template, flag: Template, fixed: Template, room: Template, p):
    """Move the flagged particle p into a neighbour that it crowds, if there is one; whether p was removed.

    The flag (N,) of the neighbour is cleared, because it then has room. Otherwise a whole row would be removed.
    """
    count, closed = collect_star(mesh, room.star, p)
    removed = False
    if closed == 1 and flag[p] >= NEAR_HULL:
        count = open_fan(mesh, room.star, count, p, limits[LEAST_AREA] * mesh.state[p, TARGET] ** 2)
    if count > 1:
        q, a, along = collapse_target(mesh, limits, flag, room.star, count, closed, p)
        if q >= 0:
            closes = closed == 1 and not along and a >= 0
            if not along or mesh.wall[q] != OFF_WALLS or fixed[q] != 0:
                a = -1
            least = limits[LEAST_AREA] * mesh.state[p, TARGET] ** 2
            collapse_conserving_momentum(mesh, room, count, closed, p, q, a, closes, least)
            flag[q] = 0
            removed = True
    return removed


@ti.func
def gather_long_edges(
    mesh: Template, span: Template, long_edges: Template, counters: Template, t, long, every, waiting
):
    """Store the long edges of cell t, see `coarsen`; ``span`` (M,) lets cells with short edges be skipped."""
    edges, keys = ti.static(long_edges.names, long_edges.keys)
    wanted = ti.min(insertion_candidates(counters[REMOVED] + waiting), edges.shape[0])
    bound = long if every != 0 else 0.5 * long
    if every == 0 and counters[STORED] == wanted:
        bound = ti.max(bound, keys[0])
    lowest = ti.min(bound, long)
    if mesh.stale[t] != 0 or span[t] * (1 + 1e-9) > lowest * lowest:
        for i in ti.static(range(3)):
            if every == 0 and counters[STORED] == wanted:
                bound = ti.max(bound, keys[0])
            needed = MUCH_LONGER * long
            found = edge_key(mesh, t, i, long, ti.min(bound, needed))
            if every == 0:
                keep_longest(edges, keys, counters, found, 3 * t + i, bound, needed, wanted)
            elif found > long:
                edges[counters[STORED]], keys[counters[STORED]] = 3 * t + i, found
                counters[STORED] = counters[STORED] + 1


@ti.pyfunc
def insertion_candidates(particles):
    """Number of edges examined for insertion sites of so many particles."""
    return 8 * particles + 32


@kernel
def coarsen(
    mesh: TriangleArrays,
    fixed: Ints1,
    removed: Ints1,
    long_edges: LongEdges,
    counters: Ints1,
    limits: Reals1,
    options: Ints1,
    scratch: Ints1,
    flag: Ints1,
    span: Reals1,
    queue: Queue,
    serial: Template,
):
    """Remove particles that crowd others, by collapsing the edge to a neighbour, and gather long edges.

    Off interfaces and walls: those closer than limits[TOO_CLOSE] to another, or than [TO_INTERFACE] to an edge of
    interface or wall. On an interface: closer than [ALONG_INTERFACE] to the next on it, and the area enclosed is kept;
    or closer than [FILM] to a wall, or across empty space to a corner of one, so that the interface then ends there;
    where interfaces touch, only this. On a wall: closer than [ALONG_INTERFACE] to the next on it, or than [FILM] at a
    contact. fixed (N,) stay. No cell is left with less than twice the area [LEAST_AREA]. The particles closest to
    others are removed first. Where needles of empty space are in the way, see `open_fan`.

    Afterwards, where limits[LONG_EDGE] > 0: the edges of `long_edges.longest_edges` for as many particles
    as were removed and options[WAITING], in no order, or of `long_edges.long_edges` if options[EVERY_EDGE] is 1.

    removed (N,): the particles removed, at most options[MOST]. counters, zero before: [REMOVED] particles, [STORED]
    edges, and [NEEDED] ones that should be split. scratch (SCRATCH,), flag (N,), span (M,) and queue,
    S >= N, are for this kernel's use.
    """
    room = ti.static(room_in(scratch))
    ti.loop_config(serialize=serial)
    for i in range(mesh.state.shape[0]):
        flag[i] = 0
    ti.loop_config(serialize=serial)
    for t in range(mesh.cells.shape[0]):
        if mesh.fluid[t] >= 0:
            span[t] = flag_crowding(mesh, limits, flag, t)
    size = 0
    ti.loop_config(serialize=True)
    for p in range(mesh.state.shape[0]):
        if flag[p] > 0 and fixed[p] == 0 and mesh.corner[p] >= 0:
            size = queue_crowding(mesh, queue, room.star, size, p)
    ti.loop_config(serialize=True)
    for _ in range(1):
        while size > 0 and counters[REMOVED] < options[MOST]:
            p = queue.names[0]
            size = drop_first(queue, size)
            if flag[p] > 0:
                if remove_crowding(mesh, limits, flag, fixed, room, p):
                    removed[counters[REMOVED]] = p
                    counters[REMOVED] += 1
    ti.loop_config(serialize=True)
    for t in range(mesh.cells.shape[0]):
        if limits[LONG_EDGE] > 0 and mesh.fluid[t] >= 0:
            every, waiting = options[EVERY_EDGE], options[WAITING]
            gather_long_edges(mesh, span, long_edges, counters, t, limits[LONG_EDGE], every, waiting)
