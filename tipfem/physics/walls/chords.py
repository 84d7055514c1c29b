"""ChordPressures: the pressure of curves along which fluids slip, on the polyline of their particles.

A particle that slides on a curve moves along the line from the particle before it to that after it: at right angles to
the mean of the normals of its two faces, not to each of them. So a pressure that varies along the wall has a part
along the slip, t . int p n phi, which is no force on the fluid: it is added to momentum. With it, what is left of the
row of a fluid at rest is int phi (grad p - rho b), which vanishes. The volumes that slip moves through the faces by the
same coefficients, t . int q n phi, are those between chords and curve: they are no growth of the fluid, and are taken
from continuity. So neither term does work together, and walls at rest give no energy.

All is linear: the faces are those predicted for the middle of the step, to whose normals directions are at right
angles, so that volumes sum to zero, and for the intermediate time, at which forces act. What both differ by is a part
of the work of pressure between intermediate and last positions.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from tipfem.backend.launch import launch
from tipfem.linalg.sparsity import Csr
from tipfem.physics import linear_rows
from tipfem.physics.term import Equations, TermWork
from tipfem.typing import Array


class Slip(NamedTuple):
    """K unknown parts of the slips of particles, of which one has as many as name it; a slip is their sum.

    Attributes:
        number: (K,) of the slip.
        node: (K,) whose displacement it is a part of.
        column: (K, 3) by which the node's unknowns are multiplied in the slip,
        row: (K, 3) and a force along the slip in the node's rows.
    """

    number: Array
    node: Array
    column: Array
    row: Array


class ChordPressures:
    """See the module.

    Args:
        name: of its device arrays.
        faces: (E, 2) particles along curves, with the fluid on their left, at most one of them off the curve.
        nodes: (E, 2) of the mesh that is solved on, with the pressures of that fluid.
        middle: (N, 2) positions predicted for the middle of the step [m], of the volumes.
        intermediate: (N, 2) those for the intermediate time [m], of the forces.
        index: (K,) the particles that slide.
        along: (K, 2) unit vectors along which they do.
    """

    def __init__(
        self, name: str, faces: Array, nodes: Array, middle: Array, intermediate: Array, index: Array, along: Array
    ) -> None:
        self._name = name
        number = np.full(len(middle), -1)
        number[index] = np.arange(len(index))
        slip, node, volume, force = list[Array](), list[Array](), list[Array](), list[Array]()
        for one in range(2):
            of = number[faces[:, one]]
            here = np.flatnonzero(of >= 0)
            for position, values in ((middle, volume), (intermediate, force)):
                edge = position[faces[here, 1]] - position[faces[here, 0]]
                across = along[of[here], 0] * edge[:, 1] - along[of[here], 1] * edge[:, 0]
                values += [across / (3.0 if one == other else 6.0) for other in range(2)]
            slip += [of[here]] * 2
            node += [nodes[here, other] for other in range(2)]
        parts = slip, node, volume, force
        self._slip, self._node, self._volume, self._force = (np.concatenate(part) for part in parts)

    def couplings(self, slips: Slip) -> tuple[Array, Array]:
        """Rows and columns of the nodes that are coupled."""
        of, part = _pairs(self._slip, slips.number)
        pressures, others = self._node[of], slips.node[part]
        one, other = (slips.node[k] for k in _pairs(slips.number, slips.number))
        return np.concatenate([others, pressures, one]), np.concatenate([pressures, others, other])

    def put(
        self, equations: Equations, slips: Slip, given: Array, rate: Array | float = 0.0, force: Array | float = 0.0
    ) -> None:
        """Set the matrix.

        Args:
            equations: of the step.
            slips: the parts of the slips.
            given: (K,) those that are prescribed [m].
            rate: (K,) friction over slip [N/m, per metre of depth], and
            force: (K,) friction without slip in the step [N, per metre of depth].
        """
        of, part = _pairs(self._slip, slips.number)
        one, other = _pairs(slips.number, slips.number)
        count, friction = len(of), np.broadcast_to(rate, len(given))
        blocks = np.zeros((2 * count + len(one), 3, 3))
        blocks[:count, :, 2] = slips.row[part] * self._force[of][:, None]
        blocks[count : 2 * count, 2, :] = -slips.column[part] * self._volume[of][:, None]
        drag = friction[slips.number[one]]
        blocks[2 * count :] = drag[:, None, None] * slips.row[one][:, :, None] * slips.column[other][:, None, :]
        row, column = self.couplings(slips)
        size = equations.rows
        key = row.astype(np.int64) * size + column
        order = np.argsort(key, kind="stable")
        first = np.flatnonzero(np.diff(key[order], prepend=-1))
        blocks = np.add.reduceat(blocks[order], first) if len(first) else blocks
        row, column = np.divmod(key[order][first], size)
        rows, starts = np.unique(row, return_index=True)
        constant = np.zeros((size, 3))
        np.add.at(constant[:, 2], self._node, -self._volume * given[self._slip])
        drags = friction * given + force
        np.add.at(constant, slips.node, slips.row * drags[slips.number, None])
        up, self._count, self._equations = equations.buffers.upload, len(rows), equations
        self._matrix = (
            up(f"{self._name}.chords.rows", rows.astype(np.int32)),
            up(f"{self._name}.chords.offsets", np.append(starts, len(row)).astype(np.int32)),
            up(f"{self._name}.chords.columns", column.astype(np.int32)),
            up(f"{self._name}.chords.values", blocks.ravel()),
        )
        self._constant = up(f"{self._name}.chords.constant", constant[rows].ravel())

    def residual(self, x: Any, out: Any) -> None:
        """See `Term.residual`."""
        if self._count:
            arrays = *self._matrix, self._constant, self._equations.scale, x, out, self._count
            launch(linear_rows.add_product, *arrays, work=(self._count, linear_rows.ROW))

    def gather(self, matrix: Csr) -> None:
        """See `Term.gather`."""
        if self._count:
            e, work = self._equations, (self._count, linear_rows.ROW)
            launch(linear_rows.add_blocks, *self._matrix, e.scale, *matrix, e.rows, self._count, work=work)

    def work(self, pressure: Array, slip: Array) -> TermWork:
        """What is not done by walls: the part of their reactions along the slip.

        Args:
            pressure: (P,) of the nodes.
            slip: (K,) of the particles [m].
        """
        forces, volumes = (float((v * pressure[self._node]) @ slip[self._slip]) for v in (self._force, self._volume))
        return TermWork(walls=forces, geometry=volumes - forces)


def _pairs(slip: Array, number: Array) -> tuple[Array, Array]:
    """All pairs of entries of two lists (E,), (K,) of the same slip; the second ascends."""
    first, last = np.searchsorted(number, slip), np.searchsorted(number, slip, side="right")
    length = last - first
    of = np.repeat(np.arange(len(slip)), length)
    ahead = np.cumsum(length) - length
    return of, np.arange(len(of)) + np.repeat(first - ahead, length)
