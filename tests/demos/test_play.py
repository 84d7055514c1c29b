"""demos/play.py: it prints its address, runs, and says where its results are; what was done is repeated."""

from __future__ import annotations

import re

from demo_runs import python


def test_play_prints_its_address_and_ends_in_good_order(tmp_path):
    words = ("--spacing", "0.1", "--port", "0", "--no-browser", "--end-time", "0.1", "--out", str(tmp_path))
    done = python("-m", "tipfem", "demo", "play", *words)
    assert done.returncode == 0, done.stderr
    assert re.search(r"^Open http://127\.0\.0\.1:\d+/#\S{20,}$", done.stdout, re.MULTILINE)
    assert f"steps to t = 0.1 s; results: {tmp_path}" in done.stdout
    assert (tmp_path / "history.csv").exists()


def test_play_refuses_a_file_of_commands_that_is_not_there(tmp_path):
    done = python(
        "-m", "tipfem", "demo", "play", "--steering", str(tmp_path / "no.jsonl"), "--out", str(tmp_path / "out")
    )
    assert done.returncode == 2
    assert "cannot be read" in done.stderr
    assert not (tmp_path / "out").exists()
