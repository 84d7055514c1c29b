"""The demo of a wave that runs round a tank, coarse, until it has run round once."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from demo_runs import called, load
from tipfem.demos import sloshing_3d as demo


@pytest.mark.slow
def test_a_wave_runs_round(tmp_path, capsys):
    words = ["--spacing", "0.075", "--end-time", "1.6", "--time-step", "0.02", "--no-frames"]
    figures = called("sloshing_3d", tmp_path, *words)["validation"]
    assert "check: passed" in capsys.readouterr().out
    assert figures["off"] < 0.12
    assert figures["largest"] > 0.03
    assert (tmp_path / "sloshing_3d.png").stat().st_size > 0


def test_the_theory_at_a_steady_motion_is_that_of_forced_oscillations():
    """a = A w^2 4 L / pi^2 / g / (1 - (w / w_1)^2), where the natural ones have been taken out."""
    check = demo.RunsRound(load("sloshing_3d").case)
    w, k = 3.0, np.pi / 0.6
    check._place = lambda t: (0.01 * np.cos(w * t), 0.0, 0.0)
    square = 9.81 * k * np.tanh(k * 0.3)
    forced = -0.01 * w**2 * 4 * 0.6 / np.pi**2 / 9.81 / (1 - w**2 / square)
    times = np.linspace(0.0, 5.0, 40)
    expected = forced * (np.cos(w * times) - np.cos(np.sqrt(square) * times))
    along, across = check.theory(times)
    np.testing.assert_allclose(along, expected, atol=1e-4 * abs(forced))
    assert np.abs(across).max() == 0


def test_the_check_names_what_is_missed():
    check, options = demo.RunsRound(load("sloshing_3d").case), SimpleNamespace(end_time=4.0)
    good = {"off": 0.05, "largest": 0.07, "volume": 1e-15}
    assert check.missed(good, options) == []
    for name, value, text in (("off", 0.3, "amplitudes"), ("volume", 1e-6, "volume")):
        assert text in check.missed({**good, name: value}, options)[0]
