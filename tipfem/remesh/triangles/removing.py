"""The kernel that takes particles out of the cells of empty space, in place, on `edge_operations.TriangleArrays`."""

import taichi as ti

from tipfem.backend.array_types import Flags1, Ints1
from tipfem.backend.launch import kernel
from tipfem.remesh.triangles.edge_operations import (
    FAR,
    STAR,
    TARGET,
    Segment,
    TriangleArrays,
    can_collapse,
    collapse,
    collect_star,
    distance,
    entry,
    mark_stale,
    ring,
)

SCRATCH = STAR + 1
LEAST = 1e-6  # twice the area that cells around must keep, in target spacings squared


@kernel
def remove_from_cells(mesh: TriangleArrays, particles: Ints1, scratch: Ints1, done: Flags1):
    """Take particles (K,), which have no mass, out of the cells around them by collapsing an edge to a neighbour.

    done (K,): 1 for those taken out; the others are on the hull, or no collapse leaves all cells with an area. scratch
    (SCRATCH,) is for this kernel's use.
    """
    star = ti.static(Segment(scratch))
    ti.loop_config(serialize=True)
    for k in range(particles.shape[0]):
        p = particles[k]
        done[k] = ti.i8(0)
        if mesh.corner[p] >= 0:
            count, closed = collect_star(mesh, star, p)
            q, gap = -1, FAR
            for m in range(count * closed):
                r = ring(mesh, star, count, p, m)
                length = distance(mesh, p, r)
                if length < gap and can_collapse(mesh, star, count, p, r, LEAST * mesh.state[p, TARGET] ** 2):
                    q, gap = r, length
            if q >= 0:
                collapse(mesh, star, count, p, q)
                for m in range(count):
                    if mesh.fluid[entry(star, m)] >= 0:
                        mark_stale(mesh, entry(star, m))
                done[k] = ti.i8(1)
