"""FloatingBodies: the unknowns and equations of bodies that float, in place of their particles' displacements.

The particles of a body are displaced by u = U + (R - 1) r with three unknowns a body, U and the angle of R, at two
nodes of its own. They follow these, see `tipfem.fem.condensation`: T = d u / d (U, angle) at the end of the step, and
forces are summed with the particles' positions at the intermediate time, where they act. There is no iteration between
fluids and bodies, and no mass that is added by hand: light bodies are as stable as heavy ones.

The bodies' own matrices B, of mass and viscosity of the fluids beside them and of their own, take the place of the
diagonal: rows are those of force and moment times F = f B^-1, unknowns the increments times f. f is the part that B has
of the mass with which a body moves, so that a residual is as large as the increment that removes it. The
Schur complement of the pressure is then S + W B^-1 W^T with the volumes W that the bodies sweep; by the Woodbury
identity its inverse needs three cycles for S^-1 W once in a step, and a few sums in each iteration. W^T S^-1 W is the
bodies' added mass.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from functools import cached_property
from typing import Any

import numpy as np
from scipy.linalg import block_diag

from tipfem.backend.arrays import download, expect
from tipfem.backend.launch import launch
from tipfem.fem.condensation import Follows
from tipfem.geometry.plane.vectors import turned
from tipfem.linalg import vector_kernels
from tipfem.linalg.low_rank import LowRank
from tipfem.linalg.sparsity import Csr
from tipfem.mesh.mesh import Mesh
from tipfem.physics.bodies import kernels as kernels
from tipfem.physics.bodies import layout as layout
from tipfem.physics.bodies.motion import BodyMotion, rotated
from tipfem.physics.bodies.moved import MovedBodies
from tipfem.physics.contact.forces import FINEST, Trial
from tipfem.physics.contact.mouths import MouthRows, Mouths
from tipfem.physics.term import Equations, TermWork
from tipfem.physics.walls.chords import Slip
from tipfem.typing import Array

# Below this fraction of a body's largest volume swept, in the mean square, a freedom sweeps next to none, as the angle
# of a circle: the square is what it adds to the mobility, and no cycle is spent on it.
SWEEPS = 0.05
# Changes of the contacts' forces between corrections of Newton's method, which then ends with those that there are.
CHANGES = 2


class FloatingBodies(MovedBodies):
    """Bodies in the fluids, of which some float.

    Args:
        motion, friction, closed, young, mouths: see `MovedBodies`.
        pinned: (N,) mask of the particles whose pressure is prescribed.

    Attributes:
        numbers: (B,) of the bodies that float, among those of the case.
        lengths: (B,) by which angles are multiplied [m].
        units: (B, 3) unknown for an increment of one metre.
        arrays: device arrays ``bodies`` and ``data``, see `tipfem.physics.bodies.layout`.
    """

    def __init__(
        self,
        motion: BodyMotion,
        friction: Array,
        pinned: Array,
        *,
        closed: bool | None = None,
        young: Array | None = None,
        mouths: Mouths | None = None,
    ) -> None:
        super().__init__(motion, friction, closed=closed, young=young, mouths=mouths)
        self._rows_of_mouths: MouthRows | None = None
        self._pinned, self.numbers = pinned, np.flatnonzero(motion.floating)
        self._count = len(self.numbers)
        self.extra_nodes = 2 * self._count
        self.units, self._rows = np.ones((self._count, 3)), np.zeros((self._count, 3, 3))
        self._solution: Any = None  # at the last residual, if that has been
        self._residual: Any = None
        self._ends: dict[int, Any] = {}  # of vectors, by their identities, see `_end_of`
        self._changes = 0  # of the contacts' forces
        if (trial := motion.after.trial) is not None and trial.force.any():
            self.noise = FINEST

    def begin(self, equations: Equations, first_node: int) -> None:
        """See `Term.begin`."""
        self._equations, self._buffers, self._scheme = equations, equations.buffers, equations.scheme
        self._nodes, self._base = len(equations.owner), first_node * (equations.dimension + 1)
        assert first_node == self._nodes
        mesh = equations.nodes
        self._find_nodes(equations.owner)
        self._arm = r = mesh.position[self._index] - self.motion.states.position[self._of, :2]
        far = np.zeros(self._count)
        np.maximum.at(far, self._body, np.linalg.norm(r, axis=1))
        self.lengths = far
        self._increment = self.motion.increment[self.numbers]
        self._table = self._constants(equations.force, self.motion.states.label)
        self._table[:, layout.UNIT : layout.UNIT + 3] = 1.0
        self._scale = np.ones(len(self._index))
        self._find_ring(mesh)
        self._find_chords()
        if self._mouths is not None:
            on = self._rank[: len(equations.particles)]
            self._rows_of_mouths = MouthRows(self._mouths, on, self._count, mesh.cells, self._nodes, equations.rows)

    def _find_nodes(self, owner: Array) -> None:
        """The nodes on bodies that float, in the order of the bodies."""
        label = self.motion.states.label[owner]
        rank = np.full(len(self.motion.bodies) + 1, -1)
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
        rows = np.full(len(self.motion.states.label), -1)
        rows[self.motion.index] = np.arange(len(self.motion.index))
        self._in_motion = rows[owner[index]]  # the places of these nodes' particles in `BodyMotion.index`

    def _constants(self, force: Array, label: Array) -> Array:
        """(B, BODY_WIDTH) of the bodies, see `body_layout`."""
        s, states, k = self._scheme, self.motion.states, layout
        table = np.zeros((self._count, k.BODY_WIDTH))
        for row, b, length in zip(table, self.numbers.tolist(), self.lengths, strict=True):
            body, free = self.motion.bodies[b], self.motion.free[b]
            x, v, a = states.position[b], states.velocity[b] * free, states.acceleration[b] * free
            row[[k.MASS, k.INERTIA, k.LENGTH]] = body.total_mass, body.inertia_about_reference, length
            row[k.VELOCITY : k.VELOCITY + 3], row[k.ACCELERATION : k.ACCELERATION + 3] = v, a
            row[k.V_HISTORY : k.V_HISTORY + 3], row[k.A_HISTORY : k.A_HISTORY + 3] = s.history(v, a)
            row[k.STIFFNESS : k.STIFFNESS + 3] = body.stiffness
            row[k.SPRING : k.SPRING + 3] = np.asarray(body.stiffness) * (x - np.append(body.reference, 0.0))
            if (trial := self.motion.after.trial) is not None:
                row[k.SPRING : k.SPRING + 3] -= trial.total[b]
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

    def diagonal_done(self) -> None:
        """See `Term.diagonal_done`: the scale of the rows of particles that slide is kept for what they follow."""
        super().diagonal_done()
        if self.motion.slides.any():
            scale = download(self._equations.scale, 3 * self._nodes).reshape(-1, 3)
            self._scale = scale[self._index, 0].astype(float)

    def prepare(self, solve_laplacian: Callable[[], None], vectors: Any) -> None:
        """See `Term.prepare`: the bodies' own matrices, the volumes that they sweep, and the pressure's response."""
        e, r, s, count = self._equations, self._arm, self._scheme, self._count
        mesh, force = e.nodes, e.force[e.owner[self._index]]
        density, viscosity, lumping = e.properties.density, e.properties.viscosity, e.properties.lumped
        pinned = self._pinned[e.owner]
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
        free = self.motion.free[self.numbers][body].astype(float)  # (Q, 3)
        along = np.zeros((len(cell), 3, 2, 3))  # d u of the corner / d freedom
        along[..., 0, 0] = along[..., 1, 1] = 1.0
        along[..., 2] = turned(arm.reshape(-1, 2)).reshape(arm.shape) / self.lengths[body][:, None, None]
        along *= free[:, None, None, :] * on[:, :, None, None]
        slides = self.motion.along[self._in_motion][slots]  # (Q, 3, 2)
        along -= slides[..., None] * np.einsum("qai,qaik->qak", slides, along)[:, :, None, :]
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
        is_free = self.motion.free[self.numbers]
        matrix[:, range(3), range(3)] += np.where(is_free, inertia * unit**2, 1.0)
        inverse = np.linalg.inv(matrix)
        inverse *= is_free[:, :, None] * is_free[:, None, :]
        # W, by pairs of a body and a node.
        node, of, swept = corners.ravel().astype(np.int64), np.repeat(body, 3), np.repeat(swept, 3, axis=0)
        if self._rows_of_mouths is not None:
            more = self._rows_of_mouths.swept(self._in_mouths(0.0))
            node, of, swept = (np.concatenate(both) for both in zip((node, of, swept), more, strict=True))
        pair, where = np.unique(of * self._nodes + node, return_inverse=True)
        weight = np.stack([np.bincount(where, w, minlength=len(pair)) for w in swept.T], axis=1)
        swept_node, swept_body = pair % self._nodes, pair // self._nodes
        weight[pinned[swept_node]] = 0.0
        square = np.stack([np.bincount(swept_body, w, minlength=count) for w in (weight**2).T], axis=1)
        sweeps = square > SWEEPS**2 * square.max(axis=1, keepdims=True)
        weight *= sweeps[swept_body]
        rates = np.array([s.cm, s.cv, s.cf, s.alpha_m, s.gamma / (s.beta * s.dt), s.weighs], dtype=float)
        lists = {
            k.INDEX: self._index,
            k.OFFSETS: self._offsets,
            k.RING_NODES: self._ring,
            k.RING_STARTS: self._ring_starts,
            k.PAIRS: self._pairs,
        }
        tables = {
            k.BODY: self._table,
            k.ROWS: inverse,
            k.SCHEME: rates,
            k.ARM: self._arms(r),
            k.FORCE: force,
        }
        rooms = {
            k.OWN: k.OWN_WIDTH * count,
            k.TERMS: 3 * len(self._pairs),
        }
        integers, reals, room = layout.pack(lists, tables, rooms)
        self._buffers.get("bodies.data", room)
        self.arrays = self._buffers.upload("bodies.lists", integers), self._buffers.upload("bodies.data", reals)
        launch(kernels.set_scales, self.arrays[0], e.scale, self._base)
        of_body = [swept_body == b for b in range(count)]
        starts = np.append(0, np.cumsum(np.repeat([on_it.sum() for on_it in of_body], 3)))
        index = np.concatenate([np.tile(swept_node[on_it], 3) for on_it in of_body])
        weights = np.concatenate([weight[on_it].T.ravel() for on_it in of_body])
        self.low_rank = LowRank(starts, index, weights, self._nodes, self._buffers)
        self._total = total = self.low_rank.solve(sweeps.ravel(), block_diag(*matrix), solve_laplacian, vectors)
        part = np.diagonal(matrix, axis1=1, axis2=2) / np.diag(total).reshape(count, 3)
        self.units = np.where(is_free, part, 1.0)
        self._rows = self.units[:, :, None] * inverse
        self._table[:, k.UNIT : k.UNIT + 3] = self.units
        self._header, self._data = integers[: k.HEADER], download(self.arrays[1], len(reals)).astype(float)
        self._upload_tables()
        self._put_chords()

    def _upload_tables(self) -> None:
        """Put the bodies' constants and rows on the device."""
        for section, values in ((layout.BODY, self._table), (layout.ROWS, self._rows)):
            self._data[self._header[section] : self._header[section] + values.size] = values.ravel()
        self._buffers.upload("bodies.data", self._data)

    def couplings(self, *, near: bool) -> tuple[Array, Array]:
        """See `Term.couplings`: each body's two nodes, which may have no cell beside them."""
        first = self._nodes + 2 * np.arange(self._count)
        motion, angle = first, first + 1
        one, other = np.concatenate([motion, motion, angle, angle]), np.concatenate([motion, angle, motion, angle])
        of_mouths = None if self._rows_of_mouths is None else self._rows_of_mouths.couplings
        parts = [(one, other), *filter(None, (super().couplings(near=near), of_mouths))]
        return np.concatenate([part[0] for part in parts]), np.concatenate([part[1] for part in parts])

    def _in_mouths(self, part: float) -> Array:
        """(M, B, 3) volumes at mouths over increments of bodies, angles times lengths, after a part of the step."""
        assert self._rows_of_mouths is not None
        reference = self.motion.states.position[self.numbers, :2] + part * self._increment[:, :2]
        slopes = self._rows_of_mouths.slopes(self._rigidly(part), reference)
        result = slopes.reshape(len(slopes), -1, 3) * self.motion.free[self.numbers]
        result[..., 2] /= self.lengths
        return np.asarray(result)

    def _slips(self) -> Slip:
        """See `MovedBodies`: of bodies that float, slips are linear in their increments, from those predicted on."""
        own, motion = super()._slips(), self.motion
        rows = np.flatnonzero(motion.slides)
        floats = np.flatnonzero(motion.floating[motion.of[rows]])
        at = rows[floats]
        body = np.searchsorted(self.numbers, motion.of[at])
        t, free = motion.row_along[at], motion.free[self.numbers][body]
        moves, acts = (
            free * np.append(t, (t * turned(r)).sum(axis=1)[:, None] / self.lengths[body, None], axis=1)
            for r in (motion.turned_arms[at], motion.levers[at])
        )
        column, row = moves / self.units[body], np.einsum("bkm,bm->bk", self._rows[body], acts)
        moved, angle = np.zeros((2, 2, len(at), 3))
        for k, values in enumerate((column, row)):
            both, turn = moved[k], angle[k]
            both[:, :2], turn[:, 0] = -values[:, :2], -values[:, 2]
        node = self._nodes + 2 * body
        number = np.concatenate([own.number, own.number[floats], own.number[floats]])
        order = np.argsort(number, kind="stable")
        columns, rows_of = (
            np.concatenate([given, both, turn])[order]
            for given, both, turn in zip((own.column, own.row), moved, angle, strict=True)
        )
        return Slip(number[order], np.concatenate([own.node, node, node + 1])[order], columns, rows_of)

    def _arms(self, r: Array) -> Array:
        """The section `layout.ARM` at the start."""
        k, motion, at = layout, self.motion, self._in_motion
        table = np.zeros((len(r), k.ARM_WIDTH))
        for column in (k.START, k.END, k.TURNED, k.MIDDLE):
            table[:, column : column + 2] = r
        if motion.slides.any():
            free = motion.free_histories()
            for column, values in zip(
                (k.ALONG, k.ROW, k.SLID, k.V_FREE, k.A_FREE),
                (np.where(motion.curved[:, None], 0.0, motion.along), motion.row_along, motion.row_slid, *free),
                strict=True,
            ):
                table[:, column : column + 2] = values[at]
        return table

    def _present(self) -> Array:
        """See `MovedBodies`."""
        increment = self.motion.increment.copy()
        increment[self.numbers] = self._increment
        return np.asarray(increment)

    def follows(self) -> Follows:
        """The particles on the bodies follow their bodies' two nodes, those that slide themselves, too."""
        own = self._index < len(self._equations.particles)
        node, body, r, at = self._index[own], self._body[own], self._arm[own], self._in_motion[own]
        turn, slides = rotated(r, self._increment[body, 2]), np.flatnonzero(self.motion.slides[at])
        change = turn.copy()
        end_along, row_along = np.zeros((2, len(node), 2))
        if len(slides):
            end_along, row_along = self.directions()[at], self.motion.row_along[at]
            if self._solution is not None:
                u = self._equations.values(self._solution)[node[slides], :-1]
                change[slides] = u - self._increment[body[slides], :2]
            turn = turn + self.motion.row_slid[at]
        end, middle = turned(r + change), turned(r + self._scheme.cf * turn)
        column, sums = np.zeros((2, len(node), 2, 3))
        column[:, (0, 1), (0, 1)] = sums[:, (0, 1), (0, 1)] = 1.0
        column[..., 2], sums[..., 2] = end / self.lengths[body, None], middle / self.lengths[body, None]
        column *= (self.motion.free[self.numbers] / self.units)[body, None, :]
        # Only at right angles to the directions in which particles slide.
        for along, values in ((end_along, column), (row_along, sums)):
            values -= along[:, :, None] * np.einsum("bc,bck->bk", along, values)[:, None, :]
        row = np.einsum("bkm,bcm->bck", self._rows[body], sums)
        row, column = (
            np.concatenate([a, np.zeros((len(node), 2, 1))], axis=2).reshape(-1, 2, 2, 2) for a in (row, column)
        )
        motion = self._nodes + 2 * body
        found = Follows(
            np.repeat(node, 2),
            np.stack([motion, motion + 1], axis=1).ravel(),
            row.transpose(0, 2, 1, 3).reshape(-1, 2, 2),
            column.transpose(0, 2, 1, 3).reshape(-1, 2, 2),
        )
        along = np.einsum("kc,km->kcm", row_along[slides], self._scale[own][slides, None] * row_along[slides])
        themselves = Follows(
            node[slides], node[slides], along, np.einsum("kc,km->kcm", end_along[slides], end_along[slides])
        )
        parts = [found, themselves, super().follows()]
        return Follows.together([part for part in parts if part is not None], 2)

    def start(self, x: Array) -> None:
        """See `Term.start`."""
        q, first = self._unknowns(self.motion.increment[self.numbers]), self._nodes
        x[first::2, :2], x[first + 1 :: 2, 0] = q[:, :2], q[:, 2]

    def _unknowns(self, increment: Array) -> Array:
        """(B, 3) for increments (B, 3) of the bodies that float."""
        turned = np.stack([*increment[:, :2].T, self.lengths * increment[:, 2]], axis=1)
        return np.asarray(turned * self.units)

    def increments(self, x: Any) -> Array:
        """Increments (B, 3) of the bodies that float [m, m, rad], from a vector of unknowns."""
        q = self._own(x) / self.units
        q[:, 2] /= self.lengths
        return np.asarray(q)

    def _own(self, vector: Any) -> Array:
        """The entries (B, 3) of the bodies in a vector of unknowns or of a residual."""
        end = self._ends[id(vector)] if id(vector) in self._ends else self._end_of("now", vector)
        return download(end, 6 * self._count).astype(np.float64).reshape(-1, 6)[:, (0, 1, 3)]

    def _end_of(self, name: str, vector: Any) -> Any:
        """A device array with the entries of the bodies' nodes in a vector, which are its last."""
        count = 6 * self._count
        end, work = self._buffers.get(f"bodies.end_{name}", count), (count, vector_kernels.ENTRY)
        launch(vector_kernels.copy_entries, vector, self._base, end, count, work=work)
        return end

    def expect(self) -> None:
        """See `Term.expect`."""
        super().expect()
        vectors = {"solution": self._solution, "residual": self._residual}
        self._ends = {id(vector): self._end_of(name, vector) for name, vector in vectors.items()}
        for end in self._ends.values():
            expect(end, 6 * self._count)

    def work(self, x: Any, displacement: Array) -> TermWork:
        """See `Term.work`; and what is left of the bodies' own equations."""
        force = np.einsum("bkm,bm->bk", np.linalg.pinv(self._rows), self._own(self._residual))
        left = float((force * self._own(x) / self.units).sum())
        at, motion, found = self._in_motion, self.motion, super().work(x, displacement)
        here = np.flatnonzero(motion.slides[at] & (self._scale > 0))
        if len(here):
            # The work on bodies has the forces along them, too. Of these rows the scale is not in its vector, by which
            # they are counted as left, and taken from the work of walls.
            row, moved = (self._equations.values(vector)[self._index[here], :-1] for vector in (self._residual, x))
            rigid, counted = motion.levered(motion.increment[motion.of])[at[here]], float((row * moved).sum())
            left += float((row * rigid / self._scale[here, None]).sum()) - counted
            found = dataclasses.replace(found, walls=found.walls + counted)
        return dataclasses.replace(found, left=left)

    def place(self, x: Any) -> None:
        """Displace the bodies' particles by the bodies' increments in ``x``, and set their rates."""
        self._ends.clear()
        increment = self.increments(x)
        trial = self.motion.after.trial
        self.remembers = trial is not None
        if trial is not None and self._solution is not None:
            increment = self._push(trial, increment, x)
        self._increment, self._solution = increment, x
        launch(kernels.place, *self.arrays, self._equations.motion, x, self._base)

    def _push(self, trial: Trial, increment: Array, x: Any) -> Array:
        """Make contacts act as the increments (B, 3) of a correction in ``x`` ask for; those with which they act."""
        if (increment == self._increment).all():
            return increment
        if self._changes < CHANGES:
            every = self.motion.increment.copy()
            every[self.numbers] = increment
            new, k = trial.asked(every, self._mobility, self.tolerance), layout
            self._changes += not new.solved
            self._table[:, k.SPRING : k.SPRING + 3] -= (new.total - trial.total)[self.numbers]
            self._upload_tables()
            increment = (every + new.moved)[self.numbers]
            unknowns = self._buffers.upload("bodies.unknowns", self._unknowns(increment).ravel())
            launch(kernels.put_increments, unknowns, x, self._base, self._count)
        else:
            new = dataclasses.replace(trial, left=math.inf, tolerance=self.tolerance)
        self.unfinished = not (new.solved or math.isinf(new.left))
        self.motion.after = dataclasses.replace(self.motion.after, trial=new)
        return increment

    def collect(self, x: Any, out: Any) -> None:
        """See `Term.collect`: forces and moments on the bodies, and their own."""
        launch(kernels.collect_residual, *self.arrays, x, out, self._base)
        super().residual(x, out)  # after the bodies' rows are set
        if self._rows_of_mouths is not None:
            acts = np.einsum("bkm,pbm->pbk", self._rows, self._in_mouths(self._scheme.cf))
            self._rows_of_mouths.put(self._equations, self._in_mouths(1.0) / self.units, acts)
            self._rows_of_mouths.residual(x, out)
        self._residual = out

    def residual(self, x: Any, out: Any) -> None:
        """See `Term.residual`: done by `collect`."""

    def gather(self, matrix: Csr) -> None:
        """Add the derivatives by the angles that do not follow from displacements, at the last residual."""
        e, lists = self._equations, (self._parts, self._corners, self._bits, self._slots)
        of_elements = e.elements.density, e.elements.lumping, e.linear.record
        launch(kernels.rotation_terms, *self.arrays, *lists, *of_elements, len(self._pairs))
        launch(kernels.add_rotations, *self.arrays, e.scale, matrix, self._nodes, e.rows)
        super().gather(matrix)
        if self._rows_of_mouths is not None:
            self._rows_of_mouths.gather(matrix)

    def gather_own(self, matrix: Csr) -> None:
        """See `Term.gather_own`."""
        launch(kernels.add_own, *self.arrays, matrix, self._nodes, self._equations.rows)

    def settle(self, x: Any, forces: Callable[[Any, Array], Array]) -> None:
        """See `MovedBodies.settle`."""
        increment = np.zeros((len(self.motion.bodies), 3))
        increment[self.numbers] = self.increments(x)
        self.motion.solved(increment)
        super().settle(x, forces)
        if (trial := self.motion.after.trial) is not None:
            mouths = np.zeros_like(increment)
            if self._rows_of_mouths is not None:
                pressure = self._rows_of_mouths.mean @ self._equations.values(x)[:, -1]
                mouths[self.numbers] = np.einsum("p,pbk->bk", pressure, self._in_mouths(self._scheme.cf))
                mouths[self.numbers, 2] *= self.lengths
            new = dataclasses.replace(trial, begins=(self.motion.increment, self.motion.slid), mouths=mouths)
            self.motion.after = dataclasses.replace(self.motion.after, trial=new)

    @cached_property
    def _mobility(self) -> Array:
        """(3 B, 3 B) derivative of all bodies' increments by forces and moments on them."""
        result = np.zeros((3 * len(self.motion.bodies),) * 2)
        rows = (3 * self.numbers[:, None] + np.arange(3)).ravel()
        size = np.stack([np.ones(self._count), np.ones(self._count), 1 / self.lengths], axis=1).ravel()
        result[np.ix_(rows, rows)] = np.linalg.inv(self._total) * size * size[:, None]
        free = self.motion.free.ravel()
        return np.asarray(result * free * free[:, None])
