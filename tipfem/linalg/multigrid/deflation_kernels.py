"""Kernels that set the level of pressure in bubbles of a light fluid in a heavy one.

Inside a bubble the pressure Laplacian is as many times stronger than around it as the outer fluid is heavier: the
pressure of the whole bubble can be wrong by a constant that no smoothing sees, and a bubble smaller than the cells of
the background grid no coarse grid either. So each bubble is a coarse unknown of its own.
"""

import taichi as ti

from tipfem.backend.launch import kernel


@ti.func
def root(parent: ti.template(), i):
    """The particle that stands for all that are connected with particle i; halves the way there for the next time."""
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


@kernel
def connect_light(
    cells: ti.types.ndarray(),
    density: ti.types.ndarray(),
    parent: ti.types.ndarray(),
    limit: float,
    elements: ti.i32,
    nodes: ti.i32,
    width: ti.i32,
):
    """parent (N,): the lowest of all particles that cells (M, width) lighter than ``limit`` [kg/m^3] connect a
    particle with; -1 for particles without such a cell."""
    ti.loop_config(serialize=True)
    for i in range(nodes):
        parent[i] = -1
    ti.loop_config(serialize=True)
    for e in range(elements):
        if density[e] < limit:
            for a in range(width):
                i = cells[e, a]
                if parent[i] < 0:
                    parent[i] = i
            one = parent[cells[e, 0]]
            connected = True
            for a in range(1, width):
                connected = connected and parent[cells[e, a]] == one
            if not connected:
                one = root(parent, one)
                for a in range(1, width):
                    other = root(parent, cells[e, a])
                    if other < one:
                        parent[one] = other
                        one = other
                    else:
                        parent[other] = one
    ti.loop_config(serialize=True)
    for i in range(nodes):
        if parent[i] >= 0:
            j = i
            while parent[j] != j:
                j = parent[j]
            parent[i] = j


@kernel
def bubble_energies(
    row_offsets: ti.types.ndarray(),
    columns: ti.types.ndarray(),
    values: ti.types.ndarray(),
    label: ti.types.ndarray(),
    offsets: ti.types.ndarray(),
    members: ti.types.ndarray(),
    energy: ti.types.ndarray(),
    bubbles: ti.i32,
):
    """energy (B,): sum of the entries of the matrix (CSR) between particles of a bubble; ``label`` as from
    `connect_light`."""
    for k in range(bubbles):
        total = 0.0
        for m in range(offsets[k], offsets[k + 1]):
            i = members[m]
            for s in range(row_offsets[i], row_offsets[i + 1]):
                if label[columns[s]] == label[i]:
                    total += values[s]
        energy[k] = total


@ti.func
def lift(
    b: ti.template(),
    x: ti.template(),
    row_offsets: ti.template(),
    columns: ti.template(),
    values: ti.template(),
    offsets: ti.template(),
    members: ti.template(),
    energy: ti.template(),
    bubbles,
):
    """One after the other, the level of x in each bubble is set so that its equations hold in the sum."""
    for k in range(bubbles):
        missing = 0.0
        for m in range(offsets[k], offsets[k + 1]):
            i = members[m]
            missing += b[i]
            for s in range(row_offsets[i], row_offsets[i + 1]):
                missing -= values[s] * x[columns[s]]
        if energy[k] > 0.0:
            for m in range(offsets[k], offsets[k + 1]):
                i = members[m]
                for s in range(row_offsets[i], row_offsets[i + 1]):
                    if columns[s] == i and values[s] > 0.0:  # not where pressure is prescribed
                        x[i] = x[i] + missing / energy[k]


@kernel
def lift_bubbles(
    b: ti.types.ndarray(),
    x: ti.types.ndarray(),
    row_offsets: ti.types.ndarray(),
    columns: ti.types.ndarray(),
    values: ti.types.ndarray(),
    offsets: ti.types.ndarray(),
    members: ti.types.ndarray(),
    energy: ti.types.ndarray(),
    bubbles: ti.i32,
):
    """`lift` by one thread."""
    ti.loop_config(serialize=True)
    for _ in range(1):
        lift(b, x, row_offsets, columns, values, offsets, members, energy, bubbles)
