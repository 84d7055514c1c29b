"""Gaps between solids that touch: their cells are closed, and belong to empty space.

The outlines of solids that touch stay two chains of particles, a skin apart. A cell is between solids if each of its
particles is on one, and they are not all on the same. Its gap is the distance of a corner on one solid to the edge on
the other. Cells between solids that are of empty space and narrow are closed: no fluid is solved there, and where they
touch nothing slides at their particles. Their label is what is remembered of them.

Fluids close where solids touch, as far as the gap is narrow from there and in front of both. What is closed opens where
it is wide or no longer in front of both: to the empty space beside it, or else, where it has none, to the fluid there.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping
from typing import Any

import numpy as np

from tipfem.geometry.plane.domain import Domain
from tipfem.geometry.plane.touching import SKIN
from tipfem.linalg.parts import connected_parts
from tipfem.mesh.mesh import Mesh, corners_among
from tipfem.typing import Array

TOUCH = 1.2 * SKIN  # where a gap closes [spacings]
HELD = 2.4 * SKIN  # below which nothing slides in it
NARROW = 0.5  # as far as it closes around such a place
WIDE = 0.9  # where it opens again
BESIDE = 0.01  # part of an edge of a solid by which a particle over it may be beyond its ends


def owners(label: Array, wall: Array) -> Array:
    """(N,) number of the solid that each particle is on: 0 for the tank, b + 1 for body b, -1 for none."""
    return np.where(label >= 0, label + 1, np.where(wall, 0, -1)).astype(np.int32)


def gap_widths(position: Array, cells: Array, owner: Array) -> Array:
    """(M,) gap of each cell between solids, inf for other cells [m]; ``owner`` (N,) see `owners`."""
    result = np.full(len(cells), np.inf)
    rows = np.flatnonzero(corners_among(owner >= 0, cells) == 3)
    one, two, three = owner[cells[rows]].T
    rows = rows[(one != two) | (one != three)]
    x, of = position[cells[rows]], owner[cells[rows]]
    sides = np.roll(x, -2, axis=1) - np.roll(x, -1, axis=1)  # opposite to each corner
    length = np.linalg.norm(sides, axis=2)
    # The edge that is on one solid; of three solids the longest.
    same = np.roll(of, -1, axis=1) == np.roll(of, -2, axis=1)
    length = np.where(same.any(axis=1, keepdims=True), np.where(same, length, 0.0), length).max(axis=1)
    twice = np.abs(sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0])
    result[rows] = twice / length
    return result


def closed_cells(position: Array, cells: Array, owner: Array, spacing: float) -> Array:
    """(M,) mask of the cells of empty space that are closed."""
    return gap_widths(position, cells, owner) < WIDE * spacing


def is_full(mesh: Mesh, empty: Array | None, owner: Array) -> bool:
    """Whether all empty cells (E, 3) are between solids, if there are any; ``owner`` (N,) see `owners`."""
    between = empty is None or np.isfinite(gap_widths(mesh.position, empty, owner)).all()
    return bool(between) and not mesh.flying.any()


def closed_particles(
    position: Array, empty: Array | None, owner: Array, spacing: float, until: float = HELD
) -> Array | None:
    """(N,) mask of the particles that closed cells hold, of empty cells (M, 3) of a mesh; None for none.

    ``until`` is the gap from which on they slide [spacings].
    """
    if empty is None or not len(empty):
        return None
    shut = gap_widths(position, empty, owner) < until * spacing
    if not shut.any():
        return None
    result = np.zeros(len(owner), dtype=bool)
    result[empty[shut]] = True
    return result


def touching_particles(position: Array, empty: Array | None, owner: Array, spacing: float) -> Array:
    """(N,) mask of the particles of closed gaps, of empty cells (M, 3), narrow somewhere, up to where they are wide."""
    count = len(owner)
    if empty is None or not len(empty):
        return np.zeros(count, dtype=bool)
    gap = gap_widths(position, empty, owner) / spacing
    cells = empty[gap < WIDE]
    number = connected_parts(count, cells[:, :2].ravel(), cells[:, 1:].ravel())[1]
    result = np.isin(number, number[empty[gap < HELD]])
    return np.asarray(result)


def facing(position: Array, cells: Array, owner: Array, outlines: Mapping[int, Domain], *, tips: bool = True) -> Array:
    """(M,) mask of cells between solids in front of a side of each, and not beyond a corner, where fluids begin.

    ``outlines`` of the solids are by their numbers, see `owners`; with ``tips`` particles over sides are in front, too.
    """
    of, result = owner[cells], np.ones(len(cells), dtype=bool)
    for k in range(3):
        one, other = (k + 1) % 3, (k + 2) % 3
        across = (of[:, one] == of[:, other]) & (of[:, k] != of[:, one])
        tip, start, end = (position[cells[:, i]] for i in (k, one, other))
        edge = end - start
        # Beside a corner of a solid its other side is nearest, too: the edge tells which side it is.
        foot = ((tip - start) * edge).sum(axis=1) / np.maximum((edge**2).sum(axis=1), 1e-300)
        above = (foot > -BESIDE) & (foot < 1 + BESIDE)
        for number, outline in outlines.items():
            for faces, place, allowed in ((k, 0.5 * (start + end), False), (one, tip, above | (not tips))):
                rows = np.flatnonzero(across & (of[:, faces] == number) & ~np.asarray(allowed))
                if len(rows):
                    distance, part = outline.distances(place[rows])
                    nearest = part[np.arange(len(rows)), distance.argmin(axis=1)]
                    result[rows] &= (nearest > 0) & (nearest < 1)
    return result


def relabelled(
    mesh: Mesh,
    position: Array,
    owner: Array,
    outlines: Mapping[int, Domain],
    may: Array,
    spacing: float,
    empty: int,
) -> Mesh:
    """A mesh, of fluids and empty space with the number ``empty``, with gaps that close and open.

    ``outlines`` of the solids are by their numbers, see `owners`, at the time of ``position`` (N, 2) [m]; ``may`` (B +
    1,) masks those that may touch others.
    """
    fluid = np.asarray(mesh.fluid).copy()
    gap = gap_widths(position, mesh.cells, owner) / spacing
    near = np.flatnonzero(np.isfinite(gap))
    gap[near[~may[owner[mesh.cells[near]]].any(axis=1)]] = np.inf
    # Fluids close, connected with a place that touches.
    narrow = (gap < NARROW) & (fluid != empty)
    rows = np.flatnonzero(narrow)
    narrow[rows] = facing(position, mesh.cells[rows], owner, outlines)
    if (gap[narrow] < TOUCH).any():
        number = _parts(narrow, *_beside(mesh, narrow))
        touched = np.zeros(len(fluid), dtype=bool)
        touched[number[narrow & (gap < TOUCH)]] = True
        fluid[narrow & touched[number]] = empty
    # What is empty between solids fills where it is wide, or behind one that has slid on, beside a fluid and not beside
    # empty space.
    wide = np.isfinite(gap) & (fluid == empty)
    rows = np.flatnonzero(wide & (gap < WIDE))
    wide[rows] = ~facing(position, mesh.cells[rows], owner, outlines, tips=False)
    if wide.any():
        cell, other = _beside(mesh, wide)
        number = _parts(wide, cell, other)
        dry, beside = np.zeros(len(fluid), dtype=bool), np.full(len(fluid), -1)
        dry[number[cell[(fluid[other] == empty) & ~np.isfinite(gap[other])]]] = True
        wet = fluid[other] != empty
        np.maximum.at(beside, number[cell[wet]], fluid[other[wet]])
        fills = wide & ~dry[number] & (beside[number] >= 0)
        fluid[fills] = beside[number[fills]]
    return mesh if (fluid == mesh.fluid).all() else mesh.relabelled(fluid.astype(np.int32))


def _beside(mesh: Mesh, mask: Array) -> tuple[Array, Array]:
    """Cells (K,) of a mask (M,), and those across their sides; those of the whole mesh are dear."""
    inside = np.zeros(len(mesh.position), dtype=np.int8)
    inside[mesh.cells[mask]] = 1
    near = np.flatnonzero(sum(inside[of] for of in mesh.cells.T) > 1)
    ends = np.sort(mesh.cells[near][:, ((1, 2), (2, 0), (0, 1))].reshape(-1, 2).astype(np.int64), axis=1)
    key = ends[:, 0] * len(inside) + ends[:, 1]
    order = np.argsort(key, kind="stable")
    first = np.flatnonzero(np.diff(key[order]) == 0)
    one, other = (near[order[of] // 3] for of in (first, first + 1))
    cell, other = np.append(one, other), np.append(other, one)
    return cell[mask[cell]], other[mask[cell]]


def _parts(mask: Array, cell: Array, other: Array) -> Array:
    """(M,) number of the connected part of each cell of a mask (M,), see `_beside`; 0 for others, too."""
    cells, number = np.flatnonzero(mask), np.zeros(len(mask), dtype=int)
    number[cells] = np.arange(len(cells))
    inner = mask[other]
    number[cells] = connected_parts(len(cells), number[cell[inner]], number[other[inner]])[1]
    return number


def tightened(boundary: Any, held: Array) -> Any:
    """A boundary on which the particles of a mask (N,) do not slide."""
    stays = held[boundary.index[boundary.slides]]
    if not stays.any():
        return boundary
    new = copy.copy(boundary)
    new.free = boundary.free.copy()
    new.free[boundary.slides[stays]] = 0.0
    new.slides = boundary.slides[~stays]
    return new
