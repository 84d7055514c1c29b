"""SidePressuresTerm: a pressure on each side of interfaces.

All kernels of the elements run on the P nodes of a `tipfem.mesh.cut.CutMesh`, as on any mesh. Copies of a particle have
pressures of their own, and its displacement, see `tipfem.fem.condensation`.

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

from tipfem.backend.arrays import download, expect
from tipfem.backend.launch import launch
from tipfem.linalg import sparsity
from tipfem.linalg.sparsity import Csr, run_starts
from tipfem.mesh.cut import CutMesh
from tipfem.physics.side_pressures import kernels
from tipfem.physics.side_pressures.carried import PressureJump
from tipfem.physics.term import Equations, Term
from tipfem.physics.walls.step import WallsInStep
from tipfem.scratch import filled, owned
from tipfem.typing import Array


class SidePressuresTerm(Term):
    """The pressures of the fluids at each particle, on the mesh of the step cut along its interfaces.

    ``jump`` (F, N) is a first guess of the pressure of each fluid less that of the particle [Pa]; ``along`` (N, 2) unit
    vectors along which wall particles slide that no wall holds, 0 for others; ``count`` particles have copies.
    """

    cut: CutMesh

    def __init__(self, cut: CutMesh, jump: Array, walls: WallsInStep, along: Array | None = None) -> None:
        self.cut, self.jump, self._sliding, self._projectors = cut, jump, walls.sliding, walls.columns
        if along is not None:
            more = np.flatnonzero(along.any(axis=1))
            products = (along[more, :, None] * along[more, None, :]).reshape(-1, 4)
            self._sliding = np.concatenate([walls.sliding, more])
            self._projectors = np.concatenate([walls.columns.reshape(-1, 4), products])
        first = run_starts(cut.owner[cut.copied])
        self._tied = tied = cut.owner[cut.particles + first]
        self.count, self._first = len(tied), first

    def start(self, x: Array) -> None:
        """See `Term.start`."""
        cut, copied = self.cut, self.cut.copied
        x[copied, -1] += self.jump[cut.fluids[cut.component[copied]], cut.owner[copied]]

    def begin(self, equations: Equations, first_node: int) -> None:
        """See `Term.begin`."""
        self._equations, cut = equations, self.cut
        if self.count:
            copies = cut.particles + np.append(self._first, cut.copies)
            groups = np.concatenate([[self.count], self._tied, copies]).astype(np.int32)
            put = equations.buffers.upload
            self._ties = put("ties.groups", groups)
            self.groups = self._ties, self.count + cut.copies
            row = filled(-1, "ties.row", cut.particles, np.int32)
            row[self._sliding] = np.arange(len(self._sliding))
            self._slides = put("ties.slides", row[self._tied])
            self._along = put(
                "ties.projectors", self._projectors if len(self._sliding) else np.zeros((1, equations.dimension**2))
            )

    def jump_at(self, x: Any) -> Array:
        """(F, N) pressure of each fluid less that of the particle in a device vector of unknowns.

        Where a particle is in several components of a fluid, it is that of one of them.
        """
        pressure, cut = self._equations.values(x)[:, -1], self.cut
        copied, owner = cut.copied, cut.owner[cut.copied]
        result = filled(0.0, "", self.jump.shape)
        result[cut.fluids[cut.component[copied]], owner] = pressure[copied] - pressure[owner]
        return result

    def carried(self, x: Any) -> PressureJump:
        """See `Term.carried`."""
        return PressureJump(self.jump_at(x))

    def diagonal(self) -> None:
        """The scale of a particle's momentum rows is that of its copies' rows together."""
        self._launch(kernels.join_scales)

    def _launch(self, kernel: Any) -> None:
        if self.count:
            e, work = self._equations, (self.count, kernels.TIE)
            launch(kernel, self._ties, e.scale, self.count, e.dimension, work=work)

    def schur_complement(self, laplacian: Csr) -> Csr:
        """The Laplacian of a cut mesh with what tied particles add to the Schur complement."""
        self._launch(kernels.copy_scales)
        if not self.count:
            return laplacian
        e, nodes = self._equations, len(self.cut.owner)
        get = e.buffers.get
        *extra, values, number = self._added()
        row_offsets, work = get("ties.row_offsets", nodes + 1, integer=True), (nodes, sparsity.MERGED_ROW)
        counts = nodes, nodes
        old = laplacian.row_offsets, laplacian.columns
        launch(sparsity.count_merged, *old, *extra, row_offsets, *counts, work=work)
        most = laplacian.columns.shape[0] + number
        count = sparsity.running_sums(row_offsets, nodes, e.buffers, most=most)
        matrix = Csr(row_offsets, get("ties.columns", count, integer=True), get("ties.laplacian", count))
        launch(sparsity.merge_rows, *laplacian, *extra, values, *matrix, *counts, work=work)
        return matrix

    def labels(self) -> Array | None:
        """See `Term.labels`: the components, -1 for those without a tied particle that moves."""
        if not self.count:
            return None
        component, diagonal = self.cut.component, download(*self._diagonal, copy=False)
        tied, label = np.zeros(len(self.cut.fluids), dtype=np.int8), owned(len(component), np.int32)
        launch(kernels.label_tied, component, diagonal, tied, label)
        return label

    def _added(self) -> tuple[Any, Any, Any, int]:
        """(P, P) sum over the tied particles of B_k . diag(A)^-1 B_l: a matrix in CSR on the device, and its size.

        diag(A)^-1 is 0 where displacements are prescribed.
        """
        e, nodes, count = self._equations, len(self.cut.owner), self.count
        get = e.buffers.get
        starts = get("ties.starts", count + 1, integer=True)
        launch(
            kernels.count_slopes, self._ties, e.topology.offsets, starts, count, e.dimension, work=(count, kernels.TIE)
        )
        size = sparsity.running_sums(starts, count, e.buffers, most=(e.dimension + 1) * self.cut.corners)
        ends, tie, entries = (get(f"ties.{name}", size, integer=True) for name in ("ends", "tie", "entries"))
        heads, offsets = (get(f"ties.{name}", nodes + 1, integer=True) for name in ("heads", "added_offsets"))
        node, slope, diagonal = (
            get("ties.node", size, 1, integer=True),
            get("ties.slope", size, e.dimension),
            get("ties.diagonal", nodes),
        )
        lists = kernels.Slopes(starts, ends, node, tie, slope)
        where = e.motion, e.period, e.scale, self._slides, self._along, lists
        launch(kernels.list_slopes, self._ties, e.topology, *where, count, e.dimension, work=(count, kernels.SLOPES))
        sparsity.list_corners(node, heads, entries, (size, 1), nodes, e.buffers)
        work = nodes, kernels.ADDED_ROW
        launch(kernels.count_added, *lists[:4], heads, entries, offsets, nodes, work=work)
        most = (e.dimension + 1) ** 2 * self.cut.pairs
        number = sparsity.running_sums(offsets, nodes, e.buffers, most=most)
        columns, values = get("ties.added_columns", number, integer=True), get("ties.added", number)
        matrix = Csr(offsets, columns, values)
        launch(kernels.add_products, lists, heads, entries, matrix, diagonal, nodes, e.dimension, work=work)
        self._diagonal = diagonal, nodes
        expect(diagonal, nodes)
        return *matrix, number
