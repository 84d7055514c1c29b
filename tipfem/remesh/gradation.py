"""Gradation of the target spacings: a kernel that limits their growth from particle to particle."""

import taichi as ti

from tipfem.backend.array_types import Ints1, Ints2, Periods, Reals1, Reals2, Template
from tipfem.backend.launch import kernel
from tipfem.backend.periodic import difference

# The edges of a cell, by dimension.
EDGES = {2: ((0, 1), (1, 2), (2, 0)), 3: ((0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3))}
SWEEPS = 100  # far more than needed: one sweep carries targets along many edges
ROUND_OFF = 1e-9


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
