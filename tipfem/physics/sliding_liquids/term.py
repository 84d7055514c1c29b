"""SlidingLiquidsTerm: the equations of liquids that slide along each other.

At the particle i of an interface the lighter liquid has the displacement u_i + s t, see `slip`. In the momentum
equations that is a virtual displacement, too. With m the mass of the lighter liquid at i, its cells e of the areas A,
and s(u), s(a) of displacements and accelerations, the weak forms are added to by

    momentum:    m [t . (a_i - b + s(a) t) s(u') + t . u'_i s(a)] + sum_e A / 3 (t . grad p) s(u')
                 - c_f sum_e rho A / 3 (t . grad (b . u')) s(u)
    continuity:  -sum_e A / 3 (t . grad q) s(u) + sum_e tau A / 3 (t . grad q) s(a)

for virtual displacements u' and pressures q; in 3-D with V / 4 for A / 3, and for each of the two tangents; of rings, a
corner's part of the volume. Pressure acts by its gradient, and a volume moves from cell to cell by the same
coefficients. So what slides does not pass through the interface, however it bends; nothing is gained or lost between
the two equations; the volume of each component stays, as the gradients of a cell's q sum to zero; and where grad p =
rho b in the lighter liquid, as at rest, there is no force on what slides. The second line is the weight of the volumes
that have moved from node to node at the intermediate time, c_f u, at which pressure acts on the cells: with that of the
start alone, pressure and weight are out of balance by a part to dt s, which damps waves. The last term is the slip in
the acceleration that stabilises the pressure. Viscous stress acts as if nothing slid: mu / h times the slip, between
the particles on the interface and those beside.

Gradients are those at the intermediate positions as the first iterate has them, and t is that at the start of the step.
So all of this is linear: a constant matrix and a constant vector for the step.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from scipy import sparse

from tipfem.backend.launch import launch
from tipfem.geometry.period import Period
from tipfem.linalg.sparsity import Csr
from tipfem.mesh.cut import CutMesh
from tipfem.mesh.mesh import simplex_measure
from tipfem.physics import linear_rows
from tipfem.physics.sliding_liquids.slip import InterfaceSlip
from tipfem.physics.term import Equations, Term, TermWork
from tipfem.typing import Array


class SlidingLiquidsTerm(Term):
    """The equations on a cut mesh of P nodes, on the device; ``follows_rate``: see `InterfaceSlip.after`."""

    def __init__(self, slip: InterfaceSlip, cut: CutMesh, *, follows_rate: bool = False) -> None:
        self._slip, self._cut, self._follows_rate = slip, cut, follows_rate
        self._dim = cut.mesh.dimension

    def begin(self, equations: Equations, first_node: int) -> None:
        """See `Term.begin`."""
        slip, cut, e, scheme = self._slip, self._cut, equations, equations.scheme
        self._equations, self._cm, given = e, scheme.cm, e.properties
        self._lumping = lumping = given.lumped[slip.cell]
        measure = np.abs(simplex_measure(e.mesh.position, e.mesh.cells[slip.cell], e.mesh.period.planar))
        length2 = 4 / math.pi * measure if cut.mesh.dimension == 2 else np.cbrt(6 / math.pi * measure) ** 2
        viscous = 12 * given.viscosity[slip.cell] / (given.density[slip.cell] * length2)
        tau = scheme.dt / np.hypot(1 / (e.stabilisation * scheme.dt), viscous)
        position = e.mesh.position + scheme.cf * scheme.predict(e.particles.velocity, e.particles.acceleration)
        acceleration, force = e.relative + e.force, e.force
        self._acceleration = acceleration[slip.nodes]
        self._slip_acceleration = a = slip.slip(acceleration)
        nodes, dim = len(cut.owner), self._dim
        own = self._of_displacements(nodes)
        terms = self._of_cells(cut, tau, position, own)
        self._terms = _entries(terms)
        _, node, value = self._terms
        inertia, together, plain, stabilisation, moved = np.split(value, (dim, 2 * dim, 2 * dim + 1, 2 * dim + 2), 1)
        self._inertia, self._stabilisation = inertia, stabilisation[:, 0]
        self._weight = scheme.cf * moved * force[cut.owner[node]]
        row, column, steady = (
            _blocks(np.hstack(parts), node, terms.indptr, nodes)
            for parts in (
                (scheme.cm * (inertia + together), plain),
                (scheme.cm * inertia - self._weight, scheme.cm * stabilisation - plain),
                (inertia, stabilisation),
            )
        )
        matrix = own.T @ row + column.T @ own
        matrix.sort_indices()
        forced = slip.carried(self._acceleration - force[slip.nodes] + slip.slid(a), lumping)
        constant = (own.T @ forced + steady.T @ a).reshape(nodes, -1)
        length = np.diff(matrix.indptr)
        filled = np.flatnonzero(length)  # each of these rows has a constant, too
        self._couplings = np.repeat(np.arange(nodes), length), matrix.indices
        put = e.buffers.upload
        self._count = len(filled)
        self._matrix = (
            put("slip.rows", filled.astype(np.int32)),
            put("slip.row_offsets", np.append(matrix.indptr[filled], matrix.indptr[-1]).astype(np.int32)),
            put("slip.columns", matrix.indices.astype(np.int32)),
            put("slip.values", matrix.data.ravel()),
        )
        self._constant = put("slip.constant", constant[filled].ravel())

    def _of_displacements(self, nodes: int) -> sparse.bsr_array:
        """s(u): a row for each slip, with blocks of d + 1 columns for the unknowns of a node."""
        slip, count = self._slip, len(self._slip.owner)
        number = np.concatenate([np.repeat(np.arange(count), np.diff(slip.offsets)), np.arange(count)])
        weight = np.concatenate([slip.weight, np.full(count, -1.0)]) * slip.part[number]
        value = np.zeros((len(number), slip.tangent.shape[1] + 1))
        value[:, :-1] = weight[:, None] * slip.tangent[number]
        order = np.argsort(number, kind="stable")
        starts = slip.offsets + np.arange(count + 1)
        return _blocks(value[order], np.concatenate([slip.beside, slip.owner])[order], starts, nodes)

    def _of_cells(self, cut: CutMesh, tau: Array, position: Array, own: sparse.bsr_array) -> sparse.bsr_array:
        """The sums over the cells around each slip: a row for it, with s(u) as ``own``.

        With the columns Z^T M of displacements (d), see `InterfaceSlip.carried`; Z^T M Z s(u) of displacements (d);
        A / 3 t . grad p of pressures, and that times tau; the mass rho A / 3 t . grad phi that moves to a particle.
        """
        slip, mesh, dim = self._slip, cut.mesh, cut.mesh.dimension
        nodes, corners, count = mesh.cells[slip.cell], dim + 1, len(slip.owner)
        gradient = _gradients(mesh.period, position[cut.owner[nodes]])
        volume = slip.share * mesh.measure[slip.cell, None]  # of each corner
        cell, corner, way = np.nonzero(slip.corner >= 0)
        number, others = slip.corner[cell, corner, way], slip.corner[cell]
        tangent, lumped = slip.tangent[number], self._lumping[cell, None]
        own_corner = corner[:, None] == np.arange(corners)
        weight = (lumped * own_corner + (1 - lumped) * slip.share[cell]) * slip.corner_mass[cell, corner, None]
        pressure = np.einsum("jkd,jd->jk", gradient[cell], tangent) * volume[cell, corner, None]
        size, width = corners * len(number), 2 * dim + 3
        value = np.zeros((2 * size, width))
        value[:size, :dim] = (weight[:, :, None] * tangent[:, None]).reshape(-1, dim)
        value[:size, 2 * dim + 2] = (pressure * (slip.cell_mass / mesh.measure[slip.cell])[cell, None]).ravel()
        value[size:, 2 * dim] = pressure.ravel()
        value[size:, 2 * dim + 1] = (pressure * tau[cell, None]).ravel()
        node = np.concatenate([slip.nodes[cell].ravel(), nodes[cell].ravel()])
        entries, of = np.arange(2 * size), np.tile(np.repeat(number, corners), 2)
        summed = _bsr(sparse.csr_array((np.ones(2 * size), (of, entries)), shape=(count, 2 * size)))
        found = summed @ _blocks(value, node, np.append(entries, 2 * size), len(cut.owner))
        # What slides at other corners of the cells.
        there = others >= 0
        cosine = np.einsum("jkrd,jd->jkr", slip.tangent[others], tangent)
        pairs = np.repeat(number, corners * (dim - 1))[there.ravel()], others[there]
        together = sparse.csr_array(((weight[:, :, None] * cosine)[there], pairs), shape=(count, count))
        along = np.zeros((len(own.indices), width))
        along[:, dim : 2 * dim] = own.data[:, 0, :dim]
        return found + _bsr(together) @ _blocks(along, own.indices, own.indptr, len(cut.owner))

    def couplings(self, *, near: bool) -> tuple[Array, Array]:
        """See `Term.couplings`."""
        return self._couplings

    def diagonal(self) -> None:
        """See `Term.diagonal`."""
        work = (self._count, linear_rows.ROW)
        launch(linear_rows.add_diagonal, *self._matrix, self._equations.scale, self._count, self._dim, work=work)

    def gather(self, matrix: Csr) -> None:
        """See `Term.gather`."""
        e, work = self._equations, (self._count, linear_rows.ROW)
        launch(linear_rows.add_blocks, *self._matrix, e.scale, matrix, e.rows, self._count, self._dim, work=work)

    def residual(self, x: Any, out: Any) -> None:
        """See `Term.residual`."""
        work = (self._count, linear_rows.ROW)
        arrays = (*self._matrix, self._constant, self._equations.scale, x, out, self._count, self._dim)
        launch(linear_rows.add_product, *arrays, work=work)

    def carried(self, x: Any) -> InterfaceSlip | None:
        """See `Term.carried`."""
        if not self._follows_rate:
            return None
        dt, (_, slid, slips) = self._equations.scheme.dt, self._slips(x)
        return self._slip.after(slid / dt, slips, dt)

    def forces(self, x: Any) -> Array:
        """See `Term.forces`: all but what is tested with s(u')."""
        return self._forces(*self._slips(x)[1:])

    def work(self, x: Any, displacement: Array) -> TermWork:
        """See `Term.work`."""
        slip, wall, (values, slid, slips) = self._slip, self._equations.particles.wall, self._slips(x)
        u, (number, node, _) = values[:, : self._dim], self._terms
        cells = u[slip.nodes]
        accelerated = slip.carried(self._cm * cells + self._acceleration + slip.slid(slips), self._lumping)
        held = np.flatnonzero(wall)
        reaction = self._forces(slid, slips)[held]
        weight = float(np.einsum("ek,ek->e", self._weight, u[node]) @ slid[number])
        return TermWork(
            inertia=float(slid @ accelerated + slip.carried(cells, self._lumping) @ slips),
            stabilisation=float((self._stabilisation * values[node, self._dim]) @ slips[number]),
            weight=weight,
            geometry=weight,
            walls=float((reaction * u[held]).sum()),
            wall_force=reaction.sum(axis=0),
            force=(slip.mass * slips) @ slip.tangent,
        )

    def _slips(self, x: Any) -> tuple[Array, Array, Array]:
        """Unknowns (P, d + 1) at ``x``, s (C,) of their displacements, and of the accelerations."""
        values = self._equations.values(x)
        slid = self._slip.slip(values)
        return values, slid, self._cm * slid + self._slip_acceleration

    def _forces(self, slid: Array, slips: Array) -> Array:
        """See `forces`, from the s (C,) of displacements and of accelerations."""
        number, node, _ = self._terms
        force = self._inertia * slips[number, None] - self._weight * slid[number, None]
        return np.stack([np.bincount(node, part, len(self._cut.owner)) for part in force.T], axis=1)


def _gradients(period: Period, x: Array) -> Array:
    """Gradients (K, d + 1, d) of the shape functions of cells with corners (K, d + 1, d)."""
    inverse = np.linalg.inv(period.shortest(x[:, 1:] - x[:, :1])).transpose(0, 2, 1)
    return np.asarray(np.concatenate([-inverse.sum(axis=1)[:, None], inverse], axis=1))


def _blocks(value: Array, node: Array, starts: Array, nodes: int) -> sparse.bsr_array:
    """A matrix whose rows have blocks of ``value`` (E, c), each from its ``starts`` on, at nodes (E,) of ``nodes``."""
    shape = len(starts) - 1, nodes * value.shape[1]
    return sparse.bsr_array((value[:, None, :], node, starts), shape=shape, blocksize=(1, value.shape[1]))


def _bsr(matrix: sparse.csr_array) -> sparse.bsr_array:
    """The same by blocks of one entry, whose products with others are by their blocks."""
    return matrix.tobsr((1, 1))


def _entries(matrix: sparse.bsr_array) -> tuple[Array, Array, Array]:
    """Rows (E,), nodes (E,) and values (E, c) of a matrix of `_blocks`."""
    return np.repeat(np.arange(matrix.shape[0]), np.diff(matrix.indptr)), matrix.indices, matrix.data[:, 0]
