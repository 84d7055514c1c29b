"""Walls: the walls of a case in its steps."""

from __future__ import annotations

from tipfem.case.case import Case
from tipfem.physics.physics import Physics, StepStart
from tipfem.physics.walls.layers import Layers
from tipfem.physics.walls.term import WallTerm


class Walls(Physics[Layers | None]):
    """See the module; they carry their boundary layers, which stand at fixed points of the walls."""

    name = "walls"

    @classmethod
    def of(cls, case: Case) -> Walls:
        """See `Physics.of`."""
        return cls()

    def terms(self, part: Layers | None, step: StepStart) -> tuple[WallTerm]:
        """See `Physics.terms`."""
        return (WallTerm(step.walls),)
