"""Tanks in 3-D with blocks: water at rest round them, its forces on them, dam breaks over them, and case files."""

from __future__ import annotations

import numpy as np
import pytest
from resumed_runs import require_same_when_resumed

import tipfem as tp

WATER, AIR = tp.Fluid("water", 1000.0, 1e-3), tp.Fluid("air", 1.2, 1.8e-5)
SIZE, DOWN = (1.0, 0.8, 0.6), (0.0, 0.0, -9.81)
STEP, PIER = ((0, 0, 0), (0.2, 0.8, 0.15)), ((0.5, 0.3, 0), (0.7, 0.5, 0.6))
SUNK = ((0.4, 0.2, 0), (0.6, 0.6, 0.2))


def tank(blocks, spacing=0.1, **what):
    """A tank with blocks by their names."""
    made = tp.tank(SIZE, spacing, jitter=0.15)
    for name, box in blocks.items():
        made.block(name, box, **what)
    return made


@pytest.mark.slow(only=("True-layer",))
@pytest.mark.parametrize("law", ["no-slip", "layer", None])
@pytest.mark.parametrize("free_surface", [True, False])
def test_water_rests_round_blocks(law, free_surface):
    made = tank({"step": STEP, "pier": PIER}, law=law)
    if not free_surface:
        made.fill(AIR)
    made.fill(WATER, box=((0, 0, 0), (1, 0.8, 0.3)))
    case = tp.Case(made, [WATER] if free_surface else [WATER, AIR], DOWN, free_surface=free_surface)
    simulation = tp.Simulation(case, time_step=0.01)
    assert simulation.volume("water") == pytest.approx(0.8 * 0.3 - 0.2 * 0.8 * 0.15 - 0.2 * 0.2 * 0.3, rel=1e-12)
    for _ in range(10):
        simulation.step()
    assert np.abs(simulation.particles.velocity).max() < 1e-9


def test_forces_and_pressures_on_a_block_are_hydrostatic():
    """A block under water has its weight less buoyancy on top of it, and nothing along the floor."""
    probes = [
        tp.WallForce(name="whole", wall="sunk"),
        tp.WallForce(name="top", wall="sunk front"),
        tp.WallForce(name="right", wall="sunk right"),
        tp.WallPressure(name="at", wall="sunk right", at=(0.6, 0.4, 0.1)),
        tp.WallPressure(name="any", wall="sunk", at=(0.5, 0.4, 0.2)),
    ]
    made = tank({"sunk": SUNK}).fill(WATER, box=((0, 0, 0), (1, 0.8, 0.4)))
    simulation = tp.Simulation(tp.Case(made, [WATER], DOWN, free_surface=True), time_step=0.01, probes=probes)
    simulation.step()
    force = {
        name: [simulation.probes[name][f"pressure_force_{k}"][-1] for k in "xyz"] for name in ("whole", "top", "right")
    }
    assert force["top"] == pytest.approx([0, 0, -1000 * 9.81 * 0.2 * 0.2 * 0.4], abs=1e-6)
    assert force["right"] == pytest.approx([-1000 * 9.81 * 0.4 * 0.2 * 0.3, 0, 0], abs=1e-6)
    assert force["whole"] == pytest.approx(force["top"], abs=1e-6)
    assert simulation.probes["at"]["pressure"][-1] == pytest.approx(1000 * 9.81 * 0.3, rel=1e-9)
    assert simulation.probes["any"]["pressure"][-1] == pytest.approx(1000 * 9.81 * 0.2, rel=1e-9)


def test_forces_on_sides_that_go_on_in_each_other_are_refused():
    made = tank({"a": ((0.2, 0, 0), (0.4, 0.4, 0.2)), "b": ((0.4, 0, 0), (0.6, 0.4, 0.2))})
    case = tp.Case(made.fill(WATER, box=((0, 0, 0), (1, 0.8, 0.4))), [WATER], DOWN, free_surface=True)
    for wall in ("a", "b", "b right"):
        with pytest.raises(ValueError, match="go on in those of another block"):
            tp.Simulation(case, probes=[tp.WallForce(name="force", wall=wall)])


@pytest.mark.slow
def test_a_dam_breaks_over_blocks():
    made = tank({"step": ((0.6, 0, 0), (0.8, 0.8, 0.15)), "pier": ((0.6, 0.2, 0), (0.8, 0.4, 0.45))})
    made.fill(WATER, box=((0, 0, 0), (0.4, 0.8, 0.45)))
    simulation = tp.Simulation(tp.Case(made, [WATER], DOWN, free_surface=True))
    volume = simulation.volume("water")
    while simulation.time < 0.6:
        simulation.step()
    assert simulation.volume("water") == pytest.approx(volume, rel=1e-12)
    domain, x = simulation.case.blocks, simulation.particles.position
    assert not domain.solid(x[~simulation.particles.wall]).any()
    # All faces of walls are on planes, and no cell reaches into a block.
    mesh, planes = simulation.mesh, simulation.state.boundary.planes
    assert planes[simulation.particles.wall].any(axis=1).all()
    assert not domain.solid(mesh.centres()).any()
    assert (x[mesh.used, 0] > 0.9).any(), "no water came over the step"


@pytest.mark.slow
def test_a_run_with_blocks_goes_on_with_the_same_bits(tmp_path):
    made = tank({"step": STEP}).fill(WATER, box=((0.4, 0, 0), (1, 0.8, 0.45)))
    require_same_when_resumed(tp.Case(made, [WATER], DOWN, free_surface=True), tmp_path)


@pytest.mark.slow
def test_a_tank_with_blocks_turns_with_them():
    """Water at rest in a tank that has been turned by 0.2 is level, and none of it is in a block."""
    made = tank({"step": STEP, "pier": PIER}).fill(WATER, box=((0, 0, 0), (1, 0.8, 0.3)))
    motion = tp.Motion(angle=lambda t: 0.1 * (1 - np.cos(4 * t)), axis=(0, 1, 0), pivot=(0.5, 0.4, 0.0))
    simulation = tp.Simulation(tp.Case(made, [WATER], DOWN, free_surface=True, tank_motion=motion))
    volume = simulation.volume("water")
    while simulation.time < 0.5:
        simulation.step()
    row = simulation.history[-1]
    assert [row[f"tank_turn_{k}"] for k in "xyz"] == pytest.approx([0, motion.angle(simulation.time), 0])
    pose = simulation.case.boundary.pose(simulation.time, 1e-6)
    y = pose.origin(simulation.particles.position)
    assert not simulation.case.blocks.solid(y[~simulation.particles.wall]).any()
    assert simulation.volume("water") == pytest.approx(volume, rel=1e-12)


@pytest.mark.parametrize(
    ("name", "box", "text"),
    [
        ("left", STEP, "name of its own"),
        ("a", ((0, 0, 0), (0, 1, 1)), "lower < upper"),
        ("a", ((2, 0, 0), (3, 1, 1)), "outside the tank"),
        ("a", ((0.4, 0, 0), (0.6, 0.8, 0.6)), "one part"),
        ("pier", PIER, "name of its own"),
    ],
)
def test_blocks_that_are_refused(name, box, text):
    made = tank({"pier": ((0.6, 0.2, 0), (0.8, 0.4, 0.6))})
    with pytest.raises(ValueError, match=text):
        made.block(name, box)


def test_what_blocks_do_not_go_with_is_refused():
    with pytest.raises(ValueError, match=r"tipfem\.shapes"):
        tp.tank((1, 1), 0.1).block("a", STEP)
    made = tank({"pier": PIER}).fill(AIR).fill(WATER, box=((0, 0, 0), (1, 0.8, 0.3)))
    with pytest.raises(ValueError, match="needs 'sharp'"):
        tp.Case(made, [WATER, AIR], DOWN, interface="interpolated")
    made = tank({"step": STEP}).fill(WATER, box=((0, 0, 0), (1, 0.8, 0.3)))
    made.wall("right", motion=lambda t: 0.01 * t**2)
    with pytest.raises(ValueError, match="no wall of a tank with blocks can move"):
        tp.Case(made, [WATER], DOWN, free_surface=True)
    close = tank({"step": ((0, 0, 0), (0.95, 0.8, 0.15))}).fill(WATER, box=((0, 0, 0), (1, 0.8, 0.3)))
    with pytest.raises(ValueError, match=r"thinner than 1\.2 spacings"):
        tp.Case(close, [WATER], DOWN, free_surface=True)


def test_places_in_a_block_are_refused_by_probes():
    """As those outside the tank are; places on its sides have fluid beside them."""
    made = tank({"step": STEP, "pier": PIER}).fill(WATER, box=((0, 0, 0), (1, 0.8, 0.3)))
    case = tp.Case(made, [WATER], DOWN, free_surface=True)
    for place, block in (((0.6, 0.4, 0.3), "pier"), ((0.05, 0.4, 0.1), "step")):
        for probe in (
            tp.PointProbe(name="here", at=place),
            tp.LineProbe(name="here", start=(0.9, 0.1, 0.1), end=place, count=3),
        ):
            with pytest.raises(ValueError, match=f"lies in the block '{block}'"):
                tp.Simulation(case, probes=[probe])
    tp.Simulation(case, probes=[tp.PointProbe(name="on", at=(0.5, 0.4, 0.2))])


def test_walls_given_as_arrays_are_those_of_a_convex_tank():
    made = tank({"pier": PIER}).fill(WATER, box=((0, 0, 0), (1, 0.8, 0.3)))
    particles = tp.Case(made, [WATER], DOWN, free_surface=True).particles
    with pytest.raises(ValueError, match=r"outer walls of a convex tank; see Tank\.block"):
        tp.Case(particles, [WATER], DOWN, free_surface=True)


def test_two_contact_angles_are_refused_on_a_block():
    made = tank({"pier": PIER}).fill(WATER, box=((0, 0, 0), (1, 0.8, 0.3)))
    made.wall("pier left", contact_angle={"water": (50, 110)})
    with pytest.raises(ValueError, match="wall 'pier left': contact_angle has two angles"):
        tp.Case(made, [WATER], DOWN, free_surface=True, surface_tension={"water": 0.07})


@pytest.mark.slow
def test_a_drop_falls_onto_the_edge_of_a_block():
    """It keeps its volume, and none of it is in a block."""
    made = tp.tank((1.4, 1.4, 1.4), 0.1, jitter=0.15)
    made.block("step", ((0, 0, 0), (0.4, 1.4, 0.2))).block("pier", ((1.0, 0.6, 0), (1.2, 0.8, 1.4)))
    made.fill(WATER, box=((0, 0, 0), (1.4, 1.4, 0.35)))
    simulation = tp.Simulation(tp.Case(made, [WATER], DOWN, free_surface=True), time_step=5e-3)
    before = simulation.volume("water")
    simulation.steer(tp.Drop((0.4, 0.7, 0.8), 0.21, "water"))
    volume = simulation.volume("water")
    assert volume - before == pytest.approx(4 / 3 * np.pi * 0.21**3, rel=0.12)
    while simulation.time < 0.4:
        simulation.step()
    assert simulation.volume("water") == pytest.approx(volume, rel=1e-12)
    assert not simulation.case.blocks.solid(simulation.particles.position[~simulation.particles.wall]).any()
    for place, text in (((1.1, 0.7, 0.8), "outside the walls"), ((0.75, 0.7, 0.9), "too close to a wall")):
        with pytest.raises(ValueError, match=text):
            simulation.steer(tp.Drop(place, 0.21, "water"))


def test_a_block_that_covers_a_side_of_another_takes_its_law():
    made = tank({"a": ((0.2, 0.2, 0), (0.4, 0.4, 0.15)), "b": ((0.4, 0, 0), (0.6, 0.6, 0.45))}, law="no-slip")
    assert "a right" not in made.sides
    assert "b left" in made.sides
    made.fill(WATER, box=((0, 0, 0), (1, 0.8, 0.3)))
    tp.Case(made, [WATER], DOWN, free_surface=True)
