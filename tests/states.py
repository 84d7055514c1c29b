"""Solved steps without a solver: particles that moved as a test wants them to, for remeshers."""

from __future__ import annotations

import numpy as np

from tipfem.case.boundary.boundary import Boundary
from tipfem.fem.time_integration import GeneralizedAlpha
from tipfem.physics.state import Solved, StepWork
from tipfem.physics.walls.step import WallsInStep


def first_state(remesher, particles, reference=0):
    """The first state of particles between fixed walls."""
    return remesher.start(particles, Boundary(particles, (), None), reference)


def moved_to(state, particles, dt=1e-3):
    """A step from a state, at the end of which are these ``particles``."""
    scheme, nothing = GeneralizedAlpha(0.0, dt), np.zeros_like(particles.position)
    return Solved(
        before=state,
        time=state.time + dt,
        scheme=scheme,
        particles=particles,
        walls=WallsInStep(state.boundary, state.mesh, state.particles, scheme),
        displacement=particles.position - state.particles.position,
        inertia=nothing,
        force=nothing,
        grid_box=state.grid_box,
        growth=np.zeros(len(state.mesh.cells)),
        work=StepWork(*np.zeros(8), np.zeros(particles.dimension)),
        acting=(),
        newton_iterations=0,
        krylov_iterations=0,
        residual=0.0,
    )
