"""Bodies as users describe them: their mass and inertia, their motion, and errors that name what is wrong."""

from __future__ import annotations

import math

import numpy as np
import pytest

import tipfem as tp
from tipfem.case.body import Body, polygon_moments
from tipfem.case.walls import Motion

BOX = ((0.0, 0.0), (0.3, 0.0), (0.3, 0.1), (0.0, 0.1))


def test_moments_of_a_rectangle_and_a_circle() -> None:
    area, centre, second = polygon_moments(np.array(BOX) + 100.0)
    assert area == pytest.approx(0.03, rel=1e-12)
    np.testing.assert_allclose(centre, [100.15, 100.05], rtol=1e-14)
    assert second == pytest.approx(0.03 * (0.3**2 + 0.1**2) / 12, rel=1e-9)
    angle = np.linspace(0, 2 * math.pi, 1001)[:-1]
    area, _, second = polygon_moments(0.5 * np.stack([np.cos(angle), np.sin(angle)], axis=1))
    assert area == pytest.approx(math.pi / 4, rel=1e-4)
    assert second == pytest.approx(math.pi / 32, rel=1e-4)


def test_corners_are_anticlockwise_and_open() -> None:
    np.testing.assert_array_equal(Body((*BOX[::-1], BOX[-1])).corners.mean(axis=0), Body(BOX).corners.mean(axis=0))
    assert polygon_moments(Body(BOX[::-1]).corners)[0] > 0


def test_mass_and_inertia_follow_from_the_shape() -> None:
    body = Body(BOX, density=500.0)
    assert body.total_mass == pytest.approx(15.0)
    assert body.inertia_about_reference == pytest.approx(15.0 * 0.1 / 12)
    hinged = Body(BOX, density=500.0, hinge=(0.0, 0.0))
    assert hinged.inertia_about_reference == pytest.approx(15.0 * (0.1 / 12 + 0.15**2 + 0.05**2))
    assert hinged.freedoms == ("angle",)
    off = Body(BOX, mass=15.0, centre=(0.1, 0.05))
    assert off.inertia_about_reference == pytest.approx(15.0 * (0.1 / 12 + 0.05**2))
    np.testing.assert_allclose(off.reference, [0.1, 0.05])


def test_a_prescribed_motion_has_its_derivatives() -> None:
    motion = Motion(translation=lambda t: (0.1 * math.sin(t), 0.0), angle=lambda t: t**2)
    position, velocity, acceleration = Body(BOX, motion=motion).prescribed(1.0, 1e-3)
    np.testing.assert_allclose(position, [0.15 + 0.1 * math.sin(1), 0.05, 1.0], rtol=1e-12)
    np.testing.assert_allclose(velocity, [0.1 * math.cos(1), 0.0, 2.0], atol=1e-9)
    np.testing.assert_allclose(acceleration, [-0.1 * math.sin(1), 0.0, 2.0], atol=1e-7)


def test_a_body_that_has_not_begun_to_move_has_no_rates() -> None:
    """Differences of places would have those of round-off, 1e-9 m/s^2."""
    motion = Motion(translation=lambda t: (0.0, max(t - 1.0, 0.0) ** 3), angle=lambda t: 0.0)
    for time in (0.0, 0.5):
        position, velocity, acceleration = Body(BOX + np.array([0.625, 0.3]), motion=motion).prescribed(time, 1e-3)
        np.testing.assert_allclose(position, [0.775, 0.35, 0.0], rtol=1e-12)
        assert not velocity.any()
        assert not acceleration.any()


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"shape": ((0, 0), (1, 0))}, "it needs 3 or more"),
        ({"shape": ((0, 0), (1, 0), (2, 0))}, "has no area"),
        ({"density": -1.0}, "density is -1.0 kg/m\\^3; it must be a number > 0"),
        ({"density": 1.0, "mass": 1.0}, "give one of the two"),
        ({"density": 1.0, "motion": Motion(angle=lambda t: t)}, "give one$"),
        ({"density": 1.0, "free": ("z",)}, "it must be some of"),
        ({"density": 1.0, "free": ("x",), "hinge": (0, 0)}, "free in angle only"),
        ({"density": 1.0, "free": ("x",), "velocity": (0, 1)}, "in which the body is not free"),
        ({"stiffness": (1, 0, 0)}, "only a body that floats"),
        ({"density": 1.0, "damping": (-1, 0, 0)}, "a list of 3 numbers >= 0"),
        ({"contact": "bounce"}, "it must be one of"),
        ({"name": ""}, "non-empty string"),
    ],
)
def test_errors_name_what_is_wrong(given: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Body(**{"shape": BOX, **given})  # type: ignore[arg-type]


def test_a_body_has_no_name_of_a_column_of_the_walls():
    with pytest.raises(ValueError, match=r"name is 'wall', under which .* has the forces on the walls"):
        Body([(0, 0), (1, 0), (1, 1)], name="wall")


@pytest.mark.parametrize("radii", [(0.3, 1.0), (1.0, 0.3)])
def test_a_body_inside_another_is_refused(radii, water):
    tank = tp.tank((4, 4), 0.1).fill(water)
    for name, radius in zip("ab", radii, strict=True):
        tank.add(Body(tp.shapes.circle((2, 2), radius), name=name))
    with pytest.raises(ValueError, match="body 'b': it is on, or on the wrong side of, body 'a'"):
        tp.Case(tank, [water], (0, -9.81))
