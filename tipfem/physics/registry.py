"""The physics that there are, the only list of them."""

from __future__ import annotations

import math
from typing import Any

from tipfem.case.case import Case
from tipfem.case.largest_step import RESOLVED
from tipfem.physics.beaches import Beaches
from tipfem.physics.bodies.physics import Bodies
from tipfem.physics.free_surface import FreeSurface
from tipfem.physics.openings.physics import Openings
from tipfem.physics.physics import Physics
from tipfem.physics.side_pressures.physics import SidePressures
from tipfem.physics.sliding_liquids.physics import SlidingLiquids
from tipfem.physics.surface_tension.physics import SurfaceTension
from tipfem.physics.walls.physics import Walls

# In the order in which their terms prescribe displacements and pressures.
PHYSICS: tuple[type[Physics[Any]], ...] = (
    Walls,
    Openings,
    Bodies,
    FreeSurface,
    SidePressures,
    SlidingLiquids,
    SurfaceTension,
    Beaches,
)


def physics_of(case: Case) -> tuple[Physics[Any], ...]:
    """The physics that a case has."""
    return tuple(physics for kind in PHYSICS if (physics := kind.of(case)) is not None)


def step_frequency(case: Case) -> float:
    """Frequency of the fastest motion at the scale of a spacing [1/s]: 0.05 over it is a time step that resolves it.

    It is `Case.natural_frequency`, or that of the shortest `Physics.longest_step`.
    """
    return max(case.natural_frequency(), *(RESOLVED / physics.longest_step for physics in physics_of(case)))


def default_step(case: Case) -> float:
    """Largest time step where none is given [s]: `Case.default_step`, or the shortest `Physics.longest_step`."""
    step = min(case.default_step(), *(physics.longest_step for physics in physics_of(case)))
    return step if math.isfinite(step) else 1e-3
