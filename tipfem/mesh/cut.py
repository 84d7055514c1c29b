"""CutMesh: a mesh cut open along its interfaces, so that a field can have a value on each side of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tipfem.geometry.place import places
from tipfem.mesh.components import ON_INTERFACE
from tipfem.mesh.mesh import Mesh
from tipfem.typing import Array


@dataclass(frozen=True)
class CutMesh:
    """The cells of a mesh on P nodes: one for each pair of a particle and a connected component of a fluid there.

    The first N nodes are the N particles themselves, each in the heaviest of its components; the others are copies of
    particles on interfaces, those of a particle one after the other, sorted by its place, see `tipfem.geometry.place`.
    Where no interface passes, a particle is one node.

    Attributes:
        mesh: the same cells, in the same order, on the P nodes.
        owner: (P,) particle of each node.
        component: (P,) component of each node; 0 for those in no cell.
        fluid: (P,) fluid of each node.
        particles: N.
    """

    mesh: Mesh
    owner: Array
    component: Array
    fluid: Array
    particles: int

    @property
    def copies(self) -> int:
        """Number of nodes that are not particles, P - N."""
        return len(self.owner) - self.particles

    @property
    def copied(self) -> slice:
        """Numbers of the nodes that are not particles."""
        return slice(self.particles, len(self.owner))


def cut_along_interfaces(mesh: Mesh, rank: Array) -> CutMesh:
    """Cut a mesh along its interfaces.

    Args:
        mesh: M cells on N particles, with the components of its fluids.
        rank: (M,) of the cells' fluids, more for heavier ones, see `tipfem.case.fluid.ranks`; densities will do where
            no two fluids have the same.

    Raises:
        ValueError: the components of the mesh are not labelled.
    """
    components = mesh.components
    if components is None:
        raise ValueError("cut_along_interfaces: the components of this mesh are not labelled")
    n = len(mesh.position)
    on_interface = (components.mark & ON_INTERFACE) > 0
    cell, corner = np.divmod(np.flatnonzero(on_interface.take(mesh.cells)), mesh.cells.shape[1])
    at = mesh.cells[cell, corner]
    there = np.unique(at)
    turn = np.zeros(n, dtype=np.int64)
    turn[there[np.argsort(places(mesh.position[there]), kind="stable")]] = np.arange(len(there))
    pair = turn[at] * len(components) + components.label[cell]
    _, where, number = np.unique(pair, return_index=True, return_inverse=True)
    particle, label = at[where], components.label[cell[where]]
    order = np.lexsort((label, -rank[cell[where]], turn[particle]))
    heaviest = np.zeros(len(where), dtype=bool)
    heaviest[order[np.diff(turn[particle[order]], prepend=-1) > 0]] = True
    node = particle.copy()
    node[~heaviest] = n + np.arange(np.count_nonzero(~heaviest))
    cells = mesh.cells.copy()
    cells[cell, corner] = node[number]
    owner = np.concatenate([np.arange(n), particle[~heaviest]])
    component = np.zeros(len(owner), dtype=np.int32)
    component[cells] = components.label[:, None]
    return CutMesh(
        Mesh(mesh.position[owner], cells, mesh.fluid, period=mesh.period),
        owner,
        component,
        components.fluid[component],
        n,
    )
