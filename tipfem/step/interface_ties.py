"""Pressures on both sides of interfaces: the equations on a cut mesh, whose copies move with their particles.

All kernels of the elements run on the P nodes of a `tipfem.mesh.cut.CutMesh`, as on any mesh, with a Jacobian K_cut.
With T the matrix that gives each copy the displacement of its particle and leaves all pressures alone, the Jacobian of
the N displacements and P pressures is T^T K_cut T: displacements are spread to the copies before a product, and the
momentum rows of the copies are added to those of their particle after it. Vectors keep entries for the displacements
of the copies: in unknowns and corrections they are those of the particle, in residuals zero.

The pressures of a particle act on one displacement, which couples them in the Schur complement D diag(A)^-1 G: with
B_k = d V_k / d x, the derivative of the volume of component k by the particle's position, the entry for two of its
components is B_k . diag(A)^-1 B_l. The Laplacian of the cut mesh lacks it, so it is added as a spring of the stiffness
-B_k . diag(A)^-1 B_l between the two pressures. B_1 = -B_2 where two components meet inside the tank.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from tipfem.backend.arrays import Buffers, download
from tipfem.backend.launch import launch
from tipfem.linalg.sparsity import Csr
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
    """

    def __init__(self, cut: CutMesh, walls: Walls, buffers: Buffers) -> None:
        self._cut, self._walls, self._buffers = cut, walls, buffers
        self._dimension = cut.mesh.dimension
        tied, first = np.unique(cut.owner[cut.particles :], return_index=True)
        self._tied, self.count = tied, len(tied)
        self._particles = buffers.upload("ties.particles", tied.astype(np.int32))
        self._copies = buffers.upload("ties.copies", np.append(first, cut.copies).astype(np.int32))

    def join_scales(self, scale: Any) -> None:
        """Make the scale (P (d + 1),) of a particle's momentum rows that of its copies' rows together."""
        self._launch(tie_kernels.join_scales, scale)
        self.spread(scale)

    def spread(self, x: Any) -> None:
        """Give the copies the displacements of their particles in a vector (P (d + 1),): x = T x."""
        self._launch(tie_kernels.spread, x)

    def collect(self, x: Any) -> None:
        """Add the copies' momentum rows in a vector (P (d + 1),) to those of their particles: x = T^T x."""
        self._launch(tie_kernels.collect, x)

    def clear(self, x: Any) -> None:
        """Set the copies' displacements in a vector (P (d + 1),) to zero."""
        n, d, work = self._cut.particles, self._dimension, (self._cut.copies, tie_kernels.TIE)
        launch(tie_kernels.clear, self._copies, x, n, self.count, d, work=work)

    def _launch(self, kernel: Any, x: Any) -> None:
        n, d, work = self._cut.particles, self._dimension, (self.count, tie_kernels.TIE)
        launch(kernel, self._particles, self._copies, x, n, self.count, d, work=work)

    def sprung(self, laplacian: Csr, scale: Any, schur: float) -> tuple[Csr, Array]:
        """The Laplacian of a cut mesh with springs between the pressures of each particle.

        Args:
            laplacian: of P nodes, on the device.
            scale: (P (d + 1),) of the rows, on the device, joined.
            schur: by which the stiffness is divided, as the Laplacian is.

        Returns:
            The matrix, on the device; (P,) the component of each node, -1 in components without a spring.
        """
        one, other, stiffness = self._springs(download(scale, self._cut.particles * (self._dimension + 1)), schur)
        nodes, put = len(self._cut.owner), self._buffers.upload
        row = np.concatenate([one, other])
        order = np.argsort(row, kind="stable")
        offsets = np.concatenate([[0], np.cumsum(np.bincount(row, minlength=nodes))])
        count = download(laplacian.row_offsets, nodes + 1)[-1] + len(row)
        get = self._buffers.get
        matrix = Csr(
            get("ties.row_offsets", nodes + 1, integer=True),
            get("ties.columns", int(count), integer=True),
            get("ties.laplacian", int(count)),
        )
        launch(
            tie_kernels.add_springs,
            *laplacian,
            put("ties.spring_offsets", offsets.astype(np.int32)),
            put("ties.spring_columns", np.concatenate([other, one])[order].astype(np.int32)),
            put("ties.stiffness", np.tile(stiffness, 2)[order]),
            *matrix,
            nodes,
            work=(nodes, tie_kernels.ROW),
        )
        component = self._cut.component
        strength = np.bincount(component[row], np.tile(stiffness, 2), minlength=component.max(initial=0) + 1)
        return matrix, np.where(strength[component] > 0, component, -1).astype(np.int32)

    def _springs(self, scale: Array, schur: float) -> tuple[Array, Array, Array]:
        """Nodes (S,) and (S,) at the ends of the springs, and their stiffness (S,)."""
        cut, d, walls = self._cut, self._dimension, self._walls
        nodes = len(cut.owner)
        group = np.full(cut.particles, -1)
        group[self._tied] = np.arange(self.count)
        mesh = cut.mesh
        near = (group >= 0)[cut.owner].take(mesh.cells)
        cell, corner = np.nonzero(near)
        after, last = (mesh.position[mesh.cells[cell, (corner + k) % 3]] for k in (1, 2))
        side = 0.5 * (last - after)
        node = mesh.cells[cell, corner]
        # d V / d x of a triangle by a corner: half the opposite side, turned by a right angle.
        gradient = np.stack([np.bincount(node, w, minlength=nodes) for w in (-side[:, 1], side[:, 0])], axis=1)
        if len(walls.sliding):
            projector = np.tile(np.eye(d), (cut.particles, 1, 1))
            projector[walls.sliding] = walls.columns.reshape(-1, d, d)
            gradient = np.einsum("ijk,ik->ij", projector[cut.owner], gradient)
        flexibility = scale.reshape(-1, d + 1)[:, :d]  # diag(A)^-1, 0 where displacements are prescribed
        ends = np.concatenate([self._tied, np.arange(cut.particles, nodes)])
        ends = ends[np.argsort(cut.owner[ends], kind="stable")]
        one, other = [ends[:0]], [ends[:0]]
        for distance in range(1, len(ends)):
            same = cut.owner[ends[distance:]] == cut.owner[ends[:-distance]]
            if not same.any():
                break
            one.append(ends[:-distance][same])
            other.append(ends[distance:][same])
        i, j = np.concatenate(one), np.concatenate(other)
        stiffness = -(gradient[i] * gradient[j] * flexibility[cut.owner[i]]).sum(axis=1) / schur
        joined = stiffness > 0
        return i[joined], j[joined], stiffness[joined]
