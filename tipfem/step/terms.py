"""The terms of a step: what acts in it beside the bulk flow, by the case and the state."""

from __future__ import annotations

import numpy as np

from tipfem.case.case import Case
from tipfem.fem.time_integration import TimeScheme
from tipfem.mesh.cut import cut_along_interfaces
from tipfem.physics.bodies.motion import BodyMotion
from tipfem.physics.bodies.term import FloatingBodies, MovedBodies
from tipfem.physics.free_surface import FreeSurface
from tipfem.physics.side_pressures.term import SidePressures
from tipfem.physics.sliding_liquids.term import SlidingLiquids
from tipfem.physics.term import Term
from tipfem.physics.walls.step import Walls
from tipfem.physics.walls.term import WallTerm
from tipfem.state import State


def terms_of(case: Case, state: State, walls: Walls, scheme: TimeScheme) -> list[Term]:
    """The terms of a step, in the order in which they prescribe displacements and pressures.

    Args:
        case: of the simulation.
        state: at the start of the step.
        walls: in the step.
        scheme: time integration, with the step's length.

    Raises:
        ValueError: a function of time of the case returns an invalid value.
    """
    particles, mesh = state.particles, state.mesh
    terms: list[Term] = [WallTerm(walls)]
    if state.bodies is not None:
        motion = BodyMotion(scheme, case.bodies, state.bodies, particles, state.time)
        floats = motion.floating.any()
        terms.append(FloatingBodies(motion, mesh.surface.pinned) if floats else MovedBodies(motion))
    if mesh.surface.exists:
        terms.append(FreeSurface(walls))
    if case.two_sided:
        jump = state.pressure_jump
        jump = np.zeros((len(case.fluids), len(particles))) if jump is None else jump
        cut = cut_along_interfaces(mesh, state.material.density)
        terms.append(SidePressures(cut, jump, walls))
        if state.slip is not None:
            terms.append(SlidingLiquids(state.slip, cut))
    return terms
