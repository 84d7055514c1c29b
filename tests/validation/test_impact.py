"""demos/validation/impact/run.py: figures of pressure histories, and a coarse run up to the impact."""

from __future__ import annotations

import json
import math

import imageio.v3 as iio
import numpy as np
import pytest
from tipfem.demos.validation.impact import run as study

from tipfem.app import application as commands


def test_the_running_mean_is_that_of_lines_between_samples():
    time = np.sort(np.random.default_rng(1).uniform(0.0, 4.0, 400))
    flat = study.integral(time, np.full(400, 3.0))
    np.testing.assert_allclose(study.running_mean(time, flat), 3.0, rtol=1e-12)
    inside = (time > 0.1) & (time < 3.9)
    slope = study.integral(time, 2 * time)
    np.testing.assert_allclose(study.running_mean(time, slope)[inside], 2 * time[inside], atol=0.02)


def test_figures_are_found_in_a_history_made_of_them():
    time = np.linspace(0.0, 6.0, 6001)
    ripple = 0.05 * np.sin(2 * np.pi * time / 0.02)  # its mean over the length of the running mean is zero
    pressure = np.where(time > 2.5, 0.5, 0.0) + np.where(time > 2.5, ripple, 0.0)
    found = study.figures_of(time, pressure, study.integral(time, pressure))
    assert found["arrival"] == pytest.approx(2.5, abs=0.02)
    assert found["peak"] == pytest.approx(0.5, abs=1e-2)
    assert found["impulse"] == pytest.approx(0.5, abs=1e-2)
    assert found["plateau"] == pytest.approx(0.5, abs=1e-3)
    assert found["noise"] == pytest.approx(0.05 / math.sqrt(2), rel=0.02)
    assert study.missed(found, {"arrival": 2.5, "plateau": 0.5}) == []
    lines = study.missed(found, {"arrival": 2.0, "plateau": 0.3})
    assert len(lines) == 2
    assert lines[0].startswith("arrival is 2.49, +25 %")
    dry = {"arrival": math.nan, "plateau": math.nan}
    assert len(study.missed(dry, {"arrival": 2.5, "plateau": 0.5})) == 2
    assert len(study.missed(dry, {"arrival": 2.5, "plateau": 0.5}, end=3.0)) == 1
    assert study.missed(dry, {"arrival": 2.5, "plateau": 0.5}, end=2.5) == []
    mean, deviation = study.spread_of([found, {**found, "plateau": 0.6}])["plateau"]
    assert (mean, deviation) == pytest.approx((0.55, 0.1 / math.sqrt(2)), abs=1e-3)


def test_the_experiment_is_what_buchner_measured():
    time, pressure = study.experiment()
    found = study.figures_of(time, pressure, study.integral(time, pressure))
    assert found["arrival"] == pytest.approx(2.55, abs=0.06)
    assert found["plateau"] == pytest.approx(0.54, abs=0.01)


@pytest.mark.slow
def test_energy_of_a_dam_break_without_viscosity_never_rises():
    """10 mm, walls that slip, through the impact at 0.26 s: no step adds 1e-6 of the potential energy at the start."""
    water, air = study.tp.Fluid("water", 998.2, 0.0), study.tp.Fluid("air", 1.204, 0.0)
    tank = study.tp.tank((0.584, 0.584), 0.01, jitter=0.001, seed=1)
    tank.fill(air).fill(water, box=((0, 0), (0.146, 0.292)))
    for side in ("left", "right", "bottom", "top"):
        tank.wall(side, slip=True)
    case = study.tp.Case(tank, [water, air], (0, -9.81), numerics=study.tp.Numerics(largest_move=0.8))
    simulation = study.tp.Simulation(case, time_step=1.2e-3)
    while simulation.time < 0.285:
        simulation.step()
    history = simulation.history
    energy = np.array([row["kinetic_energy"] + row["potential_energy"] for row in history])
    assert np.diff(energy).max() < 1e-6 * history[0]["potential_energy"]
    assert energy[-1] > 0.95 * energy[0]
    assert 1 <= sum(row["impact"] for row in history) <= 0.1 * len(history)
    assert max(row["impact"] for row in history if row["time"] < 0.24) == 0


@pytest.mark.slow
def test_a_coarse_run_reaches_the_wall_and_measures_nothing_before(tmp_path, capsys):
    assert commands.demo("validation/impact", "--across", "10", "--end-time", "2.95", "--out", str(tmp_path)) == 0
    gauge = study.scaled(study.tp.read_results(tmp_path / "10"))["pressure"]
    assert np.abs(gauge.pressure[gauge.time < 2.3]).max() < 0.05
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary["figures"]["H / 10"]["arrival"] == pytest.approx(summary["experiment"]["arrival"], rel=0.12)
    assert math.isnan(summary["figures"]["H / 10"]["plateau"])
    for picture in ("pressure.png", "corner.png"):
        assert iio.imread(tmp_path / picture).std() > 5
    assert "check: " in capsys.readouterr().out
