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
from tipfem.step import body_coupling as coupling
from tipfem.step import body_kernels as kernels
from tipfem.step import body_layout as layout
from tipfem.step.linear_system import LinearSystem
from tipfem.typing import Array
from tipfem.walls.bodies import BodyWalls, turned

# Below this fraction of a body's largest volume swept, in the mean square, a freedom sweeps next to none, as the angle
# of a circle: the square is what it adds to the mobility, and no cycle is spent on it.
SWEEPS = 0.05


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
        arrays: device arrays ``bodies`` and ``data``, see `tipfem.step.body_layout`.
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
        self._table = self._constants(force, walls.states.label)
        particle = self._index if owner is None else owner[self._index]
        self._find_ring(mesh)
        self._build(mesh, r, properties, pinned, force[particle])

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
        """(B, BODY_WIDTH) of the bodies, see `body_layout`."""
        s, states, k = self._scheme, self._walls.states, layout
        table = np.zeros((self._count, k.BODY_WIDTH))
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
        self._parts = put("bodies.parts", np.append(first, len(order)).astype(np.int32))
        self._corners = put("bodies.corners", corner[order].astype(np.int32))
        self._bits = put("bodies.bits", bits[part].astype(np.int32))
        self._slots = put("bodies.slots", slots[part].ravel().astype(np.int32))
        self._pairs, self._ring, self._ring_starts = pair_body, ring, np.append(start, len(pair))

    def _build(self, mesh: Mesh, r: Array, properties: tuple[Array, Array, Array], pinned: Array, force: Array) -> None:
        """The data on the device, and from them the preconditioner and the scales of the bodies' rows."""
        s, count = self._scheme, self._count
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
        k = layout
        inertia = self._table[:, [k.MASS, k.MASS, k.INERTIA]] * s.cm
        inertia += (
            self._table[:, k.DAMPING : k.DAMPING + 3] * s.cv + self._table[:, k.STIFFNESS : k.STIFFNESS + 3] * s.cf
        )
        unit = np.stack([np.ones(count), np.ones(count), 1 / self.lengths], axis=1)
        is_free = self._walls.free[self.numbers]
        matrix[:, range(3), range(3)] += np.where(is_free, inertia * unit**2, 1.0)
        inverse = np.linalg.inv(matrix)
        inverse *= is_free[:, :, None] * is_free[:, None, :]
        # W, by pairs of a body and a node.
        node, of = corners.ravel().astype(np.int64), np.repeat(body, 3)
        pair, where = np.unique(of * self._nodes + node, return_inverse=True)
        weight = np.stack([np.bincount(where, np.repeat(w, 3), minlength=len(pair)) for w in swept.T], axis=1)
        swept_node, swept_body = pair % self._nodes, pair // self._nodes
        weight[pinned[swept_node]] = 0.0
        square = np.stack([np.bincount(swept_body, w, minlength=count) for w in (weight**2).T], axis=1)
        sweeps = square > SWEEPS**2 * square.max(axis=1, keepdims=True)
        weight *= sweeps[swept_body]
        rates = np.array([s.cm, s.cv, s.cf, s.alpha_m, s.gamma / (s.beta * s.dt), 1 / (s.beta * s.dt**2)])
        lists = {
            k.INDEX: self._index,
            k.OFFSETS: self._offsets,
            k.RING_NODES: self._ring,
            k.RING_STARTS: self._ring_starts,
            k.PAIRS: self._pairs,
            k.SWEPT_STARTS: np.append(0, np.cumsum(np.bincount(swept_body, minlength=count))),
            k.SWEPT: swept_node,
        }
        tables = {
            k.BODY: self._table,
            k.INVERSE: inverse,
            k.SCHEME: rates,
            k.ARM: np.tile(r, k.ARM_WIDTH // 2),
            k.FORCE: force,
            k.WEIGHTS: weight,
        }
        rooms = {
            k.MOBILITY: 9 * count**2,
            k.REACTION: 6 * count,
            k.FIRST: 3 * count,
            k.OWN: k.OWN_WIDTH * count,
            k.TERMS: 3 * len(self._pairs),
            k.RESPONSE: 3 * count * self._nodes,
        }
        integers, reals, room = layout.pack(lists, tables, rooms)
        self._buffers.get("bodies.data", room)
        self.arrays = self._buffers.upload("bodies.lists", integers), self._buffers.upload("bodies.data", reals)
        self._set_scales(self._respond(matrix, sweeps), is_free)

    def _respond(self, matrix: Array, sweeps: Array) -> Array:
        """Set the pressure's response to the bodies' motions, and the inverse of the bodies' mobility.

        Args:
            matrix: (B, 3, 3) the bodies' own matrices.
            sweeps: (B, 3) mask of the freedoms that sweep volume.

        Returns:
            (3 B, 3 B) the bodies' own matrices and the added mass.
        """
        count, nodes, vectors = self._count, self._nodes, self._system.multigrid.vectors
        for column, solved in enumerate(sweeps.ravel().tolist()):
            if solved:
                launch(coupling.set_swept_volume, *self.arrays, vectors, column, nodes)
                self._system.solve_pressure_without_bodies()
            launch(coupling.store_response, *self.arrays, vectors, column, int(solved), nodes)
        full = download(self.arrays[1], 9 * count**2).astype(float).reshape(3 * count, 3 * count)
        for b in range(count):
            full[3 * b : 3 * b + 3, 3 * b : 3 * b + 3] += matrix[b]
        self._buffers.upload("bodies.data", np.linalg.inv(full).ravel())
        return full

    def _set_scales(self, full: Array, is_free: Array) -> None:
        """A residual is the increment that would remove it, with the mass that the body and the fluids have together.

        Args:
            full: (3 B, 3 B) see `_respond`.
            is_free: (B, 3) mask of the freedoms.
        """
        total = np.diag(full).reshape(self._count, 3)
        each = np.diff(self._offsets)
        particle = np.repeat(each / np.maximum(total[:, 0], total[:, 1]), each)
        launch(
            kernels.set_scales,
            self.arrays[0],
            self._buffers.upload("bodies.particle_scale", particle),
            self._buffers.upload("bodies.scale", np.where(is_free, 1 / total, 0.0).ravel()),
            self._scale,
            self._base,
            len(self._index),
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
        launch(kernels.place, *self.arrays, motion, x, self._base)

    def residual(self, x: Any, r: Any) -> None:
        """Put the bodies' equations in place of their particles' momentum in the residual ``r`` at ``x``."""
        launch(kernels.collect_residual, *self.arrays, self._scale, x, r, self._base)

    def linearise(self, density: Any, lumping: Any, record: Any) -> None:
        """Compute the derivatives by the angles that do not follow from displacements, at the last residual."""
        lists = self._parts, self._corners, self._bits, self._slots
        launch(kernels.rotation_terms, *self.arrays, *lists, density, lumping, record, len(self._pairs))

    def add_rotations(self, v: Any, out: Any) -> None:
        """Add to out = K v what rotations change in it beyond displacements."""
        launch(coupling.add_rotations, *self.arrays, self._scale, v, out, self._base)

    def product(self, v: Any, out: Any) -> None:
        """Put the bodies' rows in place of their particles' in out = K v."""
        launch(coupling.collect_product, *self.arrays, self._scale, v, out, self._base)

    def begin(self, r: Any) -> None:
        """Give the bodies' particles in a residual the increments that the bodies' own matrices give."""
        launch(coupling.begin_precondition, *self.arrays, self._scale, r, self._base)

    def clear(self, r: Any) -> None:
        """Undo `begin`."""
        launch(coupling.clear, self.arrays[0], r)

    def correct_pressure(self, vectors: Any) -> None:
        """Correct the multigrid's solution for the mobility of the bodies."""
        launch(coupling.add_mobility, *self.arrays, vectors, self._nodes)

    def end(self, z: Any) -> None:
        """Set the bodies' increments in a correction, and displace their particles by them."""
        launch(coupling.end_precondition, *self.arrays, self._scale, z, self._base)
