"""Newton's method on any residual whose linearisation can be solved approximately."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

from tipfem.errors import StepRefused


class Solve(Protocol):
    """A linear problem that is solved, or will be by the next residual."""

    @property
    def iterations(self) -> int:
        """Number of iterations, known after the next residual."""


class Problem(Protocol):
    """The interface of `newton` to a problem, which chooses the type of its vectors."""

    def residual(self, x: Any) -> float:
        """Evaluate the residual at ``x``, linearise there, and return the residual's norm."""

    def correct(self, x: Any, tolerance: float) -> Solve:
        """Solve the linearised problem to a relative ``tolerance`` and add the correction to ``x``."""

    def halve(self, x: Any) -> None:
        """Take half of the last correction, or of what is left of it, back from ``x``."""


@dataclass(frozen=True)
class NewtonResult:
    """Result of Newton's method."""

    solution: Any  # the last iterate
    iterations: int  # linear problems solved
    krylov_iterations: int  # their total
    norm: float  # of the residual at the solution
    converged: bool  # whether the norm is within the tolerance

    def require(self) -> None:
        """Raises StepRefused unless Newton's method has converged."""
        if not self.converged:
            text = f"Newton's method did not converge in {self.iterations} iterations"
            raise StepRefused(f"{text} (residual {self.norm:.2e} h)")


def newton(
    problem: Problem,
    x: Any,
    *,
    tolerance: float,
    max_iterations: int,
    noise: float = math.inf,
    search: bool = False,
    unfinished: Callable[[], bool] = lambda: False,
) -> NewtonResult:
    """Inexact Newton iteration from ``x``, overwritten, until the residual's norm is within ``tolerance``.

    The linear tolerance follows Eisenstat & Walker (1996), choice 2 with gamma = 0.5, alpha = 2: no system is solved
    more accurately than the quadratic convergence of Newton's method or the tolerance requires. A first residual above
    ``noise`` is corrected once even if it is within the tolerance: otherwise a flow that is coming to rest would drift
    on at the speed that the tolerance allows. A correction that leaves far more than the least residual so far is
    halved, up to `HALVINGS` times; with ``search`` one that leaves nearly all of the last, too. While the problem is
    ``unfinished`` it is corrected even within the tolerance.
    """
    forcing = FIRST_FORCING
    norm = least = problem.residual(x)
    iterations = krylov_iterations = 0
    within = norm <= tolerance
    while (norm > tolerance or (iterations == 0 and norm > noise) or unfinished()) and iterations < max_iterations:
        if not math.isfinite(norm):
            break
        enough = POLISH if within else 0.4 * tolerance / norm if norm > tolerance else LOOSE
        result = problem.correct(x, max(forcing, enough, SMALLEST_FORCING))
        iterations += 1
        previous, norm = norm, problem.residual(x)
        krylov_iterations += result.iterations
        halvings = 0
        most = max(ENOUGH * previous, tolerance) if search else DIVERGES * least
        while norm > most and math.isfinite(norm) and halvings < HALVINGS:
            problem.halve(x)
            norm, halvings = problem.residual(x), halvings + 1
        if norm > DIVERGES * least:
            break
        least = min(least, norm)
        forcing = min(FIRST_FORCING, 0.5 * (norm / previous) ** 2)
    return NewtonResult(x, iterations, krylov_iterations, norm, norm <= tolerance)


# In steps of half a spacing, the nonlinear part of the residual after the first correction is a hundredth or more at
# the particles where it is largest.
FIRST_FORCING = 1e-2
POLISH = 1e-2  # linear tolerance where the residual is within the tolerance already
LOOSE = 0.05  # the same, where only the problem is unfinished: no new Jacobian for that
SMALLEST_FORCING = 1e-10
DIVERGES = 20  # residual over the smallest one so far, from which no solve has come back
HALVINGS, ENOUGH = 4, 0.95  # of corrections, and in a search the part of a residual above which they are halved
