"""Forces on walls with openings."""

from __future__ import annotations

import pytest

import tipfem as tp

WATER = tp.Fluid("water", 1000.0, 1e-3)
HEIGHT, WIDTH = 0.2, 0.3


@pytest.mark.parametrize("law", ["no-slip", "slip"])
@pytest.mark.parametrize("kind", ["outlet", "inlet"])
@pytest.mark.parametrize("between", [(0.0, 0.1), (0.06, 0.16)])
def test_the_force_on_a_wall_at_rest_is_that_on_what_is_closed(law, kind, between):
    low, high = between
    tank = tp.tank((WIDTH, HEIGHT), 0.02).fill(WATER)
    for side in tank.sides:
        tank.wall(side, **({"slip": True} if law == "slip" else {"law": law}))
    line = ((WIDTH, low), (WIDTH, high))
    if kind == "outlet":
        openings = [tp.Outlet(wall="right", between=line, pressure=lambda x, t: 9810.0 * (HEIGHT - x[:, 1]))]
    else:
        vent = tp.Vent(wall="top", between=((0.04, HEIGHT), (0.16, HEIGHT)))
        openings = [tp.Inlet(wall="right", between=line, fluid=WATER, velocity=0.0), vent]
    case = tp.Case(tank, [WATER], (0, -9.81), openings=openings)
    probes = [tp.WallForce(name=name, wall=name) for name in ("right", "left")]
    simulation = tp.Simulation(case, time_step=5e-3, probes=probes)
    for _ in range(3):
        simulation.step()
    right, left = (simulation.probes[name]["pressure_force_x"][-1] for name in ("right", "left"))
    whole = 0.5 * 9810.0 * HEIGHT**2
    through = 9810.0 * (HEIGHT * (high - low) - 0.5 * (high**2 - low**2))
    assert left == pytest.approx(-whole, rel=1e-6)
    assert right == pytest.approx(whole - through, rel=1e-6)
    last = simulation.history[-1]
    assert last["opening_force_x"] == pytest.approx(-through, rel=1e-6)
    assert last["wall_force_x"] == pytest.approx(through, rel=1e-6)
