"""Outlines that touch: corners of one over edges of another, in two dimensions."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tipfem.geometry.plane.domain import Domain
from tipfem.typing import Array

# Outlines that touch are this far apart [spacings]: they stay two chains of particles, with cells between them.
SKIN = 0.05
# Outlines nearer than this are drawn as touching [spacings].
TOUCHING = 2 * SKIN
LEANS = 0.2  # sine of the angle by which sides that touch lean against each other
SWEEPS = 1000  # over all contacts, to put outlines a skin apart
EXACT = 1e-11  # what they leave of it [skins]
SLACK = 1e-6  # of a gap, in skins, in front of which it is one


class Over(NamedTuple):
    """Corners over edges, K pairs."""

    corner: Array  # (K,) their numbers
    edge: Array  # (K,) their numbers
    gap: Array  # (K,) from the edge's line to the corner [m]; less than 0 behind it
    normal: Array  # (K, 2) of the edge, towards the side where the corner belongs


def corners_over(one: Domain, other: Domain, reach: float, *, tanks: tuple[bool, bool] = (False, False)) -> Over:
    """The corners of one solid within ``reach`` [m] of edges of the other, and over these.

    A corner touches an edge if the edge's normal is between those of its own two sides, up to `LEANS`: where corners
    meet, that tells which sides touch. ``tanks`` has whether each is a tank, solid outside.
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
    """An outline that touches on opposite sides."""

    number: int  # of the outline
    missing: float  # width by which it is too large [m]
    place: Array  # (2,) of a corner there [m]


def shifts_apart(
    outlines: list[Domain], tank: Domain, may: Array, spacing: float
) -> tuple[Array, Array, NoRoom | None]:
    """Shifts (B, 2) [m] that put the outlines of B solids that touch the tank's or each other's a skin apart.

    Beside them the mask (B + 1, B + 1) of the pairs that touch, of those that ``may``, the tank first, and an outline
    for which there is no shift.
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
        worst, most, short_of = None, SLACK * skin, 0.0
        for one, other, short, n, place in rows:
            touch[one, other] = touch[other, one] = True
            missing = float(short - n @ (shift[one] - shift[other]))
            short_of = max(short_of, missing)
            if missing > most:
                worst, most = NoRoom(max(one, other) - 1, missing, place), missing
            if missing > 0:
                part = 0.5 if one and other else 1.0  # the tank stays
                shift[one] += part * missing * n if one else 0.0
                shift[other] -= part * missing * n if other else 0.0
        if short_of <= EXACT * skin:
            break
    return shift[1:], touch, worst
