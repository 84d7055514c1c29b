"""The first step: accelerations and pressures that follow from the initial positions and velocities."""

from __future__ import annotations

import numpy as np
import pytest
from manufactured import Vortex
from tipfem.demos.validation.waves import run as waves

import tipfem as tp


def falling_drop(time_step, rho_inf=0.0):
    """A square of water that falls freely in an empty tank."""
    water = tp.Fluid("water", density=1000.0, viscosity=1e-3)
    tank = tp.tank((1, 1), 0.05, jitter=0.2).fill(water, box=((0.3, 0.5), (0.7, 0.8)))
    case = tp.Case(tank, [water], (0, -9.81), free_surface=True, numerics=tp.Numerics(rho_inf=rho_inf))
    return tp.Simulation(case, time_step=time_step)


@pytest.mark.parametrize("rho_inf", [0.0, 0.5, 1.0])
def test_free_fall_is_exact_from_the_first_step_on(rho_inf):
    """y = y_0 - g t^2 / 2 and v = -g t; without an acceleration at the start the first step would count half."""
    simulation = falling_drop(2e-3, rho_inf)
    wet = ~simulation.particles.wall
    start = simulation.particles.position[wet]
    for _ in range(5):
        simulation.step()
        t, particles = simulation.time, simulation.particles
        fallen = particles.position[wet] - start
        np.testing.assert_allclose(fallen, np.broadcast_to([0, -0.5 * 9.81 * t**2], fallen.shape), atol=1e-9 * 0.05)
        np.testing.assert_allclose(particles.velocity[wet, 1], -9.81 * t, rtol=1e-6)


def test_gravity_is_felt_in_the_shortest_of_steps():
    """Steps to times close to each other are far below the tolerance of Newton's method; accelerations are kept."""
    simulation = falling_drop(2e-3)
    wet = ~simulation.particles.wall
    for n in range(3):
        simulation.step(1.5 * simulation.instant * (n + 1))
    np.testing.assert_allclose(simulation.particles.velocity[wet, 1], -9.81 * simulation.time, rtol=1e-6)
    for _ in range(5):
        simulation.step()
    assert simulation.step_number == 8
    np.testing.assert_allclose(simulation.particles.velocity[wet, 1], -9.81 * simulation.time, rtol=1e-6)


def wave_at(dt, rho_inf):
    """Relative amplitude of a small wave of syrup under air at an eighth and at a quarter of its period.

    Stabilisation is of first order in time where c is not small. The steps are shorter than 2 T, see `flow_time`. The
    wave is too small for remeshing.
    """
    numerics = tp.Numerics(rho_inf=rho_inf, stabilisation=0.02, newton_tolerance=1e-11, acceleration_tolerance=1e-9)
    simulation = tp.Simulation(waves.build("syrup", 10, 2e-4, numerics), time_step=dt)
    start, found = waves.mode(simulation), []
    for end in (0.064, 0.128):
        simulation.run(end)
        found.append(waves.mode(simulation) / start)
    assert simulation.step_number == round(0.128 / dt)
    assert not sum(row["relocated"] for row in simulation.history)
    return np.array(found)


@pytest.mark.slow
@pytest.mark.parametrize("rho_inf", [0.0, 0.8])
def test_a_wave_is_second_order_in_time_from_its_start(rho_inf):
    """Halving the step quarters the change of the amplitude. Started without acceleration it would halve it."""
    courses = np.array([wave_at(dt, rho_inf) for dt in (0.004, 0.002, 0.001)])
    coarse, fine = np.abs(np.diff(courses, axis=0))
    assert (np.log2(coarse / fine) > 1.7).all(), courses


def vortex_from_rest(accelerated, dt):
    """Velocities of a vortex that a force sets off with a jerk, with or without its acceleration at the start."""
    vortex = Vortex(0.05, amplitude=lambda t: 0.05 * t, rate=lambda t: 0.05)
    fluid = tp.Fluid("fluid", density=1.0, viscosity=vortex.viscosity)
    particles = tp.tank((1, 1), 1 / 12, jitter=0.2).fill(fluid).sample([fluid])
    if accelerated:
        particles.acceleration = ~particles.wall[:, None] * vortex.acceleration(particles.position, 0.0)
    numerics = tp.Numerics(stabilisation=0.005 / dt, newton_tolerance=1e-10, acceleration_tolerance=1e-8)
    case = tp.Case(particles, [fluid], (0, 0), body_force=vortex.body_force, numerics=numerics)
    simulation = tp.Simulation(case, time_step=dt)
    simulation.run(0.064)
    assert simulation.step_number == round(0.064 / dt)
    return simulation


def test_a_flow_set_off_by_a_force_has_the_acceleration_of_the_closed_form():
    """After eight steps; one step that counts half would leave it 6 % behind."""
    found, given = (vortex_from_rest(accelerated, 0.008).particles.velocity for accelerated in (False, True))
    assert np.linalg.norm(found - given) < 0.01 * np.linalg.norm(given)


def test_accelerations_that_were_given_stay():
    """And a state that has them, with its pressures, is the same state."""
    simulation = vortex_from_rest(True, 0.004)
    again = tp.Simulation(simulation.case, time_step=0.004)
    state = again.solver.consistent(again.state, 0.004)
    np.testing.assert_array_equal(state.particles.acceleration, simulation.case.particles.acceleration)
    assert state.particles.pressure.any()
    assert again.solver.consistent(state, 0.004) is state
    assert simulation.solver.consistent(simulation.state, 0.004) is simulation.state


def test_velocities_with_divergence_leave_no_kick_in_the_acceleration():
    """What a step takes to make velocities free of divergence grows with 1 / dt, and is not an acceleration."""
    water = tp.Fluid("water", density=1000.0, viscosity=1e-3)
    particles = tp.tank((1, 1), 0.1, jitter=0.1).fill(water).sample([water])
    x = particles.position - 0.5
    inside = ~particles.wall
    swirl, source = 1e-3 * np.stack([-x[:, 1], x[:, 0]], axis=1), 1e-3 * x
    particles.velocity = (swirl + source) * (np.abs(x).max(axis=1) < 0.35)[:, None] * inside[:, None]
    simulation = tp.Simulation(tp.Case(particles, [water], (0, -9.81)), time_step=1e-3)
    start = simulation.solver.consistent(simulation.state, 1e-3).particles
    kick = simulation.solve(simulation.state, 1e-3).acceleration
    assert np.abs(start.acceleration).max() < 1e-2 * np.abs(kick).max()


def test_the_first_pressures_of_a_given_velocity_do_not_correct_it():
    """A steady vortex: pressure cos(pi x) cos(pi y) rho U^2, of which a first step of 1 ms missed 0.31 in the mean."""
    vortex = Vortex(viscosity=0.01)
    fluid = tp.Fluid("fluid", density=1.0, viscosity=vortex.viscosity)
    tank = tp.tank((1, 1), 0.05, jitter=0.2).fill(fluid, velocity=lambda x: vortex.velocity(x, 0.0))
    for side in tank.sides:
        tank.wall(side, law="no-slip")
    case = tp.Case(tank, [fluid], (0, 0), body_force=vortex.body_force)
    simulation = tp.Simulation(case, time_step=1e-3)
    given, mass = simulation.particles.velocity, simulation.state.mass
    states = [simulation.solver.consistent(simulation.state, 1e-3)]
    simulation.step()
    for state in (*states, simulation.state):
        pressure = np.cos(np.pi * state.particles.position).prod(axis=1)
        assert np.std(state.particles.pressure - pressure) < 0.035
    start = states[0].particles.velocity
    assert 1e-4 < np.sqrt(np.mean((start - given) ** 2)) < 3e-3
    lost = mass @ (given**2 - start**2).sum(axis=1)
    assert 0 < lost < 1e-4 * mass @ (given**2).sum(axis=1)


def test_a_velocity_that_is_free_of_divergence_on_any_mesh_stays():
    """A linear one of a free drop, to the bit; and one with divergence keeps both momenta of the drop."""
    fluid, gradient = tp.Fluid("fluid", density=1000.0, viscosity=1e-3), np.array([[1.0, -0.5], [0.5, -1.0]])
    for bent in (False, True):
        tank = tp.tank((1, 1), 0.05).fill(
            fluid, disc=([0.5, 0.5], 0.3), velocity=lambda x, b=bent: (x - 0.4) @ gradient.T + b * (x - 0.4) ** 2
        )
        simulation = tp.Simulation(tp.Case(tank, [fluid], (0, -9.81), free_surface=True), time_step=5e-3)
        before, state = simulation.particles, simulation.solver.divergence_free(simulation.state, 5e-3)
        assert (state.particles.velocity != before.velocity).any() == bent
        x, m = before.position, simulation.state.mass
        lost = m[:, None] * (state.particles.velocity - before.velocity)
        assert np.abs(lost.sum(axis=0)).max() <= 1e-7 * np.abs(lost).sum()
        assert abs((x[:, 0] * lost[:, 1] - x[:, 1] * lost[:, 0]).sum()) <= 1e-7 * np.abs(lost).sum()


def test_walls_that_accelerate_do_so_from_the_start():
    """A tank that is shaken: its walls have their own accelerations, and the water goes with them."""
    water = tp.Fluid("water", density=1000.0, viscosity=1e-3)
    motion = tp.Motion(translation=lambda t: (0.05 * t**2, 0.0))
    tank = tp.tank((1, 1), 0.1).fill(water)
    for side in ("left", "right", "bottom", "top"):
        tank.wall(side, law="no-slip")
    simulation = tp.Simulation(tp.Case(tank, [water], (0, -9.81), tank_motion=motion), time_step=1e-3)
    acceleration = simulation.solver.consistent(simulation.state, 1e-3).particles.acceleration
    np.testing.assert_allclose(acceleration, np.broadcast_to([0.1, 0.0], acceleration.shape), atol=1e-6)
