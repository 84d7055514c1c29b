"""Warnings of a run while it goes on: each once, when it happens."""

from __future__ import annotations

import logging
from types import SimpleNamespace

import numpy as np
import pytest

import tipfem as tp
from tipfem.run.watch import SETTLED, Watch

WATER = tp.Fluid("water", 1000.0, 1e-3)
AIR = tp.Fluid("air", 1.2, 1.8e-5)
H = 0.02


def case(*more):
    """Water to the roof but for a corner of air, a vent in the water, and what enters below."""
    tank = tp.tank((0.4, 0.2), H).fill(WATER).fill(AIR, box=((0.24, 0.1), (0.4, 0.2)))
    openings = [
        tp.Inlet(wall="bottom", between=((0.1, 0), (0.3, 0)), fluid=WATER, velocity=0.1, ramp=0.02),
        tp.Vent(wall="top", between=((0.04, 0.2), (0.16, 0.2)), name="vent"),
        *more,
    ]
    return tp.Case(tank, [WATER, AIR], (0, -9.81), openings=openings)


def row(step, **changes):
    usual = {"step": step, "time": 0.1 * step, "kinetic_energy": 1.0, "potential_energy": 100.0}
    return {**usual, "numerical_dissipation": 0.0, "energy_residual": 0.0, **changes}


def told(watch, rows, volumes=None):
    """What is said, by the step; of water and air 1 m^2 each are wanted, and there, if no ``volumes`` are given."""
    found, steps = [], []
    still = SimpleNamespace(velocity=np.zeros((1, 2)))
    flow = SimpleNamespace(state=SimpleNamespace(wanted_volume=np.ones(2), volume=np.ones(2), particles=still))
    watch.say = found.append
    for each in rows:
        before = len(found)
        if volumes is not None:
            flow.state.volume, flow.state.wanted_volume = volumes[each["step"]]
        watch.after_step(flow, each)
        steps += [each["step"]] * (len(found) - before)
    return steps, found


def test_water_that_leaves_by_a_vent_is_told_once_when_it_happens(caplog):
    simulation = tp.Simulation(case(), time_step=4e-3)
    with caplog.at_level(logging.WARNING, logger="tipfem"):
        simulation.run(0.1, progress=False)
    lines = [record for record in caplog.records if record.event == "warning"]
    (line,) = [record for record in lines if record.figures["what"] == "vent"]
    left = [sum(r["through_vent_water"] for r in simulation.history[: k + 1]) for k in range(len(simulation.history))]
    first = next(r for r, passed in zip(simulation.history, left, strict=True) if -passed > H**2)
    assert line.figures["t"] == first["time"] < simulation.time
    assert "water left by vent, a vent: put it where the gas stands" in line.getMessage()


def test_an_outlet_that_takes_in_is_told_in_that_step():
    drain = tp.Outlet(wall="right", between=((0.4, 0), (0.4, 0.1)), name="drain")
    passed = [-6e-3, -4e-3, 0.0, 4e-4, 2e-4, 5e-3]
    rows = [row(k, through_drain_water=value, through_drain_air=0.0) for k, value in enumerate(passed)]
    steps, lines = told(Watch(case(drain)), rows)
    assert steps == [4]
    assert lines[0].startswith("warning: t = 0.4 s: 6 % of what left by drain came back")
    # A run that goes on from a checkpoint has told it.
    watch = Watch(case(drain))
    watch.look_back(rows[:5])
    assert told(watch, rows[5:]) == ([], [])


@pytest.mark.parametrize(("sign", "verb"), [(1, "taken"), (-1, "added")])
def test_numerics_that_take_a_twentieth_of_the_energy_are_told(sign, verb):
    """Of 10 J that have become motion; not of what a flow at rest has by round-off."""
    rows = [row(k, potential_energy=100.0 - min(k, 10)) for k in range(40)]
    rows[30]["numerical_dissipation"] = rows[35]["numerical_dissipation"] = sign * 0.4
    steps, lines = told(Watch(case()), rows)
    assert steps == [35]
    assert lines[0].startswith(f"warning: t = 3.5 s: numerics have {verb} 0.8 J, 5 % of what the flow has had")
    rest = [row(k, kinetic_energy=1e-20, numerical_dissipation=1e-14) for k in range(2 * SETTLED)]
    assert told(Watch(case()), rest) == ([], [])


def test_a_change_of_a_volume_is_told():
    """Of what a fluid has had at most: what is left of one that has left the tank is a small part."""
    off = [0.0, 0.002, -0.0045, 0.006, 0.05]
    volumes = [(np.array([2.0 * (1 + part), 1.0]), np.array([2.0, 1.0])) for part in off]
    steps, lines = told(Watch(case()), [row(k) for k in range(5)], volumes)
    assert steps == [3]
    assert lines == ["warning: t = 0.3 s: numerics have made 0.6 % of the volume of water"]
    # A run that goes on from a checkpoint has told it.
    watch = Watch(case())
    volume, wanted = volumes[3]
    watch.look_back(
        [row(k) for k in range(4)], SimpleNamespace(state=SimpleNamespace(volume=volume, wanted_volume=wanted))
    )
    assert told(watch, [row(4)], volumes) == ([], [])
    leaves = [(np.array([1.0, wanted - 0.0045]), np.array([1.0, wanted])) for wanted in (1.0, 0.5, 0.1, 0.006, 0.0046)]
    assert told(Watch(case()), [row(k) for k in range(5)], leaves) == ([], [])


def test_a_turning_tank_that_loses_volume_is_told_of_it(caplog):
    """Gravity turns round it, with the interpolated interface at a coarse spacing."""
    tank = tp.tank((0.4, 0.4), 0.05, jitter=0.1, seed=1).fill(AIR).fill(WATER, box=((0, 0), (0.4, 0.2)))
    motion = tp.Motion(angle=lambda t: 20 * t**2, pivot=(0.2, 0.2))
    numerics = tp.Numerics(volume_correction=0.0)
    turning = tp.Case(tank, [WATER, AIR], (0, -9.81), interface="interpolated", tank_motion=motion, numerics=numerics)
    simulation = tp.Simulation(turning)
    with caplog.at_level(logging.WARNING, logger="tipfem"):
        simulation.run(0.2, progress=False)
    (line,) = (record for record in caplog.records if record.figures.get("what") == "volume_water")
    start = simulation.state.wanted_volume[0]
    first = next(r for r in simulation.history if abs(r["volume_water"] / start - 1) > 0.005)
    assert line.figures["t"] == first["time"] < simulation.time
    assert "of the volume of water" in line.getMessage()


@pytest.mark.parametrize("turning", [False, True], ids=["to the roof", "turning"])
def test_velocities_that_the_first_step_takes_are_told(turning, caplog):
    """Those of a stream function that is 0 along the walls remain."""
    k = np.pi / 0.2

    def velocity(x):
        s, c = np.sin(k * x), np.cos(k * x)
        return 0.03 * np.stack([s[:, 0] * c[:, 1], -c[:, 0] * s[:, 1]], axis=1)

    tank = tp.tank((0.2, 0.2), H).fill(WATER, velocity=velocity if turning else (0.0, 0.03))
    for side in ("left", "right", "bottom", "top"):
        tank.wall(side, slip=True)
    simulation = tp.Simulation(tp.Case(tank, [WATER], (0, 0)), time_step=4e-3)
    with caplog.at_level(logging.WARNING, logger="tipfem"):
        simulation.run(8e-3, progress=False)
    lines = [r.getMessage() for r in caplog.records if r.event == "warning" and r.figures["what"] == "start"]
    if turning:
        assert lines == []
    else:
        (line,) = lines
        assert "of 0.027 m/s, the mean speeds given at the start" in line


@pytest.mark.slow
def test_an_interpolated_interface_that_loses_a_volume_says_which_one_keeps_it():
    """A tank that turns over, 10 spacings across: remeshing moves a third of h^2 per step between the fluids."""
    tank = tp.tank((0.2, 0.2), 0.02).fill(AIR).fill(WATER, box=((0, 0), (0.2, 0.1)))
    motion = tp.Motion(angle=lambda t: 2 * t**2 / (1 + t), pivot=(0.1, 0.1))
    for interface in ("interpolated", "sharp"):
        simulation = tp.Simulation(tp.Case(tank, [WATER, AIR], (0, -9.81), interface=interface, tank_motion=motion))
        watch, found = Watch(simulation.case), []
        watch.say = found.append
        while simulation.time < 0.6:
            simulation.step()
            watch.after_step(simulation, simulation.history[-1])
        assert any("of the volume of water: " in line and "'sharp'" in line for line in found) == (
            interface == "interpolated"
        )
