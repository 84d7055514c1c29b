"""Convex corners of tanks along whose walls fluids slide."""

from __future__ import annotations

import math

import numpy as np
import pytest
from resumed_runs import require_same_when_resumed

import tipfem as tp
from tipfem.physics.bodies.motion import BodyStates
from tipfem.physics.walls.corners import corners_of_walls

WATER = tp.Fluid("water", density=1000.0, viscosity=1e-6)
OIL = tp.Fluid("oil", density=900.0, viscosity=2e-3)
HEIGHT, RISE, LENGTH = 0.2, 0.1, 0.4
STEP = [(0, 0), (0.5, 0), (0.5, 0.3), (1, 0.3), (1, 1), (0, 1)]
SILL = [(0, 0), (0.4, 0), (0.4, 0.2), (0.6, 0.2), (0.6, 0), (1, 0), (1, 1), (0, 1)]
ROUND = [(0, 0), (0.4, 0), tp.shapes.arc((0.6, 0.0), clockwise=True), *SILL[3:]]
SQUARE = [(0.3, 0.55), (0.55, 0.55), (0.55, 0.8), (0.3, 0.8)]
PLATE = [(0, 0), (0.4, 0), (0.5, 0.5), (0.505, 0.499), (0.4052, 0), *SILL[5:]]  # 0.1 spacings thick
BOX = [(0, 0), (1, 0), (1, 1), (0, 1)]


def found(simulation):
    """The corners that slide in the next step: round which the fluid flows, and brinks."""
    state = simulation.state
    corners = corners_of_walls(state.boundary, state.particles.target, state.mesh, None)
    return (0, 0) if corners is None else (int(corners.turns.sum()), int((~corners.turns).sum()))


def channel(corners, names, spacing, velocity, law="slip", shape=None, **options):
    """Water in a tank from a side "in" to one "out", between walls that slip."""
    tank = tp.tank(shape=shape or tp.shapes.polygon(corners, names=names), spacing=spacing, **options).fill(WATER)
    for name in tank.sides:
        if name not in ("in", "out", "axis"):
            tank.wall(name, slip=law == "slip", law=None if law == "slip" else law)
    openings = [tp.Inlet(wall="in", fluid=WATER, velocity=velocity), tp.Outlet(wall="out", direction="normal")]
    return tank, openings


@pytest.mark.parametrize(("law", "across", "down"), [("slip", 4, False), ("slip", 4, True), ("layer", 6, False)])
def test_inertance_of_a_step_in_a_channel(law, across, down):
    """The pressure that sets off the water, over that of two uniform flows: by conformal mapping (N. Marcuvitz,
    Waveguide Handbook, 1951, section 5.26, in the limit of long waves) their lengths over their heights, and this. It
    is within 1 %; with corners that hold the fluid 12, 14 and 5.5 % too large."""
    names = ["floor", "face", "crest", "out", "roof", "in"]
    end, first = (0, RISE) if down else (RISE, 0)
    corners = [(0, first), (LENGTH, first), (LENGTH, end), (2 * LENGTH, end), (2 * LENGTH, HEIGHT), (0, HEIGHT)]
    tank, openings = channel(corners, names, RISE / across, lambda t: t, law)
    simulation = tp.Simulation(tp.Case(tank, [WATER], (0, 0), openings=openings), time_step=1e-3)
    for _ in range(12):
        simulation.step()
        assert found(simulation) == (1, 0)
    particles, row, ratio = simulation.particles, simulation.history[-1], 1 - RISE / HEIGHT
    on = np.flatnonzero(particles.position[:, 0] < 1e-9)
    on = on[np.argsort(particles.position[on, 1])]
    before, after = HEIGHT - first, HEIGHT - end
    pressure = np.trapezoid(particles.pressure[on], particles.position[on, 1]) / before
    discharge = row["time"] * before
    pressure -= 0.5 * WATER.density * discharge**2 * (1 / after**2 - 1 / before**2)
    exact = (ratio + 1 / ratio) * math.log((1 + ratio) / (1 - ratio)) - 2 * math.log(4 * ratio / (1 - ratio**2))
    inertance = pressure / (WATER.density * before) - LENGTH / before - LENGTH / after
    assert inertance * math.pi / exact == pytest.approx(1, abs=0.01)
    # What passes openings is to round-off what they say, and no volume is made in the corner.
    through = [sum(r[f"through_{name}_water"] for r in simulation.history) for name in ("inlet_in", "outlet_out")]
    assert through[0] == pytest.approx(0.5 * row["time"] * discharge, rel=1e-6)
    assert sum(through) == pytest.approx(0, abs=1e-15)
    assert simulation.state.volume_error < 1e-12
    assert max(abs(r["energy_residual"]) for r in simulation.history) < 1e-12 * row["kinetic_energy"]


def tank_of(shape, fluids, level, law, holes=()):
    tank = tp.tank(shape=tp.shapes.polygon(shape, holes=holes), spacing=0.05)
    for k, fluid in enumerate(fluids):
        tank.fill(fluid, box=((0, 0), (1, level)) if level and k == len(fluids) - 1 else None)
    for name in tank.sides:
        tank.wall(name, slip=law is None, law=law)
    return tank


@pytest.mark.parametrize("law", [None, "layer"])
@pytest.mark.parametrize(
    ("shape", "fluids", "level", "corners"),
    [
        (STEP, [WATER], None, 1),
        (STEP, [WATER], 0.8, 1),
        (SILL, [OIL, WATER], 0.5, 2),
        (SILL, [OIL, WATER], 0.2, 0),
        (SILL, [WATER], 0.2, 0),
        (PLATE, [WATER], 0.8, 2),
        (ROUND, [WATER], 0.8, 1),
        (ROUND, [OIL, WATER], 0.5, 1),
        (BOX, [OIL, WATER], 0.4, 4),
    ],
    ids=["full", "surface", "two", "interface", "level", "plate", "arc", "arc and two", "hole"],
)
def test_fluids_at_rest_stay_at_rest_beside_corners(shape, fluids, level, corners, law):
    """Corners at which fluids, or fluid and surface, meet are held."""
    tank = tank_of(shape, fluids, level, law, [SQUARE] if shape is BOX else [])
    case = tp.Case(tank, fluids, (0.0, -9.81), free_surface=level is not None and len(fluids) == 1)
    simulation = tp.Simulation(case, time_step=2e-3)
    for _ in range(20):
        simulation.step()
    assert found(simulation) == (corners, 0)
    assert simulation.particles.max_speed < 1e-10


@pytest.mark.slow(but=("surface-None",))
@pytest.mark.parametrize("motion", [None, "turns"])
@pytest.mark.parametrize(
    ("shape", "fluids", "level"),
    [(SILL, [OIL, WATER], 0.5), (ROUND, [OIL, WATER], 0.5), (SILL, [WATER], 0.6), (ROUND, [WATER], 0.6)],
    ids=["two", "arc and two", "surface", "arc and surface"],
)
def test_volumes_and_energy_are_kept_beside_corners(shape, fluids, level, motion):
    """Also of a tank that turns."""
    surface = len(fluids) == 1
    turns = tp.Motion(angle=lambda t: 0.1 * (1 - math.cos(5 * t)) ** 2, pivot=(0.5, 0.0)) if motion else None
    gravity = (0.0, -9.81) if motion else (3.0, -9.81)
    case = tp.Case(tank_of(shape, fluids, level, None), fluids, gravity, free_surface=surface, tank_motion=turns)
    simulation = tp.Simulation(case, time_step=2e-3)
    while simulation.time < 0.25:
        simulation.step()
    rows = simulation.history
    assert found(simulation)[0] == (1 if shape is ROUND else 2)
    assert simulation.state.volume_error < 1e-12
    assert max(abs(row["energy_residual"]) for row in rows) < 1e-10 * max(row["kinetic_energy"] for row in rows)
    assert sum(row["refused_steps"] for row in rows) == 0


def test_a_tank_that_accelerates_is_as_one_in_another_gravity():
    """Corners go with the tank; within what differences of its motion are off."""

    def run(gravity, motion):
        case = tp.Case(tank_of(SILL, [WATER], 0.6, None), [WATER], gravity, free_surface=True, tank_motion=motion)
        simulation = tp.Simulation(case, time_step=2e-3)
        for _ in range(3):
            simulation.step()
        return simulation

    moved = run((0.0, -9.81), tp.Motion(translation=lambda t: (1.5 * t * t, 0.0)))
    other, time = run((-3.0, -9.81), None).particles, moved.time
    assert found(moved) == (2, 0)
    np.testing.assert_allclose(moved.particles.position - [1.5 * time**2, 0], other.position, atol=2e-7)
    np.testing.assert_allclose(moved.particles.velocity - [3 * time, 0], other.velocity, atol=3e-3 * other.max_speed)


@pytest.mark.slow
def test_a_run_with_corners_goes_on_to_the_bit(tmp_path):
    case = tp.Case(tank_of(ROUND, [OIL, WATER], 0.5, None), [OIL, WATER], (3.0, -9.81))
    require_same_when_resumed(case, tmp_path)


def test_a_hole_is_as_a_body_that_is_fixed():
    """Both are solids along which water slides: the same flow, and the same force, to round-off."""
    corners, names = [(0, 0), (0.6, 0), (0.6, 0.3), (0, 0.3)], ["below", "out", "above", "in"]
    square = tp.shapes.rectangle((0.2, 0.1), (0.3, 0.2))
    simulations, sides = [], ("left", "top", "right", "bottom")
    for body in (False, True):
        shape = tp.shapes.polygon(corners, names=names, holes=[] if body else [square])
        tank, openings = channel(None, None, 0.02, lambda t: 10 * t, shape=shape)
        if body:
            tank.add(tp.Body(square, name="b", slip=True))
        probes = [] if body else [tp.WallForce(name=side, wall=side) for side in sides]
        case = tp.Case(tank, [WATER], (0, 0), openings=openings)
        simulations.append(tp.Simulation(case, time_step=1e-3, probes=probes))
    hole, body = simulations
    for _ in range(5):
        hole.step()
        body.step()
        assert found(hole) == (4, 0)
        assert len(body.state.part(BodyStates).corners) == 4
        for name in ("position", "velocity"):
            one, other = (getattr(s.particles, name) for s in simulations)
            np.testing.assert_allclose(one, other, atol=1e-12)
    row = body.history[-1]
    for axis in "xy":
        columns = [f"{part}_force_{axis}" for part in ("pressure", "viscous")]
        force = sum(hole.probes[side][column][-1] for side in sides for column in columns)
        assert force == pytest.approx(row[f"b_force_{axis}"], abs=1e-9 * abs(row["b_force_x"]))


def test_a_contraction_of_a_pipe_keeps_its_volume():
    """Rings: what the slip of a corner takes is cubic in it."""
    corners = [(0, 0), (0.2, 0), (0.2, 0.3), (0.1, 0.3), (0.1, 0.6), (0, 0.6)]
    names = ["in", "wall", "face", "neck", "out", "axis"]
    tank, openings = channel(corners, names, 0.02, lambda t: 10 * t, coordinates="axisymmetric")
    simulation = tp.Simulation(tp.Case(tank, [WATER], (0, 0), openings=openings), time_step=2e-3)
    while simulation.time < 0.1:
        simulation.step()
    rows = simulation.history
    assert found(simulation) == (1, 0)
    through = [sum(row[f"through_{name}_water"] for row in rows) for name in ("inlet_in", "outlet_out")]
    assert sum(through) == pytest.approx(0, abs=1e-14)
    assert simulation.state.volume_error < 1e-12
    assert max(abs(row["energy_residual"]) for row in rows) < 1e-12 * rows[-1]["kinetic_energy"]
    assert np.mean([row["newton_iterations"] for row in rows]) < 3


@pytest.mark.slow
def test_a_stream_over_a_thin_plate_is_not_refused():
    """Its edge of 0.1 spacings is passed by 0.4 of them in a step."""
    thick = 0.1 * RISE / 4
    corners = [(0, 0), (0.4, 0), (0.4, RISE), (0.4 + thick, RISE), (0.4 + thick, 0), (0.8, 0), (0.8, 0.2), (0, 0.2)]
    names = ["floor", "front", "edge", "back", "floor", "out", "roof", "in"]
    tank, openings = channel(corners, names, RISE / 4, lambda t: min(10 * t, 1.0))
    simulation = tp.Simulation(tp.Case(tank, [WATER], (0, 0), openings=openings), time_step=2e-3)
    while simulation.time < 0.4:
        simulation.step(0.4)
    assert found(simulation) == (2, 0)
    assert sum(row["refused_steps"] for row in simulation.history) <= 2


def test_no_slip_walls_hold_their_corners():
    tank = tank_of(STEP, [WATER], None, "no-slip")
    assert found(tp.Simulation(tp.Case(tank, [WATER], (0.0, -9.81)))) == (0, 0)
