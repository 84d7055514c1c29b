"""Gradation of the target spacings: a kernel that limits their growth from particle to particle."""

import taichi as ti

from tipfem.backend.array_types import Ints1, Ints2, Periods, Reals1, Reals2, Template
from tipfem.backend.launch import kernel
from tipfem.remesh.triangles.edge_operations import TriangleArrays, distance, side

SWEEPS = 100  # far more than needed: one sweep carries targets along many edges
ROUND_OFF = 1e-9


@ti.func
def lower_targets(mesh: Template, spacing: Template, lowered: Template, t, growth, now):
    """Lower the target spacings of cell t until they grow by at most ``growth`` along its edges; 1 if any changed.

    lowered (N,) is set to ``now`` for those that are.
    """
    changed = 0
    for i in ti.static(range(3)):
        a, b = mesh.cells[t, i], mesh.cells[t, (i + 1) % 3]
        if spacing[a] > spacing[b]:
            a, b = b, a
        # Most edges need no change, and for these no square root.
        more = spacing[b] - spacing[a]
        if more > 0:
            ba = side(mesh, b, a)
            dx, dy = growth * ba[0], growth * ba[1]
            if more * more > dx * dx + dy * dy:
                highest = spacing[a] + growth * distance(mesh, a, b)
                if spacing[b] > highest * (1 + ROUND_OFF):
                    spacing[b] = highest
                    lowered[b] = now
                    changed = 1
    return changed


@kernel
def limit_gradation(
    x: Reals2, cells: Ints2, period: Periods, spacing: Reals1, lowered: Ints1, growth: ti.f64
) -> ti.i32:
    """Lower target ``spacing`` (N,) [m] until it grows by at most ``growth`` along every edge of the cells (M, 3).

    Sweeps over the cells, forwards and backwards, until one changes nothing; returns how many it took. x (N, 2) [m].
    lowered (N,), zero before: the number of the visit, of all sweeps, in which a target was lowered last. Cells are
    skipped if none of their targets was lowered since their last visit.
    """
    mesh = ti.static(TriangleArrays(x, cells, None, None, period))
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
                since = ti.max(lowered[cells[t, 0]], lowered[cells[t, 1]], lowered[cells[t, 2]])
                if since >= last:
                    changed += lower_targets(mesh, spacing, lowered, t, growth, visit)
            if changed > 0:
                sweeps = sweep + 1
    return sweeps
