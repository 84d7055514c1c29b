"""The largest time step, judged by the time in which gravity moves a particle by a spacing."""

from __future__ import annotations

import math

DEFAULT = 0.1  # of sqrt(h / |b|), the largest time step where none is given
RESOLVED = 0.05  # of sqrt(h / |b|), a time step that resolves the motion by gravity at the scale of a spacing
LONGEST = 10.0  # of sqrt(h / |b|), far beyond what any step reaches: a mistake


def step_limit(frequency: float) -> float:
    """The largest time step that makes sense [s], by the frequency sqrt(|b| / h) [1/s]; infinite without forces."""
    return LONGEST / frequency if frequency > 0 else math.inf


def too_long(step: float, limit: float) -> str:
    """Objection to a largest time step [s] that exceeds `step_limit` [s]."""
    return (
        f"is {step:g} s; it must be at most {limit:.2g} s, {LONGEST:g} sqrt(h / |b|) with the spacing h and the "
        f"acceleration b of gravity. The default is {DEFAULT * limit / LONGEST:.2g} s, {DEFAULT:g} sqrt(h / |b|)"
    )
