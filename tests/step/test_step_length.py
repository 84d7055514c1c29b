"""The length of steps, from the error of the time integration and what the case lets particles move."""

from __future__ import annotations

import numpy as np
import pytest

import tipfem as tp

WATER = tp.Fluid("water", density=1000.0, viscosity=1e-3)
AIR = tp.Fluid("air", density=1.2, viscosity=1.8e-5)


def column(time_tolerance: float, width: float = 0.6) -> tp.Simulation:
    """A column of water that falls in air, with a largest step far above what it allows."""
    tank = tp.tank((width, 0.6), 0.03).fill(AIR).fill(WATER, box=((0, 0), (0.21, 0.3)))
    case = tp.Case(tank, [WATER, AIR], (0, -9.81), numerics=tp.Numerics(time_tolerance=time_tolerance))
    return tp.Simulation(case, time_step=0.02)


def errors_of_steps(simulation: tp.Simulation, until: float) -> list[float]:
    """Of the steps to ``until`` that the error limits."""
    found = []
    while simulation.time < until:
        simulation.step()
        assert simulation.solved is not None
        if simulation.control.limit == "error":
            found.append(simulation.solved.error)
    return found


def test_the_error_of_steps_is_near_the_tolerance():
    tp.init()
    steps = []
    for tolerance in (4e-4, 4e-4 / 8):
        simulation = column(tolerance)
        errors = errors_of_steps(simulation, 0.15)
        assert len(errors) > 0.8 * simulation.step_number
        assert 0.4 * tolerance < np.median(errors) < 1.2 * tolerance
        steps.append(simulation.step_number)
    assert 1.6 < steps[1] / steps[0] < 2.4


def test_the_error_counts_what_moves():
    """A drop falls into a pool; a wider pool, at rest, is no reason for longer steps."""
    tp.init()
    lengths = []
    for width in (0.6, 1.8):
        tank = tp.tank((width, 0.6), 0.03).fill(AIR).fill(WATER, box=((0, 0), (width, 0.15)))
        tank.fill(WATER, box=((0.21, 0.36), (0.39, 0.51)))
        case = tp.Case(tank, [WATER, AIR], (0, -9.81), numerics=tp.Numerics(time_tolerance=1e-5))
        simulation = tp.Simulation(case, time_step=0.02)
        errors_of_steps(simulation, 0.05)
        lengths.append(simulation.control.accurate)
    assert lengths[1] == pytest.approx(lengths[0], rel=0.1)


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ({}, 2.0),
        ({"free_surface": True}, 0.5),
        ({"interface": "interpolated"}, 0.5),
        ({"numerics": tp.Numerics(largest_move=0.7)}, 0.7),
        ({"free_surface": True, "numerics": tp.Numerics(largest_move=0.7)}, 0.7),
    ],
)
def test_how_far_particles_may_move(options, expected):
    tank = tp.tank((1.0, 1.0), 0.1).fill(WATER)
    assert tp.Case(tank, [WATER], (0, -9.81), **options).largest_move == expected


def test_particles_move_far_where_empty_space_has_cells():
    tank = tp.tank((1.0, 1.0, 1.0), 0.25, jitter=0.1).fill(WATER, box=((0, 0, 0), (1, 1, 0.5)))
    case = tp.Case(tank, [WATER], (0, 0, -9.81), free_surface=True)
    assert case.largest_move == 2
    assert case.step_control["tolerance"] < 1


def test_particles_move_less_with_openings():
    channel = tp.tank((1.0, 1.0), 0.1).fill(WATER)
    openings = [tp.Inlet(wall="left", fluid=WATER, velocity=1.0), tp.Outlet(wall="right", pressure=0.0)]
    assert tp.Case(channel, [WATER], (0, 0), openings=openings).largest_move == 0.5


def test_without_forces_particles_move_by_half_a_spacing():
    """Gravity, a body force or surface tension limits steps where they may move farther."""
    tank = tp.tank((1, 1), 0.1).fill(WATER)
    assert tp.Case(tank, [WATER], (0, 0)).largest_move == 0.5
    assert tp.Case(tank, [WATER], (0, 0), body_force=lambda x, t: np.full_like(x, 0.1)).largest_move == 2
    two = tp.tank((1, 1), 0.1).fill(WATER).fill(AIR, box=((0, 0), (1, 0.5)))
    assert tp.Case(two, [WATER, AIR], (0, 0)).largest_move == 0.5
    assert tp.Case(two, [WATER, AIR], (0, 0), surface_tension={("water", "air"): 0.07}).largest_move == 2


def test_spray_may_move_twice_as_far_in_a_step():
    """It does not count up to twice the speed of others, and moves by a spacing above."""
    tp.init()
    tank = tp.tank((1.5, 0.8), 0.05).fill(WATER, box=((0, 0), (0.5, 0.4)))
    simulation = tp.Simulation(tp.Case(tank, [WATER], (0, -9.81), free_surface=True), time_step=4e-3)
    while not (flies := simulation.mesh.surface.loose).any():
        simulation.step()
    i, others = np.flatnonzero(flies)[0], np.linalg.norm(simulation.particles.velocity[~flies], axis=1).max()
    simulation.particles.velocity[i] = (-1.9 * others, 0.0)
    assert simulation.state.speed_over_spacing(4e-3) == pytest.approx(others / 0.05, rel=1e-12)
    simulation.particles.velocity[i] = (-20 * others, 0.0)
    before = simulation.particles.position[i]
    simulation.step()
    assert simulation.history[-1]["refused_steps"] == 0
    assert simulation.control.limit == "motion"
    np.testing.assert_allclose(simulation.particles.position[i] - before, [-0.05, 0.0], atol=1e-5)
