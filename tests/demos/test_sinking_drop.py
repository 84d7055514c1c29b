"""The demo of three fluids, coarse and short."""

from __future__ import annotations

from types import SimpleNamespace

import imageio.v3 as iio
import pytest
from demo_runs import called, load
from tipfem.demos.support.checks import DropSinks, mean_height

import tipfem as tp


@pytest.mark.slow
def test_a_drop_falls_through_air_into_water(tmp_path, capsys):
    """Coarse, until the drop is well under water: every fluid keeps its volume, all that is promised is there."""
    words = ["--spacing", "0.006", "--time-step", "0.002", "--end-time", "1", "--frames-per-second", "10"]
    figures = called("sinking_drop", tmp_path, *words)["validation"]
    assert "check: passed" in capsys.readouterr().out
    for name in ("glycerin", "water", "air"):
        assert figures[f"volume_error_{name}"] < 1e-6
    assert figures["centre"] < 0.4
    assert figures["dry"] == 0.0
    for name in ("drop.png", "strip.png"):
        assert iio.imread(tmp_path / name).std() > 5
    assert (tmp_path / "animation.mp4").is_file()
    assert "centre_height" in (tmp_path / "history.csv").read_text().splitlines()[0]


@pytest.mark.parametrize("interface", ["interpolated", "sharp"])
def test_both_rules_carry_three_fluids(interface):
    """The fall itself is free fall, and the volumes add up to the tank, whatever the rule."""
    case = load("sinking_drop", spacing=0.005, interface=interface).case
    simulation = tp.Simulation(case, time_step=1e-3)
    begun = mean_height(simulation, 0)
    assert begun == pytest.approx(0.09, abs=0.0025)
    while simulation.time < 0.04:
        simulation.step(0.04)
    # The first step from rest counts half, and the air gives way.
    fallen = begun - mean_height(simulation, 0)
    assert fallen == pytest.approx(0.5 * 9.81 * 0.04**2, rel=0.1)
    volumes = [simulation.volume(fluid.name) for fluid in case.fluids]
    assert sum(volumes) == pytest.approx(0.1 * 0.12, rel=1e-12)


def test_check_finds_what_is_wrong():
    """Figure by figure; where the drop is counts only when it had time to sink."""
    demo, whole = DropSinks(0.06), SimpleNamespace(end_time=2.0)
    good = {f"volume_error_{name}": 0.005 for name in ("glycerin", "water", "air")}
    good |= {"largest_speed": 1.5, "centre": 0.2, "dry": 0.0}
    assert demo.missed(good, whole) == []
    for name, value in (("volume_error_air", 0.02), ("largest_speed", 9.0), ("centre", 0.9), ("dry", 0.1)):
        missed = demo.missed({**good, name: value}, whole)
        assert len(missed) == 1
        assert missed[0].startswith(f"{name} is ")
    assert demo.missed({**good, "centre": 1.5, "dry": 1.0}, SimpleNamespace(end_time=0.1)) == []
