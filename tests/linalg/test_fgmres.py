"""Flexible GMRES on device vectors."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from tipfem.backend.arrays import Buffers, download
from tipfem.backend.launch import FEW_PARTS, PARTS_OF_GPU, launch
from tipfem.linalg import vector_kernels
from tipfem.linalg.fgmres import KrylovResult, fgmres, largest
from tipfem.linalg.queued_fgmres import GOES_ON, HEAD, Pace, QueuedSolve, orthogonalise_queued


def overwrite(array, values):
    """Set the first entries of a device array, leave the others."""
    whole = array.to_numpy()
    whole[: len(values)] = values
    array.from_numpy(whole)


def on_device(function, size):
    """An operator on device vectors from a function on NumPy vectors."""
    return lambda v, out: overwrite(out, function(download(v, size)))


def solve(matrix, b, *, preconditioner=None, tolerance=1e-12, max_iterations=60, buffers=None):
    """The solution and the result of fgmres, which starts on a solution vector full of rubbish."""
    n = len(b)
    buffers = buffers or Buffers()
    operator = matrix if callable(matrix) else lambda v: matrix @ v
    solution = buffers.upload("test.x", np.full(n, 1e30))
    result = fgmres(
        on_device(operator, n),
        on_device(preconditioner or (lambda v: v), n),
        buffers.upload("test.b", b),
        solution,
        n,
        tolerance=tolerance,
        max_iterations=max_iterations,
        buffers=buffers,
    )
    return download(solution, n), result


def system(n, seed=0, spread=0.6):
    """A well-conditioned matrix without symmetry, and a right-hand side."""
    rng = np.random.default_rng(seed)
    matrix = np.eye(n) * 2 + spread * rng.standard_normal((n, n)) / math.sqrt(n) + np.triu(np.ones((n, n)), 1) / n
    return matrix, rng.standard_normal(n)


@pytest.mark.parametrize("n", [1, 2, 9, 40, 333])
def test_fgmres_equals_a_direct_solve(n):
    matrix, b = system(n, seed=n)
    x, result = solve(matrix, b)
    assert result.converged
    assert result.iterations <= min(n, 40)
    np.testing.assert_allclose(x, np.linalg.solve(matrix, b), atol=1e-10 * abs(b).max())
    residual = np.linalg.norm(matrix @ x - b) / np.linalg.norm(b)
    assert residual <= 2e-12
    assert abs(residual - result.relative_residual) < 1e-14


def test_fgmres_reports_the_residual_it_leaves():
    matrix, b = system(80, spread=0.9)
    seen = []
    for tolerance in (1e-1, 1e-3, 1e-6):
        x, result = solve(matrix, b, tolerance=tolerance)
        left = np.linalg.norm(matrix @ x - b) / np.linalg.norm(b)
        assert result.converged
        assert left <= tolerance
        np.testing.assert_allclose(result.relative_residual, left, rtol=1e-3)
        seen.append(result.iterations)
    assert seen == sorted(set(seen))


@pytest.mark.parametrize("n", [7, 8, 9, 16, 17, 26])
def test_fgmres_needs_and_keeps_the_whole_basis(n):
    """A cyclic shift: the residual stays 1 until the n-th vector solves it all; bases pass 8 and 16 vectors."""
    shift = np.roll(np.eye(n), 1, axis=0)
    b = np.zeros(n)
    b[0] = 3.0
    x, result = solve(shift, b, max_iterations=n)
    assert result == KrylovResult(n, result.relative_residual, True)
    np.testing.assert_allclose(x, np.roll(b, -1), atol=1e-13)
    _, result = solve(shift, b, max_iterations=n - 1)
    assert not result.converged
    assert result.iterations == n - 1
    np.testing.assert_allclose(result.relative_residual, 1.0, rtol=1e-12)


def test_fgmres_basis_stays_orthogonal_where_one_projection_is_not_enough():
    """Condition number 1e10: 30 vectors, every Krylov vector nearly in the span of those before."""
    n = 30
    rng = np.random.default_rng(4)
    q, _ = np.linalg.qr(rng.standard_normal((n, n)))
    matrix = q @ np.diag(np.logspace(0, -10, n)) @ q.T
    buffers = Buffers()
    _, result = solve(matrix, rng.standard_normal(n), tolerance=1e-15, max_iterations=20, buffers=buffers)
    vectors = download(buffers.get("krylov.vectors", 0), 2 * (result.iterations + 1) * n).reshape(-1, n)
    basis = vectors[::2]
    assert len(basis) > 16
    np.testing.assert_allclose(basis @ basis.T, np.eye(len(basis)), atol=5e-11)


def test_fgmres_gives_up_at_the_limit():
    matrix, b = system(60, spread=1.2)
    x, result = solve(matrix, b, tolerance=1e-12, max_iterations=5)
    assert (result.iterations, result.converged) == (5, False)
    left = np.linalg.norm(matrix @ x - b) / np.linalg.norm(b)
    np.testing.assert_allclose(result.relative_residual, left, rtol=1e-10)
    # the best of the Krylov space: least squares over K_5
    krylov = [b]
    for _ in range(4):
        krylov.append(matrix @ krylov[-1])
    basis, _ = np.linalg.qr(np.array(krylov).T)
    best = np.linalg.norm(matrix @ basis @ np.linalg.lstsq(matrix @ basis, b, rcond=None)[0] - b)
    np.testing.assert_allclose(left, best / np.linalg.norm(b), rtol=1e-8)


def test_fgmres_with_a_zero_rhs():
    matrix, _ = system(12)
    x, result = solve(matrix, np.zeros(12))
    assert result == KrylovResult(0, 0.0, True)
    assert (x == 0).all()


def test_fgmres_on_singular_systems():
    """The zero matrix is reported, not raised; a Neumann Laplacian with a balanced right-hand side is solved."""
    x, result = solve(np.zeros((5, 5)), np.ones(5))
    assert not result.converged
    assert (x == 0).all()
    n = 20
    chain = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    chain[0, 0] = chain[-1, -1] = 1.0
    b = np.random.default_rng(0).standard_normal(n)
    b -= b.mean()
    x, result = solve(chain, b, tolerance=1e-10)
    assert result.converged
    np.testing.assert_allclose(chain @ x, b, atol=1e-8)


def test_fgmres_is_flexible_and_uses_its_preconditioner():
    matrix, b = system(50, spread=1.0)
    matrix = np.diag(np.logspace(0, 4, 50)) @ matrix
    inverse = np.linalg.inv(matrix)
    x, result = solve(matrix, b, preconditioner=lambda v: inverse @ v)
    assert result.iterations == 1
    np.testing.assert_allclose(x, inverse @ b, atol=1e-11)
    diagonal = np.diag(matrix)
    calls = itertools.count(1)
    x, result = solve(matrix, b, preconditioner=lambda v: v / diagonal * (1 + 0.5 * math.sin(7 * next(calls))))
    assert result.converged
    np.testing.assert_allclose(matrix @ x, b, atol=1e-9)
    _, plain = solve(matrix, b, max_iterations=result.iterations)
    assert not plain.converged


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_fgmres_raises_on_what_is_not_finite(bad):
    matrix, b = system(20)
    spoiled = b.copy()
    spoiled[13] = bad
    with pytest.raises(FloatingPointError):
        solve(matrix, spoiled)
    calls = itertools.count(1)
    late = np.where(np.arange(20) == 19, bad, 0.0)
    with pytest.raises(FloatingPointError), np.errstate(invalid="ignore"):
        solve(lambda v: matrix @ v + (late if next(calls) == 4 else 0.0), b)
    with pytest.raises(FloatingPointError), np.errstate(invalid="ignore"):
        solve(matrix, b, preconditioner=lambda v: v + late)


def test_fgmres_does_not_look_beyond_the_live_entries():
    """Buffers that held a larger system, spoiled with NaN, give the same digits as fresh ones."""
    matrix, b = system(37)
    fresh, _ = solve(matrix, b)
    buffers = Buffers()
    solve(*system(100), buffers=buffers)
    for name in ("test.x", "test.b", "krylov.vectors", "krylov.v", "krylov.z", "krylov.w"):
        overwrite(buffers.get(name, 100), np.full(100, np.nan))
    again, _ = solve(matrix, b, buffers=buffers)
    np.testing.assert_array_equal(again, fresh)


@pytest.mark.parametrize("n", [1, 31, 32, 33, 1000])
def test_largest(n):
    buffers = Buffers()
    values = np.random.default_rng(n).uniform(-1, 1, n)
    values[n // 2] = -3.5
    x = buffers.upload("x", np.concatenate([values, [99.0]]))
    assert largest(x, n, buffers) == 3.5
    for place in (0, n - 1):
        spoiled = values.copy()
        spoiled[place] = np.nan
        assert math.isnan(largest(buffers.upload("x", spoiled), n, buffers))


@pytest.mark.slow(but=("7",))
@pytest.mark.parametrize("n", [7, 700, 40_000])
def test_kernels_of_a_gpu_equal_numpy(n):
    """Those whose threads take entries side by side, in as many parts as there, and those whose sums are folded."""
    k, parts, buffers, rng = 2, PARTS_OF_GPU, Buffers(), np.random.default_rng(n)
    basis = np.linalg.qr(rng.standard_normal((n, 3)))[0].T
    w, z = rng.standard_normal(n), rng.standard_normal((3, n))
    krylov = buffers.upload("krylov", np.concatenate([*np.stack([basis, z], axis=1).reshape(6, n), w]))
    partial, results = buffers.get("partial", (parts + FEW_PARTS) * 4), buffers.get("results", k + 5)
    vector_kernels.orthogonalise_on_gpu.taichi(krylov, partial, results, k, n, 0.0, parts)
    dots = basis @ w
    before, after = w @ w, w @ w - dots @ dots
    wanted = [*dots, 1 / math.sqrt(after), before, after]
    np.testing.assert_allclose(download(results, k + 5)[1:], wanted, rtol=1e-9)
    np.testing.assert_allclose(download(krylov, 7 * n)[6 * n :], (w - dots @ basis) / math.sqrt(after), atol=1e-9)
    x, weights = buffers.get("x", n), np.array([1.0, -2.0, 3.0])
    vector_kernels.combine_on_gpu.taichi(krylov, weights, x, 3, n)
    np.testing.assert_allclose(download(x, n), weights @ z, atol=1e-12 * np.abs(z).max())
    as_on_gpu = n, parts, 1, False
    vector_kernels.largest.taichi(x, partial, results, *as_on_gpu)
    assert download(results, 2).tolist() == [abs(download(x, n)).max(), 0]
    vector_kernels.normalise.taichi(x, krylov, partial, results, *as_on_gpu)
    length = np.linalg.norm(download(x, n))
    assert download(results, 1)[0] == pytest.approx(length, rel=1e-12)
    np.testing.assert_allclose(download(krylov, n), download(x, n) / length, rtol=1e-12)


def queued(matrix, b, *, tolerance=1e-10, most=60, reduction=0.3):
    """A `QueuedSolve` by kernels of a GPU: the result, the solution, the iterations queued, and the arrays."""
    n, buffers, numbers = len(b), Buffers(), []
    operator, (solution, v, w) = on_device(lambda v: matrix @ v, n), (buffers.get(name, n) for name in "xvw")

    def iteration(k, krylov, partial, state):
        numbers.append(k)
        if download(state, HEAD)[GOES_ON]:
            launch(vector_kernels.copy_entries, krylov, 2 * k * n, v, n, work=(n, 1.0))
            operator(v, w)
            launch(vector_kernels.store_direction, v, w, krylov, k, n, work=(n, 1.0))
            launch(orthogonalise_queued, krylov, partial, state, k, n, 0)

    options = {"tolerance": tolerance, "most": most, "buffers": buffers, "pace": Pace(reduction)}
    solve = QueuedSolve(iteration, lambda: None, buffers.upload("b", b), solution, n, **options)
    return solve.done(), download(solution, n), numbers, buffers


@pytest.mark.parametrize("n", [1, 2, 9, 40, 333])
def test_a_queued_solve_equals_the_other(n):
    """Also where the residual is 1 until the last vector, and where there are too few vectors."""
    b, shift = np.random.default_rng(n).standard_normal(n), np.roll(np.eye(n), 1, axis=0)
    if n < 60:
        np.testing.assert_allclose(queued(shift, np.eye(n)[0])[1], np.eye(n)[-1], atol=1e-13)
    matrix, _ = system(n, n)
    for most in (60, 3):
        x, wanted = solve(matrix, b, tolerance=1e-10, max_iterations=most)
        result, found, numbers, _ = queued(matrix, b, tolerance=1e-10, most=most)
        assert (result.iterations, result.converged) == (wanted.iterations, wanted.converged)
        np.testing.assert_allclose(result.relative_residual, wanted.relative_residual, rtol=1e-6, atol=1e-14)
        np.testing.assert_allclose(found, x, atol=1e-9 * abs(b).max())
        assert sorted(set(numbers)) == list(range(max(numbers) + 1))  # some are queued again after a second pass
        assert result.iterations <= max(numbers) + 1 <= most


@pytest.mark.parametrize("size", [33, 30])
def test_a_queued_solve_does_not_depend_on_how_many_iterations_are_queued(size):
    """The larger one well conditioned, the other with second passes of Gram-Schmidt's method."""
    rng = np.random.default_rng(4)
    q, _ = np.linalg.qr(rng.standard_normal((30, 30)))
    matrix = q @ np.diag(np.logspace(0, -10, 30)) @ q.T if size == 30 else system(33)[0]
    b = rng.standard_normal(size)
    found = [queued(matrix, b, tolerance=1e-12, most=20, reduction=reduction) for reduction in (1e-9, 0.3, 0.99)]
    for result, x, _, buffers in found:
        assert result == found[0][0]
        np.testing.assert_array_equal(x, found[0][1])
        made = result.iterations
        basis = download(buffers.get("krylov.vectors", 0), 2 * made * size).reshape(-1, size)[::2]
        np.testing.assert_allclose(basis @ basis.T, np.eye(made), atol=5e-11)
    assert len({len(numbers) for _, _, numbers, _ in found}) > 1


def test_a_queued_solve_of_what_is_zero_or_not_finite():
    matrix, b = system(12)
    result, x, *_ = queued(matrix, np.zeros(12))
    assert result == KrylovResult(0, 0.0, True)
    assert (x == 0).all()
    result, x, *_ = queued(np.zeros((12, 12)), b)
    assert result == KrylovResult(0, 1.0, False)
    assert (x == 0).all()
    for bad in (np.nan, np.inf):
        with pytest.raises(FloatingPointError, match="the residual is not finite"):
            queued(matrix, np.where(np.arange(12) == 3, bad, b))
        spoiled = matrix.copy()
        spoiled[3, 5] = bad
        with pytest.raises(FloatingPointError, match="a Krylov vector is not finite"):
            queued(spoiled, b)
