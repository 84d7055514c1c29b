"""Kernels of surface tension in the equations of a step, see `tipfem.physics.surface_tension.term`.

Those of edges are for 2-D, and those of facets, at the end, for 3-D.

The edges are listed by their ends: those of the particle ``rows[r]`` are offsets[r] to offsets[r + 1], each with the
particle at its ``other`` end and its tension ``sigma``. The columns of ``held`` are those of `HELD`. So
every row is summed by one thread, in one order. Unknowns are interleaved as in `tipfem.fem.residual`; the first two
columns of ``motion`` are positions at the step's start.
"""

from typing import NamedTuple

import numpy as np
import taichi as ti

from tipfem.backend.array_types import Ints1, Periods, Reals1, Reals2, Template
from tipfem.backend.launch import kernel
from tipfem.backend.periodic import difference, radius
from tipfem.fem.jacobian import block_entry
from tipfem.linalg.sparsity import Csr, find_column

ROW = 40.0  # nanoseconds of one thread for a row
# What holds the particle of a row along a wall: direction (2), displacement so far, largest force, stiffness.
DRAWN, LARGEST, STIFFNESS, HELD = 2, 3, 4, 5


class EdgeArrays(NamedTuple):
    """Rows and their entries in CSR, and what else acts on the rows."""

    rows: "Ints1"  # nodes
    offsets: "Ints1"
    other: "Ints1"  # end of each entry's edge
    sigma: "Reals1"  # of each entry [N/m]
    pull: "Reals2"  # constant force on each row
    projects: "Ints1"  # whether rows keep the part along dV / dx alone
    along: "Reals2"  # and have this force in its place
    held: "Reals2"  # see `HELD`


def hessian_width(*, axial: bool) -> int:
    """Entries of an edge's second derivatives, see `add_forces`."""
    return 5 if axial else 3


@ti.func
def stiffness(side, sigma):
    """sigma / L (I - t t^T) of an edge with the vector ``side`` from one end to the other; its xx, xy and yy."""
    length = side.norm()
    t = side / length
    return sigma / length * ti.Vector([1.0 - t[0] * t[0], -t[0] * t[1], 1.0 - t[1] * t[1]])


@kernel
def add_diagonal(
    motion: Reals2, period: Periods, edges: EdgeArrays, scale: Reals1, cf: float, count: ti.i32, serial: Template
):
    """Make the scale of momentum rows one over the sum of 1 / scale and the diagonal at the step's start."""
    ti.loop_config(serialize=serial)
    for r in range(count):
        i = edges.rows[r]
        total = ti.Vector([0.0, 0.0])
        for s in range(edges.offsets[r], edges.offsets[r + 1]):
            j = edges.other[s]
            side = ti.Vector([difference(motion, period, j, i, 0), difference(motion, period, j, i, 1)])
            h = stiffness(side, edges.sigma[s])
            if ti.static(len(period.shape) == 3):
                h *= 0.5 * (radius(motion, period, i) + radius(motion, period, j))
            total += ti.Vector([h[0], h[2]])
        for k in ti.static(range(2)):
            if scale[3 * i + k] > 0.0:
                more = cf * total[k] + edges.held[r, STIFFNESS] * edges.held[r, k] ** 2
                scale[3 * i + k] = 1.0 / (1.0 / scale[3 * i + k] + more)


@kernel
def add_forces(
    motion: Reals2,
    period: Periods,
    edges: EdgeArrays,
    scale: Reals1,
    x: Reals1,
    hessian: Reals2,
    yielding: Reals1,
    out: Reals1,
    cf: float,
    count: ti.i32,
    serial: Template,
):
    """Add dE / dx at the intermediate positions to ``out``, scaled, and set the ``hessian`` of each entry.

    Each row has a constant force ``pull`` in addition, and one that holds it. The hessian is c_f sigma / L (I - t t^T),
    its xx, xy and yy; ``yielding`` is 1 for rows that slide, whose holding force does not depend on ``x``.

    In an axisymmetric flow both times the mean of 2 pi r, with the force pi sigma L e_r and with c_f pi sigma t in the
    hessian. Of rows that are ``projects`` only the part along dV / dx is kept, see `SurfaceTensionTerm`.
    """
    ti.loop_config(serialize=serial)
    for r in range(count):
        i = edges.rows[r]
        force = ti.Vector([edges.pull[r, 0], edges.pull[r, 1]])
        for s in range(edges.offsets[r], edges.offsets[r + 1]):
            j = edges.other[s]
            side = ti.Vector([difference(motion, period, j, i, 0), difference(motion, period, j, i, 1)])
            for k in ti.static(range(2)):
                side[k] += cf * (x[3 * j + k] - x[3 * i + k])
            h = cf * stiffness(side, edges.sigma[s])
            if ti.static(len(period.shape) == 3):
                turn = ti.static(2.0 * np.pi)
                mean_r = 0.5 * (radius(motion, period, i) + radius(motion, period, j))
                mean_r += 0.5 * turn * cf * (x[3 * i] + x[3 * j])
                h *= mean_r
                force -= mean_r * edges.sigma[s] / side.norm() * side
                force[0] += 0.5 * turn * edges.sigma[s] * side.norm()
                t = 0.5 * turn * cf * edges.sigma[s] / side.norm() * side
                hessian[s, 3], hessian[s, 4] = t[0], t[1]
            else:
                force -= edges.sigma[s] / side.norm() * side
            for k in ti.static(range(3)):
                hessian[s, k] = h[k]
        if ti.static(len(period.shape) == 3):
            if edges.projects[r] != 0:  # along dV / dx alone; the Hessian is that without this
                n = ti.Vector([0.0, 0.0])
                xi, zi = motion[i, 0] + cf * x[3 * i], motion[i, 1] + cf * x[3 * i + 1]
                for k in ti.static(range(2)):
                    j = edges.other[edges.offsets[r] + k]
                    xj, zj = motion[j, 0] + cf * x[3 * j], motion[j, 1] + cf * x[3 * j + 1]
                    n += (1.0 - 2.0 * k) * ti.Vector([(2.0 * xi + xj) * (zi - zj), xi * xi + xi * xj + xj * xj])
                force = n.dot(force) / n.dot(n) * n + ti.Vector([edges.along[r, 0], edges.along[r, 1]])
        if edges.held[r, LARGEST] > 0.0:
            t, largest = ti.Vector([edges.held[r, 0], edges.held[r, 1]]), edges.held[r, LARGEST]
            drawn = edges.held[r, STIFFNESS] * (edges.held[r, DRAWN] + t[0] * x[3 * i] + t[1] * x[3 * i + 1])
            yielding[r] = 1.0 if ti.abs(drawn) > largest else 0.0
            force += ti.max(-largest, ti.min(largest, drawn)) * t
        for k in ti.static(range(2)):
            out[3 * i + k] = out[3 * i + k] + scale[3 * i + k] * force[k]


@kernel
def add_blocks(
    edges: EdgeArrays,
    hessian: Reals2,
    yielding: Reals1,
    scale: Reals1,
    matrix: Csr,
    period: Periods,
    nodes: ti.i32,
    count: ti.i32,
    serial: Template,
):
    """Add the hessians of all entries, and what holds rows, to a Jacobian of ``nodes`` that has its columns, scaled."""
    held, to = ti.static((edges.held, matrix.values))
    ti.loop_config(serialize=serial)
    for r in range(count):
        i, couplings = edges.rows[r], matrix.row_offsets[nodes]
        own = find_column(matrix.columns, matrix.row_offsets[i], matrix.row_offsets[i + 1], i)
        if held[r, LARGEST] > 0.0 and yielding[r] == 0.0:
            for k in ti.static(range(2)):
                for m in ti.static(range(2)):
                    one = block_entry(couplings, own, k, m, 2)
                    to[one] = to[one] + scale[3 * i + k] * held[r, STIFFNESS] * held[r, k] * held[r, m]
        for s in range(edges.offsets[r], edges.offsets[r + 1]):
            at = find_column(matrix.columns, matrix.row_offsets[i], matrix.row_offsets[i + 1], edges.other[s])
            beside = ti.Matrix([[-hessian[s, 0], -hessian[s, 1]], [-hessian[s, 1], -hessian[s, 2]]])
            here = -beside
            if ti.static(len(period.shape) == 3):
                # With t from i to j: d2E / dx_i dx_i has -(t e_r + e_r t), d2E / dx_i dx_j has e_r t - t e_r.
                for k in ti.static(range(2)):
                    t = hessian[s, 3 + k]
                    here[k, 0] -= t
                    here[0, k] -= t
                    beside[k, 0] -= t
                    beside[0, k] += t
            for k in ti.static(range(2)):
                for m in ti.static(range(2)):
                    one, two = block_entry(couplings, own, k, m, 2), block_entry(couplings, at, k, m, 2)
                    to[one] = to[one] + scale[3 * i + k] * here[k, m]
                    to[two] = to[two] + scale[3 * i + k] * beside[k, m]


ROUND = 0.05  # determinant of the mean of n n^T, over that of a sphere, above which a surface is not flat


class FacetArrays(NamedTuple):
    """Rows and their facets in CSR: those of the particle ``rows[r]`` are offsets[r] to offsets[r + 1]."""

    rows: "Ints1"  # nodes
    offsets: "Ints1"
    one: "Ints1"  # the two other corners of each entry's facet, in one order about its normal
    other: "Ints1"
    sigma: "Reals1"  # of each entry [N/m]
    pull: "Reals2"  # constant force on each row
    free: "Reals2"  # (R, 9) projectors on where rows may move, with what is along dV / dx alone
    surfaces: "Ints1"  # rows of each surface that hangs together, one behind the other: where they start, in
    members: "Ints1"  # all rows by their surface


@ti.func
def facet_at(motion: Template, period: Template, x: Template, cf, i, j, k):
    """Sides (3,) and (3,) of a facet from node i to the others, and twice its area vector, at intermediate places."""
    a, b = ti.Vector.zero(ti.f64, 3), ti.Vector.zero(ti.f64, 3)
    for m in ti.static(range(3)):
        a[m] = difference(motion, period, j, i, m) + cf * (x[4 * j + m] - x[4 * i + m])
        b[m] = difference(motion, period, k, i, m) + cf * (x[4 * k + m] - x[4 * i + m])
    return a, b, a.cross(b)


@kernel
def add_facet_diagonal(
    motion: Reals2, period: Periods, facets: FacetArrays, scale: Reals1, cf: float, count: ti.i32, serial: Template
):
    """Make the scale of momentum rows one over the sum of 1 / scale and the diagonal of tilts at the step's start."""
    ti.loop_config(serialize=serial)
    for r in range(count):
        i = facets.rows[r]
        total = ti.Vector.zero(ti.f64, 3)
        for s in range(facets.offsets[r], facets.offsets[r + 1]):
            a, b = ti.Vector.zero(ti.f64, 3), ti.Vector.zero(ti.f64, 3)
            for m in ti.static(range(3)):
                a[m] = difference(motion, period, facets.one[s], i, m)
                b[m] = difference(motion, period, facets.other[s], i, m)
            area = a.cross(b)
            n = area.normalized()
            total += cf * facets.sigma[s] * (a - b).norm_sqr() / (2.0 * area.norm()) * n * n
        for k in ti.static(range(3)):
            if scale[4 * i + k] > 0.0:
                scale[4 * i + k] = 1.0 / (1.0 / scale[4 * i + k] + total[k])


@kernel
def facet_forces(
    motion: Reals2,
    period: Periods,
    facets: FacetArrays,
    x: Reals1,
    hessian: Reals2,
    force: Reals2,
    cf: float,
    count: ti.i32,
    serial: Template,
):
    """Set dE / dx at the intermediate places as the first columns of ``force`` (R, 9), and the ``hessian`` (E, 18).

    The next columns are what is left out of it, and the last ones the unit vector along dV / dx.

    With g_a = dA / dx_a and the normal n the second derivatives of a facet's area A are

        d2A / dx_a dx_b = ((g_a . g_b) n n^T + g_a g_b^T - g_b g_a^T) / A

    those by its own place and by those of the two others, which are kept, sum to zero.
    """
    ti.loop_config(serialize=serial)
    for r in range(count):
        i = facets.rows[r]
        pull = ti.Vector([facets.pull[r, 0], facets.pull[r, 1], facets.pull[r, 2]])
        own_force, along = ti.Vector.zero(ti.f64, 3), ti.Vector.zero(ti.f64, 3)
        for s in range(facets.offsets[r], facets.offsets[r + 1]):
            a, b, normal = facet_at(motion, period, x, cf, i, facets.one[s], facets.other[s])
            size = normal.norm()
            n, sigma = normal / size, facets.sigma[s]
            own, one, other = 0.5 * (a - b).cross(n), 0.5 * b.cross(n), -0.5 * a.cross(n)
            own_force += sigma * own
            along += normal
            for k in ti.static(range(3)):
                for m in ti.static(range(3)):
                    factor = 2.0 * cf * sigma / size
                    hessian[s, 3 * k + m] = factor * (own.dot(one) * n[k] * n[m] + own[k] * one[m] - one[k] * own[m])
                    to_other = own.dot(other) * n[k] * n[m] + own[k] * other[m] - other[k] * own[m]
                    hessian[s, 9 + 3 * k + m] = factor * to_other
        own_force += pull
        free = ti.Matrix.zero(ti.f64, 3, 3)
        for k in ti.static(range(9)):
            free[k // 3, k % 3] = facets.free[r, k]
        along = free @ along
        along /= along.norm() + 1e-300
        left = free @ own_force - along.dot(own_force) * along
        for k in ti.static(range(3)):
            force[r, k], force[r, 3 + k], force[r, 6 + k] = own_force[k] - left[k], left[k], along[k]


@ti.func
def given_back(total, left):
    """(3,) w with (sum of n n^T) w = left for the sum ``total`` of all unit vectors n of a surface; 0 of a flat one."""
    w = ti.Vector.zero(ti.f64, 3)
    mean = total.trace() / 3.0
    if total.determinant() > ti.static(ROUND) * mean**3 and mean > 0.0:
        w = total.inverse() @ left
    return w


@kernel
def give_back(facets: FacetArrays, force: Reals2, surfaces: ti.i32, serial: Template):
    """Add to the forces (R, 9) of each surface what is left out of them in sum, as forces along their normals."""
    ti.loop_config(serialize=serial)
    for g in range(surfaces):
        total, left = ti.Matrix.zero(ti.f64, 3, 3), ti.Vector.zero(ti.f64, 3)
        for s in range(facets.surfaces[g], facets.surfaces[g + 1]):
            r = facets.members[s]
            n = ti.Vector([force[r, 6], force[r, 7], force[r, 8]])
            total += n.outer_product(n)
            left += ti.Vector([force[r, 3], force[r, 4], force[r, 5]])
        w = given_back(total, left)
        for s in range(facets.surfaces[g], facets.surfaces[g + 1]):
            r = facets.members[s]
            n = ti.Vector([force[r, 6], force[r, 7], force[r, 8]])
            for k in ti.static(range(3)):
                force[r, k] += n.dot(w) * n[k]


@kernel
def add_row_forces(facets: FacetArrays, force: Reals2, scale: Reals1, out: Reals1, count: ti.i32, serial: Template):
    """Add the forces of all rows to ``out``, scaled."""
    ti.loop_config(serialize=serial)
    for r in range(count):
        i = facets.rows[r]
        for k in ti.static(range(3)):
            out[4 * i + k] = out[4 * i + k] + scale[4 * i + k] * force[r, k]


@kernel
def add_facet_blocks(
    facets: FacetArrays, hessian: Reals2, scale: Reals1, matrix: Csr, nodes: ti.i32, count: ti.i32, serial: Template
):
    """Add the hessians of all entries to a Jacobian of ``nodes`` that has its columns, scaled."""
    to = ti.static(matrix.values)
    ti.loop_config(serialize=serial)
    for r in range(count):
        i, couplings = facets.rows[r], matrix.row_offsets[nodes]
        start, end = matrix.row_offsets[i], matrix.row_offsets[i + 1]
        own = find_column(matrix.columns, start, end, i)
        for s in range(facets.offsets[r], facets.offsets[r + 1]):
            one, other = (
                find_column(matrix.columns, start, end, facets.one[s]),
                find_column(matrix.columns, start, end, facets.other[s]),
            )
            for k in ti.static(range(3)):
                for m in ti.static(range(3)):
                    h, g = hessian[s, 3 * k + m], hessian[s, 9 + 3 * k + m]
                    at_own, at_one, at_other = (
                        block_entry(couplings, own, k, m, 3),
                        block_entry(couplings, one, k, m, 3),
                        block_entry(couplings, other, k, m, 3),
                    )
                    to[at_own] = to[at_own] - scale[4 * i + k] * (h + g)
                    to[at_one] = to[at_one] + scale[4 * i + k] * h
                    to[at_other] = to[at_other] + scale[4 * i + k] * g
