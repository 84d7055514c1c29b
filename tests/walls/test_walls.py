"""Walls as they are described: what is refused, which particles they find, and how rows of them are spaced."""

from __future__ import annotations

import re

import numpy as np
import pytest

import tipfem as tp
from tipfem.case.walls import rates
from tipfem.mesh.mesh import no_surface
from tipfem.physics.walls.spacing import crowded_moves, space_back, space_sliding


@pytest.fixture
def case(water):
    """Maker of cases of a tank of 1 m x 0.6 m with walls and options."""

    def make(walls=(), tank=None, **options):
        tank = tank or tp.tank((1, 0.6), 0.1)
        return tp.Case(tank.fill(water), [water], (0, -9.81), walls=walls, **options)

    return make


def floor(**what):
    return tp.Wall("floor", between=((0, 0), (1, 0)), **what)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda t: t.wall("ceiling", slip=True), "'ceiling' is no wall of this tank; it has left, right, bottom, top"),
        (lambda t: t.wall("front", slip=True), "'front' is no wall of this tank; it has left, right, bottom, top"),
        (lambda t: t.wall("top"), "wall 'top': [] given; it takes one or more of"),
        (lambda t: t.wall("top", speed=1), "wall 'top': ['speed'] given; it takes one or more of"),
        (lambda t: t.wall("top", slip=True).wall("top", slip=True), "wall 'top' is described twice"),
        (lambda t: t.wall("top", slip=0.1), "slip is 0.1; it must be True or False (a length is slip_length)"),
        (lambda t: t.wall("top", slip_length=0), "slip_length is 0 m; it must be a number > 0"),
        (lambda t: t.wall("top", slip_length=float("inf")), "slip_length is inf m; it must be a number > 0"),
        (lambda t: t.wall("top", slip=True, slip_length=1.0), "give one of the two"),
        (lambda t: t.wall("top", slip=True, velocity=(1, 0)), "velocity has no effect on a fluid that slips freely"),
        (lambda t: t.wall("left", motion=0.1), "motion is 0.1; it must be a function of time"),
        (lambda t: tp.Wall("w", slip=True), "wall 'w': give either its ends, between, or its particles"),
        (lambda t: tp.Wall("", between=((0, 0), (1, 0))), "name is ''; it must be a non-empty string"),
        (lambda t: tp.Wall("w", between=((0, 0), (0, 0))), "between is ((0, 0), (0, 0)); it must be two"),
        (lambda t: tp.Motion(), "neither translation nor angle"),
        (lambda t: tp.Motion(angle=1.0), "angle is 1.0 rad; it must be a function of time to a value in rad"),
        (lambda t: tp.Motion(angle=lambda t: t, pivot="a"), "pivot is 'a'; it must be a list of 2 or 3 numbers in m"),
        (lambda t: tp.Motion(angle=lambda t: t, axis=(0, 0, 0)), "axis is (0, 0, 0); it must be a direction"),
    ],
)
def test_what_cannot_be_is_refused_where_it_is_said(make, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        make(tp.tank((1, 0.6), 0.1))


@pytest.mark.parametrize(
    ("walls", "options", "message"),
    [
        ([floor(slip=True)] * 2, {}, "walls are named ['floor', 'floor']; every wall needs a name of its own"),
        ([tp.Wall("a", between=((0, 0), (0.5, 0)), slip=True), floor(slip=True)], {}, "['a', 'floor'] overlap"),
        ("floor", {}, "walls is 'floor'; it must be a list of Wall"),
        ([tp.Wall("a", between=((0, 0.1), (1, 0.1)), slip=True)], {}, "wall 'a': only 2 wall particles belong to it"),
        ([tp.Wall("a", particles=[0, 1, 8], slip=True)], {}, "particle 8 at [0.1, 0.0"),
        ([tp.Wall("a", particles=[0, 1, 999], slip=True)], {}, "particles must be indices from 0 to 76"),
        ([tp.Wall("a", particles=[0, 1, 2, 14], slip=True)], {}, "is not on one straight side"),
        ([floor(velocity=(0.0, 1.0))], {}, "velocity [0.0, 1.0] m/s is not along the wall; use motion to move a wall"),
        ([floor(velocity=(1.0,))], {}, "velocity at t = 0 s is (1.0,); it must be 2 finite speeds in m/s"),
        ([floor(motion=lambda t: 0.1 + t)], {}, "motion at t = 0 is 0.1 m; it must be zero"),
        ([floor(motion=lambda t: None)], {}, "motion at t = 0 s gave None; it must be a length in m"),
        ([tp.Wall("a", between=((0, 0), (0.5, 0)), motion=np.sin)], {}, "must be the whole side"),
        ([floor(motion=np.sin)], {}, "change the volume of the closed tank by -0.17 %"),
        ([], {"tank_motion": 1.0}, "tank_motion is 1.0; it must be a Motion"),
        ([], {"tank_motion": tp.Motion(angle=np.cos)}, "angle at t = 0 is 1.0; it must be zero"),
        ([], {"tank_motion": tp.Motion(translation=np.sin)}, "it must be 2 finite lengths in m"),
        ([], {"tank_motion": tp.Motion(angle=np.sin, pivot=(0, 0, 0))}, "must be a point of 2 coordinates"),
    ],
)
def test_what_does_not_fit_the_tank_is_refused_by_the_case(case, walls, options, message):
    """A piston alone too: the tank is closed and the fluids are incompressible."""
    with pytest.raises(ValueError, match=re.escape(message)):
        case(walls, **options)


def test_a_motion_that_compresses_later_stops_the_run(water):
    """A run looks at all of its time before it begins; by itself, the step that would do it says so."""
    late = tp.tank((1, 0.6), 0.1).fill(water).wall("left", motion=lambda t: max(t - 2.0, 0.0) ** 3)
    simulation = tp.Simulation(tp.Case(late, [water], (0, 0)), time_step=0.3)
    with pytest.raises(ValueError, match=r"at t = 2\.01 s .* change the volume of the closed tank"):
        simulation.run(3.0, progress=False)
    assert simulation.time == 0
    for _ in range(6):
        simulation.step()
    with pytest.raises(tp.SimulationError, match=r"at t = 2\.1 s .* change the volume of the closed tank"):
        simulation.step()
    assert simulation.time == pytest.approx(1.8)


def test_velocities_of_walls_are_given_by_the_walls_alone(water):
    """At the start a wall particle may move only where its wall leaves it free to."""
    particles = tp.tank((1, 0.6), 0.1).fill(water).sample([water])
    bottom = particles.position[:, 1] == 0
    particles.velocity[bottom & (particles.position[:, 0] == 0.5)] = (1.0, 0.0)
    tp.Case(particles, [water], (0, 0), walls=[floor(slip=True)])
    with pytest.raises(ValueError, match=r"at \[0.5, 0.0\] has velocity \[1.0, 0.0\] m/s; it must be zero in the dir"):
        tp.Case(particles, [water], (0, 0), walls=[floor(velocity=(1.0, 0.0))])


def test_by_name_by_ends_and_by_particles_find_the_same_wall(case, water):
    tank = tp.tank((1, 0.6), 0.1)
    for side in ("left", "right", "top"):
        tank.wall(side, law="no-slip")
    named = case(tank=tank.wall("bottom", slip=True)).boundary
    ends = case([floor(slip=True)]).boundary
    particles = tp.tank((1, 0.6), 0.1).fill(water).sample([water])
    mask = particles.wall & (particles.position[:, 1] == 0)
    others = [case([tp.Wall("floor", particles=which, slip=True)]).boundary for which in (mask, np.flatnonzero(mask))]
    assert named.slides.size == 9  # all but the corners
    for other in (ends, *others):
        np.testing.assert_array_equal(other.free, named.free)


def test_corners_and_the_ends_of_a_part_are_fixed(case):
    """A floor that slips on its left half only, and a tank that slips all around."""
    b = case([tp.Wall("half", between=((0, 0), (0.5, 0)), slip=True)]).boundary
    y = b._y[b.slides]
    np.testing.assert_allclose(np.sort(y[:, 0]), [0.1, 0.2, 0.3, 0.4])
    assert not y[:, 1].any()
    tank = tp.tank((1, 0.6), 0.1)
    for side in ("left", "right", "bottom", "top"):
        tank.wall(side, slip=True)
    b = case(tank=tank).boundary
    assert len(b.slides) == len(b.index) - 4
    assert len(b.pieces) == 4


def test_sides_of_a_tilted_polygon_are_found(water):
    """A pentagon in any position: five sides, normals into the fluid; walls that slip stay exactly straight."""
    angle = 0.3 + 2 * np.pi * np.arange(5) / 5
    corner = np.stack([np.cos(angle), np.sin(angle)], axis=1) + 3.0
    part = np.arange(0, 1, 1 / 12)[:, None]
    rim = np.concatenate([a + part * (b - a) for a, b in zip(corner, np.roll(corner, -1, axis=0), strict=True)])
    inner = np.random.default_rng(0).uniform(-1, 1, (600, 2))
    inner = inner[np.linalg.norm(inner, axis=1) < 0.72][:250] + 3.0
    wall = np.arange(len(rim) + len(inner)) < len(rim)
    particles = tp.Particles(np.concatenate([rim, inner]), 0 * wall, wall, spacing=0.1)
    walls = [tp.Wall(f"side {k}", between=(corner[k], corner[(k + 1) % 5]), slip=True) for k in range(5)]
    case = tp.Case(particles, [water], (0, -9.81), walls=walls)
    b = case.boundary
    assert len(b.offset) == 5
    assert len(b.slides) == 55
    assert (b.side_normal @ np.full(2, 3.0) > b.offset).all()
    simulation = tp.Simulation(case, time_step=2e-3)
    for _ in range(5):
        simulation.step()
    b = simulation.boundary
    off = np.abs(simulation.particles.position[b.index] @ b.side_normal.T - b.offset)
    assert off[b.on_side].max() < 1e-14


def test_edges_of_a_tank_in_3d_slide_along_themselves(water):
    tank = tp.tank((1, 1, 1), 0.25, jitter=0.1).fill(water)
    for side in ("left", "right", "bottom", "top", "back"):
        tank.wall(side, slip=True)
    b = tp.Case(tank, [water], (0, -9.81, 0), interface="interpolated").boundary
    rank = np.round(np.trace(b.free, axis1=1, axis2=2)).astype(int)
    faces, edges = 5 * 9, 8 * 3  # each of the 4 edges of the front wall is held by it
    assert [(rank == k).sum() for k in (2, 1)] == [faces, edges]


@pytest.mark.parametrize("time", [0.0, 1e-4, 3.0])
def test_rates_are_of_fourth_order_and_never_ask_for_negative_times(time):
    asked = []

    def function(t):
        asked.append(t)
        return np.array([np.sin(2 * t), np.exp(t)])

    value, one, two = rates(function, time, 1e-2)
    np.testing.assert_allclose(value, [np.sin(2 * time), np.exp(time)])
    np.testing.assert_allclose(one, [2 * np.cos(2 * time), np.exp(time)], rtol=1e-6)
    np.testing.assert_allclose(two, [-4 * np.sin(2 * time), np.exp(time)], rtol=1e-4, atol=1e-5)
    assert min(asked) >= 0


def row_of(x):
    """Particles on the x axis with velocity (2 x, 0)."""
    x = np.asarray(x, dtype=float)
    position = np.stack([x, 0 * x], axis=1)
    return tp.Particles(position, 0 * x, 0 * x, velocity=2 * position, pressure=x, spacing=1.0), np.arange(len(x))


def test_a_crowded_particle_goes_to_the_middle_of_the_widest_gap():
    particles, piece = row_of([0, 1, 2, 3.6, 4.4, 5.2, 5.5, 6])
    assert crowded_moves(particles.position, piece) == [(6, 2, 3)]
    assert space_sliding(particles, piece, no_surface(len(particles))) == 1
    np.testing.assert_allclose(particles.position[6], [2.8, 0])
    np.testing.assert_allclose(particles.velocity[6], [5.6, 0])
    assert particles.pressure[6] == pytest.approx(2.8)


def test_a_wide_gap_takes_the_particle_spared_most_easily():
    particles, piece = row_of([0, 2, 2.7, 3.4, 4.2, 5, 6])
    assert crowded_moves(particles.position, piece) == [(2, 0, 1)]


@pytest.mark.parametrize("seed", range(5))
def test_spacing_ends_and_keeps_number_and_ends(seed):
    x = np.sort(np.random.default_rng(seed).uniform(0, 30, 31))
    x[[0, -1]] = 0, 30
    particles, piece = row_of(x)
    space_sliding(particles, piece, no_surface(len(particles)))
    after = np.sort(particles.position[:, 0])
    assert after[[0, -1]].tolist() == [0, 30]
    gaps = np.diff(after)
    assert gaps.min() > 0.3
    assert gaps.max() < 2.2
    np.testing.assert_allclose(particles.velocity[:, 0], 2 * particles.position[:, 0])  # linear is kept


def test_a_row_is_set_back_with_its_pressure():
    particles, piece = row_of([0, 1.3, 2.3, 3.3, 4])
    space_back(particles, piece, np.array([0, 0.25, 0.5, 0.75, 1]))
    np.testing.assert_allclose(particles.position[:, 0], [0, 1, 2, 3, 4])
    np.testing.assert_allclose(particles.pressure, [0, 1, 2, 3, 4])
