"""Passages: the particles of openings on the boundary of a case, which no wall holds."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from tipfem.case.open_lines import OpenLine
from tipfem.geometry.plane.domain import Domain
from tipfem.typing import Array

Member = tuple[int, int, Array]  # number of a wall, number of its side, particles on it; see `Boundary.members`


@dataclass(frozen=True)
class Passages:
    """The openings among the W wall particles of a boundary with S sides, and N particles."""

    nodes: list[Array]  # the particles of each opening, from one end to the other, ends included
    # (N,) mask of those that no wall holds: all but the ends, and these too where an inlet begins in a corner with a
    # wall along which fluids slide
    open: Array
    free: Array  # (N,) mask of those whose displacements are unknowns: they are on outlets and vents
    crossing: Array  # (K,) those that cross their opening at right angles only, and
    across: Array  # (K, 2) the directions in which they do
    # (W,) all wall particles, their positions (W, 2) and sides (W, S), and members of the walls as if there were no
    # openings
    index: Array
    # (W,) all wall particles, their positions (W, 2) and sides (W, S), and members of the walls as if there were no
    # openings
    y: Array
    # (W,) all wall particles, their positions (W, 2) and sides (W, S), and members of the walls as if there were no
    # openings
    on_side: Array
    # (W,) all wall particles, their positions (W, 2) and sides (W, S), and members of the walls as if there were no
    # openings
    members: list[Member]
    # row, side and number of the wall (-1 for one that is fixed and no-slip) of each particle that is the last one of
    # its wall because of an opening in the corner, and slides if the wall lets it. Rows are those of the particles that
    # are left
    corners: list[tuple[int, int, int]]

    @property
    def ends(self) -> Array:
        """The particles at the ends of openings."""
        return np.concatenate([on[[0, -1]] for on in self.nodes])

    def without(self, pairs: Array) -> Array:
        """The faces (E, 2) of a boundary, given by their particles, that are not on openings."""
        count = int(pairs.max()) + 1
        across = np.concatenate([np.sort(np.stack([on[:-1], on[1:]], axis=1), axis=1) for on in self.nodes])
        return pairs[~np.isin(np.sort(pairs, axis=1) @ [count, 1], across @ [count, 1])]

    def remain(self, lines: Sequence[OpenLine], y: Array, on_side: Array, slack: float) -> bool:
        """Whether the same particles are on the openings in the same order, at other positions; see `opened`."""
        for line, on in zip(lines, self.nodes, strict=True):
            s = line.coordinates(y[on_side[:, line.side]])
            within = np.count_nonzero((s >= -slack) & (s <= line.length + slack))
            s = line.coordinates(y[np.searchsorted(self.index, on)])
            if within != len(on) or not (np.diff(s) > 0).all() or s[0] < -slack or s[-1] > line.length + slack:
                return False
        return True

    def hold(self, fixed: Array, slippery: Array) -> None:
        """Set in masks (N,) which of them a repair keeps, and which slide: those that are free, but for the ends."""
        slippery[self.open] = self.free[self.open]
        slippery[self.ends], fixed[self.ends] = False, True
        fixed[self.open & ~self.free] = True


def opened(
    lines: Sequence[OpenLine],
    normal: Sequence[bool],
    index: Array,
    y: Array,
    on_side: Array,
    members: list[Member],
    count: int,
    slack: float,
) -> tuple[Passages, Array, Array, list[Member]]:
    """The openings on wall particles, and what is left to the walls.

    The wall particles ``index`` (W,) are at ``y`` (W, 2) in the tank [m], and on sides ``on_side`` (W, S); within
    ``slack`` of an end they are there [m]. Which openings are crossed at right angles only says ``normal``. Returns the
    passages; a mask (W,) of the particles that walls hold; the sides (W', S) of these, and the walls' members among
    them: two where an opening interrupts a wall.
    """
    left, kept, corners, rows_of = on_side.copy(), np.ones(len(index), dtype=bool), list[int](), list[Array]()
    none = np.zeros(0, dtype=np.int64), np.zeros((0, y.shape[1]))
    crossing = [none]
    for line, right_angles in zip(lines, normal, strict=True):
        row = np.flatnonzero(on_side[:, line.side])
        s = line.coordinates(y[row])
        order = np.argsort(s, kind="stable")
        first, last = np.searchsorted(s[order], [-slack, line.length + slack])
        row = row[order[first:last]]
        rows_of.append(row)
        free = row[1:-1]
        if right_angles:
            crossing.append((index[free], np.tile(line.inwards, (len(free), 1))))
        for end, slips in zip(row[[0, -1]].tolist(), line.slips, strict=True):
            if on_side[end].sum() > 1:
                left[end, line.side] = False
                corners.append(end)
            if slips and line.opening.velocities:
                free = np.append(free, end)
        kept[free] = False
    number = np.cumsum(kept) - 1
    among, slides = list[Member](), list[tuple[int, int, int]]()
    for wall, side, found in members:
        part = np.zeros(len(found), dtype=np.int64)
        for line, row in zip(lines, rows_of, strict=True):
            if line.side == side:
                is_on = np.zeros(len(index), dtype=bool)
                is_on[row] = True
                on = is_on[found]
                part[1:] += np.cumsum(on[1:] & on[:-1])
        stays = left[found, side] & kept[found]
        for own in np.flatnonzero(np.bincount(part[stays])):
            rows = found[(part == own) & stays]
            if len(rows) > 1:
                among.append((wall, side, number[rows]))
                # Where the end is an inlet's, the last one of the wall slides as those beside it do.
                whole = found[part == own]
                slides += [
                    (int(number[row]), side, wall)
                    for row, end in zip(rows[[0, -1]], whole[[0, -1]], strict=True)
                    if not kept[end]
                ]
    owner = {side: wall for wall, side, _ in members}
    is_open = np.zeros(count, dtype=bool)
    is_open[index[~kept]] = True
    nodes, is_free = [index[row] for row in rows_of], np.zeros(count, dtype=bool)
    for line, on in zip(lines, nodes, strict=True):
        if not line.opening.velocities:
            is_free[on[1:-1]] = True
    across = (np.concatenate(column) for column in zip(*crossing, strict=True))
    ends = [(int(number[end]), int(np.argmax(left[end]))) for end in corners if kept[end]]
    slides += [(row, side, owner.get(side, -1)) for row, side in ends]
    passages = Passages(nodes, is_open, is_free, next(across), next(across), index, y, on_side, members, slides)
    return passages, kept, left[kept], among


def with_ends(
    lines: Sequence[OpenLine], nodes: Sequence[Array], slides: Array, corners: Array, slippery: Collection[int]
) -> list[OpenLine]:
    """Openings with what their ends may do: in a wall that slips under a free surface, an inlet's end is a jet's foot.

    ``slides`` (N,) masks particles that slide along walls in ``corners``; ``slippery`` are the sides whose walls slip
    where there is empty space.
    """
    result = []
    for line, on in zip(lines, nodes, strict=True):
        first, last = (line.side in slippery and end not in corners for end in on[[0, -1]])
        one, other = slides[on[[0, -1]]].tolist()
        result.append(dataclasses.replace(line, slips=(one or first, other or last), beside=(first, last)))
    return result


def edges_named(domain: Domain, sides: Mapping[str, Array], slack: float) -> dict[str, Array]:
    """Edges (E,) of a domain by the names of walls.

    ``sides`` of a box, whose edges have no names: one point (2,) on each, NaN where any coordinate will do [m], from
    which edges are within ``slack`` [m].
    """
    if not sides:
        return {name: np.flatnonzero(domain.side == k) for k, name in enumerate(domain.sides)}
    on = {
        name: [(np.abs(ends - point) < slack).any(axis=1) for ends in (domain.start, domain.end)]
        for name, point in sides.items()
    }
    return {name: np.flatnonzero(first & last) for name, (first, last) in on.items()}
