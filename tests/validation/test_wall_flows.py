"""Flows along walls that slip, slide and move, against closed forms; they are those of demos/validation/walls."""

from __future__ import annotations

import numpy as np
import pytest
from flow_problems import flow_problem
from scipy.special import erfc
from tipfem.demos.validation.walls import flows

import tipfem as tp
from tipfem.fem.time_integration import GeneralizedAlpha
from tipfem.physics.term import ElementProperties
from tipfem.physics.walls.step import WallsInStep, WallStep
from tipfem.step.linear_system import Workspace


def mean_velocity(simulation):
    """Of all fluid, (2,) [m/s]."""
    mesh = simulation.mesh
    share = np.bincount(mesh.cells.ravel(), np.repeat(mesh.measure / 3, 3))
    return share @ simulation.particles.velocity / share.sum()


@pytest.mark.slow
def test_a_wall_that_slides_drags_the_fluid_as_in_stokes_first_problem():
    """From a layer 4 spacings wide to one of 7: velocities to 0.1 % of the wall's; 0.2 % is asked of viscous flows."""
    nu, speed, h = 1e-4, 5e-3, 1e-3
    past = (4 * h) ** 2 / nu
    fluid, tank = tp.Fluid("oil", 1000.0, 1000.0 * nu), tp.tank((8 * h, 96 * h), h, periodic="x")

    def exact(height, time):
        return speed * erfc(height / np.sqrt(4 * nu * (past + time)))

    tank.fill(fluid, velocity=lambda x: np.stack([exact(x[:, 1], 0.0), 0.0 * x[:, 1]], axis=1))
    tank.wall("bottom", law="no-slip", velocity=(speed, 0.0)).wall("top", slip=True)
    simulation, off = tp.Simulation(tp.Case(tank, [fluid], (0, 0)), time_step=h * h / nu), []
    while simulation.time < 2 * past - 1e-9:
        simulation.step()
        particles = simulation.particles
        off.append(np.abs(particles.velocity[:, 0] - exact(particles.position[:, 1], simulation.time)).max())
    assert max(off) < 1e-3 * speed


@pytest.mark.slow
@pytest.mark.parametrize(("jitter", "sizes"), [(0.0, (16, 32, 64)), (0.2, (16, 32))])
def test_taylor_green_decays_at_its_rate_and_converges_at_second_order(jitter, sizes):
    """Free slip on four walls, to 1/e, particles sliding along the walls from corner to corner."""
    viscosity, errors, relocated = 0.1, [], 0
    for cells in sizes:
        simulation = flows.taylor_green(cells, viscosity, jitter=jitter)
        start = simulation.particles.position
        corners = np.flatnonzero(simulation.case.boundary.stays)
        flows.advance(simulation, 0.5 / (viscosity * np.pi**2))
        particles = simulation.particles
        exact = flows.taylor_green_velocity(particles.position, simulation.time, viscosity)
        errors.append(np.sqrt(((particles.velocity - exact) ** 2).sum(axis=1).mean()))
        amplitude = (particles.velocity * exact).sum() / (exact**2).sum()
        assert abs(amplitude - 1) < 0.01
        relocated += sum(row["relocated"] for row in simulation.history)
        x = particles.position[simulation.boundary.index]
        assert ((x == 0) | (x == 1)).any(axis=1).all()
        assert simulation.mesh.measure.sum() == pytest.approx(1, rel=1e-12)
        assert len(corners) == 4
        np.testing.assert_array_equal(particles.position[corners], start[corners])
        rows = [x[(x[:, axis] == c), 1 - axis] for axis in (0, 1) for c in (0.0, 1.0)]
        gaps = np.concatenate([np.diff(np.sort(row)) for row in rows]) * cells
        assert gaps.min() > 0.3
        assert gaps.max() < 2.2
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert relocated > 100
    assert orders.min() > 1.75, (errors, orders)
    assert abs(orders[-1] - 2) < 0.25, (errors, orders)


@pytest.mark.parametrize("viscosity", [1e-3, 1e-1])
def test_walls_that_slip_cost_no_iterations(viscosity):
    """FGMRES to 1e-8 from the same random displacements, whatever the walls."""
    fluid, h, dt, counts = tp.Fluid("fluid", 1.0, viscosity), 1 / 24, 0.01, []
    for wall in ({"law": "no-slip"}, {"slip": True}, {"slip_length": h}, {"slip_length": 0.01 * h}):
        tank = tp.tank((1, 1), h, jitter=0.2).fill(fluid)
        for side in flows.SIDES:
            tank.wall(side, **wall)
        simulation = tp.Simulation(tp.Case(tank, [fluid], (0, -1)), time_step=dt)
        particles, mesh, scheme = simulation.particles, simulation.mesh, GeneralizedAlpha(0.0, dt)
        material = ElementProperties(*(np.full(len(mesh.cells), value) for value in (1.0, viscosity, 0.0)))
        given = simulation.case.boundary, mesh, particles
        held = wall == {"law": "no-slip"}
        walls = WallsInStep(*given, scheme) if held else WallStep(*given, material.viscosity, scheme, 0.0)
        force = np.tile((0.0, -1.0), (len(particles), 1))
        problem = flow_problem(mesh, particles, material, scheme, force, 0.25, Workspace(), walls)
        u = np.random.default_rng(0).uniform(-1e-3, 1e-3, particles.position.shape) * h
        x = problem.vector(u, particles.pressure)
        problem.residual(x)
        counts.append(problem.correct(x, 1e-8).iterations)
    assert max(counts[1:]) <= 1.2 * counts[0], counts
    assert counts[0] < 80


@pytest.mark.slow(only=("two fluids",))
@pytest.mark.parametrize(
    ("options", "largest"),
    [({"cells": 12}, 0.01), ({"cells": 12, "slip_length": 0.25}, 0.01), ({"cells": 12, "ratio": 5.0}, 0.02)],
    ids=["no slip", "slip length", "two fluids"],
)
def test_long_cavity_under_a_lid(options, largest):
    """The profile of a channel without net flow; the lid's particles stay where they are, but for two fluids."""
    simulation = flows.long_cavity(**options)
    lid = simulation.particles.position[:, 1] == 1
    before = simulation.particles.position[lid]
    flows.advance(simulation, 0.25)
    if "ratio" in options:  # whose interface might meet the lid, and would go with it
        lid = simulation.particles.wall & (simulation.particles.position[:, 1] == 1)
        middle = np.abs(simulation.particles.position[lid, 0] - 3) < 1.5
        np.testing.assert_allclose(simulation.particles.velocity[lid][middle, 0], 1.0, atol=2e-3)
    else:
        np.testing.assert_allclose(simulation.particles.position[lid], before, atol=1e-12)
        np.testing.assert_array_equal(simulation.particles.velocity[lid][1:-1], [[1.0, 0.0]] * (lid.sum() - 2))
    y = np.linspace(0.03, 0.97, 20)
    exact = flows.channel(options.get("slip_length", 0.0), options.get("ratio", 1.0))(y)
    got = np.mean([flows.profile(simulation, np.stack([0 * y + x, y], axis=1))[:, 0] for x in (2.6, 3.0, 3.4)], axis=0)
    assert np.abs(got - exact).max() < largest


@pytest.mark.parametrize("slip", [False, True])
def test_rigid_translation_is_hydrostatics_with_effective_gravity(slip):
    """A tank full of one fluid, shaken and lifted: it moves as one, and grad p = rho (g - a)."""
    simulation, rates = flows.swayed(20, slip=slip)
    for _ in range(40):
        simulation.step()
    particles = simulation.particles
    velocity, acceleration = rates(simulation.time)
    assert np.abs(velocity).max() > 0.1
    np.testing.assert_allclose(particles.velocity, np.tile(velocity, (len(particles), 1)), atol=1e-4)
    pressure = 1000.0 * particles.position @ (np.array([0, -9.81]) - acceleration)
    off = particles.pressure - pressure
    assert np.ptp(off) < 1e-3 * np.ptp(pressure)
    assert simulation.mesh.measure.sum() == pytest.approx(0.6, rel=1e-12)


@pytest.mark.slow
def test_a_fluid_without_friction_keeps_its_vorticity_of_zero_in_a_tank_that_rolls():
    """The potential flow in a square that turns, through walls of free slip; walls exactly where the tank is."""
    errors = []
    for cells in (16, 32):
        simulation = flows.advance(flows.rolled(cells), 0.9)
        particles = simulation.particles
        exact = flows.rolled_velocity(particles.position, simulation.time)
        errors.append(np.sqrt(((particles.velocity - exact) ** 2).sum(axis=1).mean() / (exact**2).sum(axis=1).mean()))
        boundary = simulation.boundary
        y = boundary.pose(simulation.time, 1e-3).origin(particles.position)[boundary.index]
        assert np.abs(np.abs(y - 0.5).max(axis=1) - 0.5).max() < 1e-14
    assert errors[1] < 0.03
    assert errors[1] < 0.5 * errors[0]


@pytest.mark.slow
def test_waves_between_two_layers_in_a_tank_that_sways_follow_linear_theory():
    """The lower layer's first moment, through its largest swing and back."""
    simulation, rows = flows.sloshed(16), []
    while simulation.time < 2.8:
        simulation.step(2.8)
        rows.append((simulation.time, flows.first_moment(simulation)))
    time, moment = np.array(rows).T
    linear = flows.linear_moment(time)
    assert np.sqrt(((moment - linear) ** 2).mean()) < 0.08 * np.abs(linear).max()
    assert np.ptp(moment) == pytest.approx(np.ptp(linear), rel=0.15)


@pytest.mark.slow
@pytest.mark.parametrize("slip", [False, True])
def test_two_pistons_push_the_fluid_along(slip):
    """Walls that move together: the stroke times the depth passes every section, floors cope with both ends."""
    simulation = flows.pistons(10, slip=slip)
    grids = set()
    for end in (0.8, 1.5):
        flows.advance(simulation, end)
        particles, moved = simulation.particles, flows.stroke(end)
        assert particles.position[:, 0].min() == pytest.approx(moved, rel=1e-12)
        assert particles.position[:, 0].max() == pytest.approx(1 + moved, rel=1e-12)
        assert simulation.mesh.measure.sum() == pytest.approx(0.4, rel=1e-12)
        floor = np.sort(particles.position[particles.wall & (particles.position[:, 1] == 0), 0])
        assert 24 <= len(floor) <= 28
        assert 0.5 * 0.04 < np.diff(floor).min()
        assert np.diff(floor).max() < 1.7 * 0.04
        assert mean_velocity(simulation)[0] == pytest.approx(0.3 * np.sin(2 * end), rel=0.02)
        grids.add(simulation.state.grid_box.tobytes())
    assert len(grids) <= 2


@pytest.mark.slow(but=("0.5",))
@pytest.mark.parametrize("rho_inf", [0.0, 0.5, 1.0])
def test_all_kinds_of_walls_at_once(rho_inf):
    """Pistons that slip, a lid, a floor with friction that slides ever faster, in a tank that is lifted and tilts."""
    fluid = tp.Fluid("fluid", 1.0, 1e-2)
    tank = tp.tank((1, 0.4), 0.04, jitter=0.2).fill(fluid)
    tank.wall("left", motion=flows.stroke, slip=True).wall("right", motion=lambda t: -flows.stroke(t), slip=True)
    tank.wall("top", velocity=(0.3, 0)).wall("bottom", slip_length=0.1, velocity=lambda t: (t, 0.0))
    motion = tp.Motion(translation=lambda t: (0.0, t**2), angle=lambda t: 0.2 * np.sin(t) ** 2, pivot=(0.5, 0.0))
    case = tp.Case(tank, [fluid], (0, -9.81), tank_motion=motion, numerics=tp.Numerics(rho_inf=rho_inf))
    simulation = flows.advance(tp.Simulation(case, time_step=0.01), 0.6)
    particles, boundary = simulation.particles, simulation.boundary
    y = boundary.pose(simulation.time, 1e-3).origin(particles.position)
    lower, upper = y.min(axis=0), y.max(axis=0)
    moved = flows.stroke(simulation.time)
    np.testing.assert_allclose([lower, upper], [[moved, 0], [1 + moved, 0.4]], atol=1e-12)
    assert simulation.mesh.measure.sum() == pytest.approx(0.4, rel=1e-12)
    sides = [np.abs(y[boundary.index, axis] - c) for axis, c in ((0, lower[0]), (0, upper[0]), (1, 0), (1, 0.4))]
    assert np.min(sides, axis=0).max() < 1e-12
    assert len(simulation.history) < 70


def test_walls_in_3d(water):
    """A tank in 3-D that slides along, free slip on some walls and friction on others: it moves as one."""
    tank = tp.tank((1, 1, 1), 0.2, jitter=0.1).fill(water)
    tank.wall("left", slip=True).wall("bottom", slip=True).wall("top", slip_length=0.1).wall("back", slip=True)
    motion = tp.Motion(translation=lambda t: (t**2, 0.0, -0.5 * t**2))
    simulation = tp.Simulation(
        tp.Case(tank, [water], (0, -9.81, 0), tank_motion=motion, interface="interpolated"), time_step=0.01
    )
    for _ in range(5):
        simulation.step()
    velocity = np.array([2.0, 0.0, -1.0]) * simulation.time
    np.testing.assert_allclose(simulation.particles.velocity, np.tile(velocity, (216, 1)), atol=1e-3)
    pressure = -998.2 * simulation.particles.position @ np.array([2.0, 9.81, -1.0])
    assert np.ptp(simulation.particles.pressure - pressure) < 1e-2 * np.ptp(pressure)
