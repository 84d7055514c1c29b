"""Bodies under a free surface, and with interfaces between particles: what `test_bodies` has for sharp interfaces."""

from __future__ import annotations

import math

import numpy as np
import pytest
from resumed_runs import require_same_when_resumed

import tipfem as tp
from tipfem.physics.bodies.motion import body_pose, outline_of, stopped_by_bodies
from tipfem.physics.bodies.outlines import Outline

AIR, WATER = tp.Fluid("air", 1.2, 1.8e-5), tp.Fluid("water", 1000.0, 1e-3)
GRAVITY = (0.0, -9.81)


def box(centre=(0.5, 0.5), turn=0.0, size=(0.3, 0.2)):
    rotation = np.array([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]])
    corners = 0.5 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * size
    return corners @ rotation.T + centre


def half_full(*bodies, spacing=0.05, fluids=(WATER,), law=None, depth=0.5):
    tank = tp.tank((1.0, 1.0), spacing)
    if len(fluids) == 2:
        tank.fill(fluids[1])
    tank.fill(fluids[0], box=((0, 0), (1, depth)))
    for side in ("left", "right", "bottom") if law else ():
        tank.wall(side, law=law)
    for body in bodies:
        tank.add(body)
    kind = {"interface": "interpolated"} if len(fluids) == 2 else {"free_surface": True}
    return tp.Case(tank, list(fluids), GRAVITY, **kind)


def require_outside(simulation):
    """No fluid is inside a body: no cell overlaps it, and no particle is in it; the outline is where the body is."""
    states, particles, mesh = simulation.state.parts["bodies"], simulation.particles, simulation.mesh
    for number, body in enumerate(simulation.case.bodies):
        pose, outline = body_pose(body, states, number), outline_of(body)
        assert not outline.contains(pose.origin(particles.position[~particles.wall])).any()
        middle = particles.position[mesh.cells].mean(axis=1)
        assert not outline.contains(pose.origin(middle)).any()
        mine = pose.origin(particles.position[states.label == number])
        # Those that slide on an arc are on that, not on its chords; new ones are between two of them.
        off = outline.distances(mine)[0].min(axis=1).max()
        assert off < (0.15 * particles.spacing if Outline(body).curved else 1e-9)
    tank = simulation.case.boundary.tank.area
    covered = sum(body.area for body in simulation.case.bodies)
    if not simulation.case.grounded:
        assert mesh.measure.sum() == pytest.approx(tank - covered, rel=1e-9)


def energies(row):
    return sum(row[f"{name}_energy"] for name in ("kinetic", "potential", "body_kinetic", "body_potential"))


@pytest.mark.slow(but=("interpolated",))
@pytest.mark.parametrize("fluids", [(WATER,), (WATER, AIR)], ids=["free surface", "interpolated"])
def test_energy_and_volumes_are_accounted_for(fluids):
    bodies = [
        tp.Body(box((0.3, 0.55), size=(0.2, 0.15)), density=500.0, name="box", damping=(3.0, 4.0, 0.5)),
        tp.Body(tp.shapes.circle((0.72, 0.45), 0.1), density=700.0, name="log", angular_velocity=3.0),
    ]
    simulation = tp.Simulation(half_full(*bodies, spacing=0.04, fluids=fluids))
    simulation.step()
    start = energies(simulation.history[0])
    for _ in range(30):
        simulation.step()
        require_outside(simulation)
    rows = simulation.history[1:]
    moved = max(row["body_kinetic_energy"] for row in rows)
    assert moved > 0.01
    # With the interpolated interface a few steps keep more than round-off.
    assert max(abs(row["energy_residual"]) for row in rows) < (1e-9 if len(fluids) == 1 else 1e-5) * moved
    balance = energies(rows[-1]) - start
    for name in ("viscous_dissipation", "numerical_dissipation", "damper_dissipation"):
        balance += sum(row[name] for row in rows)
    assert abs(balance) < 3e-3 * moved
    change = simulation.state.volume / simulation.state.wanted_volume - 1
    assert np.abs(change).max() < (1e-10 if len(fluids) == 1 else 5e-3)
    assert sum(row["refused_steps"] for row in rows) == 0


@pytest.mark.slow
def test_a_body_falls_into_the_water():
    """Through nothing as in vacuum; then the water takes it up, without flowing into it."""
    body = tp.Body(box((0.5, 0.72), turn=0.3), density=400.0)
    simulation = tp.Simulation(half_full(body, spacing=0.04, law="layer"))
    centre = simulation.state.parts["bodies"].position[0].copy()
    while simulation.time < 0.09:
        simulation.step(0.09)
    fallen = simulation.state.parts["bodies"]
    np.testing.assert_allclose(fallen.position[0], centre + (0, -0.5 * 9.81 * 0.09**2, 0), atol=1e-9)
    np.testing.assert_allclose(fallen.velocity[0], (0, -9.81 * 0.09, 0), atol=1e-9)
    assert not simulation.history[-1]["body_force_y"]
    while simulation.time < 0.45:
        simulation.step(0.45)
        require_outside(simulation)
    assert max(row["body_force_y"] for row in simulation.history) > 9.81 * simulation.case.bodies[0].total_mass
    assert abs(simulation.state.parts["bodies"].velocity[0, 1]) < 0.7
    assert simulation.state.volume == pytest.approx(simulation.state.wanted_volume, rel=1e-10)
    # A thin cell that bursts in the splash may take a shorter step.
    assert sum(row["refused_steps"] for row in simulation.history) <= 0.03 * len(simulation.history)


@pytest.mark.slow
def test_a_wave_maker_moves_the_water():
    motion = tp.Motion(translation=lambda t: (0.03 * (1 - math.cos(8 * t)), 0.0))
    paddle = tp.Body(box((0.25, 0.5), size=(0.1, 0.6)), motion=motion, name="paddle")
    simulation = tp.Simulation(half_full(paddle, spacing=0.04, law="layer"))
    while simulation.time < 0.4:
        simulation.step(0.4)
        require_outside(simulation)
    rows = simulation.history[1:]
    assert rows[-1]["paddle_x"] == pytest.approx(0.25 + 0.03 * (1 - math.cos(3.2)), rel=1e-12)
    moved = max(row["kinetic_energy"] for row in rows)
    assert moved > 0.5
    assert sum(row["external_work"] for row in rows) > moved
    assert max(abs(row["energy_residual"]) for row in rows) < 1e-9 * moved


@pytest.mark.slow
def test_contacts_are_found_where_there_is_no_mesh():
    """A body that falls on another in the air, and one that is moved against a wall above the water."""
    lower = tp.Body(box((0.5, 0.5), size=(0.3, 0.1)), name="shelf")
    upper = tp.Body(tp.shapes.circle((0.5, 0.8), 0.05), density=500.0, name="ball")
    simulation = tp.Simulation(half_full(lower, upper, depth=0.25, spacing=0.04), time_step=3e-3)
    with pytest.raises(tp.SimulationError, match="body 'ball' is in contact with body 'shelf' at "):
        simulation.run(0.3, progress=False)
    gap = simulation.state.parts["bodies"].position[1, 1] - 0.05 - 0.55
    assert 0.25 * 0.04 < gap < 0.6 * 0.04
    motion = tp.Motion(translation=lambda t: (t**2, 0.0))
    hammer = tp.Body(box((0.7, 0.8), size=(0.2, 0.1)), motion=motion, contact="hold", name="hammer")
    simulation = tp.Simulation(half_full(hammer, spacing=0.04), time_step=0.02)
    simulation.run(0.6, progress=False)
    assert simulation.state.parts["bodies"].held.all()
    assert 0.17 < simulation.state.parts["bodies"].position[0, 0] - 0.7 < 0.2


def test_spray_does_not_fly_into_bodies():
    body = tp.Body(box((0.5, 0.7), turn=0.3), density=400.0, velocity=(0.5, 0.0), angular_velocity=2.0)
    simulation = tp.Simulation(half_full(body))
    particles, states = simulation.particles.copy(), simulation.state.parts["bodies"]
    flying = np.flatnonzero(~particles.wall)[:3]
    loose = np.zeros(len(particles), dtype=bool)
    loose[flying] = True
    body = simulation.case.bodies[0]
    pose, outline = body_pose(body, states, 0), outline_of(body)
    top = body.corners[[2, 3]].mean(axis=0)
    across = (body.corners[2] - body.corners[1]) / 0.2
    particles.position[flying] = [top - 0.01 * across, top + 0.01 * across, (0.2, 0.2)]
    particles.velocity[flying] = [-across, -across, -across]
    done = stopped_by_bodies([body], states, particles, loose)
    assert not outline.contains(pose.origin(done.position[flying])).any()
    np.testing.assert_array_equal(done.position[flying[1:]], particles.position[flying[1:]])
    np.testing.assert_array_equal(done.velocity[flying[1:]], particles.velocity[flying[1:]])
    relative = done.velocity[flying[0]] - pose.rigid_velocity(done.position[flying[:1]])[0]
    assert relative @ across == pytest.approx(0.0, abs=1e-12)
    others = np.setdiff1d(np.arange(len(particles)), flying)
    np.testing.assert_array_equal(done.position[others], particles.position[others])


@pytest.mark.slow(but=("interpolated",))
@pytest.mark.parametrize("fluids", [(WATER,), (WATER, AIR)], ids=["free surface", "interpolated"])
def test_a_run_goes_on_to_the_bit(tmp_path, fluids):
    require_same_when_resumed(half_full(tp.Body(box(), density=500.0), fluids=fluids), tmp_path)
