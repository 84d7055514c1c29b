"""Observer: what looks at a run as it goes on - progress, a viewer, fields, checkpoints."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from tipfem.step.stepper import Row, Stepper  # which starts Taichi


class Observer:
    """Looks at a run; each method does nothing unless it is overridden."""

    def begin(self, flow: Stepper, until: float) -> None:
        """A run to a time [s] begins."""

    def next_time(self) -> float:
        """The next time that a step is to end at [s]."""
        return math.inf

    def after_step(self, flow: Stepper, row: Row) -> None:
        """A step has been taken; ``row`` is its row of the history."""

    def finish(self, flow: Stepper, until: float) -> None:
        """A run to a time [s] ends, there or before; may be called again, after an error of another observer."""
