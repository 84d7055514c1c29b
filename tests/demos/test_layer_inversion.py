"""The demo in which glycerin falls through water, coarse and short, and whole."""

from __future__ import annotations

import importlib
import json
import subprocess
import sys
from pathlib import Path

import imageio.v3 as iio
import numpy as np
import pytest

import tipfem as tp

DEMOS = Path(__file__).resolve().parents[2] / "demos"


@pytest.fixture
def demo(monkeypatch):
    """The demo as a module."""
    monkeypatch.syspath_prepend(str(DEMOS))
    return importlib.import_module("layer_inversion")


def test_the_command_leaves_what_it_promises(tmp_path):
    """Coarse, to 2 s, as a user types it: history, summary, pressure, movie and strip; the volumes are kept."""
    out = tmp_path / "results"
    words = ["--spacing", "0.01", "--end-time", "2", "--time-step", "0.02", "--interface", "sharp", "--out", str(out)]
    done = subprocess.run(
        [sys.executable, str(DEMOS / "layer_inversion.py"), *words], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "check: passed" in done.stdout
    figures = json.loads((out / "summary.json").read_text())["validation"]
    assert figures["volume_error"] < 1e-6
    assert figures["sunk_volume"] > 0.4
    assert len(list((out / "frames").glob("*.png"))) == 9
    assert (out / "animation.mp4").stat().st_size > 1e4
    for name in ("pressure.png", "strip.png"):
        assert iio.imread(out / name).std() > 5
    assert "pressure_error" in (out / "history.csv").read_text().splitlines()[0]


@pytest.mark.parametrize("interface", ["interpolated", "sharp"])
def test_the_start_is_a_wave_of_half_the_tank(demo, interface):
    """Half the tank each, within a spacing's part; the glycerin lies on top, and none of it has sunk."""
    case = demo.build(0.005, interface=interface)
    layers = demo.inverted(case)
    assert sum(thickness for _, thickness in layers) == pytest.approx(demo.EDGE, rel=1e-12)
    assert layers[0][1] == pytest.approx(demo.EDGE / 2, rel=0.06)
    assert layers[0][0].name == "glycerin"
    begun = demo.sunk(tp.Simulation(case), layers[0][1])
    assert max(begun.values()) < 0.12


def test_sunk_counts_what_it_says(demo, glycerin, water):
    """Layers the other way round have sunk whole; particles on the interface count."""
    tank = tp.tank((0.1, 0.1), 0.01).fill(water).fill(glycerin, box=((0, 0), (0.1, 0.05)))
    for interface in ("interpolated", "sharp"):
        simulation = tp.Simulation(tp.Case(tank, [glycerin, water], (0, -9.81), interface=interface), time_step=1e-3)
        assert demo.sunk(simulation, 0.05)["sunk_particles"] == 1.0
        assert demo.sunk(simulation, 0.05)["sunk_volume"] > 0.95
        watch = demo.profiles.PressureWatch([(glycerin, 0.05), (water, 0.05)], 9.81, since=0.0, bins=10)
        for _ in range(3):
            simulation.step()
            assert watch(simulation) < 0.005
        height, error = watch.mean
        assert len(height) == 10
        assert np.abs(error).max() < 0.005


def test_check_finds_what_is_wrong(demo):
    """A whole run is judged by all figures, a short one by its volumes."""
    good = {"pressure_agreement": 0.99, "sunk_particles": 0.99, "volume_error": 0.005}
    assert demo.check(good, demo.END_TIME) == []
    for name, value in (("pressure_agreement", 0.98), ("sunk_particles", 0.96), ("volume_error", 0.02)):
        assert len(demo.check({**good, name: value}, demo.END_TIME)) == 1
        assert demo.check({**good, name: np.nan}, demo.END_TIME)[0].startswith(name)
    assert demo.check({**good, "sunk_particles": 0.1}, 1.0) == []


@pytest.mark.slow
def test_the_whole_run(tmp_path):
    """The default run passes its check, in under 15 minutes."""
    out = tmp_path / "results"
    done = subprocess.run(
        [sys.executable, str(DEMOS / "layer_inversion.py"), "--no-frames", "--out", str(out)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert json.loads((out / "summary.json").read_text())["wall_seconds"] < 900
