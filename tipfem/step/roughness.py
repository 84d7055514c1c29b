"""Roughness at the scale of the mesh: a measure of how well a flow is resolved, and of noise."""

import numpy as np
import taichi as ti

from tipfem.backend.array_types import Ints1, Ints2, Periods, Reals1, Reals2, Template
from tipfem.backend.arrays import APART, partials
from tipfem.backend.launch import add_parts, kernel, launch, part_of
from tipfem.backend.periodic import difference
from tipfem.backend.real_functions import angle_between
from tipfem.physics.state import State
from tipfem.scratch import filled

# Columns of the sums: of turning angles, and how many; then of each fluid in turn.
ANGLES, TURNS, FLUIDS = 0, 1, 2
SEVERAL = -2  # of the fluids at a particle
ROUGHNESS = 60.0  # nanoseconds of one thread for a particle in `sum_roughness`


@kernel
def sum_roughness(
    position: Reals2,
    velocity: Reals2,
    cells: Ints2,
    neighbours: Ints2,
    fluid: Ints1,
    period: Periods,
    cell: Ints1,
    partial: Reals2,
    sums: Reals1,
    parts: ti.i32,
    stride: Template,
    serial: Template,
):
    """Sums over the particles inside each fluid, on no interface and not on the hull, added to sums (2 F + 2,).

    Of each fluid: squared deviations from the linear fit to the neighbours' velocities, and squared speeds. Before
    them, absolute angles between successive edges of interfaces [rad], and how many. cell (N,) is -1 before.
    """
    ti.loop_config(serialize=True)
    for t in range(cells.shape[0]):
        for i in ti.static(range(3)):
            cell[cells[t, i]] = t
    ti.loop_config(serialize=serial)
    for t in range(parts * stride):
        first, last = part_of(t, parts, stride, cell.shape[0])
        if t % stride == 0:
            for k in range(sums.shape[0]):
                partial[t // stride, k] = 0.0
        for p in range(first, last):
            own, n, arriving, leaving = SEVERAL, 0.0, 0, 0
            away, apart = ti.Vector.zero(float, 2), ti.Vector.zero(float, 2)
            squares, products = ti.Vector.zero(float, 3), ti.Matrix.zero(float, 2, 2)
            a, b = ti.Vector.zero(float, 2), ti.Vector.zero(float, 2)  # edges of an interface to and from it
            start = cell[p]
            c, onwards = start, 1  # round the particle, from a hull the other way as well
            if c >= 0:
                own = fluid[c]
            while c >= 0:
                i = ti.select(cells[c, 0] == p, 0, ti.select(cells[c, 1] == p, 1, 2))
                side = i + ti.select(onwards == 1, 1, 2)  # opposite which the next cell is
                side -= ti.select(side > 2, 3, 0)
                o, r = neighbours[c, side], cells[c, 3 - i - side]
                if onwards == 1:
                    q = cells[c, side]
                    d = ti.Vector([difference(position, period, q, p, k) for k in ti.static(range(2))])
                    u = ti.Vector([velocity[q, k] - velocity[p, k] for k in ti.static(range(2))])
                    n += 1.0
                    away += d
                    apart += u
                    squares += ti.Vector([d[0] * d[0], d[0] * d[1], d[1] * d[1]])
                    products += u.outer_product(d)
                if o >= 0:
                    if fluid[o] != fluid[c]:
                        own = SEVERAL
                        e = ti.Vector([difference(position, period, r, p, k) for k in ti.static(range(2))])
                        if (fluid[c] < fluid[o]) == (onwards == 1):
                            arriving, a = arriving + 1, -e
                        else:
                            leaving, b = leaving + 1, e
                    c = ti.select(o == start, -1, o)
                elif onwards == 1:
                    own, onwards, c = SEVERAL, 0, start
                else:
                    c = -1
            if arriving == 1 and leaving == 1:
                turn = angle_between(a[0] * b[1] - a[1] * b[0], a.dot(b))
                partial[t // stride, ANGLES] = partial[t // stride, ANGLES] + turn
                partial[t // stride, TURNS] = partial[t // stride, TURNS] + 1.0
            if own >= 0 and n >= 4.0:
                x, y = away / n
                xx, xy, yy = squares - n * ti.Vector([x * x, x * y, y * y])
                more = ti.Vector([yy * x - xy * y, xx * y - xy * x]) / (xx * yy - xy * xy)
                for k in ti.static(range(2)):
                    mean = apart[k] / n
                    px, py = products[k, 0] - apart[k] * x, products[k, 1] - apart[k] * y
                    centre = mean - px * more[0] - py * more[1]
                    part, at = t // stride, FLUIDS + 2 * own
                    partial[part, at] = partial[part, at] + centre * centre
                    partial[part, at + 1] = partial[part, at + 1] + velocity[p, k] ** 2
    ti.loop_config(serialize=True)
    for k in range(sums.shape[0]):
        add_parts(sums, partial, k, parts)


def roughness(state: State, fluids: int) -> tuple[list[float], float]:
    """Roughness of the velocities of each fluid, and of the interfaces between them, in 2-D.

    Returns:
        For each of the ``fluids`` the root mean square of the deviation of a particle's velocity from the linear fit to
        those of its neighbours, over the root mean square of its speed, 0 for a fluid at rest; interfaces and walls
        excepted. And the mean absolute angle between successive edges of interfaces [degrees].
    """
    mesh, velocity = state.mesh, state.particles.velocity
    sums, last = np.zeros(FLUIDS + 2 * fluids), filled(-1, "roughness.last", len(velocity), np.int32)
    launch(
        sum_roughness,
        *map(np.ascontiguousarray, (mesh.position, velocity, mesh.cells, mesh.neighbours, mesh.fluid)),
        mesh.period.array,
        last,
        partials(len(sums) + APART),
        sums,
        work=(len(velocity), ROUGHNESS),
    )
    (angles, turns), (deviation, square) = sums[:FLUIDS], sums[FLUIDS:].reshape(fluids, 2).T
    parts = np.sqrt(np.divide(deviation, square, out=np.zeros(fluids), where=square > 0))
    return parts.tolist(), float(np.degrees(angles / max(turns, 1.0)))
