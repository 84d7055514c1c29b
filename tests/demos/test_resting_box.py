"""The demo of a dam break that pushes a box: at rest before, and Coulomb's friction while it slides."""

from __future__ import annotations

import math

import pytest
from demo_runs import called
from tipfem.demos.support.passing import PushedBox


@pytest.mark.slow
def test_the_box_rests_and_slides(tmp_path, capsys):
    figures = called("resting_box", tmp_path, "--spacing", "0.03", "--until", "0.4", "--no-frames")["validation"]
    assert "check: passed" in capsys.readouterr().out
    assert figures["weight"] < 1e-5
    assert figures["friction"] < 1e-9
    assert figures["lifted"] < 1e-2  # 0.009 on an even lattice, 2e-5 in three perturbed starts
    assert 0.05 < figures["moved"] < 0.12


def test_the_check_names_what_is_missed():
    check = PushedBox(0.4, 0.3)
    good = {"weight": 1e-6, "friction": 1e-9, "lifted": 1e-4, "moved_before": 1e-12, "moved": 0.2}
    assert check.missed(good, None) == check.missed({**good, "friction": math.nan}, None) == []
    for name, value in (("weight", 0.01), ("friction", 1e-3), ("lifted", 0.1), ("moved_before", 1e-3)):
        (line,) = check.missed({**good, name: value}, None)
        assert line.startswith(f"{name} is {value:.4g}, above")
