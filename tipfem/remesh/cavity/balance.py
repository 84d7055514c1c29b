"""Balances of a repair by cavities: the volumes of the components of fluids, and momentum."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy import sparse

from tipfem.backend.launch import launch
from tipfem.mesh.mesh import Mesh
from tipfem.physics.state import lumped
from tipfem.remesh.cavity import passes
from tipfem.remesh.cavity.arrays import FIXED, ON
from tipfem.remesh.cavity.cavities import Cavities, measures, touching
from tipfem.remesh.volumes import component_numbers
from tipfem.scratch import scratch
from tipfem.typing import Array

NOTICED = 1e-6  # volume that is given back close to where it is missing [spacings^d]
SLACK = 1e-13  # of the volume of all fluids, that may be missing


def components_of(x: Array, cells: Array, across: Array, label: Array, *, empty: bool = False) -> Array:
    """The component (M,) of each cell among those of its label that are joined by faces; -1 for unused rows.

    Label 0 is one component where it is ``empty`` space.
    """
    result, count = component_numbers(x, cells, across, np.where(label == 0, -1, label) if empty else label)
    if empty:
        result[label == 0] = count
    return result


class Wanted(NamedTuple):
    """Volumes that the components of a mesh are to have after a repair."""

    of: Array  # (M,) component of each cell before it
    label: Array  # (K,) of each component
    volume: Array  # (K,) [m^3]

    @classmethod
    def of_mesh(cls, mesh: Mesh, total: Array, *, empty: bool = False, known: Array | None = None) -> Wanted:
        """The components of a mesh, each with its part of the ``total`` (F,) volume of its label [m^3].

        Of the first cells the component may be ``known`` (M',): the others are ``empty`` space.
        """
        fluid = np.asarray(mesh.fluid)
        if known is None:
            of = components_of(mesh.position, mesh.cells, mesh.neighbours, fluid, empty=empty)
        else:
            of = np.append(known, np.full(len(fluid) - len(known), known.max() + 1, dtype=known.dtype))
        label, there = first_of(of, fluid), np.bincount(fluid, mesh.measure, minlength=len(total))
        return cls(of, label, np.bincount(of, mesh.measure) * (total / np.where(there > 0, there, 1.0))[label])


def restore_volumes(cavities: Cavities, old: Wanted, label: Array, empty: bool) -> None:
    """Restore the volumes of all components ``label`` (M,), see `wanted_volumes`, and of the fluids; in place.

    What cannot have its volume, as a drop that has lost half of its cells, leaves the rest to the largest component of
    its fluid. Label 0 has any volume where it is ``empty`` space.
    """
    total = np.bincount(old.label, old.volume)
    wanted, fluid = wanted_volumes(cavities, label, old)
    for last in (False, True):
        cavities.restore_volumes(wanted, label, (fluid == 0) & empty)
        there = cavities.volumes(label, len(wanted))
        off = np.where((fluid == 0) & empty, 0.0, there - wanted)
        if last or np.abs(off).max() < SLACK * total[int(empty) :].sum():
            break
        wanted = there.copy()
        for f in range(len(total)):
            mine = np.flatnonzero(fluid == f)
            if len(mine):
                wanted[mine[np.argmax(there[mine])]] += total[f] - there[mine].sum()


def wanted_volumes(cavities: Cavities, label: Array, old: Wanted) -> tuple[Array, Array]:
    """The volume (K,) that each component is to have: that of the components before, as far as they share cells.

    And its fluid (K,).

    Args:
        cavities: after a repair.
        label: (M,) component of each of its cells.
        old: what was there before.
    """
    fluid, count = old.label[old.of], int(label.max()) + 1
    own = np.where(label >= 0, measures(cavities.x, cavities.cells), 0.0)
    of_new = np.zeros(count, dtype=np.int64)
    of_new[label[label >= 0]] = cavities.label[label >= 0]
    same = np.flatnonzero(cavities.label[: len(fluid)] == fluid)
    shared = sparse.coo_matrix((own[same], (old.of[same], label[same])), shape=(len(old.volume), count)).tocsr()
    whole = np.asarray(shared.sum(axis=1)).ravel()
    wanted = shared.T @ np.divide(old.volume, whole, out=np.zeros_like(whole), where=whole > 0)
    # What shares no cell with what was there, or cannot move, stays; the largest of its fluid makes up for it.
    size = np.bincount(label[label >= 0], own[label >= 0], minlength=count)
    moves = (cavities.marks & (ON | FIXED)) == ON
    movable = np.zeros(count, dtype=bool)
    movable[label[(label >= 0) & touching(moves, cavities.cells)]] = True
    stays = (wanted == 0) | ~movable
    wanted[stays] = size[stays]
    for f, total in enumerate(np.bincount(old.label, old.volume)):
        mine = np.flatnonzero(of_new == f)
        if len(mine):
            wanted[mine[np.argmax(size[mine])]] += total - wanted[mine].sum()
    return np.asarray(wanted), of_new


def first_of(number: Array, values: Array) -> Array:
    """One of the values for each number from 0 on."""
    result = np.zeros(int(number.max()) + 1, dtype=values.dtype)
    result[number] = values
    return result


def changed(cavities: Cavities, place: Array, mesh: Mesh) -> tuple[Array, Array]:
    """The cells of a mesh that a repair has changed, and those that are there for them, of particles at ``place``."""
    gone, come = (np.empty(len(some), dtype=bool) for some in (mesh.cells, cavities.cells))
    cells, fluid = (np.asarray(each, dtype=np.int32) for each in (mesh.cells, mesh.fluid))
    old = np.ascontiguousarray(mesh.position), np.ascontiguousarray(cells), fluid
    now = cavities.simplices._replace(x=np.ascontiguousarray(place)), cavities.is_new.view(np.int8)
    launch(passes.compare, *old, *now, gone.view(np.int8), come.view(np.int8), work=(len(come), passes.MEASURE))
    return np.flatnonzero(gone), np.flatnonzero(come)


def restore_nearby(cavities: Cavities, mesh: Mesh, density: Array) -> None:
    """Restore to labels what a repair has taken from them, as where films break, close to where it was; in place.

    Spread over all of a fluid's faces, water of a toe on a floor would be raised to the level of the lake behind it.
    """
    gone, new = changed(cavities, cavities.x, mesh)
    label, least = np.asarray(mesh.fluid)[gone], NOTICED * cavities.spacing**mesh.dimension
    if not len(gone):
        return
    cells = np.concatenate([mesh.cells[gone], cavities.cells[new]])
    patch, count = _patches(cells, len(cavities.x))
    rank = np.concatenate([label, cavities.label[new]])
    off = np.concatenate([mesh.measure[gone], -measures(cavities.x, cavities.cells[new])])
    missing = np.bincount(rank * count + patch, off, len(density) * count).reshape(-1, count)
    missing[0] = 0.0  # which is what all others have not
    number, patches = np.nonzero(np.abs(missing) > least)
    if len(number):
        of, there = np.divmod(np.unique(patch[:, None] * len(cavities.x) + cells), len(cavities.x))
        first, last = (np.searchsorted(of, patches, side) for side in ("left", "right"))
        part = np.repeat(np.arange(len(patches)), last - first)
        near = there[np.arange(len(part)) - np.repeat(np.cumsum(last - first) - last, last - first)]
        cavities.restore_near(number, part, near, missing[number, patches])


def keep_momentum(cavities: Cavities, repaired: Array, mesh: Mesh, fields: Array, density: Array) -> None:
    """Restore the momentum, and the rate of it, that a repair of the mesh has taken; in place.

    Where cells have changed, patch by patch: all particles of a patch get the same velocity and acceleration, the first
    columns of the fields, but for those that are held. What other cells lose or gain as volumes are restored goes to
    their own corners, ``repaired`` (N', 3) before it. A small piece that the repair makes larger, and restored volumes
    smaller, would be several times as fast if its corners took that up, too. Empty space, without density, joins no
    patches.
    """
    used, count, d = cavities.label >= 0, len(cavities.x), mesh.dimension
    old_cells, old_fluid, cells, label = mesh.cells, np.asarray(mesh.fluid), cavities.cells, cavities.label
    gone, new = changed(cavities, repaired, mesh)
    gone, new = gone[density[old_fluid[gone]] > 0], new[density[label[new]] > 0]
    before, volume = (np.where(used, measures(x, cells), 0.0) for x in (repaired, cavities.x))
    held, columns = (cavities.marks & FIXED) != 0, np.s_[:, : 2 * d]
    values = cavities.fields[columns]
    moved = used & (volume != before)
    moved[new] = False
    here = np.flatnonzero(moved)
    lacks = (density[label[here]] * (before[here] - volume[here]) / (d + 1))[:, None] * _sums(values, cells[here])
    if len(new) or len(gone):
        together = np.concatenate([old_cells[gone], cells[new]])
        patch, groups = _patches(together, count)
        lost = density[old_fluid[gone]] * mesh.measure[gone] / (d + 1)
        made = density[label[new]] * volume[new] / (d + 1)
        moments = np.concatenate(
            [
                lost[:, None] * _sums(fields[columns], old_cells[gone]),
                -made[:, None] * _sums(values, cells[new]),
            ]
        )
        at = np.full(count, -1)
        at[together] = patch[:, None]
        mass = masses(cavities, volume, density, at >= 0)
        free = np.flatnonzero((at >= 0) & ~held & (mass > 0))
        missing = np.stack([np.bincount(patch, each, groups) for each in moments.T], axis=1)
        weight = np.bincount(at[free], mass[free], groups)
        change = np.divide(missing, weight[:, None], out=np.zeros_like(missing), where=weight[:, None] > 0)
        values[free] += change[at[free]]
    if len(here):
        corner, near = cells[here], np.zeros(count, dtype=bool)
        near[corner] = True
        mass = masses(cavities, volume, density, near)
        free = ~held & (mass > 0)
        share = free[corner] / np.maximum(free[corner].sum(axis=1), 1)[:, None]
        for column, lack in zip(values.T, lacks.T, strict=True):
            given = np.bincount(corner.ravel(), (share * lack[:, None]).ravel(), count)
            column[free] += given[free] / mass[free]
    cavities.fields[columns] = values


def _sums(values: Array, cells: Array) -> Array:
    """(M, C) sums of values (N, C) over the corners of cells (M, d + 1)."""
    out, sizes = np.empty((len(cells), values.shape[1])), (cells.shape[1] - 1, values.shape[1])
    given = np.ascontiguousarray(cells, dtype=np.int32), np.ascontiguousarray(values), out, *sizes
    launch(passes.sum_corners, *given, work=(len(cells), passes.SUM))
    return out


def masses(cavities: Cavities, volume: Array, density: Array, some: Array) -> Array:
    """(N,) lumped masses of ``some`` particles (N,) for volumes (M,) of the cells [m^3]; of others, less [kg]."""
    used = cavities.around(some)
    mesh = Mesh(cavities.x, cavities.cells[used]).with_(measure=volume[used])
    return lumped(mesh, density[cavities.label[used]])


def _patches(cells: Array, count: int) -> tuple[Array, int]:
    """The patch (M,) of each of some cells (M, d + 1) of ``count`` particles, and how many: who share particles."""
    patch = np.empty(len(cells), dtype=np.int32)
    rows = (scratch(f"patches.{name}", count, np.int32) for name in ("parent", "number"))
    return patch, int(launch(passes.join_patches, np.ascontiguousarray(cells, dtype=np.int32), *rows, patch))
