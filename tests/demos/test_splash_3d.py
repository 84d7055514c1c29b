"""The demo of a ball that falls into a pool in space, coarse, until its crater opens."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
from demo_runs import called, load
from tipfem.demos import splash_3d as demo


@pytest.mark.slow
def test_a_ball_opens_a_crater(tmp_path, capsys):
    words = ["--spacing", "0.075", "--end-time", "0.22", "--frames-per-second", "50", "--no-frames"]
    figures = called("splash_3d", tmp_path, *words)["validation"]
    assert "check: passed" in capsys.readouterr().out
    assert 0.4 < figures["crater"] < 1.0
    assert figures["aside"] < 0.05
    assert (tmp_path / "splash_3d.png").stat().st_size > 0


def test_the_check_names_what_is_missed():
    """And knows the ball's speed where it meets the pool."""
    check, options = demo.Splashes(load("splash_3d").case), SimpleNamespace(end_time=0.8)
    speed = 2.5**2 + 2 * 9.81 * 0.07
    assert check.deepest == pytest.approx((0.22**3 * speed / (3 * 9.81)) ** 0.25)
    good = {"crater": 0.8, "jet": 1.5, "volume": 1e-15, "aside": 0.01}
    assert check.missed(good, options) == []
    for name, value, text in (
        ("crater", 0.3, "depth"),
        ("crater", 1.2, "depth"),
        ("jet", 0.2, "diameters"),
        ("volume", 1e-9, "volume"),
        ("aside", 0.5, "aside"),
    ):
        assert text in check.missed({**good, name: value}, options)[0]
