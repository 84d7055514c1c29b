"""Errors of a run; those of arguments are ValueErrors."""

from __future__ import annotations


class SimulationError(RuntimeError):
    """A run cannot continue; all results up to that time are kept and written."""


class StepRefused(Exception):
    """A time step failed or was too inaccurate; a shorter one may succeed."""


class CheckpointError(RuntimeError):
    """A checkpoint cannot be read, or is not one of this run."""


class TriangulationError(RuntimeError):
    """The particles could not be triangulated."""
