"""The demo of three fluids, coarse and short."""

from __future__ import annotations

import importlib
import json
from pathlib import Path

import imageio.v3 as iio
import pytest

import tipfem as tp

DEMOS = Path(__file__).resolve().parents[2] / "demos"


@pytest.fixture
def demo(monkeypatch):
    """The demo as a module."""
    monkeypatch.syspath_prepend(str(DEMOS))
    return importlib.import_module("sinking_drop")


def test_a_drop_falls_through_air_into_water(demo, tmp_path, capsys):
    """Coarse, until the drop is well under water: every fluid keeps its volume, all that is promised is there."""
    words = ["--spacing", "0.006", "--time-step", "0.002", "--end-time", "1", "--frames-per-second", "10"]
    demo.main([*words, "--out", str(tmp_path)])
    assert "check: passed" in capsys.readouterr().out
    figures = json.loads((tmp_path / "summary.json").read_text())["validation"]
    for name in ("glycerin", "water", "air"):
        assert figures[f"volume_error_{name}"] < 1e-6
    assert figures["centre"] < 0.4
    assert figures["dry"] == 0.0
    for name in ("drop.png", "strip.png"):
        assert iio.imread(tmp_path / name).std() > 5
    assert (tmp_path / "animation.mp4").is_file()
    assert "centre_height" in (tmp_path / "history.csv").read_text().splitlines()[0]


@pytest.mark.parametrize("interface", ["interpolated", "sharp"])
def test_both_rules_carry_three_fluids(demo, interface):
    """The fall itself is free fall, and the volumes add up to the tank, whatever the rule."""
    simulation = tp.Simulation(demo.build(0.005, interface=interface), time_step=1e-3)
    begun = demo.centre_height(simulation)
    assert begun == pytest.approx(demo.CENTRE[1], abs=0.0025)
    while simulation.time < 0.04:
        simulation.step(0.04)
    # The first step from rest counts half, and the air gives way.
    fallen = begun - demo.centre_height(simulation)
    assert fallen == pytest.approx(0.5 * demo.GRAVITY * 0.04**2, rel=0.1)
    volumes = [simulation.volume(fluid.name) for fluid in demo.FLUIDS]
    assert sum(volumes) == pytest.approx(demo.TANK[0] * demo.TANK[1], rel=1e-12)


def test_check_finds_what_is_wrong(demo):
    """Figure by figure; where the drop is counts only when it had time to sink."""
    good = {f"volume_error_{name}": 0.005 for name in ("glycerin", "water", "air")}
    good |= {"largest_speed": 1.5, "centre": 0.2, "dry": 0.0}
    assert demo.check(good, 2.0) == []
    for name, value in (("volume_error_air", 0.02), ("largest_speed", 9.0), ("centre", 0.9), ("dry", 0.1)):
        missed = demo.check({**good, name: value}, 2.0)
        assert len(missed) == 1
        assert missed[0].startswith(f"{name} is ")
    assert demo.check({**good, "centre": 1.5, "dry": 1.0}, 0.1) == []
