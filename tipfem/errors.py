"""Errors of a run; those of arguments are ValueErrors."""

from __future__ import annotations


class SimulationError(RuntimeError):
    """A run cannot go on; what was computed up to there is kept and written."""


class StepRefused(Exception):
    """A step was not good enough; a shorter one may be."""


class CheckpointError(RuntimeError):
    """A checkpoint cannot be read, or is not one of this run."""
