"""The problem of a step with the terms that a state would have, for tests of the equations."""

from __future__ import annotations

from tipfem.case.boundary import Boundary
from tipfem.mesh.cut import cut_along_interfaces
from tipfem.physics.free_surface import FreeSurface
from tipfem.physics.side_pressures.term import SidePressures
from tipfem.physics.sliding_liquids.term import SlidingLiquids
from tipfem.physics.surface_tension.term import SurfaceTension
from tipfem.physics.walls.step import Walls
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
):
    """A `FlowProblem`; walls are fixed and no-slip by default, and pressures continuous without a ``pressure_jump``."""
    walls = walls or Walls(Boundary(particles, (), None), mesh, particles, scheme)
    terms = [WallTerm(walls)]
    if mesh.surface.exists:
        terms.append(FreeSurface(walls))
    if pressure_jump is not None:
        cut = cut_along_interfaces(mesh, properties.density)
        terms.append(SidePressures(cut, pressure_jump, walls))
    if slip is not None:
        terms.append(SlidingLiquids(slip, cut))
    if tension is not None:
        terms.append(SurfaceTension(tension, None, holding, 0.1 * particles.spacing))
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
    )
