"""Inlets that draw off: what stands there leaves, whatever fluid would come back."""

from __future__ import annotations

import numpy as np
import pytest

import tipfem as tp

WATER = tp.Fluid("water", 1000.0, 1e-3)
AIR = tp.Fluid("air", 1.2, 1.8e-5)
FLUIDS = (WATER, AIR)
LOW, HIGH = ((0.4, 0), (0.4, 0.1)), ((0.4, 0.2), (0.4, 0.28))


def tank_of_two(between, fluid, **inlet):
    """A simulation of 0.06 m^2 of water below air, with an inlet in the right side and a vent above."""
    tank = tp.tank((0.4, 0.3), 0.02).fill(AIR).fill(WATER, box=((0, 0), (0.4, 0.15)))
    openings = [
        tp.Inlet(wall="right", between=between, fluid=fluid, name="drain", **inlet),
        tp.Vent(wall="top", between=((0.1, 0.3), (0.3, 0.3)), name="vent"),
    ]
    return tp.Simulation(tp.Case(tank, FLUIDS, (0, -9.81), openings=openings), time_step=4e-3)


def stepped(simulation, until):
    """What has passed (2, F), after the volumes were checked in each step."""
    start = simulation.state.volume.copy()
    while simulation.time < until:
        simulation.step(until)
        passed = simulation.state.parts["openings"].total
        assert simulation.state.volume - start == pytest.approx(passed.sum(axis=0), abs=1e-13)
    assert max(map(abs, simulation.numerical_error().values())) < np.inf
    return passed


DRAWN = {
    "discharge": {"discharge": -0.02, "ramp": 0.02},
    "discharge function": {"discharge": lambda t: -0.02 * min(t / 0.02, 1.0)},
    "velocity": {"velocity": -0.2, "ramp": 0.02},
    "velocity function": {"velocity": lambda t: -10.0 * t},
    "profile": {"profile": lambda s, t: -0.2 + 0 * s},
}


@pytest.mark.parametrize("given", DRAWN)
@pytest.mark.parametrize(("between", "stands"), [(LOW, 0), (HIGH, 1)])
def test_what_stands_there_leaves(between, stands, given):
    simulations = [tank_of_two(between, fluid, **DRAWN[given]) for fluid in FLUIDS]
    assert simulations[0].state.volume == pytest.approx([0.06, 0.06], rel=1e-12)
    passed = [stepped(simulation, 0.04) for simulation in simulations]
    assert passed[0][0, stands] < -2e-4
    assert passed[0][0, 1 - stands] == 0.0
    # The fluid that would come back makes no difference.
    np.testing.assert_array_equal(passed[1], passed[0])
    np.testing.assert_array_equal(simulations[1].particles.velocity, simulations[0].particles.velocity)


def test_an_inlet_whose_valve_is_closed_changes_no_fluid():
    simulation = tank_of_two(HIGH, WATER, discharge=0.02, open=((0.5, 1.0),))
    assert simulation.state.volume == pytest.approx([0.06, 0.06], rel=1e-12)
    assert np.abs(stepped(simulation, 0.02)).max() < 1e-15


def test_a_discharge_that_turns_lets_in_its_fluid_and_draws_off_what_stands_there():
    def discharge(t):
        return 0.04 * np.sin(2 * np.pi * t / 0.16)

    simulation = tank_of_two(HIGH, WATER, discharge=discharge)
    passed = stepped(simulation, 0.16)
    rows = simulation.history
    through = np.array([[row[f"through_drain_{f.name}"] for f in FLUIDS] for row in rows])
    times = np.array([0.0, *(row["time"] for row in rows)])
    half = 0.04 * 0.16 / (2 * np.pi)
    wanted = -half * np.diff(np.cos(2 * np.pi * times / 0.16))
    assert through.sum(axis=1) == pytest.approx(wanted, abs=1e-8)
    enters = wanted > 0
    assert (through[enters, 1] == 0).all()
    assert (through[~enters] <= 1e-18).all()
    assert through[~enters, 0].sum() < -0.1 * half  # of the water that stands there by then
    assert passed[0].sum() == pytest.approx(0.0, abs=1e-8)


def test_a_profile_that_lets_in_below_draws_off_above():
    """Air enters by the lower half of an opening in water, and water leaves by its upper half."""

    def profile(s, t):
        return min(t / 0.02, 1.0) * np.where(s < 0.0499, 0.1, -0.1)

    simulation = tank_of_two(((0.4, 0), (0.4, 0.1)), AIR, profile=profile)
    passed = stepped(simulation, 0.04)
    through = np.array([[row[f"through_drain_{f.name}"] for f in FLUIDS] for row in simulation.history])
    assert (through[:, 1] > 0).all()
    assert (through[:, 0] < 0).all()
    assert passed[0, 1] == pytest.approx(0.1 * 0.04 * 0.03, rel=0.3)


@pytest.mark.parametrize("by", ["outlet", "vent and drain"])
def test_the_last_film_of_a_liquid_leaves(by):
    """A slab of water below oil moves through an opening as wide as the tank, to its last drop."""
    oil, h = tp.Fluid("oil", 900.0, 1e-2), 0.02
    tank = tp.tank((8 * h, 8 * h), h).fill(oil).fill(WATER, box=((0, 0), (8 * h, 2 * h)))
    for side in ("left", "right"):
        tank.wall(side, slip=True)
    openings = {
        "outlet": [tp.Inlet(wall="top", fluid=oil, velocity=0.5), tp.Outlet(wall="bottom", name="out")],
        "vent and drain": [tp.Vent(wall="top"), tp.Inlet(wall="bottom", fluid=oil, velocity=-0.5, name="out")],
    }[by]
    simulation = tp.Simulation(tp.Case(tank, [WATER, oil], (0, -9.81), openings=openings), time_step=4e-3)
    start = simulation.state.volume.copy()
    while simulation.time < 0.12:
        simulation.step(0.12)
        passed = simulation.state.parts["openings"].total.sum(axis=0)
        assert simulation.state.volume - start == pytest.approx(passed, abs=1e-10 * start[0])
    assert simulation.volume("water") == 0.0
    through = sum(row["through_out_water"] for row in simulation.history)
    assert -through == pytest.approx(start[0], rel=1e-10)
    errors = simulation.numerical_error()
    assert abs(errors["volume_water"]) + abs(errors["volume_oil"]) < 1e-10
