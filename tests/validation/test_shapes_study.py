"""The study of tanks of any shape: its closed forms, and short runs of it."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest
from tipfem.demos.validation.shapes import obstacle
from tipfem.demos.validation.shapes import run as shapes


@pytest.mark.parametrize("oils", [shapes.OILS[:1], shapes.OILS])
def test_the_exact_flow_between_circles_has_the_walls_speeds_and_one_torque(oils):
    r = np.linspace(shapes.INNER, shapes.OUTER, 20001)
    u, torque = shapes.exact_speed(r, oils)
    assert u[0] == pytest.approx(shapes.SPEED)
    assert u[-1] == pytest.approx(0.0, abs=1e-12)
    # torque = -2 pi r^2 mu r d(u / r) / dr, the same at every radius
    shear = r * np.gradient(u / r, r)
    for part, oil in ((slice(10, 9000), oils[0]), (slice(11000, -10), oils[-1])):
        np.testing.assert_allclose(-2 * math.pi * r[part] ** 2 * oil.viscosity * shear[part], torque, rtol=1e-5)


@pytest.mark.parametrize("bottom", list(shapes.BOTTOMS))
@pytest.mark.parametrize("slip", [False, True])
def test_fluids_at_rest_stay_at_rest(bottom, slip):
    figures = shapes.rest(10, bottom, slip=slip)
    assert figures["speed_at_rest"] < 1e-9
    assert shapes.check("rest", figures) == []


def test_the_checks_can_fail():
    assert shapes.check("x", {"speed": 0.001, "order": 1.9}) == []
    assert shapes.check("x", {"speed": 0.001, "order": 1.2}) == ["x: order is 1.2, less than 1.5"]
    assert "order is nan" in shapes.check("x", {"speed": 0.001, "order": math.nan})[0]
    assert shapes.check("x", {"speed": 0.02, "torque": -0.03, "period": 0.03, "speed_at_rest": 2e-9}).__len__() == 4
    history = [{"time": 0.1, "front": 0.25}, {"time": 0.2, "front": 0.35}]
    assert obstacle.first_time(history, 0.3) == pytest.approx(0.15)
    assert math.isnan(obstacle.first_time(history, 0.5))


def test_the_check_of_the_obstacle_judges_what_the_run_was_long_enough_for():
    good = {**obstacle.REFERENCE, "volume_error": 0.0}
    never = dict.fromkeys(obstacle.REFERENCE, math.nan) | {"volume_error": 0.0}
    check = obstacle.Obstacle()

    def missed(figures, spacing=0.006, end_time=0.5):
        return check.missed(figures, SimpleNamespace(spacing=spacing, end_time=end_time, interface="sharp"))

    assert missed(good) == []
    for name, limit in obstacle.LIMITS.items():
        assert missed({**good, name: (1 - 1.1 * limit) * good[name]})[0].startswith(f"{name} is ")
    assert len(missed({**good, "volume_error": math.nan})) == 1
    assert [line.split()[0] for line in missed(never)] == list(obstacle.REFERENCE)
    assert [line.split()[0] for line in missed(never, end_time=0.15)] == ["block"]
    assert missed(never, end_time=0.1) == []
    assert missed(never, spacing=0.01) == []
