"""Kernel that repairs interfaces that run along edges: contacts with walls, films that break, and slivers.

Arrays are those of `edge_operations.TriangleArrays`; marks of particles those of `tipfem.mesh.components.Components`.
All lengths are relative to the target spacings, areas to their squares.
"""

import taichi as ti

from tipfem.backend.array_types import Flags1, Ints1, Ints2, Reals1, Reals2, Template
from tipfem.backend.launch import kernel
from tipfem.mesh.components import ON_HULL, ON_INTERFACE
from tipfem.remesh.triangles.edge_operations import (
    MASS,
    STAR,
    TARGET,
    VELOCITY,
    Segment,
    TriangleArrays,
    add_mass,
    collect_star,
    distance,
    double_area,
    double_cell_area,
    entry,
    interface_edges,
    mark_stale,
    mass_parts,
    ring,
    share_rates,
    side,
    target,
)
from tipfem.remesh.triangles.queue import Queue, drop_first, place, push

# Limits of `repair_interfaces`, see there.
REACH, GAP, LEAST_AREA, FILM, SLIVER, LONG_EDGE, LIMITS = 0, 1, 2, 3, 4, 5, 6
# Counters of `repair_interfaces`: cells of films that broke, and slivers absorbed.
BROKEN, ABSORBED, COUNTERS = 0, 1, 2
# Bits of the flags of cells.
IN_FILM, AT_INTERFACE = 1, 2
SCRATCH = 2 * (STAR + 1)  # entries: two stars
CELL = 10.0  # nanoseconds of one thread for a cell in `repair_interfaces`
FASTER = 2.0  # largest ratio of a contact's displacement to that of the interface's next particle
STEEPER = 1.05  # least ratio of heights of an interface's second and first particles that gives a direction
TRIALS, SHORTER = 3, 0.3  # trials to slide a contact, and the factor on its displacement from one to the next


@ti.func
def contact_goal(mesh: Template, displacement: Template, limits: Template, star: Template, w, a, one, other):
    """Displacement of an interface's contact w along a wall [m], towards the particle ``one``; the direction (2,).

    ``a`` is the interface's first particle off the wall, for whose cells ``star`` has room; on the wall ``one`` is
    ahead of w, with the fluid on the left, and ``other`` behind.
    """
    x = ti.static(mesh.state)
    length = distance(mesh, one, other)
    along, wa = side(mesh, other, one), side(mesh, w, a)
    tx, ty = along[0] / length, along[1] / length
    ax, ay = wa[0], wa[1]
    foot, height = ax * tx + ay * ty, ti.abs(ax * ty - ay * tx)
    far = limits[REACH] * x[w, TARGET]
    goal = ti.max(foot - far, ti.min(foot + far, 0.0))
    count, closed = collect_star(mesh, star, a)
    number, first, second = interface_edges(mesh, star, count, closed, a)
    if count > 0 and number == 2:
        b = second if first == w else first
        wb = side(mesh, w, b)
        bx, by = wb[0], wb[1]
        above = ti.abs(bx * ty - by * tx)
        if above > STEEPER * height:
            goal = foot + (foot - bx * tx - by * ty) * height / (above - height)
            goal = ti.max(foot - far, ti.min(foot + far, goal))
    dx, dy = displacement[a, 0] - displacement[w, 0], displacement[a, 1] - displacement[w, 1]
    furthest = FASTER * ti.sqrt(dx**2 + dy**2)
    goal = ti.max(-furthest, ti.min(furthest, goal))
    near = limits[GAP] * x[w, TARGET]
    ahead, behind = distance(mesh, w, one) - near, distance(mesh, w, other) - near
    return ti.max(-ti.max(behind, 0.0), ti.min(ti.max(ahead, 0.0), goal)), ti.Vector([tx, ty])


@ti.func
def move_along(mesh: Template, star: Template, count, w, goal, direction, least):
    """Move particle w by ``goal`` [m] in a direction (2,), or less: its cells keep twice an area of ``least``."""
    x = ti.static(mesh.state)
    wx, wy = x[w, 0], x[w, 1]
    for m in range(count):
        add_mass(mesh, entry(star, m), -1)
    distance_left = goal
    trial = 0
    while trial < TRIALS:
        x[w, 0], x[w, 1] = wx + distance_left * direction[0], wy + distance_left * direction[1]
        good = True
        for m in range(count):
            if double_cell_area(mesh, entry(star, m)) < least:
                good = False
        trial += 1
        if good:
            trial = TRIALS
        else:
            distance_left *= SHORTER
            x[w, 0], x[w, 1] = wx, wy
    for m in range(count):
        add_mass(mesh, entry(star, m), 1)
        mark_stale(mesh, entry(star, m))


@ti.func
def slide_contact(
    mesh: Template, mark: Template, displacement: Template, limits: Template, star: Template, other_star: Template, w
):
    """Slide the contact w of an interface along its wall in the direction of the interface, if it is a simple one."""
    count, closed = collect_star(mesh, star, w)
    if count > 1 and closed == 0:
        number, a, _none = interface_edges(mesh, star, count, closed, w)
        if number == 1 and mark[a] == ON_INTERFACE:
            one, other = ring(mesh, star, count, w, 0), ring(mesh, star, count, w, count)
            goal, direction = contact_goal(mesh, displacement, limits, other_star, w, a, one, other)
            move_along(mesh, star, count, w, goal, direction, limits[LEAST_AREA] * mesh.state[w, TARGET] ** 2)


@ti.func
def film_height(mesh: Template, t):
    """Height of cell t over its longest edge, in targets."""
    x = ti.static(mesh.state)
    a, b, c = mesh.cells[t, 0], mesh.cells[t, 1], mesh.cells[t, 2]
    longest = ti.max(distance(mesh, a, b), distance(mesh, b, c), distance(mesh, c, a))
    return 3.0 * double_area(mesh, a, b, c) / (longest * (x[a, TARGET] + x[b, TARGET] + x[c, TARGET]))


@ti.func
def film_flags(mesh: Template, mark: Template, film, t):
    """Bits of cell t: `AT_INTERFACE` if it has an edge there, and `IN_FILM`.

    It is in a film if it is lower than ``film`` and none of its particles is inside its fluid.
    """
    bits = 0
    for i in ti.static(range(3)):
        o = mesh.neighbours[t, i]
        if o >= 0:
            if mesh.fluid[o] != mesh.fluid[t]:
                bits = AT_INTERFACE
    a, b, c = mesh.cells[t, 0], mesh.cells[t, 1], mesh.cells[t, 2]
    if mark[a] > 0 and mark[b] > 0 and mark[c] > 0:
        if film_height(mesh, t) < film:
            bits += IN_FILM
    return bits


@ti.func
def change_fluid(mesh: Template, t, beyond):
    """Move cell t, and its mass, to the fluid of the cell ``beyond``.

    Mass that its particles gain belonged to that fluid elsewhere, so it moves as the cell beyond does. A thin film of
    air leaves the gap between water and a wall at many times the water's speed; with that speed, as much water would
    have a multiple of the energy. Particles that a wall holds keep their state.
    """
    gained = mesh.density[mesh.fluid[beyond]] - mesh.density[mesh.fluid[t]]
    shares = mass_parts(mesh, t, gained)
    if gained > 0.0:
        rates = ti.Vector.zero(ti.f64, 4)  # velocity and acceleration
        for k in ti.static(range(3)):
            for c in ti.static(range(4)):
                rates[c] += mesh.state[mesh.cells[beyond, k], VELOCITY + c] / 3.0
        for k in ti.static(range(3)):
            i, share = mesh.cells[t, k], shares[k]
            share_rates(mesh, i, share / (mesh.state[i, MASS] + share), rates)
    add_mass(mesh, t, -1)
    mesh.fluid[t] = mesh.fluid[beyond]
    add_mass(mesh, t, 1)


@ti.func
def longest_sides(mesh: Template, t, apart):
    """The longest edge of cell t at an interface and the cell beyond; the same of those shared with its own fluid.

    Also the longest of those on the hull. Edges shared with cell ``apart`` are left out; where there are none, the
    length is 0 and the cell -1.
    """
    interface, shared, hull = 0.0, 0.0, 0.0
    beyond, beside = -1, -1
    for i in ti.static(range(3)):
        o = mesh.neighbours[t, i]
        if o < 0 or o != apart:
            length = distance(mesh, mesh.cells[t, (i + 1) % 3], mesh.cells[t, (i + 2) % 3])
            if o < 0:
                hull = ti.max(hull, length)
            elif mesh.fluid[o] != mesh.fluid[t]:
                if length > interface:
                    interface, beyond = length, o
            elif length > shared:
                shared, beside = length, o
    return interface, beyond, shared, beside, hull


@ti.func
def with_walls(mesh: Template, t, fluid, interface, shared, hull):
    """Lengths at the interface and inside the fluid of t, which may go to ``fluid``, with those on the hull.

    Thin wedges between an interface and a wall go to the heavier fluid.
    """
    own, other = mesh.density[mesh.fluid[t]], mesh.density[fluid]
    if own < other or (own == other and mesh.fluid[t] < fluid):
        interface = ti.max(interface, hull)
    elif shared > 0.0:
        shared = ti.max(shared, hull)
    return interface, shared


@ti.func
def break_film(mesh: Template, flag: Template, t):
    """Move cell t of a film to the fluid beyond its longest edge at an interface; returns how many cells changed.

    This edge must be longer than all that t shares with its own fluid, which are at the interface then. Otherwise, it
    does so together with the cell beyond the longest of those, if both are in the film, for the sides of both:
    diagonals of films are longer than their edges along the interface. Edges on walls count as if they were at the
    interface of the lighter fluid, see `with_walls`. So the longest edges of an interface only ever go, and thin cells
    side by side do not exchange their fluids in one repair after the other, which would disturb a flow however short
    its steps are.
    """
    changed = 0
    interface, beyond, shared, beside, hull = longest_sides(mesh, t, -1)
    if beyond >= 0:
        fluid = mesh.fluid[beyond]
        single, within = with_walls(mesh, t, fluid, interface, shared, hull)
        if single > within:
            change_fluid(mesh, t, beyond)
            changed = 1
        elif flag[beside] & IN_FILM > 0:
            one, _, inside, _, wall = longest_sides(mesh, t, beside)
            other, opposite, inside_too, _, wall_too = longest_sides(mesh, beside, t)
            same = True
            if opposite >= 0:
                same = mesh.fluid[opposite] == fluid
            inside = ti.max(inside, inside_too)
            double, within_both = with_walls(mesh, t, fluid, ti.max(one, other), inside, ti.max(wall, wall_too))
            if same and double > within_both:
                change_fluid(mesh, t, beyond)
                change_fluid(mesh, beside, beyond)
                flag[beside] = flag[beside] & ~IN_FILM
                changed = 2
    return changed


@ti.func
def is_sliver(mesh: Template, mark: Template, limits: Template, t, i: Template):
    """Whether cell t is low over its edge opposite corner i, which is long and part of an interface.

    It is not a sliver if the particle at the corner is itself on an interface or the hull, or if the edge is not the
    longest: the particle is beside such an edge, and the interface would run to and fro through it.
    """
    x = ti.static(mesh.state)
    o = mesh.neighbours[t, i]
    sliver = False
    if o >= 0:
        if mesh.fluid[o] != mesh.fluid[t]:
            apex, b, c = mesh.cells[t, i], mesh.cells[t, (i + 1) % 3], mesh.cells[t, (i + 2) % 3]
            length, wanted = distance(mesh, b, c), target(x, b, c)
            low = double_area(mesh, apex, b, c) < limits[SLIVER] * wanted * length
            longest = ti.max(distance(mesh, apex, b), distance(mesh, apex, c)) < length
            sliver = low and longest and length > limits[LONG_EDGE] * wanted and mark[apex] == 0
    return sliver


@ti.func
def absorb_sliver(mesh: Template, mark: Template, flag: Template, limits: Template, t):
    """Move cell t to the fluid beyond the longest of its edges over which it is a sliver.

    Its third particle is marked (N,) as on the interface, its neighbours are flagged (M,) `AT_INTERFACE`. Returns 1 if
    the cell changed its fluid.
    """
    longest, corner = 0.0, -1
    for i in ti.static(range(3)):
        if is_sliver(mesh, mark, limits, t, i):
            length = distance(mesh, mesh.cells[t, (i + 1) % 3], mesh.cells[t, (i + 2) % 3])
            if length > longest:
                longest, corner = length, i
    if corner >= 0:
        change_fluid(mesh, t, mesh.neighbours[t, corner])
        mark[mesh.cells[t, corner]] = ON_INTERFACE
        for k in ti.static(range(3)):
            o = mesh.neighbours[t, k]
            if o >= 0:
                flag[o] = flag[o] | AT_INTERFACE
    return 1 if corner >= 0 else 0


@ti.func
def queue_cell(mesh: Template, queue: Template, size, t):
    """Put cell t into a queue of ``size``, the lowest first; returns the new size."""
    middle = 0.0
    for k in ti.static(range(3)):
        middle += place(mesh.state, mesh.cells[t, k])
    return push(queue, size, -film_height(mesh, t), middle, t)


@kernel
def repair_interfaces(
    mesh: TriangleArrays,
    fixed: Ints1,
    mark: Ints1,
    displacement: Reals2,
    counters: Ints1,
    limits: Reals1,
    scratch: Ints1,
    flag: Ints1,
    stays: Flags1,
    queue: Queue,
    slide: ti.i32,
    serial: Template,
):
    """Slide contacts along walls in the direction of their interfaces, break films, and absorb slivers at interfaces.

    Contacts, except those ``fixed`` (N,), slide along walls where ``slide`` is 1: the line through the last two
    particles of the interface off the wall, A and B, is extended to the wall, at most limits[REACH] from the foot of A.
    In a step the contact goes at most twice as far as A did, of the particles' displacement (N, 2) [m]: the fluid wets
    walls by its motion, and does not creep along them. The contact stays [GAP] away from the next particles on the
    wall, and no cell is left with less than twice the area [LEAST_AREA].

    Films go to the fluid beside them: cells without a particle inside their fluid, lower than [FILM]. At such a thin
    film, two surfaces are about to coalesce, or a filament to break. Its cells go to the fluid beyond their longest
    edge at an interface, see `break_film`, but for those of films that ``stays`` (M,). counters: [BROKEN] cells.

    Slivers are absorbed if no film breaks, which would change the marks: a cell lower than [SLIVER] over an interface's
    edge longer than [LONG_EDGE] goes to the fluid beyond the edge, if its third particle is neither on an interface nor
    on the hull: there is no room on such an edge for another particle, and this one cannot be removed where others are
    as close. counters: [ABSORBED] cells; mark (N,) is kept up to date.

    Contacts are taken in the order of their places, films and slivers in that of their heights. scratch (SCRATCH,),
    flag (M,) and queue, S >= max(3 M, N), are for this kernel's use.
    """
    star, other_star = ti.static(Segment(scratch, 0), Segment(scratch, STAR + 1))
    size = 0
    ti.loop_config(serialize=True)
    for w in range(mesh.state.shape[0]):
        if slide != 0 and mark[w] == ON_INTERFACE + ON_HULL and fixed[w] == 0 and mesh.corner[w] >= 0:
            size = push(queue, size, place(mesh.state, w), 0.0, w)
    ti.loop_config(serialize=True)
    for _ in range(1):
        while size > 0:
            w = queue.names[0]
            size = drop_first(queue, size)
            slide_contact(mesh, mark, displacement, limits, star, other_star, w)
    ti.loop_config(serialize=serial)
    for t in range(mesh.cells.shape[0]):
        flag[t] = 0
        if mesh.fluid[t] >= 0:
            flag[t] = film_flags(mesh, mark, limits[FILM], t)
            if stays[t] != 0:
                flag[t] = flag[t] & ~IN_FILM
    ti.loop_config(serialize=True)
    for t in range(mesh.cells.shape[0]):
        if flag[t] & IN_FILM > 0:
            size = queue_cell(mesh, queue, size, t)
    ti.loop_config(serialize=True)
    for _ in range(1):
        while size > 0:
            t = queue.names[0]
            size = drop_first(queue, size)
            if flag[t] & IN_FILM > 0:
                counters[BROKEN] += break_film(mesh, flag, t)
    ti.loop_config(serialize=True)
    for t in range(mesh.cells.shape[0]):
        if flag[t] & AT_INTERFACE > 0 and counters[BROKEN] == 0:
            for i in ti.static(range(3)):
                if is_sliver(mesh, mark, limits, t, i):
                    size = queue_cell(mesh, queue, size, t)
    ti.loop_config(serialize=True)
    for _ in range(1):
        while size > 0:
            t = queue.names[0]
            size = drop_first(queue, size)
            counters[ABSORBED] += absorb_sliver(mesh, mark, flag, limits, t)


@kernel
def find_rest(path: Reals2, cells: Ints2, fluid: Ints1, stays: Flags1, still: Flags1, limit: ti.f64) -> ti.i32:
    """Mark the cells (M,) whose corners all move by less than the limit, and the particles (N,) of such cells alone.

    Returns how many cells these are; removed ones, of fluid -1, are none.
    """
    ti.loop_config(serialize=True)
    for n in range(path.shape[0]):
        stays[n] = ti.cast(1, ti.i8)
    count = 0
    ti.loop_config(serialize=True)
    for t in range(cells.shape[0]):
        rest = fluid[t] >= 0
        if rest:
            for i, k in ti.static(ti.ndrange(3, 2)):
                rest = rest and ti.abs(path[cells[t, i], k]) < limit
            for i in ti.static(range(3)):
                if not rest:
                    stays[cells[t, i]] = ti.cast(0, ti.i8)
        still[t] = ti.cast(rest, ti.i8)
        count += ti.cast(rest, ti.i32)
    return count
