"""Newton's method on any residual whose linearisation can be solved approximately."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Protocol

from tipfem.krylov import KrylovResult


class Problem(Protocol):
    """What `newton` asks of a problem. Vectors are the problem's own business."""

    def residual(self, x: Any) -> float:
        """Evaluate the residual at ``x``, linearise there, and return the residual's norm."""

    def correct(self, x: Any, tolerance: float) -> KrylovResult:
        """Solve the linearised problem to a relative ``tolerance`` and add the correction to ``x``."""


@dataclass(frozen=True)
class NewtonResult:
    """How Newton's method went.

    Attributes:
        solution: the last iterate.
        iterations: linear problems solved.
        krylov_iterations: of all of them together.
        norm: of the residual at the solution.
        converged: whether the norm is within the tolerance.
    """

    solution: Any
    iterations: int
    krylov_iterations: int
    norm: float
    converged: bool


def newton(problem: Problem, x: Any, *, tolerance: float, max_iterations: int) -> NewtonResult:
    """Inexact Newton iteration from ``x`` until the residual's norm is within ``tolerance``.

    The linear tolerance follows Eisenstat & Walker (1996), choice 2 with gamma = 0.5, alpha = 2:
    no system is solved more accurately than the quadratic convergence of Newton's method can use,
    nor than the tolerance asks for.

    Args:
        problem: residual and correction.
        x: first iterate, overwritten.
        tolerance: of the residual's norm, absolute.
        max_iterations: when to give up.
    """
    forcing = FIRST_FORCING
    norm = problem.residual(x)
    iterations = krylov_iterations = 0
    while norm > tolerance and iterations < max_iterations and math.isfinite(norm):
        enough = 0.3 * tolerance / norm
        result = problem.correct(x, max(forcing, enough, SMALLEST_FORCING))
        iterations += 1
        krylov_iterations += result.iterations
        previous, norm = norm, problem.residual(x)
        if norm > 1e3 * previous:
            break
        forcing = min(FIRST_FORCING, 0.5 * (norm / previous) ** 2)
    return NewtonResult(x, iterations, krylov_iterations, norm, norm <= tolerance)


FIRST_FORCING = 1e-3
SMALLEST_FORCING = 1e-10
