"""The problem of a step with the terms that a state would have, for tests of the equations."""

from __future__ import annotations

from tipfem.case.boundary.boundary import Boundary
from tipfem.mesh.cut import cut_along_interfaces
from tipfem.physics.free_surface import FreeSurfaceTerm
from tipfem.physics.side_pressures.term import SidePressuresTerm
from tipfem.physics.sliding_liquids.term import SlidingLiquidsTerm
from tipfem.physics.surface_tension.term import SurfaceTensionTerm
from tipfem.physics.walls.step import WallsInStep
from tipfem.physics.walls.term import WallTerm
from tipfem.step.problem import FlowProblem


def flow_problem(
    mesh,
    particles,
    properties,
    scheme,
    force,
    stabilisation,
    workspace,
    walls=None,
    *,
    jacobian="rows",
    pressure_jump=None,
    slip=None,
    tension=None,
    holding=None,
    exact=True,
):
    """A `FlowProblem`; walls are fixed and no-slip by default, and pressures continuous without a ``pressure_jump``."""
    walls = walls or WallsInStep(Boundary(particles, (), None), mesh, particles, scheme)
    terms = [WallTerm(walls)]
    if mesh.surface.exists:
        terms.append(FreeSurfaceTerm(walls))
    if pressure_jump is not None:
        cut = cut_along_interfaces(mesh, properties.density)
        terms.append(SidePressuresTerm(cut, pressure_jump, walls))
    if slip is not None:
        terms.append(SlidingLiquidsTerm(slip, cut))
    if tension is not None:
        terms.append(SurfaceTensionTerm(tension, None, holding, 0.1 * particles.spacing))
    return FlowProblem(
        mesh,
        particles,
        properties,
        scheme,
        force,
        stabilisation,
        workspace,
        terms,
        stores_rows=jacobian == "rows",
        exact=exact,
    )
