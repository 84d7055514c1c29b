"""The demo of a dam break behind a gate: at rest while it is closed, and a front below it."""

from __future__ import annotations

import math

import pytest
from demo_runs import called
from tipfem.demos.support.passing import LiftedGate


@pytest.mark.slow
def test_water_rests_behind_the_gate_and_runs_below_it(tmp_path, capsys):
    figures = called("dam_break_gate", tmp_path, "--spacing", "0.03", "--until", "0.3", "--no-frames")["validation"]
    assert "check: passed" in capsys.readouterr().out
    assert abs(figures["force"] - 1) < 1e-5
    assert figures["speed_at_rest"] < 1e-10
    assert 0.8 < figures["front_speed"] < 2.0


def test_the_check_names_what_is_missed():
    check = LiftedGate(0.6, 0.3, 0.05)
    good = {"force": 1.0, "speed_at_rest": 1e-12, "front_speed": 1.4, "volume_error": 1e-14}
    assert check.missed(good, None) == check.missed({**good, "front_speed": math.nan}, None) == []
    for name, value, text in (
        ("force", 0.99, "bears 0.99"),
        ("speed_at_rest", 1e-6, "moves at 1.0e-06"),
        ("front_speed", 2.5, "runs at 2.50"),
        ("volume_error", 1e-6, "is 1.0e-06 off"),
    ):
        (line,) = check.missed({**good, name: value}, None)
        assert text in line
