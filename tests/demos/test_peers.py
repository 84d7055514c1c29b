"""demos/benchmarks/peers.py: what it compares, and what it says where interFoam is better, or missing."""

from __future__ import annotations

import csv
import json
import math
import shutil

import imageio.v3 as iio
import numpy as np
import pytest
from tipfem.demos.benchmarks import interfoam, peers
from tipfem.demos.validation.openings import water
from tipfem.demos.validation.waves import run as waves

from tipfem.app import application as commands


def wave_of(cells, height):
    """interFoam's wave at the start, of a height [m]."""
    size, fraction = (waves.LENGTH, waves.LENGTH), peers.wave_fraction(cells, height)
    return interfoam.Flow(size, (cells, cells), (waves.FLOWS["water"][0], waves.AIR), fraction, True, 1.0, 0.1)


def test_without_interfoam_one_sentence_says_what_to_install(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(shutil, "which", lambda name: None)
    assert commands.demo("benchmarks/peers", "--out", str(tmp_path / "out")) == 2
    said = capsys.readouterr().err
    assert said.startswith(f"error: {interfoam.MISSING}")
    assert len(said.splitlines()) == 1
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("cells", [10, 40])
def test_the_amplitude_of_fractions_is_that_of_the_wave(cells):
    flow = wave_of(cells, 0.005)
    assert interfoam.mode(flow, flow.fraction) == pytest.approx(0.005 * (1 - (math.pi / cells) ** 2 / 12), rel=1e-3)
    assert flow.fraction.mean() == pytest.approx(0.5, rel=1e-12)


@pytest.mark.parametrize("cells", [30, 58, 116])
def test_the_column_has_its_width_and_height(cells):
    fraction = peers.column_fraction(cells)
    h = 0.584 / cells
    assert fraction.sum() * h**2 == pytest.approx(0.146 * 0.292, rel=1e-12)
    flow = interfoam.Flow((0.584, 0.584), (cells, cells), (waves.AIR, waves.AIR), fraction, False, 1.0, 0.1)
    assert interfoam.front(flow, fraction) == pytest.approx(0.146, abs=0.5 * h)


@pytest.mark.slow
def test_a_wave_of_theory_has_no_error():
    lower, amplitude = waves.FLOWS["water"]
    theory = waves.StandingWave(waves.LENGTH, waves.LENGTH / 2, waves.GRAVITY)
    course = theory.course(2 * waves.LENGTH * amplitude, 2.1 * waves.period(lower))
    found = peers.wave_figures(course)
    assert found["amplitude"] < 1e-3  # viscosity's, of two periods
    assert found["period"] < 2e-3  # that of the air
    assert peers.wave_figures(course * [1.05, 1.0])["period"] == pytest.approx(0.05, abs=3e-3)
    assert peers.wave_figures(course * [1.0, 0.9])["amplitude"] == pytest.approx(0.1, abs=2e-3)


def test_what_interfoam_does_better_is_said(tmp_path):
    one = {"flow": "dam_break", "resolution": "5 mm", "code": "interFoam", "code_version": "1912"}
    rows = [
        {**one, "seconds": 4.0, "steps": 200, "front_rms": 0.02, "shift": -0.2},
        {**one, "code": "tipfem", "code_version": "1", "seconds": 10.0, "steps": 300, "front_rms": 0.03, "shift": -0.2},
    ]
    assert peers.better(rows) == [
        "dam break, 5 mm: interFoam takes 2.5 times less processor time.",
        "dam break, 5 mm: interFoam's front is off by 2.00%, that of tipfem by 3.00%.",
    ]
    swapped = [{**rows[1], "code": "interFoam"}, {**rows[0], "code": "tipfem"}]
    assert peers.better(swapped) == ["interFoam is better in none of these figures."]
    for _ in range(2):  # a second version's figures are added
        peers.keep(tmp_path / "figures.csv", rows, "a command", "1234567")
    with (tmp_path / "figures.csv").open(encoding="utf-8", newline="") as file:
        kept = list(csv.DictReader(file))
    assert len(kept) == 16
    assert {row["command"] for row in kept} == {"a command"}
    assert {row["value"] for row in kept if row["figure"] == "seconds"} == {"4", "10"}


def test_the_kept_figures_name_their_commit_and_command():
    with (peers.Path(peers.__file__).with_name("figures.csv")).open(encoding="utf-8", newline="") as file:
        kept = list(csv.DictReader(file))
    assert {row["code"] for row in kept} == set(peers.CODES)
    assert tuple(kept[0]) == peers.KEPT
    assert all(len(row["commit"]) >= 7 and row["command"].startswith("tipfem demo ") for row in kept)
    assert all(np.isfinite(float(row["value"])) for row in kept)


@pytest.mark.skipif(shutil.which("interFoam") is None, reason="OpenFOAM is not installed")
def test_both_codes_run_in_turns(tmp_path):
    words = ["--only", "wave", "dam_break", "--across", "10", "--spacing", "0.03", "--periods", "1", "--rounds", "1"]
    assert commands.demo("benchmarks/peers", *words, "--out", str(tmp_path)) == 0
    rows = json.loads((tmp_path / "summary.json").read_text())["figures"]
    assert [(row["flow"], row["code"]) for row in rows] == [(f, c) for f in ("wave", "dam_break") for c in peers.CODES]
    assert all(row["seconds"] > 0 and row["steps"] > 50 for row in rows)
    assert all(row["amplitude"] < 0.1 and row["period"] < 0.05 for row in rows[:2])
    assert all(row["front_rms"] < 0.06 for row in rows[2:])
    for name in ("peers.png", "time.png"):
        assert iio.imread(tmp_path / name).std() > 5


@pytest.mark.parametrize("broad", [False, True])
def test_the_channel_of_a_weir_is_meshed_without_gaps(broad):
    blocks, fraction = peers.weir_blocks(6, broad)
    sizes = [nx * ny for _, (nx, ny) in blocks.cells]
    assert len(fraction) == sum(sizes)
    corners, _ = water.weir_outline(broad)
    behind = (corners[-3][0] - water.CREST - broad * water.BROAD) * (water.HIGH - water.FLOOR)
    area = corners[-3][0] * (water.ROOF - water.HIGH) + water.CREST * water.HIGH + behind
    assert sum(sizes) * 0.01**2 == pytest.approx(area, rel=1e-9)
    assert fraction.sum() * 0.01**2 == pytest.approx(water.CREST * (water.HIGH + water.ABOVE), rel=1e-9)
    hull = [*blocks.walls(), *(edge for edges in blocks.patches.values() for edge in edges)]
    # Every corner is left as often as it is come to: the hull is closed. From its edges follows its area.
    assert sorted(a for a, _ in hull) == sorted(b for _, b in hull)
    assert 0.5 * sum(ax * by - ay * bx for (ax, ay), (bx, by) in hull) == pytest.approx(area, rel=1e-9)


def test_the_error_of_a_weir_is_that_of_the_depth_over_it():
    expected = water.weir_figures(0.16, 0.02, False)["expected"]
    exact = expected * 2 / 3 * math.sqrt(2 * water.G) * 0.06**1.5
    assert peers.weir_errors(0.16, exact, False)["head"] < 1e-12
    # 2 % less flows over the weir with the same depth: the depth is 4 / 3 % too large for what flows.
    assert peers.weir_errors(0.16, 0.98 * exact, False)["head"] == pytest.approx(0.0135, abs=1e-4)


@pytest.mark.skipif(shutil.which("interFoam") is None, reason="OpenFOAM is not installed")
@pytest.mark.parametrize("broad", [False, True])
def test_interfoams_weir_begins_to_run_over(tmp_path, monkeypatch, broad):
    monkeypatch.setattr(peers, "WEIR_END", 0.2)
    found = peers.interfoam_weir(6, broad, tmp_path)
    # The water stands as high above the crest as it will, and begins to run over like that of a dam break.
    assert found["coefficient"] == pytest.approx(found["expected"], rel=0.3)
    assert found["steps"] > 50


@pytest.mark.slow
def test_water_runs_over_a_sharp_weir_in_tipfem(monkeypatch):
    monkeypatch.setattr(peers, "WEIR_END", 1.2)  # of which the first half fills the pool behind the weir
    found = peers.tipfem_weir(6, False)
    assert found["coefficient"] == pytest.approx(found["expected"], rel=0.1)
    assert found["steps"] > 200
