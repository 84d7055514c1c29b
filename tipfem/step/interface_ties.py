"""Pressures on both sides of interfaces: the equations on a cut mesh, whose copies move with their particles.

All kernels of the elements run on the P nodes of a `tipfem.mesh.cut.CutMesh`, as on any mesh, with a Jacobian K_cut.
With T the matrix that gives each copy the displacement of its particle and leaves all pressures alone, the Jacobian of
the N displacements and P pressures is T^T K_cut T: displacements are spread to the copies before a product, and the
momentum rows of the copies are added to those of their particle after it. Vectors keep entries for the displacements
of the copies: in unknowns and corrections they are those of the particle, in residuals zero.

In the Schur complement D diag(A)^-1 G of the block preconditioner each particle couples the pressures of all nodes
around it: with B_k = d V_k / d x, the derivative of the volume of node k (a third of its cells') by the particle's
position, the entry for nodes k and l is B_k . diag(A)^-1 B_l. Inside a fluid the Laplacian of the mesh stands for the
sum of these. On an interface it cannot: the pressures on both sides act on one displacement, and the Laplacian of the
cut mesh does not join them. So there the entries themselves are added to the Laplacian, for all tied particles. That
gives the number of Krylov iterations of a continuous pressure; springs between the pressures of a particle alone take
half as many again.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import sparse

from tipfem.backend.arrays import Buffers, download
from tipfem.backend.launch import launch
from tipfem.linalg.sparsity import Csr, running_sums
from tipfem.mesh.cut import CutMesh
from tipfem.step import tie_kernels
from tipfem.typing import Array
from tipfem.walls.step import Walls


class InterfaceTies:
    """The ties between particles on interfaces and their copies, on the device.

    Args:
        cut: the mesh of the step, cut along its interfaces; 2-D.
        walls: of the step.
        buffers: where the arrays live.

    Attributes:
        count: number of particles with copies.
        groups: device array of these and their copies, see `tipfem.linalg.multigrid.mesh_transfer`.
    """

    def __init__(self, cut: CutMesh, walls: Walls, buffers: Buffers) -> None:
        self._cut, self._walls, self._buffers = cut, walls, buffers
        self._dimension = cut.mesh.dimension
        first = np.flatnonzero(np.diff(cut.owner[cut.copied], prepend=-1))
        tied = cut.owner[cut.particles + first]
        self._tied, self.count = tied, len(tied)
        copies = cut.particles + np.append(first, cut.copies)
        self.groups = buffers.upload("ties.groups", np.concatenate([[len(tied)], tied, copies]).astype(np.int32))

    def join_scales(self, scale: Any) -> None:
        """Make the scale (P (d + 1),) of a particle's momentum rows that of its copies' rows together."""
        self._launch(tie_kernels.join_scales, scale)

    def spread(self, x: Any) -> None:
        """Give the copies the displacements of their particles in a vector (P (d + 1),): x = T x."""
        self._launch(tie_kernels.spread, x)

    def collect(self, x: Any) -> None:
        """Add the copies' momentum rows in a vector (P (d + 1),) to those of their particles: x = T^T x."""
        self._launch(tie_kernels.collect, x)

    def clear(self, x: Any) -> None:
        """Set the copies' displacements in a vector (P (d + 1),) to zero."""
        self._launch(tie_kernels.clear, x)

    def _launch(self, kernel: Any, x: Any) -> None:
        launch(kernel, self.groups, x, self.count, self._dimension, work=(self.count, tie_kernels.TIE))

    def joined(self, laplacian: Csr, scale: Any) -> tuple[Csr, Array]:
        """The Laplacian of a cut mesh with what tied particles add to the Schur complement.

        Args:
            laplacian: of P nodes, on the device.
            scale: (P (d + 1),) of the rows, on the device, joined.

        Returns:
            The matrix, on the device; (P,) the component of each node, -1 in components that are not joined to others.
        """
        added = self._schur_complement(download(scale, self._cut.particles * (self._dimension + 1)))
        nodes, put, get = len(self._cut.owner), self._buffers.upload, self._buffers.get
        extra = put("ties.added_offsets", added.indptr), put("ties.added_columns", added.indices)
        row_offsets, work = get("ties.row_offsets", nodes + 1, integer=True), (nodes, tie_kernels.ROW)
        old = laplacian.row_offsets, laplacian.columns
        launch(tie_kernels.count_merged, *old, *extra, row_offsets, nodes, work=work)
        count = launch(running_sums, row_offsets, nodes)
        matrix = Csr(row_offsets, get("ties.columns", count, integer=True), get("ties.laplacian", count))
        launch(tie_kernels.merge_rows, *laplacian, *extra, put("ties.added", added.data), *matrix, nodes, work=work)
        component = self._cut.component
        strength = np.bincount(component, added.diagonal(), minlength=component.max(initial=0) + 1)
        return matrix, np.where(strength[component] > 0, component, -1).astype(np.int32)

    def _schur_complement(self, scale: Array) -> sparse.csr_matrix:
        """(P, P) sum over the tied particles of B_k . diag(A)^-1 B_l, from the scale (N (d + 1),) of the rows."""
        cut, d, walls, mesh = self._cut, self._dimension, self._walls, self._cut.mesh
        group = np.full(cut.particles, -1)
        group[self._tied] = np.arange(self.count)
        cell, corner = np.divmod(np.flatnonzero((group[cut.owner] >= 0).take(mesh.cells)), mesh.cells.shape[1])
        particle = cut.owner[mesh.cells[cell, corner]]
        after, last = (mesh.position[mesh.cells[cell, (corner + k) % 3]] for k in (1, 2))
        side = mesh.period.shortest(last - after)
        # d V / d x of a triangle by a corner is half the opposite side, turned by a right angle; a third for each node.
        slope = np.stack([-side[:, 1], side[:, 0]], axis=1) / 6
        if len(walls.sliding):
            number = np.full(cut.particles, -1)
            number[walls.sliding] = np.arange(len(walls.sliding))
            slide = np.flatnonzero(number[particle] >= 0)
            projector = walls.columns.reshape(-1, d, d)[number[particle[slide]]]
            slope[slide] = np.einsum("ijk,ik->ij", projector, slope[slide])
        # diag(A)^-1, 0 where displacements are prescribed
        slope *= np.sqrt(scale.reshape(-1, d + 1)[particle, :d])
        row = np.repeat((d * group[particle])[:, None] + np.arange(d), 3)
        column = np.repeat(mesh.cells[cell], d, axis=0).ravel()
        entries = np.repeat(slope.ravel(), 3), (row, column)
        slopes = sparse.csr_matrix(entries, shape=(d * self.count, len(cut.owner)))
        return (slopes.T @ slopes).tocsr()
