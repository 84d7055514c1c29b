"""Balances of a repair by cavities: the volumes of the components of fluids, and momentum."""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from tipfem.mesh.components import ON_HULL, ON_INTERFACE, Components
from tipfem.mesh.mesh import Mesh, simplex_measure
from tipfem.remesh.cavity.arrays import FIXED, ON
from tipfem.remesh.cavity.cavities import Cavities
from tipfem.typing import Array

SLACK = 1e-13  # of the volume of all fluids, that may be missing


def components_of(cells: Array, across: Array, label: Array) -> Array:
    """The component (M,) of each cell among those of its label that are joined by faces; -1 for unused rows."""
    row, face = np.nonzero((label[:, None] >= 0) & (across >= 0))
    other = across[row, face]
    same = label[row] == label[other]
    pairs = sparse.coo_matrix((np.ones(int(same.sum()), np.int8), (row[same], other[same])), shape=(len(cells),) * 2)
    _, found = connected_components(pairs, directed=False)
    result = np.full(len(cells), -1)
    used = label >= 0
    result[used] = np.unique(found[used], return_inverse=True)[1]
    return result


def with_components(mesh: Mesh, fluids: int) -> Mesh:
    """The mesh with the components of ``fluids`` fluids labelled, the largest first."""
    label = components_of(mesh.cells, mesh.neighbours, np.asarray(mesh.fluid))
    volume = np.bincount(label, mesh.measure)
    number = np.empty(len(volume), dtype=np.int32)
    number[np.argsort(-volume, kind="stable")] = np.arange(len(volume), dtype=np.int32)
    label, count = number[label], len(mesh.position)
    fluid = _first(label, np.asarray(mesh.fluid))
    at = np.full((fluids, count), len(volume), dtype=np.int32)
    for column in mesh.cells.T:
        np.minimum.at(at, (np.asarray(mesh.fluid), column), label)
    at[at == len(volume)] = -1
    mark = np.zeros(count, dtype=np.int32)
    beside = mesh.neighbours
    for bit, faces in (
        (ON_HULL, beside < 0),
        (ON_INTERFACE, (beside >= 0) & (label[beside] != label[:, None])),
    ):
        cell, face = np.nonzero(faces)
        for k in range(1, mesh.dimension + 1):
            mark[mesh.cells[cell, (face + k) % (mesh.dimension + 1)]] |= bit
    near = np.flatnonzero((mark[mesh.cells] == ON_INTERFACE).any(axis=1)).astype(np.int32)
    movable = np.zeros(len(volume), dtype=bool)
    movable[label[near]] = True
    return mesh.with_(components=Components(label, fluid, at, mark, movable, near))


def restore_volumes(mesh: Mesh, cavities: Cavities, total: Array) -> None:
    """Restore the volumes of all components, see `wanted_volumes`, and of the fluids; in place.

    What cannot have its volume, as a drop that has lost half of its cells, leaves the rest to the largest component of
    its fluid.
    """
    label = components_of(cavities.cells, cavities.across, cavities.label)
    wanted, fluid = wanted_volumes(mesh, cavities, label, total)
    for last in (False, True):
        cavities.restore_volumes(wanted, label)
        there = cavities.volumes(label, len(wanted))
        if last or np.abs(there - wanted).max() < SLACK * total.sum():
            break
        wanted = there.copy()
        for f in range(len(total)):
            mine = np.flatnonzero(fluid == f)
            if len(mine):
                wanted[mine[np.argmax(there[mine])]] += total[f] - there[mine].sum()


def wanted_volumes(mesh: Mesh, cavities: Cavities, label: Array, total: Array) -> tuple[Array, Array]:
    """The volume (K,) that each component is to have: that of the components before, as far as they share cells.

    And its fluid (K,).

    Args:
        mesh: before the repair.
        cavities: after it.
        label: (M,) component of each of its cells.
        total: (F,) volume that each fluid is to have [m^3].
    """
    fluid, count = np.asarray(mesh.fluid), int(label.max()) + 1
    old = components_of(mesh.cells, mesh.neighbours, fluid)
    own = simplex_measure(cavities.x, np.maximum(cavities.cells, 0)) * (label >= 0)
    of_new = np.zeros(count, dtype=np.int64)
    of_new[label[label >= 0]] = cavities.label[label >= 0]
    there = np.bincount(fluid, mesh.measure, minlength=len(total))
    volume = np.bincount(old, mesh.measure) * (total / np.where(there > 0, there, 1.0))[_first(old, fluid)]
    same = np.flatnonzero(cavities.label[: len(fluid)] == fluid)
    shared = sparse.coo_matrix((own[same], (old[same], label[same])), shape=(len(volume), count)).tocsr()
    whole = np.asarray(shared.sum(axis=1)).ravel()
    wanted = shared.T @ np.divide(volume, whole, out=np.zeros_like(whole), where=whole > 0)
    # What shares no cell with what was there, or cannot move, stays; the largest of its fluid makes up for it.
    size = np.bincount(label[label >= 0], own[label >= 0], minlength=count)
    moves = (cavities.marks & (ON | FIXED)) == ON
    movable = np.zeros(count, dtype=bool)
    movable[label[(label >= 0) & moves[cavities.cells].any(axis=1)]] = True
    stays = (wanted == 0) | ~movable
    wanted[stays] = size[stays]
    for f in range(len(total)):
        mine = np.flatnonzero(of_new == f)
        if len(mine):
            wanted[mine[np.argmax(size[mine])]] += total[f] - wanted[mine].sum()
    return np.asarray(wanted), of_new


def _first(number: Array, values: Array) -> Array:
    """One of the values for each number from 0 on."""
    result = np.zeros(int(number.max()) + 1, dtype=values.dtype)
    result[number] = values
    return result


def keep_momentum(cavities: Cavities, repaired: Array, mesh: Mesh, fields: Array, density: Array) -> None:
    """Restore the momentum, and the rate of it, that a repair has taken; in place.

    Where cells have changed, patch by patch: all particles of a patch get the same velocity and acceleration, but for
    those that are held. What cells lose or gain as volumes are restored goes to their own corners.

    Args:
        cavities: after the repair, with velocities and accelerations as the first columns of the fields.
        repaired: (N', 3) places of the particles before the volumes were restored [m].
        mesh: before the repair.
        fields: (N, K) before it.
        density: (F,) of the fluids [kg/m^3].
    """
    used, count, before = cavities.label >= 0, len(cavities.x), len(mesh.position)
    old_cells, old_fluid, cells, label = mesh.cells, np.asarray(mesh.fluid), cavities.cells, cavities.label
    size, d = len(old_cells), mesh.dimension
    goes = np.zeros(count, dtype=bool)
    goes[:before] = (repaired[:before] != mesh.position).any(axis=1)
    goes |= cavities.is_new
    same = (cells[:size] == old_cells).all(axis=1) & (label[:size] == old_fluid)
    same &= ~goes[old_cells].any(axis=1)
    gone, come = np.flatnonzero(~same), used.copy()
    come[:size] &= ~same
    new = np.flatnonzero(come)
    volume = np.zeros(len(cells))
    volume[used] = simplex_measure(repaired, cells[used])
    held, columns = (cavities.marks & FIXED) != 0, np.s_[:, : 2 * d]
    mass = _masses(cavities, volume, density)
    values = cavities.fields[columns]
    if len(new) or len(gone):
        together = np.concatenate([old_cells[gone], cells[new]])
        patch = _patches(together, count)
        lost = density[old_fluid[gone]] * mesh.measure[gone] / (d + 1)
        made = density[label[new]] * volume[new] / (d + 1)
        moments = np.concatenate(
            [
                lost[:, None] * fields[columns][old_cells[gone]].sum(axis=1),
                -made[:, None] * values[cells[new]].sum(axis=1),
            ]
        )
        at = np.full(count, -1)
        at[together] = patch[:, None]
        free = np.flatnonzero((at >= 0) & ~held & (mass > 0))
        groups = int(patch.max()) + 1
        missing = np.stack([np.bincount(patch, each, groups) for each in moments.T], axis=1)
        weight = np.bincount(at[free], mass[free], groups)
        change = np.divide(missing, weight[:, None], out=np.zeros_like(missing), where=weight[:, None] > 0)
        values[free] += change[at[free]]
    after = np.zeros(len(cells))
    after[used] = simplex_measure(cavities.x, cells[used])
    here = np.flatnonzero(used & (after != volume))
    if len(here):
        mass, corner = _masses(cavities, after, density), cells[here]
        off = density[label[here]] * (volume[here] - after[here]) / (d + 1)
        free = ~held & (mass > 0)
        share = free[corner] / np.maximum(free[corner].sum(axis=1), 1)[:, None]
        for column, lost in zip(values.T, off * values[corner].sum(axis=1).T, strict=True):
            given = np.bincount(corner.ravel(), (share * lost[:, None]).ravel(), count)
            column[free] += given[free] / mass[free]
    cavities.fields[columns] = values


def _masses(cavities: Cavities, volume: Array, density: Array) -> Array:
    """(N,) lumped masses of the particles [kg] for volumes (M,) of the cells [m^3]."""
    used = cavities.label >= 0
    each = density[cavities.label[used]] * volume[used] / (cavities.dim + 1)
    return np.bincount(cavities.cells[used].ravel(), np.repeat(each, cavities.dim + 1), len(cavities.x))


def _patches(cells: Array, count: int) -> Array:
    """The patch (M,) of each of some cells (M, 4) of ``count`` particles: those that share particles are one."""
    row = np.repeat(np.arange(len(cells)), cells.shape[1])
    shape = (len(cells) + count,) * 2
    pairs = sparse.coo_matrix((np.ones(cells.size, np.int8), (row, len(cells) + cells.ravel())), shape=shape)
    _, found = connected_components(pairs, directed=False)
    return np.unique(found[: len(cells)], return_inverse=True)[1]
