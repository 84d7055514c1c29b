"""SlidingLiquids: liquids that slide along each other, in steps and through remeshing."""

from __future__ import annotations

import dataclasses

import numpy as np

from tipfem.case.case import Case
from tipfem.case.fluid import ranks, typical_viscosity
from tipfem.case.particles import Particles
from tipfem.case.rheology import Law
from tipfem.physics.carried import Remap
from tipfem.physics.physics import Physics, StepStart
from tipfem.physics.sliding_liquids.slip import HeldSheets, InterfaceSlip, find_slip, may_slide
from tipfem.physics.sliding_liquids.term import SlidingLiquidsTerm
from tipfem.typing import Array


class SlidingLiquids(Physics[InterfaceSlip | None]):
    """See the module; where they slide is found anew on each mesh. ``held``: what holds them beside gravity."""

    name = "sliding_liquids"

    def __init__(self, density: Array, gravity: Array, held: HeldSheets | None = None) -> None:
        self._density, self._gravity, self._held = density, gravity, held

    @classmethod
    def of(cls, case: Case) -> SlidingLiquids | None:
        """See `Physics.of`."""
        if any(isinstance(f.viscosity, Law) for f in case.fluids):
            return None
        density, held = np.array([f.density for f in case.fluids], dtype=float), None
        if case.surface_tension:
            viscosity = np.array([typical_viscosity(f) for f in case.fluids])
            held = HeldSheets(ranks(case.fluids), case.surface_tension.sigma, viscosity)
        slide = may_slide(density.tolist()) or (held is not None and held.similar(density))
        there = case.two_sided and case.numerics.sliding and slide
        return cls(density, case.potential_gravity, held) if there else None

    def terms(self, part: InterfaceSlip | None, step: StepStart) -> tuple[SlidingLiquidsTerm, ...]:
        """See `Physics.terms`."""
        return () if part is None else (SlidingLiquidsTerm(part, step.cut, follows_rate=self._held is not None),)

    def remeshed(
        self, part: InterfaceSlip | None, particles: Particles, remap: Remap
    ) -> tuple[InterfaceSlip | None, Particles]:
        """See `Physics.remeshed`."""
        held = self._held
        if held is not None and part is not None:
            held = held._replace(rate=part.rate)
        found = find_slip(remap.mesh, particles, self._density, self._gravity, held)
        if found is not None and part is not None:
            found = dataclasses.replace(found, squares=part.squares)
        return found, particles
