"""The dam break demo, as its user runs it, coarse."""

from __future__ import annotations

import importlib
import json
import resource
import subprocess
import sys
from pathlib import Path

import imageio.v3 as iio
import numpy as np
import pytest

DEMOS = Path(__file__).resolve().parents[2] / "demos"


@pytest.fixture(scope="module")
def demo():
    """The demo as a module."""
    sys.path.insert(0, str(DEMOS))
    yield importlib.import_module("dam_break")
    sys.path.remove(str(DEMOS))


def test_ten_millimetres_against_the_experiments(tmp_path):
    """The command a user types leaves every file it promises and passes its own check, in 180 s of processor time."""
    out = tmp_path / "results"
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    words = ["--spacing", "0.01", "--end-time", "0.3", "--frames-per-second", "50", "--out", str(out)]
    done = subprocess.run(
        [sys.executable, str(DEMOS / "dam_break.py"), *words], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    after = resource.getrusage(resource.RUSAGE_CHILDREN)  # not the clock's: other work may run beside the tests
    assert after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime < 180
    assert "check: passed" in done.stdout
    assert str(out) in done.stdout
    summary = json.loads((out / "summary.json").read_text())
    figures = summary["validation"]
    assert figures["front_rms"] <= 0.05
    assert abs(figures["front_shift"]) <= 0.3
    assert figures["front_slope"] == pytest.approx(1.32, rel=0.15)
    assert figures["height_rms"] <= 0.08
    assert figures["volume_error"] <= 0.02
    assert len(list((out / "frames").glob("*.png"))) == 16
    movie = iio.imread(out / "animation.mp4")
    assert movie.shape == (16, 720, 1280, 3)
    assert iio.imread(out / "front.png").std() > 5
    assert iio.imread(out / "strip.png").std() > 5
    header = (out / "history.csv").read_text().splitlines()[0]
    # tests/test_simulation.py has the columns between.
    assert header.startswith("step,time,time_step,particles,newton_iterations,krylov_iterations,relocated,")
    assert header.endswith(",front,column_height,wall_seconds")


@pytest.mark.slow
def test_five_millimetres_against_the_experiments(tmp_path):
    """The default run, in under 8 minutes."""
    out = tmp_path / "results"
    done = subprocess.run(
        [sys.executable, str(DEMOS / "dam_break.py"), "--out", str(out)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    summary = json.loads((out / "summary.json").read_text())
    assert summary["wall_seconds"] < 480
    assert summary["validation"]["front_rms"] <= 0.04


def test_check_finds_what_is_wrong(demo):
    """The demo's own check can fail, figure by figure."""
    good = {"front_rms": 0.02, "front_slope": 1.25, "height_rms": 0.03, "volume_error": 0.005}
    assert demo.check(good, 0.005) == []
    for name, value in (("front_rms", 0.045), ("front_slope", 1.1), ("height_rms", 0.06), ("volume_error", 0.03)):
        missed = demo.check({**good, name: value}, 0.005)
        assert len(missed) == 1
        assert missed[0].startswith(f"{name} is ")
    assert demo.check({**good, "front_rms": 0.045}, 0.01) == []


def test_front_slope_is_that_of_a_line(demo):
    """All steps in the window count, none outside it; a run that ends early has none."""
    clock = np.sqrt(2 * demo.GRAVITY / demo.COLUMN[0])
    scaled = np.linspace(0, 3.3, 400)
    z = np.where((scaled > 1.42) & (scaled < 3.01), 1.25 * scaled + 0.4, 7.0)
    assert demo.front_slope(scaled / clock, z * demo.COLUMN[0]) == pytest.approx(1.25)
    assert np.isnan(demo.front_slope(scaled[:300] / clock, z[:300] * demo.COLUMN[0]))


def test_validate_needs_no_long_run(demo):
    """A run too short to compare still reports its volume."""
    rows = [{"time": t, "front": 0.146, "column_height": 0.292, "volume_water": 0.0426} for t in (0.01, 0.02)]
    assert list(demo.validate(rows)) == ["volume_error"]


def finished_run(folder, spacing, speed):
    """What a run whose front moves at a constant speed [m/s] would have left."""
    folder.mkdir()
    (folder / "summary.json").write_text(json.dumps({"spacing": spacing}))
    rows = [f"{t},{0.146 + speed * t},0.28,0.0426" for t in np.arange(1, 61) * 0.005]
    (folder / "history.csv").write_text("\n".join(["time,front,column_height,volume_water", *rows]) + "\n")
    return folder


def test_fronts_of_several_runs_in_one_figure(demo, tmp_path, capsys):
    """--compare runs nothing: it reads histories, prints the figures of each and draws them together."""
    folders = [finished_run(tmp_path / name, h, v) for name, h, v in (("fine", 0.002, 1.5), ("coarse", 0.005, 1.4))]
    demo.main(["--compare", *map(str, folders), "--out", str(tmp_path / "both")])
    printed = capsys.readouterr().out
    assert printed.index("tipfem, 5 mm: ") < printed.index("tipfem, 2 mm: ")
    assert "front_rms" in printed
    assert iio.imread(tmp_path / "both" / "fronts.png").std() > 5
    assert [path.name for path in (tmp_path / "both").iterdir()] == ["fronts.png"]


def test_what_is_no_run_cannot_be_compared(demo, tmp_path, capsys):
    """One line names the folder."""
    for name, text in (("nothing", None), ("other", "time\n0.1\n")):
        folder = tmp_path / name
        if text:
            finished_run(folder, 0.005, 1.0)
            (folder / "history.csv").write_text(text)
        with pytest.raises(SystemExit):
            demo.main(["--compare", str(folder)])
        assert f"{folder}: no finished run of the dam break" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--spacing", "-1"], "--spacing: '-1' is not a number > 0"),
        (["--spacing", "1.0"], "spacing is 1 m, too large for a tank"),
        (["--arch", "abacus"], "invalid choice: 'abacus'"),
        (["--time-step", "soon"], "'soon' is not a number > 0"),
    ],
)
def test_bad_options_end_with_one_line(words, message, tmp_path):
    """No traceback, no work done."""
    done = subprocess.run(
        [sys.executable, str(DEMOS / "dam_break.py"), "--out", str(tmp_path / "out"), *words],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode != 0
    assert message in done.stderr
    assert "Traceback" not in done.stderr
    assert not (tmp_path / "out").exists()


def test_help_names_units():
    """--help explains every argument."""
    done = subprocess.run(
        [sys.executable, str(DEMOS / "dam_break.py"), "--help"], capture_output=True, text=True, check=True
    )
    for option in ("--spacing", "--end-time", "--time-step", "--arch", "--out", "--frames-per-second", "--no-frames"):
        assert option in done.stdout
    assert "[m]" in done.stdout
    assert "[s]" in done.stdout


def test_initial_column_is_the_one_asked_for(demo):
    """Width, height and volume of the water at the start, at two spacings."""
    import tipfem as tp

    for spacing in (0.01, 0.02):
        simulation = tp.Simulation(demo.build(spacing), time_step=1e-3)
        assert demo.front(simulation) == pytest.approx(0.146, abs=0.02 * spacing)
        assert demo.column_height(simulation) == pytest.approx(0.292, abs=0.02 * spacing)
        assert simulation.volume("water") == pytest.approx(0.146 * 0.292, rel=1e-3)
        assert np.isnan(simulation.particles.position).sum() == 0
