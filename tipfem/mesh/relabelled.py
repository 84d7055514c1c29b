"""Relabelled: cells that have changed their fluid, with their sides; SideEnergies: what the sides of cells cost."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from tipfem.mesh.mesh import Mesh
from tipfem.typing import Array

# Of a film that broke, which is a break-up of its fluid and a merging of the other: its middle [m]; its fluid and that
# which its cells went to, F for empty space; their area [m^2]; length of interfaces that went [m]; its energy [J/m].
FILM = "x", "y", "fluid", "beside", "area", "length", "energy"


class Relabelled(NamedTuple):
    """Cells that have changed their fluid, and their K sides, each once; those on the hull are not among them."""

    length: Array  # (K,) [m]; in an axisymmetric flow areas [m^2]
    before: Array  # (K, 2) fluids on both sides before the change
    now: Array  # (K, 2) the same after it
    patch: Array  # (K,) of the P patches of adjacent cells that have changed, the one that each side is of
    area: Array  # (P,) of the patches [m^2]; in an axisymmetric flow their volumes [m^3]
    middle: Array  # (P, 2) of their cells [m]
    fluid: Array  # (P, 2) of each patch before and after, of one of its cells

    @classmethod
    def of(cls, mesh: Mesh, before: Array) -> Relabelled:
        """Relabelled sides of a mesh whose cells had the fluids ``before`` (M,); 2-D."""
        now = np.asarray(mesh.fluid)
        cell = np.flatnonzero(before != now)
        beside = mesh.neighbours[cell]
        # Where both cells have changed, their side is met from either.
        row, corner = np.nonzero((beside >= 0) & ~((before != now)[beside] & (beside < cell[:, None])))
        one, other = cell[row], beside[row, corner]
        ends = [mesh.cells[one, (corner + k) % 3] for k in (1, 2)]
        length = mesh.side_measure(*ends) if mesh.period.axial else np.hypot(*mesh.sides(*ends).T)
        both = np.stack([one, other], axis=1)
        a, b = (mesh.sides(mesh.cells[cell, 0], mesh.cells[cell, k]) for k in (1, 2))
        area = 0.5 * np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
        count, patch = _patches(cell, beside)
        places = mesh.position[mesh.cells[cell, 0]] + (a + b) / 3
        area = area * mesh.period.radius(places)
        total = np.bincount(patch, area, count)
        middle = np.stack([np.bincount(patch, area * x, count) / total for x in places.T], axis=1)
        first = cell[np.unique(patch, return_index=True)[1]]
        fluid = np.stack([before[first], now[first]], axis=1)
        return cls(length, before[both], now[both], patch[row], total, middle, fluid)


def _patches(cell: Array, beside: Array) -> tuple[int, Array]:
    """Number of patches of adjacent cells among some (C,), with the cells ``beside`` them (C, 3), and each one's."""
    number = np.full(max(cell.max(initial=-1), beside.max(initial=-1)) + 2, -1)  # the last one for no neighbour
    number[cell] = np.arange(len(cell))
    first, k = np.nonzero(number[beside] >= 0)
    pairs = coo_array((np.ones(len(first)), (first, number[beside[first, k]])), shape=(len(cell), len(cell)))
    count, patch = connected_components(pairs, directed=False)
    return int(count), patch


class SideEnergies(NamedTuple):
    """Energies per length of the sides of cells."""

    sigma: Array  # (F, F) or larger, between each two fluids, 0 between the same [N/m]
    # function of the particles (K,) and (K,) at the ends of sides on the hull to the energies (K, F) or wider of
    # each fluid there [N/m]
    hull: Callable[[Array, Array], Array]

    def raised(self, mesh: Mesh, before: Array) -> tuple[Array, Array, Array]:
        """The C cells that have changed their fluid, the patch (C,) of each, and the energy that each patch adds [J/m].

        Cells that have changed and are adjacent are a patch; fluids were ``before`` (M,), and are now those of the
        mesh.
        """
        now = np.asarray(mesh.fluid)
        cell = np.flatnonzero(before != now)
        beside = mesh.neighbours[cell]
        one, other = (mesh.cells[cell][:, [1, 2, 0]], mesh.cells[cell][:, [2, 0, 1]])
        length = mesh.side_measure(one.ravel(), other.ravel()).reshape(-1, 3)
        more = self.sigma[now[cell][:, None], now[beside]] - self.sigma[before[cell][:, None], before[beside]]
        within = (beside >= 0) & (before != now)[beside]
        row, corner = np.nonzero(beside < 0)
        hull, each = self.hull(one[row, corner], other[row, corner]), np.arange(len(row))
        more[row, corner] = hull[each, now[cell[row]]] - hull[each, before[cell[row]]]
        more[within] *= 0.5  # these sides are met from both cells
        count, patch = _patches(cell, beside)
        return cell, patch, np.bincount(patch, (more * length).sum(axis=1), count)
