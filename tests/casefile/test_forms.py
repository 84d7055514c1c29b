"""Named forms: functions of time and shapes against what they are said to be."""

import numpy as np
import pytest

from tipfem.casefile.forms import (
    Constant,
    HalfSpace,
    Limits,
    Polygon,
    Polyline,
    Ramp,
    Side,
    Sine,
    SineCurve,
    Table,
    Uniform,
    smooth_step,
)


def test_a_sine_is_one():
    sine = Sine(form="sine", amplitude=(2.0, 0.0), frequency=0.5, phase=0.3, mean=(1.0, 4.0))
    for time in (0.0, 0.7, 3.0):
        assert sine(time) == pytest.approx([1 + 2 * np.sin(np.pi * time + 0.3), 4.0])
    assert isinstance(Sine(form="sine", amplitude=1.0, frequency=1.0)(0.25), float)


def test_a_soft_start_is_zero_with_its_velocity_at_the_start_and_over_at_its_end():
    circle = Sine(form="sine", amplitude=(2.0, 3.0), frequency=0.5, phase=(0.0, 0.5 * np.pi))
    np.testing.assert_allclose(circle(0.7), [2 * np.sin(0.7 * np.pi), 3 * np.cos(0.7 * np.pi)])
    soft = Sine(form="sine", amplitude=1.0, frequency=1.0, phase=1.0, soft_start=2.0)
    bare = soft.model_copy(update={"soft_start": 0.0})
    assert soft(0.0) == 0.0
    assert abs(soft(1e-4)) < 1e-10
    assert soft(2.0) == bare(2.0)
    assert soft(3.3) == bare(3.3)


def test_a_ramp_goes_from_one_value_to_the_other_smoothly():
    ramp = Ramp(form="ramp", start_value=1.0, end_value=3.0, start_time=1.0, end_time=2.0)
    assert (ramp(0.5), ramp(1.5), ramp(9.0)) == (1.0, 2.0, 3.0)
    t = np.linspace(-0.5, 1.5, 2001)
    curve = np.array([smooth_step(part) for part in t])
    second = np.diff(curve, 2) / (t[1] - t[0]) ** 2
    assert np.abs(np.diff(second)).max() < 0.1  # no jump
    assert (np.diff(curve) >= 0).all()


def test_tables_go_through_their_values():
    times, values = [0.0, 0.5, 1.0, 2.0], [0.0, 1.0, 0.5, 0.25]
    for kind in ("cubic", "linear"):
        table = Table(form="table", times=times, values=values, interpolation=kind)
        assert [table(time) for time in times] == pytest.approx(values)
    assert table(0.75) == pytest.approx(0.75)
    smooth = Table(form="table", times=list(np.linspace(0, 1, 21)), values=list(np.sin(np.linspace(0, 1, 21))))
    assert smooth(0.512) == pytest.approx(np.sin(0.512), abs=1e-6)


def test_a_constant_and_a_uniform_force():
    force = Uniform(Constant(form="constant", value=(1.0, 2.0)))
    assert np.array_equal(force(np.zeros((3, 2)), 0.5), [[1, 2]] * 3)


def test_shapes_hold_what_they_say():
    x = np.random.default_rng(1).uniform(-1, 2, (500, 2))
    square = Polygon(points=[[0, 0], [1, 0], [1, 1], [0, 1]])
    assert np.array_equal(square(x), ((x > 0) & (x < 1)).all(axis=1))
    notch = Polygon(points=[[0, 0], [1, 0], [1, 1], [0.5, 0.5], [0, 1]])
    assert np.array_equal(notch(x), square(x) & (x[:, 1] < np.maximum(1 - x[:, 0], x[:, 0])))
    half = HalfSpace(point=[0.5, 0.5], normal=[1, 1])
    assert np.array_equal(half(x), x.sum(axis=1) < 1)
    curve = SineCurve(form="sine", height=0.5, amplitude=0.1, wavelength=2.0, origin=0.25)
    height = 0.5 + 0.1 * np.sin(np.pi * (x[:, 0] - 0.25))
    assert np.array_equal(Side(curve=curve, above=False)(x), x[:, 1] < height)
    line = Polyline(form="polyline", points=[[0, 0], [1, 1]])
    assert np.array_equal(Side(curve=line, above=True)(x), x[:, 1] > np.clip(x[:, 0], 0, 1))


def test_limits_are_the_smallest_of_those_around():
    limits = Limits.model_validate(
        {"limits": [{"box": [[0, 0], [1, 1]], "largest": 0.2}, {"box": [[0, 0], [0.5, 1]], "largest": 0.1}]}
    )
    assert limits(np.array([[0.2, 0.5], [0.8, 0.5], [2.0, 2.0]])).tolist() == [0.1, 0.2, np.inf]
