"""The kernel that inserts particles into edges of a triangulation, in place, on `edge_operations.TriangleArrays`."""

import taichi as ti

from tipfem.backend.array_types import Flags1, Ints1, Template
from tipfem.backend.launch import kernel
from tipfem.backend.periodic import middle
from tipfem.remesh.triangles.edge_operations import (
    INTERPOLATED,
    OFF_WALLS,
    TARGET,
    TriangleArrays,
    add_mass,
    column_of,
    distance,
    split,
    target,
)

# Counters of `refine`.
INSERTED, CELLS_USED = 0, 1
LONG = 1.8  # targets
SHORT_SIDE = 0.8  # factor on the room that a new particle needs, for its distance to the ends of its edge


@ti.func
def interpolate_midpoint(mesh: Template, n, b, c):
    """Set the state of particle n, except its mass, to the mean of those of b and c, which conserves momentum."""
    x = ti.static(mesh.state)
    for s in range(INTERPOLATED):
        x[n, s] = 0.5 * (x[b, s] + x[c, s])
    for k in ti.static(range(2)):
        x[n, k] = middle(x, mesh.period, b, c, k)
    x[n, TARGET] = target(x, b, c)


@ti.func
def has_room(mesh: Template, t, i, n, room):
    """Whether particle n, in the middle of the edge opposite corner i of cell t, is ``room`` targets from others.

    Or less over an edge of a wall longer than `LONG` targets, from which particles have slid away: others beside it
    would keep it as it is, and on a curve it would cut into the fluid or into the body.
    """
    x, cells = ti.static(mesh.state, mesh.cells)
    o, least = mesh.neighbours[t, i], room * x[n, TARGET]
    if o < 0 and mesh.density[mesh.fluid[t]] > 0.0:
        half = distance(mesh, n, cells[t, (i + 1) % 3]) / x[n, TARGET]
        least *= ti.min(1.0, 0.25 * LONG * LONG / (half * half))
    free = distance(mesh, n, cells[t, i]) > least and distance(mesh, n, cells[t, (i + 1) % 3]) > SHORT_SIDE * least
    if o >= 0:
        free = free and distance(mesh, n, cells[o, column_of(mesh.neighbours, o, t)]) > least
    return free


@ti.func
def insert(mesh: Template, touched: Template, t, i, n, t2, o2):
    """Split the edge opposite corner i of cell t by particle n, which has its state, and give it its mass.

    t2 and o2: removed cells. touched (M,) is set to 1 for cells that change. Returns how many cells were used, 1 on the
    hull, where n belongs to the wall, else 2.
    """
    o, b, c = mesh.neighbours[t, i], mesh.cells[t, (i + 1) % 3], mesh.cells[t, (i + 2) % 3]
    add_mass(mesh, t, -1)
    if o >= 0:
        add_mass(mesh, o, -1)
    split(mesh, t, i, n, t2, o2)
    add_mass(mesh, t, 1)
    add_mass(mesh, t2, 1)
    if o >= 0:
        add_mass(mesh, o, 1)
        add_mass(mesh, o2, 1)
    touched[t] = 1
    touched[t2] = 1
    mesh.wall[n] = ti.max(mesh.wall[b], mesh.wall[c])
    used = 1
    if o >= 0:
        mesh.wall[n] = OFF_WALLS
        touched[o] = 1
        touched[o2] = 1
        used = 2
    return used


@kernel
def refine(
    mesh: TriangleArrays,
    edges: Ints1,
    removed_cells: Ints1,
    removed: Ints1,
    touched: Flags1,
    counters: Ints1,
    room: ti.f64,
):
    """Insert the ``removed`` particles (P,) in the middle of edges, in the order given.

    edges (K,): names as of `long_edges`. An edge is skipped if a cell beside it was changed already or if a
    particle is closer than ``room`` target spacings to its middle. removed_cells (2 P + 1,): for the cells that are
    created. A new particle takes the mean of the two states; on the edge of a wall it belongs to the wall, and slides
    if one of the two does. touched (M,), zero before: cells that were changed. counters, zero before: [INSERTED]
    particles, the first of ``removed``, and [CELLS_USED] of the removed ones.
    """
    ti.loop_config(serialize=True)
    for k in range(edges.shape[0]):
        if counters[INSERTED] < removed.shape[0]:
            t, i = edges[k] // 3, edges[k] % 3
            o = mesh.neighbours[t, i]
            usable = touched[t] == 0
            if o >= 0 and usable:
                usable = touched[o] == 0
            if usable:
                n, used = removed[counters[INSERTED]], counters[CELLS_USED]
                interpolate_midpoint(mesh, n, mesh.cells[t, (i + 1) % 3], mesh.cells[t, (i + 2) % 3])
                if has_room(mesh, t, i, n, room):
                    counters[CELLS_USED] += insert(mesh, touched, t, i, n, removed_cells[used], removed_cells[used + 1])
                    counters[INSERTED] += 1
