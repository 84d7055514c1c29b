"""Floating bodies in the linear systems of a step: their freedoms in place of their particles' displacements.

The particles of a body are displaced by u = U + (R - 1) r with three unknowns a body, U and the angle of R. So the
Jacobian of the remaining unknowns is T^T K T plus that of the bodies' own equations, where T = d u / d (U, angle):
corrections are spread to the particles before a product with K, and the rows of momentum of the particles are summed
after it, to the force and the moment on the body. The sum is taken with the particles' positions at the intermediate
time, where forces act. Vectors keep entries for the displacements of these particles: in unknowns and corrections they
are those of the body, in residuals zero. There is no iteration between fluids and bodies, and no mass that is added by
hand: light bodies are as stable as heavy ones.

The preconditioner eliminates the bodies' increments as it does displacements. The Schur complement of the pressure is
then S + W B^-1 W^T, with the bodies' own matrices B and the volumes W that they sweep; by the Woodbury identity its
inverse needs three cycles for S^-1 W once in a step, and a few sums in each iteration. W^T S^-1 W is the bodies' added
mass.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from tipfem.backend.arrays import Buffers, download
from tipfem.backend.launch import launch
from tipfem.mesh.mesh import Mesh
from tipfem.step import body_kernels as kernels
from tipfem.step.linear_system import LinearSystem, Topology
from tipfem.typing import Array
from tipfem.walls.bodies import BodyWalls, turned


class BodyRows:
    """The unknowns and equations of the bodies that float, on the device.

    Args:
        walls: of the step, with bodies.
        mesh: of the equations: P nodes on N particles.
        owner: (P,) particle of each node, None where they are the same.
        properties: (M,) density [kg/m^3] and viscosity [Pa s] of the elements, and part of their mass that is lumped.
        force: (N, 2) acceleration by gravity and the like [m/s^2].
        pinned: (P,) mask of the nodes whose pressure is prescribed.
        system: of the step, whose grids and scales are set.
        scale: (P 3 + 3 B,) of the rows on the device; those of the bodies and their particles are set here.
        buffers: where the arrays live.

    Attributes:
        numbers: (B,) of the bodies that float, among those of the case.
        lengths: (B,) by which angles are multiplied to unknowns [m].
    """

    def __init__(
        self,
        walls: BodyWalls,
        mesh: Mesh,
        owner: Array | None,
        properties: tuple[Array, Array, Array],
        force: Array,
        pinned: Array,
        system: LinearSystem,
        scale: Any,
        buffers: Buffers,
    ) -> None:
        self._walls, self._scheme, self._scale, self._buffers, self._system = (
            walls,
            walls.scheme,
            scale,
            buffers,
            system,
        )
        self.numbers = np.flatnonzero(walls.floating)
        self._count, self._nodes = len(self.numbers), len(mesh.position)
        self._base = 3 * self._nodes
        self._find_nodes(owner)
        r = mesh.position[self._index] - walls.states.position[self._of, :2]
        far = np.zeros(self._count)
        np.maximum.at(far, self._body, np.linalg.norm(r, axis=1))
        self.lengths = far
        put = buffers.upload
        arm = np.zeros((len(r), kernels.ARM))
        arm[:, :2] = arm[:, 2:4] = arm[:, 4:] = r
        self._index_d, self._offsets_d = put("bodies.index", self._index), put("bodies.offsets", self._offsets)
        self._arm = put("bodies.arm", arm)
        particle = self._index if owner is None else owner[self._index]
        self._force = put("bodies.force", force[particle])
        self._table = self._constants(force, walls.states.label)
        self._constants_d = put("bodies.body", self._table)
        s = walls.scheme
        rates = np.array([s.cm, s.cv, s.cf, s.alpha_m, s.gamma / (s.beta * s.dt), 1 / (s.beta * s.dt**2)])
        self._rates = put("bodies.scheme", rates)
        self._own = put("bodies.own", np.zeros((self._count, kernels.OWN)))
        self._start = buffers.get("bodies.start", 3 * self._count)
        self._find_ring(mesh)
        self._build(mesh, r, properties, pinned, system)

    def _find_nodes(self, owner: Array | None) -> None:
        """The nodes on bodies that float, in the order of the bodies."""
        label = self._walls.states.label
        label = label if owner is None else label[owner]
        rank = np.full(len(self._walls.bodies) + 1, -1)
        rank[self.numbers] = np.arange(self._count)
        node_rank = rank[label]  # -1 for no body is the last entry
        index = np.flatnonzero(node_rank >= 0)
        index = index[np.argsort(node_rank[index], kind="stable")]
        self._index, self._body = index.astype(np.int32), node_rank[index]
        self._of = self.numbers[self._body]
        self._offsets = np.append(0, np.cumsum(np.bincount(self._body, minlength=self._count))).astype(np.int32)
        self._slot = np.full(len(node_rank), -1, dtype=np.int32)
        self._slot[index] = np.arange(len(index))
        self._rank = node_rank

    def _constants(self, force: Array, label: Array) -> Array:
        """(B, BODY) of the bodies, see `body_kernels`."""
        s, states, k = self._scheme, self._walls.states, kernels
        table = np.zeros((self._count, k.BODY))
        by_v, by_a = -1 / (s.beta * s.dt), 1 - 0.5 / s.beta
        for row, b, length in zip(table, self.numbers.tolist(), self.lengths, strict=True):
            body, free = self._walls.bodies[b], self._walls.free[b]
            x, v, a = states.position[b], states.velocity[b] * free, states.acceleration[b] * free
            share = s.cf * s.dt
            row[[k.MASS, k.INERTIA, k.LENGTH]] = body.total_mass, body.inertia_about_reference, length
            row[k.VELOCITY : k.VELOCITY + 3], row[k.ACCELERATION : k.ACCELERATION + 3] = v, a
            row[k.V_HISTORY : k.V_HISTORY + 3] = (1 + share * s.gamma * by_v) * v + share * (
                1 - s.gamma + s.gamma * by_a
            ) * a
            row[k.A_HISTORY : k.A_HISTORY + 3] = (1 - s.alpha_m) * by_v * v + ((1 - s.alpha_m) * by_a + s.alpha_m) * a
            row[k.STIFFNESS : k.STIFFNESS + 3] = body.stiffness
            row[k.SPRING : k.SPRING + 3] = np.asarray(body.stiffness) * (x - np.append(body.reference, 0.0))
            row[k.DAMPING : k.DAMPING + 3] = body.damping
            cosine, sine = np.cos(x[2]), np.sin(x[2])
            row[k.CENTRE : k.CENTRE + 2] = np.array([[cosine, -sine], [sine, cosine]]) @ (
                body.centre_of_mass - body.reference
            )
            # A body force that varies in space is taken at the mean of the body's particles.
            row[k.GRAVITY : k.GRAVITY + 2] = force[label == b].mean(axis=0)
        return table

    def _find_ring(self, mesh: Mesh) -> None:
        """The elements at bodies, and pairs of their nodes and the bodies; see `body_kernels.rotation_terms`."""
        rank = self._rank[mesh.cells]
        at = np.flatnonzero((rank >= 0).any(axis=1))
        # A row for each element and each body that it has corners on.
        rank = rank[at]
        rows = np.unique((at[:, None] * self._count + rank)[rank >= 0])
        cell, body = rows // self._count, rows % self._count
        self._ring_cell, self._ring_body = cell, body
        on = self._rank[mesh.cells[cell]] == body[:, None]
        self._ring_on = on
        bits = (on * np.array([1, 2, 4])).sum(axis=1)
        slots = np.where(on, self._slot[mesh.cells[cell]], 0)
        node, corner = mesh.cells[cell].ravel().astype(np.int64), (3 * cell[:, None] + np.arange(3)).ravel()
        key = node * self._count + np.repeat(body, 3)
        order = np.argsort(key, kind="stable")
        pair, first = np.unique(key[order], return_index=True)
        pair_node, pair_body = pair // self._count, pair % self._count
        ring, start = np.unique(pair_node, return_index=True)
        put = self._buffers.upload
        part = order // 3
        self._pairs = put("bodies.pairs", pair_body.astype(np.int32))
        self._parts = put("bodies.parts", np.append(first, len(order)).astype(np.int32))
        self._corners = put("bodies.corners", corner[order].astype(np.int32))
        self._bits = put("bodies.bits", bits[part].astype(np.int32))
        self._slots = put("bodies.slots", slots[part].ravel().astype(np.int32))
        self._ring = put("bodies.ring", ring.astype(np.int32))
        self._ring_starts = put("bodies.ring_starts", np.append(start, len(pair)).astype(np.int32))
        self._terms = self._buffers.get("bodies.terms", max(len(pair), 1), 3)
        self._pair_count, self._ring_count = len(pair), len(ring)

    def _build(
        self, mesh: Mesh, r: Array, properties: tuple[Array, Array, Array], pinned: Array, system: LinearSystem
    ) -> None:
        """Scales of the bodies' rows, and the preconditioner."""
        s, count, put = self._scheme, self._count, self._buffers.upload
        density, viscosity, lumping = properties
        cell, body, on = self._ring_cell, self._ring_body, self._ring_on
        corners = mesh.cells[cell]
        x = mesh.position[corners]
        # d V / d x of a triangle by a corner, its area times the gradient: half the opposite side, turned.
        side = 0.5 * turned((np.roll(x, -2, axis=1) - np.roll(x, -1, axis=1)).reshape(-1, 2)).reshape(-1, 3, 2)
        area = 0.5 * np.abs(
            (x[:, 1, 0] - x[:, 0, 0]) * (x[:, 2, 1] - x[:, 0, 1])
            - (x[:, 1, 1] - x[:, 0, 1]) * (x[:, 2, 0] - x[:, 0, 0])
        )
        slots = np.where(on, self._slot[corners], 0)
        arm = r[slots]  # (Q, 3, 2)
        free = self._walls.free[self.numbers][body].astype(float)  # (Q, 3)
        along = np.zeros((len(cell), 3, 2, 3))  # d u of the corner / d freedom
        along[..., 0, 0] = along[..., 1, 1] = 1.0
        along[..., 2] = turned(arm.reshape(-1, 2)).reshape(arm.shape) / self.lengths[body][:, None, None]
        along *= free[:, None, None, :] * on[:, :, None, None]
        swept = np.einsum("qai,qaik->qk", side, along) / 3  # of each corner of the cell
        # B: mass and viscosity of the elements at the bodies, and the bodies' own.
        gradient = side / area[:, None, None]
        shear = np.einsum("qaik,qaj->qkij", along, gradient)
        both = shear + shear.transpose(0, 1, 3, 2)
        own = (viscosity[cell] * area * s.cv)[:, None, None] * np.einsum("qkij,qmij->qkm", shear, both)
        share, total = lumping[cell][:, None, None], along.sum(axis=1)
        mass = share * np.einsum("qaik,qaim->qkm", along, along)
        mass += (1 - share) / 3 * np.einsum("qik,qim->qkm", total, total)
        own += (density[cell] * area / 3 * s.cm)[:, None, None] * mass
        matrix = np.zeros((count, 3, 3))
        np.add.at(matrix, body, own)
        k = kernels
        inertia = self._table[:, [k.MASS, k.MASS, k.INERTIA]] * s.cm
        inertia += (
            self._table[:, k.DAMPING : k.DAMPING + 3] * s.cv + self._table[:, k.STIFFNESS : k.STIFFNESS + 3] * s.cf
        )
        unit = np.stack([np.ones(count), np.ones(count), 1 / self.lengths], axis=1)
        is_free = self._walls.free[self.numbers]
        matrix[:, range(3), range(3)] += np.where(is_free, inertia * unit**2, 1.0)
        inverse = np.linalg.inv(matrix)
        inverse *= is_free[:, :, None] * is_free[:, None, :]
        self._inverse = put("bodies.inverse", inverse.reshape(count, 9))
        # W, by pairs of a body and a node.
        node, of = corners.ravel().astype(np.int64), np.repeat(body, 3)
        pair, where = np.unique(of * self._nodes + node, return_inverse=True)
        weight = np.stack([np.bincount(where, np.repeat(w, 3), minlength=len(pair)) for w in swept.T], axis=1)
        row_node, row_body = pair % self._nodes, pair // self._nodes
        weight[pinned[row_node]] = 0.0
        self._row_nodes = put("bodies.row_nodes", row_node.astype(np.int32))
        starts = np.append(0, np.cumsum(np.bincount(row_body, minlength=count)))
        self._row_starts = put("bodies.row_starts", starts.astype(np.int32))
        self._weights = put("bodies.weights", weight)
        response, added = np.zeros((3 * count, self._nodes)), np.zeros((3 * count, 3 * count))
        for column in range(3 * count):
            b, f = divmod(column, 3)
            if is_free[b, f]:
                rhs = np.zeros(self._nodes)
                mine = row_body == b
                rhs[row_node[mine]] = weight[mine, f]
                response[column] = system.pressure_of(rhs)
        for b in range(count):
            mine = row_body == b
            added[3 * b : 3 * b + 3] = weight[mine].T @ response[:, row_node[mine]].T
        full = added.copy()
        for b in range(count):
            full[3 * b : 3 * b + 3, 3 * b : 3 * b + 3] += matrix[b]
        self._response = put("bodies.response", response.ravel())
        self._mobility = put("bodies.mobility", np.linalg.inv(full))
        self._reaction = self._buffers.get("bodies.reaction", 6 * count)
        # A residual is the increment that would remove it, with the mass that the body and the fluids have together.
        total = np.diag(full).reshape(count, 3)
        scales = np.where(is_free, 1 / total, 0.0)
        particle = np.repeat((np.diff(self._offsets) / np.maximum(total[:, 0], total[:, 1])), np.diff(self._offsets))
        launch(
            kernels.set_scales,
            self._index_d,
            put("bodies.particle_scale", particle),
            put("bodies.scale", scales.ravel()),
            self._scale,
            self._base,
            len(self._index),
            3 * count,
        )

    def vector(self, increment: Array) -> Array:
        """The unknowns (3 B,) for increments of all bodies of the case (C, 3)."""
        q = increment[self.numbers].copy()
        q[:, 2] *= self.lengths
        return np.asarray(q.ravel())

    def increments(self, x: Any) -> Array:
        """Increments (C, 3) of all bodies of the case, from a vector of unknowns; zero for those that do not float."""
        result = np.zeros((len(self._walls.bodies), 3))
        tail = download(x, self._base + 3 * self._count)[self._base :].astype(np.float64)
        q = tail.reshape(-1, 3).copy()
        q[:, 2] /= self.lengths
        result[self.numbers] = q
        return np.asarray(result)

    def place(self, x: Any, motion: Any) -> None:
        """Displace the bodies' particles by the bodies' increments in ``x``, and set their rates in ``motion``."""
        launch(
            kernels.place,
            self._index_d,
            self._offsets_d,
            self._constants_d,
            self._rates,
            self._force,
            self._arm,
            motion,
            x,
            self._own,
            self._base,
            self._count,
        )

    def residual(self, x: Any, r: Any) -> None:
        """Put the bodies' equations in place of their particles' momentum in the residual ``r`` at ``x``."""
        launch(
            kernels.collect_residual,
            self._index_d,
            self._offsets_d,
            self._constants_d,
            self._rates,
            self._arm,
            x,
            self._scale,
            r,
            self._own,
            self._base,
            self._count,
        )

    def linearise(self, density: Any, lumping: Any, record: Any) -> None:
        """Compute the derivatives by the angles that do not follow from displacements, at the last residual."""
        launch(
            kernels.rotation_terms,
            self._pairs,
            self._parts,
            self._corners,
            self._bits,
            self._slots,
            density,
            lumping,
            record,
            self._arm,
            self._own,
            self._terms,
            self._pair_count,
        )

    def product(self, v: Any, out: Any) -> None:
        """Put the bodies' rows in place of their particles' in out = K v."""
        launch(
            kernels.collect_product,
            self._index_d,
            self._offsets_d,
            self._arm,
            self._constants_d,
            self._own,
            self._ring,
            self._ring_starts,
            self._pairs,
            self._terms,
            self._scale,
            v,
            out,
            self._base,
            self._ring_count,
            self._count,
        )

    def begin(self, r: Any) -> None:
        """Give the bodies' particles in a residual the increments that the bodies' own matrices give."""
        launch(
            kernels.begin_precondition,
            self._index_d,
            self._offsets_d,
            self._arm,
            self._constants_d,
            self._inverse,
            self._scale,
            r,
            self._start,
            self._base,
            self._count,
        )

    def clear(self, r: Any) -> None:
        """Undo `begin`."""
        launch(kernels.clear, self._index_d, r, len(self._index))

    def correct_pressure(self, vectors: Any) -> None:
        """Correct the multigrid's solution for the mobility of the bodies."""
        launch(
            kernels.add_bodies_mobility,
            self._row_starts,
            self._row_nodes,
            self._weights,
            self._response,
            self._mobility,
            vectors,
            self._reaction,
            self._nodes,
            self._count,
        )

    def end(self, z: Any) -> None:
        """Set the bodies' increments in a correction, and displace their particles by them."""
        launch(
            kernels.end_precondition,
            self._index_d,
            self._offsets_d,
            self._arm,
            self._constants_d,
            self._inverse,
            self._start,
            self._scale,
            z,
            self._base,
            self._count,
        )


def measure_forces(walls: BodyWalls, topology: Topology, owner: Array | None, local: Any, buffers: Buffers) -> None:
    """Tell walls with bodies the forces of the fluids on them, from the elements' vectors of the last residual.

    Args:
        walls: of the step, with the bodies' solution.
        topology: of the step's mesh, on the device.
        owner: (P,) particle of each node of it; None where they are the same.
        local: element vectors on the device.
        buffers: where arrays live.
    """
    label = walls.states.label if owner is None else walls.states.label[owner]
    index = np.flatnonzero(label >= 0).astype(np.int32)
    out, count = buffers.get("bodies.forces", len(index), 2), len(index)
    nodes = buffers.upload("bodies.all", index)
    launch(kernels.particle_forces, nodes, topology.offsets, topology.corners, local, out, count)
    holding = download(out, count).astype(np.float64)
    walls.measured(index if owner is None else owner[index], -holding)
