"""Kernel that removes particles from a triangulation and inserts them into edges of it.

Arrays are those of `edge_operations.TriangleArrays`. The kernel is serial.
"""

import taichi as ti

from tipfem.backend.array_types import Ints1, Ints2, Periods, Reals2, Template
from tipfem.backend.launch import kernel
from tipfem.remesh.triangles.edge_operations import (
    STAR,
    Segment,
    TriangleArrays,
    can_collapse,
    collapse,
    collect_star,
    column_of,
    distance,
    double_area,
    entry,
    ring,
    side,
    split,
)

ON_EDGE = 1e-9  # how far beside an edge of length 1 an insertion site may be by round-off
SCRATCH = 2 * (STAR + 1)  # entries: two stars


@ti.func
def nearest_target(mesh: Template, star: Template, count, p, least):
    """The nearest neighbour that particle p can be moved into, -1 for none; cells keep twice an area of ``least``."""
    q, gap = -1, 1e30
    for k in range(count):
        r = ring(mesh, star, count, p, k)
        length = distance(mesh, p, r)
        if length < gap and can_collapse(mesh, star, count, p, r, least):
            q, gap = r, length
    return q


@ti.func
def removed_cells(mesh: Template, star: Template, count):
    """The last two cells of a star that were removed, -1 for none: the last one, and the one before."""
    last, before = -1, -1
    for k in range(count):
        if mesh.fluid[entry(star, k)] < 0:
            before = last
            last = entry(star, k)
    return last, before


@ti.func
def edge_under(mesh: Template, star: Template, start, end, p):
    """The edge from particle ``start`` towards ``end`` on which particle p is: a cell and the corner opposite.

    If another particle was inserted into the edge from ``start`` to ``end``, this is the half on which p
    is. The cell is -1 for none. ``star`` is room for the cells around ``start``.
    """
    count, closed = collect_star(mesh, star, start)
    t, i, near = -1, -1, -1
    for k in range(count):
        r = ring(mesh, star, count, start, k)
        off = double_area(mesh, start, r, p) / distance(mesh, start, r) ** 2
        to_p, to_r = side(mesh, start, p), side(mesh, start, r)
        ahead = to_p[0] * to_r[0] + to_p[1] * to_r[1]
        if ti.abs(off) < ON_EDGE and ahead > 0.0 and distance(mesh, start, p) < distance(mesh, start, r):
            t, near = entry(star, k), r
    if t >= 0 and (near == end or closed == 1):
        i = 3 - column_of(mesh.cells, t, start) - column_of(mesh.cells, t, near)
        if mesh.neighbours[t, i] < 0:
            t = -1
    else:
        t = -1
    return t, i


@kernel
def relocate_particles(
    state: Reals2,
    cells: Ints2,
    neighbours: Ints2,
    fluid: Ints1,
    period: Periods,
    corner: Ints1,
    moves: Ints2,
    sites: Reals2,
    scratch: Ints1,
    least: ti.f64,
) -> ti.i32:
    """Particles moves[m, 0] go to sites[m] (2,) [m], which is on the edge from moves[m, 1] to moves[m, 2].

    First the particle is removed by a collapse of the shortest edge that leaves each cell twice the area ``least``;
    then the other edge is split. Returns how many were relocated before the first that could not be, which is the
    number of moves if all were. scratch (SCRATCH,) is for this kernel's use.
    """
    mesh = ti.static(TriangleArrays(state, cells, neighbours, fluid, period, corner))
    star, other_star = ti.static(Segment(scratch, 0), Segment(scratch, STAR + 1))
    done = 0
    ti.loop_config(serialize=True)
    for m in range(moves.shape[0]):
        if done == m:
            p = moves[m, 0]
            count, closed = collect_star(mesh, star, p)
            q = -1
            if closed == 1:
                q = nearest_target(mesh, star, count, p, least)
            if q >= 0:
                collapse(mesh, star, count, p, q)
                one, other = removed_cells(mesh, star, count)
                state[p, 0], state[p, 1] = sites[m, 0], sites[m, 1]
                t, i = edge_under(mesh, other_star, moves[m, 1], moves[m, 2], p)
                if t >= 0 and one >= 0 and other >= 0:
                    split(mesh, t, i, p, one, other)
                    done += 1
    return done
