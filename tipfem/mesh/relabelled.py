"""Relabelled: the sides of cells that have changed their fluid; SideEnergies: what the sides of cells cost."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

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


class SideEnergies(NamedTuple):
    """Energies per length of the sides of cells.

    Attributes:
        sigma: (F, F) or larger, between each two fluids, 0 between the same [N/m].
        hull: function of the particles (K,) and (K,) at the ends of sides on the hull to the energies (K, F) or wider
            of each fluid there [N/m].
    """

    sigma: Array
    hull: Callable[[Array, Array], Array]

    def raised(self, mesh: Mesh, before: Array) -> tuple[Array, Array, Array]:
        """What the cells that have changed their fluid add to the energy of their sides, patch by patch.

        Args:
            mesh: 2-D, with the fluids that its cells have now.
            before: (M,) those before.

        Returns:
            The C cells that have changed, the patch (C,) of adjacent ones that each is in, and what each patch adds
            [J/m].
        """
        now = np.asarray(mesh.fluid)
        cell = np.flatnonzero(before != now)
        number = np.full(len(now) + 1, -1)  # the last one for no neighbour
        number[cell] = np.arange(len(cell))
        beside = mesh.neighbours[cell]
        one, other = (mesh.cells[cell][:, [1, 2, 0]], mesh.cells[cell][:, [2, 0, 1]])
        length = np.linalg.norm(mesh.sides(one.ravel(), other.ravel()), axis=1).reshape(-1, 3)
        more = self.sigma[now[cell][:, None], now[beside]] - self.sigma[before[cell][:, None], before[beside]]
        within = number[beside] >= 0
        row, corner = np.nonzero(beside < 0)
        hull, each = self.hull(one[row, corner], other[row, corner]), np.arange(len(row))
        more[row, corner] = hull[each, now[cell[row]]] - hull[each, before[cell[row]]]
        more[within & (beside >= 0)] *= 0.5  # these sides are met from both cells
        first, k = np.nonzero(within & (beside >= 0))
        pairs = coo_array((np.ones(len(first)), (first, number[beside[first, k]])), shape=(len(cell), len(cell)))
        count, patch = connected_components(pairs, directed=False)
        return cell, patch, np.bincount(patch, (more * length).sum(axis=1), count)
