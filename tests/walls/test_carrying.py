"""No-slip walls that slide along themselves carry the surfaces that meet them."""

from __future__ import annotations

import numpy as np
import pytest

import tipfem as tp

SIDE, RADIUS = 0.3, 0.1  # of the box and of the drum [m]
SYRUP, AIR = tp.Fluid("syrup", density=1200.0, viscosity=5.0), tp.Fluid("air", density=1.2, viscosity=1.8e-5)
SPEED, RAMP = 0.5, 0.1  # of the walls [m/s], and the time [s] in which they reach it


def gone(time):
    """Distance that the walls have run [m]."""
    return SPEED * (time - 0.5 * RAMP) if time > RAMP else 0.5 * SPEED / RAMP * time**2


def speed(time):
    """Of the walls [m/s]."""
    return SPEED * min(time / RAMP, 1.0)


def half_full(tank, box, free):
    if not free:
        tank.fill(AIR)
    tank.fill(SYRUP, box=box)
    return tp.Case(tank, [SYRUP, AIR][: 2 - free], (0, -9.81), free_surface=free)


def lifted(free, across=24, to=(0.0, 1.0)):
    """A box half full of syrup, of which the right wall slides upwards, or ``to`` another direction."""
    tank = tp.tank((SIDE, SIDE), SIDE / across)
    tank.wall("right", velocity=lambda time: tuple(speed(time) * np.array(to)))
    return half_full(tank, ((0, 0), (SIDE, 0.5 * SIDE)), free)


def drum(free, across=20):
    """A round tank half full of syrup, of which the rim turns anticlockwise."""
    tank = tp.tank(shape=tp.shapes.circle((0, 0), RADIUS), spacing=2 * RADIUS / across)
    for side in tank.sides:
        tank.wall(side, velocity=speed)
    return half_full(tank, ((-RADIUS, -RADIUS), (RADIUS, 0)), free)


def wet(simulation, on):
    """Positions of the particles in a mask that the syrup wets [m]."""
    mesh = simulation.mesh
    here = np.zeros(len(mesh.position), dtype=bool)
    here[mesh.cells[np.asarray(mesh.fluid) == 0]] = True
    return simulation.particles.position[here & on]


def until(case, end):
    simulation = tp.Simulation(case)
    while simulation.time < end:
        simulation.step()
    return simulation


def closed(simulation):
    """Whether energy and volume closed in all steps."""
    rows = simulation.history
    moved = max(abs(row["external_work"]) for row in rows)
    return max(abs(row["energy_residual"]) for row in rows) < 1e-9 * moved and (
        abs(rows[-1]["volume_syrup"] / rows[0]["volume_syrup"] - 1) < 1e-10
    )


@pytest.mark.parametrize("free", [False, True])
def test_a_contact_goes_up_with_its_wall(free):
    """By 5 cm, less a spacing where a contact passes on to a neighbour; by 2 where particles stay."""
    simulation = until(lifted(free), 0.15)
    x = simulation.particles.position
    height = wet(simulation, np.abs(x[:, 0] - SIDE) < 1e-9)[:, 1].max() - 0.5 * SIDE
    assert gone(simulation.time) - SIDE / 24 <= height <= gone(simulation.time) + 1e-9
    assert closed(simulation)


def test_a_contact_goes_down_until_a_film_of_air_breaks():
    simulation = until(lifted(free=False, to=(0.0, -1.0)), 0.12)
    x = simulation.particles.position
    height = wet(simulation, np.abs(x[:, 0] - SIDE) < 1e-9)[:, 1].max() - 0.5 * SIDE
    assert -gone(simulation.time) - 1e-9 <= height < -0.5 * SIDE / 24
    assert closed(simulation)


@pytest.mark.slow
@pytest.mark.parametrize("free", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_contacts_go_round_with_the_rim_of_a_drum(free):
    """They stayed where they were, to 2 degrees, where the rim's particles did."""
    simulation = until(drum(free), 0.25)
    x = wet(simulation, simulation.particles.wall)
    turned = np.arctan2(x[:, 1], x[:, 0])
    turned = turned[np.abs(turned) < 0.5 * np.pi].max()
    assert turned == pytest.approx(gone(simulation.time) / RADIUS, abs=2.1 * 2 / 20)
    assert np.linalg.norm(simulation.particles.position[simulation.particles.wall], axis=1) == pytest.approx(
        RADIUS, abs=0.02 * 2 * RADIUS / 20
    )
    assert closed(simulation)


def test_fluids_at_rest_rest_beside_a_wall_that_may_slide():
    tank = tp.tank((SIDE, SIDE), SIDE / 30).wall("right", velocity=0.0)
    simulation = until(half_full(tank, ((0, 0), (SIDE, 0.5 * SIDE)), free=False), 0.02)
    assert any(wall.carries for wall in simulation.state.boundary.walls)
    assert np.abs(simulation.particles.velocity).max() < 1e-10


def test_particles_of_lids_on_one_fluid_stay():
    tank = tp.tank((SIDE, SIDE), SIDE / 12).fill(SYRUP).wall("top", velocity=(SPEED, 0.0))
    simulation = until(tp.Case(tank, [SYRUP], (0, 0)), 0.02)
    lid = simulation.case.particles.position[:, 1] == SIDE
    np.testing.assert_array_equal(simulation.particles.position[lid], simulation.case.particles.position[lid])
    assert not any(wall.carries for wall in simulation.state.boundary.walls)


def test_the_speed_at_the_wall_is_the_wall_s():
    """To a thousandth; at corners with walls that rest it jumps."""
    for viscosity in (50.0, 5.0):
        syrup = tp.Fluid("syrup", density=1200.0, viscosity=viscosity)
        tank = tp.tank((SIDE, SIDE), SIDE / 24).fill(syrup, box=((0, 0), (SIDE, 0.5 * SIDE)))
        tank.wall("bottom", velocity=lambda time: (speed(time), 0.0))
        simulation = until(tp.Case(tank, [syrup], (0, -9.81), free_surface=True), 0.1)
        assert any(wall.carries for wall in simulation.state.boundary.walls)
        x, v = simulation.particles.position, simulation.particles.velocity
        inner = (x[:, 1] == 0) & (np.abs(x[:, 0] - 0.5 * SIDE) < 0.2 * SIDE)
        assert v[inner, 0] == pytest.approx(speed(simulation.time), rel=2e-3)


def test_walls_carry_no_film_that_no_particles_resolve():
    """Of water it is 0.2 mm thick; particles of the wall stay, and the speed there is the wall's to the last digit."""
    water = tp.Fluid("syrup", density=1000.0, viscosity=1e-3)
    tank = tp.tank((SIDE, SIDE), SIDE / 12).fill(water, box=((0, 0), (SIDE, 0.5 * SIDE)))
    tank.wall("right", velocity=(0.0, SPEED))
    simulation = until(tp.Case(tank, [water], (0, -9.81), free_surface=True), 0.1)
    assert not any(wall.carries for wall in simulation.state.boundary.walls)
    x, v = simulation.particles.position, simulation.particles.velocity
    inner = (np.abs(x[:, 0] - SIDE) < 1e-12) & (x[:, 1] > 0) & (x[:, 1] < 0.4 * SIDE)
    np.testing.assert_array_equal(v[inner], [[0.0, SPEED]] * inner.sum())
    highest = wet(simulation, np.abs(x[:, 0] - SIDE) < 1e-9)[:, 1].max()
    assert abs(highest - 0.5 * SIDE) < 2 * SIDE / 12
