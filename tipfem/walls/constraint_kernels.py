"""Kernels of walls: projection of constrained unknowns, and friction along walls that slip.

They modify the results of `tipfem.fem.residual` and `tipfem.fem.schur` for the particles of these walls; vectors of
unknowns are laid out as there. The projector P = I - N^+ N of a wall particle (with its walls' normals in the rows
of N) applies to its momentum rows and to its displacement.
"""

import taichi as ti

from tipfem.backend.array_types import Ints1, Ints2, Periods, Reals1, Reals2, Template
from tipfem.backend.launch import kernel
from tipfem.fem.element import row
from tipfem.fem.residual import displacement_of


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


@kernel
def project(
    index: Ints1,
    projector: Reals2,
    x: Reals1,
    count: ti.i32,
    dim: Template,
):
    """x_i = P_i x_i for the displacements of ``count`` particles; projector (count, d * d)."""
    for s in range(count):
        i = index[s]
        u = displacement_of(x, i, dim)
        for k in ti.static(range(dim)):
            total = 0.0
            for j in ti.static(range(dim)):
                total += projector[s, k * dim + j] * u[j]
            x[i * (dim + 1) + k] = total


@kernel
def slip_scale(
    index: Ints1,
    friction: Reals1,
    scale: Reals1,
    count: ti.i32,
    dim: Template,
):
    """One scale for all momentum rows of a sliding particle, so that scaling commutes with the projection.

    friction (count,) is the contribution of the wall to diag(A).
    """
    for s in range(count):
        i = index[s]
        diagonal = friction[s]
        if scale[i * (dim + 1)] > 0.0:  # particles in no element have none
            for k in ti.static(range(dim)):
                diagonal += 1.0 / (dim * scale[i * (dim + 1) + k])
            for k in ti.static(range(dim)):
                scale[i * (dim + 1) + k] = 1.0 / diagonal


@kernel
def pressure_residual(
    faces: Ints2,
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
    momentum row of a fluid at rest is int phi_a (grad p - rho b), which vanishes. faces (F, 2), with the fluid on the
    left. record (F, 4): pressures for the two particles, and the normal times the length at the intermediate
    positions.
    """
    ti.loop_config(serialize=True)
    for f in range(count):
        a, b = faces[f, 0], faces[f, 1]
        e = row(motion, b, 2) + cf * displacement_of(x, b, 2) - row(motion, a, 2) - cf * displacement_of(x, a, 2)
        one, other = x[a * 3 + 2], x[b * 3 + 2]
        record[f, 0], record[f, 1] = one / 3.0 + other / 6.0, one / 6.0 + other / 3.0
        record[f, 2], record[f, 3] = e[1], -e[0]
        for k in ti.static(range(2)):
            out[a * 3 + k] += scale[a * 3 + k] * record[f, 0] * record[f, 2 + k]
            out[b * 3 + k] += scale[b * 3 + k] * record[f, 1] * record[f, 2 + k]


@kernel
def pressure_product(
    faces: Ints2,
    record: Reals2,
    scale: Reals1,
    x: Reals1,
    out: Reals1,
    cf: float,
    count: ti.i32,
):
    """Add the derivative of `pressure_residual` along ``x``, from its ``record``."""
    ti.loop_config(serialize=True)
    for f in range(count):
        a, b = faces[f, 0], faces[f, 1]
        e = cf * (displacement_of(x, b, 2) - displacement_of(x, a, 2))
        turned = ti.Vector([e[1], -e[0]])
        one, other = x[a * 3 + 2], x[b * 3 + 2]
        for k in ti.static(range(2)):
            n = record[f, 2 + k]
            out[a * 3 + k] += scale[a * 3 + k] * ((one / 3.0 + other / 6.0) * n + record[f, 0] * turned[k])
            out[b * 3 + k] += scale[b * 3 + k] * ((one / 6.0 + other / 3.0) * n + record[f, 1] * turned[k])


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
def slip_product(
    faces: Ints2,
    coefficient: Reals1,
    normal: Reals2,
    record: Reals2,
    scale: Reals1,
    x: Reals1,
    out: Reals1,
    cv: float,
    cf: float,
    count: ti.i32,
    dim: Template,
):
    """Add the derivative of `slip_residual` along ``x``, from the faces' linearisation."""
    ti.loop_config(serialize=True)
    for f in range(count):
        n = row(normal, f, dim)
        first = displacement_of(x, faces[f, 0], dim)
        side = ti.Matrix.zero(float, dim - 1, dim)
        change = ti.Matrix.zero(float, dim - 1, dim)
        for a in ti.static(range(1, dim)):
            corner = displacement_of(x, faces[f, a], dim)
            for k in ti.static(range(dim)):
                side[a - 1, k] = record[f, 1 + dim * dim + (a - 1) * dim + k]
                change[a - 1, k] = cf * (corner[k] - first[k])
        growth = measure_change(side, change, n)
        for a in ti.static(range(dim)):
            i = faces[f, a]
            for k in ti.static(range(dim)):
                r = i * (dim + 1) + k
                force = growth * record[f, 1 + a * dim + k] + record[f, 0] * cv * x[r]
                out[r] += scale[r] * force / dim * coefficient[f]
