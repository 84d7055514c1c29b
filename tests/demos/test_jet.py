"""The demo of a jet that breaks into drops, coarse, until it does."""

from __future__ import annotations

import math
from types import SimpleNamespace

import pytest
from demo_runs import called
from tipfem.demos import jet


@pytest.mark.slow
def test_waves_grow_at_the_rate_of_theory(tmp_path, capsys):
    """Rayleigh's, 0.343 sqrt(sigma / (rho R^3)) for k R = 0.697, less what viscosity takes."""
    assert jet.rate() == pytest.approx(0.343 * math.sqrt(0.0728 / (998.2 * 1e-9)), rel=0.01)
    words = ["--spacing", "0.00025", "--end-time", "0.022", "--no-frames"]
    figures = called("jet", tmp_path, *words)["validation"]
    assert "check: passed" in capsys.readouterr().out
    assert abs(figures["rate"]) < 0.03
    assert (tmp_path / "jet.png").stat().st_size > 0


def test_the_check_names_what_is_missed():
    check, options = jet.BreaksUp(), SimpleNamespace(end_time=0.06)
    good = {"rate": -0.01, "volume": 1e-13, "drops": 3.0}
    assert check.missed(good, options) == []
    for name, value, text in (("rate", 0.1, "rate"), ("volume", 1e-9, "volume"), ("drops", 1.0, "not broken")):
        assert text in check.missed({**good, name: value}, options)[0]
