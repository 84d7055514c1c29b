"""The demo of a hydraulic jump, coarse and short."""

from __future__ import annotations

import math
from types import SimpleNamespace

import pytest
from demo_runs import called
from tipfem.demos import hydraulic_jump as demo


@pytest.mark.slow
def test_what_enters_leaves_or_stays(tmp_path, capsys):
    words = ["--spacing", "0.02", "--end-time", "0.5", "--no-frames"]
    figures = called("hydraulic_jump", tmp_path, *words)["validation"]
    assert "check: passed" in capsys.readouterr().out
    assert figures["imbalance"] < 1e-9
    assert figures["passed"] == pytest.approx(0.5 * demo.SPEED * demo.INLET, rel=0.5)
    assert (tmp_path / "hydraulic_jump.png").stat().st_size > 0


def test_a_jump_keeps_momentum_and_loses_energy():
    """Belanger's depths have the same g d^2 / 2 + q^2 / d; the head falls by (d2 - d1)^3 / (4 d1 d2)."""
    thin, deep = demo.conjugate()
    flow, g = demo.SPEED * demo.INLET, demo.GRAVITY
    momentum, head = (lambda d: g * d * d / 2 + flow**2 / d), (lambda d: d + (flow / d) ** 2 / (2 * g))
    assert momentum(deep) == pytest.approx(momentum(thin), rel=1e-12)
    assert head(thin) == pytest.approx(demo.CREST + demo.INLET + demo.SPEED**2 / (2 * g), rel=1e-12)
    assert head(thin) - head(deep) == pytest.approx((deep - thin) ** 3 / (4 * thin * deep), rel=1e-12)


def test_the_check_names_what_is_missed():
    check, options = demo.JumpStands(), SimpleNamespace(end_time=4.0)
    good = {"imbalance": 1e-12, "passed": 1.0, "toe": 0.4, "depth_error": 0.02, "eddies": 50.0, "numerics": 50.0}
    assert check.missed(good, options) == []
    for name, value, text in (("imbalance", 1e-3, "volumes"), ("toe", 1.0, "toe"), ("depth_error", -0.2, "depth")):
        assert text in check.missed({**good, name: value}, options)[0]
    assert "depth" in check.missed({**good, "depth_error": math.nan}, options)[0]
    assert check.missed({**good, "toe": 1.0}, SimpleNamespace(end_time=1.0)) == []
