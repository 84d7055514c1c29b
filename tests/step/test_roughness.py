"""tipfem/step/roughness.py: the deviation of velocities from a linear fit, the turning of interfaces, and a flow's."""

import dataclasses

import numpy as np
import pytest

import tipfem as tp
from tipfem.step.roughness import roughness


@pytest.fixture
def simulation(water, air):
    tank = tp.tank((0.4, 0.4), 0.05, jitter=0.2).fill(air).fill(water, box=((0, 0), (0.2, 0.2)))
    return tp.Simulation(tp.Case(tank, [water, air], (0, -9.81)), time_step=1e-3)


def moving(simulation, velocity):
    """The state with other velocities (N, 2)."""
    state = simulation.state
    return dataclasses.replace(state, particles=state.particles.shallow_copy(velocity=velocity))


def test_a_velocity_that_is_linear_in_space_is_smooth(simulation):
    velocity = 1.0 + simulation.mesh.position @ np.array([[1.0, 2.0], [3.0, 4.0]])
    np.testing.assert_allclose(roughness(moving(simulation, velocity), 2)[0], 0.0, atol=1e-12)
    assert roughness(moving(simulation, 0 * velocity), 2)[0] == [0.0, 0.0]


def test_it_is_the_deviation_from_the_fit_by_least_squares(simulation):
    mesh, velocity = simulation.mesh, np.random.default_rng(1).normal(size=simulation.mesh.position.shape)
    x, parts = mesh.position, []
    at = [np.isin(np.arange(len(x)), mesh.cells[mesh.fluid == f]) for f in (0, 1)]
    inside = ~(at[0] & at[1]) & (x > 1e-9).all(axis=1) & (x < 0.4 - 1e-9).all(axis=1)
    for f in (0, 1):
        squares = []
        for p in np.flatnonzero(at[f] & inside):
            near = np.setdiff1d(mesh.cells[(mesh.cells == p).any(axis=1)], p)
            fit = np.linalg.lstsq(np.c_[np.ones(len(near)), x[near] - x[p]], velocity[near], rcond=None)[0]
            squares.append([((velocity[p] - fit[0]) ** 2).sum(), (velocity[p] ** 2).sum()])
        parts.append(np.sqrt(np.divide(*np.sum(squares, axis=0))))
    np.testing.assert_allclose(roughness(moving(simulation, velocity), 2)[0], parts, rtol=1e-9)


def test_an_interface_turns_at_its_corner_only(water, air):
    """A column of 4 by 4 spacings has 7 particles on its interface off the walls, one with an angle of 90 degrees."""
    tank = tp.tank((0.4, 0.4), 0.05).fill(air).fill(water, box=((0, 0), (0.2, 0.2)))
    state = tp.Simulation(tp.Case(tank, [water, air], (0, -9.81)), time_step=1e-3).state
    assert roughness(state, 2)[1] == pytest.approx(90 / 7)


@pytest.mark.slow
def test_a_coarse_dam_break_stays_smooth_in_its_impact(water, air):
    """Means of 0.3 to 0.4 s: 0.022, 0.35 and 7 degrees where losses of remeshing were given back as differences.

    Starts with jitter have 0.018 +- 0.002, 0.247 +- 0.013 and 5.5 +- 0.5: the mean of three of them is compared.
    """
    means = []
    for seed in (1, 2, 3):
        tank = tp.tank((0.584, 0.584), 0.0146, jitter=0.02, seed=seed).fill(air)
        tank.fill(water, box=((0, 0), (0.146, 0.292)))
        case = tp.Case(tank, [water, air], (0, -9.81), numerics=tp.Numerics(largest_move=0.8))
        simulation = tp.Simulation(case, time_step=1.2e-3)
        simulation.run(0.4, progress=False)
        rows = [row for row in simulation.history if row["time"] >= 0.3]
        means.append(
            [np.mean([row[n] for row in rows]) for n in ("roughness_water", "roughness_air", "interface_turning")]
        )
    assert (np.mean(means, axis=0) < [0.0215, 0.28, 6.4]).all(), means


def test_an_interface_that_touches_a_wall_turns_there(simulation):
    """A drop of one cell with one corner on the hull, seen from there in both directions."""
    mesh = simulation.mesh
    on_hull = np.isin(np.arange(len(mesh.position)), mesh.hull[2])
    drop = np.flatnonzero(on_hull[mesh.cells].sum(axis=1) == 1)[0]
    corner = mesh.position[mesh.cells[drop]]
    a, b = corner - np.roll(corner, 1, axis=0), np.roll(corner, -1, axis=0) - corner
    angles = np.arctan2(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0], (a * b).sum(axis=1))
    state = dataclasses.replace(
        simulation.state, mesh=mesh.relabelled(np.where(np.arange(len(mesh.cells)) == drop, 0, 1).astype(np.int32))
    )
    assert roughness(state, 2)[1] == pytest.approx(np.degrees(angles.mean()), rel=1e-6)
    assert np.degrees(angles.mean()) == pytest.approx(120)
