"""Krylov and Newton solvers, multigrid, time integration, step control and device buffers, without the simulation."""

from __future__ import annotations

import itertools
import math

import numpy as np
import numpy_twin as twin
import pytest
from scipy import sparse

import tipfem as tp
from tipfem import newton as newton_module
from tipfem.device import Buffers, download
from tipfem.flow import ElementProperties, FlowProblem, Workspace
from tipfem.krylov import KrylovResult, add, fgmres, largest
from tipfem.multigrid import BackgroundMultigrid
from tipfem.newton import newton
from tipfem.time_integration import GeneralizedAlpha, StepControl
from tipfem.triangulation import triangulate

SPECTRAL_RADII = pytest.mark.parametrize("rho_inf", [0.0, 0.5, 1.0])


# --- flexible GMRES ---------------------------------------------------------------------------------


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
        on_device(operator, n), on_device(preconditioner or (lambda v: v), n), buffers.upload("test.b", b), solution, n,
        tolerance=tolerance, max_iterations=max_iterations, buffers=buffers,
    )  # fmt: skip
    return download(solution, n), result


def system(n, seed=0, spread=0.6):
    """A well-conditioned matrix without symmetry, and a right side."""
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
        np.testing.assert_allclose(result.relative_residual, left, rtol=1e-6)
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
    basis = np.array([download(buffers.get(f"krylov.v{k}", n), n) for k in range(result.iterations + 1)])
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


def test_fgmres_with_a_zero_right_side():
    matrix, _ = system(12)
    x, result = solve(matrix, np.zeros(12))
    assert result == KrylovResult(0, 0.0, True)
    assert (x == 0).all()


def test_fgmres_on_singular_systems():
    """The zero matrix is reported, not raised; a Neumann Laplacian with a balanced right side is solved."""
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
    for name in ("test.x", "test.b", "krylov.v0", "krylov.z0", "krylov.v1"):
        overwrite(buffers.get(name, 100), np.full(100, np.nan))
    again, _ = solve(matrix, b, buffers=buffers)
    np.testing.assert_array_equal(again, fresh)


@pytest.mark.parametrize("n", [1, 31, 32, 33, 1000])
def test_largest_and_add(n):
    buffers = Buffers()
    values = np.random.default_rng(n).uniform(-1, 1, n)
    values[n // 2] = -3.5
    x = buffers.upload("x", np.concatenate([values, [99.0]]))
    assert largest(x, n, buffers) == 3.5
    y = buffers.upload("y", np.arange(n + 1.0))
    add(x, y, -2.0, n)
    np.testing.assert_allclose(download(y, n + 1), [*(np.arange(n) - 2 * values), n], rtol=1e-15)
    for place in (0, n - 1):
        spoiled = values.copy()
        spoiled[place] = np.nan
        assert math.isnan(largest(buffers.upload("x", spoiled), n, buffers))


# --- Newton's method --------------------------------------------------------------------------------


class Curves:
    """x^2 + y^2 = 4, x y = 1; ``error`` is what the linear solver leaves, as a part of its tolerance."""

    def __init__(self, *, error=0.0, norms=None):
        self.error, self.norms = error, norms
        self.seen, self.tolerances = [], []
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
        np.testing.assert_allclose(eta[k], max(wanted, 0.3 * tolerance / norms[k], 1e-10), rtol=1e-12)
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


@pytest.mark.parametrize(
    ("norms", "iterations"),
    [([1.0, 0.9, 0.8, 0.7, 0.6], 4), ([1.0, 0.5, math.nan], 2), ([math.nan], 0), ([1.0, 1.0001e3], 1), ([math.inf], 0)],
    ids=["slow", "nan", "nan at once", "diverging", "inf at once"],
)
def test_newton_reports_that_it_did_not_converge(norms, iterations):
    result = newton(Curves(norms=norms), np.array([2.5, 0.3]), tolerance=1e-8, max_iterations=4)
    assert not result.converged
    assert result.iterations == iterations
    np.testing.assert_equal(result.norm, norms[iterations])


# --- generalized-alpha ------------------------------------------------------------------------------


@pytest.mark.parametrize("rho_inf", [0.0, 0.2, 0.5, 0.8, 1.0])
def test_generalized_alpha_coefficients(rho_inf):
    """Chung & Hulbert's conditions, and the derivatives of the intermediate values by differences."""
    dt = 0.03
    scheme = GeneralizedAlpha(rho_inf, dt)
    assert scheme.alpha_m == pytest.approx((2 * rho_inf - 1) / (rho_inf + 1), rel=1e-15)
    assert scheme.alpha_f == pytest.approx(rho_inf / (rho_inf + 1), rel=1e-15)
    assert scheme.gamma == pytest.approx(0.5 - scheme.alpha_m + scheme.alpha_f, rel=1e-15)  # order 2
    assert scheme.beta == pytest.approx(0.25 * (0.5 + scheme.gamma) ** 2, rel=1e-15)  # largest damping
    assert scheme.alpha_m <= scheme.alpha_f <= 0.5  # stability
    rng = np.random.default_rng(1)
    v, a, u = rng.standard_normal((3, 7, 2))
    particles = tp.Particles(rng.uniform(size=(7, 2)), np.zeros(7), np.zeros(7), v, a, spacing=0.1)
    v0, a0 = scheme.history(particles)
    v_alpha, a_alpha = twin.Alpha(rho_inf, dt).intermediate(u, v, a)
    np.testing.assert_allclose(scheme.cv * u + v0, v_alpha, atol=1e-11)
    np.testing.assert_allclose(scheme.cm * u + a0, a_alpha, atol=1e-9)
    assert scheme.cf == pytest.approx(1 / (1 + rho_inf))
    # a constant acceleration is what the prediction keeps
    predicted = scheme.predict(particles)
    np.testing.assert_allclose(scheme.acceleration(predicted, particles), a, atol=1e-9)
    np.testing.assert_allclose(scheme.velocity(a, particles), v + dt * a, atol=1e-13)


def oscillate(rho_inf, dt, steps, *, stiffness, damping, position=1.0, velocity=0.0):
    """x'' + c x' + k x = 0 by `steps` steps; Particles at the end."""
    scheme = GeneralizedAlpha(rho_inf, dt)
    start = np.array([[position, 0.5 * position]])
    speed = np.array([[velocity, 0.5 * velocity]])
    particles = tp.Particles(
        start, np.zeros(1), np.zeros(1), speed, -stiffness * start - damping * speed, spacing=1.0
    )
    for _ in range(steps):
        v0, a0 = scheme.history(particles)
        slope = scheme.cm + damping * scheme.cv + stiffness * scheme.cf
        u = -(a0 + damping * v0 + stiffness * particles.position) / slope
        particles = scheme.advance(particles, u, particles.pressure)
    return particles


@SPECTRAL_RADII
def test_generalized_alpha_is_of_second_order(rho_inf):
    """Positions and velocities of a damped oscillator at t = 2 against the exact solution."""
    k, c, end = 9.0, 0.4, 2.0
    omega = math.sqrt(k - c * c / 4)
    decay = math.exp(-c * end / 2)
    x = decay * (math.cos(omega * end) + c / (2 * omega) * math.sin(omega * end))
    v = -decay * k / omega * math.sin(omega * end)
    errors = []
    for steps in (400, 800, 1600):
        result = oscillate(rho_inf, end / steps, steps, stiffness=k, damping=c)
        errors.append([abs(result.position[0, 0] - x), abs(result.velocity[0, 0] - v)])
        np.testing.assert_allclose(result.position[0, 1], 0.5 * result.position[0, 0], rtol=1e-12)
    order = np.log2(np.array(errors[:-1]) / np.array(errors[1:]))
    assert abs(order - 2).max() < 0.1
    assert np.max(errors[-1]) < 1e-3


@pytest.mark.parametrize("rho_inf", [0.0, 0.3, 0.7, 1.0])
def test_generalized_alpha_damps_high_frequencies_as_it_promises(rho_inf):
    """Spectral radius of one step's map of (x, dt v, dt^2 a) at omega dt = 1e5; at most 1 at any frequency."""
    dt = 0.1

    def radius(omega_dt):
        stiffness = (omega_dt / dt) ** 2
        scheme = GeneralizedAlpha(rho_inf, dt)
        columns = []
        for x, v, a in np.eye(3):
            state = tp.Particles(
                [[x, 0.0]], np.zeros(1), np.zeros(1), [[v / dt, 0.0]], [[a / dt**2, 0.0]], spacing=1.0
            )
            _, a0 = scheme.history(state)
            u = -(a0 + stiffness * state.position) / (scheme.cm + stiffness * scheme.cf)
            after = scheme.advance(state, u, state.pressure)
            columns.append([after.position[0, 0], dt * after.velocity[0, 0], dt**2 * after.acceleration[0, 0]])
        return abs(np.linalg.eigvals(np.array(columns).T)).max()

    assert radius(1e5) == pytest.approx(rho_inf, abs=5e-4)
    for omega_dt in (0.01, 0.3, 1.0, 3.0, 10.0, 100.0):
        assert radius(omega_dt) <= 1 + 1e-8


def test_generalized_alpha_keeps_energy_at_most_and_walls_at_rest():
    undamped = oscillate(1.0, 0.05, 400, stiffness=9.0, damping=0.0)
    energy = undamped.velocity[0, 0] ** 2 / 2 + 9.0 * undamped.position[0, 0] ** 2 / 2
    assert energy == pytest.approx(4.5, rel=1e-2)
    wall = np.array([True, False])
    particles = tp.Particles(np.eye(2), np.zeros(2), wall, acceleration=np.ones((2, 2)), spacing=1.0)
    after = GeneralizedAlpha(0.5, 0.1).advance(particles, np.array([[0.0, 0.0], [0.1, 0.2]]), np.array([3.0, 4.0]))
    assert (after.velocity[0] == 0).all()
    assert (after.acceleration[0] == 0).all()
    assert (after.velocity[1] != 0).all()
    np.testing.assert_array_equal(after.position, [[1.0, 0.0], [0.1, 1.2]])
    np.testing.assert_array_equal(after.pressure, [3.0, 4.0])
    assert (particles.acceleration == 1).all()


# --- the length of the step -------------------------------------------------------------------------


def test_step_control_halves_and_grows_back():
    control = StepControl(0.1, growth=1.5)
    assert control.length(0.0, 1.0, math.inf) == 0.1
    assert control.refuse(0.1)
    assert control.length(0.0, 1.0, math.inf) == 0.05
    assert control.refuse(0.05)
    dt = control.length(0.0, 1.0, math.inf)
    lengths = []
    for _ in range(5):
        dt = control.length(0.0, 1.0, math.inf)
        lengths.append(dt)
        control.accept(dt)
    np.testing.assert_allclose(lengths, [0.025, 0.0375, 0.05625, 0.084375, 0.1], rtol=1e-14)


def test_step_control_is_not_shortened_for_good_by_a_short_remainder():
    control = StepControl(0.1)
    dt = control.length(0.0, 1.0, 0.003)
    assert dt == 0.003
    control.accept(dt)
    assert control.length(0.0, 1.0, math.inf) == 0.1


def test_step_control_aims_at_a_displacement():
    control = StepControl(0.1, target=0.35)
    assert control.length(2.0, 0.01, math.inf) == pytest.approx(0.35 * 0.01 / 2.0, rel=1e-14)
    assert control.length(0.01, 0.01, math.inf) == 0.1  # too slow to matter
    assert control.length(1e9, 0.01, math.inf) >= control.smallest  # too fast for any step


@pytest.mark.parametrize("remaining", [0.25, 0.1, 0.1 + 1e-13, 1.0, 0.101, 0.0999, 7.77])
def test_step_control_divides_the_remaining_time_evenly(remaining):
    control = StepControl(0.1)
    time, lengths = 0.0, []
    while remaining - time > 1e-12:
        lengths.append(control.length(0.0, 1.0, remaining - time))
        control.accept(lengths[-1])
        time += lengths[-1]
    assert len(lengths) == math.ceil(remaining / 0.1 - 1e-9)
    np.testing.assert_allclose(lengths, remaining / len(lengths), rtol=1e-9)


@pytest.mark.parametrize("remaining", [math.inf, 0.77])
@pytest.mark.parametrize("speed", [0.0, 1e6])
def test_step_control_gives_up(remaining, speed):
    """Steps that are all refused end, whatever the speed and whether or not there is an end time."""
    control = StepControl(0.1, smallest=1e-4)
    lengths = []
    while True:
        lengths.append(control.length(speed, 0.01, remaining))
        if not control.refuse(lengths[-1]):
            break
        assert len(lengths) < 50, f"never gives up: {lengths[-3:]}"
    assert lengths[-1] < 1e-3
    assert (np.diff(lengths) < 0).all()


@pytest.mark.parametrize("largest_step", [0.0, -1.0, math.nan, math.inf])
def test_step_control_rejects_a_senseless_length(largest_step):
    with pytest.raises(ValueError, match="time step"):
        StepControl(largest_step)


# --- multigrid --------------------------------------------------------------------------------------


WATER = tp.Fluid("water", density=998.0, viscosity=1e-3)
AIR = tp.Fluid("air", density=1.2, viscosity=1.8e-5)


def two_fluids(size, spacing):
    """Particles, mesh, element densities: a column of water 998 in air 1.2, nodes shaken by 0.2 spacings."""
    upper = np.array(size) * 0.5
    filled = tp.tank(size, spacing, jitter=0.2, seed=1).fill(AIR).fill(WATER, box=(np.zeros(len(size)), upper))
    particles = filled.sample([WATER, AIR])
    mesh = triangulate(particles.position, particles.wall, spacing)
    density = np.array([998.0, 1.2])[particles.fluid][mesh.cells].mean(axis=1)
    return particles, mesh, density


def hierarchy(position, matrix, grid_spacing):
    """The multigrid of a SciPy matrix in CSR on its nodes."""
    buffers = Buffers()
    matrix.sort_indices()
    grid = BackgroundMultigrid(position.min(axis=0), position.max(axis=0), grid_spacing, buffers)
    grid.build(
        position,
        buffers.upload("rows", matrix.indptr.astype(np.int32)),
        buffers.upload("columns", matrix.indices.astype(np.int32)),
        buffers.upload("values", matrix.data),
    )
    return grid, buffers


def level_matrix(grid, level):
    """A level's operator as a dense matrix, from its stencils; entries that leave the grid must be zero."""
    shape = tuple(grid.shapes[level])
    first, last = grid.offsets[level], grid.offsets[level + 1]
    stencil = download(grid._stencil, last)[first:]
    shifts = np.array(list(itertools.product(range(-2, 3), repeat=len(shape))))
    nodes = np.stack(np.unravel_index(np.arange(last - first), shape), axis=1)
    target = nodes[:, None, :] + shifts
    inside = ((target >= 0) & (target < shape)).all(axis=2)
    assert (stencil[~inside] == 0).all()
    matrix = np.zeros((last - first, last - first))
    row = np.repeat(np.arange(last - first)[:, None], len(shifts), axis=1)
    np.add.at(matrix, (row[inside], np.ravel_multi_index(tuple(target[inside].T), shape)), stencil[inside])
    return matrix


CLOUDS = pytest.mark.parametrize(
    ("size", "spacing", "grid_spacing"),
    [((1.0, 0.7), 0.05, 0.1), ((1.3, 0.9), 0.06, 0.09), ((0.3, 2.0), 0.05, 0.1), ((1.0, 0.9, 0.8), 0.2, 0.4)],
    ids=["even", "coarser by 1.5", "narrow", "3-D"],
)


@CLOUDS
def test_coarse_operators_are_galerkin_products(size, spacing, grid_spacing):
    """P^T A P from the mesh to the finest grid, and from grid to grid, P assembled by SciPy from hat functions."""
    particles, mesh, density = two_fluids(size, spacing)
    matrix = twin.laplacian(mesh.position, mesh.cells, 1 / density)
    grid, _ = hierarchy(particles.position, matrix, grid_spacing)
    expected, points = matrix, (particles.position - particles.position.min(axis=0)) / grid_spacing
    for level in range(grid.levels):
        shape = tuple(int(n) for n in grid.shapes[level])
        p = twin.hats(points, shape)
        np.testing.assert_allclose(p.sum(axis=1), 1.0, rtol=1e-12)
        expected = p.T @ expected @ p
        got = level_matrix(grid, level)
        largest_entry = abs(expected).max()
        assert abs(got - expected).max() < 1e-12 * largest_entry
        assert abs(got.sum(axis=1)).max() < 1e-12 * largest_entry
        points = np.stack(np.unravel_index(np.arange(np.prod(shape)), shape), axis=1) / 2
    assert grid.shapes[-1].max() <= 5
    if max(size) / grid_spacing > 5:
        assert grid.levels > 1


def test_edges_beyond_the_stencil_keep_rows_at_zero_and_symmetry():
    """A grid finer than the mesh: long edges are left out, and rows still sum to zero on every level."""
    particles, mesh, density = two_fluids((1.0, 0.7), 0.1)
    matrix = twin.laplacian(mesh.position, mesh.cells, 1 / density)
    grid, _ = hierarchy(particles.position, matrix, 0.08)
    p = twin.hats((particles.position - particles.position.min(axis=0)) / 0.08, grid.shapes[0])
    whole = p.T @ matrix @ p
    assert abs(level_matrix(grid, 0) - whole).max() > 1e-3 * abs(whole).max()  # some are left out
    for level in range(grid.levels):
        got = level_matrix(grid, level)
        assert abs(got).max() > 0.1 * abs(whole).max()
        assert abs(got.sum(axis=1)).max() < 1e-12 * abs(got).max()
        assert abs(got - got.T).max() < 1e-12 * abs(got).max()
        assert np.linalg.eigvalsh(got).min() > -1e-12 * abs(got).max()


def cg_iterations(matrix, b, apply, limit=60):
    """Iterations of preconditioned conjugate gradients to a residual of 1e-8."""
    x, r = np.zeros_like(b), b.copy()
    z = apply(r)
    p, rz = z, r @ z
    for k in range(1, limit + 1):
        q = matrix @ p
        step = rz / (p @ q)
        x, r = x + step * p, r - step * q
        if np.linalg.norm(r) <= 1e-8 * np.linalg.norm(b):
            assert np.linalg.norm(matrix @ x - b) < 2e-8 * np.linalg.norm(b)
            return k
        z = apply(r)
        p, rz = z + r @ z / rz * p, r @ z
    return math.inf


def v_cycle(grid, buffers, count):
    """One cycle of the hierarchy as a function on NumPy vectors."""

    def apply(r):
        z = buffers.get("test.z", count)
        grid.apply(buffers.upload("test.r", r), z)
        return download(z, count)

    return apply


@pytest.mark.parametrize(
    ("steps", "most"),
    [((60, 120), 14), ((58, 118), 20)],
    ids=["interface on grid lines", "interface between grid lines"],
)
def test_a_cycle_in_conjugate_gradients_takes_few_iterations_on_any_mesh(steps, most):
    """Pressure Laplacian of water and air, 998 : 1.2, to 1e-8: hardly more iterations on finer meshes.

    A jump of the density that no coarse grid line follows costs iterations, whatever the mesh.
    """
    counts = []
    for n in steps:
        particles, mesh, density = two_fluids((1.0, 1.0), 1 / n)
        matrix = twin.laplacian(mesh.position, mesh.cells, 1 / density)
        grid, buffers = hierarchy(particles.position, matrix, 1.5 / n)
        b = np.random.default_rng(0).standard_normal(len(particles))
        counts.append(cg_iterations(matrix, b - b.mean(), v_cycle(grid, buffers, len(particles))))
    assert len(particles) > 13_500
    assert max(counts) <= most
    assert counts[1] <= counts[0] + 3


def test_a_cycle_is_linear_and_repeatable():
    particles, mesh, density = two_fluids((1.0, 0.7), 0.05)
    matrix = twin.laplacian(mesh.position, mesh.cells, 1 / density)
    grid, buffers = hierarchy(particles.position, matrix, 0.1)
    apply = v_cycle(grid, buffers, len(particles))
    a, b = np.random.default_rng(1).standard_normal((2, len(particles)))
    combined = apply(2 * a - 3 * b)
    np.testing.assert_allclose(combined, 2 * apply(a) - 3 * apply(b), atol=1e-11 * abs(combined).max())
    np.testing.assert_array_equal(apply(a), apply(a))


@pytest.mark.parametrize("size", [(1.0, 0.8), (1.0, 1.0, 0.75)], ids=["2-D", "3-D"])
def test_the_pressure_laplacian_is_the_stiffness_matrix(size):
    particles, mesh, density = two_fluids(size, 0.1 if len(size) == 2 else 0.25)
    scheme = GeneralizedAlpha(0.5, 2e-3)
    nothing = np.zeros(len(mesh.cells))
    problem = FlowProblem(
        mesh, particles, ElementProperties(density, nothing, nothing), scheme, np.zeros_like(mesh.position), 0.25,
        Workspace(),
    )  # fmt: skip
    offsets, columns = mesh.adjacency
    values = download(problem.buffers.get("laplacian", len(columns)), len(columns))
    got = sparse.csr_matrix((values, columns, offsets))
    cm = (1 - scheme.alpha_m) / (scheme.beta * scheme.dt**2)
    expected = twin.laplacian(mesh.position, mesh.cells, 1 / (density * cm))
    assert abs(got - expected).max() < 1e-12 * abs(expected).max()
    assert abs(np.asarray(got.sum(axis=1))).max() < 1e-12 * abs(expected).max()


@pytest.mark.parametrize("size", [(1.0, 0.8), (1.0, 1.0, 0.75)], ids=["2-D", "3-D"])
def test_the_preconditioner_is_made_of_the_blocks_of_the_derivative(size):
    """z_p = S (r_p - D r_u) with S one cycle, z_u = r_u + G z_p, rows scaled by diag(A)^-1; D and -G from K's product.

    At rest without forces, where the parts of D that the preconditioner leaves out vanish.
    """
    particles, mesh, density = two_fluids(size, 0.1 if len(size) == 2 else 0.25)
    nothing, still = np.zeros(len(mesh.cells)), np.zeros_like(mesh.position)
    problem = FlowProblem(
        mesh, particles, ElementProperties(density, nothing + 1e-3, nothing), GeneralizedAlpha(0.5, 1e-3), still,
        0.25, Workspace(),
    )  # fmt: skip
    n, width = len(particles), len(size) + 1
    problem.residual(problem.vector(still, np.zeros(n)))
    r = np.random.default_rng(3).uniform(-1, 1, (n, width))
    r[particles.wall, :-1] = 0.0
    out = problem.buffers.get("test.out", problem.size)

    def product(values):
        problem.product(problem.buffers.upload("test.in", values.ravel()), out)
        return download(out, problem.size).reshape(n, width)

    problem.precondition(problem.buffers.upload("test.r", r.ravel()), out)
    z = download(out, problem.size).reshape(n, width)
    only_u, only_p = r.copy(), z.copy()
    only_u[:, -1] = 0.0
    only_p[:, :-1] = 0.0
    coupling = product(only_p)[:, :-1]
    assert abs(coupling).max() > 1e-3 * abs(r).max()
    np.testing.assert_allclose(z[:, :-1], r[:, :-1] - coupling, atol=1e-12 * abs(z[:, :-1]).max())
    volume = np.bincount(mesh.cells.ravel(), np.repeat(mesh.measure / width, width), n)
    schur = (r - product(only_u))[:, -1] * volume / particles.spacing
    pressure = problem.buffers.get("test.z", n)
    problem._multigrid.apply(problem.buffers.upload("test.schur", schur), pressure)
    np.testing.assert_allclose(z[:, -1], download(pressure, n), atol=1e-11 * abs(z[:, -1]).max())


@pytest.mark.parametrize(("size", "most"), [((1.0, 0.8), 20), ((1.0, 1.0, 0.75), 45)], ids=["2-D", "3-D"])
def test_a_correction_solves_the_linearised_step(size, most):
    """K dx = -r to the tolerance asked for; flat tetrahedra cost iterations in 3-D."""
    particles, mesh, density = two_fluids(size, 0.1 if len(size) == 2 else 0.25)
    nothing = np.zeros(len(mesh.cells))
    body_force = np.tile([0.0, -9.81, 0.0][: len(size)], (len(particles), 1))
    problem = FlowProblem(
        mesh, particles, ElementProperties(density, nothing + 1e-3, nothing), GeneralizedAlpha(0.0, 1e-3), body_force,
        0.25, Workspace(),
    )  # fmt: skip
    x = problem.predict()
    before = problem.residual(x)
    r = problem.residual_vector().ravel()
    old = download(x, problem.size)
    result = problem.correct(x, 1e-8)
    assert result.converged
    assert result.iterations <= most
    out = problem.buffers.get("test.product", problem.size)
    problem.product(problem.buffers.upload("test.dx", download(x, problem.size) - old), out)
    assert np.linalg.norm(download(out, problem.size) + r) <= 1.01e-8 * np.linalg.norm(r)
    assert problem.residual(x) < 1e-3 * before


# --- device buffers ---------------------------------------------------------------------------------


def test_buffers_grow_and_are_used_again():
    buffers = Buffers()
    first = buffers.get("a", 100)
    assert first.shape[0] >= 100
    assert buffers.get("a", 100) is first
    assert buffers.get("a", 3) is first
    assert buffers.get("a", 0) is first
    assert buffers.get("b", 100) is not first
    larger = buffers.get("a", 1000)
    assert larger is not first
    assert larger.shape[0] >= 1000
    assert buffers.get("a", 100) is larger
    assert buffers.get("table", 10, 3).shape[1] == 3
    assert buffers.get("nothing", 0).shape[0] >= 1


@pytest.mark.parametrize("shape", [(7,), (1,), (5, 3), (64, 2)])
@pytest.mark.parametrize("kind", [np.float64, np.int32, np.int64, bool])
def test_upload_and_download_are_a_round_trip(shape, kind):
    buffers = Buffers()
    values = (np.random.default_rng(0).uniform(-9, 9, shape)).astype(kind)
    back = download(buffers.upload("a", values), shape[0])
    assert back.dtype == (np.float64 if kind is np.float64 else np.int32)
    np.testing.assert_array_equal(back, values)
    smaller = values[: (shape[0] + 1) // 2]
    np.testing.assert_array_equal(download(buffers.upload("a", smaller), len(smaller)), smaller)


def test_upload_takes_slices_and_empty_arrays():
    buffers = Buffers()
    table = np.arange(24.0).reshape(6, 4)
    np.testing.assert_array_equal(download(buffers.upload("a", table[::2, 1:3]), 3), table[::2, 1:3])
    np.testing.assert_array_equal(download(buffers.upload("b", table.T), 4), table.T)
    assert len(download(buffers.upload("empty", np.zeros(0)), 0)) == 0


def test_memory_stays_flat_while_sizes_change():
    buffers = Buffers()
    rng = np.random.default_rng(2)

    def use(rows):
        buffers.upload("vector", np.zeros(rows))
        buffers.upload("cells", np.zeros((2 * rows, 3), dtype=np.int32))
        buffers.get("work", 3 * rows, 4)

    use(1000)
    held = buffers.memory()
    assert held >= 1000 * (8 + 2 * 3 * 4 + 3 * 4 * 8)
    assert held <= 1.2 * 1000 * (8 + 2 * 3 * 4 + 3 * 4 * 8)
    for _ in range(200):
        use(int(rng.integers(1, 1001)))
    assert buffers.memory() == held
    # creeping growth does not ask for a new array every time
    arrays = {id(buffers.get("vector", rows)) for rows in range(1000, 1100)}
    assert len(arrays) == 1
