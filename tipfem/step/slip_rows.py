"""SlipRows: the equations of liquids that slide along each other, in the linear systems of a step.

At the particle i of an interface the lighter liquid has the displacement u_i + s t, see `tipfem.mesh.interface_slip`.
In the momentum equations that is a virtual displacement, too. With m the mass of the lighter liquid at i, its cells e
of the areas A, and s(u), s(a) of displacements and accelerations, the weak forms are added to by

    momentum:    m [t . (a_i - b + s(a) t) s(u') + t . u'_i s(a)] + sum_e A / 3 (t . grad p) s(u')
    continuity:  -sum_e A / 3 (t . grad q) s(u) + sum_e tau A / 3 (t . grad q) s(a)

for virtual displacements u' and pressures q. Pressure acts by its gradient, and a volume moves from cell to cell by the
same coefficients. So what slides does not pass through the interface, however it bends; nothing is gained or lost
between the two equations; the volume of each component stays, as the gradients of a cell's q sum to zero; and where
grad p = rho b in the lighter liquid, as at rest, there is no force on what slides. The last term is the slip in the
acceleration that stabilises the pressure. Viscous stress acts as if nothing slid: mu / h times the slip, between the
particles on the interface and those beside.

Gradients are those at the intermediate positions as the first iterate has them, and t is that at the start of the step.
So all of this is linear: a constant matrix and a constant vector for the step.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import sparse

from tipfem.backend.arrays import Buffers, download
from tipfem.backend.launch import launch
from tipfem.fem.time_integration import TimeScheme
from tipfem.linalg.sparsity import Csr, running_sums
from tipfem.mesh.cut import CutMesh
from tipfem.mesh.interface_slip import InterfaceSlip
from tipfem.state import SlipWork
from tipfem.step import slip_kernels, tie_kernels
from tipfem.typing import Array


class SlipRows:
    """The equations on a cut mesh of P nodes, on the device.

    Args:
        slip: where liquids slide.
        cut: the mesh.
        tau: (K,) of the slip's cells [s^2], see `tipfem.fem.element.stabilisation_time`.
        lumping: (K,) part of their mass matrix that is lumped.
        scheme: of the time integration, with the step's length.
        position: (N, 2) where gradients are taken [m].
        acceleration: (N, 2) part of a_alpha that does not depend on the step's displacements [m/s^2].
        force: (N, 2) acceleration b by gravity and the like [m/s^2].
        scale: (3 P,) of the rows, on the device.
        buffers: where the arrays live.
    """

    def __init__(
        self,
        slip: InterfaceSlip,
        cut: CutMesh,
        tau: Array,
        lumping: Array,
        scheme: TimeScheme,
        position: Array,
        acceleration: Array,
        force: Array,
        scale: Any,
        buffers: Buffers,
    ) -> None:
        self._slip, self._scale, self._buffers, self._cm = slip, scale, buffers, scheme.cm
        self._size = 3 * len(cut.owner)
        self._slides = slides = self._of_displacements()
        self._inertia, self._together = inertia, together = self._of_inertia(lumping)
        pressure, self._stabilisation = self._of_pressures(cut, tau, position)
        self._slip_acceleration = a = slip.slip(acceleration)
        self._carried = slip.carried(acceleration[slip.nodes], lumping)
        moved = slides.T @ (scheme.cm * (inertia + together @ slides) + pressure) + scheme.cm * inertia.T @ slides
        matrix = (moved - (pressure - scheme.cm * self._stabilisation).T @ slides).tobsr((3, 3))
        matrix.sort_indices()
        forced = slip.carried((acceleration - force)[slip.nodes], lumping) + together @ a
        constant = slides.T @ forced + (inertia + self._stabilisation).T @ a
        filled = np.flatnonzero(np.diff(matrix.indptr))
        put = buffers.upload
        self._count = len(filled)
        self._offsets = put("slip.offsets", matrix.indptr.astype(np.int32))
        columns, values = put("slip.columns", matrix.indices.astype(np.int32)), put("slip.values", matrix.data.ravel())
        rows, ends = put("slip.rows", filled.astype(np.int32)), matrix.indptr[np.append(filled, len(cut.owner))]
        self._matrix = rows, put("slip.row_offsets", ends.astype(np.int32)), columns, values
        self._constant = put("slip.constant", constant.reshape(-1, 3)[filled].ravel())

    def _of_displacements(self) -> sparse.csr_matrix:
        """(C, 3 P) that gives s(u) of a vector of unknowns."""
        slip, count = self._slip, len(self._slip.owner)
        number = np.concatenate([np.repeat(np.arange(count), np.diff(slip.offsets)), np.arange(count)])
        weight = np.concatenate([slip.weight, np.full(count, -1.0)]) * slip.part[number]
        return self._along(number, np.concatenate([slip.beside, slip.owner]), weight)

    def _of_inertia(self, lumping: Array) -> tuple[sparse.csr_matrix, sparse.csr_matrix]:
        """Z^T M (C, 3 P) of a vector of unknowns, and Z^T M Z (C, C), see `InterfaceSlip.carried`."""
        slip = self._slip
        cell, corner = np.nonzero(slip.corner >= 0)
        number, other = slip.corner[cell, corner], slip.corner[cell]
        weight = (lumping[cell, None] * (corner[:, None] == np.arange(3)) + (1 - lumping[cell, None]) / 3) / 3
        weight *= slip.cell_mass[cell, None]
        of = np.repeat(number, 3)
        inertia = self._along(of, slip.nodes[cell].ravel(), weight.ravel())
        cosine = np.einsum("ed,ekd->ek", slip.tangent[number], slip.tangent[other])
        there = other >= 0
        entries = np.repeat(number, there.sum(axis=1)), other[there]
        shape = len(slip.owner), len(slip.owner)
        return inertia, sparse.csr_matrix(((weight * cosine)[there], entries), shape)

    def _along(self, number: Array, particle: Array, weight: Array) -> sparse.csr_matrix:
        """(C, 3 P) with entries w t for displacements of particles, in the row and with the t of each ``number``."""
        entries = np.repeat(number, 2), (3 * particle[:, None] + (0, 1)).ravel()
        values = (weight[:, None] * self._slip.tangent[number]).ravel()
        return sparse.csr_matrix((values, entries), (len(self._slip.owner), self._size))

    def _of_pressures(self, cut: CutMesh, tau: Array, position: Array) -> tuple[sparse.csr_matrix, sparse.csr_matrix]:
        """(C, 3 P) sums of A / 3 t . grad p, and of these times tau, of a vector of unknowns."""
        slip, mesh = self._slip, cut.mesh
        nodes = mesh.cells[slip.cell]
        x = position[cut.owner[nodes]]
        side = mesh.period.shortest(np.roll(x, -2, axis=1) - np.roll(x, -1, axis=1))
        double = side[:, 0, 0] * side[:, 1, 1] - side[:, 0, 1] * side[:, 1, 0]
        gradient = np.stack([-side[:, :, 1], side[:, :, 0]], axis=2) / double[:, None, None]
        cell, corner = np.nonzero(slip.corner >= 0)
        number = slip.corner[cell, corner]
        value = (
            np.einsum("ekd,ed->ek", gradient[cell], slip.tangent[number]) * (mesh.measure[slip.cell] / 3)[cell, None]
        )
        entries = np.repeat(number, 3), (3 * nodes[cell] + 2).ravel()
        shape = len(slip.owner), self._size
        both = (sparse.csr_matrix((part.ravel(), entries), shape) for part in (value, value * tau[cell, None]))
        plain, stabilised = both
        return plain, stabilised

    def merged(self, offsets: Any, columns: Any, values: Any, nodes: int) -> tuple[Any, Any, int]:
        """Row offsets, columns and their number of a Jacobian in rows with those of these equations, too.

        Args:
            offsets: (P + 1,) of its rows, on the device.
            columns: of its blocks.
            values: one for each column, any.
            nodes: P.
        """
        get, work = self._buffers.get, (nodes, tie_kernels.ROW)
        added = self._offsets, self._matrix[2]
        new = get("slip.merged_offsets", nodes + 1, integer=True)
        launch(tie_kernels.count_merged, offsets, columns, *added, new, nodes, work=work)
        count = launch(running_sums, new, nodes)
        merged = new, get("slip.merged_columns", count, integer=True)
        unused = get("slip.unused", count)
        launch(
            tie_kernels.merge_rows, offsets, columns, values, *added, self._matrix[3], *merged, unused, nodes, work=work
        )
        return *merged, count

    def add_to(self, matrix: Csr) -> None:
        """Add the matrix to a Jacobian's rows, whose columns are those of `merged`."""
        work = (self._count, slip_kernels.ROW)
        launch(slip_kernels.add_blocks, *self._matrix, self._scale, *matrix, self._size // 3, self._count, work=work)

    def residual(self, x: Any, out: Any) -> None:
        """Add the equations at ``x`` to a scaled residual."""
        self._add(x, out, 1.0)

    def product(self, v: Any, out: Any) -> None:
        """Add the scaled matrix times ``v`` to ``out``."""
        self._add(v, out, 0.0)

    def _add(self, x: Any, out: Any, factor: float) -> None:
        work = (self._count, slip_kernels.ROW)
        arrays = (*self._matrix, self._constant, factor, self._scale, x, out, self._count)
        launch(slip_kernels.add_product, *arrays, work=work)

    def work(self, x: Any) -> SlipWork:
        """Work of the equations at ``x``."""
        values = download(x, self._size).astype(np.float64, copy=False)
        slid, carried = self._slides @ values, self._inertia @ values
        slips = self._cm * slid + self._slip_acceleration
        accelerated = self._cm * carried + self._carried + self._together @ slips
        return SlipWork(
            inertia=float(slid @ accelerated + carried @ slips),
            stabilisation=float((self._stabilisation @ values) @ slips),
            force=(self._slip.mass * slips) @ self._slip.tangent,
        )
