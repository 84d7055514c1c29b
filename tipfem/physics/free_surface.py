"""FreeSurface: where fluids end at empty space, in the equations of a step."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from tipfem.backend.launch import launch
from tipfem.case.case import Case
from tipfem.case.particles import Particles
from tipfem.fem import schur
from tipfem.linalg.sparsity import Csr
from tipfem.mesh.mesh import parabola, volume_gradient
from tipfem.physics.carried import Carried
from tipfem.physics.physics import Physics, StepStart
from tipfem.physics.term import Equations, Term
from tipfem.physics.walls.step import WallsInStep
from tipfem.typing import Array


class FreeSurfaceTerm(Term):
    """Pressure is zero there, and particles in no cell fly freely."""

    def __init__(self, walls: WallsInStep) -> None:
        self._walls = walls

    def begin(self, equations: Equations, first_node: int) -> None:
        """See `Term.begin`."""
        self._equations = equations

    def held(self, displacement: Array, pressure: Array) -> None:
        """See `Term.held`."""
        surface = self._equations.mesh.surface
        displacement |= surface.loose
        pressure |= surface.pinned

    def prescribe(self, displacement: Array, pressure: Array) -> tuple[Array, Array]:
        """See `Term.prescribe`."""
        e = self._equations
        flight = parabola(e.particles.velocity, e.force, e.scheme.dt)
        return e.mesh.surface.constrain(displacement, pressure, flight)

    def finish(self, displacement: Array, particles: Particles) -> Particles:
        """See `Term.finish`: particles in no cell may have landed."""
        e = self._equations
        return e.mesh.surface.landed(e.particles, particles, e.force, e.scheme.dt)

    def settle(self, x: Any, forces: Callable[[Any, Array], Array]) -> None:
        """See `Term.settle`: what flies freely has the acceleration of gravity, whatever the time integration."""
        e, loose = self._equations, self._equations.mesh.surface.loose
        if loose.any():
            e.relative[loose] = -e.scheme.cm * e.values(x)[: len(loose), :-1][loose]

    def schur_complement(self, laplacian: Csr) -> Csr:
        """See `Term.schur_complement`: the particles on the surface change the volume of the fluid."""
        e, walls, d = self._equations, self._walls, self._equations.dimension
        index = np.flatnonzero(e.mesh.surface.front & ~walls.fixed)
        if not len(index):
            return laplacian
        near = np.zeros(len(e.particles), dtype=bool)
        near[index] = True
        gradient = volume_gradient(e.mesh, near)
        if len(walls.sliding):
            projected = np.einsum("kij,kj->ki", walls.columns.reshape(-1, d, d), gradient[walls.sliding])
            gradient[walls.sliding] = projected
        launch(
            schur.add_grounds,
            e.buffers.upload("surface", index.astype(np.int32)),
            e.buffers.upload("surface.gradient", gradient[index]),
            e.scale,
            laplacian.row_offsets,
            laplacian.values,
            schur.SCHUR_SCALE,
            len(index),
            d,
            work=(len(index), schur.GROUND),
        )
        return laplacian


class FreeSurface(Physics[Carried | None]):
    """See the module; the surface itself belongs to the mesh."""

    name = "free_surface"
    columns = ("lowest_pressure", "highest_pressure")

    @classmethod
    def of(cls, case: Case) -> FreeSurface | None:
        """See `Physics.of`."""
        return cls() if case.free_surface else None

    def terms(self, part: Carried | None, step: StepStart) -> tuple[FreeSurfaceTerm, ...]:
        """See `Physics.terms`."""
        return (FreeSurfaceTerm(step.walls),) if step.mesh.surface.exists else ()

    def row(self, part: Carried | None, particles: Particles) -> dict[str, float]:
        """See `Physics.row`: the extremes of the pressure over that of the empty space [Pa]."""
        return {"lowest_pressure": float(particles.pressure.min()), "highest_pressure": float(particles.pressure.max())}
