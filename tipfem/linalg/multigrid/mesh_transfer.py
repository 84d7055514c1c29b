"""Device functions of the multigrid cycle on the mesh: smoothing there, and transfers to and from the finest grid.

``vectors`` holds the cycle's vectors on the mesh, ``levels`` those on the grids, see `grid_hierarchy`; the matrix
on the mesh is in CSR. ``cell_lists`` holds the mesh nodes in each grid cell, cell by cell: those of grid cell c are
``cell_lists[cell_lists[c]:cell_lists[c + 1]]``.

``ties`` holds groups of mesh nodes at one place, where the mesh is cut: T = ties[0] groups, the first node of group t
in ties[1 + t], the others from ties[1 + T + t] on, before ties[2 + T + t]. Jacobi's method takes long to bring the
values on both sides of a cut together, which no grid does. So Gauss-Seidel's method follows it there, on one thread.
"""

import taichi as ti

from tipfem.backend.array_types import Ints1, Ints2, Reals1, Template
from tipfem.backend.barrier import GROUP, rounds
from tipfem.backend.launch import kernel
from tipfem.linalg.multigrid.grid_hierarchy import (
    DIAGONAL,
    LEVELS,
    REACH,
    RESIDUAL,
    RHS,
    SHAPE,
    SIZE,
    SOLUTION,
    STENCIL_WIDTH,
    cell_of,
    corners,
    entry,
    is_periodic,
    line_start,
    pitch,
    stencils_at,
    weight,
)
from tipfem.linalg.multigrid.grid_transfer import smooth_line
from tipfem.linalg.sparsity import Csr

OMEGA = 0.8  # damping of Jacobi's method
MESH_ROW = 30.0  # nanoseconds of one thread for a mesh node in `damped_inverse_diagonals`


@ti.func
def residual_row(matrix: Template, vectors: Template, x: Template, i, nodes):
    """b - A x in row ``i``: b is the right-hand side, x the vector of that number in ``vectors``."""
    residual = vectors[RHS * nodes + i]
    for s in range(matrix.row_offsets[i], matrix.row_offsets[i + 1]):
        residual -= matrix.values[s] * vectors[x * nodes + matrix.columns[s]]
    return residual


@ti.func
def pre_smooth_node(vectors: Template, i, nodes):
    """Damped Jacobi's method from x = 0 at mesh node ``i``: x = D b."""
    vectors[SOLUTION * nodes + i] = vectors[DIAGONAL * nodes + i] * vectors[RHS * nodes + i]


@ti.func
def correct_node(vectors: Template, coordinates: Template, levels: Template, grid: Template, i, nodes, dim: Template):
    """x plus the grids' correction at mesh node ``i``, written over the residual, where post-smoothing reads it."""
    vectors[RESIDUAL * nodes + i] = vectors[SOLUTION * nodes + i] + interpolated(coordinates, levels, grid, i, dim)


@ti.func
def post_smooth_node(matrix: Template, vectors: Template, i, nodes):
    """Damped Jacobi's method at mesh node ``i``, after `correct_node`; 0 where there is no equation."""
    residual = residual_row(matrix, vectors, RESIDUAL, i, nodes)
    diagonal = vectors[DIAGONAL * nodes + i]
    vectors[SOLUTION * nodes + i] = ti.select(diagonal > 0.0, vectors[RESIDUAL * nodes + i] + diagonal * residual, 0.0)


@ti.func
def restrict_to_line(
    vectors: Template,
    coordinates: Template,
    cell_lists: Template,
    levels: Template,
    grid: Template,
    line,
    first,
    last,
    nodes,
    dim: Template,
):
    """Nodes ``first`` to ``last`` - 1 of a line of P^T r on the finest grid, P linear interpolation, pre-smoothed."""
    to = grid[0, RHS] + line_start(grid, 0, line, dim)
    across = grid[0, SHAPE + 1]
    at = ti.Vector([line // across, line % across, 0])
    for j in range(first, last):
        at[2] = j
        total = 0.0
        for corner in ti.static(corners(dim)):
            # The grid cell of which this grid node is that corner, if there is one.
            cell = ti.Vector.zero(ti.i32, dim)
            number = 0
            inside = True
            for k in ti.static(range(dim)):
                cell[k] = at[3 - dim + k] - ti.static(corner[k])
                if ti.static(k >= dim - 2):
                    if cell[k] < 0 and is_periodic(grid, k, dim) == 1:
                        cell[k] += grid[0, SHAPE + 3 - dim + k]
                inside = inside and cell[k] >= 0
                number = number * grid[0, SHAPE + 3 - dim + k] + cell[k]
            if inside:
                for m in range(cell_lists[number], cell_lists[number + 1]):
                    i = cell_lists[m]
                    total += weight(coordinates, cell, i, corner, dim) * vectors[RESIDUAL * nodes + i]
        levels[to + j] = total
    smooth_line(levels, grid, 0, line, first, last, RHS, True, dim)


@ti.func
def interpolated(coordinates: Template, levels: Template, grid: Template, i, dim: Template):
    """The finest grid's solution, interpolated (multi-)linearly to mesh node ``i``."""
    cell = cell_of(coordinates, grid, i, dim)
    total = 0.0
    for corner in ti.static(corners(dim)):
        near = grid[0, SOLUTION] + entry(grid, 0, cell + ti.Vector(corner), dim)
        total += weight(coordinates, cell, i, corner, dim) * levels[near]
    return total


@ti.func
def tied_node(ties: Template, t):
    """The first node of group ``t``."""
    return ties[1 + t]


@ti.func
def copies_of(ties: Template, t):
    """The range of the other nodes of group ``t``: first, and last + 1."""
    return ties[1 + ties[0] + t], ties[2 + ties[0] + t]


@ti.func
def smooth_ties(matrix: Template, vectors: Template, ties: Template, nodes):
    """Gauss-Seidel's method for the solution at the nodes of all groups, one after the other."""
    for t in range(ties[0]):
        first, last = copies_of(ties, t)
        for j in range(first - 1, last):
            i = tied_node(ties, t) if j < first else j
            diagonal = matrix.values[matrix.row_offsets[i]]
            if diagonal > 0.0:
                residual = residual_row(matrix, vectors, SOLUTION, i, nodes)
                vectors[SOLUTION * nodes + i] = vectors[SOLUTION * nodes + i] + residual / diagonal


@kernel
def order_ties(ties: Ints1, place: Ints1, order: Ints1, nodes: ti.i32):
    """The K nodes of all groups in the ``order`` (K,) of `smooth_ties`, and the place (N,) of each there, else -1."""
    for i in range(nodes):
        place[i] = -1
    for t in range(ties[0]):
        first, last = copies_of(ties, t)
        start = copies_of(ties, 0)[0]
        for j in range(first - 1, last):
            i = tied_node(ties, t) if j < first else j
            place[i] = t + j + 1 - start
            order[place[i]] = i


@kernel
def count_earlier(row_offsets: Ints1, columns: Ints1, place: Ints1, order: Ints1, counts: Ints1, count: ti.i32):
    """counts[m + 1] (K + 1,): to how many earlier nodes of the order the row of node m has entries; counts[0] = 0."""
    for m in range(count):
        number = 0
        for s in range(row_offsets[order[m]], row_offsets[order[m] + 1]):
            if 0 <= place[columns[s]] and place[columns[s]] < m:
                number += 1
        counts[m + 1] = number
        if m == 0:
            counts[0] = 0


@kernel
def list_earlier(
    matrix: Csr, place: Ints1, order: Ints1, starts: Ints1, earlier: Ints1, weights: Reals1, count: ti.i32
):
    """The places of these nodes, ``earlier``, from starts[m] on, and the entries over the diagonal, ``weights``."""
    for m in range(count):
        at, diagonal = starts[m], matrix.values[matrix.row_offsets[order[m]]]
        for s in range(matrix.row_offsets[order[m]], matrix.row_offsets[order[m] + 1]):
            if 0 <= place[matrix.columns[s]] and place[matrix.columns[s]] < m:
                earlier[at], weights[at] = (
                    place[matrix.columns[s]],
                    ti.select(diagonal > 0.0, matrix.values[s] / diagonal, 0.0),
                )
                at += 1


@ti.func
def smooth_ties_with_group(matrix: Template, vectors: Template, tied: Template, thread, nodes):
    """`smooth_ties` by a group of a GPU's threads.

    They compute the steps at all nodes from those at earlier nodes, see `list_earlier`, until nothing changes: then
    these are, bit by bit, the steps that one node after the other would take. The changes fade within some ten sweeps.
    ``steps`` (2 K + 3,) is scratch.
    """
    flags = 2 * tied.size
    for k in range(rounds(tied.size, thread)):
        i = tied.order[k * GROUP + thread]
        diagonal = matrix.values[matrix.row_offsets[i]]
        residual = residual_row(matrix, vectors, SOLUTION, i, nodes)
        step = ti.select(diagonal > 0.0, residual / diagonal, 0.0)
        tied.steps[k * GROUP + thread], tied.steps[tied.size + k * GROUP + thread] = step, step
    if thread == 0:
        tied.steps[flags] = 0.0
    ti.simt.block.sync()
    sweep, changes = 0, 1.0
    while changes > 0.0 and sweep <= tied.size:
        # A flag is cleared a sweep before it is used, and read a sweep after.
        if thread == 0:
            tied.steps[flags + (sweep + 1) % 3] = 0.0
        for k in range(rounds(tied.size, thread)):
            m = k * GROUP + thread
            step = tied.steps[tied.size + m]
            for s in range(tied.starts[m], tied.starts[m + 1]):
                step -= tied.weights[s] * tied.steps[tied.earlier[s]]
            if step != tied.steps[m]:
                tied.steps[m] = step
                tied.steps[flags + sweep % 3] = 1.0
        ti.simt.block.sync()
        changes = tied.steps[flags + sweep % 3]
        sweep += 1
    for k in range(rounds(tied.size, thread)):
        at = SOLUTION * nodes + tied.order[k * GROUP + thread]
        vectors[at] = vectors[at] + tied.steps[k * GROUP + thread]


@kernel
def damped_inverse_diagonals(
    matrix: Csr, vectors: Reals1, levels: Reals1, grid: Ints2, nodes: ti.i32, dim: Template, serial: Template
):
    """OMEGA / a_ii of the matrix on the mesh and of the operators on all levels; 0 where there is no equation.

    On the coarsest level, which Gauss-Seidel solves without damping, 1 / a_ii. Elsewhere sum_j |a_ij| / 2 takes the
    place of a_ii where it is larger, as where angles are obtuse and entries positive: then no eigenvalue of D^-1 A, D
    without OMEGA, is above 2, by Gershgorin's theorem. With a_ii it may be 3 on triangles and 4 on tetrahedra, and on
    grids 4 and 8, where few particles of a jet or drop are in a cell. Jacobi's method diverges from 2 / OMEGA on.
    """
    ti.loop_config(serialize=serial)
    for i in range(nodes):
        own, total = 0.0, 0.0
        for s in range(matrix.row_offsets[i], matrix.row_offsets[i + 1]):
            total += ti.abs(matrix.values[s])
            if matrix.columns[s] == i:
                own = matrix.values[s]
        vectors[DIAGONAL * nodes + i] = ti.select(own > 0.0, OMEGA / ti.max(own, 0.5 * total, 1e-300), 0.0)
    ti.loop_config(serialize=serial)
    for t in range(grid[0, DIAGONAL], grid[grid[0, LEVELS] - 1, DIAGONAL] + grid[grid[0, LEVELS] - 1, SIZE]):
        level = 0
        while t >= grid[level, DIAGONAL] + grid[level, SIZE]:
            level += 1
        width = ti.static(STENCIL_WIDTH**dim)
        inside = t - grid[level, DIAGONAL]
        place = inside % pitch(grid, level) - REACH
        first = stencils_at(grid, level, inside - place, dim) + place
        own, damping = levels[first + width // 2 * pitch(grid, level)], 1.0
        if own > 0.0 and level < grid[0, LEVELS] - 1:
            total = 0.0
            for m in range(width):
                total += ti.abs(levels[first + m * pitch(grid, level)])
            own, damping = ti.max(own, 0.5 * total), OMEGA
        levels[t] = ti.select(own > 0.0, damping / own, 0.0)
