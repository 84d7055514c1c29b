"""demos/validation/dam_break/experiments.py: the reference data, and the comparison of a run with it."""

from __future__ import annotations

import math
import sys

import numpy as np
import pytest
from tipfem.demos.validation.dam_break import experiments

WIDTH, GRAVITY = 0.146, 9.81
PER_T = math.sqrt(WIDTH / (2.0 * GRAVITY))  # seconds in one unit of T
PER_TAU = math.sqrt(WIDTH / GRAVITY)  # seconds in one unit of tau


def measured_front(shift=0.0, scale=1.0, end=3.6, start=0.0):
    """A front that passes through every reading of table 2, `shift` later in T and `scale` times as long.

    Returns time [s] and front [m]. Straight before the first reading, where Z(T + shift = 0) is 1.
    """
    data = experiments.martin_moyce_front()
    axis = np.unique(np.concatenate([[start, end], data.time + shift, np.linspace(start, end, 50)]))
    axis = axis[(axis >= start) & (axis <= end)]
    z = np.interp(axis, np.append(-1.0, data.time + shift), np.append(1.0, data.values))
    return axis * PER_T, scale * z * WIDTH


def measured_height(shift=0.0, scale=1.0):
    """A height that passes through every reading of table 6, `shift` later in T; time [s] and height [m]."""
    data = experiments.martin_moyce_height()
    axis = np.append(0.0, data.time + shift / math.sqrt(2.0))
    return axis * PER_TAU, scale * np.append(1.0, data.values) * 2.0 * WIDTH


@pytest.mark.parametrize(
    ("load", "count", "first", "last"),
    [
        ("martin_moyce_front", 15, (0.41, 1.11), (3.33, 4.11)),
        ("martin_moyce_height", 17, (0.56, 0.94), (7.4, 0.06)),
        ("koshizuka_oka_front", 9, (0.0, 1.0), (3.096, 3.624)),
        ("koshizuka_oka_mps_front", 18, (0.0, 1.002), (2.943, 3.997)),
    ],
)
def test_series_are_read_whole(load, count, first, last):
    series = getattr(experiments, load)()
    assert series.time.shape == series.values.shape == (count,)
    assert (series.time[0], series.values[0]) == first
    assert (series.time[-1], series.values[-1]) == last
    assert (np.diff(series.time) > 0.0).all()
    assert series.label
    assert "Source" in series.source


def test_an_absent_column_is_an_error():
    with pytest.raises(KeyError):
        experiments._load("koshizuka_oka1996_front_exp", "label", "T_tsqrt2g_over_L", "absent")


@pytest.mark.parametrize("shift", [-0.2345, 0.0, 0.15])
def test_a_known_shift_is_recovered(shift):
    result = experiments.compare_front(*measured_front(shift), WIDTH)
    assert result.shift == pytest.approx(shift, abs=1e-4)
    assert result.rms < 1e-4
    assert result.slope == pytest.approx(result.slope_experiment, rel=1e-3)
    assert abs(result.slope_error) < 1e-3
    assert result.points == 13
    assert not result.shift_at_limit
    assert (result.rms_unshifted > 0.02) == (shift != 0.0)


def test_a_run_that_leads_has_a_negative_shift():
    time, front = measured_front()
    result = experiments.compare_front(time - 0.01, front, WIDTH)
    assert result.shift == pytest.approx(-0.01 / PER_T, abs=1e-4)


def test_the_scaling_is_that_of_the_other_column():
    """The same flow in a column four times as wide, and on the moon, compares alike."""
    time, front = measured_front(shift=-0.1)
    wide = experiments.compare_front(2.0 * time, 4.0 * front, 4.0 * WIDTH)
    moon = experiments.compare_front(time * math.sqrt(GRAVITY / 1.62), front, WIDTH, gravity=1.62)
    assert wide.shift == moon.shift == pytest.approx(-0.1, abs=1e-4)
    assert max(wide.rms, moon.rms) < 1e-4


def test_a_front_too_long_by_a_twentieth():
    front = measured_front(scale=1.05)
    fixed = experiments.compare_front(*front, WIDTH, shift_limit=0.0)
    assert fixed.shift == 0.0
    assert fixed.rms == pytest.approx(0.05, abs=1e-6)
    assert fixed.slope_error == pytest.approx(0.05, abs=1e-6)
    assert not fixed.shift_at_limit
    free = experiments.compare_front(*front, WIDTH)
    assert free.rms_unshifted == pytest.approx(0.05, abs=1e-6)
    assert 0.01 < free.rms < 0.05  # a shift makes up for a part of it, never for all
    assert free.shift < 0.0


def test_slope_of_a_straight_line():
    axis = np.linspace(0.0, 3.4, 40)
    result = experiments.compare_front(axis * PER_T, (0.8 + 0.7 * axis) * WIDTH, WIDTH)
    assert result.slope == pytest.approx(0.7, rel=1e-9)
    assert result.slope_experiment == pytest.approx(1.2978, abs=1e-4)


def test_a_shift_out_of_reach_is_reported():
    result = experiments.compare_front(*measured_front(shift=-0.4), WIDTH)
    assert result.shift == -0.3
    assert result.shift_at_limit


def test_a_run_shorter_than_the_data():
    result = experiments.compare_front(*measured_front(shift=-0.1, end=2.0), WIDTH)
    assert result.shift == pytest.approx(-0.1, abs=1e-4)
    assert result.points == 7  # the readings up to T = 1.98, met at 1.88; the next is met at 2.10
    assert result.slope == pytest.approx(result.slope_experiment, rel=1e-3)
    shortest = experiments.compare_front(*measured_front(end=1.5), WIDTH, shift_limit=0.0)
    assert math.isfinite(shortest.rms)
    assert math.isnan(shortest.slope)
    with pytest.raises(ValueError, match="fewer than three"):
        experiments.compare_front(*measured_front(end=1.0), WIDTH)


def test_a_run_that_starts_late_leaves_the_first_readings_out():
    result = experiments.compare_front(*measured_front(start=0.5), WIDTH)
    assert result.points == 12
    assert result.rms < 1e-4


@pytest.mark.parametrize("shift", [-0.25, 0.0, 0.2])
def test_height_at_a_known_shift(shift):
    result = experiments.compare_height(*measured_height(shift), 2.0 * WIDTH, WIDTH, shift=shift)
    assert result.shift == shift
    assert result.rms < 1e-9
    assert result.largest < 1e-9
    assert result.points == 12  # tau up to 3.0
    assert (result.rms_unshifted > 0.02) == (shift != 0.0)
    assert result.largest_unshifted >= result.rms_unshifted


def test_height_too_large_by_a_twentieth():
    time, height = measured_height()
    result = experiments.compare_height(time, 1.05 * height, 2.0 * WIDTH, WIDTH)
    assert result.rms == result.rms_unshifted == pytest.approx(0.05, abs=1e-9)
    assert result.largest == result.largest_unshifted == pytest.approx(0.05, abs=1e-9)


def test_height_leaves_out_what_the_shift_takes_before_the_run():
    time, height = measured_height()
    late = time >= 0.5 * PER_TAU  # the first reading, tau = 0.56, is met at 0.35 under the shift
    result = experiments.compare_height(time[late], height[late], 2.0 * WIDTH, WIDTH, shift=-0.3)
    assert result.points == 10
    with pytest.raises(ValueError, match="no reading"):
        experiments.compare_height([0.0, 0.01], [0.29, 0.28], 2.0 * WIDTH, WIDTH)


def test_height_wants_the_column_of_the_data():
    with pytest.raises(ValueError, match="twice as high"):
        experiments.compare_height([0.0, 0.1, 0.2], [0.1, 0.1, 0.1], WIDTH, WIDTH)
    with pytest.raises(ValueError, match="shift"):
        experiments.compare_height([0.0, 0.1, 0.2], [0.2, 0.2, 0.1], 2.0 * WIDTH, WIDTH, shift=math.nan)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"width": 0.0}, "width"),
        ({"gravity": -9.81}, "gravity"),
        ({"shift_limit": -0.1}, "shift_limit"),
        ({"time": [0.0, 0.1]}, "one length"),
        ({"time": [[0.0, 0.1, 0.2]], "front": [[0.1, 0.2, 0.3]]}, "one length"),
        ({"time": [0.0, 0.2, 0.2]}, "increase"),
        ({"time": [0.0, 0.1, math.nan]}, "finite"),
        ({"front": [0.1, 0.2, math.inf]}, "finite"),
        ({"front": [0.1, 0.0, 0.3]}, "positive"),
    ],
)
def test_wrong_input_is_named(change, message):
    good = {"time": [0.0, 0.1, 0.3], "front": [0.15, 0.2, 0.5], "width": WIDTH}
    assert experiments.compare_front(**good).points > 0
    with pytest.raises(ValueError, match=message):
        experiments.compare_front(**(good | change))


def test_the_plot_is_written_and_not_blank(tmp_path):
    image = pytest.importorskip("matplotlib.image")
    runs = {"fine": measured_front(-0.2), "coarse": measured_front(-0.1)}
    path = experiments.plot_front(tmp_path / "new" / "front.png", runs, WIDTH, shift=-0.2)
    pixels = image.imread(path)[..., :3]  # (height, width, 3) in [0, 1]
    assert pixels.shape[0] > 600
    assert pixels.shape[1] > 900
    drawn = (pixels < 0.9).any(axis=-1).mean()
    assert 0.02 < drawn < 0.5
    for color in ("#0072B2", "#D55E00", "#009E73", "#E69F00", "#56B4E9"):  # both runs, all three references
        rgb = np.array([int(color[i : i + 2], 16) for i in (1, 3, 5)]) / 255.0
        assert (np.abs(pixels - rgb).max(axis=-1) < 0.02).sum() > 100, color


def test_the_plot_refuses_wrong_input(tmp_path):
    pytest.importorskip("matplotlib")
    with pytest.raises(ValueError, match="at least one"):
        experiments.plot_front(tmp_path / "front.png", {}, WIDTH)
    with pytest.raises(ValueError, match="width"):
        experiments.plot_front(tmp_path / "front.png", {"run": measured_front()}, 0.0)


def test_the_plot_names_its_extra_when_matplotlib_is_missing(tmp_path, monkeypatch):
    for name in [name for name in sys.modules if name.split(".")[0] == "matplotlib"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "matplotlib", None)  # what import finds of a package that is not there
    with pytest.raises(ImportError, match=r"tipfem\[plot\]"):
        experiments.plot_front(tmp_path / "front.png", {"run": measured_front()}, WIDTH)
