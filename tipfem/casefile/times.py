"""The lengths of time of a case file, judged by each other and by the flow."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from tipfem.case.largest_step import step_limit, too_long
from tipfem.casefile.source import Path


def check_times(sections: Mapping[str, Any], report: Callable[[Path, str], None]) -> None:
    """Report faults of the largest time step and the interval of outputs, as far as checked sections have them."""
    time, output = sections.get("time"), sections.get("output")
    tank, gravity = sections.get("tank"), sections.get("gravity")
    if tank is not None and gravity and time is not None and time.largest_step is not None:
        longest = step_limit(math.sqrt(math.hypot(*gravity) / tank.spacing))
        if time.largest_step > longest:
            report(("time", "largest_step"), too_long(time.largest_step, longest))
            return
    if time is None or output is None or output.interval is None:
        return
    if time.largest_step is not None and output.interval < 0.1 * time.largest_step:
        report(
            ("output", "interval"),
            f"is {output.interval:g} s, far below time.largest_step, {time.largest_step:g} s; it must be "
            f"{0.1 * time.largest_step:g} s or more, for every output shortens steps to end at it",
        )
