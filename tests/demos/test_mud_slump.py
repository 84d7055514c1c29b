"""The demo of mud that slumps and stops, coarse."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from demo_runs import called
from tipfem.demos import mud_slump as demo


@pytest.mark.slow
def test_mud_stops_in_the_shape_of_balance(tmp_path, capsys):
    figures = called("mud_slump", tmp_path, "--spacing", "0.0125", "--end-time", "0.7", "--no-frames")["validation"]
    assert "check: passed" in capsys.readouterr().out
    assert abs(figures["length"]) < 0.05
    assert figures["shape"] < 0.06
    assert figures["speed"] < 0.01
    assert (tmp_path / "mud_slump.png").stat().st_size > 0


def test_the_shape_of_balance_has_the_volume_of_the_mud():
    """And the slope of its surface times its depth is the yield stress over the weight."""
    prepared = demo.main.prepared()
    check = prepared.check
    check._volume = 0.02
    check.length = (9 * check._volume**2 / (8 * check._slope)) ** (1 / 3)
    x = np.linspace(0, check.length, 20001)
    assert np.trapezoid(check.shape(x), x) == pytest.approx(0.02, rel=1e-4)
    h = check.shape(x)[:10000]
    np.testing.assert_allclose(-np.gradient(h, x[:10000])[1:-1] * h[1:-1], 60.0 / (1000.0 * 9.81), rtol=1e-5)


def test_the_check_names_what_is_missed():
    check, options = demo.main.prepared().check, SimpleNamespace(end_time=1.0)
    good = {"length": -0.01, "shape": 0.02, "speed": 1e-4, "volume": 1e-13}
    assert check.missed(good, options) == []
    for name, value in (("length", -0.1), ("shape", 0.1), ("speed", 0.1), ("volume", 1e-9)):
        assert name in check.missed({**good, name: value}, options)[0]
    assert check.missed({**good, "speed": 0.1}, SimpleNamespace(end_time=0.1)) == []
