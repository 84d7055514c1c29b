"""SlipRows: the equations of liquids that slide along each other, in the linear systems of a step.

At the particle i of an interface the lighter liquid has the displacement u_i + s t, see `tipfem.mesh.interface_slip`.
In the momentum equations that is a virtual displacement, too. With m the mass of the lighter liquid at i, its cells e
of the areas A, and s(u), s(a) of displacements and accelerations, the weak forms are added to by

    momentum:    m [t . (a_i - b + s(a) t) s(u') + t . u'_i s(a)] + sum_e A / 3 (t . grad p) s(u')
                 - c_f sum_e rho A / 3 (t . grad (b . u')) s(u)
    continuity:  -sum_e A / 3 (t . grad q) s(u) + sum_e tau A / 3 (t . grad q) s(a)

for virtual displacements u' and pressures q. Pressure acts by its gradient, and a volume moves from cell to cell by the
same coefficients. So what slides does not pass through the interface, however it bends; nothing is gained or lost
between the two equations; the volume of each component stays, as the gradients of a cell's q sum to zero; and where
grad p = rho b in the lighter liquid, as at rest, there is no force on what slides. The second line is the weight of
the volumes that have moved from node to node at the intermediate time, c_f u, at which pressure acts on the cells: with
that of the start alone, pressure and weight are out of balance by a part to dt s, which damps waves. The last term is
the slip in the acceleration that stabilises the pressure. Viscous stress acts as if nothing slid: mu / h times the
slip, between the particles on the interface and those beside.

Gradients are those at the intermediate positions as the first iterate has them, and t is that at the start of the step.
So all of this is linear: a constant matrix and a constant vector for the step.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

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
        self._lumping, self._acceleration = lumping, acceleration[slip.nodes]
        self._slip_acceleration = a = slip.slip(acceleration)
        nodes, self._size = len(cut.owner), 3 * len(cut.owner)
        own = self._of_displacements()
        terms = self._of_cells(cut, tau, position, own)
        inertia, together, plain, stabilisation, moved = np.split(terms.value, (2, 4, 5, 6), axis=1)
        self._inertia, self._stabilisation = inertia, stabilisation[:, 0]
        self._weight = scheme.cf * moved * force[cut.owner[terms.node]]
        self._terms = terms
        row = np.hstack([scheme.cm * (inertia + together), plain])
        column = np.hstack([scheme.cm * inertia - self._weight, scheme.cm * stabilisation - plain])
        one, other = _pairs(own.number, terms.number, len(slip.owner))
        s, e = own.node[one], terms.node[other]
        along, row, column = own.value.take(one, axis=0), row.take(other, axis=0), column.take(other, axis=0)
        blocks = np.concatenate([along[:, :, None] * row[:, None, :], column[:, :, None] * along[:, None, :]])
        pair, values = _summed(np.concatenate([s * nodes + e, e * nodes + s]), blocks.reshape(-1, 9))
        row_of, columns = np.divmod(pair, nodes)
        forced = slip.carried(self._acceleration - force[slip.nodes] + slip.slid(a), lumping)
        parts = own.value * forced[own.number, None], np.hstack([inertia, stabilisation]) * a[terms.number, None]
        # Each of these rows is one of the matrix, too.
        filled, constant = _summed(np.concatenate([own.node, terms.node]), np.concatenate(parts))
        offsets = np.zeros(nodes + 1, dtype=np.int32)
        np.cumsum(np.bincount(row_of, minlength=nodes), out=offsets[1:])
        put = buffers.upload
        self._count, self._offsets = len(filled), put("slip.offsets", offsets)
        self._matrix = (
            put("slip.rows", filled.astype(np.int32)),
            put("slip.row_offsets", np.append(offsets[filled], offsets[-1])),
            put("slip.columns", columns.astype(np.int32)),
            put("slip.values", values.ravel()),
        )
        self._constant = put("slip.constant", constant.ravel())

    def _of_displacements(self) -> _Rows:
        """s(u), with three columns for the unknowns of a node."""
        slip, count = self._slip, len(self._slip.owner)
        number = np.concatenate([np.repeat(np.arange(count), np.diff(slip.offsets)), np.arange(count)])
        weight = np.concatenate([slip.weight, np.full(count, -1.0)]) * slip.part[number]
        value = np.zeros((len(number), 3))
        value[:, :2] = weight[:, None] * slip.tangent[number]
        order = np.argsort(number, kind="stable")
        return _Rows(number[order], np.concatenate([slip.beside, slip.owner])[order], value[order])

    def _of_cells(self, cut: CutMesh, tau: Array, position: Array, own: _Rows) -> _Rows:
        """The sums over the cells around each particle, with s(u) as ``own``.

        With the columns Z^T M of displacements (2), see `InterfaceSlip.carried`; Z^T M Z s(u) of displacements (2);
        A / 3 t . grad p of pressures, and that times tau; the mass rho A / 3 t . grad phi that moves to a particle.
        """
        slip, mesh = self._slip, cut.mesh
        nodes = mesh.cells[slip.cell]
        x = position[cut.owner[nodes]]
        side = mesh.period.shortest(np.roll(x, -2, axis=1) - np.roll(x, -1, axis=1))
        double = side[:, 0, 0] * side[:, 1, 1] - side[:, 0, 1] * side[:, 1, 0]
        gradient = np.stack([-side[:, :, 1], side[:, :, 0]], axis=2)
        gradient *= (mesh.measure[slip.cell] / 3 / double)[:, None, None]
        cell, corner = np.nonzero(slip.corner >= 0)
        number, others = slip.corner[cell, corner], slip.corner[cell]
        tangent, lumped = slip.tangent[number], self._lumping[cell, None]
        weight = (lumped * (corner[:, None] == np.arange(3)) + (1 - lumped) / 3) * (slip.cell_mass[cell] / 3)[:, None]
        pressure = (gradient[cell] @ tangent[:, :, None])[:, :, 0]
        there = others >= 0
        cosine = np.einsum("jkd,jd->jk", slip.tangent[others], tangent)
        first, second = _pairs(others[there], own.number, len(slip.owner))
        size, more = 3 * len(number), len(first)
        value = np.zeros((2 * size + more, 7))
        value[:size, :2] = (weight[:, :, None] * tangent[:, None]).reshape(-1, 2)
        value[:size, 6] = (pressure * (slip.cell_mass / mesh.measure[slip.cell])[cell, None]).ravel()
        value[size : size + more, 2:4] = (weight * cosine)[there][first, None] * own.value[second, :2]
        value[size + more :, 4] = pressure.ravel()
        value[size + more :, 5] = (pressure * tau[cell, None]).ravel()
        of = np.repeat(number, 3)
        node = np.concatenate([slip.nodes[cell].ravel(), own.node[second], nodes[cell].ravel()])
        count = len(cut.owner)
        key, value = _summed(np.concatenate([of, of[there.ravel()][first], of]) * count + node, value)
        return _Rows(*np.divmod(key, count), value)

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

    def add_to_diagonal(self) -> None:
        """Add the matrix's diagonal to that of the momentum rows, one over which their scale is."""
        work = (self._count, slip_kernels.ROW)
        launch(slip_kernels.add_diagonal, *self._matrix, self._scale, self._count, work=work)

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

    def forces(self, x: Any) -> Array:
        """(P, 2) what the equations at ``x`` add to the momentum rows beside what is tested with s(u') [N].

        At particles of walls it is what the walls exert.
        """
        return self._forces(*self._slips(x)[1:])

    def work(self, x: Any, wall: Array) -> SlipWork:
        """Work of the equations at ``x``, with the mask (N,) of the particles on walls."""
        slip, (values, slid, slips) = self._slip, self._slips(x)
        u, (number, node, _) = values[:, :2], self._terms
        cells = u[slip.nodes]
        accelerated = slip.carried(self._cm * cells + self._acceleration + slip.slid(slips), self._lumping)
        held = np.flatnonzero(wall)
        reaction = self._forces(slid, slips)[held]
        return SlipWork(
            inertia=float(slid @ accelerated + slip.carried(cells, self._lumping) @ slips),
            stabilisation=float((self._stabilisation * values[node, 2]) @ slips[number]),
            weight=float(np.einsum("ek,ek->e", self._weight, u[node]) @ slid[number]),
            walls=float((reaction * u[held]).sum()),
            wall_force=reaction.sum(axis=0),
            force=(slip.mass * slips) @ slip.tangent,
        )

    def _slips(self, x: Any) -> tuple[Array, Array, Array]:
        """Unknowns (P, 3) at ``x``, s (C,) of their displacements, and of the accelerations."""
        values = download(x, self._size).astype(np.float64, copy=False).reshape(-1, 3)
        slid = self._slip.slip(values[:, :2])
        return values, slid, self._cm * slid + self._slip_acceleration

    def _forces(self, slid: Array, slips: Array) -> Array:
        """See `forces`, from the s (C,) of displacements and of accelerations."""
        number, node, _ = self._terms
        force = self._inertia * slips[number, None] - self._weight * slid[number, None]
        return np.stack([np.bincount(node, part, self._size // 3) for part in force.T], axis=1)


class _Rows(NamedTuple):
    """Entries of a matrix whose rows are the particles that slide, and whose columns are kinds of unknowns of nodes.

    Attributes:
        number: (E,) row of each entry, ascending.
        node: (E,) whose unknowns.
        value: (E, c).
    """

    number: Array
    node: Array
    value: Array


def _pairs(one: Array, other: Array, count: int) -> tuple[Array, Array]:
    """All pairs of entries of two lists that have the same number below ``count``; the second list ascends."""
    first = np.searchsorted(other, np.arange(count + 1))
    length = np.diff(first)[one]
    of = np.repeat(np.arange(len(one)), length)
    ahead = np.cumsum(length) - length
    return of, np.arange(len(of)) + (first[one] - ahead)[of]


def _summed(key: Array, values: Array) -> tuple[Array, Array]:
    """The different keys (K,), ascending, and the sums (K, c) of the values (E, c) of each."""
    order = np.argsort(key, kind="stable")
    key = key[order]
    first = np.flatnonzero(np.diff(key, prepend=-1))
    return key[first], np.add.reduceat(values.take(order, axis=0), first)
