"""Kernels that bring the mesh to the finest background grid: which cell each node is in, and the operator there.

A mesh edge that spans more than the stencils' reach - of a mesh much coarser than the grid, as graded ones are in
places - is replaced by a chain of springs: m of them, m times as stiff, with m - 1 further nodes between, its links. To
those who know the two ends alone the chain is the edge: eliminating the links gives it back. So the grid's operator is
right for all that is smooth along the edge, and every node of a chain has neighbours in the next cells only.

Arrays of the grid are laid out as in `grid_hierarchy`. Links are numbered behind the N nodes of the mesh.
"""

import taichi as ti

from tipfem.backend.launch import kernel, part_of
from tipfem.linalg.multigrid.grid_hierarchy import (
    PLACES,
    SHAPE,
    SIZE,
    cell_number,
    corners,
    line_at,
    line_start,
    lines,
    weight,
)
from tipfem.linalg.sparsity import insertion_sort, take


@ti.func
def settle(
    scaled: ti.template(), cell: ti.template(), fraction: ti.template(), grid: ti.template(), i, dim: ti.template()
):
    """Set the cell of node ``i`` and where in it the node is, from its place in sides of the cells."""
    for k in ti.static(range(dim)):
        index = ti.cast(ti.floor(scaled[k]), ti.i32)
        index = ti.max(ti.min(index, grid[0, SHAPE + 3 - dim + k] - 2), 0)
        cell[i, k] = index
        fraction[i, k] = scaled[k] - index


@ti.func
def place_of(cell: ti.template(), fraction: ti.template(), i, dim: ti.template()):
    """Place (dim,) of node ``i`` in sides of the cells."""
    return ti.Vector([cell[i, k] + fraction[i, k] for k in ti.static(range(dim))])


@ti.func
def springs(cell: ti.template(), fraction: ti.template(), i, j, dim: ti.template()):
    """Of how many springs the edge between two nodes consists: 1 if their cells are neighbours or the same."""
    shift = ti.Vector([ti.abs(cell[j, k] - cell[i, k]) for k in ti.static(range(dim))])
    number = 1
    if shift.max() > 1:
        way = place_of(cell, fraction, j, dim) - place_of(cell, fraction, i, dim)
        # A little more than the length: no spring then reaches over a whole cell, whatever the round-off.
        number = ti.max(2, ti.cast(ti.ceil(ti.abs(way).max() + 1e-9), ti.i32))
    return number


@ti.func
def add_hat(
    rows: ti.template(), row, value, scaled: ti.template(), cell: ti.template(), grid: ti.template(), dim: ti.template()
):
    """Add ``value`` times the hat functions at a place, in or beside the cell of ``row``, to that row."""
    at, inside = ti.Vector.zero(ti.i32, dim), ti.Vector.zero(float, dim)
    for k in ti.static(range(dim)):
        index = ti.max(ti.min(ti.cast(ti.floor(scaled[k]), ti.i32), grid[0, SHAPE + 3 - dim + k] - 2), 0)
        at[k], inside[k] = index - cell[row, k], scaled[k] - index
    for corner in ti.static(corners(dim)):
        place = 0
        w = value
        for k in ti.static(range(dim)):
            place = place * 4 + at[k] + 1 + corner[k]
            w *= inside[k] if ti.static(corner[k] == 1) else 1.0 - inside[k]
        rows[row, place] = rows[row, place] + w


@kernel
def count_links(
    row_offsets: ti.types.ndarray(),
    columns: ti.types.ndarray(),
    values: ti.types.ndarray(),
    cell: ti.types.ndarray(),
    fraction: ti.types.ndarray(),
    links: ti.types.ndarray(),
    nodes: ti.i32,
    dim: ti.template(),
    serial: ti.template(),
):
    """links[i + 1] (N + 1,): how many links the chains from node ``i`` to its neighbours of higher number have."""
    ti.loop_config(serialize=serial)
    for i in range(nodes):
        number = 0
        for s in range(row_offsets[i], row_offsets[i + 1]):
            if columns[s] > i and values[s] < 0.0:
                number += springs(cell, fraction, i, columns[s], dim) - 1
        links[i + 1] = number
        if i == 0:
            links[0] = 0


@kernel
def lay_links(
    row_offsets: ti.types.ndarray(),
    columns: ti.types.ndarray(),
    values: ti.types.ndarray(),
    cell: ti.types.ndarray(),
    fraction: ti.types.ndarray(),
    links: ti.types.ndarray(),
    rows: ti.types.ndarray(),
    residual: ti.types.ndarray(),
    count: ti.types.ndarray(),
    grid: ti.types.ndarray(),
    nodes: ti.i32,
    dim: ti.template(),
    serial: ti.template(),
):
    """Cells, fractions and rows of the links, and their ``residual``, which is always zero; in ``count`` their cells
    have one node more for each.
    """
    ti.loop_config(serialize=serial)
    for i in range(nodes):
        link = nodes + links[i]
        for s in range(row_offsets[i], row_offsets[i + 1]):
            j = columns[s]
            if j > i and values[s] < 0.0:
                m = springs(cell, fraction, i, j, dim)
                start = place_of(cell, fraction, i, dim)
                piece = (place_of(cell, fraction, j, dim) - start) / m
                for n in range(1, m):
                    here = start + n * piece
                    settle(here, cell, fraction, grid, link, dim)
                    residual[link] = 0.0
                    for q in range(ti.static(4**dim)):
                        rows[link, q] = 0.0
                    stiffness = -m * values[s]
                    add_hat(rows, link, 2 * stiffness, here, cell, grid, dim)
                    add_hat(rows, link, -stiffness, here - piece, cell, grid, dim)
                    add_hat(rows, link, -stiffness, here + piece, cell, grid, dim)
                    take(count, cell_number(cell, grid, link, dim) + 1, serial)
                    link += 1


@kernel
def find_cells(
    position: ti.types.ndarray(),
    lower: ti.types.ndarray(),
    grid: ti.types.ndarray(),
    cell: ti.types.ndarray(),
    fraction: ti.types.ndarray(),
    count: ti.types.ndarray(),
    spacing: float,
    nodes: ti.i32,
    cells: ti.i32,
    dim: ti.template(),
    serial: ti.template(),
):
    """cell (N, d) of each mesh node and where in it, fraction (N, d) of its side; count[c + 1]: nodes in cell c."""
    ti.loop_config(serialize=serial)
    for c in range(cells + 1):
        count[c] = 0
    ti.loop_config(serialize=serial)
    for i in range(nodes):
        scaled = ti.Vector([(position[i, k] - lower[k]) / spacing for k in ti.static(range(dim))])
        settle(scaled, cell, fraction, grid, i, dim)
        take(count, cell_number(cell, grid, i, dim) + 1, serial)


@kernel
def sort_into_cells(
    cell: ti.types.ndarray(),
    grid: ti.types.ndarray(),
    start: ti.types.ndarray(),
    cursor: ti.types.ndarray(),
    order: ti.types.ndarray(),
    nodes: ti.i32,
    cells: ti.i32,
    dim: ti.template(),
    one_counts: ti.template(),
):
    """order (N,): the mesh nodes cell by cell, in ascending order; those of cell c from start[c] on."""
    ti.loop_config(serialize=one_counts)
    for i in range(nodes):
        order[take(cursor, cell_number(cell, grid, i, dim), one_counts)] = i
    if ti.static(not one_counts):
        for c in range(cells):
            insertion_sort(order, start[c], start[c + 1])


@ti.func
def _add_cell(
    fraction: ti.template(),
    order: ti.template(),
    rows: ti.template(),
    stencil: ti.template(),
    grid: ti.template(),
    first,
    last,
    one,
    two,
    j,
    dim: ti.template(),
):
    """Add P^T times the rows of the mesh nodes order[first:last], all those of a cell, to its corners' stencils."""
    number = ti.static(len(corners(dim)))
    # All of the grid is read before anything is written: the compiler does not keep what it has read beyond that.
    size, at = grid[0, SIZE], ti.Vector.zero(ti.i32, number)
    for k in ti.static(range(number)):
        corner = ti.static(corners(dim)[k])
        if ti.static(dim == 3):
            at[k] = line_at(grid, 0, one + corner[0], two + corner[1], dim) + j + corner[2]
        else:
            at[k] = line_at(grid, 0, one, two + corner[0], dim) + j + corner[1]
    for q in range(ti.static(4 ** (dim - 1))):
        # Row q of the 4^d grid nodes around the cell.
        total = ti.Matrix.zero(float, number, 4)
        for m in range(first, last):
            i = order[m]
            for k in ti.static(range(number)):
                w = weight(fraction, i, ti.static(corners(dim)[k]), dim)
                for u in ti.static(range(4)):
                    total[k, u] += w * rows[i, q * 4 + u]
        for k in ti.static(range(number)):
            corner = ti.static(corners(dim)[k])
            row = q + 1 - corner[0]
            if ti.static(dim == 3):
                row = (q // 4 + 1 - corner[0]) * PLACES + q % 4 + 1 - corner[1]
            for u in ti.static(range(4)):
                to = (row * PLACES + u + 1 - corner[dim - 1]) * size + at[k]
                stencil[to] = stencil[to] + total[k, u]


@kernel
def assemble_first(
    cell: ti.types.ndarray(),
    fraction: ti.types.ndarray(),
    order: ti.types.ndarray(),
    start: ti.types.ndarray(),
    row_offsets: ti.types.ndarray(),
    columns: ti.types.ndarray(),
    values: ti.types.ndarray(),
    rows: ti.types.ndarray(),
    stencil: ti.types.ndarray(),
    grid: ti.types.ndarray(),
    nodes: ti.i32,
    dim: ti.template(),
    parts: ti.i32,
    stride: ti.template(),
    serial: ti.template(),
):
    """Galerkin product P^T A P on the finest grid.

    First A P, row by row of the mesh: ``rows`` (N, 4^d) on the grid nodes around the node's cell. Then each cell adds,
    for its mesh nodes and links, to its 2^d corners. Long connections that pull nodes apart are left out,
    with their part of the diagonal, so that rows still sum to zero. Rows of the links must be there already.
    """
    ti.loop_config(serialize=serial)
    for i in range(nodes):
        for s in range(ti.static(4**dim)):
            rows[i, s] = 0.0
        own = place_of(cell, fraction, i, dim)
        for s in range(row_offsets[i], row_offsets[i + 1]):
            j = columns[s]
            m = springs(cell, fraction, i, j, dim)
            if m == 1:
                shift = ti.Vector([cell[j, k] - cell[i, k] for k in ti.static(range(dim))])
                for corner in ti.static(corners(dim)):
                    place = 0
                    for k in ti.static(range(dim)):
                        place = place * 4 + shift[k] + 1 + corner[k]
                    rows[i, place] = rows[i, place] + values[s] * weight(fraction, j, corner, dim)
            elif values[s] < 0.0:
                piece = (place_of(cell, fraction, j, dim) - own) / m
                add_hat(rows, i, m * values[s], own + piece, cell, grid, dim)
                add_hat(rows, i, (1 - m) * values[s], own, cell, grid, dim)
            else:
                add_hat(rows, i, values[s], own, cell, grid, dim)
    ti.loop_config(serialize=serial)
    for t in range(parts * stride):
        first, last = part_of(t, parts, stride, lines(grid, 0))
        for line in range(first, last):
            at, size, width = line_start(grid, 0, line, dim), grid[0, SIZE], grid[0, SHAPE + 2]
            for place in range(ti.static(PLACES**dim)):
                for j in range(width):
                    stencil[place * size + at + j] = 0.0
    # Lines of cells add to the lines of nodes on either side: those that have none in common go together.
    for colour in ti.static(corners(dim - 1)):
        ti.loop_config(serialize=serial)
        for t in range(parts * stride):
            first, last = part_of(t, parts, stride, lines(grid, 0))
            for line in range(first, last):
                one, two = line // grid[0, SHAPE + 1], line % grid[0, SHAPE + 1]
                turn = two % 2 == colour[dim - 2]
                if ti.static(dim == 3):
                    turn = turn and one % 2 == colour[0]
                if turn:
                    for j in range(grid[0, SHAPE + 2]):
                        c = line * grid[0, SHAPE + 2] + j
                        if start[c + 1] > start[c]:
                            _add_cell(fraction, order, rows, stencil, grid, start[c], start[c + 1], one, two, j, dim)
