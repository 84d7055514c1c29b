"""The demo of a drop that falls into a pool, coarse, until its crater is dug."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
from demo_runs import called
from tipfem.demos import splash_round as demo


@pytest.mark.slow
def test_a_drop_digs_a_crater(tmp_path, capsys):
    words = ["--spacing", "0.001", "--end-time", "0.008", "--no-frames"]
    figures = called("splash_round", tmp_path, *words)["validation"]
    assert "check: passed" in capsys.readouterr().out
    assert 0.3 < figures["crater"] < 1.0
    assert (tmp_path / "splash_round.png").stat().st_size > 0


def test_the_deepest_crater_takes_all_of_the_energy():
    """Without surface tension (V^2 D^3 / (3 g))^(1/4), which is more."""
    without = (demo.SPEED**2 * demo.DIAMETER**3 / (3 * demo.GRAVITY)) ** 0.25
    assert 0.8 * without < demo.deepest() < without
    energy = demo.DENSITY * demo.DIAMETER**3 * demo.SPEED**2 / 12 + demo.SIGMA * demo.DIAMETER**2
    depth = demo.deepest()
    assert demo.DENSITY * demo.GRAVITY * depth**4 / 4 + demo.SIGMA * depth**2 == pytest.approx(energy, rel=1e-12)


def test_the_check_names_what_is_missed():
    check, options = demo.Splashes(), SimpleNamespace(end_time=0.07)
    good = {"crater": 0.8, "jet": 3.0, "volume": 1e-13}
    assert check.missed(good, options) == []
    for name, value, text in (("crater", 1.1, "crater"), ("jet", 0.2, "jet"), ("volume", 1e-9, "volume")):
        assert text in check.missed({**good, name: value}, options)[0]
    assert check.missed({**good, "jet": 0.2}, SimpleNamespace(end_time=0.01)) == []
