"""Probes of the flow by an opening."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from annotated_types import MinLen

from tipfem.case.case import Case
from tipfem.probes.probe import Probe, contents

if TYPE_CHECKING:
    from tipfem.step.stepper import Stepper


@dataclass(frozen=True, kw_only=True)
class OpeningProbe(Probe, kind="opening"):
    """Volume that has entered by an opening since the start [m^2], and discharge [m^2/s], in 2-D.

    Both are less than 0 for what leaves; around an axis they are in m^3 and m^3/s.

    Attributes:
        opening: name of the inlet, outlet or vent.
        fluid: name of the fluid.

    Raises:
        ValueError: see `Probe`; no such opening or fluid.
    """

    opening: Annotated[str, MinLen(1)]
    fluid: str

    def columns(self, case: Case) -> list[tuple[str, str]]:
        """Names and units of the values; raises ValueError if the probe does not fit the case."""
        self._fluid(case, self.fluid)
        names = [opening.name for opening in case.openings]
        if self.opening not in names:
            known = ", ".join(names) or "none"
            raise self.invalid("opening", f"is {self.opening!r}; the openings of the case are {known}")
        volume = f"m{contents(case)}"
        return [("volume", volume), ("discharge", f"{volume}/s")]

    def sample(self, simulation: Stepper) -> list[float]:
        """Volume until now, and the mean discharge in the last step; 0 at the start."""
        from tipfem.physics.openings.passed import Passed  # here, since Taichi comes with it

        case, part = simulation.case, simulation.state.part(Passed)
        assert part is not None
        row = [opening.name for opening in case.openings].index(self.opening)
        column, dt = case.fluid_index(self.fluid), simulation.solved.dt if simulation.solved else 0.0
        return [float(part.total[row, column]), float(part.volume[row, column]) / dt if dt else 0.0]
