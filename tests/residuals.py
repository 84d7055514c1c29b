"""The residual of a step's problem, read from the device."""

from __future__ import annotations

import numpy as np

from tipfem.backend.arrays import download


def residual_vector(problem):
    """The last scaled residual (N, d + 1) [m] of a `FlowProblem`."""
    return download(problem._r, problem.size).astype(np.float64).reshape(problem.nodes, -1)
