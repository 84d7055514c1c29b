"""Pressures in closed gaps on the solids: those of the fluid at the mouths, which seeps in.

p - rho g . x is linear along a gap between its mouths. A gap that is open to empty space at one end is empty. A closed
cell exerts p dA / dx on each of its particles, and a third of its weight, as a cell of the fluid would: what
stands in a fluid at rest is at rest to round-off.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from tipfem.mesh.mesh import Mesh
from tipfem.physics.contact.gaps import closed_cells
from tipfem.typing import Array

MOUTH = 1.01  # as far from the end of a gap a fluid is there [spacings]


def seeping(
    mesh: Mesh,
    empty: Array | None,
    pressure: Array,
    owner: Array,
    seals: Array,
    origin: Array,
    weight: Array,
    spacing: float,
) -> Array:
    """Force and moment (B, 3) of the pressures in closed gaps on B solids [N/m, N/m, N].

    Args:
        empty: (E, 3) cells of empty space; None for none.
        owner: (N,) see `tipfem.physics.contact.gaps.owners`.
        seals: (B + 1,) mask of the solids in whose gaps nothing seeps.
        origin: (B, 2) points of the moments [m].
        weight: (2,) of the fluid, density times gravity [N/m^3].
    """
    result, x = np.zeros((len(origin), 3)), mesh.position
    if empty is None or not len(empty):
        return result
    shut = empty[closed_cells(x, empty, owner, spacing)]
    shut = shut[~seals[owner[shut]].any(axis=1)]
    if not len(shut):
        return result
    wet = np.zeros(len(x), dtype=bool)
    wet[mesh.cells] = True
    cell = np.repeat(np.arange(len(shut)), 3)
    beside = coo_matrix((np.ones(3 * len(shut)), (cell, shut.ravel())), shape=(len(shut), len(x))).tocsr()
    count, number = connected_components(beside @ beside.T, directed=False)
    side = np.roll(x[shut], -1, axis=1) - np.roll(x[shut], -2, axis=1)  # opposite to each corner
    change = 0.5 * np.stack([side[..., 1], -side[..., 0]], axis=2)  # of the area by the corner
    area = 0.5 * (side[:, 0, 0] * side[:, 1, 1] - side[:, 0, 1] * side[:, 1, 0])
    change, area = np.sign(area)[:, None, None] * change, np.abs(area)
    level, values = x @ weight, np.zeros(len(x))
    for c in range(count):
        nodes = np.unique(shut[number == c])
        axis = np.linalg.svd(x[nodes] - x[nodes].mean(axis=0), full_matrices=False)[2][0]
        along, mouths = x[nodes] @ axis, nodes[wet[nodes]]
        at, head = x[mouths] @ axis, pressure[mouths] - level[mouths]
        if max(abs(end - at).min(initial=np.inf) for end in (along.min(), along.max())) > MOUTH * spacing:
            area[number == c] = 0.0
            continue
        order = np.argsort(at)
        values[nodes] = np.interp(along, at[order], head[order]) + level[nodes]
        values[mouths] = pressure[mouths]
    mean = values[shut].mean(axis=1)
    force = mean[:, None, None] * change + (area / 3)[:, None, None] * weight
    on = owner[shut] - 1  # less than 0 on the tank
    here = on >= 0
    r = x[shut] - origin[np.maximum(on, 0)]
    moment = r[..., 0] * force[..., 1] - r[..., 1] * force[..., 0]
    for k, values in enumerate((force[..., 0], force[..., 1], moment)):
        result[:, k] = np.bincount(on[here], values[here], minlength=len(origin))
    return result
