"""Kernels that eliminate displacements which follow others, see `tipfem.fem.condensation`.

Follower number f is node ``node[f]``; its entries e = starts[f] ... starts[f + 1] - 1 name nodes ``parent[e]`` and the
matrices ``row[e]`` and ``column[e]``, (d * d,) row by row. The first ``own`` followers follow themselves alone, those
up to ``partly`` themselves and others. Vectors of unknowns are laid out as in `tipfem.fem.residual`, matrices as in
`tipfem.fem.jacobian`.
"""

from typing import NamedTuple

import taichi as ti

from tipfem.backend.array_types import Ints1, Ints2, Reals1, Reals2, Template
from tipfem.backend.launch import kernel
from tipfem.fem.jacobian import block_entry
from tipfem.fem.residual import displacement_of
from tipfem.linalg.sparsity import Csr, find_column, insertion_sort

# Nanoseconds of one thread for a follower in `spread` and `collect`, for a row and for a parent's row in `condense`.
FOLLOWER, ROW, PARENT = 15.0, 25.0, 300.0


class Parents(NamedTuple):
    """Parent number g is nodes[g]; its entries, of the nodes ``of``, are entry[lists[g]:lists[g + 1]]."""

    nodes: "Ints1"
    lists: "Ints1"
    entry: "Ints1"
    of: "Ints1"


class Counts(NamedTuple):
    """Numbers: the first ``partly`` followers follow themselves, too, and the first ``others`` parents do not."""

    partly: "int"
    followers: "int"
    others: "int"
    parents: "int"


@kernel
def count_relations(owner: Ints1, given: Ints1, parent: Ints1, first: Ints1, length: Ints1, itself: Ints1) -> ti.i32:
    """Count the relations of all P nodes, copies included.

    ``length`` (P,): how many each node has; ``first`` (P,): the first of these in the given lists (K,) of nodes and
    ``parent``, for a copy those of its ``owner``, -1 for a copy of a free node, which follows that one; ``itself``
    (P,): whether it follows itself, too.
    """
    ti.loop_config(serialize=True)
    for i in range(owner.shape[0]):
        first[i], length[i], itself[i] = -1, 0, 0
    total = given.shape[0]
    ti.loop_config(serialize=True)
    for _ in range(1):
        for e in range(given.shape[0]):
            i = given[e]
            if length[i] == 0:
                first[i] = e
            length[i] = length[i] + 1
            if parent[e] == i:
                itself[i] = 1
        for i in range(owner.shape[0]):
            if owner[i] != i:
                first[i], length[i] = first[owner[i]], ti.max(length[owner[i]], 1)
                total += length[i]
    return total


@kernel
def list_relations(
    owner: Ints1,
    given: Ints1,
    first: Ints1,
    length: Ints1,
    itself: Ints1,
    followers: Ints2,
    relations: Ints2,
    counts: Ints1,
):
    """The followers and their relations, by node and by parent.

    ``owner``, ``first``, ``length`` and ``itself`` (P,) as in `count_relations`; ``given`` (K,) are parents. Found are

    - ``followers`` (6, P + 1): number of each node, -1 for none; the followers; their starts; all parents, first those
      that do not follow themselves; the starts of their lists; and scratch;
    - ``relations`` (5, E): node, parent and number in the given lists of each, -1 for none; and by parent the relation
      and its node. Of a node or a parent, that with itself comes first;
    - ``counts`` (5,): followers that follow themselves alone, all that follow themselves, all; parents that do not
      follow themselves, and all.
    """
    ti.loop_config(serialize=True)
    for i in range(owner.shape[0]):
        followers[0, i], followers[5, i] = -1, 0
    ti.loop_config(serialize=True)
    for _ in range(1):
        nodes = owner.shape[0]
        f, e = 0, 0
        for kind in range(3):
            for i in range(nodes):
                own = ti.select(itself[i] == 0, 2, ti.select(length[i] == 1, 0, 1))
                if length[i] > 0 and own == kind:
                    followers[0, i], followers[1, f], followers[2, f] = f, i, e
                    f += 1
                    for other in range(2):
                        for j in range(length[i]):
                            source = ti.select(first[i] < 0, -1, first[i] + j)
                            parent = owner[i]
                            if source >= 0:
                                parent = given[source]
                            if (parent != i) == (other == 1):
                                relations[0, e], relations[1, e], relations[2, e] = i, parent, source
                                e += 1
            counts[kind] = f
        followers[2, f] = e
        for k in range(e):
            followers[5, relations[1, k]] = followers[5, relations[1, k]] + 1
        q, at = 0, 0
        for kind in range(2):
            for i in range(nodes):
                size = followers[5, i]
                if size > 0 and itself[i] == kind:
                    followers[3, q], followers[4, q], followers[5, i] = i, at, at
                    q += 1
                    at += size
            counts[3 + kind] = q
        followers[4, q] = at
        for other in range(2):
            for i in range(nodes):
                if followers[0, i] >= 0:
                    for k in range(followers[2, followers[0, i]], followers[2, followers[0, i] + 1]):
                        parent = relations[1, k]
                        if (parent != i) == (other == 1):
                            place = followers[5, parent]
                            relations[3, place], relations[4, place] = k, i
                            followers[5, parent] = place + 1


@kernel
def take_matrices(source: Ints1, given: Reals2, taken: Reals2, dim: Template):
    """Take matrices of relations (E,): those of number ``source`` among ``given`` (K, d * d), or else the unit."""
    ti.loop_config(serialize=True)
    for e in range(source.shape[0]):
        for k in range(given.shape[1]):
            taken[e, k] = 0.0
            if source[e] >= 0:
                taken[e, k] = given[source[e], k]
            elif k % (dim + 1) == 0:
                taken[e, k] = 1.0


@ti.func
def apply(matrix: Template, e, u, transposed: Template):
    """Matrix ``e`` times u (d,), or its transpose times u."""
    dim = ti.static(u.n)
    result = ti.Vector.zero(float, dim)
    for k in ti.static(range(dim)):
        for m in ti.static(range(dim)):
            if ti.static(transposed):
                result[k] += matrix[e, m * dim + k] * u[m]
            else:
                result[k] += matrix[e, k * dim + m] * u[m]
    return result


@ti.func
def spread_to(node: Template, starts: Template, parent: Template, column: Template, x: Template, f, dim: Template):
    """The displacement of follower ``f`` in ``x`` by those of its parents."""
    u = ti.Vector.zero(float, dim)
    for e in range(starts[f], starts[f + 1]):
        u += apply(column, e, displacement_of(x, parent[e], dim), False)
    for k in ti.static(range(dim)):
        x[node[f] * (dim + 1) + k] = u[k]


@kernel
def spread(
    node: Ints1,
    starts: Ints1,
    parent: Ints1,
    column: Reals2,
    x: Reals1,
    own: ti.i32,
    partly: ti.i32,
    count: ti.i32,
    dim: Template,
    serial: Template,
):
    """x = R x: the displacements of ``count`` followers by those of their parents."""
    ti.loop_config(serialize=serial)
    for f in range(own):
        spread_to(node, starts, parent, column, x, f, dim)
    ti.loop_config(serialize=serial)
    for f in range(own, partly):
        spread_to(node, starts, parent, column, x, f, dim)
    ti.loop_config(serialize=serial)
    for f in range(partly, count):
        spread_to(node, starts, parent, column, x, f, dim)


@ti.func
def collect_at(by_parent: Template, row: Template, x: Template, g, dim: Template):
    """Add the rows of followers in ``x`` to those of parent number ``g``, see `collect`."""
    m = by_parent.nodes[g]
    total = displacement_of(x, m, dim)
    first = by_parent.lists[g]
    if by_parent.of[first] == m:
        total = apply(row, by_parent.entry[first], total, True)
        first += 1
    for s in range(first, by_parent.lists[g + 1]):
        total += apply(row, by_parent.entry[s], displacement_of(x, by_parent.of[s], dim), True)
    for k in ti.static(range(dim)):
        x[m * (dim + 1) + k] = total[k]


@kernel
def collect(by_parent: Parents, node: Ints1, row: Reals2, x: Reals1, counts: Counts, dim: Template, serial: Template):
    """x = L^T x: momentum rows of followers are added to those of their parents, and made zero.

    Where a parent follows itself, that entry is the first. The first ``others`` parents do not: these need the rows of
    those that do as they were.
    """
    ti.loop_config(serialize=serial)
    for g in range(counts.others):
        collect_at(by_parent, row, x, g, dim)
    ti.loop_config(serialize=serial)
    for g in range(counts.others, counts.parents):
        collect_at(by_parent, row, x, g, dim)
    ti.loop_config(serialize=serial)
    for f in range(counts.partly, counts.followers):
        for k in ti.static(range(dim)):
            x[node[f] * (dim + 1) + k] = 0.0


@kernel
def condense_columns(
    follower: Ints1,
    starts: Ints1,
    parent: Ints1,
    column: Reals2,
    matrix: Csr,
    nodes: ti.i32,
    dim: Template,
    full: Template,
    serial: Template,
):
    """K = K R in place, of a matrix whose rows have the columns of the parents; columns of pressure stay.

    ``follower`` (N,) is the number of each node among the followers, -1 for others. Momentum by displacement is left
    as it is unless ``full``.
    """
    ti.loop_config(serialize=serial)
    for i in range(nodes):
        first, last, couplings = matrix.row_offsets[i], matrix.row_offsets[i + 1], matrix.row_offsets[nodes]
        for s in range(first, last):
            f = follower[matrix.columns[s]]
            if f >= 0:
                old = ti.Matrix.zero(float, dim + 1, dim)
                for k in ti.static(range(0 if full else dim, dim + 1)):
                    for m in ti.static(range(dim)):
                        at = block_entry(couplings, s, k, m, dim)
                        old[k, m] = matrix.values[at]
                        matrix.values[at] = 0.0
                for e in range(starts[f], starts[f + 1]):
                    t = s if parent[e] == matrix.columns[s] else find_column(matrix.columns, first, last, parent[e])
                    for k in ti.static(range(0 if full else dim, dim + 1)):
                        along = ti.Vector([old[k, m] for m in ti.static(range(dim))])
                        new = apply(column, e, along, True)
                        for m in ti.static(range(dim)):
                            at = block_entry(couplings, t, k, m, dim)
                            matrix.values[at] = matrix.values[at] + new[m]


@ti.func
def condense_row(by_parent: Template, row: Template, matrix: Template, nodes, g, dim: Template, full: Template):
    """The row of parent number ``g`` in `condense_rows`."""
    m, couplings = by_parent.nodes[g], matrix.row_offsets[nodes]
    begin, end, start = matrix.row_offsets[m], matrix.row_offsets[m + 1], by_parent.lists[g]
    if by_parent.of[start] == m:
        for s in range(begin, end):
            for c in ti.static(range(0 if full else dim, dim + 1)):
                old = ti.Vector([matrix.values[block_entry(couplings, s, k, c, dim)] for k in ti.static(range(dim))])
                new = apply(row, by_parent.entry[start], old, True)
                for k in ti.static(range(dim)):
                    matrix.values[block_entry(couplings, s, k, c, dim)] = new[k]
        start += 1
    for q in range(start, by_parent.lists[g + 1]):
        i = by_parent.of[q]
        for s in range(matrix.row_offsets[i], matrix.row_offsets[i + 1]):
            t = find_column(matrix.columns, begin, end, matrix.columns[s])
            if t < end:
                for c in ti.static(range(0 if full else dim, dim + 1)):
                    old = ti.Vector(
                        [matrix.values[block_entry(couplings, s, k, c, dim)] for k in ti.static(range(dim))]
                    )
                    new = apply(row, by_parent.entry[q], old, True)
                    for k in ti.static(range(dim)):
                        at = block_entry(couplings, t, k, c, dim)
                        matrix.values[at] = matrix.values[at] + new[k]


@kernel
def condense_rows(
    by_parent: Parents,
    node: Ints1,
    row: Reals2,
    matrix: Csr,
    nodes: ti.i32,
    counts: Counts,
    dim: Template,
    full: Template,
    serial: Template,
):
    """K = L^T K in place, of a matrix whose parents' rows have the columns of the followers'; see `collect`.

    Momentum by displacement is left as it is unless ``full``.
    """
    blocks = ti.static(matrix.values)
    ti.loop_config(serialize=serial)
    for g in range(counts.others):
        condense_row(by_parent, row, matrix, nodes, g, dim, full)
    ti.loop_config(serialize=serial)
    for g in range(counts.others, counts.parents):
        condense_row(by_parent, row, matrix, nodes, g, dim, full)
    ti.loop_config(serialize=serial)
    for f in range(counts.partly, counts.followers):
        i, couplings = node[f], matrix.row_offsets[nodes]
        for s in range(matrix.row_offsets[i], matrix.row_offsets[i + 1]):
            for k in ti.static(range(dim)):
                for c in ti.static(range(0 if full else dim, dim + 1)):
                    blocks[block_entry(couplings, s, k, c, dim)] = 0.0


@ti.func
def insert_pair(table: Template, count: Template, i, j):
    """Put the pair (i, j) into a hash table, if it is not there, and count it as one of i."""
    last = table.shape[0] - 1
    at = (i * 73856093 ^ j * 19349663) & last
    while table[at, 0] >= 0 and (table[at, 0] != i or table[at, 1] != j):
        at = (at + 1) & last
    if table[at, 0] < 0:
        table[at, 0], table[at, 1] = i, j
        count[i + 1] += 1


@ti.func
def node_or_parent(k, node, follower: Template, starts: Template, parent: Template):
    """The node (k = 0), or the k-th that it follows."""
    found = node
    if k > 0:
        found = parent[starts[follower[node]] + k - 1]
    return found


@kernel
def list_followers(cells: Ints2, follower: Ints1, own: ti.i32, near: Ints1) -> ti.i32:
    """The cells (M, d + 1) with a node whose number as a ``follower`` (P,) is ``own`` or more; how many there are."""
    count = 0
    ti.loop_config(serialize=True)
    for c in range(cells.shape[0]):
        there = False
        for k in range(cells.shape[1]):
            there = there or follower[cells[c, k]] >= own
        if there:
            near[count] = c
            count += 1
    return count


@kernel
def list_couplings(
    near: Ints2,
    follower: Ints1,
    starts: Ints1,
    parent: Ints1,
    one: Ints1,
    other: Ints1,
    table: Ints2,
    cursor: Ints1,
    offsets: Ints1,
    columns: Ints1,
    own: ti.i32,
):
    """Columns in CSR, ascending, of what followers in the cells ``near`` (K, d + 1) couple, and of pairs (one, other).

    ``follower`` (P,): their numbers, -1 for others. ``cursor`` and ``offsets`` (P + 1,) are zero; ``table`` (S, 2), of
    a size that is a power of two and more than all these pairs, is scratch.
    """
    ti.loop_config(serialize=True)
    for s in range(table.shape[0]):
        table[s, 0] = -1
    ti.loop_config(serialize=True)
    for _ in range(1):
        for c in range(near.shape[0]):
            for p in range(near.shape[1]):
                i = near[c, p]
                for q in range(near.shape[1]):
                    j = near[c, q]
                    if follower[i] >= own or follower[j] >= own:
                        rows, more = 1, 1
                        if follower[i] >= 0:
                            rows += starts[follower[i] + 1] - starts[follower[i]]
                        if follower[j] >= 0:
                            more += starts[follower[j] + 1] - starts[follower[j]]
                        for k in range(rows):
                            for m in range(more):
                                a = node_or_parent(k, i, follower, starts, parent)
                                b = node_or_parent(m, j, follower, starts, parent)
                                if a != i or b != j:  # the others are there
                                    insert_pair(table, offsets, a, b)
        for k in range(one.shape[0]):
            insert_pair(table, offsets, one[k], other[k])
        for i in range(follower.shape[0]):
            offsets[i + 1] += offsets[i]
            cursor[i] = offsets[i]
        for s in range(table.shape[0]):
            if table[s, 0] >= 0:
                columns[cursor[table[s, 0]]] = table[s, 1]
                cursor[table[s, 0]] += 1
        for i in range(follower.shape[0]):
            insertion_sort(columns, offsets[i], offsets[i + 1])
