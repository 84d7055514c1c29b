"""The demo of a bubble in a box, coarse, until it rises."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
from demo_runs import called, load
from tipfem.demos import rising_bubble_3d as demo


@pytest.mark.slow
def test_a_bubble_rises(tmp_path, capsys):
    words = [
        "--spacing",
        "0.125",
        "--end-time",
        "0.6",
        "--time-step",
        "0.03",
        "--frames-per-second",
        "10",
        "--no-frames",
    ]
    figures = called("rising_bubble_3d", tmp_path, *words)["validation"]
    assert "check: passed" in capsys.readouterr().out
    assert figures["speed"] == pytest.approx(0.28, abs=0.05)
    assert 0.95 < figures["sphericity"] < 1.0
    assert (tmp_path / "rising_bubble_3d.png").stat().st_size > 0


def test_the_check_names_what_is_missed():
    check, options = demo.Rises(load("rising_bubble_3d").case), SimpleNamespace(end_time=3.0)
    good = {"largest_speed": 0.35, "speed": 0.33, "changes": 0.02, "sphericity": 0.96, "aside": 0.02, "volume": 1e-14}
    assert check.missed(good, options) == []
    for name, value in (("changes", 0.2), ("aside", 1.0), ("volume", 1e-6)):
        assert name in check.missed({**good, name: value}, options)[0]
