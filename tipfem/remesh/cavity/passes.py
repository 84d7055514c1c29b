"""Kernels that pass over all cells or particles of a mesh: measures, marks, what spreads on edges."""

import math

import taichi as ti

from tipfem.backend.array_types import Flags1, Flags2, Ints1, Ints2, Reals1, Reals2, Template
from tipfem.backend.launch import kernel
from tipfem.backend.union_find import find_root
from tipfem.fem.element import measure_of
from tipfem.remesh.cavity.arrays import ON, Simplices, gradient
from tipfem.remesh.claims import raise_to

MEASURE, RAISE, SUM, SPREAD, FACES, VECTORS = 15.0, 5.0, 10.0, 120.0, 10.0, 60.0  # ns of a thread for each entry


@kernel
def measure(x: Reals2, cells: Ints2, out: Reals1, dim: Template, serial: Template):
    """Set the measure (M,) of each cell (M, d + 1), 0 for rows that never were in use."""
    ti.loop_config(serialize=serial)
    for t in range(cells.shape[0]):
        out[t] = 0.0
        if cells[t, 0] >= 0:
            out[t] = measure_of(x, cells, t, dim)


@kernel
def raise_corners(cells: Ints2, value: Ints1, out: Ints1, serial: Template):
    """Raise out (N,) to the largest value (M,) of the cells that each particle is in."""
    ti.loop_config(serialize=serial)
    for t in range(value.shape[0]):
        for k in range(cells.shape[1]):
            if cells[t, k] >= 0 and out[cells[t, k]] < value[t]:
                raise_to(out, cells[t, k], value[t], serial)


@kernel
def sum_corners(cells: Ints2, values: Reals2, out: Reals2, dim: Template, width: Template, serial: Template):
    """Set the sums (M, C) of values (N, C) over the corners of cells (M, d + 1); C is ``width``."""
    ti.loop_config(serialize=serial)
    for t in range(cells.shape[0]):
        for column in ti.static(range(width)):
            total = 0.0
            for k in ti.static(range(dim + 1)):
                total += values[cells[t, k], column]
            out[t, column] = total


@kernel
def spread(
    offsets: Ints1,
    corners: Ints1,
    rows: Ints1,
    sums: Reals2,
    before: Reals2,
    after: Reals2,
    along: Reals2,
    own: Reals2,
    width: Template,
    serial: Template,
):
    """Set ``after`` (N, C), at some ``rows`` (R,) of particles and nodes, to the mean of ``before`` around each.

    The corners at each are in CSR, see `Mesh.incidence`; a neighbour counts once for each cell of both. ``sums`` are
    those of `sum_corners`. What the first rows have of their ``own`` (A, C) changes ``along`` (A, C C) projectors only.
    """
    ti.loop_config(serialize=serial)
    for i in range(rows.shape[0]):
        p = rows[i]
        start, end = offsets[p], offsets[p + 1]
        mean = ti.Vector.zero(ti.f64, width)
        for j in range(start, end):
            c = corners[j] // 4
            for column in ti.static(range(width)):
                mean[column] += sums[c, column]
        for column in ti.static(range(width)):
            mean[column] = (mean[column] - (end - start) * before[p, column]) / ti.max(3 * (end - start), 1)
        if i < own.shape[0]:
            for column in ti.static(range(width)):
                after[p, column] = own[i, column]
                for other in ti.static(range(width)):
                    after[p, column] += along[i, column * width + other] * (mean[other] - own[i, other])
        else:
            for column in ti.static(range(width)):
                after[p, column] = mean[column]


@kernel
def name_walls(mesh: Simplices, planes: Flags2, kinds: Ints1, serial: Template):
    """Set across, where that is -1, to -2 - kinds[s] for the first of S planes (N, S) that a face's particles are on.

    kinds (S + 1,): its last entry is of faces on no plane.
    """
    ti.loop_config(serialize=serial)
    for t in range(mesh.cells.shape[0]):
        for i in range(mesh.dim + 1):
            if mesh.across[t, i] < 0:
                s, found = 0, False
                while s < planes.shape[1] and not found:
                    found = True
                    for k in range(1, mesh.dim + 1):
                        found = found and planes[mesh.cells[t, (i + k) % (mesh.dim + 1)], s] != 0
                    s += ti.select(found, 0, 1)
                mesh.across[t, i] = -2 - kinds[s]


@kernel
def touch(cells: Ints2, some: Flags1, out: Flags1, serial: Template):
    """Mark in ``out`` (M,) the cells that have one of ``some`` particles (N,); none of those in unused rows."""
    ti.loop_config(serialize=serial)
    for t in range(cells.shape[0]):
        found = 0
        for k in range(cells.shape[1]):
            if cells[t, k] >= 0:
                found |= ti.i32(some[cells[t, k]])
        out[t] = ti.i8(found)


@kernel
def take(mesh: Simplices, some: Ints1, number: Ints1, cells: Ints2, across: Ints2, label: Ints1, serial: Template):
    """Take ``some`` cells (K,) of a mesh; ``number`` (M,) is that of each, -1 for others."""
    ti.loop_config(serialize=serial)
    for k in range(some.shape[0]):
        t = some[k]
        label[k] = mesh.label[t]
        for i in ti.static(range(mesh.dim + 1)):
            o = mesh.across[t, i]
            cells[k, i], across[k, i] = mesh.cells[t, i], -1
            if o >= 0:
                across[k, i] = number[o]


@kernel
def join_patches(cells: Ints2, parent: Ints1, number: Ints1, patch: Ints1) -> ti.i32:
    """Set the patch (M,) of each cell, numbered by their first cells, and return how many there are.

    Cells that share particles are of one; parent, number (N,): scratch.
    """
    count = 0
    ti.loop_config(serialize=True)
    for _ in range(1):
        for t in range(cells.shape[0]):
            for k in range(cells.shape[1]):
                parent[cells[t, k]], number[cells[t, k]] = cells[t, k], -1
        for t in range(cells.shape[0]):
            one = find_root(parent, cells[t, 0])
            for k in range(1, cells.shape[1]):
                parent[find_root(parent, cells[t, k])] = one
        for t in range(cells.shape[0]):
            root = find_root(parent, cells[t, 0])
            if number[root] < 0:
                number[root] = count
                count += 1
            patch[t] = number[root]
    return count


@kernel
def mark_interfaces(mesh: Simplices, serial: Template):
    """Mark the particles that are `ON` interfaces, and no others."""
    ti.loop_config(serialize=serial)
    for p in range(mesh.marks.shape[0]):
        mesh.marks[p] &= ~ON
    ti.loop_config(serialize=serial)
    for t in range(mesh.cells.shape[0]):
        if mesh.label[t] >= 0:
            for i in ti.static(range(mesh.dim + 1)):
                o = mesh.across[t, i]
                if o >= 0:
                    if mesh.label[o] != mesh.label[t]:
                        for k in ti.static(range(1, mesh.dim + 1)):
                            mesh.marks[mesh.cells[t, (i + k) % (mesh.dim + 1)]] |= ON


@kernel
def compare(
    before: Reals2,
    cells: Ints2,
    label: Ints1,
    mesh: Simplices,
    is_new: Flags1,
    gone: Flags1,
    come: Flags1,
    serial: Template,
):
    """Mark the cells of a mesh that are ``gone`` (M',), and those that have ``come`` (M,), in it as it is now.

    Those of particles that have moved from ``before`` are both; the mesh has new rows behind its old ones.
    """
    ti.loop_config(serialize=serial)
    for t in range(mesh.cells.shape[0]):
        same = False
        if t < cells.shape[0]:
            same = mesh.label[t] == label[t]
            for i in ti.static(range(mesh.dim + 1)):
                p = cells[t, i]
                same = same and mesh.cells[t, i] == p and is_new[p] == 0
                for k in ti.static(range(mesh.dim)):
                    same = same and before[p, k] == mesh.x[p, k]
            gone[t] = ti.select(same, 0, 1)
        come[t] = ti.select(same or mesh.label[t] < 0, 0, 1)


@kernel
def measure_gradients(mesh: Simplices, rows: Ints1, turn: Ints1, along: Reals2, out: Reals2, serial: Template):
    """Set out (K, (d + 1) d): the gradients of the measures of the cells ``rows`` by the places of their corners.

    They are projected by row turn[p] of ``along`` (A, d d), and zero where this is -1.
    """
    ti.loop_config(serialize=serial)
    for r in range(rows.shape[0]):
        t = rows[r]
        for i in ti.static(range(mesh.dim + 1)):
            s, g = turn[mesh.cells[t, i]], gradient(mesh, t, i) / ti.static(float(math.factorial(mesh.dim)))
            for a in ti.static(range(mesh.dim)):
                total = 0.0
                if s >= 0:
                    for b in ti.static(range(mesh.dim)):
                        total += along[s, a * mesh.dim + b] * g[b]
                out[r, i * mesh.dim + a] = total
