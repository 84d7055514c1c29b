"""CutMesh: a mesh cut open along its interfaces, so that a field can have a value on each side of them."""

from dataclasses import dataclass

import numpy as np
import taichi as ti

from tipfem.backend.array_types import Ints1, Ints2, Reals1, Template
from tipfem.backend.launch import kernel, launch
from tipfem.geometry.place import places
from tipfem.mesh.components import ON_INTERFACE
from tipfem.mesh.mesh import Mesh
from tipfem.scratch import filled, owned, scratch
from tipfem.typing import Array


@dataclass(frozen=True)
class CutMesh:
    """The cells of a mesh on P nodes: one for each pair of a particle and a connected component of a fluid there.

    The first N nodes are the N particles themselves, each in the heaviest of its components; the others are copies of
    particles on interfaces, those of a particle one after the other, sorted by its place, see `tipfem.geometry.place`.
    Where no interface passes, a particle is one node, as those are that are kept whole, in one of their components.
    """

    mesh: Mesh  # the same cells, in the same order, on the P nodes
    owner: Array  # (P,) particle of each node
    component: Array  # (P,) component of each node; 0 for those in no cell
    fluids: Array  # (K,) fluid of each component
    particles: int  # N
    corners: int  # of cells, that are particles with copies
    pairs: int  # of such corners, ordered, that are one particle, each with itself, too

    @property
    def copies(self) -> int:
        """Number of nodes that are not particles, P - N."""
        return len(self.owner) - self.particles

    @property
    def copied(self) -> slice:
        """Numbers of the nodes that are not particles."""
        return slice(self.particles, len(self.owner))


def cut_along_interfaces(mesh: Mesh, rank: Array, whole: Array | None = None) -> CutMesh:
    """Cut a mesh along its interfaces, with the components of its fluids labelled, else `ValueError`.

    ``rank`` (M,) is more for heavier fluids, see `tipfem.case.fluid.ranks`; densities will do where no two fluids have
    the same. ``whole`` (N,) masks the particles that remain one node each.
    """
    components = mesh.components
    if components is None:
        raise ValueError("cut_along_interfaces: the components of this mesh are not labelled")
    n, cells = len(mesh.position), mesh.cells
    marked = np.bitwise_and(components.mark, ON_INTERFACE, out=scratch("cut.marked", n, np.int32))
    if whole is not None:
        marked[whole] = 0
    tied = np.flatnonzero(marked).astype(np.int32)
    tied = tied[np.argsort(places(mesh.position[tied]), kind="stable")]
    turn = filled(-1, "cut.turn", n, np.int32)
    turn[tied] = np.arange(len(tied), dtype=np.int32)
    most = n + len(tied) * len(components)
    new, (owner, component) = owned(cells.shape, np.int32), owned((2, min(most, n + cells.size)), np.int32)
    lists = scratch("cut.head", len(tied), np.int32), scratch("cut.entry", (cells.size, 4), np.int32)
    given = np.ascontiguousarray(cells), components.label, np.ascontiguousarray(rank, dtype=np.float64), tied, turn
    count = np.zeros(3, dtype=np.int32)
    launch(cut_cells, *given, *lists, new, owner, component, count, cells.shape[1])
    nodes, *corners = count.tolist()
    owner, component = owner[:nodes], component[:nodes]
    position = owned((nodes, cells.shape[1] - 1))
    position[:n], position[n:] = mesh.position, mesh.position[owner[n:]]
    solved = Mesh(position, new, mesh.fluid, period=mesh.period)
    return CutMesh(solved, owner, component, components.fluid, n, *corners)


LABEL, CELL, NODE, NEXT = 0, 1, 2, 3  # of an entry of `cut_cells`: a component at a particle, and one of its cells


@kernel
def cut_cells(
    cells: Ints2,
    label: Ints1,
    rank: Reals1,
    tied: Ints1,
    turn: Ints1,
    head: Ints1,
    entry: Ints2,
    new: Ints2,
    owner: Ints1,
    component: Ints1,
    count: Ints1,
    corners: Template,
):
    """The nodes of the corners of ``cells``, of each node its owner and component; ``count``: see `CutMesh`.

    ``tied`` (T,): the particles on interfaces; ``turn`` (N,) the place of each there, -1 for others. ``head`` (T,) and
    ``entry`` are scratch: for each of them a list of its components, ascending.
    """
    ti.loop_config(serialize=True)
    for i in range(turn.shape[0]):
        owner[i], component[i] = i, 0
    ti.loop_config(serialize=True)
    for _ in range(1):
        for t in range(tied.shape[0]):
            head[t] = -1
        end = 0
        for c in range(cells.shape[0]):
            for i in ti.static(range(corners)):
                t = turn[cells[c, i]]
                if t >= 0:
                    before, e = -1, head[t]
                    while e >= 0 and entry[ti.max(e, 0), LABEL] < label[c]:
                        before, e = e, entry[e, NEXT]
                    if e < 0 or entry[ti.max(e, 0), LABEL] > label[c]:
                        entry[end, LABEL], entry[end, CELL], entry[end, NEXT] = label[c], c, e
                        if before < 0:
                            head[t] = end
                        else:
                            entry[before, NEXT] = end
                        end += 1
        nodes = turn.shape[0]
        for t in range(tied.shape[0]):
            heaviest, e = head[t], head[t]
            while e >= 0:
                if rank[entry[e, CELL]] > rank[entry[heaviest, CELL]]:
                    heaviest = e
                e = entry[e, NEXT]
            e = head[t]
            while e >= 0:
                entry[e, NODE] = tied[t]
                if e != heaviest:
                    entry[e, NODE], owner[nodes] = nodes, tied[t]
                    nodes += 1
                e = entry[e, NEXT]
            if head[t] >= 0:
                entry[head[t], CELL] = 0  # from now on, a number of corners
        shared, pairs = 0, 0
        for c in range(cells.shape[0]):
            for i in ti.static(range(corners)):
                node, t = cells[c, i], turn[cells[c, i]]
                if t >= 0:
                    e = head[t]
                    if entry[e, NEXT] >= 0:
                        shared += 1
                        pairs += 2 * entry[e, CELL] + 1
                        entry[e, CELL] = entry[e, CELL] + 1
                    while entry[e, LABEL] != label[c]:
                        e = entry[e, NEXT]
                    node = entry[e, NODE]
                new[c, i], component[node] = node, label[c]
        count[0], count[1], count[2] = nodes, shared, pairs
