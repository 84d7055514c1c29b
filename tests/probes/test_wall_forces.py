"""Forces on walls: their sum is what the fluids' momentum lacks, and steady ones are those of closed forms."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import tipfem as tp
from tipfem.physics.bodies.motion import BodyStates

G = 9.81
ABOUT = np.array([0.03, -0.02])
EXACT = tp.Numerics(mass="lumped", newton_tolerance=1e-13)
SIDES = ("left", "right", "bottom", "top")
LAWS = {
    "no-slip": {"law": "no-slip"},
    "layer": {"law": "layer"},
    "slip": {"slip": True},
    "Navier": {"slip_length": 2e-3},
}


def dam_break(fluids, walls, **options):
    """Water falls in a tank that shakes or not, of spacing 0.04."""
    water, *others = fluids
    tank = tp.tank((0.4, 0.3), 0.04, jitter=0.1)
    if others:
        tank.fill(others[0])
    tank.fill(water, box=((0, 0), (0.16, 0.24)))
    for side, wall in zip(SIDES, walls, strict=True):
        tank.wall(side, **wall)
    return tp.Case(tank, list(fluids), (1.0, -G), numerics=EXACT, **options)


def in_a_shape(fluids, wall, *, body=False, **options):
    """Water falls in a tank with an inclined floor and a round side, maybe around a body that floats."""
    water, air = fluids
    corners = [(0, 0), (0.2, 0.05), (0.5, 0.05), tp.shapes.arc((0.5, 0.25)), (0.5, 0.45), (0, 0.45)]
    shape = tp.shapes.polygon(corners, names=["slope", "floor", "round", "lid", "west"])
    tank = tp.tank(shape=shape, spacing=0.03).fill(air).fill(water, box=((0, 0), (0.3, 0.3)))
    tank.wall("round", **wall)
    if body:
        tank.add(tp.Body(tp.shapes.circle((0.35, 0.3), 0.06), name="disc", density=500.0, law="no-slip"))
    return tp.Case(tank, [water, air], (0, -G), numerics=EXACT, **options)


SHAKEN = tp.Motion(translation=lambda t: (0.05 * np.sin(20 * t), 0.0), angle=lambda t: t**2, pivot=(0.2, 0.0))
BOX = {
    **{law: lambda fluids, wall=wall: dam_break(fluids, [wall] * 4) for law, wall in LAWS.items()},
    "mixed": lambda fluids: dam_break(fluids, list(LAWS.values())),
    "interpolated": lambda fluids: dam_break(fluids, [{"law": "layer"}] * 4, interface="interpolated"),
    "free surface": lambda fluids: dam_break(fluids[:1], [{"law": "layer"}] * 4, free_surface=True),
    "no-slip under a free surface": lambda fluids: dam_break(fluids[:1], [LAWS["no-slip"]] * 4, free_surface=True),
    "moving tank": lambda fluids: dam_break(fluids, list(LAWS.values()), tank_motion=SHAKEN),
    "sliding wall": lambda fluids: dam_break(fluids, [*list(LAWS.values())[:3], {"velocity": (0.3, 0.0)}]),
    "intermediate time": lambda fluids: _with(dam_break(fluids, list(LAWS.values())), rho_inf=0.7),
}
SHAPES = {
    "shape": lambda fluids: in_a_shape(fluids, LAWS["no-slip"]),
    "slip on an arc": lambda fluids: in_a_shape(fluids, LAWS["slip"]),
    "Navier on an arc": lambda fluids: in_a_shape(fluids, LAWS["Navier"]),
    "body": lambda fluids: in_a_shape(fluids, LAWS["no-slip"], body=True),
}


def _with(case, **numerics):
    return tp.Case(case.tank, case.fluids, (1.0, -G), numerics=dataclasses.replace(EXACT, **numerics))


@pytest.mark.parametrize("name", [*BOX, *SHAPES])
def test_the_forces_on_all_walls_are_what_the_fluids_momentum_lacks(water, air, name):
    """And their moments what the angular momentum lacks, in each step."""
    case = (BOX | SHAPES)[name]((water, air))
    walls = SIDES if name in BOX else ("slope", "floor", "round", "lid", "west")
    probes = [tp.WallForce(name=wall, wall=wall, about=ABOUT) for wall in walls]
    simulation = tp.Simulation(case, time_step=4e-3, probes=probes)
    for _ in range(10):
        simulation.step()
        solved, last = simulation.solved, simulation.history[-1]
        start, scheme = solved.before, solved.scheme
        table = np.array([[values[-1] for values in simulation.probes[wall].values()] for wall in walls]).sum(axis=0)
        force, moment = table[1:3] + table[3:5], table[5]
        place = start.particles.position + scheme.cf * solved.displacement - ABOUT
        if bodies := start.part(BodyStates):
            on_body = np.array([last["disc_force_x"], last["disc_force_y"]])
            ends = bodies.position, solved.part(BodyStates).position
            arm = ends[0][0, :2] + scheme.cf * (ends[1] - ends[0])[0, :2]
            arm -= ABOUT
            force, moment = force + on_body, moment + last["disc_moment"] + arm[0] * on_body[1] - arm[1] * on_body[0]
        inertia = start.mass[:, None] * solved.inertia
        scale = np.abs(inertia).sum()
        np.testing.assert_allclose(force, -inertia.sum(axis=0), atol=1e-10 * scale)
        expected = -(place[:, 0] * inertia[:, 1] - place[:, 1] * inertia[:, 0]).sum()
        assert moment == pytest.approx(expected, abs=1e-10 * scale)
        if name in BOX and case.tank_motion is None and not any(wall.velocity for wall in case.walls):
            # What generalized-alpha conserves; fluids, wall particles included, gain it from the walls and weight.
            shift = (0.5 - scheme.alpha_f) * solved.dt
            before, after = (p.velocity + shift * p.acceleration for p in (start.particles, solved.particles))
            gained = solved.dt * (-force + start.mass @ solved.force)
            np.testing.assert_allclose(start.mass @ (after - before), gained, atol=1e-10 * scale * solved.dt)


@pytest.mark.parametrize("wall", LAWS.values(), ids=LAWS)
def test_the_forces_of_fluids_at_rest_are_hydrostatic(water, air, wall):
    """On each wall, whatever its law: rho g H^2 / 2 and the moment rho g H^3 / 6; no friction."""
    tank = tp.tank((0.4, 0.4), 0.04, jitter=0.1).fill(air).fill(water, box=((0, 0), (0.4, 0.2)))
    for side in SIDES:
        tank.wall(side, **wall)
    probes = [tp.WallForce(name=side, wall=side) for side in SIDES]
    simulation = tp.Simulation(tp.Case(tank, [water, air], (0, -G), numerics=EXACT), time_step=4e-3, probes=probes)
    for _ in range(3):
        simulation.step()
    last = {side: {key: values[-1] for key, values in simulation.probes[side].items()} for side in SIDES}
    top, bottom = air.density * G * 0.2, air.density * G * 0.2 + water.density * G * 0.2
    on_side, deep = 0.2 * (0.5 * top + 0.5 * (top + bottom)), {"rel": 1e-9, "abs": 1e-9 * bottom}
    assert last["left"]["pressure_force_x"] == pytest.approx(-on_side, **deep)
    assert last["right"]["pressure_force_x"] == pytest.approx(on_side, **deep)
    assert last["bottom"]["pressure_force_y"] == pytest.approx(-0.4 * bottom, **deep)
    assert last["top"]["pressure_force_y"] == pytest.approx(0.0, **deep)
    by_water = top * 0.2**2 / 2 + water.density * G * 0.2**3 / 6
    assert last["left"]["moment"] == pytest.approx(by_water + 0.5 * top * 0.2 * (0.2 + 0.2 / 3), **deep)
    for found in last.values():
        assert abs(found["viscous_force_x"]) + abs(found["viscous_force_y"]) < 1e-9 * bottom


def test_the_shear_of_couette_flow_is_exact(glycerin):
    """A steady linear profile between a floor at rest and a lid that slides: mu U / H a unit of area on both."""
    tank = tp.tank((0.4, 0.2), 0.04, periodic="x").fill(glycerin, velocity=lambda x: np.outer(2.0 * x[:, 1], (1, 0)))
    tank.wall("top", velocity=(0.4, 0.0)).wall("bottom", law="no-slip")
    probes = [tp.WallForce(name=side, wall=side) for side in ("bottom", "top")]
    simulation = tp.Simulation(tp.Case(tank, [glycerin], (0, -G), numerics=EXACT), time_step=2e-3, probes=probes)
    for _ in range(5):
        simulation.step()
    shear = glycerin.viscosity * 2.0 * 0.4
    for side, sign in (("bottom", 1), ("top", -1)):
        table = simulation.probes[side]
        np.testing.assert_allclose(table["viscous_force_x"], sign * shear, rtol=1e-6)
    np.testing.assert_allclose(simulation.probes["bottom"]["pressure_force_y"], -glycerin.density * G * 0.08, rtol=1e-6)


@pytest.mark.parametrize("law", ["no-slip", "layer"])
def test_the_walls_of_a_channel_take_what_drives_it(glycerin, law):
    """Steady flow between two walls: the friction of both is the body force, whatever the spacing."""
    speed = 0.5 * glycerin.density / glycerin.viscosity
    tank = tp.tank((0.2, 0.1), 0.02, periodic="x")
    tank.fill(glycerin, velocity=lambda x: np.outer(speed * x[:, 1] * (0.1 - x[:, 1]), (1, 0)))
    for side in ("bottom", "top"):
        tank.wall(side, **LAWS[law])
    probes = [tp.WallForce(name=side, wall=side, impulse=True) for side in ("bottom", "top")]
    case = tp.Case(tank, [glycerin], (1.0, 0.0), numerics=EXACT)
    simulation = tp.Simulation(case, time_step=0.02, probes=probes)
    while simulation.time < 0.5 - 1e-9:
        simulation.step()
    drive = glycerin.density * 0.2 * 0.1 * simulation.time
    impulse = [simulation.probes[side]["viscous_force_x_impulse"][-1] for side in ("bottom", "top")]
    assert sum(impulse) == pytest.approx(drive, rel=3e-3)
    assert impulse == pytest.approx([0.5 * drive] * 2, rel=1e-2)


def test_there_is_no_force_before_the_first_step(water, air):
    simulation = tp.Simulation(dam_break((water, air), [LAWS["slip"]] * 4))
    probe = tp.WallForce(name="left", wall="left")
    assert np.isnan(probe.sample(simulation)).all()
    simulation.step()
    assert np.isfinite(probe.sample(simulation)).all()
