"""Constraints and friction of walls that slip, in the linear systems of a step."""

from __future__ import annotations

from typing import Any

import numpy as np

from tipfem.backend.arrays import Buffers, download
from tipfem.backend.launch import launch
from tipfem.typing import Array
from tipfem.walls import constraint_kernels
from tipfem.walls.step import Walls


class WallRows:
    """Constraints and friction of walls that slip, on the device; see `tipfem.walls.constraint_kernels`.

    Args:
        walls: of the step.
        dimension: d.
        scale: scaling of the rows, which friction and projection change.
        buffers: that hold the arrays.
    """

    def __init__(self, walls: Walls, dimension: int, scale: Any, buffers: Buffers) -> None:
        faces = walls.faces
        self._dimension, self._scheme = dimension, walls.scheme
        self._count, self._active = len(walls.sliding), walls.boundary.active
        self._faces = len(faces.nodes) if self._count else 0
        self._pressed = len(walls.pressed) if self._count else 0
        if not self._count:
            return
        put = buffers.upload
        self._period = walls.boundary.period.array
        self._index = put("walls.index", walls.sliding)
        self._rows, self._columns = put("walls.rows", walls.rows), put("walls.columns", walls.columns)
        launch(
            constraint_kernels.slip_scale,
            self._index,
            put("walls.friction", faces.friction),
            scale,
            self._count,
            dimension,
        )
        self._normals, self._coefficients, self._particles = faces.normal, faces.coefficient, faces.nodes
        self._wall_velocity = faces.wall_velocity
        self._free = ~walls.fixed[faces.nodes]  # friction does not act on particles in corners
        if self._faces:
            self._nodes, self._coefficient = put("walls.nodes", faces.nodes), put("walls.mu", faces.coefficient)
            self._normal, self._velocity = put("walls.normal", faces.normal), put("walls.v", faces.wall_velocity)
            self._record = buffers.get("walls.record", self._faces, constraint_kernels.face_record_width(dimension))

        if self._pressed:
            self._curved = put("walls.curved", walls.pressed)
            self._pressures = buffers.get("walls.pressures", self._pressed, 4)

    @property
    def active(self) -> bool:
        """Whether walls slip, slide or move; constraints are then applied between the launches of an iteration."""
        return self._active

    def residual(self, motion: Any, x: Any, scale: Any, out: Any) -> None:
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
                scale,
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
                motion,
                x,
                scale,
                self._pressures,
                out,
                self._scheme.cf,
                self._pressed,
            )
        if self._count:
            launch(constraint_kernels.project, self._index, self._rows, out, self._count, self._dimension)

    def product(self, v: Any, scale: Any, out: Any) -> None:
        """The same for the derivative along ``v``."""
        if self._faces:
            launch(
                constraint_kernels.slip_product,
                self._nodes,
                self._coefficient,
                self._normal,
                self._record,
                scale,
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
                self._pressures,
                scale,
                v,
                out,
                self._scheme.cf,
                self._pressed,
            )
        if self._count:
            launch(constraint_kernels.project, self._index, self._rows, out, self._count, self._dimension)

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
        if self._count:
            launch(constraint_kernels.project, self._index, self._columns, z, self._count, self._dimension)
