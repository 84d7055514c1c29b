"""Water that runs over corners of walls that slip, into empty space."""

from __future__ import annotations

import numpy as np
import pytest

import tipfem as tp

WATER = tp.Fluid("water", 1000.0, 1e-3)
EDGE, FLOOR, DEPTH = 0.4, 0.12, 0.06
NAMES = ["floor", "face", "bottom", "end", "roof", "in"]


def ledge(spacing, law):
    """A tank whose floor ends at a brink, above a pit."""
    corners = [(0, FLOOR), (EDGE, FLOOR), (EDGE, 0), (1.0, 0), (1.0, 0.24), (0, 0.24)]
    tank = tp.tank(shape=tp.shapes.polygon(corners, names=NAMES), spacing=spacing)
    for name in NAMES:
        tank.wall(name, law=law, slip=law is None)
    return tank


@pytest.mark.slow
@pytest.mark.parametrize("law", [None, "layer"])
def test_a_supercritical_flow_falls_over_a_brink(law):
    """The depth there is F^2 / (F^2 + 0.4) of that before it, by W. H. Hager (J. Hydraul. Eng. 109, 1983)."""
    speed = 2 * np.sqrt(9.81 * DEPTH)
    tank = ledge(DEPTH / 4, law).fill(WATER, box=((0, FLOOR), (EDGE, FLOOR + DEPTH)), velocity=(speed, 0))
    openings = [
        tp.Inlet(between=((0, FLOOR), (0, FLOOR + DEPTH)), fluid=WATER, velocity=speed),
        tp.Outlet(wall="bottom"),
    ]
    case = tp.Case(tank, [WATER], (0, -9.81), openings=openings, free_surface=True)
    probe = tp.WaveGauge(name="brink", x=EDGE - 1e-3, fluid="water")
    simulation = tp.Simulation(case, time_step=4e-3, probes=[probe])
    while simulation.time < 0.5:
        simulation.step(0.5)
        row = simulation.history[-1]
        if simulation.time < 0.18:  # it falls: what is put back into the corner does not pass the outlet
            assert abs(row["through_outlet_bottom_water"]) < 1e-4 * row["through_inlet_water"]
        assert abs(row["energy_residual"]) < 1e-10 * row["kinetic_energy"]
    assert simulation.state.volume[0] == pytest.approx(simulation.state.wanted_volume[0], rel=1e-13)
    time, depth = (np.asarray(simulation.probes["brink"][key]) for key in ("time", "depth"))
    found = depth[time > 0.3].mean() / DEPTH
    assert found == pytest.approx(4 / 4.4, rel=0.05)  # 1.16 if the particle in the corner is held
    corner = np.linalg.norm(simulation.particles.position - [EDGE, FLOOR], axis=1).argmin()
    velocity = simulation.particles.velocity[corner]
    # The pressure on the floor has become speed.
    assert velocity[0] == pytest.approx(np.sqrt(speed**2 + 2 * 9.81 * DEPTH), rel=0.15)
    assert velocity[1] == 0
    np.testing.assert_allclose(simulation.particles.position[corner], [EDGE, FLOOR], atol=1e-12)


def test_a_pool_that_ends_at_a_brink_stays_at_rest():
    tank = ledge(0.02, None).fill(WATER, box=((EDGE, 0), (1.0, FLOOR)))
    simulation = tp.Simulation(tp.Case(tank, [WATER], (0, -9.81), free_surface=True), time_step=4e-3)
    for _ in range(20):
        simulation.step()
    assert simulation.particles.max_speed < 1e-9


def test_water_leaves_a_sharp_crest_at_its_speed():
    """Behind a plate of 0.1 m whose back is steep, with 0.06 m above it; held, the particle there had no speed."""
    corners = [(0, 0), (0.3, 0), (0.3, 0.1), (0.34, -0.02), (0.6, -0.02), (0.6, 0.24), (0, 0.24)]
    tank = tp.tank(shape=tp.shapes.polygon(corners, names=["a", "b", "c", "d", "e", "f", "g"]), spacing=0.015)
    for name in "abcdefg":
        tank.wall(name, slip=True)
    case = tp.Case(tank.fill(WATER, box=((0, 0), (0.3, 0.16))), [WATER], (0, -9.81), free_surface=True)
    simulation, speeds = tp.Simulation(case, time_step=4e-3), []
    while simulation.time < 0.16:
        simulation.step()
        row = simulation.history[-1]
        crest = np.linalg.norm(simulation.particles.position - [0.3, 0.1], axis=1).argmin()
        speeds.append(np.linalg.norm(simulation.particles.velocity[crest]))
        assert abs(row["energy_residual"]) < 1e-9 * max(row["kinetic_energy"], 1e-3)
    assert simulation.particles.position[crest] == pytest.approx([0.3, 0.1], abs=1e-12)
    assert max(speeds) > 0.2 * np.sqrt(2 * 9.81 * 0.06)
    assert simulation.state.volume[0] == pytest.approx(simulation.state.wanted_volume[0], rel=1e-12)
