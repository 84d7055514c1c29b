"""The time T in the stabilisation's tau and between repairs of cells, and convergence in dt at fixed spacing."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from manufactured import Vortex

import tipfem as tp
from tipfem.remesh.stages import repairing
from tipfem.remesh.triangles.fitted import Repaired
from tipfem.step.solve import OF_FLOW, OF_GRAVITY, flow_time, steps_between_repairs

WATER = tp.Fluid("water", density=998.2, viscosity=1e-3)


def test_it_is_the_step_that_the_flow_asks_for():
    tank = tp.tank((1, 1), 0.1).fill(WATER)
    case = tp.Case(tank, [WATER], (0, -9.81))
    state = tp.Simulation(case).state
    assert flow_time(case, state) == pytest.approx(OF_GRAVITY * np.sqrt(0.1 / 9.81))
    calm = tp.Case(tp.tank((1, 1), 0.1).fill(WATER), [WATER], (0, 0))
    assert flow_time(calm, tp.Simulation(calm).state) == 0.0
    moving = tp.Case(tp.tank((1, 1), 0.1).fill(WATER, velocity=(3.0, 4.0)), [WATER], (0, 0))
    assert flow_time(moving, tp.Simulation(moving).state) == pytest.approx(OF_FLOW * 0.1 / 5.0)


@pytest.mark.parametrize("step", [1e-5, 1e-7])
def test_steps_far_shorter_than_that_are_solved_in_as_many_iterations(step):
    """As those of a splashing flow are after refusals; with T itself they would take twice as many."""
    air = tp.Fluid("air", density=1.2, viscosity=1.8e-5)
    tank = tp.tank((0.584, 0.584), 0.04).fill(air).fill(WATER, box=((0, 0), (0.146, 0.292)))
    simulation = tp.Simulation(tp.Case(tank, [WATER, air], (0, -9.81)), time_step=2e-3)
    for _ in range(10):
        simulation.step()
    simulation.step(simulation.time + step)
    taken = simulation.history[-1]
    assert taken["refused_steps"] == 0
    assert taken["time_step"] == pytest.approx(step)
    assert taken["krylov_iterations"] <= 24 * taken["newton_iterations"]


def test_a_tank_that_begins_to_turn_has_the_energy_of_the_potential_flow():
    """Without gravity, from rest, a turn so slow that h / v is 500 s.

    The moment of inertia of a fluid in a rectangle is that of the rectangle less the torsion constant of its section.
    """
    a, b, rate = 1.0, 0.5, 1e-3
    tank = tp.tank((a, b), 0.05, jitter=0.2).fill(WATER)
    for side in tank.sides:
        tank.wall(side, slip=True)
    turn = tp.Motion(angle=lambda t: rate * t**3, pivot=(a / 2, b / 2))
    simulation = tp.Simulation(tp.Case(tank, [WATER], (0, 0), tank_motion=turn), time_step=4e-3)
    for _ in range(40):
        simulation.step()
    assert flow_time(simulation.case, simulation.state) < 0.2
    n = np.arange(1, 20, 2)
    torsion = a * b**3 / 3 * (1 - 192 / np.pi**5 * b / a * (np.tanh(n * np.pi * a / (2 * b)) / n**5).sum())
    inertia = WATER.density * (a * b * (a**2 + b**2) / 12 - torsion)
    exact = 0.5 * inertia * (3 * rate * simulation.time**2) ** 2
    assert simulation.energy().kinetic == pytest.approx(exact, rel=0.02)


def simulated(vortex, time_step, cells, end):
    """A vortex of density 1 after some time, from its exact state at t = 0; and which particles kept their places."""
    fluid = tp.Fluid("fluid", density=1.0, viscosity=vortex.viscosity)
    particles = tp.tank((1, 1), 1 / cells, jitter=0.2).fill(fluid).sample([fluid])
    free = ~particles.wall[:, None]
    particles.velocity = free * vortex.velocity(particles.position, 0.0)
    particles.acceleration = free * vortex.acceleration(particles.position, 0.0)
    case = tp.Case(particles, [fluid], (0, 0), body_force=vortex.body_force)
    simulation = tp.Simulation(case, time_step=time_step)
    kept = np.ones(len(particles), dtype=bool)
    while simulation.time < end - 1e-12:
        simulation.step(end)
        kept &= ~simulation.state.relocated
    return simulation, kept


def roughness(simulation):
    """RMS of a particle's pressure less the linear fit to its neighbours'."""
    particles, rest = simulation.particles, []
    x, p = particles.position, particles.pressure
    i, j = simulation.mesh.edges.T
    for a in np.flatnonzero(~particles.wall):
        around = np.concatenate([j[i == a], i[j == a]])
        fit = np.column_stack([np.ones(len(around)), x[around] - x[a]])
        rest.append(p[a] - np.linalg.lstsq(fit, p[around], rcond=None)[0][0])
    return float(np.sqrt(np.mean(np.square(rest))))


def test_the_pressure_of_short_steps_is_as_smooth_as_that_of_long_ones():
    """T is 4.6 ms here. With tau = c dt^2 roughness would triple from 8 to 1 ms."""
    rough = [roughness(simulated(Vortex(viscosity=0.01), dt, 20, 0.032)[0]) for dt in (8e-3, 4e-3, 1e-3)]
    assert max(rough) < 1.15 * min(rough)


@pytest.mark.slow
def test_velocities_are_of_second_order_in_dt_with_remeshing():
    """Default settings, a vortex to and fro; with tau = c dt^2 the changes would stay as they are."""
    rate = np.pi / 0.064
    vortex = Vortex(0.01, lambda t: 0.5 * (1 - np.cos(rate * t)), lambda t: 0.5 * rate * np.sin(rate * t))
    runs = [simulated(vortex, dt, 20, 0.128) for dt in (4e-3, 2e-3, 1e-3)]
    assert [len(run.history) for run, _ in runs] == [32, 64, 128]
    kept = np.all([places for _, places in runs], axis=0)
    velocity = [run.particles.velocity for run, _ in runs]
    change = [np.sqrt(np.mean((a - b)[kept] ** 2)) for a, b in itertools.pairwise(velocity)]
    assert min(np.log2(np.array(change[:-1]) / change[1:])) > 1.8, change


def at_full_speed(time_step, end):
    """A vortex at full speed from t = 0 on, whose accelerations are found by the first step; and as `simulated`."""
    vortex = Vortex(viscosity=0.01)
    fluid = tp.Fluid("fluid", density=1.0, viscosity=vortex.viscosity)
    tank = tp.tank((1, 1), 1 / 20, jitter=0.2).fill(fluid, velocity=lambda x: vortex.velocity(x, 0.0))
    for side in tank.sides:
        tank.wall(side, law="no-slip")
    case = tp.Case(tank, [fluid], (0, 0), body_force=vortex.body_force)
    simulation = tp.Simulation(case, time_step=time_step)
    kept = np.ones(len(simulation.particles), dtype=bool)
    while simulation.time < end - 1e-12:
        simulation.step(end)
        kept &= ~simulation.state.relocated
    return simulation.particles.velocity, kept


def changes(runs):
    """RMS of the changes from each run to the next, of velocities of particles that were not relocated in any."""
    kept = np.all([places for _, places in runs], axis=0)
    return np.array([np.sqrt(np.mean((a - b)[kept] ** 2)) for (a, _), (b, _) in itertools.pairwise(runs)])


@pytest.mark.slow
def test_a_vortex_at_full_speed_from_the_start_is_of_second_order_in_dt(monkeypatch):
    """With the cells kept. T is 4.6 ms: Newton's tolerance follows shorter steps, or its errors would be left."""

    def kept(particles, mesh, *_, **__):
        return Repaired(particles, mesh.moved(particles.position), np.zeros(len(particles), dtype=bool))

    monkeypatch.setattr(repairing, "repair", kept)
    change = changes([at_full_speed(dt, 0.064) for dt in (8e-3, 4e-3, 2e-3, 1e-3, 5e-4)])
    assert np.log2(change[0] / change[-1]) / 3 > 1.9, change
    assert change[-1] < 1e-5


@pytest.mark.slow
def test_a_vortex_at_full_speed_has_an_order_in_dt_above_one_with_remeshing():
    """Flips at times that do not depend on dt; with a repair after every step the last change would be 1e-4.

    With the energy of every flip balanced the changes would be 4e-4 for any dt.
    """
    change = changes([at_full_speed(dt, 0.064) for dt in (8e-3, 4e-3, 2e-3, 1e-3, 5e-4)])
    assert np.log2(change[0] / change[-1]) / 3 > 1.4, change
    assert change[-1] < 3e-5


@pytest.mark.slow
def test_the_cells_are_repaired_at_times_that_do_not_depend_on_the_step(monkeypatch):
    """T is 4.6 ms by the body force, and 17 ms by the speed."""
    repaired, repair = [], repairing.repair

    def recorded(particles, mesh, *arguments, keep_cells, **others):
        repaired.append(not keep_cells)
        result = repair(particles, mesh, *arguments, keep_cells=keep_cells, **others)
        assert repaired[-1] or np.array_equal(result.mesh.cells, mesh.cells)
        return result

    monkeypatch.setattr(repairing, "repair", recorded)
    for dt in (8e-3, 4e-3, 2e-3, 1e-3):
        repaired.clear()
        at_full_speed(dt, 0.016)
        after = dt * (np.flatnonzero(repaired) + 1)
        assert after == pytest.approx(np.arange(1, len(after) + 1) * max(dt, 4e-3))
        assert after[-1] == pytest.approx(0.016)


def test_the_cells_are_repaired_after_each_step_of_the_length_that_the_flow_asks_for():
    case = tp.Case(tp.tank((1, 1), 0.1).fill(WATER), [WATER], (0, -9.81))
    state, frequency = tp.Simulation(case).state, case.natural_frequency()
    longest = OF_GRAVITY / frequency
    lengths = np.array([2.0, 1.0, 0.51, 0.49, 0.26, 0.24]) * longest
    assert [steps_between_repairs(state, dt, frequency) for dt in lengths] == [1, 1, 1, 2, 2, 4]
    moving = tp.Case(tp.tank((1, 1), 0.1).fill(WATER, velocity=(3.0, 4.0)), [WATER], (0, 0))
    assert steps_between_repairs(tp.Simulation(moving).state, 0.24 * OF_FLOW * 0.1 / 5.0, 0.0) == 4
    calm = tp.Case(tp.tank((1, 1), 0.1).fill(WATER), [WATER], (0, 0))
    assert steps_between_repairs(tp.Simulation(calm).state, 1e-6, 0.0) == 1


def test_steps_in_which_gravity_is_lost_are_refused():
    case = tp.Case(tp.tank((1, 1), 0.1).fill(WATER), [WATER], (0, -9.81))
    with pytest.raises(ValueError, match="time step is 5e-08 s; it must be 1e-07 s or more"):
        tp.Simulation(case, time_step=5e-8)
