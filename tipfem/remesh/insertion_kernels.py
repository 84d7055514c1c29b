"""Kernel that takes particles out of a triangulation and puts them into edges of it.

Arrays are those of `edge_operations`; all runs in one thread.
"""

import taichi as ti

from tipfem.backend.launch import kernel
from tipfem.remesh.edges.edge_operations import (
    STAR,
    can_collapse,
    collapse,
    collect_star,
    distance,
    double_area,
    place,
    ring,
    split,
)

ON_EDGE = 1e-9  # how far beside an edge of length 1 a place may be by round-off


@kernel
def set_elsewhere(
    x: ti.types.ndarray(),
    cells: ti.types.ndarray(),
    neighbours: ti.types.ndarray(),
    fluid: ti.types.ndarray(),
    corner: ti.types.ndarray(),
    star: ti.types.ndarray(),
    moves: ti.types.ndarray(),
    target: ti.types.ndarray(),
    count: ti.i32,
    least: ti.f64,
) -> ti.i32:
    """Particles moves[m, 0] go to target[m] (2,), which is on the edge from moves[m, 1] to moves[m, 2].

    First the particle's cells close over it, by a collapse of the shortest edge that leaves each twice the area
    ``least``; then the edge is split. Returns how many were set before one could not be: ``count`` if all is well.
    ``star`` is scratch for two stars.
    """
    done = 0
    ti.loop_config(serialize=True)
    for m in range(count):
        if done == m:
            p, start, end = moves[m, 0], moves[m, 1], moves[m, 2]
            n, closed = collect_star(cells, neighbours, corner, p, star, 0)
            q, gap = -1, 1e30
            if closed == 1:
                for k in range(n):
                    r = ring(cells, star, 0, n, p, k)
                    length = distance(x, p, r)
                    if length < gap and can_collapse(x, cells, star, 0, n, p, r, least):
                        q, gap = r, length
            if q >= 0:
                collapse(cells, neighbours, corner, fluid, star, 0, n, p, q)
                one, other = -1, -1
                for k in range(n):
                    if fluid[star[k]] < 0:
                        other = one
                        one = star[k]
                x[p, 0], x[p, 1] = target[m, 0], target[m, 1]
                around, closed2 = collect_star(cells, neighbours, corner, start, star, STAR + 1)
                # A particle of another fluid may have been set into the same edge: then its half is what is split.
                t, near = -1, -1
                for k in range(around):
                    r = ring(cells, star, STAR + 1, around, start, k)
                    side = double_area(x, start, r, p) / distance(x, start, r) ** 2
                    ahead = (x[p, 0] - x[start, 0]) * (x[r, 0] - x[start, 0]) + (x[p, 1] - x[start, 1]) * (
                        x[r, 1] - x[start, 1]
                    )
                    if ti.abs(side) < ON_EDGE and ahead > 0.0 and distance(x, start, p) < distance(x, start, r):
                        t, near = star[STAR + 1 + k], r
                if t >= 0 and one >= 0 and other >= 0 and (near == end or closed2 == 1):
                    i = 3 - place(cells, t, start) - place(cells, t, near)
                    if neighbours[t, i] >= 0:
                        split(cells, neighbours, corner, fluid, t, i, p, one, other)
                        done += 1
    return done
