"""The figures of what numerics took or gave: those of the budget, and the line that a user reads."""

from __future__ import annotations

import io
import json

import numpy as np
import pytest

import tipfem as tp
from tipfem.step.numerical_error import numerical_error, summary_line

WATER, AIR = tp.Fluid("water", density=1000.0, viscosity=1e-3), tp.Fluid("air", density=1.0, viscosity=1e-5)


def row(**changes):
    """A step of a flow that exchanges 4 J of potential and kinetic energy."""
    usual = {
        "time": 1.0,
        "kinetic_energy": 4.0,
        "potential_energy": 6.0,
        "numerical_dissipation": 0.0,
        "energy_residual": 0.0,
        "volume_water": 0.5,
        "volume_air": 0.5,
    }
    usual |= {f"{name}_{a}": 0.0 for name in ("momentum", "remeshing_momentum", "momentum_residual") for a in "xy"}
    return {**usual, **changes}


def test_figures_are_relative_to_the_flow_s_own():
    start = row(time=0.1, kinetic_energy=0.0, potential_energy=10.0, numerical_dissipation=0.01)
    end = row(
        numerical_dissipation=0.03,
        energy_residual=-0.01,
        remeshing_momentum_x=0.3,
        momentum_residual_y=0.4,
        volume_water=0.49,
    )
    found = numerical_error([start, end], [WATER, AIR], np.array([0.5, 0.5]))
    momentum = 0.5 / np.sqrt(2 * 500.5 * 4.0)
    parts = {"energy": 0.0125, "momentum": momentum, "volume_water": 0.02, "volume_air": 0.0}
    when = {"energy_lost": 0.05, "energy_of_flow": 4.0, "early_time": 0.25, "early_loss": 0.2, "time_of_loss": 0.99}
    assert found == pytest.approx(parts | when)


def test_a_fluid_that_has_left_has_lost_the_part_of_what_was_there(water):
    """0.004 of 0.4 m^2 that drained to the last 1e-6; and a mass that is 0 at the end divides nothing."""
    rows = [row(volume_water=volume) for volume in (0.4, 0.2 - 0.004, 0.0)]
    for left in (1e-6, 0.0, -1e-9):
        found = numerical_error(rows, [water], np.array([[0.4], [0.2], [left]]))
        assert found["volume_water"] == pytest.approx(0.01)
        assert found["momentum"] == 0.0


def test_fluids_at_rest_and_runs_without_steps_have_figures_too():
    rest = row(kinetic_energy=0.0)
    found = numerical_error([rest], [WATER, AIR], np.array([0.5, 0.5]))
    assert {value for name, value in found.items() if "time" not in name} == {0.0}
    assert numerical_error([], [WATER, AIR], np.array([0.5, 0.5])) == {}


def test_round_off_of_fluids_at_rest_is_no_error(water):
    """Two rows that differ by round-off, in energies of 100 J: a part of what is nothing would be anything."""
    rest = {"kinetic_energy": 1e-20, "potential_energy": 100.0, "numerical_dissipation": 1e-13}
    errors = numerical_error(
        [row(**rest), row(**{**rest, "potential_energy": 100.0 + 2e-14})], [water], np.array([2.0])
    )
    assert errors["energy"] == errors["momentum"] == 0.0


def test_energy_is_relative_to_that_of_surfaces_where_it_is_the_largest(water):
    """A drop that becomes round: it gives 9 J, 4 J of them as motion. A drop at rest has round-off only."""
    rows = [row(surface_energy=29.0, potential_energy=0.0), row(surface_energy=20.0, potential_energy=0.0)]
    assert numerical_error(rows, [water], np.array([0.5]))["energy_of_flow"] == 9.0
    rest = {"surface_energy": 20.0, "potential_energy": 0.0, "kinetic_energy": 1e-20, "numerical_dissipation": 1e-19}
    assert numerical_error([row(**rest)] * 2, [water], np.array([0.5]))["energy"] == 0.0


def test_the_line_names_what_is_above_one_per_cent():
    when = {"energy_lost": 0.16, "energy_of_flow": 40.0, "early_time": 0.1, "early_loss": 0.2, "time_of_loss": 0.26}
    small = {"energy": 0.004, "momentum": 0.001, "volume_water": -0.002, **when}
    assert summary_line(small) == (
        "numerics lost 0.16 J of the flow's 40 J (20% of it before t = 0.1 s, most at t = 0.26 s), "
        "changed 0.001 of the momentum, gave 0.002 of the volume of water"
    )
    line = summary_line({**small, "energy": -0.05, "energy_lost": -2.0, "volume_water": 0.02, "roughness_water": 0.01})
    assert line.startswith("warning: numerics added 2 J to the flow's 40 J (")
    assert "; roughness of velocities at the end 0.01 in water; above 1 %: energy, volume of water (" in line
    assert "above 1 %: energy" in summary_line({**small, "energy": float("nan"), "energy_lost": float("nan")})
    none = summary_line({**small, "energy": 0.0, "energy_lost": 0.0})
    assert none.startswith("numerics lost 0 J of the flow's 40 J, changed")


def test_the_line_says_what_openings_brought():
    rows = [row(opening_work=3.0, opening_energy=-1.0, numerical_dissipation=0.05) for _ in range(2)]
    found = numerical_error(rows, [WATER, AIR], np.array([0.5, 0.5]))
    assert found["energy_of_through_flow"] == 4.0
    assert found["energy"] == 0.1 / 4.0
    line = summary_line(found)
    assert line.startswith(
        "warning: numerics lost 0.1 J of the flow's 4 J and the 4 J that through-flow brought (0% of it before"
    )
    assert "above 1 %: energy" in line
    more = summary_line({**found, "energy_of_through_flow": 36.0})  # 0.25 % of all
    assert more.startswith("numerics lost 0.1 J of the flow's 4 J and the 36 J that through-flow brought (")
    less = summary_line({**found, "energy_of_through_flow": -36.0})
    assert less.startswith("warning: numerics lost 0.1 J of the flow's 4 J, of which through-flow took 36 J (")


def test_a_run_writes_the_figures_and_says_the_line_on_a_terminal(tmp_path, monkeypatch):
    class Terminal(io.StringIO):
        def isatty(self):
            return True

    tank = tp.tank((0.4, 0.4), 0.05).fill(AIR).fill(WATER, box=((0, 0), (0.2, 0.2)))
    for progress in (True, False):
        stream = Terminal()
        monkeypatch.setattr("sys.stderr", stream)
        simulation = tp.Simulation(tp.Case(tank, [WATER, AIR], (0, -9.81)), tmp_path, time_step=2e-3)
        simulation.run(0.01, progress=progress)
        found = json.loads((tmp_path / "summary.json").read_text())["numerical_error"]
        assert found == numerical_error(simulation.history, [WATER, AIR], simulation.state.wanted_volume)
        assert {"energy", "momentum", "volume_water", "volume_air", "energy_lost", "roughness_water"} <= set(found)
        assert ("of the volume of water" in " ".join(stream.getvalue().split())) == progress


def test_suction_at_a_free_surface_is_told_with_its_time_unless_it_is_of_single_steps():
    """By medians: an impact's pressures of a step or two say nothing of the flow."""
    steps = [row(time=0.002 * k, lowest_pressure=-1.0, highest_pressure=1000.0) for k in range(1, 501)]
    steps[200] |= {"lowest_pressure": -5e4}
    assert "suction" not in numerical_error(steps, [WATER, AIR], np.array([0.5, 0.5]))
    for k in range(370, 380):
        steps[k] |= {"lowest_pressure": -374.0}
    found = numerical_error(steps, [WATER, AIR], np.array([0.5, 0.5]))
    assert found["suction"] == 374.0
    assert found["time_of_suction"] == pytest.approx(0.75, abs=0.011)
    assert "the lowest pressure was 3.7e+02 Pa below that of the empty space at t = 0.7" in summary_line(found)


def test_the_pressure_at_a_free_surface_is_in_the_history():
    """Hydrostatic at rest; below that of the empty space where the floor moves away faster than water falls."""
    tank = tp.tank((0.4, 0.3), spacing=0.02).fill(WATER, box=((0, 0), (0.4, 0.2)))
    rest = tp.Simulation(tp.Case(tank, [WATER], gravity=(0, -10.0), free_surface=True))
    rest.step()
    assert rest.history[-1]["lowest_pressure"] == pytest.approx(0.0, abs=1e-6)
    assert rest.history[-1]["highest_pressure"] == pytest.approx(2000.0, rel=1e-6)
    tank = tp.tank((0.4, 0.3), spacing=0.02).fill(WATER, box=((0, 0), (0.4, 0.2)))
    tank.wall("bottom", motion=lambda t: -10.0 * t**2)
    pulled = tp.Simulation(tp.Case(tank, [WATER], gravity=(0, -10.0), free_surface=True), time_step=1e-3)
    for _ in range(5):
        pulled.step()
    assert pulled.history[-1]["lowest_pressure"] == pytest.approx(-2000.0, rel=0.05)
