"""The demos with a free surface, coarse and short, and what their checks find."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from demo_runs import DEMOS, called, load, python
from tipfem.demos.support.checks import Collapse, OilStaysOnTop
from tipfem.demos.validation.dam_break.case import column_height, front, spray
from tipfem.demos.validation.dam_break.check import DamBreak
from tipfem.demos.validation.sloshing.check import StandingWave, damped_wave

import tipfem as tp

FINE = SimpleNamespace(spacing=0.005)
WAVE = StandingWave(tp.Fluid("water", 1000.0, 5.0), length=1.0, depth=0.5, amplitude=0.01)


@pytest.mark.slow
def test_the_dam_break_at_ten_millimetres(tmp_path):
    """Front, height and volume against the experiments; every file that is promised is there."""
    words = ["--spacing", "0.01", "--end-time", "0.3", "--frames-per-second", "20"]
    figures = called("dam_break_free_surface", tmp_path, *words)["validation"]
    assert figures["front_rms"] <= 0.06
    assert abs(figures["front_shift"]) <= 0.3
    assert figures["front_slope"] == pytest.approx(1.32, rel=0.125)
    assert figures["height_rms"] <= 0.035
    assert figures["volume_error"] <= 1e-4
    for name in ("front.png", "animation.mp4", "case.json", "fields.pvd"):
        assert (tmp_path / name).stat().st_size > 0
    assert len(list((tmp_path / "frames").glob("*.png"))) == 7
    assert (tmp_path / "history.csv").exists()


@pytest.mark.slow
def test_sloshing_for_two_periods(tmp_path):
    """Period within 2 %, damping of the right size."""
    figures = called("sloshing", tmp_path, "--spacing", "0.05", "--end-time", "2.4", "--no-frames")["validation"]
    assert figures["period_over_theory"] == pytest.approx(1, abs=0.02)
    assert figures["damping_over_theory"] == pytest.approx(1, abs=0.4)
    assert (tmp_path / "amplitude.png").stat().st_size > 0


@pytest.mark.slow
def test_oil_on_water_at_ten_millimetres(tmp_path):
    """Volumes of both fluids, the oil on top, and energy that falls."""
    figures = called("oil_on_water", tmp_path, "--spacing", "0.01", "--end-time", "0.3", "--no-frames")["validation"]
    assert max(figures["volume_error_water"], figures["volume_error_oil"]) <= 1e-13
    assert figures["oil_over_water"] > 0.05
    assert figures["energy_gain"] <= 1e-4
    assert figures["front_rms"] <= 0.035
    assert (tmp_path / "heights.png").stat().st_size > 0


def test_checks_find_what_is_wrong():
    """Figure by figure."""
    dam = DamBreak(free_surface=True)
    good = {"front_rms": 0.03, "front_slope": 1.3, "height_rms": 0.03, "volume_error": 0.005}
    assert dam.missed(good, FINE) == []
    for name, value in (("front_rms", 0.05), ("front_slope", 1.1), ("height_rms", 0.06), ("volume_error", 0.03)):
        missed = dam.missed({**good, name: value}, FINE)
        assert len(missed) == 1
        assert missed[0].startswith(f"{name} is ")
    assert len(dam.missed({**good, "volume_error": 0.03}, SimpleNamespace(spacing=0.02))) == 1
    good = {"volume_error": 0.0, "period": 1.2, "period_over_theory": 1.01, "damping": 0.1, "damping_over_theory": 0.9}
    assert WAVE.missed(good, FINE) == []
    assert len(WAVE.missed({**good, "period_over_theory": 0.97}, FINE)) == 1
    assert len(WAVE.missed({**good, "damping_over_theory": 3.0, "volume_error": float("nan")}, FINE)) == 2
    oil = OilStaysOnTop()
    good = {"volume_error_water": 1e-14, "volume_error_oil": 1e-14, "energy_gain": 0.0, "oil_over_water": 0.02}
    assert oil.missed(good, FINE) == []
    assert len(oil.missed({**good, "volume_error_oil": 1e-8}, FINE)) == 1
    assert len(oil.missed({**good, "energy_gain": 0.001}, FINE)) == 1
    assert len(oil.missed({**good, "oil_over_water": -0.01}, FINE)) == 1


def test_a_wave_of_theory_is_found_again():
    """Period and damping of linear theory give ratios of one."""
    time = np.linspace(0.01, 3.0, 300)
    size = damped_wave(time, 0.01, WAVE.frequency, WAVE.damping, 0.02)
    rows = [{"time": t, "amplitude": a, "volume_water": 0.5} for t, a in zip(time, size, strict=True)]
    figures = WAVE.figures_of(rows)
    assert figures["period_over_theory"] == pytest.approx(1, abs=1e-6)
    assert figures["damping_over_theory"] == pytest.approx(1, abs=1e-6)
    assert list(WAVE.figures_of(rows[:10])) == ["volume_error"]


@pytest.mark.parametrize("name", ["dam_break_free_surface", "sloshing", "oil_on_water"])
def test_the_first_state_is_the_one_asked_for(name):
    """Volumes at the start, to a thousandth."""
    demo = load(name, spacing=0.02)
    simulation = tp.Simulation(demo.case, time_step=1e-3)
    if name == "sloshing":
        assert demo.check == WAVE
        assert simulation.volume("water") == pytest.approx(0.5, rel=1e-3)
        assert WAVE.measured_amplitude(simulation) == pytest.approx(WAVE.amplitude, rel=0.02)
    elif name == "oil_on_water":
        for fluid in ("water", "oil"):
            assert simulation.volume(fluid) == pytest.approx(0.146 * 0.146, rel=1e-3)
    else:
        assert simulation.volume("water") == pytest.approx(0.146 * 0.292, rel=1e-6)
        assert front(simulation) == pytest.approx(0.146, abs=1e-9)
        assert column_height(simulation) == pytest.approx(0.292, abs=1e-9)
        assert spray(simulation) == 0


@pytest.mark.slow
def test_bad_options_end_with_one_line(tmp_path):
    """A free surface leaves no choice of the interface's rule."""
    done = python(DEMOS / "sloshing.py", "--out", tmp_path, "--interface", "sharp")
    assert done.returncode != 0
    assert "error: Unknown option: --interface" in done.stderr
    assert "Traceback" not in done.stderr


def test_a_column_in_3d_collapses(tmp_path, capsys):
    words = ["--spacing", "0.1", "--end-time", "0.1", "--frames-per-second", "50", "--no-frames"]
    figures = called("dam_break_3d", tmp_path, *words)["validation"]
    assert "check: passed" in capsys.readouterr().out
    assert -3 < figures["front_ahead"] <= 1
    assert np.isnan(figures["reached"])


def test_the_check_of_a_column_in_3d_names_what_is_missed():
    check, late, early = (
        Collapse(load("dam_break_3d").case),
        SimpleNamespace(end_time=0.8),
        SimpleNamespace(end_time=0.1),
    )
    good = {"volume_error": 1e-13, "gain": 0.0, "front_ahead": 0.2, "reached": 0.5}
    assert check.missed(good, late) == []
    assert check.missed({**good, "reached": np.nan}, early) == []
    for name, value in (("volume_error", 1e-6), ("gain", 0.03), ("gain", np.nan), ("front_ahead", 2.0)):
        assert name in check.missed({**good, name: value}, late)[0]
    for time in (0.7, np.nan):
        assert "the front was at the far wall" in check.missed({**good, "reached": time}, late)[0]
