"""Outlines that touch: corners of one over edges of another, in two dimensions."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tipfem.geometry.domain import Domain
from tipfem.typing import Array

# Outlines that touch are this far apart [spacings]: they stay two chains of particles, with cells between them.
SKIN = 0.05
# Outlines nearer than this are drawn as touching [spacings].
TOUCHING = 2 * SKIN
LEANS = 0.2  # sine of the angle by which sides that touch lean against each other
SWEEPS = 1000  # over all contacts, to put outlines a skin apart
SLACK = 1e-6  # of a gap, in skins, in front of which it is one


class Over(NamedTuple):
    """Corners over edges, K pairs.

    Attributes:
        corner, edge: (K,) their numbers.
        gap: (K,) from the edge's line to the corner [m]; less than 0 behind it.
        normal: (K, 2) of the edge, towards the side where the corner belongs.
    """

    corner: Array
    edge: Array
    gap: Array
    normal: Array


def corners_over(one: Domain, other: Domain, reach: float, *, tanks: tuple[bool, bool] = (False, False)) -> Over:
    """The corners of a solid that are within ``reach`` [m] of the lines of edges of another one, and over these.

    A corner touches an edge if the edge's normal is between those of its own two sides, up to `LEANS`: where corners
    meet, that tells which sides touch.

    Args:
        one: outline with the corners.
        other: outline with the edges.
        reach: [m].
        tanks: whether each of them is that of a tank, which is solid outside.
    """
    out, normal = (of.normal if tank else -of.normal for of, tank in zip((one, other), tanks, strict=True))
    off = one.start[:, None] - other.start
    gap = np.einsum("kei,ei->ke", off, normal)
    along = np.einsum("kei,ei->ke", off, other.direction)
    first, sense = out[np.argsort(one.following)], -1.0 if tanks[0] else 1.0
    between = (first + out) @ normal.T < 0
    for side, turn in ((first, -sense), (out, sense)):  # -normal is after the first one, and before the other
        cross = np.multiply.outer(side[:, 1], normal[:, 0]) - np.multiply.outer(side[:, 0], normal[:, 1])
        between &= turn * cross < LEANS
    slack = SLACK * reach
    found = between & (np.abs(gap) < reach) & (along > -slack) & (along < other.length + slack)
    corner, edge = np.nonzero(found)
    return Over(corner, edge, gap[corner, edge], normal[edge])


class NoRoom(NamedTuple):
    """An outline that touches on opposite sides.

    Attributes:
        number: of the outline.
        missing: width by which it is too large [m].
        place: (2,) of a corner there [m].
    """

    number: int
    missing: float
    place: Array


def shifts_apart(
    outlines: list[Domain], tank: Domain, may: Array, spacing: float
) -> tuple[Array, Array, NoRoom | None]:
    """Shifts that put outlines which touch the tank's or each other's a skin apart.

    Args:
        outlines: of B solids, one loop each.
        tank: around them.
        may: mask (B + 1, B + 1) of the pairs that may touch, the tank first.
        spacing: [m].

    Returns:
        The shifts (B, 2) [m]; the mask (B + 1, B + 1) of the pairs that touch; and an outline for which there is none.
    """
    reach, skin = TOUCHING * spacing, SKIN * spacing
    all_of = [tank, *outlines]
    rows: list[tuple[int, int, float, Array, Array]] = []  # n . (shift of one - shift of other) >= missing
    for one, other in zip(*np.nonzero(may), strict=True):
        if one == other:
            continue
        over = corners_over(all_of[one], all_of[other], reach, tanks=(one == 0, other == 0))
        for corner, gap, n in zip(over.corner, over.gap, over.normal, strict=True):
            rows.append((int(one), int(other), skin - gap, n, all_of[one].start[corner]))
    shift, touch = np.zeros((len(all_of), 2)), np.zeros((len(all_of), len(all_of)), dtype=bool)
    worst: NoRoom | None = None
    for _ in range(SWEEPS):
        worst, most = None, SLACK * skin
        for one, other, short, n, place in rows:
            touch[one, other] = touch[other, one] = True
            missing = float(short - n @ (shift[one] - shift[other]))
            if missing > most:
                worst, most = NoRoom(max(one, other) - 1, missing, place), missing
            if missing > 0:
                part = 0.5 if one and other else 1.0  # the tank stays
                shift[one] += part * missing * n if one else 0.0
                shift[other] -= part * missing * n if other else 0.0
        if worst is None:
            break
    return shift[1:], touch, worst
