"""Surface tension and openings: interfaces and drops that enter and leave."""

from __future__ import annotations

import numpy as np
import pytest

import tipfem as tp

WATER = tp.Fluid("water", 1000.0, 1e-3)
OIL = tp.Fluid("oil", 900.0, 0.05)
SPEED = 0.1
EXACT = tp.Numerics(newton_tolerance=1e-11)


def channel(fill, tension=0.03):
    """Oil that flows from the left to the right, with water in it that ``fill`` puts there."""
    tank = tp.tank((0.012, 0.006), spacing=0.0006).fill(OIL, velocity=(SPEED, 0))
    tank.fill(WATER, velocity=(SPEED, 0), **fill)
    for side in ("bottom", "top"):
        tank.wall(side, slip=True)
    fluid = OIL if "disc" in fill else lambda x, t: np.where(x[:, 1] < 0.003, 0, 1)
    openings = [tp.Inlet(wall="left", fluid=fluid, velocity=SPEED), tp.Outlet(wall="right")]
    tensions = {("water", "oil"): tension}
    return tp.Case(tank, [WATER, OIL], (0, 0), openings=openings, surface_tension=tensions, numerics=EXACT)


def closed(simulation):
    """The largest energy that is left over in a step, over the work and energy that pass openings in all."""
    rows = simulation.history
    passed = sum(abs(row["opening_work"]) + abs(row["opening_energy"]) for row in rows)
    return max(abs(row["energy_residual"]) for row in rows) / passed


def test_two_layers_pass_a_channel_as_if_there_were_no_ends():
    """The interface neither pulls at the outlet nor is work lost at the inlet that holds it."""
    simulation = tp.Simulation(channel({"box": ((0, 0), (0.012, 0.003))}))
    while simulation.time < 0.03:
        simulation.step(0.03)
        assert np.abs(simulation.particles.velocity - [SPEED, 0]).max() < 1e-9
    row = simulation.history[-1]
    assert row["surface_energy"] == pytest.approx(0.012 * 0.03, rel=1e-9)
    assert abs(row["energy_residual"]) < 1e-13


@pytest.mark.slow
def test_a_drop_leaves_by_an_outlet_with_its_energy():
    simulation = tp.Simulation(channel({"disc": ((0.0095, 0.003), 0.0015)}))
    start = simulation.state.stored(simulation.particles.position)
    assert start == pytest.approx(0.03 * 2 * np.pi * 0.0015, rel=0.02)
    probe, seen = tp.DropProbe(name="drop", fluid="water"), []
    while simulation.volume("water") > 0:
        simulation.step()
        seen.append(simulation.history[-1]["surface_energy"])
        assert simulation.time < 0.1
    assert min(seen) == 0.0
    assert max(seen) < 1.02 * start
    # Without viscosity of the water to speak of, what does not leave with the drop is dissipated.
    left = -sum(row["opening_energy"] for row in simulation.history)
    assert left > 0.5 * start
    assert closed(simulation) < 1e-8
    for name in ("momentum_residual_x", "momentum_residual_y"):
        assert max(abs(row[name]) for row in simulation.history) < 1e-9
    values = probe.sample(simulation)
    assert values[0] == 0
    assert np.isnan(values[1:]).all()


@pytest.mark.slow
def test_a_jet_of_liquid_alone_leaves_with_its_surface():
    tank = tp.tank((0.012, 0.012), 0.0005).fill(WATER, box=((0.004, 0), (0.008, 0.012)), velocity=(0, -0.5))
    for side in ("left", "right"):
        tank.wall(side, slip=True)
    openings = [
        tp.Inlet(wall="top", between=((0.004, 0.012), (0.008, 0.012)), fluid=WATER, velocity=0.5),
        tp.Outlet(wall="bottom"),
    ]
    case = tp.Case(
        tank,
        [WATER],
        (0, -9.81),
        openings=openings,
        surface_tension={"water": 0.0728},
        free_surface=True,
        numerics=EXACT,
    )
    simulation, speeds = tp.Simulation(case), []
    for _ in range(110):
        simulation.step()
        at_outlet = simulation.particles.position[:, 1] < 1e-9
        inside = simulation.state.mesh.used & at_outlet
        speeds.append(-simulation.particles.velocity[inside, 1].mean())
    assert simulation.history[-1]["surface_energy"] == pytest.approx(0.0728 * 2 * 0.012, rel=0.03)
    assert closed(simulation) < 1e-8
    # Free fall from 0.5 m/s over 12 mm; at the outlet the pull of both surfaces goes on.
    assert np.mean(speeds[-50:]) == pytest.approx(np.sqrt(0.25 + 2 * 9.81 * 0.012), rel=0.02)
