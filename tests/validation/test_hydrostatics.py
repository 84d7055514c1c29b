"""Layers at rest: pressure is hydrostatic, and stays so."""

from __future__ import annotations

import numpy as np
import pytest

import tipfem as tp
from tipfem.mesh import measures


@pytest.mark.parametrize(("interface", "tolerance"), [("interpolated", 0.025), ("sharp", 1e-9)])
@pytest.mark.parametrize("jitter", [0.0, 0.2])
@pytest.mark.parametrize("pair", ["water under air", "glycerin under water"])
def test_pressure_is_hydrostatic(pair, jitter, interface, tolerance, water, air, glycerin):
    """For 20 steps within 2.5 % of the largest pressure or, with a sharp interface, to round-off."""
    lower, upper = (water, air) if pair == "water under air" else (glycerin, water)
    size = 0.1
    filled = tp.tank((size, size), size / 20, jitter=jitter).fill(upper).fill(lower, box=((0, 0), (size, size / 2)))
    simulation = tp.Simulation(tp.Case(filled, [lower, upper], (0, -9.81), interface=interface), time_step=1e-3)
    height = simulation.particles.position[:, 1]
    for _ in range(20):
        simulation.step()
        particles = simulation.particles
        height = particles.position[:, 1]
        exact = measures.hydrostatic_pressure(height, [(lower, size / 2), (upper, size / 2)])
        assert np.abs(particles.pressure - exact).max() < tolerance * exact.max()
    # The density that the pressure's gradient shows, away from the interface.
    for fluid, band in ((lower, (0.0, 0.35)), (upper, (0.65, 1.0))):
        inside = (height > band[0] * size) & (height < band[1] * size)
        gradient = np.polyfit(height[inside], particles.pressure[inside], 1)[0]
        assert gradient == pytest.approx(-fluid.density * 9.81, rel=0.02, abs=0.02 * exact.max() / size)


def test_one_fluid_at_rest_is_exact(water):
    """Linear pressure is in the space of the elements: one fluid stays at rest to round-off."""
    case = tp.Case(tp.tank((0.1, 0.1), 0.01, jitter=0.2).fill(water), [water], (0, -9.81))
    simulation = tp.Simulation(case, time_step=1e-3)
    for _ in range(5):
        simulation.step()
    particles = simulation.particles
    exact = measures.hydrostatic_pressure(particles.position[:, 1], [(water, 0.1)])
    # The accuracy that the solver is asked for, not that of the elements, is what is left.
    assert np.abs(particles.pressure - exact).max() < 1e-3 * exact.max()
    assert np.abs(particles.velocity).max() < 1e-5


@pytest.mark.slow
def test_pressure_stays_calm_while_remeshing_stirs_the_interface(water, air):
    """Half a second of water under air: the volume source must not turn the noise of remeshing into pressure."""
    filled = tp.tank((0.4, 0.4), 0.02).fill(air).fill(water, box=((0, 0), (0.4, 0.2)))
    simulation = tp.Simulation(tp.Case(filled, [water, air], (0, -9.81)))
    corner = int(np.argmin(np.abs(simulation.particles.position).sum(axis=1)))
    pressure, volume = [], []
    while simulation.time < 0.5:
        simulation.step(0.5)
        pressure.append(simulation.particles.pressure[corner] / (9.81 * 0.2 * (water.density + air.density)))
        volume.append(simulation.volume("water") / 0.08 - 1)
    assert np.median(pressure) == pytest.approx(1, abs=0.01)
    assert np.percentile(np.abs(np.array(pressure) - 1), 90) < 0.1
    assert np.abs(volume).max() < 0.01
    assert np.linalg.norm(simulation.particles.velocity[simulation.particles.fluid == 0], axis=1).max() < 0.2


def test_gravity_may_come_as_a_body_force(water, air):
    """The zero of pressure, the default step and the volume source follow what acts, not what it is called."""
    filled = tp.tank((0.1, 0.1), 0.01).fill(air).fill(water, box=((0, 0), (0.1, 0.05)))
    states = []
    for options in ({"gravity": (0, -9.81)}, {"gravity": (0, 0), "body_force": lambda x, t: x * 0 + (0.0, -9.81)}):
        simulation = tp.Simulation(tp.Case(filled, [water, air], **options))
        for _ in range(5):
            simulation.step()
        states.append(simulation.particles)
    np.testing.assert_array_equal(states[0].position, states[1].position)
    np.testing.assert_array_equal(states[0].pressure, states[1].pressure)
