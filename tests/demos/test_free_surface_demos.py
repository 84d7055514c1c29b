"""The demos with a free surface, coarse and short, and what their checks find."""

from __future__ import annotations

import importlib
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

DEMOS = Path(__file__).resolve().parents[2] / "demos"


@pytest.fixture(scope="module")
def demo():
    """A demo as a module, by its name."""
    sys.path.insert(0, str(DEMOS))
    yield importlib.import_module
    sys.path.remove(str(DEMOS))


def run(name: str, out: Path, *words: str) -> dict:
    """What a demo says of itself in summary.json, run with the words a user would type; it must pass its check."""
    done = subprocess.run(
        [sys.executable, str(DEMOS / f"{name}.py"), "--out", str(out), *words],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "check: passed" in done.stdout
    assert (out / "history.csv").exists()
    return json.loads((out / "summary.json").read_text())["validation"]


def test_the_dam_break_at_ten_millimetres(tmp_path):
    """Front, height and volume against the experiments; every file that is promised is there."""
    figures = run(
        "dam_break_free_surface", tmp_path, "--spacing", "0.01", "--end-time", "0.3", "--frames-per-second", "20"
    )
    assert figures["front_rms"] <= 0.06
    assert abs(figures["front_shift"]) <= 0.3
    assert figures["front_slope"] == pytest.approx(1.32, rel=0.15)
    assert figures["height_rms"] <= 0.06
    assert figures["volume_error"] <= 0.02
    for name in ("front.png", "animation.mp4", "case.json", "fields.pvd"):
        assert (tmp_path / name).stat().st_size > 0
    assert len(list((tmp_path / "frames").glob("*.png"))) == 7


def test_sloshing_for_two_periods(tmp_path):
    """Period within 2 %, damping of the right size."""
    figures = run("sloshing", tmp_path, "--spacing", "0.05", "--end-time", "2.4", "--no-frames")
    assert figures["period_over_theory"] == pytest.approx(1, abs=0.02)
    assert figures["damping_over_theory"] == pytest.approx(1, abs=0.4)
    assert (tmp_path / "amplitude.png").stat().st_size > 0


def test_oil_on_water_at_ten_millimetres(tmp_path):
    """Volumes of both fluids, the oil on top, and energy that falls."""
    figures = run("oil_on_water", tmp_path, "--spacing", "0.01", "--end-time", "0.3", "--no-frames")
    assert max(figures["volume_error_water"], figures["volume_error_oil"]) <= 0.04
    assert figures["oil_over_water"] > 0
    assert (tmp_path / "heights.png").stat().st_size > 0


def test_checks_find_what_is_wrong(demo):
    """Figure by figure."""
    dam = demo("dam_break_free_surface")
    good = {"front_rms": 0.03, "front_slope": 1.3, "height_rms": 0.03, "volume_error": 0.005}
    assert dam.check(good, 0.005) == []
    for name, value in (("front_rms", 0.05), ("front_slope", 1.1), ("height_rms", 0.06), ("volume_error", 0.03)):
        missed = dam.check({**good, name: value}, 0.005)
        assert len(missed) == 1
        assert missed[0].startswith(f"{name} is ")
    wave = demo("sloshing")
    good = {"volume_error": 0.0, "period": 1.2, "period_over_theory": 1.01, "damping": 0.1, "damping_over_theory": 0.9}
    assert wave.check(good) == []
    assert len(wave.check({**good, "period_over_theory": 0.97})) == 1
    assert len(wave.check({**good, "damping_over_theory": 3.0, "volume_error": float("nan")})) == 2
    oil = demo("oil_on_water")
    good = {"volume_error_water": 0.01, "volume_error_oil": 0.01, "energy_gain": 0.0, "oil_over_water": 0.02}
    assert oil.check(good, 0.005) == []
    assert len(oil.check({**good, "volume_error_oil": 0.03}, 0.005)) == 1
    assert oil.check({**good, "volume_error_oil": 0.03}, 0.01) == []
    assert len(oil.check({**good, "oil_over_water": -0.01}, 0.005)) == 1


def test_a_wave_of_theory_is_found_again(demo):
    """Period and damping of linear theory give ratios of one."""
    wave = demo("sloshing")
    time = np.linspace(0.01, 3.0, 300)
    size = wave.damped_wave(time, 0.01, wave.FREQUENCY, wave.DAMPING, 0.02)
    rows = [{"time": t, "amplitude": a, "volume_water": 0.5} for t, a in zip(time, size, strict=True)]
    figures = wave.validate(rows)
    assert figures["period_over_theory"] == pytest.approx(1, abs=1e-6)
    assert figures["damping_over_theory"] == pytest.approx(1, abs=1e-6)
    assert list(wave.validate(rows[:10])) == ["volume_error"]


@pytest.mark.parametrize("name", ["dam_break_free_surface", "sloshing", "oil_on_water"])
def test_the_first_state_is_the_one_asked_for(demo, name):
    """Volumes at the start, to a thousandth."""
    import tipfem as tp

    module = demo(name)
    simulation = tp.Simulation(module.build(0.02), time_step=1e-3)
    if name == "sloshing":
        assert simulation.volume("water") == pytest.approx(0.5, rel=1e-3)
        assert module.amplitude(simulation) == pytest.approx(module.AMPLITUDE, rel=0.02)
    elif name == "oil_on_water":
        for fluid in ("water", "oil"):
            assert simulation.volume(fluid) == pytest.approx(0.146 * 0.146, rel=1e-3)
    else:
        assert simulation.volume("water") == pytest.approx(0.146 * 0.292, rel=1e-6)
        assert module.front(simulation) == pytest.approx(0.146, abs=1e-9)
        assert module.column_height(simulation) == pytest.approx(0.292, abs=1e-9)
        assert module.spray(simulation) == 0


def test_bad_options_end_with_one_line(tmp_path):
    """A free surface leaves no choice of the interface's rule."""
    done = subprocess.run(
        [sys.executable, str(DEMOS / "sloshing.py"), "--out", str(tmp_path), "--interface", "sharp"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode != 0
    assert "unrecognized arguments: --interface" in done.stderr
    assert "Traceback" not in done.stderr
