"""Kernels of friction along walls that slip, and of the pressure of curved walls.

They add to the results of `tipfem.fem.residual` and `tipfem.fem.jacobian`; vectors of unknowns are laid out as there.
"""

import taichi as ti

from tipfem.backend.array_types import Ints1, Ints2, Periods, Reals1, Reals2, Template
from tipfem.backend.launch import kernel
from tipfem.fem.element import row
from tipfem.fem.jacobian import block_entry
from tipfem.fem.residual import displacement_of

SLIDING = 10.0  # nanoseconds of one thread for a sliding particle in `slip_scale`


def face_record_width(dim: int) -> int:
    """Entries of a face's linearisation, see `slip_residual`."""
    return 1 + 2 * dim * dim


@ti.func
def face_measure(side, n):
    """Length of an edge, or area of a triangle, spanned by the rows of ``side`` (d - 1, d), with a normal n."""
    result = 0.0
    if ti.static(n.n == 2):
        result = n[0] * side[0, 1] - n[1] * side[0, 0]
    else:
        one = ti.Vector([side[0, k] for k in ti.static(range(3))])
        two = ti.Vector([side[1, k] for k in ti.static(range(3))])
        result = 0.5 * n.dot(one.cross(two))
    return result


@ti.func
def measure_change(side, change, n):
    """Derivative of `face_measure` along a change (d - 1, d) of ``side``."""
    result = 0.0
    if ti.static(n.n == 2):
        result = face_measure(change, n)
    else:
        for a in ti.static(range(2)):
            mixed = side
            for k in ti.static(range(3)):
                mixed[a, k] = change[a, k]
            result += face_measure(mixed, n)
    return result


@ti.func
def block_of(row_offsets: Template, columns: Template, i, j):
    """Number of the block of row ``i`` and column ``j``, which are on a face together."""
    found = row_offsets[i]
    for s in range(row_offsets[i], row_offsets[i + 1]):
        if columns[s] == j:
            found = s
    return found


@kernel
def slip_scale(
    sliding: Ints1,
    friction: Reals1,
    scale: Reals1,
    count: ti.i32,
    dim: Template,
    serial: Template,
):
    """One scale for all momentum rows of a sliding particle, so that scaling commutes with the projection.

    sliding (count,): the particles; friction (count,) is the contribution of the wall to diag(A).
    """
    ti.loop_config(serialize=serial)
    for s in range(count):
        i = sliding[s]
        diagonal = friction[s]
        if scale[i * (dim + 1)] > 0.0:  # particles in no element have none
            for k in ti.static(range(dim)):
                diagonal += 1.0 / (dim * scale[i * (dim + 1) + k])
            for k in ti.static(range(dim)):
                scale[i * (dim + 1) + k] = 1.0 / diagonal


@kernel
def pressure_residual(
    faces: Ints2,
    nodes: Ints2,
    motion: Reals2,
    x: Reals1,
    scale: Reals1,
    record: Reals2,
    out: Reals1,
    cf: float,
    count: ti.i32,
):
    """Add the pressure of curved walls, int p n phi_a over their faces, to the scaled momentum rows (2-D).

    A particle that slides on a curve moves at right angles to the mean of the normals of its two faces, not to each of
    them, so that a pressure that varies along the wall has a part along it: with this term what is left of the
    momentum row of a fluid at rest is int phi_a (grad p - rho b), which vanishes. faces (F, 2): particles, with the
    fluid on the left; nodes (F, 2) of the mesh that is solved on, which have the pressures of that fluid.
    record (F, 4): pressures for the two particles, and the normal times the length at the intermediate positions.
    """
    ti.loop_config(serialize=True)
    for f in range(count):
        a, b = faces[f, 0], faces[f, 1]
        e = row(motion, b, 2) + cf * displacement_of(x, b, 2) - row(motion, a, 2) - cf * displacement_of(x, a, 2)
        one, other = x[nodes[f, 0] * 3 + 2], x[nodes[f, 1] * 3 + 2]
        record[f, 0], record[f, 1] = one / 3.0 + other / 6.0, one / 6.0 + other / 3.0
        record[f, 2], record[f, 3] = e[1], -e[0]
        for k in ti.static(range(2)):
            out[a * 3 + k] += scale[a * 3 + k] * record[f, 0] * record[f, 2 + k]
            out[b * 3 + k] += scale[b * 3 + k] * record[f, 1] * record[f, 2 + k]


@kernel
def add_pressures(
    faces: Ints2,
    record: Reals2,
    scale: Reals1,
    row_offsets: Ints1,
    columns: Ints1,
    blocks: Reals1,
    cf: float,
    rows: ti.i32,
    count: ti.i32,
):
    """Add the derivative of `pressure_residual`, from its ``record``, to the blocks of the Jacobian.

    faces (F, 2): nodes of the mesh that is solved on, which has ``rows`` nodes.
    """
    ti.loop_config(serialize=True)
    for f in range(count):
        couplings = row_offsets[rows]
        for one in ti.static(range(2)):
            i = faces[f, one]
            for other in ti.static(range(2)):
                s = block_of(row_offsets, columns, i, faces[f, other])
                part = ti.static(1.0 / 3.0 if one == other else 1.0 / 6.0)
                # e = x_b - x_a, turned: (e_y, -e_x)
                turn = ti.static(1.0 if other == 1 else -1.0) * cf * record[f, one]
                blocks[block_entry(couplings, s, 0, 1, 2)] += scale[i * 3] * turn
                blocks[block_entry(couplings, s, 1, 0, 2)] -= scale[i * 3 + 1] * turn
                for k in ti.static(range(2)):
                    up = block_entry(couplings, s, k, 2, 2)
                    blocks[up] += scale[i * 3 + k] * part * record[f, 2 + k]


@kernel
def slip_residual(
    faces: Ints2,
    coefficient: Reals1,
    normal: Reals2,
    wall_velocity: Reals2,
    period: Periods,
    motion: Reals2,
    x: Reals1,
    scale: Reals1,
    record: Reals2,
    out: Reals1,
    cv: float,
    cf: float,
    count: ti.i32,
    dim: Template,
):
    """Add Navier's friction to the scaled residual: node a of a face gets A / d mu / l (v_alpha,a - v_wall,a).

    A is the face's measure at the intermediate positions; lumping (nodal quadrature) keeps friction on the diagonal,
    however short the slip length. faces (F, d); coefficient mu / l (F,); normal (F, d);
    wall_velocity (F, d * d). The projection removes its normal part. Serial, because faces share nodes.
    """
    ti.loop_config(serialize=True)
    for f in range(count):
        n = row(normal, f, dim)
        first = row(motion, faces[f, 0], dim) + cf * displacement_of(x, faces[f, 0], dim)
        side = ti.Matrix.zero(float, dim - 1, dim)
        for a in ti.static(range(1, dim)):
            corner = row(motion, faces[f, a], dim) + cf * displacement_of(x, faces[f, a], dim)
            for k in ti.static(range(dim)):
                side[a - 1, k] = corner[k] - first[k]
                if ti.static(len(period.shape) == 2):
                    side[a - 1, k] -= period[0, k] * ti.floor(side[a - 1, k] * period[1, k] + 0.5)
                record[f, 1 + dim * dim + (a - 1) * dim + k] = side[a - 1, k]
        measure = face_measure(side, n)
        record[f, 0] = measure
        for a in ti.static(range(dim)):
            i = faces[f, a]
            for k in ti.static(range(dim)):
                slip = cv * x[i * (dim + 1) + k] + motion[i, dim + k] - wall_velocity[f, a * dim + k]
                record[f, 1 + a * dim + k] = slip
                r = i * (dim + 1) + k
                out[r] += scale[r] * measure / dim * coefficient[f] * slip


@kernel
def add_friction(
    faces: Ints2,
    coefficient: Reals1,
    normal: Reals2,
    record: Reals2,
    scale: Reals1,
    row_offsets: Ints1,
    columns: Ints1,
    blocks: Reals1,
    cv: float,
    cf: float,
    rows: ti.i32,
    count: ti.i32,
    dim: Template,
):
    """Add the derivative of `slip_residual`, from the faces' linearisation, to the blocks of the Jacobian.

    faces (F, d): nodes of the mesh that is solved on, of ``rows`` nodes, whose rows and columns are those of their
    particles.
    """
    ti.loop_config(serialize=True)
    for f in range(count):
        couplings = row_offsets[rows]
        n = row(normal, f, dim)
        side = ti.Matrix.zero(float, dim - 1, dim)
        for a in ti.static(range(dim - 1)):
            for k in ti.static(range(dim)):
                side[a, k] = record[f, 1 + dim * dim + a * dim + k]
        for other in ti.static(range(dim)):
            for m in ti.static(range(dim)):
                # The corner's displacement changes the sides from the first corner.
                change = ti.Matrix.zero(float, dim - 1, dim)
                for a in ti.static(range(dim - 1)):
                    if ti.static(other == 0):
                        change[a, m] = -cf
                    elif ti.static(other == a + 1):
                        change[a, m] = cf
                growth = measure_change(side, change, n)
                for one in ti.static(range(dim)):
                    i = faces[f, one]
                    s = block_of(row_offsets, columns, i, faces[f, other])
                    for k in ti.static(range(dim)):
                        force = growth * record[f, 1 + one * dim + k]
                        if ti.static(one == other and k == m):
                            force += record[f, 0] * cv
                        uu = block_entry(couplings, s, k, m, dim)
                        blocks[uu] += scale[i * (dim + 1) + k] * force / dim * coefficient[f]


@kernel
def find_nearest(
    place: Reals2,
    part: Ints1,
    others: Reals2,
    part_of_others: Ints1,
    period: Periods,
    distance: Reals1,
    number: Ints1,
):
    """Distance (P,) from places (P, 2) to the nearest of others (Q, 2) on the same part of a wall, and its number (P,).

    1e15 m, and 0, where there is none on that part; the first of several at the same distance.
    """
    ti.loop_config(serialize=True)
    for i in range(place.shape[0]):
        least, found = 1e30, 0
        for j in range(others.shape[0]):
            if part_of_others[j] == part[i]:
                square = 0.0
                for k in ti.static(range(2)):
                    d = others[j, k] - place[i, k]
                    if ti.static(len(period.shape) == 2):
                        d -= period[0, k] * ti.floor(d * period[1, k] + 0.5)
                    square += d * d
                if square < least:
                    least, found = square, j
        distance[i], number[i] = ti.sqrt(least), found
