"""LiquidsThatSlide: liquids that slide along each other, in steps and through remeshing."""

from __future__ import annotations

import numpy as np

from tipfem.case.case import Case
from tipfem.case.particles import Particles
from tipfem.physics.carried import Remap
from tipfem.physics.physics import Physics, StepStart
from tipfem.physics.sliding_liquids.slip import InterfaceSlip, find_slip, may_slide
from tipfem.physics.sliding_liquids.term import SlidingLiquids
from tipfem.typing import Array


class LiquidsThatSlide(Physics[InterfaceSlip]):
    """See the module; where they slide is found anew on each mesh.

    Args:
        density: (F,) of the fluids [kg/m^3].
        gravity: (2,) [m/s^2].
    """

    name = "sliding_liquids"

    def __init__(self, density: Array, gravity: Array) -> None:
        self._density, self._gravity = density, gravity

    @classmethod
    def of(cls, case: Case) -> LiquidsThatSlide | None:
        """See `Physics.of`."""
        density = [f.density for f in case.fluids]
        slide = case.two_sided and may_slide(density)
        return cls(np.array(density, dtype=float), case.potential_gravity) if slide else None

    def terms(self, part: InterfaceSlip | None, step: StepStart) -> tuple[SlidingLiquids, ...]:
        """See `Physics.terms`."""
        return () if part is None else (SlidingLiquids(part, step.cut),)

    def remeshed(
        self, part: InterfaceSlip | None, particles: Particles, remap: Remap
    ) -> tuple[InterfaceSlip | None, Particles]:
        """See `Physics.remeshed`."""
        return find_slip(remap.mesh, particles, self._density, self._gravity), particles
