"""demos/play.py: it prints its address, runs, and says where its results are; what was done is repeated."""

from __future__ import annotations

import csv
import inspect
import math
import re
import time

import pytest
from demo_runs import python
from tipfem.demos import play

import tipfem as tp


@pytest.mark.slow
def test_play_prints_its_address_and_ends_in_good_order(tmp_path):
    words = ("--spacing", "0.1", "--port", "0", "--no-browser", "--end-time", "0.1", "--out", str(tmp_path))
    done = python("-m", "tipfem", "demo", "play", *words)
    assert done.returncode == 0, done.stderr
    assert re.search(r"^Open http://127\.0\.0\.1:\d+/#\S{20,}$", done.stdout, re.MULTILINE)
    assert f"steps to t = 0.1 s; results: {tmp_path}" in done.stdout
    assert (tmp_path / "history.csv").exists()


@pytest.mark.slow
def test_play_refuses_a_file_of_commands_that_is_not_there(tmp_path):
    done = python(
        "-m", "tipfem", "demo", "play", "--steering", str(tmp_path / "no.jsonl"), "--out", str(tmp_path / "out")
    )
    assert done.returncode == 2
    assert "cannot be read" in done.stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_what_was_played_for_long_is_kept_and_another_begins_beside_it(tmp_path):
    """A run of twenty minutes in the folder, and one that goes on in the next: the third has a folder of its own."""
    words = ("--spacing", "0.1", "--port", "0", "--no-browser", "--end-time", "0.03", "--out", str(tmp_path / "play"))
    for name in ("play", "play_2"):
        done = python("-m", "tipfem", "demo", "play", *words)
        assert done.returncode == 0, done.stderr
        assert f"results: {tmp_path / name}\n" in done.stdout
        history = tmp_path / name / "history.csv"
        *rows, last = list(csv.DictReader(history.open()))
        last["wall_seconds"] = 1200.0
        with history.open("w") as file:
            table = csv.DictWriter(file, list(last))
            table.writeheader()
            table.writerows([*rows, last])
    done = python("-m", "tipfem", "demo", "play", *words)
    assert f"results: {tmp_path / 'play_3'}\n" in done.stdout


@pytest.mark.slow
@pytest.mark.benchmark
def test_a_tank_that_swings_is_computed_in_about_real_time():
    """About 1 000 particles, no step refused; eight tenths of real time on a busy machine, in the best of ten parts."""
    asked = {name: one.default for name, one in inspect.signature(play.main).parameters.items()}
    flow = tp.Simulation(play.case(asked["spacing"], box=True), time_step=asked["time_step"])
    assert 900 < len(flow.particles) < 1100
    flow.steer(tp.Gravity((9.81 * math.sin(0.35), -9.81 * math.cos(0.35))))
    paces = []
    for _ in range(10):
        began, before = time.perf_counter(), flow.time
        flow.run(before + 10 * asked["time_step"], progress=False)
        paces.append((flow.time - before) / (time.perf_counter() - began))
    assert flow.step_number <= 105
    assert max(paces) > 0.8, paces
