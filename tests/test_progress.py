"""The progress of runs: the bar, the lines of the log, and its JSON."""

from __future__ import annotations

import io
import json
import logging
import math
import re

import pytest
from demo_runs import DEMOS

import tipfem as tp
from tipfem.app.commands import main
from tipfem.errors import StepRefused
from tipfem.logs import log_lines
from tipfem.run import progress
from tipfem.run.progress import RunProgress, StepReport, duration

CASE = str(DEMOS / "cases" / "dam_break.toml")
ROW = {
    "step": 7,
    "time": 0.25,
    "time_step": 1e-3,
    "refused_steps": 2,
    "newton_iterations": 3,
    "krylov_iterations": 12,
    "particles": 900,
    "wall_seconds": 5.0,
}


@pytest.fixture
def simulation(water, air):
    tank = tp.tank((0.4, 0.4), 0.05).fill(air).fill(water, box=((0, 0), (0.2, 0.2)))
    return tp.Simulation(tp.Case(tank, [water, air], (0, -9.81)), time_step=2e-3)


def read(path):
    return [json.loads(line) for line in path.read_text().splitlines()]


def test_a_script_without_a_terminal_has_a_line_at_the_start_and_one_at_the_end(simulation, capfd):
    simulation.run(0.004)
    said = capfd.readouterr()
    first, last = said.err.splitlines()
    assert first.startswith("81 particles of water, air; walls: ")
    assert first.endswith("run from t = 0 s, step 0, to t = 0.004 s")
    assert last == "2 steps to t = 0.004 s"
    assert said.out == ""
    simulation.run(0.006, progress=False)
    assert capfd.readouterr() == ("", "")
    with log_lines("warning"):
        simulation.run(0.008)
    assert "particles of water" not in capfd.readouterr().err


def test_the_time_left_does_not_count_the_compilation_of_the_first_steps(monkeypatch, caplog):
    now = [0.0]
    monkeypatch.setattr(progress.clock, "monotonic", lambda: now[0])
    shown = RunProgress(0.0, 1.0, enabled=False)
    with caplog.at_level(logging.DEBUG, logger="tipfem"):
        for step, wall in enumerate([30.0, 35.0, 36.0, *(36.0 + k for k in range(1, 8))], 1):
            now[0] = wall
            shown.update({**ROW, "time": 0.01 * step}, 1.0, "motion", 0.0)
    left = [record.figures["seconds_left"] for record in caplog.records if record.event == "step"]
    assert all(math.isnan(value) for value in left[:3])
    assert left[3:] == pytest.approx([100 - step for step in range(4, 11)])


def test_every_step_and_what_stopped_it_is_in_the_log(simulation, tmp_path, monkeypatch):
    path = tmp_path / "log.jsonl"
    solve, refused = simulation.solver.solve, []

    def refuse_once(*arguments, **options):
        if not refused:
            refused.append(True)
            raise StepRefused("a test")
        return solve(*arguments, **options)

    monkeypatch.setattr(simulation.solver, "solve", refuse_once)
    with tp.log_json(path):
        simulation.run(0.004)
    simulation.run(0.006)  # no longer logged
    lines = read(path)
    assert [line["event"] for line in lines[:3]] == ["begin", "refused", "step"]
    assert lines[1]["message"].endswith("is refused: a test")
    steps = [line for line in lines if line["event"] == "step"]
    assert [line["t"] for line in steps] == [row["time"] for row in simulation.history if row["time"] < 0.0041]
    assert steps[0]["refused"] == 1
    assert steps[0]["newton"] == simulation.history[0]["newton_iterations"]
    assert steps[-1]["volume_error"] < 1e-6
    assert lines[-1]["event"] == "end"
    assert lines[-1]["status"] == "complete"
    assert {line["level"] for line in lines} >= {"debug", "info"}
    assert logging.getLogger("tipfem").level == logging.NOTSET


def test_a_line_says_time_step_limit_volume_iterations_and_time_left(monkeypatch, caplog):
    now = [1000.0]
    monkeypatch.setattr(progress.clock, "monotonic", lambda: now[0])
    shown = RunProgress(0.0, 1.0)
    with caplog.at_level(logging.INFO, logger="tipfem"):
        for k in range(1, 31):
            now[0] += 1.0  # a second for 0.01 s of simulated time
            shown.update({**ROW, "time": 0.01 * k}, 1.0, "motion", 3e-9)
    assert len(caplog.messages) == 3  # every 10 s
    assert caplog.messages[-1] == (
        "t = 0.3 of 1 s, step 7, dt 1.0e-03 s (motion, 2 refused), volume error 3e-09, Newton 3, Krylov 12, "
        "0:01:10 left"
    )
    assert caplog.records[-1].figures["seconds_left"] == pytest.approx(70.0)


def test_the_time_left_follows_the_pace_of_the_last_minute(monkeypatch, caplog):
    now = [0.0]
    monkeypatch.setattr(progress.clock, "monotonic", lambda: now[0])
    shown = RunProgress(0.0, 10.0)
    time = 0.0
    with caplog.at_level(logging.DEBUG, logger="tipfem"):
        for k in range(300):
            now[0] += 1.0
            time += 0.02 if k < 150 else 0.01  # it gets slower
            shown.update({**ROW, "time": time}, 10.0, "motion", 0.0)
    left = [record.figures["seconds_left"] for record in caplog.records if record.event == "step"]
    assert left[100] == pytest.approx((10 - 2.02) / 0.02, rel=0.01)
    assert left[-1] == pytest.approx((10 - 4.5) / 0.01, rel=0.01)


@pytest.mark.parametrize("width", [60, 80, 100, 200])
def test_a_terminal_has_a_bar_the_time_left_and_what_else_there_is_room_for(simulation, monkeypatch, width):
    """Of a line that is cut nobody sees the end."""

    class Terminal(io.StringIO):
        def isatty(self):
            return True

    monkeypatch.setenv("COLUMNS", str(width))
    monkeypatch.setenv("TERM", "xterm")
    stream = Terminal()
    monkeypatch.setattr("sys.stderr", stream)
    simulation.run(0.01)
    lines = re.split(r"[\r\n]+", re.sub(r"\x1b\[[?0-9;]*[A-Za-z]", "", stream.getvalue()))
    shown = [line.rstrip() for line in lines if " %  " in line]
    assert all(len(line) <= width and "━" in line and "…" not in line for line in shown)
    parts = ("left", "of 0.01 s", "step ", "(maximum)", "volume error", "Newton", "Krylov")
    there = [part in shown[-1] for part in parts]
    assert there == sorted(there, reverse=True)
    assert sum(there) >= {60: 2, 80: 3, 100: 4, 200: 7}[width]


def test_durations_and_unknown_ones():
    assert duration(80.4) == "0:01:20"
    assert duration(math.nan) == "?"
    report = StepReport(1, 0.1, 1.0, 1e-3, "maximum", 0, 0.0, 1, 2, 3, 4.0, math.nan)
    assert str(report).endswith("? left")
    assert "refused" not in str(report)


def test_commands_print_lines_and_write_the_log(tmp_path, capfd, monkeypatch):
    monkeypatch.setattr(progress, "_LINES", 0.0)
    coarse = ["--set", "tank.spacing=0.04", "--set", "time.largest_step=1e-3"]
    words = ["run", CASE, *coarse, "--until", "0.004", "--out", str(tmp_path / "out")]
    assert main([*words, "--log-json", str(tmp_path / "log.jsonl")]) == 0
    said = capfd.readouterr()
    assert "run from t = 0 s, step 0, to t = 0.004 s" in said.err
    assert "of 0.004 s, step 1, dt 1.0e-03 s (" in said.err
    lines = read(tmp_path / "log.jsonl")
    events = [line["event"] for line in lines]
    assert events.count("step") == 4
    assert events.count("fields") == 2
    assert events.count("checkpoint") == 2
    words = ["resume", str(tmp_path / "out"), "--until", "0.006", "--no-progress"]
    assert main([*words, "--log-json", str(tmp_path / "log.jsonl")]) == 0
    assert ", step 5, " not in capfd.readouterr().err
    assert [line["step"] for line in read(tmp_path / "log.jsonl") if line["event"] == "step"] == [1, 2, 3, 4, 5, 6]


def test_a_log_that_cannot_be_written_is_refused_before_the_run(tmp_path, capfd):
    words = ["run", CASE, "--out", str(tmp_path / "out"), "--log-json", str(tmp_path / "none" / "log.jsonl")]
    assert main(words) == 2
    assert "cannot be written (No such file or directory); name another file" in capfd.readouterr().err
    assert not (tmp_path / "out").exists()
    with pytest.raises(ValueError, match="level is 'loud'; it must be one of"), tp.log_json(tmp_path / "x", "loud"):
        pass


def test_a_figure_that_is_not_finite_is_null(tmp_path):
    with tp.log_json(tmp_path / "log.jsonl"):
        progress.log(logging.INFO, "progress", "text", {"seconds_left": math.nan, "dt": 0.5})
    (line,) = read(tmp_path / "log.jsonl")
    assert line["seconds_left"] is None
    assert line["dt"] == 0.5
