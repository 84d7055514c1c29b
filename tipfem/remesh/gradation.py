"""Kernels for target spacings: what limits their growth from particle to particle, and lowers them in films."""

import taichi as ti

from tipfem.backend.array_types import Ints1, Ints2, Periods, Reals1, Reals2, Template
from tipfem.backend.launch import kernel
from tipfem.backend.periodic import difference
from tipfem.remesh.cavity.arrays import Simplices, cell, gradient, measure

# The edges of a cell, by dimension.
EDGES = {2: ((0, 1), (1, 2), (2, 0)), 3: ((0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3))}
SWEEPS = 100  # far more than needed: one sweep carries targets along many edges
ROUND_OFF = 1e-9
OPPOSITE = -0.9  # cosine of the angle between the two sides of a film, at most


@ti.func
def lower_targets(
    x: Template, cells: Template, period: Template, spacing: Template, lowered: Template, t, growth, now, dim: Template
):
    """Lower the target spacings of cell t until they grow by at most ``growth`` along its edges; 1 if any changed.

    lowered (N,) is set to ``now`` for those that are.
    """
    changed = 0
    for edge in ti.static(EDGES[dim]):
        a, b = cells[t, edge[0]], cells[t, edge[1]]
        if spacing[a] > spacing[b]:
            a, b = b, a
        # Most edges need no change, and for these no square root.
        more = spacing[b] - spacing[a]
        if more > 0:
            square = 0.0
            for k in ti.static(range(dim)):
                square += difference(x, period, b, a, k) ** 2
            if more * more > growth * growth * square:
                highest = spacing[a] + growth * ti.sqrt(square)
                if spacing[b] > highest * (1 + ROUND_OFF):
                    spacing[b] = highest
                    lowered[b] = now
                    changed = 1
    return changed


@kernel
def limit_gradation(
    x: Reals2, cells: Ints2, period: Periods, spacing: Reals1, lowered: Ints1, growth: ti.f64, dim: Template
) -> ti.i32:
    """Lower target ``spacing`` (N,) [m] until it grows by at most ``growth`` along every edge of the cells (M, d + 1).

    Sweeps over the cells, forwards and backwards, until one changes nothing; returns how many it took. x (N, d) [m].
    lowered (N,), zero before: the number of the visit, of all sweeps, in which a target was lowered last. Cells are
    skipped if none of their targets was lowered since their last visit.
    """
    sweeps = 0
    ti.loop_config(serialize=True)
    for sweep in range(SWEEPS):
        if sweeps == sweep:
            elements, changed = cells.shape[0], 0
            for k in range(elements):
                t = k if sweep % 2 == 0 else elements - 1 - k
                visit, last = sweep * elements + k + 1, sweep * elements - k
                if sweep == 0:
                    last = 0
                since = lowered[cells[t, 0]]
                for i in ti.static(range(1, dim + 1)):
                    since = ti.max(since, lowered[cells[t, i]])
                if since >= last:
                    changed += lower_targets(x, cells, period, spacing, lowered, t, growth, visit, dim)
            if changed > 0:
                sweeps = sweep + 1
    return sweeps


@ti.func
def is_border(mesh: Template, fills: Template, t, i: Template):
    """Whether the face of cell t opposite to its corner i bounds its fluid."""
    result = False
    if mesh.label[t] >= 0:
        if fills[mesh.label[t]] != 0:
            o = mesh.across[t, i]
            result = o < 0
            if o >= 0:
                result = mesh.label[o] != mesh.label[t]
    return result


@kernel
def lower_in_films(mesh: Simplices, fills: Ints1, normal: Reals2, finest: ti.f64):
    """Lower mesh.wide [m] at the cells of films to their height over a face, but not below the ``finest`` [m].

    A film has particles on interfaces, of which mesh.marks is not 0, and a border on either side of a cell: the face
    opposite to a corner, and the corner. fills (L,): 1 for labels that are fluids; normal (N, L d), zero before: sums
    of the area vectors of the borders of each label around a particle, outward.
    """
    ti.loop_config(serialize=True)
    for t in range(mesh.cells.shape[0]):
        for i in ti.static(range(mesh.dim + 1)):
            if is_border(mesh, fills, t, i):
                out = -gradient(mesh, t, i)
                for k in ti.static(range(mesh.dim + 1)):
                    for a in ti.static(range(mesh.dim)):
                        if ti.static(k != i):
                            normal[mesh.cells[t, k], mesh.label[t] * mesh.dim + a] += out[a]
    ti.loop_config(serialize=True)
    for t in range(mesh.cells.shape[0]):
        for i in ti.static(range(mesh.dim + 1)):
            if is_border(mesh, fills, t, i):
                p, free = mesh.cells[t, i], True
                for k in ti.static(range(mesh.dim + 1)):
                    if ti.static(k != i):
                        free = free and mesh.marks[mesh.cells[t, k]] != 0
                out = -gradient(mesh, t, i)
                beyond = ti.Vector([normal[p, mesh.label[t] * mesh.dim + a] for a in ti.static(range(mesh.dim))])
                if free or mesh.marks[p] != 0:
                    if beyond.norm() > 0.0 and out.dot(beyond) < OPPOSITE * out.norm() * beyond.norm():
                        height = ti.max(measure(mesh, cell(mesh, t)) / out.norm(), finest)
                        for k in ti.static(range(mesh.dim + 1)):
                            q = mesh.cells[t, k]
                            mesh.wide[q] = ti.min(mesh.wide[q], height)
