"""Observer: what looks at steps as they are taken - history, probes, progress, a viewer, fields, checkpoints."""

from __future__ import annotations

import math
from typing import Any


class Observer:
    """Looks at steps, and at the runs that they are parts of; each method does nothing unless it is overridden.

    ``flow`` is the `tipfem.step.stepper.Stepper` that takes the steps, whose import starts Taichi.
    """

    def begin(self, flow: Any, until: float) -> None:
        """A run to a time [s] begins."""

    def next_time(self) -> float:
        """The next time that a step is to end at [s]."""
        return math.inf

    def before_step(self, flow: Any) -> None:
        """A step is about to be taken."""

    def after_step(self, flow: Any, row: dict[str, float]) -> None:
        """A step has been taken; ``row`` is its row of the history."""

    def finish(self, flow: Any, until: float) -> None:
        """A run to a time [s] ends, there or before; may be called again, after an error of another observer."""
