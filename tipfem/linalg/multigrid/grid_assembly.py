"""Kernels for the finest background grid: the grid cell of each mesh node, and the operator by a Galerkin product.

A mesh edge that spans more than the stencils' reach, as in a graded mesh where it is much coarser than the grid, is
replaced by a chain of springs: m of them, m times as stiff, with m - 1 nodes between them, its links. Eliminating
the links gives the edge back. So the grid's operator is accurate for functions that are smooth along the edge, and the
neighbours of every node of a chain are in adjacent grid cells.

Grids are laid out as in `grid_hierarchy`; for ``coordinates`` (N, d) of mesh nodes see `grid_hierarchy.cell_index`, for
``cell_lists`` `mesh_transfer`. Links are numbered after the N nodes of the mesh.
"""

import taichi as ti

from tipfem.backend.array_types import Ints1, Ints2, Reals1, Reals2, Template
from tipfem.backend.launch import kernel, part_of
from tipfem.linalg.multigrid.grid_hierarchy import (
    LAST_PERIOD,
    PERIOD,
    RESIDUAL,
    SHAPE,
    STENCIL_WIDTH,
    cell_number,
    cell_of,
    corners,
    is_periodic,
    line_at,
    line_of,
    line_shift,
    line_start,
    lines,
    nearest_image,
    node_count,
    pitch,
    stencils_at,
    weight,
)
from tipfem.linalg.sparsity import Csr, insertion_sort, post_increment

# Nanoseconds of one thread for a mesh node in `locate_nodes`; in `count_links` and `place_links`; in `multiply_rows`
# and `assemble_finest`.
LOCATE, CHAINS, PRODUCT = 10.0, 30.0, 60.0


@ti.func
def point_of(coordinates: Template, i, dim: Template):
    """Coordinates of node ``i`` as a vector (dim,)."""
    return ti.Vector([coordinates[i, k] for k in ti.static(range(dim))])


@ti.func
def edge_between(coordinates: Template, grid: Template, i, j, dim: Template):
    """Coordinates of node ``j`` less those of node ``i`` (dim,)."""
    return nearest_image(grid, point_of(coordinates, j, dim) - point_of(coordinates, i, dim), dim)


@ti.func
def spring_count(coordinates: Template, grid: Template, i, j, dim: Template):
    """Number of springs of the edge between two nodes: 1 if their grid cells are adjacent or the same."""
    shift = ti.abs(nearest_image(grid, cell_of(coordinates, grid, j, dim) - cell_of(coordinates, grid, i, dim), dim))
    number = 1
    if shift.max() > 1:
        edge = edge_between(coordinates, grid, i, j, dim)
        # Slightly more than the length, so that no spring spans a whole grid cell, whatever the round-off.
        number = ti.max(2, ti.cast(ti.ceil(ti.abs(edge).max() + 1e-9), ti.i32))
    return number


@ti.func
def add_hat(rows: Template, row, value, point, coordinates: Template, grid: Template, dim: Template):
    """Add ``value`` times the hat functions at ``point`` (dim,), in or beside the grid cell of ``row``, to that row."""
    cell = cell_of(coordinates, grid, row, dim)
    at, inside = ti.Vector.zero(ti.i32, dim), ti.Vector.zero(float, dim)
    for k in ti.static(range(dim)):
        index = ti.cast(ti.floor(point[k]), ti.i32)
        if is_periodic(grid, k, dim) == 0:
            index = ti.max(ti.min(index, grid[0, SHAPE + 3 - dim + k] - 2), 0)
        at[k], inside[k] = index - cell[k], point[k] - index
    for corner in ti.static(corners(dim)):
        entry = 0
        w = value
        for k in ti.static(range(dim)):
            entry = entry * 4 + at[k] + 1 + corner[k]
            w *= inside[k] if ti.static(corner[k] == 1) else 1.0 - inside[k]
        rows[row, entry] = rows[row, entry] + w


@kernel
def locate_nodes(
    position: Reals2,
    lower: Reals1,
    grid: Ints2,
    coordinates: Reals2,
    cell_lists: Ints1,
    spacing: Reals1,
    nodes: ti.i32,
    cells: ti.i32,
    dim: Template,
    serial: Template,
):
    """Coordinates (N, d) of mesh nodes in the grid; cell_lists[c + 1]: number in cell c, [0]: where lists begin."""
    ti.loop_config(serialize=serial)
    for c in range(cells + 1):
        cell_lists[c] = cells + 1 if c == 0 else 0
    ti.loop_config(serialize=serial)
    for i in range(nodes):
        for k in ti.static(range(dim)):
            coordinates[i, k] = (position[i, k] - lower[k]) / spacing[k]
        post_increment(cell_lists, cell_number(coordinates, grid, i, dim) + 1, serial)


@kernel
def count_links(
    matrix: Csr, coordinates: Reals2, grid: Ints2, links: Ints1, nodes: ti.i32, dim: Template, serial: Template
):
    """links[i + 1] (N + 1,): number of links in the chains from node ``i`` to its neighbours of higher number."""
    ti.loop_config(serialize=serial)
    for i in range(nodes):
        number = 0
        for s in range(matrix.row_offsets[i], matrix.row_offsets[i + 1]):
            if matrix.columns[s] > i and matrix.values[s] < 0.0:
                number += spring_count(coordinates, grid, i, matrix.columns[s], dim) - 1
        links[i + 1] = number
        if i == 0:
            links[0] = 0


@kernel
def place_links(
    matrix: Csr,
    coordinates: Reals2,
    links: Ints1,
    rows: Reals2,
    vectors: Reals1,
    cell_lists: Ints1,
    grid: Ints2,
    nodes: ti.i32,
    dim: Template,
    serial: Template,
):
    """Coordinates and rows of the links, their residual, always 0, in ``vectors``, their number in ``cell_lists``."""
    ti.loop_config(serialize=serial)
    for i in range(nodes):
        link = nodes + links[i]
        for s in range(matrix.row_offsets[i], matrix.row_offsets[i + 1]):
            j = matrix.columns[s]
            if j > i and matrix.values[s] < 0.0:
                m = spring_count(coordinates, grid, i, j, dim)
                start = point_of(coordinates, i, dim)
                piece = edge_between(coordinates, grid, i, j, dim) / m
                for n in range(1, m):
                    here = start + n * piece
                    for k in ti.static(range(2)):
                        if grid[0, PERIOD + k] > 0:
                            here[dim - 2 + k] -= grid[0, PERIOD + k] * ti.floor(here[dim - 2 + k] / grid[0, PERIOD + k])
                    for k in ti.static(range(dim)):
                        coordinates[link, k] = here[k]
                    vectors[RESIDUAL * nodes + link] = 0.0
                    for q in range(ti.static(4**dim)):
                        rows[link, q] = 0.0
                    stiffness = -m * matrix.values[s]
                    add_hat(rows, link, 2 * stiffness, here, coordinates, grid, dim)
                    add_hat(rows, link, -stiffness, here - piece, coordinates, grid, dim)
                    add_hat(rows, link, -stiffness, here + piece, coordinates, grid, dim)
                    link += 1
    ti.loop_config(serialize=serial)
    for link in range(nodes, nodes + links[nodes]):
        post_increment(cell_lists, cell_number(coordinates, grid, link, dim) + 1, serial)


@kernel
def fill_lists(
    coordinates: Reals2,
    grid: Ints2,
    cell_lists: Ints1,
    cursor: Ints1,
    nodes: ti.i32,
    cells: ti.i32,
    dim: Template,
    one_counts: Template,
):
    """Fill ``cell_lists`` with the nodes of each grid cell in ascending order; cursor (cells,): where lists begin."""
    ti.loop_config(serialize=one_counts)
    for i in range(nodes):
        cell_lists[post_increment(cursor, cell_number(coordinates, grid, i, dim), one_counts)] = i
    if ti.static(not one_counts):
        for c in range(cells):
            insertion_sort(cell_lists, cell_lists[c], cell_lists[c + 1])


@ti.func
def _add_cell(
    coordinates: Template,
    cell_lists: Template,
    rows: Template,
    levels: Template,
    grid: Template,
    number,
    one,
    two,
    j,
    dim: Template,
):
    """Add P^T times the rows of the mesh nodes in grid cell ``number`` to its corners' stencils."""
    corner_count = ti.static(len(corners(dim)))
    first, last = cell_lists[number], cell_lists[number + 1]
    # ``grid`` is read before anything is written: the compiler would read it again after a write.
    size, at = pitch(grid, 0), ti.Vector.zero(ti.i32, corner_count)
    cell = ti.Vector.zero(ti.i32, dim)
    for k in ti.static(range(dim)):
        cell[k] = ti.Vector([one, two, j])[3 - dim + k]
    for k in ti.static(range(corner_count)):
        corner = ti.static(corners(dim)[k])
        if ti.static(dim == 3):
            at[k] = stencils_at(grid, 0, line_at(grid, 0, one + corner[0], two + corner[1], dim), dim) + j + corner[2]
        else:
            inside = line_at(grid, 0, one, two, dim) + line_shift(grid, 0, two, corner[0])
            at[k] = stencils_at(grid, 0, inside, dim) + j + corner[1]
            if ti.static(corner[1] == 1):
                if j + 1 == grid[0, LAST_PERIOD]:
                    at[k] -= grid[0, LAST_PERIOD]
    for q in range(ti.static(4 ** (dim - 1))):
        # Row q of the 4^d grid nodes around the grid cell.
        total = ti.Matrix.zero(float, corner_count, 4)
        for m in range(first, last):
            i = cell_lists[m]
            for k in ti.static(range(corner_count)):
                w = weight(coordinates, cell, i, ti.static(corners(dim)[k]), dim)
                for u in ti.static(range(4)):
                    total[k, u] += w * rows[i, q * 4 + u]
        for k in ti.static(range(corner_count)):
            corner = ti.static(corners(dim)[k])
            row = q + 1 - corner[0]
            if ti.static(dim == 3):
                row = (q // 4 + 1 - corner[0]) * STENCIL_WIDTH + q % 4 + 1 - corner[1]
            for u in ti.static(range(4)):
                to = (row * STENCIL_WIDTH + u + 1 - corner[dim - 1]) * size + at[k]
                levels[to] = levels[to] + total[k, u]


@kernel
def multiply_rows(
    coordinates: Reals2, matrix: Csr, rows: Reals2, grid: Ints2, nodes: ti.i32, dim: Template, serial: Template
):
    """A P of the Galerkin product P^T A P: ``rows`` (N, 4^d) of the mesh on the grid nodes around the node's grid cell.

    Long edges with positive entries, whose springs would be of negative stiffness, are left out with their part of the
    diagonal, so that rows still sum to zero.
    """
    ti.loop_config(serialize=serial)
    for i in range(nodes):
        for s in range(ti.static(4**dim)):
            rows[i, s] = 0.0
        own, own_cell = point_of(coordinates, i, dim), cell_of(coordinates, grid, i, dim)
        for s in range(matrix.row_offsets[i], matrix.row_offsets[i + 1]):
            j = matrix.columns[s]
            m = spring_count(coordinates, grid, i, j, dim)
            if m == 1:
                cell = cell_of(coordinates, grid, j, dim)
                shift = nearest_image(grid, cell - own_cell, dim)
                for corner in ti.static(corners(dim)):
                    entry = 0
                    for k in ti.static(range(dim)):
                        entry = entry * 4 + shift[k] + 1 + corner[k]
                    rows[i, entry] = rows[i, entry] + matrix.values[s] * weight(coordinates, cell, j, corner, dim)
            elif matrix.values[s] < 0.0:
                piece = edge_between(coordinates, grid, i, j, dim) / m
                add_hat(rows, i, m * matrix.values[s], own + piece, coordinates, grid, dim)
                add_hat(rows, i, (1 - m) * matrix.values[s], own, coordinates, grid, dim)
            else:
                add_hat(rows, i, matrix.values[s], own, coordinates, grid, dim)


@kernel
def assemble_finest(
    coordinates: Reals2,
    cell_lists: Ints1,
    rows: Reals2,
    levels: Reals1,
    grid: Ints2,
    dim: Template,
    parts: ti.i32,
    stride: Template,
    serial: Template,
):
    """Product P^T A P on the finest grid: each cell adds its nodes' and links' ``rows`` of A P to its corners."""
    ti.loop_config(serialize=serial)
    for t in range(parts * stride):
        first, last = part_of(t, parts, stride, lines(grid, 0))
        for line in range(first, last):
            at, width = stencils_at(grid, 0, line_start(grid, 0, line, dim), dim), grid[0, SHAPE + 2]
            for offset in range(ti.static(STENCIL_WIDTH**dim)):
                entries = at + offset * pitch(grid, 0)
                for j in range(width):
                    levels[entries + j] = 0.0
    # Lines of grid cells add to the lines of grid nodes on either side: lines that share none have the same colour.
    for colour in ti.static(corners(dim - 1)):
        ti.loop_config(serialize=serial)
        for t in range(parts * stride):
            first, last = part_of(t, parts, stride, lines(grid, 0))
            for line in range(first, last):
                one, two = line // grid[0, SHAPE + 1], line % grid[0, SHAPE + 1]
                has_colour = two % 2 == colour[dim - 2]
                if ti.static(dim == 3):
                    has_colour = has_colour and one % 2 == colour[0]
                if has_colour:
                    for j in range(grid[0, SHAPE + 2]):
                        number = line * grid[0, SHAPE + 2] + j
                        if cell_lists[number + 1] > cell_lists[number]:
                            _add_cell(coordinates, cell_lists, rows, levels, grid, number, one, two, j, dim)


@kernel
def assemble_by_nodes(coordinates: Reals2, cell_lists: Ints1, rows: Reals2, levels: Reals1, grid: Ints2, dim: Template):
    """`assemble_finest` for GPUs, whose threads take a grid node or cell each."""
    for node in range(node_count(grid, 0)):
        line, j = line_of(grid, 0, node)
        entries = stencils_at(grid, 0, line_start(grid, 0, line, dim), dim) + j
        for offset in range(ti.static(STENCIL_WIDTH**dim)):
            levels[entries + offset * pitch(grid, 0)] = 0.0
    for colour in ti.static(corners(dim)):
        for node in range(node_count(grid, 0)):
            line, j = line_of(grid, 0, node)
            one, two = line // grid[0, SHAPE + 1], line % grid[0, SHAPE + 1]
            has_colour = j % 2 == colour[dim - 1] and two % 2 == colour[dim - 2]
            if ti.static(dim == 3):
                has_colour = has_colour and one % 2 == colour[0]
            if has_colour and cell_lists[node + 1] > cell_lists[node]:
                _add_cell(coordinates, cell_lists, rows, levels, grid, node, one, two, j, dim)
