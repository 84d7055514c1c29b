"""Linear systems reduced to the pressures: their solution, where they are used, and that steps come out the same."""

import numpy as np
import pytest
from scipy.sparse import diags
from scipy.sparse.linalg import spsolve

import tipfem as tp
from tipfem.backend.arrays import download
from tipfem.step import solve
from tipfem.step.linear_system import LinearSystem
from tipfem.step.problem import FlowProblem

SPACING = 0.02


def splashing(water, air, **options):
    """A column of water in air that begins to fall, with a wall that slips."""
    tank = tp.tank((0.4, 0.3), SPACING, jitter=0.2).fill(air).fill(water, box=((0, 0), (0.15, 0.2)))
    tank.wall("bottom", slip=True)
    simulation = tp.Simulation(tp.Case(tank, [water, air], (0, -9.81), **options), time_step=2e-3)
    for _ in range(3):
        simulation.step()
    return simulation


class Stop(Exception):
    """Ends a step once its problem has been examined."""


def problem_of(simulation, monkeypatch):
    """The problem of the next step at its first iterate, with the residual there."""
    found = []

    def examine(problem, x, **_options):
        problem.residual(x)
        found.append((problem, x))
        raise Stop

    with monkeypatch.context() as inner:
        inner.setattr(solve, "newton", examine)
        with pytest.raises(Stop):
            simulation.step()
    return found[0]


@pytest.mark.parametrize("pressure", ["two-sided", "continuous"])
def test_the_reduced_solution_is_that_with_the_diagonal_of_momentum_by_displacement(water, air, pressure, monkeypatch):
    """By SciPy from the assembled rows; the closed tank's pressure is known up to a constant."""
    problem, _ = problem_of(splashing(water, air, numerics=tp.Numerics(pressure=pressure)), monkeypatch)
    system, size = problem.system, problem.size
    assert system.reducible
    problem.linearise()
    full = system.matrix().tocoo()
    moving = (full.row % 3 < 2) & (full.col % 3 < 2)
    scaled = (full.row == full.col) & (full.data != 0)  # by the diagonal, which is 1 but for what geometry adds
    full.data[moving] = np.where(scaled, 1.0, 0.0)[moving]
    r = download(problem.buffers.get("residual", size), size).astype(float)
    matrix = full.tocsr()
    empty = np.asarray(abs(matrix).sum(axis=1)).ravel() == 0
    matrix = matrix + diags(empty.astype(float))
    first = int(np.flatnonzero(~empty[2::3])[0]) * 3 + 2
    matrix = matrix.tolil()
    matrix[first] = 0.0
    matrix[first, first] = 1.0  # in place of the row that those of the others add up to
    exact = spsolve(matrix.tocsc(), np.where(np.arange(size) == first, 0.0, r))

    problem.linearise(reduced=True)
    out = problem.buffers.get("correction", size)
    result = system.solve(problem.buffers.get("residual", size), out, 1e-11, 80)
    assert result.converged
    found = download(out, size).astype(float)
    rows = ~empty & (np.arange(size) % 3 < 2)
    np.testing.assert_allclose(found[rows], exact[rows], atol=1e-7 * abs(exact[rows]).max())
    rest = matrix @ np.where(empty, 0.0, found) - r
    pressures = ~empty & (np.arange(size) % 3 == 2) & (np.arange(size) != first)
    assert abs(rest[pressures]).max() < 1e-9 * abs(r).max()


def by_reduced_systems(simulation, steps, monkeypatch):
    """How many corrections of so many steps are by reduced systems, and how many there are."""
    counts, correct = np.zeros(2, dtype=int), FlowProblem.correct

    def counted(problem, x, tolerance):
        result = correct(problem, x, tolerance)
        counts[:] += problem._reduces, 1
        return result

    with monkeypatch.context() as inner:
        inner.setattr(FlowProblem, "correct", counted)
        for _ in range(steps):
            simulation.step()
    return counts.tolist()


def test_flows_of_little_viscosity_are_solved_by_reduced_systems(water, air, monkeypatch):
    """The same step as by full systems, within Newton's tolerance of 25 millionths of a spacing."""
    reduced, full = (splashing(water, air) for _ in range(2))
    some, number = by_reduced_systems(reduced, 1, monkeypatch)
    assert some == number > 0
    monkeypatch.setattr(LinearSystem, "_is_reducible", lambda _: False)
    assert by_reduced_systems(full, 1, monkeypatch)[0] == 0
    moved = abs(reduced.particles.position - full.particles.position).max()
    assert 0 < moved < 1e-4 * SPACING


@pytest.mark.parametrize(
    "options",
    [
        {"viscosity": 5.0},
        {"numerics": tp.Numerics(mass="consistent")},
        {"numerics": tp.Numerics(jacobian="matrix-free")},
    ],
    ids=["viscous", "consistent mass", "matrix-free"],
)
def test_others_are_not(air, options, monkeypatch):
    fluid = tp.Fluid("fluid", 1000.0, options.pop("viscosity", 1e-3))
    assert by_reduced_systems(splashing(fluid, air, **options), 1, monkeypatch)[0] == 0


def test_a_reduced_system_that_leaves_much_of_a_residual_is_given_up(water, air, monkeypatch):
    """Where viscosity is taken for little, the step converges all the same, by the full system."""
    thick = tp.Fluid("thick", 1000.0, 30.0)
    reference = splashing(thick, air)
    monkeypatch.setattr("tipfem.step.linear_system.LITTLE_VISCOUS", 1e9)
    simulation = splashing(thick, air)
    some, number = by_reduced_systems(simulation, 1, monkeypatch)
    assert 0 < some < number
    monkeypatch.setattr("tipfem.step.linear_system.LITTLE_VISCOUS", 0.0)
    reference.step()
    assert abs(simulation.particles.position - reference.particles.position).max() < 1e-3 * SPACING


@pytest.mark.parametrize(
    ("before", "norm", "goes_on"), [(1.0, 0.5, True), (1.0, 0.9, False), (0.05, 0.005, True), (0.05, 0.02, False)]
)
def test_reduced_systems_go_on_while_they_reduce_the_residual(water, air, before, norm, goes_on, monkeypatch):
    """By a fifth where it is large and corrections may be far off, and by four fifths where it is small; one that is
    given up serves no more, however loose tolerances are."""
    problem, x = problem_of(splashing(water, air), monkeypatch)
    gathered, linearise = [], problem.linearise
    monkeypatch.setattr(problem, "linearise", lambda *, reduced: (gathered.append(reduced), linearise(reduced=reduced)))
    problem.correct(x, 0.1)
    problem._before, problem._norm = before, norm
    problem.correct(x, 0.1)
    assert problem._reduces is goes_on
    assert gathered == ([True] if goes_on else [True, False])
