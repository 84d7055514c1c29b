"""Walls that move along their normals in tanks with bodies and with shapes."""

from __future__ import annotations

import math

import numpy as np
import pytest

import tipfem as tp


def pushed(time):
    """Displacement of the piston [m]."""
    return 0.03 * (1 - math.cos(6 * time))


def box(**motion):
    corners = [(0.4, 0.15), (0.5, 0.15), (0.5, 0.22), (0.4, 0.22)]
    return tp.Body(corners, name="box", **(motion or {"density": 500.0}))


@pytest.mark.slow
@pytest.mark.parametrize("free_surface", [True, False], ids=["free surface", "air"])
@pytest.mark.parametrize("body", ["floats", "is moved"])
def test_a_piston_drives_waves_to_a_body(water, air, free_surface, body):
    tank = tp.tank((0.8, 0.4), 0.02)
    tank = tank if free_surface else tank.fill(air)
    tank.fill(water, box=((0, 0), (0.8, 0.2))).wall("left", motion=pushed)
    if not free_surface:
        tank.wall("right", motion=lambda time: -pushed(time))
    tank.add(box() if body == "floats" else box(motion=tp.Motion(angle=lambda time: 0.2 * math.sin(time) ** 2)))
    fluids = [water] if free_surface else [water, air]
    simulation = tp.Simulation(tp.Case(tank, fluids, (0, -9.81), free_surface=free_surface), time_step=4e-3)
    before = simulation.volume("water")
    simulation.run(until=0.4, progress=False)
    position = simulation.particles.position
    assert position[:, 0].min() == pytest.approx(pushed(0.4), abs=1e-12)
    assert simulation.volume("water") == pytest.approx(before, rel=1e-10)
    assert simulation.particles.max_speed > 0.05
    if body == "floats" and free_surface:
        # What the piston has pushed away has lifted the surface and the body with it.
        lifted = simulation.volume("water") / (0.8 - pushed(0.4)) - simulation.volume("water") / 0.8
        assert simulation.state.particles.position[:, 1].max() > 0.2 + 0.5 * lifted


def test_a_body_that_a_piston_reaches_stops_the_run(water):
    tank = tp.tank((0.8, 0.4), 0.02).fill(water, box=((0, 0), (0.8, 0.2)))
    tank.wall("left", motion=lambda time: 2.0 * time**2)
    tank.add(box(motion=tp.Motion(angle=lambda time: 0.0 * time)))
    simulation = tp.Simulation(tp.Case(tank, [water], (0, -9.81), free_surface=True), time_step=4e-3)
    with pytest.raises(ValueError, match=r"body 'box': .* the wall 'left' at t = 0\.44"):
        simulation.run(until=0.5, progress=False)


@pytest.mark.slow
def test_the_inclined_wall_of_a_tank_follows_its_motion(water):
    corners = [(0.0, 0.0), (0.8, 0.0), (1.0, 0.4), (0.0, 0.4)]
    tank = tp.tank(shape=corners, spacing=0.02).fill(water, box=((0, 0), (1.0, 0.2)))
    tank.wall("side1", motion=pushed)
    simulation = tp.Simulation(tp.Case(tank, [water], (0, -9.81), free_surface=True), time_step=4e-3)
    before = simulation.volume("water")
    simulation.run(until=0.3, progress=False)
    inwards = np.array([-0.4, 0.2]) / math.hypot(0.4, 0.2)
    distance = (simulation.particles.position - (0.8, 0.0)) @ inwards
    assert distance.min() == pytest.approx(pushed(0.3), abs=1e-12)
    assert simulation.volume("water") == pytest.approx(before, rel=1e-10)


def test_spray_is_stopped_where_a_wall_has_moved_to(water):
    corners = [(0.0, 0.0), (0.8, 0.0), (1.0, 0.4), (0.0, 0.4)]
    tank = tp.tank(shape=corners, spacing=0.02).fill(water, box=((0, 0), (1.0, 0.2)))
    tank.wall("side3", motion=lambda time: 0.5 * time)
    boundary = tp.Case(tank, [water], (0, -9.81), free_surface=True).boundary
    particles = tp.Case(tank, [water], (0, -9.81), free_surface=True).particles.copy()
    free = int(np.flatnonzero(~particles.wall)[0])
    particles.position[free] = (0.07, 0.3)
    loose = np.arange(len(particles)) == free
    assert (boundary.stopped(particles, loose, 0.1).position[free] == (0.07, 0.3)).all()
    assert boundary.stopped(particles, loose, 0.2).position[free, 0] >= 0.1
