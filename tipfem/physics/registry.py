"""The physics that there are, the only list of them."""

from __future__ import annotations

from typing import Any

from tipfem.case.case import Case
from tipfem.physics.bodies.physics import Bodies
from tipfem.physics.free_surface import FreeSurfaces
from tipfem.physics.physics import Physics
from tipfem.physics.side_pressures.physics import InterfacePressures
from tipfem.physics.sliding_liquids.physics import LiquidsThatSlide
from tipfem.physics.surface_tension.physics import Tension
from tipfem.physics.walls.physics import TankWalls

# In the order in which their terms prescribe displacements and pressures.
PHYSICS: tuple[type[Physics[Any]], ...] = (
    TankWalls,
    Bodies,
    FreeSurfaces,
    InterfacePressures,
    LiquidsThatSlide,
    Tension,
)


def physics_of(case: Case) -> tuple[Physics[Any], ...]:
    """The physics that a case has."""
    return tuple(physics for kind in PHYSICS if (physics := kind.of(case)) is not None)
