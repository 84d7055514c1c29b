"""Beaches of case files."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

from tipfem.case.beaches import Beach
from tipfem.case.case import Case
from tipfem.case.waves import WaveMaker
from tipfem.casefile.forms import Model, declares
from tipfem.casefile.lists import Listed

LENGTH = 1.5  # of a beach that returns little, in wave lengths


@declares(Beach)
class BeachTable(Model):
    """Damping of the fluids before a wall, so that waves do not come back."""


class Beaches(Listed):
    """See `Listed`."""

    attribute = "beaches"
    kinds: ClassVar = {"beaches": Beach}
    tables: ClassVar = {"beaches": (BeachTable, "where fluids are damped before a wall")}
    words: ClassVar = {
        "sponge beach damping_zone relaxation_zone damping absorber": "what damps waves is in tables [[beaches]], each "
        "with wall = 'right', say, length and period",
    }

    def of(self, case: Case) -> Sequence[Beach]:
        """See `Listed.of`."""
        return [zone.beach for zone in case.beaches]

    def name(self, key: str, table: Any) -> str:
        """See `Listed.name`."""
        return str(table.wall)

    def hints(self, case: Case) -> list[str]:
        """Lines on beaches where waves are made, and on those that are too short for these."""
        found = []
        for wall in case.walls:
            if not isinstance(maker := wall.motion, WaveMaker):
                continue
            for beach in self.of(case):
                if beach.wall == wall.name:
                    found.append(f"the beach at {beach.wall!r} damps the waves where they are made")
                elif beach.length < LENGTH * maker.length:
                    why = f"a beach should have {LENGTH:g} wave lengths, {LENGTH * maker.length:.3g} m"
                    found.append(f"the beach at {beach.wall!r} is {beach.length:g} m long; {why}")
        return found
