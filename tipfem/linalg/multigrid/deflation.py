"""Subdomain deflation: each bubble of a light fluid in a heavy one is a coarse unknown of the pressure's multigrid.

The coefficient of the pressure Laplacian is larger inside a bubble than around it by the ratio of the densities: the
pressure of the whole bubble can have a constant error that no smoother reduces, and that no background grid represents
if the bubble is smaller than the grid's cells. So the coarse space is extended by the functions that are one on a
bubble and zero elsewhere: R. A. Nicolaides, Deflation of conjugate gradients with applications to boundary value
problems, SIAM J. Numer. Anal. 24, 1987.

``subdomains`` holds the particles of the bubbles, list by list: those of bubble k are
``subdomains[subdomains[k]:subdomains[k + 1]]``, so that there are ``subdomains[0] - 1`` bubbles.
"""

from typing import Any

import numpy as np
import taichi as ti

from tipfem.backend.array_types import Ints1, Ints2, Reals1, Template
from tipfem.backend.arrays import Buffers
from tipfem.backend.barrier import GROUP, rounds
from tipfem.backend.launch import kernel, launch
from tipfem.backend.runtime import on_gpu
from tipfem.backend.union_find import find_root
from tipfem.geometry.place import places
from tipfem.linalg.multigrid.grid_hierarchy import ENERGY, SOLUTION
from tipfem.linalg.multigrid.mesh_transfer import residual_row
from tipfem.linalg.sparsity import Csr, run_starts
from tipfem.scratch import scratch
from tipfem.typing import Array

# Smallest ratio of densities at which there are bubbles. The light elements are then those below the geometric mean of
# the lowest and the highest density.
DENSITY_RATIO = 10.0
# Components of more particles than this are left to the coarse grids.
LARGEST = 2000
MEMBER = 30.0  # nanoseconds of one thread for a particle in `set_energies`


@kernel
def label_light_components(
    cells: Ints2, density: Reals1, label: Ints1, limit: float, elements: ti.i32, nodes: ti.i32, width: ti.i32
):
    """Connected components of cells lighter than ``limit`` [kg/m^3]: ``label`` (N,) is the lowest particle, or -1."""
    ti.loop_config(serialize=True)
    for i in range(nodes):
        label[i] = -1
    ti.loop_config(serialize=True)
    for e in range(elements):
        if density[e] < limit:
            for a in range(width):
                i = cells[e, a]
                if label[i] < 0:
                    label[i] = i
            one = label[cells[e, 0]]
            connected = True
            for a in range(1, width):
                connected = connected and label[cells[e, a]] == one
            if not connected:
                one = find_root(label, one)
                for a in range(1, width):
                    other = find_root(label, cells[e, a])
                    if other < one:
                        label[one] = other
                        one = other
                    else:
                        label[other] = one
    ti.loop_config(serialize=True)
    for i in range(nodes):
        if label[i] >= 0:
            label[i] = find_root(label, i)


@kernel
def find_bubbles(label: Ints1, size: Ints1, members: Ints1, largest: ti.i32) -> ti.i32:
    """Particles, ascending, of all components but the largest and those of more than ``largest``; their number."""
    count = 0
    ti.loop_config(serialize=True)
    for _ in range(1):
        nodes = label.shape[0]
        for i in range(nodes):
            size[i] = 0
        for i in range(nodes):
            if label[i] >= 0:
                size[label[i]] = size[label[i]] + 1
        most = 0
        for k in range(nodes):
            if size[k] > size[most]:
                most = k
        size[most] = largest + 1  # excluded, however small
        for i in range(nodes):
            if label[i] >= 0 and size[ti.max(label[i], 0)] <= largest:
                members[count] = i
                count += 1
    return count


@kernel
def set_energies(
    matrix: Csr, label: Ints1, subdomains: Ints1, vectors: Reals1, count: ti.i32, nodes: ti.i32, serial: Template
):
    """Diagonal entries of the coarse operator, as `ENERGY` of the bubbles' particles: sums of the matrix in a bubble.

    They are 0 at particles of prescribed pressure, which have no equation.
    """
    ti.loop_config(serialize=serial)
    for k in range(count):
        total = 0.0
        for m in range(subdomains[k], subdomains[k + 1]):
            i = subdomains[m]
            vectors[ENERGY * nodes + i] = 0.0
            for s in range(matrix.row_offsets[i], matrix.row_offsets[i + 1]):
                if label[matrix.columns[s]] == label[i]:
                    total += matrix.values[s]
                if matrix.columns[s] == i and matrix.values[s] > 0.0:
                    vectors[ENERGY * nodes + i] = 1.0
        for m in range(subdomains[k], subdomains[k + 1]):
            vectors[ENERGY * nodes + subdomains[m]] = vectors[ENERGY * nodes + subdomains[m]] * ti.max(total, 0.0)


@ti.func
def deflate(matrix: Template, vectors: Template, subdomains: Template, nodes):
    """Add a constant to the solution in one bubble after the other, so that the sum of its equations holds."""
    for k in range(subdomains[0] - 1):
        residual = 0.0
        for m in range(subdomains[k], subdomains[k + 1]):
            residual += residual_row(matrix, vectors, SOLUTION, subdomains[m], nodes)
        for m in range(subdomains[k], subdomains[k + 1]):
            i = subdomains[m]
            if vectors[ENERGY * nodes + i] > 0.0:
                vectors[SOLUTION * nodes + i] = vectors[SOLUTION * nodes + i] + residual / vectors[ENERGY * nodes + i]


@kernel
def set_energies_by_group(
    matrix: Csr, label: Ints1, subdomains: Ints1, vectors: Reals1, partial: Reals1, nodes: ti.i32
):
    """`set_energies` by a group of a GPU's threads; ``partial`` (GROUP,) is scratch."""
    ti.loop_config(block_dim=GROUP)
    for thread in range(GROUP):
        for k in range(subdomains[0] - 1):
            first, last = subdomains[k], subdomains[k + 1]
            own = 0.0
            for m in range(rounds(last - first, thread)):
                i = subdomains[first + m * GROUP + thread]
                vectors[ENERGY * nodes + i] = 0.0
                for s in range(matrix.row_offsets[i], matrix.row_offsets[i + 1]):
                    if label[matrix.columns[s]] == label[i]:
                        own += matrix.values[s]
                    if matrix.columns[s] == i and matrix.values[s] > 0.0:
                        vectors[ENERGY * nodes + i] = 1.0
            total = sum_of_group(partial, own, thread, last - first)
            for m in range(rounds(last - first, thread)):
                at = ENERGY * nodes + subdomains[first + m * GROUP + thread]
                vectors[at] = vectors[at] * ti.max(total, 0.0)


@ti.func
def sum_of_group(partial: Template, own, thread, count):
    """Sum of what the threads of a group that share ``count`` iterations have each; ``partial`` (GROUP,) is scratch."""
    ti.simt.block.sync()
    partial[thread] = own
    ti.simt.block.sync()
    total = 0.0
    for m in range(ti.min(count, GROUP)):
        total += partial[m]
    return total


@ti.func
def deflate_with_group(matrix: Template, vectors: Template, subdomains: Template, partial: Template, thread, nodes):
    """`deflate` by a group of a GPU's threads; ``partial`` (GROUP,) is scratch."""
    for k in range(subdomains[0] - 1):
        first, last = subdomains[k], subdomains[k + 1]
        own = 0.0
        for m in range(rounds(last - first, thread)):
            i = subdomains[first + m * GROUP + thread]
            own += residual_row(matrix, vectors, SOLUTION, i, nodes)
        total = sum_of_group(partial, own, thread, last - first)
        for m in range(rounds(last - first, thread)):
            i = subdomains[first + m * GROUP + thread]
            if vectors[ENERGY * nodes + i] > 0.0:
                vectors[SOLUTION * nodes + i] = vectors[SOLUTION * nodes + i] + total / vectors[ENERGY * nodes + i]
        ti.simt.block.sync()


@kernel
def deflate_by_group(matrix: Csr, vectors: Reals1, subdomains: Ints1, partial: Reals1, nodes: ti.i32):
    """`deflate_with_group`."""
    ti.loop_config(block_dim=GROUP)
    for thread in range(GROUP):
        deflate_with_group(matrix, vectors, subdomains, partial, thread, nodes)


@kernel
def deflate_serially(matrix: Csr, vectors: Reals1, subdomains: Ints1, nodes: ti.i32):
    """`deflate`, serially."""
    ti.loop_config(serialize=True)
    for _ in range(1):
        deflate(matrix, vectors, subdomains, nodes)


class SubdomainDeflation:
    """The coarse space of a step's bubbles: all connected components of the light fluid except the largest.

    Args:
        extremes: lowest and highest density.
        shape: M, N and d + 1.
        matrix: the pressure Laplacian.
        vectors: those of the cycle on the mesh, see `tipfem.linalg.multigrid.grid_hierarchy`.
        label: (N,) connected component of each particle, -1 for those in none, where all components but the largest are
            to be bubbles; by default those of the light fluid.
        position: (N, d) of the particles [m], by which the bubbles are sorted.
    """

    def __init__(
        self,
        cells: Array,
        density: Array,
        extremes: tuple[float, float],
        shape: tuple[int, int, int],
        matrix: Csr,
        vectors: Any,
        buffers: Buffers,
        label: Array | None = None,
        *,
        position: Array,
    ) -> None:
        self._matrix, self._vectors, self._nodes = matrix, vectors, shape[1]
        (lowest, highest), (elements, nodes, width) = extremes, shape
        if label is None and highest >= DENSITY_RATIO * lowest:
            label, limit = np.empty(nodes, dtype=np.int32), float(np.sqrt(lowest * highest))
            launch(label_light_components, cells, density, label, limit, elements, nodes, width)
        lists = np.ones(1, dtype=np.int32) if label is None else _bubble_lists(label, position)
        self.count = int(lists[0]) - 1
        self.subdomains = buffers.upload("deflation.subdomains", lists)
        self.scratch = buffers.get("deflation.partial", GROUP)
        if label is not None and self.count:
            given = matrix, buffers.upload("deflation.label", label), self.subdomains, vectors
            if on_gpu():
                launch(set_energies_by_group, *given, self.scratch, nodes)
            else:
                launch(set_energies, *given, self.count, nodes, work=(len(lists), MEMBER))

    def correct(self) -> None:
        """Add a constant to the solution in each bubble, so that the sum of its equations holds."""
        given = self._matrix, self._vectors, self.subdomains
        if self.count and on_gpu():
            launch(deflate_by_group, *given, self.scratch, self._nodes)
        elif self.count:
            launch(deflate_serially, *given, self._nodes)


def _bubble_lists(label: Array, position: Array) -> Array:
    """The particles of all components but the largest, list by list, sorted by first places, from labels (N,)."""
    size, members = scratch("bubbles", (2, len(label)), np.int32)
    inside = members[: launch(find_bubbles, label, size, members, LARGEST)]
    if not len(inside):
        return np.ones(1, dtype=np.int32)
    first = np.full(len(size), np.inf)
    np.minimum.at(first, label[inside], places(position[inside]))
    inside = inside[np.lexsort((label[inside], first[label[inside]]))]
    starts = run_starts(label[inside])
    offsets = np.append(starts, len(inside))
    return np.concatenate([offsets + len(offsets), inside]).astype(np.int32)
