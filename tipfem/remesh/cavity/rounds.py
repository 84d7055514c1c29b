"""Kernels of a round of changes: find, propose, stake, settle, apply, link.

What is to be changed is found in every cell, and proposed in a row each: a cavity with the cells that fill it anew.
Proposals claim the particles of their cells, see `tipfem.remesh.claims`, and those that have all of theirs win.
Winners share no particle, so no cell, no edge, no face and no neighbour either: each changes its cells and what their
neighbours know of them. Neither the order of threads nor their number has an influence.

``limits`` (`LIMITS`,): [SPACING] h; [LIMIT] of what is found: of flips an excess, of other swaps, cures and smoothing a
quality, of collapses, splits and films a length in h; of collapses the [LONGEST] edge that may come from them in h, and
the [LEAST] quality, or what they must [GAIN], as other changes must; [BEND] of an interface where edges turn; of films
the time [AHEAD] in s within which empty space closes.
"""

import taichi as ti

from tipfem.backend.array_types import Flags1, Ints1, Ints2, Longs1, Reals1, Reals2, Template
from tipfem.backend.launch import kernel
from tipfem.geometry.place import DIRECTION
from tipfem.remesh.cavity.arrays import (
    CELL,
    CODE,
    COLLAPSE,
    COUNT,
    CURE,
    DONE,
    FILLED,
    FILLED_MOST,
    FIRST,
    FIXED,
    FREE_CELL,
    KIND,
    LAND,
    LATER,
    LIMIT,
    MOST,
    MOVES,
    NEW,
    NEW_LABEL,
    NEW_PARTICLE,
    NONE,
    ON,
    OUTER,
    OUTERS,
    PLACE,
    RELABEL,
    SLOT,
    SMOOTH,
    SPACING,
    SPLIT,
    SWAP,
    URGENCY,
    USED,
    WALL,
    WON,
    P,
    Proposals,
    Q,
    Simplices,
    cell,
    distance,
    finest_at,
    gradient,
    has_mark,
    in_cavity,
    measure,
    new_cell,
    place_of,
    position,
    quality,
    wanted,
)
from tipfem.remesh.cavity.collapses import merge, propose_collapse, propose_removal
from tipfem.remesh.cavity.films import closes, land, propose_relabelling
from tipfem.remesh.cavity.smoothing import propose_smoothing
from tipfem.remesh.cavity.splits import propose_insertion, propose_split_in_middle
from tipfem.remesh.cavity.stars import is_in, is_interface, owns
from tipfem.remesh.cavity.swaps import flip_excess, propose_flip, propose_swap
from tipfem.remesh.claims import raise_to, whole_place, whole_urgency

FIND, PROPOSE, STAKE, SETTLE, APPLY, LINK = 30.0, 4000.0, 5.0, 500.0, 1000.0, 200.0  # ns of a thread for each entry
WORST = 2.0  # more than any quality: urgencies are positive
FINE = 1 << SWAP | 1 << CURE | 1 << SMOOTH  # in 3-D what is good enough not to be swapped is so for these, too


@ti.func
def length_code(mesh: Template, limits: Template, t, longer: Template):
    """1 + 4 i + j of the longest or shortest edge of corners i, j of cell t that it owns and that is to go; else 0."""
    code, best = 0, (limits[LIMIT] * limits[SPACING]) ** 2
    for j in ti.static(range(mesh.dim + 1)):
        for i in ti.static(range(j)):
            a, b = mesh.cells[t, i], mesh.cells[t, j]
            # As close as both may be: what a split leaves is not to be collapsed where distances grow.
            unit = wanted(mesh, a, b) if longer else ti.min(mesh.wide[a], mesh.wide[b])
            square = (position(mesh, a) - position(mesh, b)).norm_sqr() / (unit * unit)
            worse = square > best if ti.static(longer) else square < best
            if worse:
                if owns(mesh, t, i, j):
                    best, code = square, 1 + 4 * i + j
    return code


@ti.func
def film_code(mesh: Template, fields: Template, limits: Template, t):
    """1 for a cell whose particles all are on an interface or a wall, and which is lower than a film, or alone; else 0.

    Or which closes. One of them must move: what is at rest stays as it is.
    """
    inside, moves, film = False, False, True
    for i in range(mesh.dim + 1):
        if mesh.marks[mesh.cells[t, i]] & (ON | WALL) == 0:
            inside = True
        if has_mark(mesh, mesh.cells[t, i], MOVES):
            moves = True
        if mesh.across[t, i] >= 0:
            film = film and mesh.label[mesh.across[t, i]] != mesh.label[t]
    if moves and not inside and not film:
        largest = 0.0
        for i in range(mesh.dim + 1):
            largest = ti.max(largest, gradient(mesh, t, i).norm())
        film = measure(mesh, cell(mesh, t)) < limits[LIMIT] * finest_at(mesh, limits, t) * largest
        film = film or closes(mesh, fields, limits, t)
    return 1 if moves and not inside and film else 0


@kernel
def find(
    mesh: Simplices,
    tried: Ints1,
    fields: Reals2,
    limits: Reals1,
    some: Ints1,
    code: Ints1,
    task: Template,
    serial: Template,
):
    """code (K,): what a task is to change at each of ``some`` cells (K,), 0 for nothing.

    tried (M,): bits of the tasks for which cells were looked at; changes reset them.
    """
    ti.loop_config(serialize=serial)
    for n in range(some.shape[0]):
        t, found = some[n], 0
        if mesh.label[t] >= 0 and (tried[t] >> task) & 1 == 0:
            if ti.static(task == SWAP and mesh.dim == 2):
                most = limits[LIMIT]
                for i in ti.static(range(mesh.dim + 1)):
                    excess = flip_excess(mesh, t, i)
                    if excess > most:
                        most, found = excess, 1 + i
            elif ti.static(task == COLLAPSE or task == SPLIT):
                found = length_code(mesh, limits, t, task == SPLIT)
            elif ti.static(task == RELABEL):
                if tried[t] & DONE == 0:
                    found = film_code(mesh, fields, limits, t)
            elif quality(mesh, t) < limits[LIMIT]:
                found = 1
            if found == 0:
                tried[t] |= ti.static(FINE if task == SWAP and mesh.dim == 3 else 1 << task)
        code[n] = found


@kernel
def propose(
    mesh: Simplices,
    tried: Ints1,
    fields: Reals2,
    limits: Reals1,
    rows: Proposals,
    count: ti.i32,
    task: Template,
    serial: Template,
):
    """The best change for [CELL] and [CODE] of each of the first ``count`` rows, with its [KIND], `NONE` for none."""
    ti.loop_config(serialize=serial)
    for r in range(count):
        t, code = rows.row[r, CELL], rows.row[r, CODE] - 1
        rows.row[r, KIND] = NONE
        good, urgency = True, WORST - quality(mesh, t)
        if ti.static(task == SWAP and mesh.dim == 2):
            propose_flip(mesh, rows, r, t, code)
            urgency = flip_excess(mesh, t, code)
        elif ti.static(task == SWAP):
            good = propose_swap(mesh, rows, limits, r, t)
        elif ti.static(task == COLLAPSE or task == CURE):
            good = propose_collapse(mesh, rows, limits, r, t, code, task == CURE)
        elif ti.static(task == SPLIT):
            good = propose_split_in_middle(mesh, rows, limits, r, t, code // 4, code % 4)
            a, b = mesh.cells[t, code // 4], mesh.cells[t, code % 4]
            urgency = distance(mesh, a, b) / (wanted(mesh, a, b) * limits[SPACING])
        elif ti.static(task == SMOOTH):
            good = propose_smoothing(mesh, rows, limits, r, t)
        else:
            good = propose_relabelling(mesh, rows, fields, limits, r, t)
        rows.real[r, URGENCY] = urgency
        if not good:
            rows.row[r, KIND] = NONE
            tried[t] |= 1 << task


@kernel
def propose_moves(mesh: Simplices, moves: Ints2, sites: Reals2, rows: Proposals, insert: Template, serial: Template):
    """Rows that take the particles moves[m, 0] out, or ``insert`` one at sites[m], on an edge from moves[m, 1].

    [CELL] of row m is a cell at this particle.
    """
    ti.loop_config(serialize=serial)
    for r in range(moves.shape[0]):
        rows.row[r, KIND], rows.real[r, URGENCY] = NONE, 1.0
        if rows.row[r, CELL] >= 0:
            if ti.static(insert):
                place = ti.Vector([sites[r, k] for k in ti.static(range(mesh.dim))])
                propose_insertion(mesh, rows, r, rows.row[r, CELL], moves[r, 1], place)
            else:
                propose_removal(mesh, rows, r, rows.row[r, CELL], moves[r, 0])


@ti.func
def tie_of(mesh: Template, rows: Template, r):
    """Tie-break between proposals that are as urgent: the place of the cell that proposes."""
    place = 0.0
    for i in ti.static(range(mesh.dim + 1)):
        y = position(mesh, mesh.cells[rows.row[r, CELL], i])
        for k in ti.static(range(mesh.dim)):
            place += ti.static(DIRECTION[k]) * y[k]
    return whole_place(place, r)


@ti.func
def is_claimed(mesh: Template, rows: Template, claim: Template, r, value):
    """Whether all particles of the cavity of row r are claimed by this value."""
    good = True
    for m in range(rows.row[r, COUNT]):
        for i in ti.static(range(mesh.dim + 1)):
            if claim[mesh.cells[in_cavity(rows, r, m), i]] != value:
                good = False
    return good


@kernel
def stake(mesh: Simplices, rows: Proposals, urgency: Longs1, tie: Longs1, count: ti.i32, serial: Template):
    """[WON] 1 for the rows that have all particles of their cavities; urgency and tie (N,) are for claims.

    Loops are flat: the software driver of Vulkan ends inner loops that have atomic operations on 64 bits in them.
    """
    ti.loop_config(serialize=serial)
    for p in range(urgency.shape[0]):
        urgency[p], tie[p] = ti.i64(0), ti.i64(0)
    ti.loop_config(serialize=serial)
    for k in range(count * MOST):
        r, m = k // MOST, k % MOST
        if rows.row[r, KIND] != NONE:
            if m < rows.row[r, COUNT]:
                for i in ti.static(range(mesh.dim + 1)):
                    p = mesh.cells[in_cavity(rows, r, m), i]
                    raise_to(urgency, p, whole_urgency(rows.real[r, URGENCY]), serial)
    ti.loop_config(serialize=serial)
    for r in range(count):
        first = 0
        if rows.row[r, KIND] != NONE:
            if is_claimed(mesh, rows, urgency, r, whole_urgency(rows.real[r, URGENCY])):
                first = 1
        rows.row[r, FIRST] = first
    ti.loop_config(serialize=serial)
    for k in range(count * MOST):
        r, m = k // MOST, k % MOST
        if rows.row[r, FIRST] == 1:
            if m < rows.row[r, COUNT]:
                for i in ti.static(range(mesh.dim + 1)):
                    raise_to(tie, mesh.cells[in_cavity(rows, r, m), i], tie_of(mesh, rows, r), serial)
    ti.loop_config(serialize=serial)
    for r in range(count):
        won = 0
        if rows.row[r, FIRST] == 1:
            if is_claimed(mesh, rows, tie, r, tie_of(mesh, rows, r)):
                won = 1
        rows.row[r, WON] = won


@ti.func
def is_refilled(rows: Template, r):
    """Whether row r has new cells."""
    return rows.row[r, KIND] == SWAP or rows.row[r, KIND] == SPLIT


@kernel
def allot(mesh: Simplices, rows: Proposals, is_new: Flags1, touched: Flags1, free: Ints1, total: Ints1, count: ti.i32):
    """Allot to winners the lowest unused cells, listed in ``free``, and particles, which ``is_new`` marks.

    ``touched`` (M,) marks their cells, old and new, and those beside. total (6,): winners, those that are refilled,
    cells and particles that are wanted, and those that there are; nothing is marked if these are too few.
    """
    ti.loop_config(serialize=True)
    for _ in range(1):
        won, refilled, more, splits = 0, 0, 0, 0
        at, given = 0, 0
        for r in range(count):
            if rows.row[r, WON] == 1:
                won += 1
                rows.row[r, FREE_CELL] = more
                if is_refilled(rows, r):
                    refilled += 1
                    more += ti.max(rows.row[r, FILLED] - rows.row[r, COUNT], 0)
                if rows.row[r, KIND] == SPLIT:
                    splits += 1
                    while at < mesh.marks.shape[0] and mesh.marks[ti.min(at, mesh.marks.shape[0] - 1)] != 0:
                        at += 1
                    rows.row[r, NEW_PARTICLE] = at
                    given += ti.select(at < mesh.marks.shape[0], 1, 0)
                    at += 1
        cells, t = 0, 0
        while cells < more and t < mesh.label.shape[0]:
            if mesh.label[t] < 0:
                free[cells] = t
                cells += 1
            t += 1
        total[0], total[1], total[2], total[3], total[4], total[5] = won, refilled, more, splits, cells, given
        if cells == more and given == splits:
            for k in range(more):
                touched[free[k]] = 1
            for r in range(count):
                if rows.row[r, WON] == 1:
                    if rows.row[r, KIND] == SPLIT:
                        is_new[rows.row[r, NEW_PARTICLE]] = 1
                    for m in range(rows.row[r, COUNT]):
                        c = in_cavity(rows, r, m)
                        touched[c] = 1
                        for i in range(mesh.dim + 1):
                            if mesh.across[c, i] >= 0:
                                touched[mesh.across[c, i]] = 1


@ti.func
def refill(mesh: Template, rows: Template, free: Template, tried: Template, r):
    """Put the new cells of row r in the place of its old ones, and list the faces around them for `link`."""
    count, filled, outers = rows.row[r, COUNT], rows.row[r, FILLED], 0
    for m in range(count):
        c = in_cavity(rows, r, m)
        for i in ti.static(range(mesh.dim + 1)):
            o = mesh.across[c, i]
            if not is_in(rows, r, count, o):
                for w in ti.static(range(mesh.dim)):
                    rows.row[r, OUTER + 4 * outers + w] = mesh.cells[c, w + ti.static(1 if w >= i else 0)]
                rows.row[r, OUTER + 4 * outers + mesh.dim] = o
                outers += 1
    for m in range(filled):
        c = in_cavity(rows, r, ti.min(m, count - 1))
        if m >= count:
            c = free[rows.row[r, FREE_CELL] + m - count]
        rows.row[r, SLOT + m] = c
        for i in ti.static(range(mesh.dim + 1)):
            if rows.row[r, NEW + 4 * m + i] == LATER:
                rows.row[r, NEW + 4 * m + i] = rows.row[r, NEW_PARTICLE]
            mesh.cells[c, i] = rows.row[r, NEW + 4 * m + i]
        mesh.label[c] = rows.row[r, NEW_LABEL + m]
        tried[c] = 0
    for m in range(filled, count):
        mesh.label[in_cavity(rows, r, m)] = -1
    rows.row[r, OUTERS] = outers


@ti.func
def along_edge(mesh: Template, rows: Template, fields: Template, r, to):
    """Fields of particle ``to`` where the place of row r is, along the edge P-Q."""
    p, q = rows.row[r, P], rows.row[r, Q]
    side = position(mesh, q) - position(mesh, p)
    part = side.dot(place_of(mesh, rows, r) - position(mesh, p)) / (side.norm_sqr() + 1e-300)
    part = ti.min(ti.max(part, 0.0), 1.0)
    if not (to == q and has_mark(mesh, q, FIXED)):
        for k in range(fields.shape[1]):
            fields[to, k] = (1.0 - part) * fields[p, k] + part * fields[q, k]


@ti.func
def interpolate(mesh: Template, rows: Template, fields: Template, r, p):
    """Fields of particle p where it will be, from the cell of row r that is there, or nearest."""
    place, best, pick = place_of(mesh, rows, r), -1e30, in_cavity(rows, r, 0)
    for m in range(rows.row[r, COUNT]):
        c, low = in_cavity(rows, r, m), 1e30
        for i in ti.static(range(mesh.dim + 1)):
            low = ti.min(low, share(mesh, c, i, place))
        if low > best:
            best, pick = low, c
    for k in range(fields.shape[1]):
        value = 0.0
        for i in ti.static(range(mesh.dim + 1)):
            value += share(mesh, pick, i, place) * fields[mesh.cells[pick, i], k]
        fields[p, k] = value


@ti.func
def share(mesh: Template, c, i, place):
    """The shape function of corner i of cell c at a place."""
    return 1.0 + gradient(mesh, c, i).dot(place - position(mesh, mesh.cells[c, i])) / measure(mesh, cell(mesh, c))


@kernel
def apply(mesh: Simplices, tried: Ints1, fields: Reals2, rows: Proposals, free: Ints1, count: ti.i32, serial: Template):
    """Make the changes of the rows that have [WON]; their new cells are cells of ``free`` from [FREE_CELL] on.

    fields (N, K): of the particles; those that are new or moved have the values of the old cells there.
    """
    ti.loop_config(serialize=serial)
    for r in range(count):
        if rows.row[r, WON] == 1:
            for m in range(rows.row[r, COUNT]):
                c = in_cavity(rows, r, m)
                tried[c] &= DONE
                for i in ti.static(range(mesh.dim + 1)):
                    if mesh.across[c, i] >= 0:
                        tried[mesh.across[c, i]] &= DONE
            kind = rows.row[r, KIND]
            if kind == COLLAPSE:
                along_edge(mesh, rows, fields, r, rows.row[r, Q])
                merge(mesh, rows, r)
            elif kind == SMOOTH:
                interpolate(mesh, rows, fields, r, rows.row[r, P])
                for k in ti.static(range(mesh.dim)):
                    mesh.x[rows.row[r, P], k] = rows.real[r, PLACE + k]
            elif kind == LAND:
                land(mesh, rows, r)
            elif kind == RELABEL:
                mesh.label[in_cavity(rows, r, 0)] = rows.row[r, P]
                tried[in_cavity(rows, r, 0)] |= DONE
            else:
                if kind == SPLIT:
                    new, place = rows.row[r, NEW_PARTICLE], place_of(mesh, rows, r)
                    mesh.marks[new] = (
                        USED
                        + MOVES
                        + WALL * rows.row[r, CODE]
                        + (ON if is_interface(mesh, rows, r, rows.row[r, COUNT]) else 0)
                    )
                    mesh.wide[new] = wanted(mesh, rows.row[r, P], rows.row[r, Q])
                    along_edge(mesh, rows, fields, r, new)
                    for k in ti.static(range(mesh.dim)):
                        mesh.x[new, k] = place[k]
                refill(mesh, rows, free, tried, r)


@ti.func
def is_face(c, z, face: Template, dim: Template):
    """Whether face z of a cell of particles c (d + 1,) has these particles (d,)."""
    hits = 0
    for i in ti.static(range(dim + 1)):
        if i != z:
            for k in ti.static(range(dim)):
                hits += ti.select(face[k] == c[i], 1, 0)
    return hits == dim


@ti.func
def boundary_of(mesh: Template, rows: Template, r, face):
    """The face of the boundary that a new face is on: that which is split or swapped, at the edge P-Q; else -1."""
    result = -1
    for w in range(rows.row[r, OUTERS]):
        o, ends, others = rows.row[r, OUTER + 4 * w + mesh.dim], 0, 0
        for b in ti.static(range(mesh.dim)):
            x = rows.row[r, OUTER + 4 * w + b]
            if x == rows.row[r, P] or x == rows.row[r, Q]:
                ends += 1
            else:
                for a in ti.static(range(mesh.dim)):
                    others += ti.select(x == face[a], 1, 0)
        if o < -1 and ends == 2 and others == mesh.dim - 2:
            result = o
    return result


@kernel
def link(mesh: Simplices, rows: Proposals, count: ti.i32, serial: Template):
    """Join the faces of new cells with each other, or with the cells around their cavity."""
    ti.loop_config(serialize=serial)
    for k in range(count * FILLED_MOST):
        r, m = k // FILLED_MOST, k % FILLED_MOST
        if rows.row[r, WON] == 1 and is_refilled(rows, r) and m < rows.row[r, FILLED]:
            c, new = rows.row[r, SLOT + m], new_cell(mesh, rows, r, m)
            for i in ti.static(range(mesh.dim + 1)):
                face = ti.Vector([new[a + ti.static(1 if a >= i else 0)] for a in ti.static(range(mesh.dim))])
                to, out = -1, -1
                for w in range(rows.row[r, OUTERS]):
                    hits = 0
                    for a in ti.static(range(mesh.dim)):
                        for b in ti.static(range(mesh.dim)):
                            hits += ti.select(rows.row[r, OUTER + 4 * w + b] == face[a], 1, 0)
                    if hits == mesh.dim:
                        to = rows.row[r, OUTER + 4 * w + mesh.dim]
                        out = to
                if to == -1:
                    to = boundary_of(mesh, rows, r, face)
                for w in range(rows.row[r, FILLED]):
                    hits = 0
                    for z in ti.static(range(mesh.dim + 1)):
                        for a in ti.static(range(mesh.dim)):
                            hits += ti.select(rows.row[r, NEW + 4 * w + z] == face[a], 1, 0)
                    if hits == mesh.dim and w != m:
                        to = rows.row[r, SLOT + w]
                mesh.across[c, i] = to
                if out >= 0:
                    beyond = cell(mesh, out)
                    for z in ti.static(range(mesh.dim + 1)):
                        if is_face(beyond, z, face, mesh.dim):
                            mesh.across[out, z] = c
