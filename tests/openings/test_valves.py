"""Valves by time and by commands, another discharge, and pumps."""

from __future__ import annotations

import numpy as np
import pytest
from tipfem.render.openings import gaps_of

import tipfem as tp
from tipfem.casefile.record import case_facts

WATER = tp.Fluid("water", 1000.0, 1e-3)
AIR = tp.Fluid("air", 1.2, 1.8e-5)
SYRUP = tp.Fluid("syrup", 1.0, 0.01)
NOZZLE = ((0.1, 0), (0.2, 0))


def fountain(vent=None, **inlet):
    tank = tp.tank((0.3, 0.3), 0.02).fill(AIR).fill(WATER, box=((0, 0), (0.3, 0.06)))
    openings = [
        tp.Inlet(wall="bottom", between=NOZZLE, fluid=WATER, name="nozzle", **inlet),
        tp.Vent(wall="top", between=((0.02, 0.3), (0.1, 0.3)), name="vent", open=vent),
    ]
    return tp.Case(tank, [WATER, AIR], (0, -9.81), openings=openings)


def passed(simulation):
    return simulation.state.parts["openings"].total


@pytest.mark.parametrize("ramp", [0.0, 0.02])
def test_an_inlet_lets_in_what_its_valve_lets(ramp):
    simulation = tp.Simulation(fountain(discharge=0.06, ramp=ramp, open=((0.02, 0.05), (0.09, 0.2))), time_step=4e-3)
    while simulation.time < 0.12:
        simulation.step(0.12)
    entered = 0.06 * (0.03 + 0.03 - 0.5 * ramp)
    assert passed(simulation)[0] == pytest.approx([entered, 0.0], rel=1e-12)
    assert passed(simulation)[1] == pytest.approx([0.0, -entered], rel=1e-9)
    rows = simulation.history
    while_closed = [row["through_nozzle_water"] for row in rows if 0.055 + ramp < row["time"] < 0.09]
    assert len(while_closed) > 2
    assert max(map(abs, while_closed)) == 0.0


def test_a_probe_has_what_has_passed_and_passes():
    probe = tp.OpeningProbe(name="entered", opening="nozzle", fluid="water")
    simulation = tp.Simulation(fountain(discharge=0.06), time_step=4e-3, probes=[probe])
    for _ in range(5):
        simulation.step()
    record = simulation.probes["entered"]
    assert record["volume"][-1] == pytest.approx(0.06 * simulation.time, rel=1e-12)
    assert record["discharge"][-1] == pytest.approx(0.06, rel=1e-12)
    with pytest.raises(ValueError, match="opening is 'door'; the openings of the case are nozzle, vent"):
        tp.Simulation(fountain(discharge=0.06), probes=[tp.OpeningProbe(name="entered", opening="door", fluid="water")])


def two_outlets(**options):
    """A channel with an inlet at the left, and outlets at the right and in the roof."""
    tank = tp.tank((0.4, 0.2), 0.02).fill(SYRUP)
    openings = [
        tp.Inlet(wall="left", fluid=SYRUP, discharge=0.1, ramp=0.05, name="in", profile="parabola"),
        tp.Outlet(wall="right", name="end", **options),
        tp.Outlet(wall="top", between=((0.1, 0.2), (0.24, 0.2)), name="roof"),
    ]
    return tp.Case(tank, [SYRUP], (0, 0), openings=openings, numerics=tp.Numerics(newton_tolerance=1e-9))


def test_nothing_passes_an_outlet_that_is_closed():
    simulation = tp.Simulation(two_outlets(open=((0.0, 0.06),)), time_step=5e-3)
    while simulation.time < 0.2:
        simulation.step(0.2)
        if simulation.time > 0.07:
            row = simulation.history[-1]
            assert row["through_end_syrup"] == 0.0
            assert row["through_roof_syrup"] == pytest.approx(-row["through_in_syrup"], rel=1e-9)
            on = simulation.state.boundary.passages.nodes[1]
            assert (simulation.particles.velocity[on] == 0).all()
    rows = simulation.history
    assert sum(row["through_end_syrup"] for row in rows) < -1e-4
    flux = sum(abs(row["opening_work"]) + abs(row["opening_energy"]) for row in rows)
    assert sum(abs(row["energy_residual"]) for row in rows) < 1e-6 * flux
    assert max(abs(row["momentum_residual_x"]) for row in rows) < 1e-8


def test_what_enters_a_tank_that_is_closed_is_refused():
    simulation = tp.Simulation(fountain(vent=((0.0, 0.02),), discharge=0.06), time_step=4e-3)
    for _ in range(5):
        simulation.step()
    with pytest.raises(tp.SimulationError, match=r"0.06 m.2/s enter by inlets, and all that can leave is closed: vent"):
        simulation.step()


def test_a_tank_is_at_rest_while_all_is_closed():
    simulation = tp.Simulation(fountain(vent=((0.02, 9.0),), discharge=0.06, open=((0.02, 9.0),)), time_step=4e-3)
    for _ in range(4):
        simulation.step()
    assert simulation.particles.max_speed < 1e-9
    while simulation.time < 0.06:
        simulation.step()
    assert passed(simulation)[0, 0] > 1e-4


@pytest.mark.slow
def test_commands_set_discharge_and_valve_and_are_repeated_to_the_bit(tmp_path):
    """Also by a run that goes on from a checkpoint."""

    def steered(simulation, first=0):
        for step in range(first, 30):
            if step == 5:
                simulation.steer(tp.Discharge("nozzle", 0.03))
            if step == 10:
                simulation.steer(tp.Valve("nozzle", False))
                simulation.steer(tp.Valve("vent", False))
            if step == 15:
                simulation.steer(tp.Valve("vent", True))
                simulation.steer(tp.Valve("nozzle", True))
            if simulation.results is not None and step == 12:
                simulation.write_checkpoint(1.0)
            simulation.step()
        return simulation

    whole = steered(tp.Simulation(fountain(discharge=0.06), tmp_path, time_step=4e-3))
    rows = whole.history
    through = np.array([row["through_nozzle_water"] / row["time_step"] for row in rows])
    assert through[:5] == pytest.approx(0.06, rel=1e-9)
    assert through[5:10] == pytest.approx(0.03, rel=1e-9)
    assert (through[10:15] == 0).all()
    assert through[15:] == pytest.approx(0.03, rel=1e-9)
    again = tp.Simulation(fountain(discharge=0.06), time_step=4e-3, steering=tmp_path / "steering.jsonl")
    for _ in range(30):
        again.step()
    resumed = tp.Simulation.resume(tmp_path, fountain(discharge=0.06))
    while resumed.step_number < 30:
        resumed.step()
    for other in (again, resumed):
        for name in ("position", "velocity", "pressure"):
            assert np.array_equal(getattr(whole.particles, name), getattr(other.particles, name)), name
        assert np.array_equal(passed(whole), passed(other))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: tp.Discharge("vent", 0.1), "discharge: opening is 'vent'; it must be one of nozzle"),
        (lambda: tp.Valve("door", True), "valve: opening is 'door'; it must be one of nozzle, vent"),
        (lambda: tp.Discharge("nozzle", "much"), "discharge: value is 'much', a text; it must be a number in m.2/s"),
        (lambda: tp.Valve("nozzle", 1), "valve: open is 1; it must be True or False"),
        (lambda: tp.Valve("vent", False), "valve: 0.06 m.2/s enter by inlets, and all that can leave is closed: vent"),
    ],
)
def test_commands_refuse(make, message):
    simulation = tp.Simulation(fountain(discharge=0.06), time_step=4e-3)
    with pytest.raises(ValueError, match=message):
        simulation.steer(make())


def pumped(drain, *more, g=(0, 0)):
    tank = tp.tank((0.4, 0.2), 0.02).fill(SYRUP)
    there = tp.Inlet(between=((0, 0.04), (0, 0.16)), fluid=SYRUP, pump="drain", name="pump", profile="parabola")
    return tp.Case(tank, [SYRUP], g, openings=[drain, there, *more], numerics=tp.Numerics(newton_tolerance=1e-9))


def test_a_pump_moves_fluid_in_a_closed_tank():
    """What is drawn off at the right enters at the left in the same step; volume, energy and momentum close."""
    drain = tp.Inlet(wall="right", fluid=SYRUP, discharge=-0.08, ramp=0.05, name="drain")
    simulation = tp.Simulation(pumped(drain), time_step=5e-3)
    volume = simulation.state.volume[0]
    while simulation.time < 0.2:
        simulation.step(0.2)
    expected = 0.08 * (0.2 - 0.025)
    assert passed(simulation)[:, 0] == pytest.approx([-expected, expected], rel=1e-12)
    assert simulation.state.volume[0] == pytest.approx(volume, rel=1e-12)
    rows = simulation.history
    flux = sum(abs(row["opening_work"]) + abs(row["opening_energy"]) for row in rows)
    assert sum(abs(row["energy_residual"]) for row in rows) < 1e-6 * flux
    assert sum(row["refused_steps"] for row in rows) == 0


def test_a_pump_delivers_what_has_left_by_an_outlet():
    drain = tp.Outlet(wall="right", name="drain", pressure=-20.0)
    roof = tp.Outlet(wall="top", between=((0.1, 0.2), (0.24, 0.2)), name="roof")
    simulation = tp.Simulation(pumped(drain, roof), time_step=2e-3)
    for _ in range(40):
        simulation.step()
    rows = simulation.history
    out = np.array([-row["through_drain_syrup"] / row["time_step"] for row in rows])
    into = np.array([row["through_pump_syrup"] / row["time_step"] for row in rows])
    assert out[-1] > 1e-3
    step, mean, wanted = np.array([row["time_step"] for row in rows]), 0.0, []
    for k, value in enumerate(out[:-1]):
        mean += (value - mean) * step[k] / (3 * step[: k + 1].max())
        wanted.append(max(mean, 0.0))
    assert into[1:] == pytest.approx(wanted, rel=1e-9, abs=1e-12)


@pytest.mark.parametrize(
    ("drain", "message"),
    [
        (tp.Outlet(wall="right", name="end"), "pump is 'drain'; it must be the name of another opening: end"),
        (tp.Outlet(wall="right", name="drain"), "what flows in cannot leave; add a vent or an outlet"),
        (
            tp.Inlet(wall="right", fluid=SYRUP, profile=lambda s, t: -1 + 0 * s, name="drain"),
            "pump is 'drain', which has neither discharge nor velocity",
        ),
    ],
)
def test_a_pump_refuses(drain, message):
    with pytest.raises(ValueError, match=message):
        pumped(drain)


@pytest.mark.parametrize("times", [((0.2, 0.1),), (0.1, 0.2), ((0.0, 1.0), (0.5, 2.0)), "always"])
def test_a_valve_refuses(times):
    with pytest.raises(ValueError, match=r"open is .* it must be pairs of times \(start, end\) in s"):
        tp.Vent(wall="top", open=times)


def test_drains_and_closed_valves_are_drawn_as_what_they_are():
    tank = tp.tank((0.4, 0.2), 0.02).fill(SYRUP)
    openings = [
        tp.Inlet(wall="left", fluid=SYRUP, velocity=0.1, open=((0.2, 0.4),)),
        tp.Inlet(wall="top", fluid=SYRUP, velocity=-0.1, between=((0.1, 0.2), (0.3, 0.2))),
        tp.Outlet(wall="right"),
    ]
    case = tp.Case(tank, [SYRUP], (0, 0), openings=openings)
    gaps = gaps_of(case_facts(case)["openings"])
    assert [gap.kind for gap in gaps] == ["inlet", "outlet", "outlet"]
    assert [[gap.is_open(time) for gap in gaps] for time in (0.1, 0.3)] == [[False, True, True], [True, True, True]]
