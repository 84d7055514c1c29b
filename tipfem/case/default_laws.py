"""The law of walls of which nothing is said, by the kind of case.

There are two: "layer", see `tipfem.physics.walls.layers`, and "no-slip". A tank's walls have the first unless a rule
of `RULES` says otherwise; walls of particles that are given as arrays are no-slip walls. Outlines of bodies have the
first with the sharp interface, which slip along them needs.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Setting:
    """Properties of a case that decide the law."""

    dimension: int  # of the tank
    sharp: bool  # whether the case has the sharp interface
    own_walls: bool  # whether the case is given walls of its own, beside those of the tank
    graded: bool = False  # whether particles are farther apart in some places
    thick: bool = False  # whether a fluid follows a law of viscosity under which no thin boundary layers form
    full: bool = True  # whether the fluids fill the tank


@dataclass(frozen=True)
class Rule:
    """A law, and where and why it is the default."""

    # tells whether the rule is for a setting, and a wall that is curved or not
    applies: Callable[[Setting, bool], bool]
    law: str  # of the walls
    why: str  # the reason, which follows "because"


# The first that applies decides.
RULES = (
    Rule(
        lambda case, curved: case.own_walls, "no-slip", "the case has walls of its own, which may lie on the same sides"
    ),
    Rule(
        lambda case, curved: case.dimension == 3 and case.full and not case.sharp,
        "no-slip",
        "in 3-D, with the interpolated interface, a full tank keeps its mesh better while particles of walls stay",
    ),
    Rule(
        lambda case, curved: case.thick,
        "no-slip",
        "a fluid follows a law of viscosity under which no thin boundary layers form",
    ),
    Rule(
        lambda case, curved: curved and case.graded,
        "no-slip",
        "the wall is curved, and particles would be removed along it where they may be farther apart",
    ),
    Rule(
        lambda case, curved: curved and not case.sharp,
        "no-slip",
        "the wall is curved, and with the interpolated interface the particles along it are not spaced",
    ),
    Rule(lambda case, curved: True, "layer", "boundary layers may be thinner than the particles' spacing"),
)


def default_law(setting: Setting, *, curved: bool) -> Rule:
    """The rule for a wall of a tank of which nothing is said; ``curved`` tells whether the wall is."""
    return next(rule for rule in RULES if rule.applies(setting, curved))


def default_body_law(*, sharp: bool) -> str:
    """The law of a body's outline of which nothing is said, by whether the case has the sharp interface."""
    return "layer" if sharp else "no-slip"
