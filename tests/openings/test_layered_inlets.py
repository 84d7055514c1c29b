"""Inlets of several liquids: each enters with the discharge that its width asks for, or is refused."""

from __future__ import annotations

import numpy as np
import pytest

import tipfem as tp

WATER = tp.Fluid("water", 998.2, 1.002e-3)
OIL = tp.Fluid("oil", 850.0, 1e-2)
LOW, HIGH, SPEED = 0.15, 0.35, 0.1


def step_down(bounds, *, spacings=8, ramp=0.0):
    """A simulation of layers from water on, by turns, that fall from an inlet above a step into oil."""

    def fluid(x, _):
        return np.searchsorted(bounds, x[:, 1], side="right") % 2

    tank = tp.tank((0.6, 0.4), (HIGH - LOW) / spacings).fill(OIL)
    openings = [
        tp.Inlet(wall="left", between=((0, LOW), (0, HIGH)), fluid=fluid, velocity=SPEED, ramp=ramp, name="in"),
        tp.Outlet(wall="bottom", between=((0.45, 0), (0.6, 0))),
    ]
    return tp.Simulation(tp.Case(tank, [WATER, OIL], (0, -9.81), openings=openings))


def share_of_water(bounds, spacings):
    """Part of the discharge by layers of water, for a speed that falls to 0 in the last edge at each end."""
    s = np.linspace(LOW, HIGH, 20001)
    middle = 0.5 * (s[1:] + s[:-1])
    h = (HIGH - LOW) / spacings
    speed = np.clip(np.minimum(middle - LOW, HIGH - middle) / h, 0.0, 1.0)
    return speed[np.searchsorted(bounds, middle, side="right") % 2 == 0].sum() / speed.sum()


@pytest.mark.slow
@pytest.mark.parametrize("bounds", [(0.25,), (0.24,), (0.2, 0.3), (0.23, 0.27)])
def test_each_liquid_enters_with_its_discharge_at_eight_spacings(bounds):
    """Also where it falls away behind the inlet, and where its bound is between two particles."""
    simulation = step_down(bounds, ramp=0.1)
    start = simulation.state.volume.copy()
    while simulation.time < 0.5:
        simulation.step(0.5)
    passed = simulation.state.parts["openings"].total
    entered = SPEED * (HIGH - LOW) * (0.5 - 0.05)
    water = share_of_water(bounds, 8)
    assert passed[0] == pytest.approx([water * entered, (1 - water) * entered], rel=0.01)
    assert passed[0].sum() == pytest.approx(entered, rel=1e-10)
    assert simulation.state.volume - start == pytest.approx(passed.sum(axis=0), abs=1e-13)
    last = simulation.history[-10:]
    rate = sum(row["through_in_water"] for row in last) / sum(row["time_step"] for row in last)
    assert rate == pytest.approx(water * SPEED * (HIGH - LOW), rel=0.01)


@pytest.mark.parametrize("bounds", [(0.24, 0.26), (0.16,), (0.34,), (0.25, 0.26)])
def test_a_layer_without_an_edge_is_refused(bounds):
    with pytest.raises(ValueError, match=r"inlet 'in': fluid has a layer of (water|oil) of 0.0\d+ m around .*refine"):
        step_down(bounds)
