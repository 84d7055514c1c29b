"""Constraints and friction of walls that slip, in the linear systems of a step."""

from __future__ import annotations

from typing import Any

import numpy as np

from tipfem.backend.arrays import Buffers, download
from tipfem.backend.launch import launch
from tipfem.linalg.sparsity import Csr
from tipfem.typing import Array
from tipfem.walls import constraint_kernels
from tipfem.walls.constraint_kernels import COLUMNS, ROWS, SLIDING, SLIDING_ROW
from tipfem.walls.step import Walls


class WallRows:
    """Constraints and friction of walls that slip, on the device; see `tipfem.walls.constraint_kernels`.

    Args:
        walls: of the step.
        dimension: d.
        scale: scaling of the rows, which friction and projection change.
        buffers: that hold the arrays.
        cells: (M, d + 1) nodes of the mesh that is solved on, which may be cut along interfaces.
        owner: (P,) particle of each node; None where they are the same.

    Attributes:
        arrays: the sliding particles and their projectors, on the device.
    """

    def __init__(
        self,
        walls: Walls,
        dimension: int,
        scale: Any,
        buffers: Buffers,
        cells: Array,
        owner: Array | None = None,
    ) -> None:
        faces = walls.faces
        self._dimension, self._scheme, self._scale = dimension, walls.scheme, scale
        self._count = count = len(walls.sliding)
        self._faces = len(faces.nodes) if count else 0
        self._pressed = len(walls.pressed) if count else 0
        put = buffers.upload
        self._put, self._projector = put, np.concatenate([walls.rows, walls.columns, np.zeros((1, dimension**2))])
        self.arrays = (
            put("walls.sliding", np.append(count, walls.sliding).astype(np.int32)),
            put("walls.projector", self._projector),
        )
        if not count:
            return
        self._period = walls.boundary.period.array
        friction = put("walls.friction", faces.friction)
        work = (count, SLIDING)
        launch(constraint_kernels.slip_scale, self.arrays[0], friction, scale, count, dimension, work=work)
        number = np.full(len(walls.fixed), -1)
        number[walls.sliding] = np.arange(count)
        of = number if owner is None else number[owner]
        nodes = np.flatnonzero(of >= 0)
        self._rows, self._nodes_sliding = len(of), len(nodes)
        self._sliding = put("walls.nodes_sliding", nodes), put("walls.of_nodes", of[nodes])
        self._normals, self._coefficients, self._particles = faces.normal, faces.coefficient, faces.nodes
        self._wall_velocity = faces.wall_velocity
        self._free = ~walls.fixed[faces.nodes]  # friction does not act on particles in corners
        if self._faces:
            self._nodes, self._coefficient = put("walls.nodes", faces.nodes), put("walls.mu", faces.coefficient)
            self._of_rows = put("walls.of_rows", _nodes_of(faces.nodes, faces.cell, cells, owner))
            self._normal, self._velocity = put("walls.normal", faces.normal), put("walls.v", faces.wall_velocity)
            self._record = buffers.get("walls.record", self._faces, constraint_kernels.face_record_width(dimension))

        if self._pressed:
            self._curved = put("walls.curved", walls.pressed)
            self._of_pressures = put("walls.of_pressures", _nodes_of(walls.pressed, walls.pressed_cell, cells, owner))
            self._pressures = buffers.get("walls.pressures", self._pressed, 4)

    def turn(self, which: Array, projector: Array) -> None:
        """Set the projectors (K, d, d) of the displacements of sliding particles, by their positions in `sliding`."""
        self._projector[self._count + which] = projector.reshape(len(which), -1)
        self._put("walls.projector", self._projector)

    def residual(self, motion: Any, x: Any, out: Any) -> None:
        """Add friction at ``x`` to the scaled residual ``out``, and project its momentum rows."""
        if self._faces:
            launch(
                constraint_kernels.slip_residual,
                self._nodes,
                self._coefficient,
                self._normal,
                self._velocity,
                self._period,
                motion,
                x,
                self._scale,
                self._record,
                out,
                self._scheme.cv,
                self._scheme.cf,
                self._faces,
                self._dimension,
            )
        if self._pressed:
            launch(
                constraint_kernels.pressure_residual,
                self._curved,
                self._of_pressures,
                motion,
                x,
                self._scale,
                self._pressures,
                out,
                self._scheme.cf,
                self._pressed,
            )
        self.project_rows(out)

    def add_to(self, matrix: Csr) -> None:
        """Add the derivative of friction at the last `residual` to a Jacobian's rows, and project them."""
        if self._faces:
            launch(
                constraint_kernels.add_friction,
                self._of_rows,
                self._coefficient,
                self._normal,
                self._record,
                self._scale,
                *matrix,
                self._scheme.cv,
                self._scheme.cf,
                self._rows,
                self._faces,
                self._dimension,
            )
        if self._pressed:
            launch(
                constraint_kernels.add_pressures,
                self._of_pressures,
                self._pressures,
                self._scale,
                *matrix,
                self._scheme.cf,
                self._rows,
                self._pressed,
            )
        if self._count:
            launch(
                constraint_kernels.project_rows,
                self._sliding[0],
                self.arrays[1],
                self._sliding[1],
                matrix.row_offsets,
                matrix.values,
                self._rows,
                self._nodes_sliding,
                self._dimension,
                work=(self._nodes_sliding, SLIDING_ROW),
            )

    def product(self, v: Any, out: Any) -> None:
        """Add the same to the product of the elements' Jacobian with ``v``, and project it."""
        if self._faces:
            launch(
                constraint_kernels.slip_product,
                self._nodes,
                self._coefficient,
                self._normal,
                self._record,
                self._scale,
                v,
                out,
                self._scheme.cv,
                self._scheme.cf,
                self._faces,
                self._dimension,
            )
        if self._pressed:
            launch(
                constraint_kernels.pressure_product,
                self._curved,
                self._of_pressures,
                self._pressures,
                self._scale,
                v,
                out,
                self._scheme.cf,
                self._pressed,
            )
        self.project_rows(out)

    def project_rows(self, out: Any) -> None:
        """Project the momentum rows of a vector."""
        self._project(out, ROWS)

    def friction(self, displacement: Array) -> tuple[float, float]:
        """Dissipation by friction at the last `residual`, and the work done against it.

        The first is that of the slip at the intermediate time, dt k s^2. The second is tested with the displacements,
        as all other work is, k s . (u - dt v_wall): where walls are still it is what their friction takes, and where
        the velocity changes in the step, another one than the first.

        Args:
            displacement: (N, d) in the step [m].

        Returns:
            Both in J, per metre of depth in 2-D.
        """
        if not self._faces:
            return 0.0, 0.0
        d, record = self._dimension, download(self._record, self._faces).astype(float)
        slip = record[:, 1 : 1 + d * d].reshape(-1, d, d)
        slip -= np.einsum("fak,fk->fa", slip, self._normals)[:, :, None] * self._normals[:, None]
        moved = displacement[self._particles] - self._scheme.dt * self._wall_velocity.reshape(-1, d, d)
        force = (record[:, 0] * self._coefficients / d)[:, None, None] * slip * self._free[:, :, None]
        return float(self._scheme.dt * (force * slip).sum()), float((force * moved).sum())

    def project(self, z: Any) -> None:
        """Project the displacements of a correction."""
        self._project(z, COLUMNS)

    def _project(self, x: Any, which: int) -> None:
        if self._count:
            work = (self._count, SLIDING)
            launch(constraint_kernels.project, *self.arrays, x, which, self._dimension, work=work)


def _nodes_of(faces: Array, cell: Array, cells: Array, owner: Array | None) -> Array:
    """The nodes (F, d) of faces of the mesh that is solved on, from their particles (F, d) and cells (F,)."""
    if owner is None:
        return faces
    corners = cells[cell]
    corner = (owner[corners][:, None] == faces[:, :, None]).argmax(axis=2)
    return np.take_along_axis(corners, corner, axis=1).astype(np.int32)
