"""Kernels that keep the volumes of bodies: which triangles make one, what each has, and how interfaces move.

All run in one thread, in the order of the triangles: sums are the same every time. Arrays are those of
`volumes`.
"""

import taichi as ti

from tipfem.backend.launch import on_arrays
from tipfem.fem.element import area_of

TURNS = 4  # of holding particles back, see `shift_interfaces`


@ti.func
def root_of(body: ti.template(), t):
    """First triangle of the tree that ``t`` hangs on; halves the way there."""
    r = t
    while body[r] != r:
        body[r] = body[body[r]]
        r = body[r]
    return r


@on_arrays
@ti.kernel
def take_stock(
    x: ti.types.ndarray(),
    cells: ti.types.ndarray(),
    across: ti.types.ndarray(),
    fluid: ti.types.ndarray(),
    body: ti.types.ndarray(),
    mark: ti.types.ndarray(),
    measure: ti.types.ndarray(),
    volume: ti.types.ndarray(),
    of: ti.types.ndarray(),
    free: ti.types.ndarray(),
    near: ti.types.ndarray(),
    at: ti.types.ndarray(),
    count: ti.types.ndarray(),
    elements: ti.i32,
    particles: ti.i32,
    marked: ti.i32,
):
    """What bodies there are in the triangles, and what they have.

    body (M,): number of the connected body of one fluid that each cell belongs to, in the order of their first cells,
    -1 for cells that are gone. mark (N,): bit 1 for particles on an interface, bit 2 for those on the hull; zero
    before, unless it is given, ``marked``. measure (M,): areas. volume (K,), fluid ``of`` (K,), free (K,): 1 for bodies
    with a particle of mark 1. near (M,): the triangles with such a particle. at (F, N): a body of each fluid at each
    particle, -1 before, where there is none.
    count: [0] bodies, [1] triangles in ``near``.
    """
    ti.loop_config(serialize=True)
    for t in range(elements):
        root = t
        body[t] = t
        for i in ti.static(range(3)):
            o = across[t, i]
            bit = 0
            if fluid[t] < 0:
                bit = 0
            elif 0 <= o < t:
                if fluid[o] != fluid[t]:
                    bit = 1
                elif body[o] != root:
                    other = root_of(body, o)
                    body[ti.max(root, other)] = ti.min(root, other)
                    root = ti.min(root, other)
            elif o < 0:
                bit = 2
            if bit > 0 and marked == 0:
                for k in ti.static(range(1, 3)):
                    n = cells[t, ti.static((i + k) % 3)]
                    mark[n] = mark[n] | bit
        body[t] = root
    ti.loop_config(serialize=True)
    for t in range(elements):  # numbers as -1 - number until all are there
        if fluid[t] < 0:
            body[t] = 0
        elif body[t] == t:
            body[t] = -1 - count[0]
            count[0] = count[0] + 1
        else:
            body[t] = body[body[t]]
    ti.loop_config(serialize=True)
    for t in range(elements):
        b, f, bits = -1 - body[t], fluid[t], 0
        body[t] = b
        if f >= 0:
            area = area_of(x, cells, t)
            measure[t] = area
            volume[b] = volume[b] + area
            of[b] = f
            for k in ti.static(range(3)):
                n = cells[t, k]
                if mark[n] == 1:
                    bits = 1
                known = at[f, n]
                if known != 4 * b + k and (known & 3 <= k or known < 0):  # of several that of the last to end in it
                    at[f, n] = 4 * b + k
            if bits > 0:
                free[b] = 1
                near[count[1]] = t
                count[1] = count[1] + 1
    ti.loop_config(serialize=True)
    for n in range(particles):
        for f in range(at.shape[0]):
            at[f, n] = at[f, n] >> 2


@on_arrays
@ti.kernel
def hand_on(
    old: ti.types.ndarray(),
    new: ti.types.ndarray(),
    moved: ti.types.ndarray(),
    loss: ti.types.ndarray(),
    parts: ti.types.ndarray(),
    result: ti.types.ndarray(),
    fluids: ti.i32,
    count: ti.i32,
):
    """Each body's loss (K,) in equal ``parts`` (K,) with its particles: see `volumes.inherit`; (F, N) old, new."""
    ti.loop_config(serialize=True)
    for f in range(fluids):
        for i in range(count):
            if old[f, i] >= 0 and new[f, i] >= 0 and moved[i] == 0:
                parts[old[f, i]] = parts[old[f, i]] + 1
    ti.loop_config(serialize=True)
    for f in range(fluids):
        for i in range(count):
            if old[f, i] >= 0 and new[f, i] >= 0 and moved[i] == 0:
                result[new[f, i]] = result[new[f, i]] + loss[old[f, i]] / parts[old[f, i]]


@on_arrays
@ti.kernel
def triangles_at(
    cells: ti.types.ndarray(), movable: ti.types.ndarray(), near: ti.types.ndarray(), elements: ti.i32
) -> ti.i32:
    """near (M,): the triangles with a movable particle; returns how many there are."""
    count = 0
    ti.loop_config(serialize=True)
    for t in range(elements):
        if movable[cells[t, 0]] != 0 or movable[cells[t, 1]] != 0 or movable[cells[t, 2]] != 0:
            near[count] = t
            count += 1
    return count


@on_arrays
@ti.kernel
def gradients(
    x: ti.types.ndarray(),
    cells: ti.types.ndarray(),
    body: ti.types.ndarray(),
    near: ti.types.ndarray(),
    nodes: ti.types.ndarray(),
    head: ti.types.ndarray(),
    chain: ti.types.ndarray(),
    gradient: ti.types.ndarray(),
    gram: ti.types.ndarray(),
    count: ti.i32,
    movable: ti.i32,
):
    """Gradients dV_k / dx of the bodies' volumes at the particles ``nodes``, and their products ``gram`` (K, K).

    The entries of particle i begin at head[i], which is -2 for particles that stay: chain (E, 2) holds the body and
    the next entry, -1 after the last; gradient (E, 2) is the entry's. There are at most three a triangle.
    """
    ti.loop_config(serialize=True)
    for n in range(movable):
        head[nodes[n]] = -1
    entries = 0
    ti.loop_config(serialize=True)
    for n in range(count):
        t = near[n]
        for k in ti.static(range(3)):
            i = cells[t, k]
            if head[i] > -2:
                e = head[i]
                while e >= 0:
                    if chain[e, 0] == body[t]:
                        break
                    e = chain[e, 1]
                if e < 0:
                    e = entries
                    entries += 1
                    chain[e, 0], chain[e, 1] = body[t], head[i]
                    gradient[e, 0], gradient[e, 1] = 0.0, 0.0
                    head[i] = e
                a, b = cells[t, ti.static((k + 1) % 3)], cells[t, ti.static((k + 2) % 3)]
                gradient[e, 0] = gradient[e, 0] - 0.5 * (x[b, 1] - x[a, 1])
                gradient[e, 1] = gradient[e, 1] + 0.5 * (x[b, 0] - x[a, 0])
    ti.loop_config(serialize=True)
    for n in range(movable):
        e = head[nodes[n]]
        while e >= 0:
            o = head[nodes[n]]
            while o >= 0:
                product = gradient[e, 0] * gradient[o, 0] + gradient[e, 1] * gradient[o, 1]
                gram[chain[e, 0], chain[o, 0]] = gram[chain[e, 0], chain[o, 0]] + product
                o = chain[o, 1]
            e = chain[e, 1]


@on_arrays
@ti.kernel
def shift_interfaces(
    x: ti.types.ndarray(),
    cells: ti.types.ndarray(),
    body: ti.types.ndarray(),
    near: ti.types.ndarray(),
    nodes: ti.types.ndarray(),
    head: ti.types.ndarray(),
    chain: ti.types.ndarray(),
    gradient: ti.types.ndarray(),
    factor: ti.types.ndarray(),
    way: ti.types.ndarray(),
    measure: ti.types.ndarray(),
    gain: ti.types.ndarray(),
    limit: ti.f64,
    count: ti.i32,
    movable: ti.i32,
) -> ti.i32:
    """Shift the particles ``nodes`` by the sum of factor (K,) times their gradients, but by ``limit`` [m] at most.

    None moves at a triangle that would lose more than half of its area. Positions ``x`` (N, 2) and areas (M,) are
    changed, and ``gain`` (K,) is what the bodies' volumes gain. Returns how many moved; of all or none, where holding
    back some does not help the others. way (N, 4) is scratch.
    """
    ti.loop_config(serialize=True)
    for n in range(movable):
        i = nodes[n]
        shift = ti.Vector([0.0, 0.0])
        e = head[i]
        while e >= 0:
            shift += factor[chain[e, 0]] * ti.Vector([gradient[e, 0], gradient[e, 1]])
            e = chain[e, 1]
        shift *= ti.min(1.0, limit / ti.max(shift.norm(), 1e-300))
        way[i, 0], way[i, 1], way[i, 2], way[i, 3] = shift[0], shift[1], x[i, 0], x[i, 1]
    bad, moved = 1, 0
    ti.loop_config(serialize=True)
    for turn in range(TURNS + 1):
        if bad > 0:
            moved = 0
            for n in range(movable):
                i = nodes[n]
                if turn == TURNS:
                    way[i, 0], way[i, 1] = 0.0, 0.0
                if way[i, 0] != 0 or way[i, 1] != 0:
                    moved += 1
                x[i, 0], x[i, 1] = way[i, 2] + way[i, 0], way[i, 3] + way[i, 1]
            bad = 0
            for n in range(count):
                if area_of(x, cells, near[n]) < 0.5 * measure[near[n]]:
                    bad += 1
                    for k in ti.static(range(3)):
                        way[cells[near[n], k], 0], way[cells[near[n], k], 1] = 0.0, 0.0
    ti.loop_config(serialize=True)
    for n in range(count):
        t = near[n]
        area = area_of(x, cells, t)
        gain[body[t]] = gain[body[t]] + (area - measure[t])
        measure[t] = area
    return moved
