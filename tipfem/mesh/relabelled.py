"""Relabelled: the sides of cells that have changed their fluid."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tipfem.mesh.mesh import Mesh
from tipfem.typing import Array


class Relabelled(NamedTuple):
    """The K sides of cells that have changed their fluid, each once; those on the hull are not among them.

    Attributes:
        length: (K,) [m].
        before: (K, 2) fluids on both sides before the change.
        now: (K, 2) the same after it.
    """

    length: Array
    before: Array
    now: Array

    @classmethod
    def of(cls, mesh: Mesh, before: Array) -> Relabelled:
        """Those of a mesh whose cells had the fluids ``before`` (M,); 2-D."""
        now = np.asarray(mesh.fluid)
        cell = np.flatnonzero(before != now)
        beside = mesh.neighbours[cell]
        # Where both cells have changed, their side is met from either.
        row, corner = np.nonzero((beside >= 0) & ~((before != now)[beside] & (beside < cell[:, None])))
        one, other = cell[row], beside[row, corner]
        side = mesh.sides(*(mesh.cells[one, (corner + k) % 3] for k in (1, 2)))
        both = np.stack([one, other], axis=1)
        return cls(np.hypot(side[:, 0], side[:, 1]), before[both], now[both])
