"""Mouths of closed gaps in tanks that are full: what a gap takes up flows into it there.

Where there is no empty space, the area by which a closed gap grows is missing from the fluids. With N linear along the
gap, 1 at one mouth and 0 at the other, the first gives the sum of N over the gap's cells times their growth. The cells
of the fluid around the mouth lose that volume, by the source of their continuity.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from tipfem.mesh.mesh import Mesh, simplex_measure
from tipfem.typing import Array


class Gap(NamedTuple):
    """A connected set of closed cells."""

    cells: Array  # (K, 3)
    fluid: int  # beside it, the last one; -1 for none
    beside: Array  # (Q,) numbers of the fluid's cells around its mouths
    weight: Array  # (Q, K) volume that each of those loses, over the growth of each cell of the gap


def gaps(mesh: Mesh, empty: Array | None) -> list[Gap]:
    """The closed gaps of a full tank, where all empty cells (E, 3) are closed."""
    if empty is None or not len(empty):
        return []
    fluid, x = np.asarray(mesh.fluid), mesh.position
    row = np.repeat(np.arange(len(empty)), 3)
    at = coo_matrix((np.ones(len(row)), (row, empty.ravel())), shape=(len(empty), len(x))).tocsr()
    count, number = connected_components(at @ at.T, directed=False)
    result = []
    for c in range(count):
        cells = empty[number == c]
        inside = np.zeros(len(x), dtype=bool)
        inside[cells] = True
        around = np.flatnonzero(inside[mesh.cells].any(axis=1))
        if not len(around):
            result.append(Gap(cells, -1, around, np.zeros((0, len(cells)))))
            continue
        last = int(fluid[around].max())
        around = around[fluid[around] == last]
        nodes = np.unique(cells)
        axis = np.linalg.svd(x[nodes] - x[nodes].mean(axis=0), full_matrices=False)[2][0]
        wet = np.zeros(len(x), dtype=bool)
        wet[mesh.cells[around]] = True
        mouths = x[nodes[wet[nodes]]] @ axis
        low, high = mouths.min(), mouths.max()
        width = np.ptp(x[nodes] @ axis)
        of = mesh.cells[around]
        s = np.where(inside[of], x[of] @ axis, 0.0).sum(axis=1) / inside[of].sum(axis=1)
        mean = (x[cells] @ axis).mean(axis=1)
        two = high - low > 0.5 * width  # else there is one mouth
        part = np.clip((mean - low) / (high - low), 0.0, 1.0) if two else np.zeros(len(cells))
        end = s > 0.5 * (low + high) if two else np.zeros(len(s), dtype=bool)
        area, weight = mesh.measure[around], np.zeros((len(around), len(cells)))
        for mine, share in ((~end, 1 - part), (end, part)):
            if mine.any():
                weight[mine] = (area[mine] / area[mine].sum())[:, None] * share
        result.append(Gap(cells, last, around, weight / np.maximum(weight.sum(axis=0), 1e-300)))
    return result


def growth(mesh: Mesh, empty: Array | None, end: Array) -> Array | None:
    """(M,) relative growth of the cells of a full tank by what flows into closed gaps in a step; None for nothing.

    Args:
        mesh: at the start of the step.
        empty: (E, 3) its empty cells.
        end: (N, 2) positions at its end, of the particles of gaps.
    """
    result = np.zeros(len(mesh.cells))
    for gap in gaps(mesh, empty):
        change = np.abs(simplex_measure(end, gap.cells, mesh.period))
        change -= np.abs(simplex_measure(mesh.position, gap.cells, mesh.period))
        result[gap.beside] -= gap.weight @ change / mesh.measure[gap.beside]
    return result if result.any() else None


def taken_up(mesh: Mesh, empty: Array | None, end: Array, fluids: int) -> Array:
    """(F,) volume by which gaps have grown in a step, of the fluids beside them; arguments of `growth`."""
    result = np.zeros(fluids)
    for gap in gaps(mesh, empty):
        if gap.fluid >= 0:
            ends = (np.abs(simplex_measure(x, gap.cells, mesh.period)).sum() for x in (end, mesh.position))
            result[gap.fluid] += next(ends) - next(ends)
    return result
