"""Kernels that label the connected components of fluids and keep their volumes.

Those that make sums are serial, in the order of the cells, so that these are repeatable. Arrays are those of `volumes`
and of `tipfem.mesh.components.Components`.
"""

from typing import NamedTuple

import taichi as ti

from tipfem.backend.array_types import Flags1, Ints1, Ints2, Periods, Reals1, Reals2, Template
from tipfem.backend.launch import kernel
from tipfem.backend.periodic import difference, radius
from tipfem.fem.element import area_of, measure_of
from tipfem.mesh.components import ON_HULL, ON_INTERFACE

CELL = 5.0  # nanoseconds of one thread for the area of a cell
TRIALS = 4  # in which particles are held back, see `shift_interfaces`
UNKNOWN = 2**31 - 1  # component of a fluid at a particle, in `place_components`
# Columns of the list of gradients' entries, see `gradients`.
COMPONENT, NEXT = 0, 1
END, FIXED = -1, -2
# First columns, in the scratch of `shift_interfaces`, of a particle's displacement and of its position before.
DISPLACEMENT, BEFORE = 0, 2


@ti.func
def root_of(label: Template, i):
    """Root of the set of cell ``i``; unlike `find_root` it changes nothing, for others may look at the same time."""
    r = i
    while label[r] != r:
        r = label[r]
    return r


@ti.func
def unite(label: Template, one, other):
    """Join the sets of two cells, the higher root under the lower one, whoever else does so at the same time.

    After J. Jaiganesh, M. Burtscher, A high-performance connected components implementation for GPUs, HPDC 2018: roots
    are the lowest of their sets in any order.
    """
    a, b = root_of(label, one), root_of(label, other)
    while a != b:
        low, high = ti.min(a, b), ti.max(a, b)
        before = ti.atomic_min(label[high], low)
        if before == high:  # it was a root still
            a = b
        else:
            a, b = root_of(label, before), root_of(label, low)


@kernel
def join_cells(
    x: Reals2,
    cells: Ints2,
    neighbours: Ints2,
    fluid: Ints1,
    period: Periods,
    label: Ints1,
    mark: Ints1,
    measure: Reals1,
    dim: Template,
    serial: Template,
):
    """label (M,): the lowest cell of each cell's component. mark (N,), zero before: bits `ON_INTERFACE`, `ON_HULL`.

    measure (M,): of the cells. Removed cells are left as they are.
    """
    ti.loop_config(serialize=serial)
    for t in range(cells.shape[0]):
        label[t] = t
        if fluid[t] >= 0:
            if ti.static(dim == 2):
                measure[t] = area_of(x, cells, period, t)
            else:
                measure[t] = measure_of(x, cells, t, dim)
    ti.loop_config(serialize=serial)
    for t in range(cells.shape[0]):
        for i in ti.static(range(dim + 1)):
            o = neighbours[t, i]
            bit = 0
            if fluid[t] >= 0:
                if o < 0:
                    bit = ON_HULL
                elif o < t:
                    if fluid[o] == fluid[t]:
                        unite(label, t, o)
                    else:
                        bit = ON_INTERFACE
            if bit > 0:
                for k in ti.static(range(1, dim + 1)):
                    n = cells[t, ti.static((i + k) % (dim + 1))]
                    if mark[n] & bit == 0:
                        ti.atomic_or(mark[n], bit)
    ti.loop_config(serialize=serial)
    for t in range(cells.shape[0]):
        label[t] = root_of(label, t)


@kernel
def number_components(fluid: Ints1, label: Ints1, measure: Reals1, number: Ints1, of: Ints1, volume: Reals1) -> ti.i32:
    """Numbers of the roots of `join_cells`, ascending; the components' fluids and volumes (K,), and K."""
    count = 0
    ti.loop_config(serialize=True)
    for _ in range(1):
        root, b, total = -1, 0, 0.0  # of the last cell; its component's volume in a register, as long as roots repeat
        for t in range(label.shape[0]):
            if fluid[t] >= 0:
                if label[t] != root:
                    if root >= 0:
                        volume[b] = total
                    root = label[t]
                    if root == t:
                        number[t], of[count], volume[count] = count, fluid[t], 0.0
                        count += 1
                    b = number[root]
                    total = volume[b]
                total += measure[t]
        if root >= 0:
            volume[b] = total
    return count


@kernel
def place_components(
    cells: Ints2,
    fluid: Ints1,
    mark: Ints1,
    number: Ints1,
    rank: Ints1,
    label: Ints1,
    movable: Flags1,
    near: Ints1,
    at: Ints2,
    dim: Template,
    serial: Template,
) -> ti.i32:
    """label (M,): the rank (K,) of each cell's component instead of its root, -1 for removed cells.

    movable (K,), zero before: 1 for those with a particle on an interface and off the hull. near (M,): the cells with
    such a particle, and how many there are. at (F, N): the lowest rank of each fluid at each particle, -1 for none.
    """
    ti.loop_config(serialize=serial)
    for f, n in ti.ndrange(at.shape[0], at.shape[1]):
        at[f, n] = UNKNOWN
    ti.loop_config(serialize=serial)
    for t in range(cells.shape[0]):
        k = -1
        if fluid[t] >= 0:
            k = rank[number[label[t]]]
            for i in ti.static(range(dim + 1)):
                if at[fluid[t], cells[t, i]] > k:
                    ti.atomic_min(at[fluid[t], cells[t, i]], k)
        label[t] = k
    ti.loop_config(serialize=serial)
    for f, n in ti.ndrange(at.shape[0], at.shape[1]):
        if at[f, n] == UNKNOWN:
            at[f, n] = -1
    count = 0
    ti.loop_config(serialize=True)
    for t in range(cells.shape[0]):
        if label[t] >= 0:
            beside = False
            for i in ti.static(range(dim + 1)):
                beside = beside or mark[cells[t, i]] == ON_INTERFACE
            if beside:
                movable[label[t]] = 1
                near[count] = t
                count += 1
    return count


@kernel
def measure_cells(x: Reals2, cells: Ints2, period: Periods, measure: Reals1, serial: Template):
    """measure (M,): areas of the triangles at the positions x (N, 2)."""
    ti.loop_config(serialize=serial)
    for t in range(cells.shape[0]):
        measure[t] = area_of(x, cells, period, t)


@kernel
def transfer_deficits(old: Ints2, new: Ints2, relocated: Flags1, deficit: Reals1, shares: Ints1, result: Reals1):
    """Divide each component's deficit (K,) equally among its particles: see `volumes.transfer_deficits`."""
    ti.loop_config(serialize=True)
    for f in range(old.shape[0]):
        for i in range(old.shape[1]):
            if old[f, i] >= 0 and new[f, i] >= 0 and relocated[i] == 0:
                shares[old[f, i]] = shares[old[f, i]] + 1
    ti.loop_config(serialize=True)
    for f in range(old.shape[0]):
        for i in range(old.shape[1]):
            if old[f, i] >= 0 and new[f, i] >= 0 and relocated[i] == 0:
                result[new[f, i]] = result[new[f, i]] + deficit[old[f, i]] / shares[old[f, i]]


class Contacts(NamedTuple):
    """Particles at which interfaces end on walls."""

    along: "Reals2"  # (N, 2) unit vectors along their walls
    nodes: "Ints1"  # they are, ascending
    near: "Ints1"  # the cells at such particles on any wall
    found: "Ints1"  # (2,) how many there are of both


class Gradients(NamedTuple):
    """dV_k / dx of the components' volumes: lists of entries of particles, at most three per cell."""

    head: "Ints1"  # (N,) the first entry of a particle, or `END`
    chain: "Ints2"  # (E, 2) the component, and the next entry, `END` after the last
    gradient: "Reals2"  # (E, 2)


@ti.func
def entry_of(head: Template, chain: Template, i, component):
    """Entry of a component in the list of particle i; `END` if there is none."""
    e = head[i]
    while e >= 0:
        if chain[e, COMPONENT] == component:
            break
        e = chain[e, NEXT]
    return e


@kernel
def list_contacts(
    x: Reals2,
    cells: Ints2,
    neighbours: Ints2,
    fluid: Ints1,
    period: Periods,
    mark: Ints1,
    slides: Flags1,
    flat: float,
    contact: Flags1,
    length: Reals1,
    contacts: Contacts,
):
    """The particles among ``slides`` (N,) at which interfaces end on straight walls, and may move along these.

    ``flat``: cosine of the least angle between interface and wall. ``contact`` and ``length`` (N,) are scratch.
    """
    along, nodes, near, found = ti.static(contacts.along, contacts.nodes, contacts.near, contacts.found)
    ti.loop_config(serialize=True)
    for i in range(mark.shape[0]):
        contact[i] = ti.cast(slides[i] and mark[i] == ON_INTERFACE + ON_HULL, ti.i8)
        length[i], along[i, 0], along[i, 1] = 0.0, 0.0, 0.0
    ti.loop_config(serialize=True)
    for _ in range(1):
        count = 0
        for t in range(cells.shape[0]):
            if contact[cells[t, 0]] or contact[cells[t, 1]] or contact[cells[t, 2]]:
                near[count] = t
                count += 1
                for i in ti.static(range(3)):
                    if neighbours[t, i] < 0:
                        a, b = cells[t, ti.static((i + 1) % 3)], cells[t, ti.static((i + 2) % 3)]
                        d = ti.Vector([difference(x, period, b, a, k) for k in ti.static(range(2))])
                        for end in ti.static((a, b)):
                            length[end] += d.norm()
                            along[end, 0] += d[0]
                            along[end, 1] += d[1]
        found[1] = count
        for i in range(mark.shape[0]):
            if contact[i]:
                whole = ti.sqrt(along[i, 0] ** 2 + along[i, 1] ** 2)
                if whole > (1.0 - 1e-12) * length[i]:  # of two edges in one line the lengths add up
                    along[i, 0], along[i, 1] = along[i, 0] / whole, along[i, 1] / whole
                else:
                    contact[i] = 0
        for c in range(count):
            t = near[c]
            for i in ti.static(range(3)):
                o = neighbours[t, i]
                if o >= 0 and fluid[ti.max(o, 0)] != fluid[t]:
                    a, b = cells[t, ti.static((i + 1) % 3)], cells[t, ti.static((i + 2) % 3)]
                    d = ti.Vector([difference(x, period, b, a, k) for k in ti.static(range(2))])
                    for end in ti.static((a, b)):
                        if ti.abs(d[0] * along[end, 0] + d[1] * along[end, 1]) > flat * d.norm() and contact[end]:
                            contact[end] = 2
        count = 0
        for i in range(mark.shape[0]):
            if contact[i] == 1:
                nodes[count] = i
                count += 1
        found[0] = count


@kernel
def gradients(
    x: Reals2,
    cells: Ints2,
    period: Periods,
    label: Ints1,
    near: Ints1,
    nodes: Ints1,
    tangent: Reals2,
    entries: Gradients,
) -> ti.i32:
    """Gradients dV_k / dx of the components' volumes at the particles ``nodes``.

    ``near``: the cells with such a particle. entries.head is `FIXED` for particles that stay. Returns how many products
    of two of them `products` lists.

    tangent (len(nodes), 2): the direction in which a contact on a wall may move; zero for particles off the walls. Of
    a contact's gradients the part in that direction is taken, twice: the interface ends there, so that a shift of all
    of it by one distance changes the volume at the contact by half as much as elsewhere.
    """
    head, chain, gradient = ti.static(entries.head, entries.chain, entries.gradient)
    ti.loop_config(serialize=True)
    for n in range(nodes.shape[0]):
        head[nodes[n]] = END
    number = 0
    ti.loop_config(serialize=True)
    for n in range(near.shape[0]):
        t = near[n]
        for k in ti.static(range(3)):
            i = cells[t, k]
            if head[i] > FIXED:
                e = entry_of(head, chain, i, label[t])
                if e < 0:
                    e = number
                    number += 1
                    chain[e, COMPONENT], chain[e, NEXT] = label[t], head[i]
                    gradient[e, 0], gradient[e, 1] = 0.0, 0.0
                    head[i] = e
                a, b = cells[t, ti.static((k + 1) % 3)], cells[t, ti.static((k + 2) % 3)]
                mean_r = 1.0
                if ti.static(len(period.shape) == 3):
                    mean_r = (radius(x, period, i) + radius(x, period, a) + radius(x, period, b)) / 3.0
                    gradient[e, 0] = gradient[e, 0] + 2.0 * ti.math.pi / 3.0 * area_of(x, cells, period, t) / mean_r
                gradient[e, 0] = gradient[e, 0] - 0.5 * mean_r * difference(x, period, b, a, 1)
                gradient[e, 1] = gradient[e, 1] + 0.5 * mean_r * difference(x, period, b, a, 0)
    ti.loop_config(serialize=True)
    for n in range(nodes.shape[0]):
        t = ti.Vector([tangent[n, 0], tangent[n, 1]])
        e = head[nodes[n]]
        while e >= 0 and (t[0] != 0 or t[1] != 0):
            part = 2.0 * (gradient[e, 0] * t[0] + gradient[e, 1] * t[1])
            gradient[e, 0], gradient[e, 1] = part * t[0], part * t[1]
            e = chain[e, NEXT]
    pairs = 0
    ti.loop_config(serialize=True)
    for n in range(nodes.shape[0]):
        e, count = head[nodes[n]], 0
        while e >= 0:
            count += 1
            e = chain[e, NEXT]
        pairs += count * count
    return pairs


@kernel
def products(nodes: Ints1, tangent: Reals2, entries: Gradients, pair: Ints2, product: Reals1):
    """Products (P,) of the gradients of each ``pair`` (P, 2) of components at a particle; see `gradients`.

    Their sums by pairs are the matrix dV_k / dx . dV_l / dx.
    """
    head, chain, gradient = ti.static(entries.head, entries.chain, entries.gradient)
    ti.loop_config(serialize=True)
    for _ in range(1):
        place = 0
        for n in range(nodes.shape[0]):
            weight = 1.0 if tangent[n, 0] == 0 and tangent[n, 1] == 0 else 0.5
            e = head[nodes[n]]
            while e >= 0:
                o = head[nodes[n]]
                while o >= 0:
                    pair[place, 0], pair[place, 1] = chain[e, COMPONENT], chain[o, COMPONENT]
                    product[place] = weight * (gradient[e, 0] * gradient[o, 0] + gradient[e, 1] * gradient[o, 1])
                    place += 1
                    o = chain[o, NEXT]
                e = chain[e, NEXT]


@ti.func
def place_shifted(x: Template, nodes: Template, shift: Template, give_up):
    """Displace the particles ``nodes`` by ``shift`` (N, 4), or move them back if ``give_up``; return how many moved."""
    moved = 0
    for n in range(nodes.shape[0]):
        i = nodes[n]
        if give_up:
            shift[i, DISPLACEMENT], shift[i, DISPLACEMENT + 1] = 0.0, 0.0
        if shift[i, DISPLACEMENT] != 0 or shift[i, DISPLACEMENT + 1] != 0:
            moved += 1
        for k in ti.static(range(2)):
            x[i, k] = shift[i, BEFORE + k] + shift[i, DISPLACEMENT + k]
    return moved


@ti.func
def hold_back(x: Template, cells: Template, period: Template, near: Template, measure: Template, shift: Template):
    """Hold back the particles of cells ``near`` that lost more than half of their area; return how many cells."""
    halved = 0
    for n in range(near.shape[0]):
        t = near[n]
        if area_of(x, cells, period, t) < 0.5 * measure[t]:
            halved += 1
            for k in ti.static(range(3)):
                shift[cells[t, k], DISPLACEMENT], shift[cells[t, k], DISPLACEMENT + 1] = 0.0, 0.0
    return halved


@kernel
def shift_interfaces(
    x: Reals2,
    cells: Ints2,
    period: Periods,
    label: Ints1,
    near: Ints1,
    nodes: Ints1,
    entries: Gradients,
    factor: Reals1,
    shift: Reals2,
    measure: Reals1,
    gain: Reals1,
    limit: ti.f64,
) -> ti.i32:
    """Displace the particles ``nodes`` by the sum of factor (K,) times their gradients, but by ``limit`` [m] at most.

    None moves at a cell that would lose more than half of its area. Positions ``x`` (N, 2) and areas (M,) are changed,
    and ``gain`` (K,) is increased by the change of the components' volumes. Returns how many particles moved, 0 if
    cells still lose too much after `TRIALS` trials. shift (N, 4) is scratch.
    """
    head, chain, gradient = ti.static(entries.head, entries.chain, entries.gradient)
    ti.loop_config(serialize=True)
    for n in range(nodes.shape[0]):
        i = nodes[n]
        sum = ti.Vector([0.0, 0.0])
        e = head[i]
        while e >= 0:
            sum += factor[chain[e, COMPONENT]] * ti.Vector([gradient[e, 0], gradient[e, 1]])
            e = chain[e, NEXT]
        sum *= ti.min(1.0, limit / ti.max(sum.norm(), 1e-300))
        for k in ti.static(range(2)):
            shift[i, DISPLACEMENT + k], shift[i, BEFORE + k] = sum[k], x[i, k]
    halved, moved = 1, 0
    ti.loop_config(serialize=True)
    for trial in range(TRIALS + 1):
        if halved > 0:
            moved = place_shifted(x, nodes, shift, trial == TRIALS)
            halved = hold_back(x, cells, period, near, measure, shift)
    ti.loop_config(serialize=True)
    for n in range(near.shape[0]):
        t = near[n]
        area = area_of(x, cells, period, t)
        gain[label[t]] = gain[label[t]] + (area - measure[t])
        measure[t] = area
    return moved
