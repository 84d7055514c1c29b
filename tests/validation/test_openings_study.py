"""Flows through openings against what is known of them, coarse."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from tipfem.demos.validation.openings import channels, run, waves

import tipfem as tp


@pytest.mark.slow
def test_coarse_channels_are_near_theory():
    coarse, fine = (channels.poiseuille(across, end=0.5) for across in (8, 12))
    assert abs(fine["gradient"]) < 0.01
    assert math.log(coarse["velocity"] / fine["velocity"]) / math.log(12 / 8) > 1.9
    assert fine["refused"] == 0


@pytest.mark.slow
def test_the_command_leaves_figures_and_names_what_is_missed(tmp_path, capsys):
    assert run.main(flow=("uniform",), across=4, out=tmp_path) == 0
    figures = json.loads((tmp_path / "summary.json").read_text())["uniform"]
    assert figures["across"] == 4
    assert figures["velocity"] < 1e-9
    assert figures["refused"] == 0
    capsys.readouterr()


# Figures of the flows at coarse spacings, and what they may differ by: some are far from the references, which the demo
# asks for at finer ones. Those of water scatter by some percent with any change.
COARSE = [
    ("layers", 12, {"interface": (0.0, 0.02), "velocity": (0.0, 0.02)}, 0),
    ("vortex", 32, {"left": (0.0, 1e-4)}, 0),
    ("step", 6, {"reattachment": (2.922, 0.15)}, 0),
    ("cylinder", 10, {"drag": (5.58, 0.25)}, 0),
    ("overfall", 4, {"brink": (0.921, 0.03)}, 12),
    ("weir", 4, {"coefficient": (0.688, 0.03)}, 12),
    ("broad_weir", 4, {"coefficient": (0.838, 0.03)}, 15),
    ("bore", 4, {"depth": (0.95, 0.07)}, 30),
    ("waves", 5, {"height": (1.0, 0.03), "reflection": (0.0, 0.02)}, 3),
    ("plate", 4, {"transmission": (0.483, 0.04), "reflection": (0.73, 0.05)}, 3),
]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "across", "expected", "refused"), COARSE, ids=[row[0] for row in COARSE])
def test_a_flow_stays_near_its_coarse_figures(name, across, expected, refused):
    found = run.STUDIES[name].run(across)
    for key, (value, within) in expected.items():
        assert found[key] == pytest.approx(value, abs=within), key
    assert found["refused"] <= refused


@pytest.mark.parametrize("name", run.STUDIES)
def test_the_check_of_a_flow_can_fail(name):
    good = {"expected": 0.65, "hager": 0.9, "passes": 0.54, "comes back": 0.84, "refused": 0.0}
    for key, compared in run.STUDIES[name].compared.items():
        good[key] = good[compared.value] if isinstance(compared.value, str) else compared.value
    assert run.check(name, good) == []
    for key in run.STUDIES[name].compared:
        assert len(run.check(name, {**good, key: math.nan})) == 1
        assert len(run.check(name, {**good, key: good[key] + 0.4})) == 1


def test_waves_that_come_back_are_told_from_those_that_go():
    number, omega = tp.WavePiston(height=1e-4, period=1.0, depth=waves.DEPTH).number, 2 * math.pi
    time, places = np.linspace(0, 4, 400, endpoint=False), np.array(waves.GAUGES)
    onwards = 0.01 * np.cos(omega * time[:, None] - number * places)
    back = 0.002 * np.cos(omega * time[:, None] + number * places + 0.7)
    found = waves.both_ways(time, onwards + back + 1e-3, waves.GAUGES, 1.0)
    assert found == pytest.approx((0.01, 0.002), rel=1e-9)
