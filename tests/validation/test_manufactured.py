"""Orders of convergence in space and time, for a vortex known in closed form."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from manufactured import Vortex

import tipfem as tp


def simulate(vortex, cells, time_step, end, *, jitter, interface="interpolated", **numerics):
    """Run the vortex in the unit square on ``cells`` spacings a side, from its exact state at t = 0."""
    fluid = tp.Fluid("fluid", density=1.0, viscosity=vortex.viscosity)
    particles = tp.tank((1, 1), 1 / cells, jitter=jitter).fill(fluid).sample([fluid])
    off_wall = ~particles.wall[:, None]
    particles.velocity = off_wall * vortex.velocity(particles.position, 0.0)
    particles.acceleration = off_wall * vortex.acceleration(particles.position, 0.0)
    case = tp.Case(
        particles, [fluid], (0, 0), body_force=vortex.body_force, interface=interface, numerics=tp.Numerics(**numerics)
    )
    simulation = tp.Simulation(case, time_step=time_step)
    while simulation.time < end:
        simulation.step(end)
    return simulation


@pytest.mark.slow
@pytest.mark.parametrize(("interface", "jitter"), [("interpolated", 0.0), ("interpolated", 0.2), ("sharp", 0.2)])
def test_second_order_in_space(interface, jitter):
    """Velocity converges at the order 2 of linear elements, within 0.2, through remeshing and relocation.

    Repaired in place, the coarsest mesh is worse than the finer ones would have it: only the last order counts.
    """
    vortex = Vortex(viscosity=0.05)
    errors, relocated = [], 0
    for cells in (16, 32, 64):
        simulation = simulate(
            vortex, cells, 0.4 / cells, 0.2, jitter=jitter, interface=interface, acceleration_tolerance=1e-6
        )
        particles = simulation.particles
        wrong = particles.velocity - vortex.velocity(particles.position, simulation.time)
        errors.append(np.sqrt((wrong**2).sum(axis=1).mean()))
        relocated += sum(row["relocated"] for row in simulation.history)
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert relocated > 20
    counted = orders if interface == "interpolated" else orders[1:]
    assert np.abs(counted - 2).max() < 0.2, (errors, orders)


@pytest.mark.slow(but=("1.0",))
@pytest.mark.parametrize("rho_inf", [0.0, 0.5, 1.0])
def test_second_order_in_time(rho_inf):
    """Halving the step quarters the change of the solution.

    The mesh keeps its edges (the flow is slow), and c dt is kept constant, so that the problem in
    space that the steps solve is the same for all of them. The flow starts smoothly from rest.
    """
    amplitude, frequency, end = 0.004, 20.0, 0.16
    vortex = Vortex(
        0.05,
        amplitude=lambda t: amplitude * (1 - np.cos(frequency * t)),
        rate=lambda t: amplitude * frequency * np.sin(frequency * t),
    )
    velocities = []
    for dt in (0.008, 0.004, 0.002):
        simulation = simulate(
            vortex,
            12,
            dt,
            end,
            jitter=0.2,
            rho_inf=rho_inf,
            stabilisation=0.005 / dt,
            newton_tolerance=1e-10,
            acceleration_tolerance=1e-8,
        )
        assert len(simulation.history) == round(end / dt)
        velocities.append(simulation.particles.velocity)
    coarse, fine = (np.linalg.norm(a - b) for a, b in itertools.pairwise(velocities))
    # The accelerations at the start, which are found from two short steps, take a little of the order.
    assert abs(np.log2(coarse / fine) - 2) < 0.25
