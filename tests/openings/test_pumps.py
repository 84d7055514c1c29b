"""Pumps by their head."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import tipfem as tp
from tipfem.mesh.measures import depth
from tipfem.physics.openings.lines import OpeningLines
from tipfem.physics.openings.passed import Passed

WATER = tp.Fluid("water", 1000.0, 1e-3)
SYRUP = tp.Fluid("syrup", 1.0, 0.01)


def curve(discharge):
    """Head over discharge [m]."""
    return 0.1 * (1 - discharge / 0.05)


def test_a_pump_draws_by_its_head():
    """The pressure in the middle of its drain, of total heads; and nothing passes before one is known."""
    there = {"wall": "top", "between": ((0.1, 0.2), (0.2, 0.2)), "fluid": SYRUP, "pump": "drain", "name": "pump"}
    drain = tp.Outlet(wall="bottom", between=((0.2, 0.0), (0.4, 0.0)), name="drain")
    pump = tp.Inlet(**there, head=lambda q: 3.0 - 10 * q)
    tank = tp.tank((0.6, 0.2), 0.02).fill(SYRUP)
    case = tp.Case(tank, [SYRUP], (0, -10.0), openings=[drain, pump, tp.Outlet(wall="left")])
    openings, part = OpeningLines(case), Passed.nothing(3, 1)
    assert openings.setting(part, 0.0).closed.tolist() == [True, False, False]
    part = dataclasses.replace(part, pressure=np.array([0.0, 40.0, 0.0]), rate=np.array([-0.1, 0.1, 0.0]))
    setting, rho = openings.setting(part, 0.0), SYRUP.density
    assert setting.drawn[0] == pytest.approx(40.0 + rho * (10 * (0.2 - 2.0) + 0.5 * (1.0**2 - 0.5**2)))
    assert setting.discharge(1)(0.0) == 0.1
    with pytest.raises(ValueError, match="head is a height of fluid, which weighs nothing here; give gravity"):
        tp.Case(tank, [SYRUP], (0, 0), openings=[drain, pump, tp.Outlet(wall="left")])
    with pytest.raises(ValueError, match="head is that of a pump of one fluid; name the outlet that it draws from"):
        tp.Inlet(wall="left", fluid=SYRUP, velocity=1.0, head=1.0)


@pytest.mark.slow
def test_a_pump_raises_water_by_its_head_over_a_wall():
    """Two basins: the pump stops when the levels differ by its head where nothing flows."""
    corners = [(0, 0), (0.3, 0), (0.3, 0.44), (0.36, 0.44), (0.36, 0), (0.66, 0), (0.66, 0.5), (0, 0.5)]
    names = ["basin", "before", "crest", "behind", "tub", "right", "roof", "left"]
    tank = tp.tank(shape=tp.shapes.polygon(corners, names=names), spacing=0.02)
    tank.fill(WATER, box=((0, 0), (0.3, 0.2))).fill(WATER, box=((0.36, 0), (0.66, 0.2)))
    for name in names:
        tank.wall(name, slip=True)
    openings = [
        tp.Outlet(wall="basin", between=((0.1, 0), (0.2, 0)), name="drain"),
        tp.Inlet(
            wall="tub", fluid=WATER, between=((0.46, 0), (0.56, 0)), pump="drain", ramp=0.2, head=curve, name="up"
        ),
    ]
    case = tp.Case(tank, [WATER], (0, -9.81), openings=openings, free_surface=True)
    simulation = tp.Simulation(case, time_step=5e-3)
    simulation.run(until=2.5, progress=False)
    levels = [
        np.mean([depth(simulation.mesh, simulation.particles.fluid, 0, x) for x in np.linspace(a, a + 0.26, 9)])
        for a in (0.02, 0.38)
    ]
    assert levels[1] - levels[0] == pytest.approx(0.1, rel=0.02)
