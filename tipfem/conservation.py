"""Volumes of fluids whose interfaces run along edges: each connected body of a fluid keeps its own.

The constraint J = 1 holds at particles, for the elements around them together. At an interface these
belong to two fluids, and what one loses the other gains: nothing in the equations tells them apart,
no source can. So the loss is measured after every step, body by body, and undone by moving the interface.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse

from tipfem.interface_kernels import find_bodies
from tipfem.mesh import simplex_measure
from tipfem.particles import Array


def bodies(across: Array, fluid: Array) -> Array:
    """Number (M,) of the connected body of one fluid that each triangle belongs to, from 0.

    Args:
        across: (M, 3) neighbours, -1 for none.
        fluid: (M,) of each triangle.
    """
    body = np.empty(len(across), dtype=np.int32)
    stack = np.empty(len(across), dtype=np.int32)
    find_bodies(np.ascontiguousarray(across), np.ascontiguousarray(fluid), body, stack, len(across))
    return body


def inherit(
    old: tuple[Array, Array, Array], new: tuple[Array, Array, Array], loss: Array, moved: Array
) -> Array:
    """What bodies of a new mesh have to make good of the losses of those of the old one.

    A body hands its loss on in equal parts with its particles: so bodies may merge and split.

    Args:
        old: cells (M, 3), fluid (M,) and body (M,) of each triangle.
        new: the same after remeshing.
        loss: (K,) of the old bodies [m^2].
        moved: (N,) mask of particles that were set elsewhere; they hand on nothing.

    Returns:
        (K',) loss of the new bodies [m^2]; that of a body which is gone is in none.
    """
    fluids, count = int(max(old[1].max(), new[1].max())) + 1, len(moved)
    body_at = []
    for cells, fluid, body in (old, new):
        at = np.full(fluids * count, -1, dtype=np.int32)
        for corner in cells.T:  # of a particle's bodies of one fluid any will do
            at[fluid * count + corner] = body
        at.reshape(fluids, count)[:, moved] = -1
        body_at.append(at)
    both = (body_at[0] >= 0) & (body_at[1] >= 0)
    parts = np.bincount(body_at[0][both], minlength=len(loss))
    share = (loss / np.maximum(parts, 1))[body_at[0][both]]
    return np.bincount(body_at[1][both], weights=share, minlength=int(new[2].max()) + 1)


def share_out(volume: Array, loss: Array, fluid: Array, total: Array, free: Array) -> Array:
    """Volumes (K,) that bodies are to have: each its own loss back, and what a fluid still lacks by size.

    Args:
        volume: (K,) that the bodies have [m^2].
        loss: (K,) of the bodies [m^2].
        fluid: (K,) of the bodies.
        total: (F,) that each fluid is to have [m^2].
        free: (K,) whether the body's surface can move; others keep what they have.
    """
    wanted = np.where(free, np.maximum(volume + loss, 0.5 * volume), volume)
    has = np.bincount(fluid, weights=wanted, minlength=len(total))
    part = np.bincount(fluid, weights=wanted * free, minlength=len(total))
    if not part.any():
        return wanted
    lack = np.where(part > 0, total - has, 0.0)
    # A fluid that is gone cannot get its volume back; the others must still fill the tank.
    lack -= (lack.sum() + wanted.sum() - volume.sum()) * part / part.sum()
    return np.asarray(wanted + lack[fluid] * wanted * free / np.maximum(part[fluid], 1e-300))


def move_interfaces(
    position: Array, cells: Array, body: Array, movable: Array, wanted: Array, limit: float,
    measure: Array | None = None,
) -> Array:  # fmt: skip
    """Where particles go so that bodies get the volumes wanted.

    Every movable particle shifts by sum_k lambda_k dV_k / dx, with the factors lambda that give the volumes; a few
    rounds, for volumes are quadratic in positions.

    Args:
        position: (N, 2) [m].
        cells: (M, 3) triangles.
        body: (M,) of each.
        movable: (N,) mask of the particles that may move: those of interfaces, off the walls.
        wanted: (K,) volumes [m^2].
        limit: of a particle's shift in one round [m].
        measure: (M,) the triangles' areas, if known already [m^2]; changed to those at the new positions.

    Returns:
        (N, 2) new positions.
    """
    nodes = np.flatnonzero(movable)
    if not len(nodes):
        return position
    x = position.copy()
    place = np.full(len(x), -1)
    place[nodes] = np.arange(len(nodes))
    around = np.flatnonzero(movable[cells].any(axis=1))
    near, owner = cells[around], body[around]
    measure = simplex_measure(x, cells) if measure is None else measure
    volume = np.bincount(body, weights=measure, minlength=len(wanted))
    rows, columns = np.repeat(owner, 3), place[near].ravel()
    on = columns >= 0
    for _ in range(4):
        missing = wanted - volume
        if np.abs(missing).max() <= 1e-14 * wanted.sum():
            break
        side = x[near[:, [2, 0, 1]]] - x[near[:, [1, 2, 0]]]
        entries = 0.5 * np.stack([-side[..., 1], side[..., 0]], axis=-1).reshape(-1, 2)
        shape = (len(wanted), len(nodes))
        gradient = sparse.hstack(
            [sparse.csr_matrix((entries[on, k], (rows[on], columns[on])), shape=shape) for k in (0, 1)]
        ).tocsr()
        # The volumes' sum is that of the tank: one combination of the factors moves nothing.
        factor = np.linalg.lstsq((gradient @ gradient.T).toarray(), missing, rcond=1e-10)[0]
        shift = (gradient.T @ factor).reshape(2, -1).T
        length = np.linalg.norm(shift, axis=1, keepdims=True)
        shift *= np.minimum(1.0, limit / np.maximum(length, 1e-300))
        if not _keep_shape(x, near, nodes, shift, place):
            break
        area = simplex_measure(x, near)
        volume += np.bincount(owner, weights=area - measure[around], minlength=len(wanted))
        measure[around] = area
    return x


def _keep_shape(x: Array, near: Array, nodes: Array, shift: Array, place: Array) -> bool:
    """Shift x[nodes] in place, but none at a triangle of ``near`` that would lose more than half of its area.

    Returns whether anything was moved. ``shift`` is changed; place (N,) is the number of a particle among ``nodes``.
    """
    start, area = x[nodes].copy(), simplex_measure(x, near)
    for _ in range(4):
        x[nodes] = start + shift
        bad = simplex_measure(x, near) < 0.5 * area
        if not bad.any():
            return bool(shift.any())
        held = place[near[bad]].ravel()
        shift[held[held >= 0]] = 0.0
    x[nodes] = start
    return False
