"""Kernels of particles on interfaces and their copies, see `tipfem.physics.side_pressures.term`.

``ties`` has the tied particles and their copies as in `tipfem.linalg.multigrid.mesh_transfer`.
"""

from typing import NamedTuple

import taichi as ti

from tipfem.backend.array_types import Flags1, Ints1, Ints2, Periods, Reals1, Reals2, Template
from tipfem.backend.launch import kernel
from tipfem.backend.periodic import difference, radius
from tipfem.fem.bundles import Topology
from tipfem.linalg.multigrid.mesh_transfer import copies_of, tied_node
from tipfem.linalg.sparsity import Csr, find_column

TIE = 10.0  # nanoseconds of one thread for a tied particle
SLOPES = 500.0  # and for one in `list_slopes`
ADDED_ROW = 10.0  # and for a node in `count_added` and `add_products`


class Slopes(NamedTuple):
    """Lists of the tied particles, see `list_slopes`."""

    starts: "Ints1"
    ends: "Ints1"
    node: "Ints2"
    tie: "Ints1"
    slope: "Reals2"


class Sides(NamedTuple):
    """Fluids at the particles: at (F, N) is negative where one is not; the heaviest (N,); densities (F,)."""

    at: "Ints2"
    heaviest: "Ints1"
    density: "Reals1"


class Found(NamedTuple):
    """Scratch (F N,) of `extend_pressures`, but for ``flag``."""

    total: "Reals1"
    summed: "Reals1"
    flag: "Flags1"


@kernel
def label_tied(component: Ints1, diagonal: Reals1, tied: Flags1, label: Ints1):
    """Components (P,) of nodes, -1 for those without a node where ``diagonal`` is positive; tied (K,) begins as 0."""
    ti.loop_config(serialize=True)
    for i in range(label.shape[0]):
        if diagonal[i] > 0.0:
            tied[component[i]] = ti.cast(1, ti.i8)
    ti.loop_config(serialize=True)
    for i in range(label.shape[0]):
        label[i] = component[i] if tied[component[i]] else -1


@kernel
def join_scales(ties: Ints1, scale: Reals1, count: ti.i32, dim: Template, serial: Template):
    """The scale of the momentum rows of ``count`` tied particles and their copies: one over the sum of 1 / scale.

    Rows of particles whose displacement is prescribed have the scale 0, and keep it.
    """
    ti.loop_config(serialize=serial)
    for t in range(count):
        first, last = copies_of(ties, t)
        for k in ti.static(range(dim)):
            own = tied_node(ties, t) * (dim + 1) + k
            if scale[own] > 0.0:
                diagonal = 1.0 / scale[own]
                for j in range(first, last):
                    diagonal += 1.0 / scale[j * (dim + 1) + k]
                scale[own] = 1.0 / diagonal


@kernel
def copy_scales(ties: Ints1, scale: Reals1, count: ti.i32, dim: Template, serial: Template):
    """Copy the scale of the particles' momentum rows to those of their copies."""
    ti.loop_config(serialize=serial)
    for t in range(count):
        first, last = copies_of(ties, t)
        for j in range(first, last):
            for k in ti.static(range(dim)):
                scale[j * (dim + 1) + k] = scale[tied_node(ties, t) * (dim + 1) + k]


@kernel
def count_slopes(ties: Ints1, offsets: Ints1, counts: Ints1, count: ti.i32, dim: Template, serial: Template):
    """counts[t + 1] (T + 1,): the length of the list of tied particle t in `list_slopes`; counts[0] = 0."""
    ti.loop_config(serialize=serial)
    for t in range(count):
        if t == 0:
            counts[0] = 0
        first, last = copies_of(ties, t)
        own = tied_node(ties, t)
        counts[t + 1] = (dim + 1) * (offsets[own + 1] - offsets[own] + offsets[last] - offsets[first])


@ti.func
def volume_slope(cells: Template, motion: Template, period: Template, e, own, i, dim: Template):
    """(d,) derivative of a corner's part of the volume of cell e by the place of its corner ``own``, node i."""
    a, b = cells[e, (own + 1) % (dim + 1)], cells[e, (own + 2) % (dim + 1)]
    v = ti.Vector.zero(ti.f64, dim)
    if ti.static(dim == 2):
        # Half the opposite side, turned by a right angle; a third for each node.
        v = ti.Vector([-difference(motion, period, b, a, 1), difference(motion, period, b, a, 0)]) / 6.0
        if ti.static(len(period.shape) == 3):
            area = 0.5 * (
                difference(motion, period, a, i, 0) * difference(motion, period, b, i, 1)
                - difference(motion, period, a, i, 1) * difference(motion, period, b, i, 0)
            )
            v *= (radius(motion, period, i) + radius(motion, period, a) + radius(motion, period, b)) / 3.0
            v[0] += 2.0 * ti.math.pi / 9.0 * area
    else:
        # A third of the opposite face, whose corners follow each other as the parity of ``own`` says; a quarter.
        c = cells[e, (own + 3) % 4]
        one = ti.Vector([difference(motion, period, b, a, k) for k in ti.static(range(3))])
        other = ti.Vector([difference(motion, period, c, a, k) for k in ti.static(range(3))])
        v = one.cross(other) / ti.select(own % 2 == 0, -24.0, 24.0)
    return v


@kernel
def list_slopes(
    ties: Ints1,
    mesh: Topology,
    motion: Reals2,
    period: Periods,
    scale: Reals1,
    slides: Ints1,
    projectors: Reals2,
    lists: Slopes,
    count: ti.i32,
    dim: Template,
    serial: Template,
):
    """diag(A)^(-1/2) B_k of each tied particle for the nodes k of the cells around it, see `SidePressures`.

    The lists of particle t are starts[t]:ends[t] of ``node`` (., 1), of ``tie``, which is t, and of ``slope`` (., d);
    from there to starts[t + 1] ``node`` is -1. slides (T,): the row of ``projectors`` (K, d^2) of the tied
    particles that slide, -1 for the others.
    """
    ti.loop_config(serialize=serial)
    for t in range(count):
        first, last = copies_of(ties, t)
        end = lists.starts[t]
        for j in range(first - 1, last):
            i = tied_node(ties, t) if j < first else j
            for c in range(mesh.offsets[i], mesh.offsets[i + 1]):
                e = mesh.corners[c] // (dim + 1)
                own = mesh.corners[c] - (dim + 1) * e
                v = volume_slope(mesh.cells, motion, period, e, own, i, dim)
                s = slides[t]
                if s >= 0:
                    along = v
                    for k in ti.static(range(dim)):
                        v[k] = 0.0
                        for m in ti.static(range(dim)):
                            v[k] += projectors[s, dim * k + m] * along[m]
                for k in ti.static(range(dim)):
                    v[k] *= ti.sqrt(scale[(dim + 1) * tied_node(ties, t) + k])
                for q in ti.static(range(dim + 1)):
                    n, at = mesh.cells[e, q], lists.starts[t]
                    while at < end and lists.node[at, 0] != n:
                        at += 1
                    if at == end:
                        lists.node[at, 0], lists.tie[at] = n, t
                        for k in ti.static(range(dim)):
                            lists.slope[at, k] = 0.0
                        end += 1
                    for k in ti.static(range(dim)):
                        lists.slope[at, k] = lists.slope[at, k] + v[k]
        lists.ends[t] = end
        for at in range(end, lists.starts[t + 1]):
            lists.node[at, 0] = -1


@ti.func
def _is_new(starts: Template, ends: Template, node: Template, tie: Template, first, c, entries: Template, n):
    """Whether none of the tied particles of entries[first:c] has node ``n`` in its list."""
    new = True
    for b in range(first, c):
        t = tie[entries[b]]
        for s in range(starts[t], ends[t]):
            if node[s, 0] == n:
                new = False
    return new


@kernel
def count_added(
    starts: Ints1,
    ends: Ints1,
    node: Ints2,
    tie: Ints1,
    heads: Ints1,
    entries: Ints1,
    counts: Ints1,
    nodes: ti.i32,
    serial: Template,
):
    """counts[i + 1] (P + 1,): number of columns of row i of the matrix of `add_products`; counts[0] = 0.

    The entries of each node in the lists of `list_slopes`, in ascending order: heads[i]:heads[i + 1] of ``entries``.
    """
    ti.loop_config(serialize=serial)
    for i in range(nodes):
        number = 0
        for c in range(heads[i], heads[i + 1]):
            t = tie[entries[c]]
            for s in range(starts[t], ends[t]):
                number += ti.cast(_is_new(starts, ends, node, tie, heads[i], c, entries, node[s, 0]), ti.i32)
        counts[i + 1] = number
        if i == 0:
            counts[0] = 0


@kernel
def add_products(
    lists: Slopes,
    heads: Ints1,
    entries: Ints1,
    matrix: Csr,
    diagonal: Reals1,
    nodes: ti.i32,
    dim: Template,
    serial: Template,
):
    """The matrix of the sums over the tied particles of the products of the nodes' slopes, and its diagonal (P,)."""
    ti.loop_config(serialize=serial)
    for i in range(nodes):
        end, square = matrix.row_offsets[i], 0.0
        for c in range(heads[i], heads[i + 1]):
            e = entries[c]
            for s in range(lists.starts[lists.tie[e]], lists.ends[lists.tie[e]]):
                at = find_column(matrix.columns, matrix.row_offsets[i], end, lists.node[s, 0])
                if at == end:
                    matrix.columns[at], matrix.values[at] = lists.node[s, 0], 0.0
                    end += 1
                product = lists.slope[e, 0] * lists.slope[s, 0]
                for k in ti.static(range(1, dim)):
                    product += lists.slope[e, k] * lists.slope[s, k]
                matrix.values[at] = matrix.values[at] + product
            own = lists.slope[e, 0] ** 2
            for k in ti.static(range(1, dim)):
                own += lists.slope[e, k] ** 2
            square += own
        diagonal[i] = square


KNOWN, MISSING, FOUND = 1, 2, 3  # of a fluid at a particle in `extend_pressures`; 0 where it is not


@kernel
def extend_pressures(
    cells: Ints2,
    fluid: Ints1,
    position: Reals2,
    period: Periods,
    sides: Sides,
    acceleration: Reals2,
    sweeps: ti.i32,
    found: Found,
    side: Reals2,
    carried: Reals1,
    dim: Template,
):
    """See `tipfem.physics.side_pressures.carried.pressures_on_sides`.

    Before, side (F, N) has the pressures of the fluids where ``flag`` (F N,) says that they are known, and carried (N,)
    those of the particles; afterwards carried those of the ``heaviest`` (N,) fluids, and side the others less these.
    at (F, N): negative where a fluid is not.
    """
    ti.loop_config(serialize=True)
    for _ in range(1):
        n, fluids, missing = sides.heaviest.shape[0], sides.density.shape[0], 0
        for f in range(fluids):
            for i in range(n):
                if sides.at[f, i] < 0:
                    found.flag[f * n + i] = 0
                elif found.flag[f * n + i] == 0:
                    found.flag[f * n + i] = MISSING
                    missing += 1
        sweep = 0
        while missing > 0 and sweep < sweeps:
            for c in range(cells.shape[0]):
                for i in ti.static(range(dim + 1)):
                    f, a = fluid[c], cells[c, i]
                    if found.flag[f * n + a] >= MISSING:
                        for j in ti.static([(i + k) % (dim + 1) for k in range(1, dim + 1)]):
                            b = cells[c, j]
                            if found.flag[f * n + b] == KNOWN:
                                rise = difference(position, period, a, b, 0) * acceleration[b, 0]
                                for k in ti.static(range(1, dim)):
                                    rise += difference(position, period, a, b, k) * acceleration[b, k]
                                if found.flag[f * n + a] == MISSING:
                                    found.flag[f * n + a] = FOUND
                                    found.total[f * n + a], found.summed[f * n + a] = 0.0, 0.0
                                found.total[f * n + a] += side[f, b] + sides.density[f] * rise
                                found.summed[f * n + a] += 1.0
            for f in range(fluids):
                for i in range(n):
                    if found.flag[f * n + i] == FOUND:
                        found.flag[f * n + i] = KNOWN
                        side[f, i] = found.total[f * n + i] / found.summed[f * n + i]
                        missing -= 1
            sweep += 1
        for i in range(n):
            anything = 0
            for f in range(fluids):
                anything += found.flag[f * n + i] == KNOWN
            if anything:
                carried[i] = side[sides.heaviest[i], i]
            for f in range(fluids):
                side[f, i] = side[f, i] - carried[i] if sides.at[f, i] >= 0 else 0.0
