"""Newton's corrections of a step: none inverts an element, and pressures that were guessed come first."""

from __future__ import annotations

import numpy as np
import pytest
from flow_problems import flow_problem

import tipfem as tp
from tipfem.fem.time_integration import GeneralizedAlpha
from tipfem.linalg.fgmres import KrylovResult
from tipfem.physics.term import ElementProperties
from tipfem.step import problem as steps
from tipfem.step.linear_system import Workspace
from tipfem.step.problem import FlowProblem

WATER, AIR = (
    tp.Fluid("water", density=1000.0, viscosity=1e-3),
    tp.Fluid("air", density=1.2, viscosity=2e-5),
)
SPACING = 0.05


def posed(dt: float, speed: float, pressure: float) -> FlowProblem:
    """Water that falls into air with a wrong guess of the air's pressure [Pa] at its particles."""
    tank = tp.tank((1.0, 1.0), SPACING, jitter=0.1, seed=2).fill(AIR).fill(WATER, box=((0.3, 0.3), (0.7, 0.7)))
    case = tp.Case(tank, fluids=[WATER, AIR], gravity=(0, -9.81), numerics=tp.Numerics(pressure="two-sided"))
    state = tp.Simulation(case).state
    p = state.particles
    p.velocity[p.fluid == 0] = (0.0, -speed)
    rng = np.random.default_rng(1)
    jump = np.zeros((2, len(p)))
    jump[1] = pressure * rng.uniform(-1, 1, len(p))
    material = ElementProperties(state.material.density, state.material.viscosity, np.zeros(len(state.mesh.cells)))
    force = np.tile([0.0, -9.81], (len(p), 1))
    scheme = GeneralizedAlpha(0.0, dt)
    return flow_problem(state.mesh, p, material, scheme, force, 0.25, Workspace(), pressure_jump=jump)


def test_a_first_correction_changes_pressures_alone_where_they_were_a_bad_guess():
    problem = posed(5e-3, 1.0, 2e3)
    x = problem.predict()
    u, p = problem.split(x)
    first = problem.residual(x)
    assert first > steps.GUESSED
    problem.correct(x, 1e-3)
    v, q = problem.split(x)
    np.testing.assert_array_equal(u, v)
    assert abs(q - p).max() > 10.0
    assert problem.residual(x) < 0.5 * first
    problem.correct(x, 1e-3)
    w, _ = problem.split(x)
    assert abs(w - v).max() > 1e-3 * SPACING


def test_a_good_first_guess_is_corrected_as_a_whole():
    problem = posed(1e-4, 0.0, 0.0)
    x = problem.predict()
    u, _ = problem.split(x)
    assert problem.residual(x) <= steps.GUESSED
    problem.correct(x, 1e-3)
    assert abs(problem.split(x)[0] - u).max() > 0


@pytest.mark.parametrize("far", [0.2, 1.0, 5.0])
def test_no_correction_inverts_an_element(far, monkeypatch):
    """Displacements are halved until J of all elements is above the limit; pressures are corrected in full."""
    problem = posed(1e-4, 0.0, 0.0)
    x = problem.predict()
    problem.residual(x)
    u, p = problem.split(x)
    moved = int(np.argmin(((problem.particles.position - 0.6) ** 2).sum(axis=1)))
    given = np.zeros((problem.nodes, 3))
    given[moved, 0] = -far * SPACING
    given[:, 2] = -7.0

    def solved(*args, **options):
        problem.buffers.upload("correction", given.ravel())
        return KrylovResult(1, 0.0, True)

    monkeypatch.setattr(problem.system, "solve", solved)
    problem.correct(x, 1e-2)
    v, q = problem.split(x)
    np.testing.assert_allclose(q - p, 7.0)
    part = (v - u)[moved, 0] / (far * SPACING)
    smallest = problem.limits(x).smallest_jacobian
    assert smallest >= steps.DAMPED
    assert (part == pytest.approx(1.0)) == (far == 0.2)
    assert np.log2(part) == pytest.approx(round(np.log2(part)))
    twice = problem.vector(u + 2 * (v - u), q)
    assert part == pytest.approx(1.0) or problem.limits(twice).smallest_jacobian < steps.DAMPED
