"""The demo in which glycerin falls through water, coarse and short."""

from __future__ import annotations

from types import SimpleNamespace

import imageio.v3 as iio
import numpy as np
import pytest
from demo_runs import called, load, typed
from tipfem.demos.validation.layers.check import END_TIME, sunk
from tipfem.demos.validation.layers.profiles import PressureWatch

import tipfem as tp


@pytest.mark.slow
def test_the_command_leaves_what_it_promises(tmp_path):
    """Coarse, to 2 s: history, summary, pressure, movie and strip; the volumes are kept."""
    out = tmp_path / "results"
    words = ["--spacing", "0.01", "--end-time", "2", "--time-step", "0.02", "--interface", "sharp"]
    figures = called("layer_inversion", out, *words)["validation"]
    assert figures["volume_error"] < 1e-6
    assert figures["sunk_volume"] > 0.4
    assert len(list((out / "frames").glob("*.png"))) == 9
    assert (out / "animation.mp4").stat().st_size > 1e4
    for name in ("pressure.png", "strip.png"):
        assert iio.imread(out / name).std() > 5
    assert "pressure_error" in (out / "history.csv").read_text().splitlines()[0]


@pytest.mark.parametrize("interface", ["interpolated", pytest.param("sharp", marks=pytest.mark.slow)])
def test_the_start_is_a_wave_of_half_the_tank(interface):
    """Half the tank each, within a spacing's part; the glycerin lies on top, and none of it has sunk."""
    demo = load("layer_inversion", spacing=0.005, interface=interface)
    begun = tp.Simulation(demo.case)
    layers = demo.check.inverted(begun)
    assert sum(thickness for _, thickness in layers) == pytest.approx(0.1, rel=1e-12)
    assert layers[0][1] == pytest.approx(0.05, rel=0.06)
    assert layers[0][0].name == "glycerin"
    assert max(sunk(begun, layers[0][1]).values()) < 0.12


def test_sunk_counts_what_it_says(glycerin, water):
    """Layers the other way round have sunk whole; particles on the interface count."""
    tank = tp.tank((0.1, 0.1), 0.01).fill(water).fill(glycerin, box=((0, 0), (0.1, 0.05)))
    for interface in ("interpolated", "sharp"):
        simulation = tp.Simulation(tp.Case(tank, [glycerin, water], (0, -9.81), interface=interface), time_step=1e-3)
        assert sunk(simulation, 0.05)["sunk_particles"] == 1.0
        assert sunk(simulation, 0.05)["sunk_volume"] > 0.95
        watch = PressureWatch([(glycerin, 0.05), (water, 0.05)], 9.81, since=0.0, bins=10)
        for _ in range(3):
            simulation.step()
            assert watch(simulation) < 0.005
        height, error = watch.mean
        assert len(height) == 10
        assert np.abs(error).max() < 0.005


def test_check_finds_what_is_wrong():
    """A whole run is judged by all figures, a short one by its volumes."""
    demo = load("layer_inversion", spacing=0.01)
    assert demo.options.end_time == END_TIME
    good = {"pressure_agreement": 0.99, "sunk_particles": 0.99, "volume_error": 0.005}
    assert demo.check.missed(good, demo.options) == []
    for name, value in (("pressure_agreement", 0.98), ("sunk_particles", 0.96), ("volume_error", 0.02)):
        assert len(demo.check.missed({**good, name: value}, demo.options)) == 1
        assert demo.check.missed({**good, name: np.nan}, demo.options)[0].startswith(name)
    assert demo.check.missed({**good, "sunk_particles": 0.1}, SimpleNamespace(end_time=1.0)) == []


@pytest.mark.slow
def test_the_whole_run(tmp_path):
    """The default run passes its check, in under 15 minutes."""
    assert typed("layer_inversion.py", tmp_path / "results", "--no-frames")["wall_seconds"] < 900
