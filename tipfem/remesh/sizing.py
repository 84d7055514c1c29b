"""Kernel that makes target spacings change gradually from particle to particle."""

import taichi as ti

from tipfem.backend.launch import kernel
from tipfem.remesh.edges.edge_operations import distance

SWEEPS = 100  # far more than there are: targets stride along many edges in one sweep


@kernel
def limit_growth(
    x: ti.types.ndarray(),
    cells: ti.types.ndarray(),
    target: ti.types.ndarray(),
    lowered: ti.types.ndarray(),
    growth: ti.f64,
    elements: ti.i32,
) -> ti.i32:
    """Lower ``target`` (N,) until it grows by at most ``growth`` along every edge of the triangles ``cells`` (M, 3).

    Sweeps over the triangles, to and fro, until one changes nothing; returns how many it took. x (N, >= 2) [m].
    lowered (N,), zero before: the turn, of all sweeps, in which a target was changed last. Triangles of which none was
    since their last turn are passed over.
    """
    sweeps = 0
    ti.loop_config(serialize=True)
    for sweep in range(SWEEPS):
        if sweeps == sweep:
            changed = False
            for k in range(elements):
                t = k if sweep % 2 == 0 else elements - 1 - k
                turn, last = sweep * elements + k + 1, sweep * elements - k
                if sweep == 0:
                    last = 0
                since = ti.max(lowered[cells[t, 0]], lowered[cells[t, 1]], lowered[cells[t, 2]])
                if since >= last:
                    for i in ti.static(range(3)):
                        a, b = cells[t, i], cells[t, (i + 1) % 3]
                        if target[a] > target[b]:
                            a, b = b, a
                        # Most edges join equal targets: no need to know how long they are.
                        more = target[b] - target[a]
                        if more > 0:
                            dx, dy = growth * (x[a, 0] - x[b, 0]), growth * (x[a, 1] - x[b, 1])
                            if more * more > dx * dx + dy * dy:  # roots are for those that may be too high
                                highest = target[a] + growth * distance(x, a, b)
                                if target[b] > highest * (1 + 1e-9):
                                    target[b] = highest
                                    lowered[b] = turn
                                    changed = True
            if changed:
                sweeps = sweep + 1
    return sweeps
