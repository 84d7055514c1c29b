"""Openings under a free surface: what passes is exact, and empty space takes in what enters."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

import tipfem as tp
from tipfem.physics.openings import put_back

WATER = tp.Fluid("water", 1000.0, 1e-3)
SIZE, SPACING = (0.4, 0.3), 0.02


def basin(openings, depth, *, more=None):
    """A simulation of water of a depth, and in one more box, in a tank whose walls slip."""
    tank = tp.tank(SIZE, SPACING).fill(WATER, box=((0, 0), (0.4, depth)))
    if more is not None:
        tank.fill(WATER, box=more)
    for side in tank.sides:
        tank.wall(side, slip=True)
    case = tp.Case(tank, [WATER], (0, -9.81), openings=openings, free_surface=True)
    return tp.Simulation(case, time_step=4.5e-3)


def balanced(simulation, until):
    """The simulation at a time, after volume and energy were checked in each step; and what has passed (K,)."""
    start = simulation.state.volume[0]
    while simulation.time < until:
        simulation.step(until)
        passed = simulation.state.parts["openings"].total[:, 0]
        assert simulation.state.volume[0] - start == pytest.approx(passed.sum(), abs=1e-14)
        row = simulation.history[-1]
        given = abs(row["opening_work"]) + abs(row["opening_energy"]) + row["kinetic_energy"]
        assert abs(row["energy_residual"]) < 1e-9 * given + 1e-12
    return simulation, passed


@pytest.mark.slow
def test_a_tank_drains_by_its_floor_until_it_is_nearly_dry():
    drain = tp.Outlet(wall="bottom", between=((0.14, 0), (0.26, 0)))
    simulation, passed = balanced(basin([drain], 0.2), 0.4)
    assert passed[0] < -0.035
    assert len(simulation.particles) < 200  # of 267 at the start
    # By theory the level falls as in a tank with a slot, q = C b sqrt(2 g h); the opening is no jet, C is below 1. At
    # spacings within 8 % of this the ratio is 1.8 to 2.2, at half of it 1.9.
    time = np.array([row["time"] for row in simulation.history])
    out = -np.cumsum([row["through_outlet_bottom_water"] for row in simulation.history])
    half = float(np.interp(0.02, out, time))
    ideal = 2 * 0.4 / (0.12 * np.sqrt(2 * 9.81)) * (np.sqrt(0.2) - np.sqrt(0.15))
    assert 1.5 < half / ideal < 2.4


def test_a_jet_falls_through_an_empty_tank_and_leaves_it():
    openings = [
        tp.Inlet(wall="top", between=((0.14, 0.3), (0.26, 0.3)), fluid=WATER, velocity=0.7, ramp=0.02),
        tp.Outlet(wall="bottom"),
    ]
    simulation, passed = balanced(basin(openings, 0.04, more=((0.14, 0.26), (0.26, 0.3))), 0.4)
    assert passed[0] == pytest.approx(0.7 * 0.12 * (0.4 - 0.01), rel=1e-12)
    last = [row for row in simulation.history if row["time"] > 0.28]
    rate = -sum(row["through_outlet_bottom_water"] for row in last) / sum(row["time_step"] for row in last)
    assert rate == pytest.approx(0.7 * 0.12, rel=0.15)  # the mean from a jet that sways, after its first drop
    # As fast as by a free fall, and so much narrower.
    x, v = simulation.particles.position, simulation.particles.velocity
    low = (x[:, 1] > 0.05) & (x[:, 1] < 0.15) & simulation.mesh.used & ~simulation.particles.wall
    assert low.sum() > 5
    fall = np.sqrt(0.7**2 + 2 * 9.81 * (0.3 - x[low, 1]))
    assert (-v[low, 1] / fall).mean() == pytest.approx(1.0, rel=0.1)  # less than 1: in the contraction the inlet draws
    assert np.ptp(x[low, 0]) == pytest.approx(0.12 * 0.7 / fall.mean(), rel=0.3)


def test_an_end_of_a_dry_drain_keeps_its_state():
    """No cell is at it, so none has a state for where it is put back after round-off has moved it."""
    simulation = basin([tp.Outlet(wall="right", between=((0.4, 0.2), (0.4, 0.3)))], 0.1)
    mesh, particles = simulation.mesh, simulation.particles
    end = simulation.state.boundary.passages.nodes[0][:1]
    assert not np.isin(end, mesh.cells).any()
    pressure = np.arange(1.0, 1.0 + len(particles))
    moved = particles.shallow_copy(position=particles.position * (1 + 1e-15), pressure=pressure)
    done = put_back._interpolated(moved, particles.position, end, mesh, np.zeros(0, dtype=np.int32), particles.wall)
    np.testing.assert_array_equal(done.position, particles.position)
    np.testing.assert_array_equal(done.pressure, pressure)
    np.testing.assert_array_equal(done.velocity, moved.velocity)


def test_a_channel_runs_uniformly():
    openings = [
        tp.Inlet(wall="left", between=((0, 0), (0, 0.1)), fluid=WATER, velocity=0.5),
        tp.Outlet(wall="right", level=0.1, fluid=WATER),
    ]
    tank = tp.tank(SIZE, SPACING).fill(WATER, box=((0, 0), (0.4, 0.1)), velocity=(0.5, 0.0))
    for side in tank.sides:
        tank.wall(side, slip=True)
    case = tp.Case(tank, [WATER], (0, -9.81), openings=openings, free_surface=True)
    simulation = tp.Simulation(case, time_step=4.5e-3)
    for _ in range(30):
        simulation.step()
    used = simulation.mesh.used
    assert np.abs(simulation.particles.velocity[used] - [0.5, 0.0]).max() < 1e-8


def test_an_inlet_fills_a_tank_without_a_vent():
    inlet = tp.Inlet(wall="bottom", between=((0.14, 0), (0.26, 0)), fluid=WATER, discharge=0.06, ramp=0.05)
    simulation, passed = balanced(basin([inlet], 0.06), 0.2)
    assert passed[0] == pytest.approx(0.06 * (0.2 - 0.025), rel=1e-12)
    assert simulation.particles.position[simulation.mesh.used, 1].max() > 0.08


def test_water_stays_at_rest_beside_a_reservoir_of_its_level():
    simulation = basin([tp.Outlet(wall="right", level=0.1, fluid=WATER, direction="normal")], 0.1)
    for _ in range(20):
        simulation.step()
    assert simulation.particles.max_speed < 1e-9
    assert abs(simulation.state.parts["openings"].total).max() < 1e-12


def test_an_inlet_whose_valve_is_closed_lets_nothing_in():
    inlet = tp.Inlet(
        wall="top", between=((0.14, 0.3), (0.26, 0.3)), fluid=WATER, velocity=0.5, ramp=0.01, open=((0.1, 1.0),)
    )
    simulation, passed = balanced(basin([inlet], 0.06, more=((0.14, 0.26), (0.26, 0.3))), 0.1)
    assert passed[0] == 0.0
    start = simulation.state.volume[0]
    _, passed = balanced(simulation, 0.15)
    assert simulation.state.volume[0] - start == pytest.approx(passed[0], abs=1e-14)
    assert passed[0] == pytest.approx(0.5 * 0.12 * (0.05 - 0.005), rel=1e-9)


def test_a_closed_drain_holds_the_water():
    drain = tp.Outlet(wall="bottom", between=((0.14, 0), (0.26, 0)), open=((1.0, 2.0),))
    simulation = basin([drain], 0.1)
    for _ in range(20):
        simulation.step()
    assert simulation.particles.max_speed < 1e-9
    assert (simulation.state.parts["openings"].total == 0).all()


def test_a_pump_lifts_what_leaves_by_a_drain():
    openings = [
        tp.Outlet(wall="bottom", between=((0.14, 0), (0.26, 0)), name="drain", pressure=600.0),
        tp.Inlet(wall="left", between=((0, 0.16), (0, 0.26)), fluid=WATER, pump="drain"),
    ]
    _, passed = balanced(basin(openings, 0.12, more=((0, 0.16), (0.04, 0.26))), 0.2)
    assert passed[0] < -0.005
    assert passed[1] == pytest.approx(-passed[0], rel=0.1)  # it follows one step later


@pytest.mark.parametrize(
    ("opening", "message"),
    [
        (tp.Vent(wall="top"), r"vent 'vent_top': there is a free surface.*leave the vent out"),
        (
            tp.Inlet(wall="left", fluid=WATER, velocity=1.0),
            r"inlet 'inlet_left': there is no fluid before it, at \[0.02",
        ),
    ],
)
def test_a_case_refuses(opening, message):
    with pytest.raises(ValueError, match=message):
        basin([opening], 0.1)


@pytest.mark.parametrize(("beside", "taken"), [((0, -1), -1), ((-1, 0), -1), ((0, 0), 0), ((0, 1), 0)])
def test_what_enters_a_cell_with_one_corner_on_an_inlet(beside, taken):
    """Nothing, where nothing enters by one of the edges next to that corner: the cell stays what it is."""
    openings = SimpleNamespace(fluids_in=lambda *_: np.array(beside))
    position = np.array([[0.0, 0.0], [0.0, 1.0], [0.0, 2.0], [1.0, 0.5], [1.0, 1.5]])
    cells, on = np.array([[1, 3, 4], [0, 3, 1]]), np.arange(3)
    source, mixed = put_back.Gate._entering(
        SimpleNamespace(openings=openings), None, on, cells, position, 0.0, np.ones(3)
    )
    assert source.tolist() == [taken, beside[0]]  # the other cell has an edge of the line
    assert mixed[:, 0].tolist() == ([-1, -1] if beside[0] == beside[1] else list(beside))
