"""Runs with the sharp interface: fluids at rest stay at rest, and a drop keeps its volume."""

from __future__ import annotations

import numpy as np
import pytest

import tipfem as tp
from tipfem.mesh import measures


def pair_of(name, water, air, glycerin) -> list[tp.Fluid]:
    """Lower and upper fluid."""
    return [water, air] if name == "water under air" else [glycerin, water]


def at_rest(fluids, degrees: float = 0.0, spacing: float = 0.1) -> tp.Simulation:
    """Two layers on a jittered mesh, gravity and interface tilted."""
    lower, upper = fluids
    angle = np.deg2rad(degrees)
    gravity = 9.81 * np.array([np.sin(angle), -np.cos(angle)])
    tank = tp.tank((1, 1), spacing, jitter=0.2).fill(upper)
    if degrees:
        tank.fill(lower, where=lambda x: (x - [0.5, 0.47]) @ gravity > 0)
    else:
        tank.fill(lower, box=((0, 0), (1, 0.5)))
    return tp.Simulation(tp.Case(tank, fluids, gravity, interface="sharp"), time_step=1e-3)


PAIRS = ["water under air", "glycerin under water"]


@pytest.mark.parametrize("degrees", [0.0, 10.0])
@pytest.mark.parametrize("pair", PAIRS)
def test_layers_at_rest_stay_at_rest(pair, degrees, water, air, glycerin):
    """On any mesh, to round-off: also where the interface meets the walls between their particles."""
    fluids = pair_of(pair, water, air, glycerin)
    simulation = at_rest(fluids, degrees)
    for _ in range(4):  # the first repair, which steps of this length wait for, may find particles that crowd others
        simulation.step()
    start = simulation.particles.position.copy()
    fastest = 0.0
    for _ in range(46):
        simulation.step()
        fastest = max(fastest, simulation.particles.max_speed)
        assert simulation.history[-1]["relocated"] == 0
    assert fastest < 1e-9
    np.testing.assert_allclose(simulation.particles.position, start, atol=1e-10)
    if not degrees:
        exact = measures.hydrostatic_pressure(simulation.particles.position[:, 1], [(f, 0.5) for f in fluids])
        np.testing.assert_allclose(simulation.particles.pressure, exact, atol=1e-5 * exact.max())
        assert simulation.volume(fluids[0].name) == pytest.approx(0.5, rel=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize("pair", PAIRS)
def test_layers_stay_at_rest_for_long(pair, water, air, glycerin):
    simulation = at_rest(pair_of(pair, water, air, glycerin), spacing=0.05)
    volume = [simulation.volume(f.name) for f in simulation.case.fluids]
    for _ in range(2000):
        simulation.step()
        assert simulation.particles.max_speed < 1e-9
    np.testing.assert_allclose([simulation.volume(f.name) for f in simulation.case.fluids], volume, rtol=1e-12)


def test_a_drop_that_falls_keeps_its_volume(water, air):
    tank = tp.tank((1, 1), 0.08).fill(air).fill(water, disc=((0.5, 0.6), 0.2))
    simulation = tp.Simulation(tp.Case(tank, [water, air], (0, -9.81), interface="sharp"))
    volume, height = simulation.volume("water"), measures.extent(simulation.mesh, simulation.particles.fluid, 0, 1)
    while simulation.time < 0.15:
        simulation.step()
        assert simulation.volume("water") == pytest.approx(volume, rel=1e-9)
        assert simulation.volume("air") == pytest.approx(1.0 - volume, rel=1e-9)
    fell = height - measures.extent(simulation.mesh, simulation.particles.fluid, 0, 1)
    assert 0.5 * 0.5 * 9.81 * 0.15**2 < fell < 1.05 * 0.5 * 9.81 * 0.15**2
