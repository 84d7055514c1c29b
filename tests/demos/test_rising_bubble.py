"""The demo of a bubble that rises in syrup, coarse."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
from demo_runs import called
from tipfem.demos import rising_bubble as demo
from tipfem.demos.validation.round.bubbles import terminal_reynolds


@pytest.mark.slow
def test_the_bubble_rises_as_in_experiments(tmp_path, capsys):
    """With 10 spacings in its diameter."""
    words = ["--spacing", "0.0026", "--end-time", "0.35", "--no-frames"]
    figures = called("rising_bubble", tmp_path, *words)["validation"]
    assert "check: passed" in capsys.readouterr().out
    assert abs(figures["reynolds"]) < 0.05
    assert figures["sphericity"] < 0.85
    assert (tmp_path / "rising_bubble.png").stat().st_size > 0


def test_the_speed_in_experiments_has_its_limits():
    """With much viscosity a drag coefficient of 16 / Re, that of a bubble without friction inside; with little 2.67."""
    assert terminal_reynolds(1.0, 1e6) == pytest.approx((1.0**3 / 1e6) ** 0.5 / 12, rel=0.02)
    assert terminal_reynolds(1e4, 1e-2) == pytest.approx((4 / 3 / 2.67) ** 0.5 * (1e12 / 1e-2) ** 0.25, rel=0.01)


def test_the_check_names_what_is_missed():
    check, options = demo.main.prepared().check, SimpleNamespace(end_time=0.4)
    good = {"reynolds": -0.01, "volume": 1e-12, "height": 0.1, "sphericity": 0.7}
    assert check.missed(good, options) == []
    for name, value in (("reynolds", 0.1), ("volume", 1e-6)):
        assert name in check.missed({**good, name: value}, options)[0]
    assert check.missed({**good, "reynolds": 0.1}, SimpleNamespace(end_time=0.1)) == []
