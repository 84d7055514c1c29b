"""Flows through openings that are known in closed form."""

from __future__ import annotations

import numpy as np
import pytest

import tipfem as tp

WATER = tp.Fluid("water", 1000.0, 1e-3)
OIL = tp.Fluid("oil", 900.0, 0.05)
AIR = tp.Fluid("air", 1.2, 1.8e-5)
SYRUP = tp.Fluid("syrup", 1.0, 0.01)


def total(simulation):
    """(K, F) what has passed the openings."""
    return simulation.state.parts["openings"].total


def ramp(time, rise):
    part = min(time / rise, 1.0)
    return part * part * (3 - 2 * part)


@pytest.mark.slow(but=("0.0",))
@pytest.mark.parametrize("angle", [0.0, 0.4, 0.5 * np.pi])
def test_a_uniform_flow_passes_a_channel_in_any_direction(angle):
    length, width, gravity = 0.3, 0.16, 9.81
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    corners = np.array([(0, 0), (length, 0), (length, width), (0, width)]) @ turn
    names = ["below", "out", "above", "in"]
    tank = tp.tank(shape=tp.shapes.polygon(corners.tolist(), names=names), spacing=0.02)
    tank.fill(SYRUP, velocity=turn[0])
    for name in ("below", "above"):
        tank.wall(name, slip=True)
    along = turn[0]
    openings = [
        tp.Inlet(wall="in", fluid=SYRUP, velocity=1.0),
        tp.Outlet(wall="out", pressure=lambda x, t: gravity * (1 - x[:, 1]) + 3.0),
    ]
    exact = tp.Numerics(newton_tolerance=1e-11)
    case = tp.Case(tank, [SYRUP], (0, -gravity), openings=openings, numerics=exact)
    simulation = tp.Simulation(case, time_step=0.01)
    while simulation.time < 0.5:
        simulation.step(0.5)
        p = simulation.particles
        assert np.abs(p.velocity - along).max() < 1e-9
        assert np.abs(p.pressure - gravity * (1 - p.position[:, 1]) - 3.0).max() < 1e-8
    assert total(simulation)[0, 0] == pytest.approx(width * 0.5, rel=1e-12)
    assert total(simulation).sum() == pytest.approx(0.0, abs=1e-14)
    assert len(np.unique([row["particles"] for row in simulation.history])) > 1


@pytest.mark.parametrize("sides", [("right",), ("left", "right")])
def test_layers_stay_at_rest_beside_reservoirs_of_the_same_level(sides):
    width, height, depth = 0.3, 0.16, 0.08
    tank = tp.tank((width, height), 0.02).fill(AIR).fill(WATER, box=((0, 0), (width, depth)))
    for side in tank.sides:
        tank.wall(side, slip=True)
    openings = [tp.Outlet(wall=side, level=depth, fluid=WATER, direction="normal") for side in sides]
    simulation = tp.Simulation(tp.Case(tank, [WATER, AIR], (0, -9.81), openings=openings), time_step=5e-3)
    start = simulation.state.volume.copy()
    for _ in range(30):
        simulation.step()
    assert simulation.particles.max_speed < 1e-9
    assert np.abs(simulation.state.volume - start).max() < 1e-12


def test_layers_stay_at_rest_beside_the_pressure_of_what_stands_in_an_outlet():
    tank = tp.tank((0.3, 0.16), 0.02).fill(AIR).fill(WATER, box=((0, 0), (0.3, 0.08)))
    for side in tank.sides:
        tank.wall(side, slip=True)
    openings = [tp.Outlet(wall="right", pressure="hydrostatic", direction="normal")]
    simulation = tp.Simulation(tp.Case(tank, [WATER, AIR], (0, -9.81), openings=openings), time_step=5e-3)
    for _ in range(30):
        simulation.step()
    assert simulation.particles.max_speed < 1e-9


def poiseuille(spacings):
    """Root mean square error of the velocity, of the pressure gradient, and the simulation after a passage."""
    height, length, speed = 0.2, 0.4, 1.0
    tank = tp.tank((length, height), height / spacings).fill(SYRUP)
    for side in tank.sides:
        tank.wall(side, law="no-slip")
    openings = [
        tp.Inlet(wall="left", fluid="syrup", discharge=speed * height, profile="parabola", ramp=0.1),
        tp.Outlet(wall="right"),
    ]
    simulation = tp.Simulation(tp.Case(tank, [SYRUP], (0, 0), openings=openings), time_step=0.01)
    while simulation.time < 0.6:
        simulation.step(0.6)
    p = simulation.particles
    r = p.position[:, 1] / height
    exact = np.stack([6 * speed * r * (1 - r), 0 * r], axis=1)
    inside = (p.position[:, 0] > 0.2 * length) & (p.position[:, 0] < 0.9 * length)
    slope = np.polyfit(p.position[inside, 0], p.pressure[inside], 1)[0]
    error = np.sqrt(((p.velocity - exact) ** 2).sum(axis=1).mean()) / speed
    return error, slope / (-12 * SYRUP.viscosity * speed / height**2) - 1, simulation


@pytest.mark.slow
def test_poiseuille_flow_between_inlet_and_outlet_is_of_second_order():
    (coarse, gradient, simulation), (fine, _, _) = poiseuille(8), poiseuille(12)
    assert np.log(coarse / fine) / np.log(12 / 8) > 1.9
    assert fine < 0.008
    assert abs(gradient) < 0.035
    assert total(simulation).sum() == pytest.approx(0.0, abs=1e-13)
    # What the pressure and the inlet do is dissipated: the flow is steady at the end.
    last = simulation.history[-1]
    assert last["opening_work"] + last["opening_energy"] == pytest.approx(
        last["viscous_dissipation"] + last["numerical_dissipation"] + 0.0, rel=0.05
    )
    for row in simulation.history:
        assert abs(row["energy_residual"]) < 1e-9 * abs(row["opening_work"]) + 1e-12
        assert abs(row["momentum_residual_x"]) < 2.5e-6  # which Newton's method leaves


def test_a_fountain_fills_a_tank_and_the_air_leaves_by_a_vent():
    tank = tp.tank((0.3, 0.3), 0.02).fill(AIR).fill(WATER, box=((0, 0), (0.3, 0.06)))
    openings = [
        tp.Inlet(wall="bottom", between=((0.1, 0), (0.2, 0)), fluid=WATER, discharge=0.06, ramp=0.05),
        tp.Vent(wall="top", between=((0.02, 0.3), (0.1, 0.3))),
    ]
    simulation = tp.Simulation(tp.Case(tank, [WATER, AIR], (0, -9.81), openings=openings), time_step=4e-3)
    start = simulation.state.volume.copy()
    while simulation.time < 0.25:
        simulation.step(0.25)
    entered = 0.06 * (0.25 - 0.025)
    passed = total(simulation)
    assert passed[0] == pytest.approx([entered, 0.0], rel=1e-12)
    assert passed[1] == pytest.approx([0.0, -entered], rel=1e-9)
    assert simulation.state.volume - start == pytest.approx(passed.sum(axis=0), abs=1e-12 * entered + 1e-13)
    through = sum(row["through_inlet_bottom_water"] for row in simulation.history)
    assert through == pytest.approx(entered, rel=1e-12)
    assert sum(row["opening_volume_air"] for row in simulation.history) == pytest.approx(-entered, rel=1e-9)
    assert simulation.numerical_error()["volume_water"] == pytest.approx(0.0, abs=1e-10)


@pytest.mark.slow
def test_two_layers_pass_a_channel_side_by_side():
    height, length = 0.16, 0.3
    tank = tp.tank((length, height), 0.02).fill(OIL, velocity=(0.4, 0))
    tank.fill(WATER, box=((0, 0), (length, 0.08)), velocity=(0.4, 0))
    for side in tank.sides:
        tank.wall(side, slip=True)

    def fluid(x, _):
        return np.where(x[:, 1] < 0.08, 0, 1)

    openings = [
        tp.Inlet(wall="left", fluid=fluid, velocity=0.4),
        tp.Outlet(wall="right", pressure="hydrostatic", direction="normal"),
    ]
    simulation = tp.Simulation(tp.Case(tank, [WATER, OIL], (0, -9.81), openings=openings), time_step=5e-3)
    while simulation.time < 0.4:
        simulation.step(0.4)
    p, mesh = simulation.particles, simulation.mesh
    assert np.abs(p.velocity - [0.4, 0.0]).max() < 1e-8
    middles = p.position[mesh.cells].mean(axis=1)
    assert (np.asarray(mesh.fluid) == (middles[:, 1] > 0.08)).all()
    entered = 0.4 * 0.4 * height
    assert total(simulation)[0] == pytest.approx([entered / 2, entered / 2], rel=1e-9)
    assert total(simulation)[1] == pytest.approx([-entered / 2, -entered / 2], rel=1e-8)


def test_water_of_a_reservoir_enters_below_its_level_and_no_air_is_driven_in():
    """The air that stands below the level is not driven in by the pressure of the water, at up to 40 m/s."""
    tank = tp.tank((0.4, 0.4), 0.02).fill(AIR).fill(WATER, box=((0, 0), (0.4, 0.2)))
    for side in tank.sides:
        tank.wall(side, slip=True)
    reservoir = tp.Inlet(wall="left", level=lambda t: 0.3, fluid=WATER)
    openings = [reservoir, tp.Vent(wall="top", between=((0.2, 0.4), (0.3, 0.4)))]
    simulation = tp.Simulation(tp.Case(tank, [WATER, AIR], (0, -9.81), openings=openings), time_step=5e-3)
    start, torricelli = simulation.state.volume.copy(), np.sqrt(2 * 9.81 * 0.3)
    while simulation.time < 0.1:
        simulation.step(0.1)
        on = simulation.particles.position[:, 0] < 1e-9
        assert simulation.particles.velocity[on, 0].max() < torricelli
    passed = total(simulation)
    assert passed[0, 0] > 0.005
    assert passed[0, 1] < 0
    assert simulation.state.volume - start == pytest.approx(passed.sum(axis=0), abs=1e-13)
    assert max(abs(row["energy_residual"]) for row in simulation.history) < 1e-9
    assert len(simulation.history) < 40


def test_water_above_the_level_of_a_reservoir_leaves_and_air_follows():
    tank = tp.tank((0.4, 0.4), 0.02).fill(AIR).fill(WATER, box=((0, 0), (0.4, 0.24)))
    for side in tank.sides:
        tank.wall(side, slip=True)
    openings = [tp.Outlet(wall="right", level=0.12, fluid=WATER), tp.Vent(wall="top", between=((0.1, 0.4), (0.2, 0.4)))]
    simulation = tp.Simulation(tp.Case(tank, [WATER, AIR], (0, -9.81), openings=openings), time_step=5e-3)
    while simulation.time < 0.12:
        simulation.step(0.12)
    passed = total(simulation)
    assert passed[0, 0] < -0.005
    assert passed[1, 0] == 0
    assert simulation.particles.max_speed < 5
