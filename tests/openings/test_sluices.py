"""Jets from below a gate, whose outlets pinch off pockets of air: linear solves stalled there."""

from __future__ import annotations

import numpy as np
import pytest

import tipfem as tp

WATER = tp.Fluid("water", density=1000.0, viscosity=1e-3)
AIR = tp.Fluid("air", density=1.2, viscosity=1.8e-5)
LENGTH, HEIGHT, GATE, LIP, DEPTH = 1.0, 0.4, 0.5, 0.075, 0.3  # [m]
FEEDS = {
    "discharge": tp.Inlet(wall="in", between=((0, 0), (0, 0.2)), fluid=WATER, discharge=0.085, ramp=0.4),
    "level": tp.Outlet(wall="in", level=DEPTH, fluid=WATER, direction="free"),
}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("feed", "direction", "blunt"),
    [("discharge", "normal", True), ("discharge", "normal", False), ("level", "free", False)],
)
def test_a_jet_below_a_gate_leaves_by_an_outlet(feed, direction, blunt):
    behind = LIP if blunt else 1.5 * LIP
    corners = [(0, 0), (LENGTH, 0), (LENGTH, HEIGHT), (GATE + 0.025, HEIGHT), (GATE + 0.025, behind)]
    corners += [(GATE, LIP), (GATE, HEIGHT), (0, HEIGHT)]
    names = ["floor", "out", "roof_behind", "back", "lip", "plate", "roof", "in"]
    tank = tp.tank(shape=tp.shapes.polygon(corners, names=names), spacing=0.0125).fill(AIR)
    tank.fill(WATER, box=((0, 0), (GATE, DEPTH))).fill(WATER, box=((GATE, 0), (LENGTH, 0.4 * LIP)))
    for name in names:
        tank.wall(name, slip=True)
    openings = [
        FEEDS[feed],
        tp.Outlet(wall="out", direction=direction),
        tp.Vent(wall="roof", between=((0.1, HEIGHT), (0.3, HEIGHT))),
        tp.Vent(wall="roof_behind", between=((0.6, HEIGHT), (0.8, HEIGHT)), name="behind"),
    ]
    simulation = tp.Simulation(tp.Case(tank, [WATER, AIR], (0, -9.81), openings=openings), time_step=5e-3)
    start = simulation.state.volume.copy()
    while simulation.time < 1.1:
        simulation.step(1.1)
    passed = simulation.state.parts["openings"].total
    assert simulation.state.volume - start == pytest.approx(passed.sum(axis=0), abs=1e-12)
    assert passed[1, 0] < -0.04
    assert sum(row["refused_steps"] for row in simulation.history) < 10
    assert simulation.particles.max_speed < 10
    # Of what the reservoir sends, next to nothing is air.
    assert abs(passed[0, 1]) < 0.06 * passed[0, 0] + 1e-12
    assert np.isfinite(simulation.particles.pressure).all()
