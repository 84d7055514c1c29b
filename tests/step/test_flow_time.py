"""The time T in the stabilisation's tau: what it is, and that the pressure does not depend on shorter steps."""

from __future__ import annotations

import numpy as np
import pytest
from manufactured import Vortex

import tipfem as tp
from tipfem.step.solve import OF_FLOW, OF_GRAVITY, flow_time

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


def roughness(time_step, cells=10, end=0.012):
    """RMS of a particle's pressure less the linear fit to its neighbours', in a vortex with U = 1 m/s, density 1."""
    vortex, fluid = Vortex(viscosity=0.01), tp.Fluid("fluid", density=1.0, viscosity=0.01)
    particles = tp.tank((1, 1), 1 / cells, jitter=0.2).fill(fluid).sample([fluid])
    free = ~particles.wall[:, None]
    particles.velocity = free * vortex.velocity(particles.position, 0.0)
    particles.acceleration = free * vortex.acceleration(particles.position, 0.0)
    case = tp.Case(particles, [fluid], (0, 0), body_force=vortex.body_force)
    simulation = tp.Simulation(case, time_step=time_step)
    while simulation.time < end - 1e-12:
        simulation.step(end)
    x, p, rest = simulation.particles.position, simulation.particles.pressure, []
    i, j = simulation.mesh.edges.T
    for a in np.flatnonzero(~particles.wall):
        around = np.concatenate([j[i == a], i[j == a]])
        fit = np.column_stack([np.ones(len(around)), x[around] - x[a]])
        rest.append(p[a] - np.linalg.lstsq(fit, p[around], rcond=None)[0][0])
    return float(np.sqrt(np.mean(np.square(rest))))


def test_the_pressure_of_short_steps_is_as_smooth_as_that_of_long_ones():
    """Eight times as many steps; with tau = c dt^2 it would be twice as rough and more."""
    assert roughness(5e-4) < 1.15 * roughness(4e-3)


def test_steps_in_which_gravity_is_lost_are_refused():
    case = tp.Case(tp.tank((1, 1), 0.1).fill(WATER), [WATER], (0, -9.81))
    with pytest.raises(ValueError, match="time step is 5e-08 s; it must be 1e-07 s or more"):
        tp.Simulation(case, time_step=5e-8)
