"""The demos of a drop that falls into a pool and of a bubble that bursts, coarse, until it does."""

from __future__ import annotations

import math
from types import SimpleNamespace

import pytest
from demo_runs import called, load
from tipfem.demos.support.splashing import Burst, Crater


@pytest.mark.slow
def test_a_drop_opens_a_crater(tmp_path, capsys):
    words = ["--spacing", "0.0004", "--time-step", "0.0003", "--end-time", "0.009", "--no-frames"]
    figures = called("splash", tmp_path, *words)["validation"]
    assert "check: passed" in capsys.readouterr().out
    assert figures["broken"] > 0  # the film of air under the drop
    assert 1.5 < figures["depth"] < figures["deepest"]


@pytest.mark.slow
def test_a_bubble_bursts(tmp_path, capsys):
    words = ["--spacing", "0.0005", "--time-step", "0.0003", "--end-time", "0.026", "--no-frames"]
    figures = called("bursting_bubble", tmp_path, *words)["validation"]
    assert "check: passed" in capsys.readouterr().out
    assert 0.01 < figures["burst"] < 0.026


def test_the_check_of_a_bubble_names_what_is_missed():
    check, options = Burst(load("bursting_bubble").case), SimpleNamespace(end_time=0.045)
    good = {"volume_error": 1e-14, "energy_rise": 0.0, "pockets": 0.0, "burst": 0.02, "retraction": 0.9}
    assert check.missed(good, options) == []
    assert check.missed({**good, "pockets": 1.0, "burst": math.nan, "retraction": math.nan}, options) == []
    for name, value, text in (
        ("energy_rise", 0.1, "energy_rise"),
        ("pockets", 0.5, "0.50 of the bubble is left"),
        ("retraction", 2.0, "2.00 of their speed by Taylor and Culick"),
    ):
        assert text in check.missed({**good, name: value}, options)[0]


def test_the_check_names_what_is_missed():
    check = Crater(load("splash").case)
    deep = check.deepest()
    half_disc = 2 / 3 * 998.2 * 9.81 * deep**3 + (math.pi - 2) * deep * 0.0728
    drop = 998.2 * math.pi * 0.0015**2 * (0.5 * 1.3**2 + 9.81 * 0.0021)
    assert half_disc == pytest.approx(drop + 2 * math.pi * 0.0015 * 0.0728)
    good = {"volume_error": 1e-14, "energy_rise": 0.0, "depth": 2.0, "deepest": 6.0}
    late, early = (SimpleNamespace(end_time=time) for time in (0.015, 0.001))
    assert check.missed(good, late) == []
    for name, value in (("volume_error", 1e-6), ("energy_rise", 0.1), ("energy_rise", float("nan"))):
        assert name in check.missed({**good, name: value}, late)[0]
    for depth in (0.5, 7.0):
        assert "radii deep" in check.missed({**good, "depth": depth}, late)[0]
    assert check.missed({**good, "depth": -1.0}, early) == []
