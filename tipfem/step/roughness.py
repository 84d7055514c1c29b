"""Roughness at the scale of the mesh: a measure of how well a flow is resolved, and of noise."""

import numpy as np
import taichi as ti

from tipfem.backend.array_types import Ints1, Ints2, Periods, Reals1, Reals2
from tipfem.backend.launch import kernel, launch
from tipfem.backend.periodic import difference
from tipfem.backend.real_functions import angle_between
from tipfem.physics.state import State

# Columns of a particle's sums over its neighbours: how many, d, d d^T, u, and the components of u times d ...
COUNT, AWAY, SQUARES, APART, PRODUCTS = 0, 1, 3, 6, 8
# ... and how many edges of the interface arrive and leave, with their directions.
ARRIVING, LEAVING, FROM, TO, COLUMNS = 12, 13, 14, 16, 18
NONE, SEVERAL = -1, -2  # of a particle's fluids


@kernel
def sum_roughness(
    position: Reals2,
    velocity: Reals2,
    cells: Ints2,
    neighbours: Ints2,
    fluid: Ints1,
    period: Periods,
    own: Ints1,
    fit: Reals2,
    deviation: Reals1,
    square: Reals1,
    turning: Reals1,
):
    """Sums over the particles inside each fluid (F,), on no interface and not on the hull.

    deviation: of squared deviations from the linear fit to the neighbours' velocities; square: of squared speeds.
    turning (2,): absolute angles between successive edges of interfaces [rad], and how many. own (N,) is `NONE` before,
    fit (N, COLUMNS) zero.
    """
    ti.loop_config(serialize=True)
    for t in range(cells.shape[0]):
        for i in ti.static(range(3)):
            p, q = cells[t, i], cells[t, ti.static((i + 1) % 3)]  # inside, each neighbour is met once like this
            own[p] = fluid[t] if own[p] == NONE or own[p] == fluid[t] else SEVERAL
            d = ti.Vector([difference(position, period, q, p, k) for k in ti.static(range(2))])
            u = ti.Vector([velocity[q, k] - velocity[p, k] for k in ti.static(range(2))])
            fit[p, COUNT] += 1.0
            fit[p, SQUARES] += d[0] * d[0]
            fit[p, SQUARES + 1] += d[0] * d[1]
            fit[p, SQUARES + 2] += d[1] * d[1]
            for k in ti.static(range(2)):
                fit[p, AWAY + k] += d[k]
                fit[p, APART + k] += u[k]
                fit[p, PRODUCTS + 2 * k] += u[k] * d[0]
                fit[p, PRODUCTS + 2 * k + 1] += u[k] * d[1]
    ti.loop_config(serialize=True)
    for t in range(cells.shape[0]):
        for i in ti.static(range(3)):
            o, b, c = neighbours[t, i], cells[t, ti.static((i + 1) % 3)], cells[t, ti.static((i + 2) % 3)]
            if o < 0:
                own[b], own[c] = SEVERAL, SEVERAL
            elif fluid[t] < fluid[o]:
                fit[b, LEAVING] += 1.0
                fit[c, ARRIVING] += 1.0
                for k in ti.static(range(2)):
                    d = difference(position, period, c, b, k)
                    fit[b, TO + k], fit[c, FROM + k] = d, d
    ti.loop_config(serialize=True)
    for p in range(own.shape[0]):
        if fit[p, ARRIVING] == 1.0 and fit[p, LEAVING] == 1.0:
            ax, ay, bx, by = fit[p, FROM], fit[p, FROM + 1], fit[p, TO], fit[p, TO + 1]
            turning[0] += angle_between(ax * by - ay * bx, ax * bx + ay * by)
            turning[1] += 1.0
        n = fit[p, COUNT]
        if own[p] >= 0 and n >= 4.0:
            x, y = fit[p, AWAY] / n, fit[p, AWAY + 1] / n
            xx, xy = fit[p, SQUARES] - n * x * x, fit[p, SQUARES + 1] - n * x * y
            yy = fit[p, SQUARES + 2] - n * y * y
            for k in ti.static(range(2)):
                mean = fit[p, APART + k] / n
                px, py = fit[p, PRODUCTS + 2 * k] - n * mean * x, fit[p, PRODUCTS + 2 * k + 1] - n * mean * y
                centre = mean - ((yy * px - xy * py) * x + (xx * py - xy * px) * y) / (xx * yy - xy * xy)
                deviation[own[p]] += centre * centre
                square[own[p]] += velocity[p, k] ** 2


def roughness(state: State, fluids: int) -> tuple[list[float], float]:
    """Roughness of the velocities of each fluid, and of the interfaces between them, in 2-D.

    Returns:
        For each of the ``fluids`` the root mean square of the deviation of a particle's velocity from the linear fit to
        those of its neighbours, over the root mean square of its speed, 0 for a fluid at rest; interfaces and walls
        excepted. And the mean absolute angle between successive edges of interfaces [degrees].
    """
    mesh, velocity = state.mesh, state.particles.velocity
    count = len(velocity)
    deviation, square, turning = np.zeros(fluids), np.zeros(fluids), np.zeros(2)
    own, fit = np.full(count, NONE, dtype=np.int32), np.zeros((count, COLUMNS))
    launch(
        sum_roughness,
        *map(np.ascontiguousarray, (mesh.position, velocity, mesh.cells, mesh.neighbours, mesh.fluid)),
        mesh.period.array,
        own,
        fit,
        deviation,
        square,
        turning,
    )
    parts = np.sqrt(np.divide(deviation, square, out=np.zeros(fluids), where=square > 0))
    return parts.tolist(), float(np.degrees(turning[0] / max(turning[1], 1.0)))
