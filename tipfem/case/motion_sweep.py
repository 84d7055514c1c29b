"""Prescribed motions through a run before it starts: jumps, walls or others in their way, and squeezed fluids."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import TypeVar

import numpy as np

from tipfem.arguments import rounded
from tipfem.case.body import CONTACT, Body
from tipfem.case.boundary.boundary import Boundary
from tipfem.case.case import Case
from tipfem.case.walls import Motion
from tipfem.errors import Invalid
from tipfem.geometry.plane.domain import Domain, gap_between
from tipfem.geometry.plane.touching import SKIN
from tipfem.geometry.plane.vectors import turning
from tipfem.typing import Array

TIMES = 200  # at which motions are looked at
CLOSED = 3.0  # the least distance between walls that move towards each other [spacings]
HALVINGS = 30  # of the interval in which they fail, to tell when
TOUCH = 0.5 * SKIN  # the least gap of bodies that touch [spacings]
T = TypeVar("T")
JUMP = 0.1  # of a motion: what it moves by within the last of these intervals [spacings]


@dataclass(frozen=True)
class Meeting:
    """Place where a body has no room."""

    gap: float  # to what it meets [m]; 0 where they overlap
    place: Array  # (2,) [m]
    other: str  # what it meets, in words


def require_room(case: Case, start: float, end: float, volume: Callable[[], float] | None = None) -> None:
    """Check that prescribed motions of bodies and walls do not jump, and have room from ``start`` to ``end`` [s].

    They are looked at `TIMES` times, so that a body that passes a wall and comes back in between is not found. Bodies
    that float, and those that contact='hold' stops, are left to the run. For a ``volume`` of all fluids [m^2, m^3]
    walls must leave room below a free surface.

    Raises:
        ValueError: a motion jumps; a body leaves the tank, or comes too close to a wall or to another such body; or a
            wall does, or leaves the fluids no room. The message has the first time, and the place.
    """
    if not start < end < np.inf:
        return
    times = np.linspace(start, end, TIMES + 1)
    for path, subject, place in _motions(case):
        _goes_smoothly(path, subject, place, case.particles.spacing, times)
    walls_move = any(wall.motion is not None for wall in case.walls)
    if walls_move:
        _walls_keep_apart(case.boundary, case.particles.spacing, times[1:])
    given = [body for body in case.bodies if not body.floats]
    moving = [body for body in given if (body.motion or case.tank_motion) is not None and body.contact == "stop"]
    still = [body for body in given if body.motion is None and not any(body is one for one in moving)]
    for body in moving:
        _follow(case, body, [other for other in (*moving, *still) if other is not body], times)
    if volume is not None and walls_move and case.boundary.room and not case.boundary.lines:
        _fluids_have_room(case.boundary, volume(), times)


def _motions(case: Case) -> Iterator[tuple[tuple[str, ...], str, Callable[[float], Array]]]:
    """Each motion of a case: its path, in words, and where it is at a time [m]; angles times the size of the tank."""
    size = float(np.ptp(case.particles.position, axis=0).max())
    lengths = np.array([1.0, 1.0, size])
    for wall in case.walls:
        if wall.motion is not None:
            yield ("walls", wall.name, "motion"), f"Case: wall {wall.name!r}", wall.displacement
    for body in case.bodies:
        if body.motion is not None:
            yield ("bodies", body.name, "motion"), f"body {body.name!r}", partial(_scaled, body.motion, lengths)
    if (motion := case.tank_motion) is not None:
        d = case.particles.dimension
        yield (("tank_motion",), "Case", lambda time: np.append(motion.shift(time, d), size * motion.turn(time)))


def _scaled(motion: Motion, lengths: Array, time: float) -> Array:
    """Displacements of a motion in two dimensions at a time [s], scaled by lengths (3,) [m]."""
    return lengths * motion.freedoms(time)


def _goes_smoothly(
    path: tuple[str, ...], subject: str, place: Callable[[float], Array], spacing: float, times: Array
) -> None:
    """Check that a motion has no jump at times (K,) [s]; see `require_room`."""
    at = [place(time) for time in times.tolist()]
    for k, (one, other) in enumerate(pairwise(at)):
        if np.abs(other - one).max() < JUMP * spacing:
            continue
        before, after = times[k : k + 2].tolist()
        for _ in range(HALVINGS):
            middle = 0.5 * (before + after)
            between = place(middle)
            if np.abs(between - one).max() > np.abs(other - between).max():
                after, other = middle, between
            else:
                before, one = middle, between
        jump = float(np.abs(other - one).max())
        if jump >= JUMP * spacing:
            text = f"jumps by {jump:.4g} m at t = {after:.6g} s, which no step can follow; let it go there within a "
            raise Invalid(path, f"{text}time, as soft_start or a sine do", subject)


def _walls_keep_apart(boundary: Boundary, spacing: float, times: Array) -> None:
    """Check that walls keep the volume of a closed tank, and their distance, at times (K,) [s]; see `require_room`."""
    across = boundary.side_normal @ boundary.side_normal.T < -1 + 1e-9
    if isinstance(boundary.tank, Domain):  # the sides behind those of the tank are bodies'
        across[len(boundary.tank) :] = across[:, len(boundary.tank) :] = False
    least = CLOSED * spacing
    for time in times.tolist():
        offset = boundary.offset + boundary.displacements(time, 1e-6)[0]
        width = np.where(across, -(offset[:, None] + offset), np.inf)
        if width.min(initial=np.inf) < least:
            sides = np.unravel_index(np.argmin(width), width.shape)
            names = [boundary.walls[mover].name for k in sides if (mover := boundary.mover[k]) >= 0]
            text = f": its motion leaves {width.min():.4g} m to the opposite wall at t = {time:.4g} s; it must leave "
            text += f"{least:.4g} m or more, {CLOSED:g} spacings"
            raise Invalid(("walls", names[0], "motion"), text, f"Case: wall {names[0]!r}")
        if message := boundary.volume_error(time):
            raise Invalid("walls", f": {message}", "Case")


def _fluids_have_room(boundary: Boundary, volume: float, times: Array) -> None:
    """Check that walls leave room for fluids of a volume at times (K,) [s]; see `require_room`."""

    def full(time: float) -> float | None:
        enclosed = boundary.volume_at(time)
        return enclosed if enclosed < volume else None

    for before, after in pairwise(times.tolist()):
        if full(after) is None:
            continue
        time, _ = _first(full, before, after)
        names = [wall.name for wall in boundary.walls if wall.motion is not None]
        unit = f"m^{boundary.dimension}"
        text = f": from t = {time:.4g} s on its motion leaves the fluids less room than their {volume:.4g} {unit}; let "
        text += f"it end before, or fill less: at t = {after:.4g} s there are {boundary.volume_at(after):.4g} {unit}"
        raise Invalid(("walls", names[0], "motion"), text, f"Case: wall {names[0]!r}")


def _follow(case: Case, body: Body, others: list[Body], times: Array) -> None:
    """Check one body at times (K,) [s]; see `require_room` for errors."""
    limit = (TOUCH if body.gap else CONTACT) * case.particles.spacing

    def meets(time: float) -> Meeting | None:
        found = nearest_of(case, body, others, time)
        return found if found.gap < limit else None

    for before, time in pairwise(times):
        if meets(float(time)) is None:
            continue
        first, meeting = _first(meets, float(before), float(time))
        own, there = body.motion is not None, f"at t = {first:.4g} s, at {rounded(meeting.place)} m, where "
        moves = f": its motion takes it to {meeting.other}" if own else f"takes {meeting.other} to body {body.name!r}"
        text = f"{moves} {there}"
        text += f"the run would stop: the gap must not be less than {limit / case.particles.spacing:g} spacings "
        text += f"({limit:.4g} m). Let the motion end before"
        text += "" if body.gap else ", or hold the body there by contact = 'hold'"
        path, subject = (("bodies", body.name, "motion"), f"body {body.name!r}") if own else (("tank_motion",), "Case")
        raise Invalid(path, text, subject)


def _first(meets: Callable[[float], T | None], before: float, after: float) -> tuple[float, T]:
    """The first time between two [s] at which a function finds something, as at the second, and what that is."""
    for _ in range(HALVINGS):
        middle = 0.5 * (before + after)
        before, after = (before, middle) if meets(middle) else (middle, after)
    meeting = meets(after)
    assert meeting is not None
    return after, meeting


def nearest_of(case: Case, body: Body, others: list[Body], time: float) -> Meeting:
    """Nearest obstacle to a body with a prescribed motion, among the walls and other such bodies, at a time [s]."""
    pose, tank = case.boundary.pose(time, 1e-6), case.boundary.tank_at(time)
    outline, tank = _outline(body, time), tank.with_corners(pose.place(tank.start))
    found = gap_between(outline, tank, outside=False)
    nearest = Meeting(found[0], found[1], f"the wall {tank.sides[tank.side[found[2]]]!r}")
    for other in others:
        gap, place, _ = gap_between(outline, _outline(other, time), outside=True)
        if gap < nearest.gap:
            nearest = Meeting(gap, place, f"body {other.name!r}")
    return nearest


def _outline(body: Body, time: float) -> Domain:
    """The region that a body covers at a time [s]."""
    corners = body.corners
    if body.motion is not None:
        x, y, angle = body.motion.freedoms(time)
        # The pivot of a motion without one is the body's centre.
        pivot = body.reference
        corners = (corners - pivot) @ turning(angle) + pivot + (x, y)
    count = len(corners)
    return Domain([corners], [[body.name] * count], [[-1] * count])
