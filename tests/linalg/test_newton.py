"""Newton's method, without the flow."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tipfem.linalg import newton as newton_module
from tipfem.linalg.fgmres import KrylovResult
from tipfem.linalg.newton import newton


class Curves:
    """x^2 + y^2 = 4, x y = 1; ``error`` is what the linear solver leaves, as a part of its tolerance."""

    def __init__(self, *, error=0.0, norms=None):
        self.error, self.norms = error, norms
        self.seen, self.tolerances, self.halved = [], [], 0
        self.rng = np.random.default_rng(0)

    def residual(self, x):
        self.f = np.array([x @ x - 4.0, x[0] * x[1] - 1.0])
        self.jacobian = np.array([2 * x, [x[1], x[0]]])
        norm = float(np.linalg.norm(self.f)) if self.norms is None else self.norms[len(self.seen)]
        self.seen.append(norm)
        return norm

    def correct(self, x, tolerance):
        self.tolerances.append(tolerance)
        left = self.rng.standard_normal(2)
        left *= self.error * tolerance * np.linalg.norm(self.f) / np.linalg.norm(left)
        x -= np.linalg.solve(self.jacobian, self.f + left)
        return KrylovResult(3, tolerance, True)

    def halve(self, x):
        self.halved += 1


def test_newton_converges_quadratically_with_exact_solves():
    problem = Curves()
    x = np.array([2.5, 0.3])
    result = newton(problem, x, tolerance=1e-13, max_iterations=20)
    assert result.converged
    assert result.solution is x
    root = np.array([math.sqrt(2 + math.sqrt(3)), math.sqrt(2 - math.sqrt(3))])
    np.testing.assert_allclose(x, root, rtol=1e-13)
    assert result.norm == problem.seen[-1] <= 1e-13
    assert result.iterations == len(problem.tolerances) == len(problem.seen) - 1
    assert result.krylov_iterations == 3 * result.iterations
    e = np.array(problem.seen)
    e = e[e > 1e-12]
    assert len(e) >= 3
    assert (e[1:] < 2 * e[:-1] ** 2).all()


def test_newton_forcing_follows_eisenstat_and_walker():
    """eta_k = (|F_k| / |F_k-1|)^2 / 2, at most the first one, and no tighter than the tolerance is worth."""
    problem = Curves(error=1.0)
    tolerance = 1e-11
    result = newton(problem, np.array([2.5, 0.3]), tolerance=tolerance, max_iterations=20)
    assert result.converged
    norms, eta = np.array(problem.seen), np.array(problem.tolerances)
    first = newton_module.FIRST_FORCING
    assert eta[0] == first
    for k in range(1, len(eta)):
        wanted = min(first, 0.5 * (norms[k] / norms[k - 1]) ** 2)
        np.testing.assert_allclose(eta[k], max(wanted, 0.4 * tolerance / norms[k], 1e-10), rtol=1e-12)
    assert eta.min() < 1e-5
    # inexact solves cost at most one iteration more than exact ones
    exact = newton(Curves(), np.array([2.5, 0.3]), tolerance=tolerance, max_iterations=20)
    assert result.iterations <= exact.iterations + 1


def test_newton_stops_at_once_where_there_is_nothing_to_do():
    problem = Curves(norms=[1e-9])
    x = np.array([5.0, 5.0])
    result = newton(problem, x, tolerance=1e-8, max_iterations=5)
    assert (result.converged, result.iterations, result.krylov_iterations, result.norm) == (True, 0, 0, 1e-9)
    assert (x == 5.0).all()


def test_newton_goes_on_while_the_problem_is_unfinished():
    """Within the tolerance, too, with a loose linear one; no longer than allowed."""
    problem = Curves(norms=[1.0, 1e-9, 1e-9, 1e-9])
    given = np.array([2.5, 0.3])
    result = newton(problem, given, tolerance=1e-8, max_iterations=9, unfinished=lambda: len(problem.seen) < 4)
    assert (result.converged, result.iterations) == (True, 3)
    assert problem.tolerances[1:] == [newton_module.LOOSE] * 2
    assert (
        newton(Curves(norms=[1e-9] * 3), given, tolerance=1e-8, max_iterations=2, unfinished=lambda: True).iterations
        == 2
    )


@pytest.mark.parametrize(
    ("norms", "iterations"),
    [
        ([1.0, 0.9, 0.8, 0.7, 0.6], 4),
        ([1.0, 0.5, math.nan], 2),
        ([math.nan], 0),
        ([1.0, 0.1, 1.9, 2.5, 2.4, 2.3, 2.2, 2.1], 3),
        ([1.0, 19.0, 18.0, 17.0, 16.0], 4),
        ([math.inf], 0),
    ],
    ids=["slow", "nan", "nan at once", "diverging", "rising", "inf at once"],
)
def test_newton_reports_that_it_did_not_converge(norms, iterations):
    result = newton(Curves(norms=norms), np.array([2.5, 0.3]), tolerance=1e-8, max_iterations=4)
    assert not result.converged
    assert result.iterations == iterations
    np.testing.assert_equal(result.norm, norms[-1])


def test_newton_halves_a_correction_that_makes_things_far_worse():
    """As where a pressure jumps at an impact; no other one, and not for ever."""
    problem = Curves(norms=[1.0, 0.1, 1.9, 2.1, 1.9, 1e-9])
    result = newton(problem, np.array([2.5, 0.3]), tolerance=1e-8, max_iterations=4)
    assert (result.converged, result.iterations, problem.halved) == (True, 4, 1)


class Overshooting(Curves):
    """An arc tangent of one unknown: corrections from afar lead farther away."""

    def residual(self, x):
        self.f, self.slope = math.atan(x[0]), 1 / (1 + x[0] ** 2)
        self.seen.append(abs(self.f))
        return abs(self.f)

    def correct(self, x, tolerance):
        self.step = -self.f / self.slope
        x += self.step
        return KrylovResult(1, tolerance, True)

    def halve(self, x):
        self.step *= 0.5
        x -= self.step


def test_a_search_halves_corrections_that_leave_the_residual_as_it_was():
    astray = newton(Overshooting(), np.array([3.0]), tolerance=1e-12, max_iterations=4)
    found = newton(Overshooting(), np.array([3.0]), tolerance=1e-12, max_iterations=12, search=True)
    assert not astray.converged
    assert found.converged
    assert found.solution[0] == pytest.approx(0.0, abs=1e-12)
