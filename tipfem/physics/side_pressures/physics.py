"""SidePressures: a pressure on each side of interfaces, in steps and through remeshing."""

from __future__ import annotations

import numpy as np

from tipfem.case.case import Case
from tipfem.case.particles import Particles
from tipfem.physics.carried import Remap
from tipfem.physics.physics import Physics, StepStart
from tipfem.physics.side_pressures.carried import PressureJump, of_renumbered, pressures_on_sides
from tipfem.physics.side_pressures.term import SidePressuresTerm
from tipfem.scratch import scratch
from tipfem.typing import Array


class SidePressures(Physics[PressureJump | None]):
    """See the module; it carries a `PressureJump` from the first step on."""

    name = "side_pressures"

    def __init__(self, density: Array) -> None:
        self._density = density

    @classmethod
    def of(cls, case: Case) -> SidePressures | None:
        """See `Physics.of`."""
        return cls(np.array([f.density for f in case.fluids], dtype=float)) if case.two_sided else None

    def terms(self, part: PressureJump | None, step: StepStart) -> tuple[SidePressuresTerm]:
        """See `Physics.terms`."""
        jump = np.zeros((len(self._density), len(step.particles))) if part is None else part.values
        along = next((own.along for own in step.parts.values() if own.along is not None), None)
        return (SidePressuresTerm(step.cut, jump, step.walls, along),)

    def consistent(
        self, part: PressureJump | None, whole: PressureJump | None, half: PressureJump | None
    ) -> PressureJump | None:
        """See `Physics.consistent`: with the heavier fluid's pressure alone, a light one would be thrown off a drop."""
        return part if whole is None or half is None else PressureJump(2 * whole.values - half.values)

    def remeshed(
        self, part: PressureJump | None, particles: Particles, remap: Remap
    ) -> tuple[PressureJump | None, Particles]:
        """See `Physics.remeshed`."""
        if part is None:
            return None, particles
        assert remap.before.components is not None
        numbers, at = (remap.renumbered, remap.relocated), remap.before.components.at_particle
        there = np.greater_equal(at, 0, out=scratch("side_pressures.there", at.shape, bool))
        known = of_renumbered(there, *numbers, "side_pressures.known")
        relative = scratch("side_pressures.relative", particles.acceleration.shape)
        for k, force in enumerate(remap.force.mean(axis=0)):
            np.subtract(force, particles.acceleration[:, k], out=relative[:, k])
        pressure, jump = pressures_on_sides(
            particles.pressure,
            of_renumbered(part.values, *numbers, "side_pressures.jump"),
            known,
            remap.mesh,
            particles.fluid,
            self._density,
            relative,
        )
        return PressureJump(jump), particles.shallow_copy(pressure=pressure)
