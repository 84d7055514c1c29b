"""The dam break of section 4.2 of Carvalho & Sanches, as the studies vary it, and the probes that are compared.

The script demos/dam_break.py has the same case written out.
"""

from __future__ import annotations

from typing import Any

import tipfem as tp
from tipfem.mesh import measures

# Resolution: 5 mm is the coarser of the paper's two.
SPACING = 0.005  # [m]
TIME_STEP = 2.25e-3  # [s]

# Fluids, at 20 degrees Celsius.
WATER = tp.Fluid("water", density=998.2, viscosity=1.002e-3)
AIR = tp.Fluid("air", density=1.204, viscosity=1.825e-5)

# Geometry.
TANK = (0.584, 0.584)  # [m]
COLUMN = (0.146, 0.292)  # width and height [m]
GRAVITY = 9.81  # [m/s^2]
# Where the column's height is read off, from the left wall [m]. No-slip walls keep a film of water
# a particle wide and drops that stick to it; this is far enough from them, and the surface is flat there.
GAUGE = 0.15 * COLUMN[0]


def build(spacing: float = SPACING, *, slip: bool = False, law: str | None = None, **options: Any) -> tp.Case:
    """The case.

    Args:
        spacing: distance between particles [m].
        slip: whether all walls slip freely.
        law: of all walls, see `tipfem.Wall`; by default that of tanks.
        options: further ones of `tipfem.Case`.
    """
    tank = tp.tank(size=TANK, spacing=spacing).fill(AIR).fill(WATER, box=((0, 0), COLUMN))
    for side in ("left", "right", "bottom", "top") if slip or law else ():
        tank.wall(side, slip=slip, law=law)
    return tp.Case(tank, fluids=[WATER, AIR], gravity=(0, -GRAVITY), title="Dam break of water in air", **options)


def front(simulation: tp.Simulation) -> float:
    """Largest x of the water [m]; where fluids are interpolated, at the middle of the edges that join it to the air."""
    return measures.extent(simulation.mesh, simulation.particles.fluid, 0, axis=0)


def column_height(simulation: tp.Simulation) -> float:
    """Depth of the water at the gauge near the left wall [m]."""
    return measures.depth(simulation.mesh, simulation.particles.fluid, 0, GAUGE)


def spray(simulation: tp.Simulation) -> float:
    """Volume of the water that particles carry outside the cells [m^2], with a free surface."""
    return float(simulation.mesh.surface.spray.sum())
