"""Kernels of the energy balance: sums over the cells of a mesh, the cells that changed, and the exchange in them."""

from typing import NamedTuple

import taichi as ti

from tipfem.backend.array_types import Flags1, Ints1, Ints2, Periods, Reals1, Reals2, Template
from tipfem.backend.launch import close_gaps, kernel, part_of
from tipfem.backend.periodic import difference
from tipfem.fem.element import parts_of, row

ENERGY = 8.0  # nanoseconds of one thread for a triangle in `field_energy`
ACTIVE, BESIDE, PARTICLES = 0, 1, 2  # counts of `list_cells`
# And for one in `list_cells`, `exchange_momentum`, `exchanged_energy` and `mark_changed`.
LISTED, PUSHED, EXCHANGED, CHANGED = 2.5, 25.0, 2.5, 7.0


class Triangles(NamedTuple):
    """M triangles of fluids."""

    position: "Reals2"  # (N, 2)
    cells: "Ints2"  # (M, 3)
    period: "Periods"
    fluid: "Ints1"  # (M,)
    density: "Reals1"  # (F,)
    measure: "Reals1"  # (M,)


class Labelled(NamedTuple):
    """M triangles, their fluids, and the velocities of the N particles."""

    cells: "Ints2"
    fluid: "Ints1"
    velocity: "Reals2"


class Buckets(NamedTuple):
    """Cells in lists, each at a particle."""

    first: "Ints1"  # (N',)
    following: "Ints1"  # (M,) of each cell the next one


class Lists(NamedTuple):
    """Cells and particles that `list_cells` finds."""

    active: "Ints1"
    beside: "Ints1"
    particles: "Ints1"
    counts: "Ints1"  # (3,) how many there are of each


@kernel
def cell_sums(
    position: Reals2,
    velocity: Reals2,
    cells: Ints2,
    mass: Reals2,
    lumping: Reals1,
    gravity: Reals1,
    partial: Reals2,
    result: Reals1,
    dim: Template,
    parts: ti.i32,
    stride: Template,
):
    """Sums over the cells, for each fluid in turn 2 + d of them added to result (F (2 + d),).

    mass (M, F) of each cell by fluid [kg]; lumping (M,), see `tipfem.fem.mass.lumped_part`. The sums are the kinetic
    energy and -m x . gravity [J], and m v in each direction [N s].
    """
    for t in range(parts * stride):
        width = 2 + dim
        if t % stride == 0:
            for k in range(mass.shape[1] * width):
                partial[t // stride, k] = 0.0
        first, last = part_of(t, parts, stride, cells.shape[0])
        for c in range(first, last):
            energy, height, momentum = 0.0, 0.0, ti.Vector.zero(float, dim)
            for a in ti.static(range(dim + 1)):
                x, v = row(position, cells[c, a], dim), row(velocity, cells[c, a], dim)
                energy += 0.5 * v.dot(v) / (dim + 1)
                momentum += v / (dim + 1)
                for k in ti.static(range(dim)):
                    height -= gravity[k] * x[k] / (dim + 1)
            for a in ti.static(range(dim + 1)):
                apart = row(velocity, cells[c, a], dim) - momentum
                energy -= (1.0 - lumping[c]) * 0.5 * apart.dot(apart) / (dim + 1)
            for f in range(mass.shape[1]):
                part, at = t // stride, f * width
                partial[part, at] = partial[part, at] + mass[c, f] * energy
                partial[part, at + 1] = partial[part, at + 1] + mass[c, f] * height
                for k in ti.static(range(dim)):
                    partial[part, at + 2 + k] = partial[part, at + 2 + k] + mass[c, f] * momentum[k]
    ti.loop_config(serialize=True)
    for c in range(parts):
        for k in range(result.shape[0]):
            result[k] = result[k] + partial[c, k]


@kernel
def field_energy(
    mesh: Triangles,
    position: Reals2,
    velocity: Reals2,
    gravity: Reals1,
    lumping: Reals1,
    partial: Reals2,
    result: Reals1,
    parts: ti.i32,
    stride: Template,
    serial: Template,
):
    """Energies of triangles, added to result (3,) [J, per metre of depth].

    int rho |v|^2 / 2 of the velocity that is linear in each triangle; v^T M v / 2 with the part lumping (M,) of the
    mass matrix lumped, see `tipfem.fem.mass`; and -m x . gravity.
    """
    cells, period = ti.static(mesh.cells, mesh.period)
    ti.loop_config(serialize=serial)
    for t in range(parts * stride):
        kinetic, of_matrix, potential = 0.0, 0.0, 0.0
        first, last = part_of(t, parts, stride, cells.shape[0])
        for c in range(first, last):
            squares, total, mass = 0.0, ti.Vector.zero(float, 2), mesh.density[mesh.fluid[c]] * mesh.measure[c]
            shares = parts_of(1.0, mesh.position, cells, period, c)
            for a in ti.static(range(3)):
                x, v = row(position, cells[c, a], 2), row(velocity, cells[c, a], 2)
                if ti.static(len(period.shape) == 3):
                    squares += 3.0 * shares[a] * v.dot(v)
                    total += 3.0 * shares[a] * v
                    potential -= mass * (gravity[0] * x[0] + gravity[1] * x[1]) * shares[a]
                else:
                    squares += v.dot(v)
                    total += v
                    potential -= mass * (gravity[0] * x[0] + gravity[1] * x[1]) / 3.0
            mean = total.dot(total) / 3.0
            kinetic += mass * (0.25 * squares + 0.75 * mean) / 6.0
            of_matrix += mass * (lumping[c] * squares + (1.0 - lumping[c]) * mean) / 6.0
        if t % stride == 0:
            partial[t // stride, 0], partial[t // stride, 1], partial[t // stride, 2] = kinetic, of_matrix, potential
    ti.loop_config(serialize=True)
    for c in range(parts):
        for k in ti.static(range(3)):
            result[k] = result[k] + partial[c, k]


@ti.func
def new_number(number: ti.template(), p):
    """New number of a particle, see `mark_changed`."""
    q = p
    if number.shape[0] > 0:
        q = number[p]
    return q


@kernel
def mark_changed(
    old: Labelled,
    number: Ints1,
    new: Labelled,
    least: ti.f64,
    other: Flags1,
    buckets: Buckets,
    listed: Ints1,
    changed: Flags1,
    found: Ints1,
    parts: ti.i32,
    stride: Template,
    serial: Template,
):
    """Mark the cells (M',) that are not among the old ones (M,), in any order, or have a particle of the mask other.

    To the mask (N',) the particles are added whose velocity differs by more than ``least`` in a direction. number (N,)
    is the new one of each old particle, -1 for none; no number changes where it is empty. buckets and listed
    (M,) are scratch.
    """
    first, following = ti.static(buckets.first, buckets.following)
    ti.loop_config(serialize=serial)
    for p in range(old.velocity.shape[0]):
        q = new_number(number, p)
        if q >= 0:
            for k in ti.static(range(2)):
                if ti.abs(old.velocity[p, k] - new.velocity[q, k]) > least:
                    other[q] = 1
    ti.loop_config(serialize=serial)
    for p in range(first.shape[0]):
        first[p] = -1
    ti.loop_config(serialize=serial)
    for s in range(parts * stride):  # those that are not in the same row, in a list at their lowest corner
        start, last = part_of(s, parts, stride, old.cells.shape[0])
        end = start
        for t in range(start, last):
            same = t < new.cells.shape[0] and old.fluid[t] == new.fluid[ti.min(t, new.cells.shape[0] - 1)]
            if same:
                for i in ti.static(range(3)):
                    same = same and new_number(number, old.cells[t, i]) == new.cells[t, i]
            if not same:
                listed[end] = t
                end += 1
        if s % stride == 0:
            found[s // stride] = end - start
    ti.loop_config(serialize=True)
    for _ in range(1):
        for e in range(close_gaps(listed, found, parts, old.cells.shape[0])):
            t = listed[e]
            p = new_number(number, old.cells[t, 0])
            for i in ti.static(range(1, 3)):
                p = ti.min(p, new_number(number, old.cells[t, i]))
            if p >= 0:
                following[t] = first[p]
                first[p] = t
    ti.loop_config(serialize=serial)
    for t in range(new.cells.shape[0]):
        same = t < old.cells.shape[0] and new.fluid[t] == old.fluid[ti.min(t, old.cells.shape[0] - 1)]
        if same:
            for i in ti.static(range(3)):
                same = same and new_number(number, old.cells[t, i]) == new.cells[t, i]
        a, b, c = new.cells[t, 0], new.cells[t, 1], new.cells[t, 2]
        if not same:
            o = first[ti.min(a, b, c)]
            while o >= 0 and not same:
                same = old.fluid[o] == new.fluid[t]
                for i in ti.static(range(3)):
                    p = new_number(number, old.cells[o, i])
                    same = same and (p == a or p == b or p == c)
                o = following[o]
        changed[t] = not same or other[a] > 0 or other[b] > 0 or other[c] > 0


@ti.func
def gradient_of(x: ti.template(), period: ti.template(), velocity: ti.template(), cells: ti.template(), t):
    """Gradient of the velocity in a triangle, a row for each component."""
    a, b, c = cells[t, 0], cells[t, 1], cells[t, 2]
    ab = ti.Vector([difference(x, period, b, a, k) for k in ti.static(range(2))])
    ac = ti.Vector([difference(x, period, c, a, k) for k in ti.static(range(2))])
    vb, vc = row(velocity, b, 2) - row(velocity, a, 2), row(velocity, c, 2) - row(velocity, a, 2)
    area = ab[0] * ac[1] - ab[1] * ac[0]
    return ti.Matrix(
        [
            [(vb[0] * ac[1] - vc[0] * ab[1]) / area, (vc[0] * ab[0] - vb[0] * ac[0]) / area],
            [(vb[1] * ac[1] - vc[1] * ab[1]) / area, (vc[1] * ab[0] - vb[1] * ac[0]) / area],
        ]
    )


@kernel
def list_cells(
    cells: Ints2,
    grow: ti.i32,
    everywhere: ti.i32,
    changed: Flags1,
    near: Flags1,
    lists: Lists,
    found: Ints1,
    parts: ti.i32,
    stride: Template,
    serial: Template,
):
    """List the cells ``changed`` (M,), those at their particles, and their particles, ascending.

    If ``grow``, the cells at the particles listed last are taken instead of those ``changed``; they may be listed as
    ``active``. If ``everywhere``, all cells are listed as at particles. near (N,) marks the particles, and is zero at
    first.
    """
    active, beside, particles, counts = ti.static(lists.active, lists.beside, lists.particles, lists.counts)
    seen = 0 if grow != 0 and everywhere == 0 else cells.shape[0]
    ti.loop_config(serialize=serial)
    for s in range(parts * stride):
        first, last = part_of(s, parts, stride, seen)
        end = first
        for t in range(first, last):
            taken = changed[t] > 0
            if grow != 0:
                taken = near[cells[t, 0]] + near[cells[t, 1]] + near[cells[t, 2]] > 0
            if taken:
                active[end] = t
                end += 1
        if s % stride == 0:
            found[s // stride] = end - first
    ti.loop_config(serialize=True)
    for _ in range(1):
        if seen > 0:
            counts[ACTIVE] = close_gaps(active, found, parts, seen)
    ti.loop_config(serialize=serial)
    for s in range(parts * stride):
        first, last = part_of(s, parts, stride, counts[ACTIVE])
        for e in range(first, last):
            for i in ti.static(range(3)):
                near[cells[active[e], i]] = 1
    ti.loop_config(serialize=serial)
    for s in range(parts * stride):
        first, last = part_of(s, parts, stride, near.shape[0])
        end = first
        for p in range(first, last):
            if near[p] > 0:
                particles[end] = p
                end += 1
        if s % stride == 0:
            found[s // stride] = end - first
    ti.loop_config(serialize=True)
    for _ in range(1):
        counts[PARTICLES] = close_gaps(particles, found, parts, near.shape[0])
    ti.loop_config(serialize=serial)
    for s in range(parts * stride):
        first, last = part_of(s, parts, stride, cells.shape[0])
        end = first
        for t in range(first, last):
            if everywhere != 0 or near[cells[t, 0]] + near[cells[t, 1]] + near[cells[t, 2]] > 0:
                beside[end] = t
                end += 1
        if s % stride == 0:
            found[s // stride] = end - first
    ti.loop_config(serialize=True)
    for _ in range(1):
        counts[BESIDE] = close_gaps(beside, found, parts, cells.shape[0])


@ti.func
def add_push(rate: ti.template(), cells: ti.template(), t, push):
    """Add what the particles of a triangle exchange along its edges (6,) to their rates."""
    for i, k in ti.static(ti.ndrange(3, 2)):
        one, other = cells[t, i], cells[t, ti.static((i + 1) % 3)]
        rate[one, k] = rate[one, k] + push[2 * i + k]
        rate[other, k] = rate[other, k] - push[2 * i + k]


@kernel
def exchange_momentum(
    mesh: Triangles,
    neighbours: Ints2,
    mass: Reals1,
    wall: Flags1,
    velocity: Reals2,
    lists: Lists,
    rough: ti.i32,
    push: Reals2,
    rate: Reals2,
    parts: ti.i32,
    stride: Template,
    serial: Template,
):
    """Set the rates (N, 2) of the listed particles to those of `energy_balance.Exchange` in the ``active`` cells.

    push (M, 6) is scratch, for the momentum along each cell's edges. It is added up by one thread, in their order.
    """
    position, cells, period, fluid = ti.static(mesh.position, mesh.cells, mesh.period, mesh.fluid)
    active, particles, counts = ti.static(lists.active, lists.particles, lists.counts)
    ti.loop_config(serialize=serial)
    for s in range(parts * stride):
        first, last = part_of(s, parts, stride, counts[PARTICLES])
        for e in range(first, last):
            for k in ti.static(range(2)):
                rate[particles[e], k] = 0.0
    ti.loop_config(serialize=serial)
    for s in range(parts * stride):
        first, last = part_of(s, parts, stride, counts[ACTIVE])
        for e in range(first, last):
            t = active[e]
            gradient = gradient_of(position, period, velocity, cells, t)
            if rough != 0:
                total, count = gradient, 1.0
                for i in ti.static(range(3)):
                    o = neighbours[t, i]
                    if o >= 0:
                        if fluid[o] == fluid[t]:
                            total += gradient_of(position, period, velocity, cells, o)
                            count += 1.0
                gradient -= total / count
            pushed = ti.Vector.zero(float, 6)
            for i in ti.static(range(3)):
                one, other, part = cells[t, i], cells[t, ti.static((i + 1) % 3)], 0.0
                edge = ti.Vector([difference(position, period, other, one, k) for k in ti.static(range(2))])
                if wall[one] + wall[other] == 0:
                    part = mesh.density[fluid[t]] * mesh.measure[t] / 6.0 * edge.dot(gradient @ edge) / edge.dot(edge)
                for k in ti.static(range(2)):
                    pushed[2 * i + k] = part * edge[k]
            if ti.static(serial):
                add_push(rate, cells, t, pushed)
            else:
                for k in ti.static(range(6)):
                    push[e, k] = pushed[k]
    if ti.static(not serial):
        ti.loop_config(serialize=True)
        for _ in range(1):
            for e in range(counts[ACTIVE]):
                add_push(rate, cells, active[e], ti.Vector([push[e, k] for k in ti.static(range(6))]))
    ti.loop_config(serialize=serial)
    for s in range(parts * stride):
        first, last = part_of(s, parts, stride, counts[PARTICLES])
        for e in range(first, last):
            for k in ti.static(range(2)):
                rate[particles[e], k] /= ti.max(mass[particles[e]], 1e-300)


@kernel
def exchanged_energy(
    mesh: Triangles,
    velocity: Reals2,
    rate: Reals2,
    lumping: Reals1,
    consistent: float,
    lists: Lists,
    term: Reals2,
    result: Reals1,
    found: Ints1,
    parts: ti.i32,
    stride: Template,
    serial: Template,
):
    """Add v^T M u and u^T M u (4,) with a rate u of the velocities v to result, from the cells ``beside``.

    First with the part ``consistent`` of M lumped, then with the part lumping (M,) of each cell. term (M, 6) is
    scratch, for what one thread adds up in their order.
    """
    cells, period, beside, counts = ti.static(mesh.cells, mesh.period, lists.beside, lists.counts)
    ti.loop_config(serialize=serial)
    for s in range(parts * stride):
        first, last = part_of(s, parts, stride, counts[BESIDE])
        end = first
        for e in range(first, last):
            t = beside[e]
            square = 0.0
            for i in ti.static(range(3)):
                square += ti.abs(rate[cells[t, i], 0]) + ti.abs(rate[cells[t, i], 1])
            if not square > 0.0:
                continue
            vu, uu = 0.0, 0.0
            v, u = ti.Vector.zero(float, 2), ti.Vector.zero(float, 2)
            axial = ti.static(len(period.shape) == 3)
            shares = parts_of(1.0, mesh.position, cells, period, t)
            for i in ti.static(range(3)):
                vi, ui = row(velocity, cells[t, i], 2), row(rate, cells[t, i], 2)
                if ti.static(axial):
                    vu += vi.dot(ui) * shares[i]
                    uu += ui.dot(ui) * shares[i]
                    v += vi * shares[i]
                    u += ui * shares[i]
                else:
                    vu += vi.dot(ui) / 3.0
                    uu += ui.dot(ui) / 3.0
                    v += vi / 3.0
                    u += ui / 3.0
            mean_vu, mean_uu, m, part = v.dot(u), u.dot(u), mesh.density[mesh.fluid[t]] * mesh.measure[t], lumping[t]
            terms = ti.Vector(
                [
                    m * (consistent * vu + (1.0 - consistent) * mean_vu),
                    m * (consistent * uu + (1.0 - consistent) * mean_uu),
                    m * (part * vu + (1.0 - part) * mean_vu),
                    m * (part * uu + (1.0 - part) * mean_uu),
                ]
            )
            for k in ti.static(range(4)):
                if ti.static(serial):
                    result[k] = result[k] + terms[k]
                else:
                    term[end, k] = terms[k]
            end += 1
        if s % stride == 0:
            found[s // stride] = end - first
    if ti.static(not serial):
        ti.loop_config(serialize=True)
        for s in range(parts):
            first, _last = part_of(s, parts, 1, counts[BESIDE])
            for e in range(first, first + found[s]):
                for k in ti.static(range(4)):
                    result[k] = result[k] + term[e, k]


@kernel
def add_rates(velocity: Reals2, rate: Reals2, factor: ti.f64, lists: Lists):
    """Add a factor times the rates (N, 2) of the listed particles to their velocities."""
    ti.loop_config(serialize=True)
    for e in range(lists.counts[PARTICLES]):
        p = lists.particles[e]
        for k in ti.static(range(2)):
            velocity[p, k] = velocity[p, k] + factor * rate[p, k]
