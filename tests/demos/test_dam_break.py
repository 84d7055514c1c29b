"""The dam break demo, as its user runs it, coarse."""

from __future__ import annotations

import resource
import sys
from types import SimpleNamespace

import imageio.v3 as iio
import numpy as np
import pytest
from demo_runs import DEMOS, called, load, python, typed
from tipfem.demos.validation.dam_break import case, check

import tipfem as tp


@pytest.mark.slow
def test_ten_millimetres_against_the_experiments(tmp_path):
    """The command a user types leaves every file it promises and passes its own check, in 180 s of processor time."""
    out = tmp_path / "results"
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    summary = typed("dam_break.py", out, "--spacing", "0.01", "--end-time", "0.3", "--frames-per-second", "50")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)  # not the clock's: other work may run beside the tests
    assert after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime < 180
    figures = summary["validation"]
    assert figures["front_rms"] <= 0.05
    assert abs(figures["front_shift"]) <= 0.3
    assert figures["front_slope"] == pytest.approx(1.32, rel=0.125)
    assert figures["height_rms"] <= 0.035
    assert figures["volume_error"] <= 1e-9
    assert len(list((out / "frames").glob("*.png"))) == 16
    movie = iio.imread(out / "animation.mp4")
    assert movie.shape == (16, 720, 948, 3)  # as wide as the square tank and the legend need
    assert iio.imread(out / "front.png").std() > 5
    assert iio.imread(out / "strip.png").std() > 5
    header = (out / "history.csv").read_text().splitlines()[0]
    # tests/test_simulation.py has the columns between.
    assert header.startswith(
        "step,time,time_step,particles,newton_iterations,krylov_iterations,newton_residual,refused_steps,impact,relocated,"
    )
    assert header.endswith(",front,column_height,wall_seconds")


@pytest.mark.slow
def test_five_millimetres_against_the_experiments(tmp_path):
    """The default run, in under 8 minutes."""
    summary = typed("dam_break.py", tmp_path / "results")
    assert summary["wall_seconds"] < 480
    assert summary["validation"]["front_rms"] <= 0.04


def test_check_finds_what_is_wrong():
    """The demo's own check can fail, figure by figure."""
    fine, coarse, demo = SimpleNamespace(spacing=0.005), SimpleNamespace(spacing=0.01), check.DamBreak()
    good = {"front_rms": 0.02, "front_slope": 1.25, "height_rms": 0.03, "volume_error": 0.005}
    assert demo.missed(good, fine) == []
    for name, value in (("front_rms", 0.045), ("front_slope", 1.1), ("height_rms", 0.06), ("volume_error", 0.03)):
        missed = demo.missed({**good, name: value}, fine)
        assert len(missed) == 1
        assert missed[0].startswith(f"{name} is ")
    assert demo.missed({**good, "front_rms": 0.045}, coarse) == []


def test_front_slope_is_that_of_a_line():
    """All steps in the window count, none outside it; a run that ends early has none."""
    clock = np.sqrt(2 * case.GRAVITY / case.COLUMN[0])
    scaled = np.linspace(0, 3.3, 400)
    z = np.where((scaled > 1.42) & (scaled < 3.01), 1.25 * scaled + 0.4, 7.0)
    assert check.front_slope(scaled / clock, z * case.COLUMN[0]) == pytest.approx(1.25)
    assert np.isnan(check.front_slope(scaled[:300] / clock, z[:300] * case.COLUMN[0]))


def test_figures_need_no_long_run():
    """A run too short to compare still reports its volume."""
    rows = [{"time": t, "front": 0.146, "column_height": 0.292, "volume_water": 0.0426} for t in (0.01, 0.02)]
    assert list(check.figures_of(rows)) == ["volume_error"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--spacing", "-1"], "error: Invalid value for --spacing: '-1' is not a number > 0"),
        (["--spacing", "1.0"], "spacing is 1 m, too large for a tank"),
        (["--arch", "abacus"], 'Invalid value "abacus" for --arch'),
        (["--time-step", "soon"], "'soon' is not a number > 0"),
    ],
)
def test_bad_options_end_with_one_line(words, message, tmp_path):
    """No traceback, no work done."""
    done = python(DEMOS / "dam_break.py", "--out", tmp_path / "out", *words)
    assert done.returncode != 0
    assert message in done.stderr
    assert "Traceback" not in done.stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_help_names_units():
    """--help explains every argument."""
    printed = python(DEMOS / "dam_break.py", "--help").stdout
    for option in ("--spacing", "--end-time", "--time-step", "--arch", "--out", "--frames-per-second", "--no-frames"):
        assert option in printed
    assert "--air-spacing" in printed
    assert "[m]" in printed
    assert "[s]" in printed


def test_initial_column_is_the_one_asked_for():
    """Width, height and volume of the water at the start, at two spacings."""
    for spacing in (0.01, 0.02):
        simulation = tp.Simulation(load("dam_break", spacing=spacing).case, time_step=1e-3)
        assert case.front(simulation) == pytest.approx(0.146, abs=0.02 * spacing)
        assert case.column_height(simulation) == pytest.approx(0.292, abs=0.02 * spacing)
        assert simulation.volume("water") == pytest.approx(0.146 * 0.292, rel=1e-3)
        assert np.isnan(simulation.particles.position).sum() == 0


@pytest.mark.parametrize("interface", ["interpolated", "sharp"])
def test_the_studies_have_the_same_case(interface):
    """The script's case, written out, is that of validation/dam_break/case.py."""
    script = load("dam_break", spacing=0.02, interface=interface)
    study = case.build(0.02, interface=interface)
    np.testing.assert_array_equal(script.case.particles.position, study.particles.position)
    np.testing.assert_array_equal(script.case.particles.fluid, study.particles.fluid)
    assert script.case.fluids == study.fluids
    assert script.case.numerics == study.numerics
    np.testing.assert_array_equal(script.case.gravity, study.gravity)
    assert script.options.time_step == case.TIME_STEP


def test_the_air_may_be_coarser():
    """--air-spacing takes particles out of the air."""
    graded = load("dam_break", spacing=0.01, air_spacing=0.04).case
    assert len(graded.particles) < 0.5 * len(load("dam_break", spacing=0.01).case.particles)


def test_without_matplotlib_a_run_has_its_figures_and_no_front(tmp_path, monkeypatch, capsys):
    """A plain installation has no matplotlib: it comes with an extra."""
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    out = tmp_path / "run"
    summary = called("dam_break", out, "--spacing", "0.04", "--end-time", "0.02", "--no-frames")
    assert summary["check"] == "passed"
    assert "tipfem[plot]" in capsys.readouterr().err
    assert not (out / "front.png").exists()
