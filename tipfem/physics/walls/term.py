"""WallTerm: the walls in the equations of a step."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np

from tipfem.backend.arrays import download, expect
from tipfem.backend.launch import launch
from tipfem.case.particles import Particles
from tipfem.fem import work as work_kernels
from tipfem.fem.condensation import Follows
from tipfem.linalg.sparsity import Csr
from tipfem.physics.term import Equations, Frame, Term, TermWork
from tipfem.physics.walls import kernels as kernels
from tipfem.physics.walls.chords import ChordPressures, Slip
from tipfem.physics.walls.curve_step import CurveStep
from tipfem.physics.walls.layers import Layers
from tipfem.physics.walls.step import WallsInStep
from tipfem.scratch import copied, owned, scratch
from tipfem.typing import Array


class WallTerm(Term):
    """Constraints at walls, friction along those that slip, and the pressure of curved ones."""

    def __init__(self, walls: WallsInStep) -> None:
        self.walls = walls
        if walls.tank_moves:
            self.frame = Frame(walls.frame, walls.relative)
        self._curves, self._lag = walls.curves, 0.0
        self._displacement: Array | None = None  # at the last residual, with curves
        self._follows: Follows | None = None

    def held(self, displacement: Array, pressure: Array) -> None:
        """See `Term.held`."""
        displacement |= self.walls.fixed

    def histories(self, velocity: Array, acceleration: Array) -> tuple[Array, Array]:
        """See `Term.histories`."""
        return self.walls.histories(velocity, acceleration)

    def prescribe(self, displacement: Array, pressure: Array) -> tuple[Array, Array]:
        """See `Term.prescribe`."""
        return self.walls.constrain(displacement, in_place=True), pressure

    def begin(self, equations: Equations, first_node: int) -> None:
        """See `Term.begin`."""
        walls, faces, e = self.walls, self.walls.faces, equations
        self._equations, self._scheme, d = e, e.scheme, e.dimension
        if e.mesh.surface.exists:  # its particles move by what curved walls do not
            self._curves = None
        count = len(walls.sliding)
        self._faces = len(faces.nodes) if count else 0
        put, cells, owner, self._lists = e.buffers.upload, e.nodes.cells, e.owner, list[Array]()
        if self._faces:
            self._nodes, self._coefficient = put("walls.nodes", faces.nodes), put("walls.mu", faces.coefficient)
            self._lists.append(nodes_of(faces.nodes, faces.cell, cells, owner))
            self._of_rows = put("walls.of_rows", self._lists[-1])
            self._normal, self._velocity = put("walls.normal", faces.normal), put("walls.v", faces.wall_velocity)
            at_nodes, at_rows = kernels.by_node(faces.nodes), kernels.by_node(self._lists[-1])
            self._at_nodes = put("walls.starts", at_nodes[0]), put("walls.order", at_nodes[1])
            self._at_rows = put("walls.row_starts", at_rows[0]), put("walls.row_order", at_rows[1])
            self._touched = len(at_nodes[0]) - 1, len(at_rows[0]) - 1
            self._record = e.buffers.get("walls.record", self._faces, kernels.face_record_width(d))
        if count:
            self._slides = put("walls.sliding", walls.sliding.astype(np.int32)), put("walls.friction", faces.friction)
        self._chords: ChordPressures | None = None
        if count:
            self._find_chords()

    def _find_chords(self) -> None:
        """Set the pressures of curves and corners."""
        walls, e, curves, corners = self.walls, self._equations, self.walls.curves, self.walls.corners
        faces, cell = np.zeros((0, 2), dtype=np.int32), np.zeros(0, dtype=np.int64)
        index, along, middle = np.zeros(0, dtype=np.int64), np.zeros((0, 2)), e.mesh.position
        if curves is not None:
            faces, cell, middle = curves.pressed, curves.cell, curves.middle
            index, along = curves.particles, curves.along
        row_along, end_along, kinds, self._turns = along, along, None, np.zeros(0, dtype=np.int64)
        if corners is not None and corners.pressed.any():
            self._turns, kinds = corners.particles[corners.pressed], np.zeros((2, len(middle)), dtype=bool)
            kinds[0, self._turns] = True
            cells, _, *pair = e.mesh.hull
            pairs, numbers = np.stack(pair, axis=1).astype(np.int32), np.array([1, len(middle)])
            more = kinds[0][pairs].any(axis=1)
            # Of the particles beside them on straight sides, only what these change of the corners' volumes.
            sides = np.setdiff1d(np.intersect1d(pairs[more], walls.sliding), [*index, *self._turns])
            kinds[1, sides] = True
            more &= ~np.isin(pairs @ numbers, faces @ numbers)
            faces, cell = np.concatenate([faces, pairs[more]]), np.concatenate([cell, cells[more]])
            own = np.concatenate([self._turns, sides])
            order = np.argsort(walls.sliding)
            at = order[np.searchsorted(walls.sliding, own, sorter=order)]
            rows, ends = (_directions(projectors.reshape(-1, 2, 2)[at]) for projectors in (walls.rows, walls.columns))
            ends *= np.sign((rows * ends).sum(axis=1))[:, None]
            index = np.concatenate([index, own])
            along = np.concatenate([along, np.where(kinds[0, own][:, None], rows, 0.0)])
            row_along, end_along = np.concatenate([row_along, rows]), np.concatenate([end_along, ends])
        if not len(faces):
            return
        nodes = nodes_of(faces, cell, e.nodes.cells, e.owner)
        given = middle, index, along, row_along, e.mesh.period, weight_at(faces, cell, e), kinds
        self._chords = ChordPressures("walls", faces, nodes, *given)
        row = np.append(row_along, np.zeros((len(row_along), 1)), axis=1)
        self._slips = Slip(np.arange(len(row)), index, row, row)
        self._given, self._end_along = -(walls.rigid[index] * row_along).sum(axis=1), end_along
        self._chords.put(e, self._slips, self._given)

    def diagonal_done(self) -> None:
        """One scale for all momentum rows of a sliding particle, with the friction there."""
        count = len(self.walls.sliding)
        if count:
            e = self._equations
            launch(kernels.slip_scale, *self._slides, e.scale, count, e.dimension, work=(count, kernels.SLIDING))

    def follows(self) -> Follows | None:
        """Particles that slide follow themselves, but for what is normal to their walls."""
        walls, d, turns = self.walls, self.walls.frame.shape[1], self._curves is not None
        if self._follows is not None and not (turns and self._displacement is not None):
            return self._follows
        nodes, rows, columns = walls.sliding, *(each.reshape(-1, d, d) for each in (walls.rows, walls.columns))
        if self._curves is not None and self._displacement is not None:
            here, of_curve = walls.on_curves
            columns = columns.copy()
            columns[here] = self._curves.projector_at(self._displacement)[of_curve]
        if (nodes[1:] < nodes[:-1]).any():  # not in the order of their numbers
            order = np.argsort(nodes, kind="stable")
            nodes, rows, columns = nodes[order], rows[order], columns[order]
        self._follows = Follows(nodes, nodes, rows, columns)
        return self._follows

    def _slipped(self, displacement: Array) -> Array:
        """(K,) slips along curves by displacements (N, 2) [m]."""
        return np.asarray((displacement[self._slips.node] * self._slips.row[:, :2]).sum(axis=1) + self._given)

    def growth(self, x: Any) -> float | None:
        """The area that the boundary with curves encloses, in displacements along these, is to grow by."""
        if self._curves is None:
            return None
        values = self._equations.values(x)[: len(self._equations.mesh.position)]
        self._displacement = values[:, :-1].copy()
        grown = self._curves.growth(self._displacement)
        return grown - self._take(x) if self._chords is not None and len(self._turns) else grown

    def _take(self, x: Any) -> float:
        """Set the volumes of corners at ``x``; what is taken from continuity."""
        assert self._chords is not None
        e, turns = self._equations, self._turns
        u = e.values(x)[: len(e.mesh.position), :-1]
        end = e.mesh.position + u
        halfway = end.copy()
        halfway[turns] -= 0.5 * (u - self.walls.rigid)[turns]
        self._chords.take(halfway, end, self._end_along)
        return self._chords.taken(self._slipped(u))

    def couplings(self, *, near: bool) -> tuple[Array, Array] | None:
        """See `Term.couplings`: the nodes of faces."""
        lists = [nodes.astype(np.int64) for nodes in self._lists if near]
        one = [np.repeat(nodes, nodes.shape[1], axis=1).ravel() for nodes in lists]
        other = [np.tile(nodes, (1, nodes.shape[1])).ravel() for nodes in lists]
        if self._chords is not None:
            rows, columns = self._chords.couplings(self._slips)
            one, other = [*one, rows], [*other, columns]
        return (np.concatenate(one), np.concatenate(other)) if one else None

    def _sliding(self, nodes: Any, lists: tuple[Any, Any], touched: int) -> kernels.SlidingFaces:
        """The faces with friction, with their nodes or rows and the lists of these."""
        of_faces = self._coefficient, self._normal, self._velocity, self._faces
        return kernels.SlidingFaces(nodes, *lists, *of_faces, touched)

    def residual(self, x: Any, out: Any) -> None:
        """See `Term.residual`."""
        e, s = self._equations, self._scheme
        if self._faces:
            launch(
                kernels.slip_residual,
                self._sliding(self._nodes, self._at_nodes, self._touched[0]),
                e.period,
                e.motion,
                x,
                e.scale,
                self._record,
                out,
                s.cv,
                s.cf,
                e.dimension,
                work=(self._faces, kernels.FACE),
            )
        if self._chords is not None:
            if len(self._turns):
                self._take(x)
            self._chords.residual(x, out)

    def gather(self, matrix: Csr) -> None:
        """See `Term.gather`."""
        e, s = self._equations, self._scheme
        if self._faces:
            launch(
                kernels.add_friction,
                self._sliding(self._of_rows, self._at_rows, self._touched[1]),
                self._record,
                e.scale,
                matrix,
                s.cv,
                s.cf,
                e.rows,
                e.dimension,
                work=(self._faces, kernels.FACE),
            )
        if self._chords is not None:
            self._chords.gather(matrix)

    def expect(self) -> None:
        """See `Term.expect`."""
        if self._faces:
            expect(self._record, self._faces)

    def settle(self, x: Any, forces: Callable[[Any, Array], Array]) -> None:
        """See `Term.settle`: the work of walls that move is done with their velocity at the time of their forces.

        With displacements, whose mean is half a step before, what moves to and fro would do another work than that.
        """
        self._lag, lag = 0.0, self.walls.lag()
        if lag is not None:
            e = self._equations
            nodes = e.nodes_of(np.asarray(lag.any(axis=1)))
            self._lag = float((forces(x, nodes) * lag[e.owner[nodes]]).sum())

    def finish(self, displacement: Array, particles: Particles) -> Particles:
        """See `Term.finish`."""
        return self.walls.finish(self._equations.particles, displacement, particles)

    def carried(self, x: Any) -> Layers | None:
        """See `Term.carried`."""
        return self.walls.layers

    def work(self, x: Any, displacement: Array) -> TermWork | None:
        """Dissipation by friction, and the work done against it.

        The first is that of the slip at the intermediate time, dt k s^2. The second is tested with the displacements,
        as all other work is, k s . (u - dt v_wall): where walls are still it is what their friction takes, and where
        the velocity changes in the step, another one than the first.
        """
        pressed = TermWork(lag=self._lag)
        if self._chords is not None:
            slip = self._slipped(displacement)
            own = self._chords.work(self._equations.values(x)[:, -1], slip, slip)
            pressed = dataclasses.replace(own, lag=self._lag)
            if self._curves is not None:
                across = self._work_across(self._curves, displacement)
                pressed = dataclasses.replace(pressed, walls=pressed.walls - across, geometry=pressed.geometry + across)
        if not self._faces:
            return pressed
        faces, d, dt = self.walls.faces, self._equations.dimension, self._scheme.dt
        record = copied(download(self._record, self._faces, copy=False), "friction.record", np.float64)
        dissipated, done = scratch("friction.work", (2, self._faces, d * d))
        launch(
            kernels.friction_work,
            record,
            faces.nodes,
            faces.coefficient,
            faces.wall_velocity,
            self.walls.sliding.astype(np.int32),
            self.walls.rows,
            displacement,
            scratch("friction.row", len(displacement), np.int32),
            dissipated,
            done,
            dt,
            d,
        )
        return dataclasses.replace(
            pressed, friction_dissipation=float(dt * dissipated.sum()), friction=float(done.sum())
        )

    def _work_across(self, curves: CurveStep, displacement: Array) -> float:
        """Work on particles of curves across their directions in the step, off which corrections go, see `CurveStep`.

        It is no work of walls, which do not move so, but one of pressure at other positions than those of the volumes.
        """
        e, index = self._equations, curves.particles
        on = np.zeros(len(displacement), dtype=bool)
        on[index] = True
        nodes = e.nodes_of(on)
        force, buffer = np.zeros_like(displacement), e.buffers.get("walls.held", len(nodes), 2)
        lists = e.topology.offsets, e.topology.corners, e.linear.local
        launch(work_kernels.node_forces, e.buffers.upload("walls.nodes_held", nodes), *lists, buffer, len(nodes), 2)
        np.add.at(force, e.owner[nodes], download(buffer, len(nodes)))
        slid = (displacement - self.walls.rigid)[index]
        across = slid - (slid * curves.along).sum(axis=1)[:, None] * curves.along
        return float((force[index] * across).sum())


def _directions(projectors: Array) -> Array:
    """Unit vectors (K, 2) on which projectors (K, 2, 2) project, of either sign."""
    largest = np.argmax(projectors[:, (0, 1), (0, 1)], axis=1)
    of = projectors[np.arange(len(projectors)), largest]
    return np.asarray(of / np.linalg.norm(of, axis=1, keepdims=True))


def weight_at(faces: Array, cell: Array, equations: Equations) -> Array:
    """(E, 2) weight of the fluid at faces (E, 2) of cells (E,) [N/m^3]."""
    return np.asarray(equations.properties.density[cell, None] * equations.force[faces[:, 0]])


def nodes_of(faces: Array, cell: Array, cells: Array, owner: Array) -> Array:
    """The nodes (F, d) of faces of the mesh that is solved on, from their particles (F, d) and cells (F,)."""
    nodes = owned(faces.shape, np.int32)
    given = (np.ascontiguousarray(values, dtype=np.int32) for values in (faces, cell, cells, owner))
    launch(kernels.list_nodes, *given, nodes)
    return nodes
