"""Periodic tanks: the period of positions, the particles of a tank, and what is refused."""

import numpy as np
import pytest

import tipfem as tp
from tipfem.case.forces import PokeForce
from tipfem.geometry.period import Period, no_period

WATER = tp.Fluid("water", density=1000.0, viscosity=1e-3)
AIR = tp.Fluid("air", density=1.2, viscosity=1.8e-5)


def test_differences_are_to_the_nearest_image():
    period = Period(np.array([2.0, 0.0]))
    given = np.array([[0.4, 5.0], [1.4, -5.0], [-1.4, 0.0], [3.9, 1.0]])
    np.testing.assert_allclose(period.shortest(given), [[0.4, 5.0], [-0.6, -5.0], [0.6, 0.0], [-0.1, 1.0]])
    np.testing.assert_allclose(period.shortest(given[:, 0], 0), [0.4, -0.6, 0.6, -0.1])
    assert period.shortest(given[:, 1], 1) is not None
    assert no_period(2).shortest(given) is given


def test_positions_are_wrapped_into_the_domain():
    period = Period(np.array([2.0, 0.0]))
    given = np.array([[-1e-300, 1.0], [2.0, -3.0], [5.5, 0.0], [1.0, 9.0]])
    wrapped = period.wrapped(given)
    np.testing.assert_allclose(wrapped, [[0.0, 1.0], [0.0, -3.0], [1.5, 0.0], [1.0, 9.0]])
    assert ((wrapped[:, 0] >= 0) & (wrapped[:, 0] < 2.0)).all()
    assert period.wrapped(wrapped) is wrapped


def test_a_periodic_tank_has_no_walls_on_its_sides():
    tank = tp.tank((1.0, 0.5), 0.05, periodic="x").fill(AIR).fill(WATER, box=((0, 0), (1, 0.25)))
    particles = tank.sample([WATER, AIR], fitted=True)
    assert len(particles) == 20 * 11
    assert (particles.wall == np.isin(particles.position[:, 1], [0.0, 0.5])).all()
    assert particles.position[:, 0].max() < 1.0
    with pytest.raises(ValueError, match="'left' is no wall of this tank; it has bottom, top"):
        tank.wall("left", slip=True)


def test_a_face_between_the_two_ends_belongs_to_the_heavier_fluid():
    tank = tp.tank((1.0, 0.5), 0.05, periodic="x").fill(AIR).fill(WATER, box=((0.5, 0), (1, 0.5)))
    particles = tank.sample([WATER, AIR], fitted=True)
    assert (particles.fluid[particles.position[:, 0] == 0.0] == 0).all()
    case = tp.Case(tank, [WATER, AIR], (0, -9.81))
    volume = tp.Simulation(case).state.volume
    np.testing.assert_allclose(volume, [0.25, 0.25], rtol=1e-12)


@pytest.mark.parametrize(
    ("size", "spacing", "periodic", "message"),
    [
        ((1.0, 1.0), 0.1, "y", "periodic is 'y'; it must be one of 'x', 'xy'"),
        ((1.0, 0.7), 0.1, "xy", "0.7 m high; with a spacing of 0.1 m it must be 0.8 m or more"),
        ((1.0, 1.0, 1.0), 0.1, "x", "only tanks in 2-D are periodic"),
        ((0.7, 1.0), 0.1, "x", "it must be 0.8 m or more, 8 spacings"),
    ],
)
def test_what_cannot_be_a_periodic_tank_is_refused(size, spacing, periodic, message):
    with pytest.raises(ValueError, match=message):
        tp.tank(size, spacing, jitter=0.1, periodic=periodic)


def test_a_shape_has_walls_all_around():
    with pytest.raises(ValueError, match="a tank with a shape has walls all around"):
        tp.tank(shape=[(0, 0), (1, 0), (0, 1)], spacing=0.1, periodic="x")


@pytest.mark.parametrize(
    ("options", "walls", "message"),
    [
        ({"free_surface": True}, {}, "free_surface is True"),
        ({"grading": tp.Grading({"water": 0.2})}, {}, "a grading is given"),
        ({"tank_motion": tp.Motion(translation=lambda t: (0.0, 0.0))}, {}, "tank_motion is given"),
        ({}, {"motion": lambda t: 0.0}, "a wall has a motion"),
        ({"period": (1.0, 0.0)}, {}, r"beside a tank; say tank\(..., periodic='x'\)"),
    ],
)
def test_what_cannot_be_combined_is_refused_before_the_run(options, walls, message):
    tank = tp.tank((1.0, 1.0), 0.1, periodic="x").fill(WATER)
    if walls:
        tank.wall("bottom", **walls)
    with pytest.raises(ValueError, match=message):
        tp.Case(tank, [WATER], (0, 0), **options)


def test_bodies_are_refused():
    tank = tp.tank((1.0, 1.0), 0.05, periodic="x").fill(WATER)
    tank.add(tp.Body(tp.shapes.rectangle((0.4, 0.4), (0.6, 0.6))))
    with pytest.raises(ValueError, match="there are bodies"):
        tp.Case(tank, [WATER], (0, 0))


def test_particles_given_as_arrays_may_be_periodic():
    tank = tp.tank((1.0, 0.5), 0.1, periodic="x").fill(WATER)
    particles = tank.sample([WATER])
    case = tp.Case(particles, [WATER], (0, 0), interface="interpolated", period=(1.0, 0.0))
    assert case.period == Period(np.array([1.0, 0.0]))
    for wrong in ((0.0, 1.0), (1.0,), (1.0, -1.0), (np.inf, 0.0), (1.0, np.inf)):
        with pytest.raises(ValueError, match=r"it must be \(width, 0\)"):
            tp.Case(particles, [WATER], (0, 0), period=wrong)
    with pytest.raises(ValueError, match="is outside the period"):
        tp.Case(particles, [WATER], (0, 0), period=(0.85, 0.0))
    with pytest.raises(
        ValueError, match="is a wall particle; a domain that is periodic in all directions has no walls"
    ):
        tp.Case(particles, [WATER], (0, 0), period=(1.0, 0.6))


def test_a_tank_that_is_periodic_in_both_directions_has_no_walls():
    tank = tp.tank((1.0, 0.5), 0.05, periodic="xy").fill(AIR).fill(WATER, box=((0, 0), (1, 0.25)))
    assert tank.sides == ()
    with pytest.raises(ValueError, match="'top' is no wall of this tank; it has none"):
        tank.wall("top", slip=True)
    particles = tank.sample([WATER, AIR], fitted=True)
    assert len(particles) == 20 * 10
    assert not particles.wall.any()
    assert (particles.position.max(axis=0) < [1.0, 0.5]).all()
    assert (particles.fluid[particles.position[:, 1] == 0.0] == 0).all()  # the face between the two ends
    case = tp.Case(tank, [WATER, AIR], (0, 0))
    assert case.pressure_reference() == -1
    np.testing.assert_array_equal(case.box, [[0.0, 0.0], [1.0, 0.5]])
    np.testing.assert_allclose(tp.Simulation(case).state.volume, [0.25, 0.25], rtol=1e-12)


def test_gravity_without_walls_is_refused():
    tank = tp.tank((1.0, 1.0), 0.1, periodic="xy").fill(WATER)
    with pytest.raises(ValueError, match=r"gravity is .* periodic in all directions; no wall holds the fluids"):
        tp.Case(tank, [WATER], (0, -9.81))
    case = tp.Case(tp.tank((1.0, 1.0), 0.1, periodic="xy").fill(WATER), [WATER], (0, 0))
    simulation = tp.Simulation(case)
    with pytest.raises(ValueError, match="gravity: the domain is periodic in all directions"):
        simulation.steer(tp.Gravity((0.0, -1.0)))
    simulation.steer(tp.Gravity((0.0, 0.0)))


def test_a_poke_acts_through_the_ends():
    force = PokeForce((0.02, 0.98), (1.0, 0.0), 0.1, 1.0)
    period = Period(np.array([1.0, 1.0]))
    x = np.array([[0.02, 0.98], [0.98, 0.02], [0.5, 0.5]])
    assert (force.field(x, period)[:, 0] > [0.9, 0.1, -1.0]).all()
    assert force.field(x, no_period(2))[1, 0] == 0.0
