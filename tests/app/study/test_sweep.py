"""A sweep with local workers: one run fails, one is killed on its way; the same command again."""

from __future__ import annotations

import contextlib
import csv
import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path

import pytest

from tipfem.app.application import app
from tipfem.app.study.running import LocalWorkers, Outcome, Sweep, usable_cores
from tipfem.app.study.study import load_study
from tipfem.app.study.table import figures_of, status_of

# Water alone, under a free surface: each process of a run has fewer kernels to make ready.
BASE = """
gravity = [0, -9.81]
free_surface = true

[fluids.water]
density = 998.2
viscosity = 1e-3

[tank]
size = [0.4, 0.4]
spacing = 0.08

[[fill]]
fluid = "water"
box = [[0, 0], [0.16, 0.24]]

[time]
end = 0.01
largest_step = 0.002

[output]
interval = 0.01
"""
STUDY = """
case = "base.toml"
folder = "out"

[set]
time.end = 0.03
time.largest_step = 1e-4
checkpoint.interval = 0.002

[[runs]]
name = "killed"
fluids.water.viscosity = 1e-2

[[runs]]
name = "fails"
numerics.newton_iterations = 1
numerics.newton_tolerance = 1e-14
time.largest_step = 0.1  # so that refused steps soon are too short
output.interval = 0.1
"""


def table(folder: Path) -> list[dict[str, str]]:
    with open(folder / "study.csv", encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def has_gone_on(run: Path) -> bool:
    """Whether it has a checkpoint besides that of the start."""
    return len(list((run / "checkpoints").glob("*.h5"))) > 1


def wait(reached: Callable[[], bool], process: subprocess.Popen[str]) -> None:
    """Until something is reached, while the process lives, for 200 s at most."""
    end = time.monotonic() + 200
    while not reached():
        assert process.poll() is None, process.communicate()[0]
        assert time.monotonic() < end
        time.sleep(0.005)


@pytest.fixture(scope="module")
def swept(tmp_path_factory):
    """The folder, the exit code and what the command printed; the first run's process was killed once."""
    folder = tmp_path_factory.mktemp("sweep")
    (folder / "base.toml").write_text(BASE, encoding="utf-8")
    (folder / "study.toml").write_text(STUDY, encoding="utf-8")
    words = ["sweep", "study.toml", "--workers", str(min(2, len(usable_cores())))]
    process = subprocess.Popen(
        [sys.executable, "-m", "tipfem", *words],
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    try:
        run = folder / "out" / "killed"
        wait(lambda: has_gone_on(run), process)
        os.kill(json.loads((run / ".lock").read_text())["process"], signal.SIGKILL)
        said = process.communicate(timeout=200)[0]
    finally:
        process.kill()
    return folder, process.returncode, said


@pytest.mark.slow
def test_one_failed_run_is_one_failed_row(swept):
    folder, code, said = swept
    rows = {row["run"]: row for row in table(folder / "out")}
    assert code == 1, said
    assert {name: row["status"] == "complete" for name, row in rows.items()} == {"killed": True, "fails": False}
    assert "the run stops at t = " in rows["fails"]["status"]
    assert "error: the run stops at t = " in (folder / "out" / "fails" / "log.txt").read_text()
    assert float(rows["killed"]["time"]) == 0.03
    assert rows["killed"]["fluids.water.viscosity"] == "0.01"
    assert rows["fails"]["fluids.water.viscosity"] == ""
    assert int(rows["killed"]["last.step"]) == int(rows["killed"]["steps"]) >= 300
    assert "(1 of 2 complete)" in said
    assert "Traceback" not in said


def test_a_killed_run_goes_on_from_its_checkpoint(swept):
    folder, _, said = swept
    assert said.count("killed: killed; it goes on from its checkpoint") == 1
    log = (folder / "out" / "killed" / "log.txt").read_text()
    assert "going on from t = 0" in log
    assert "going on from step " in log
    with open(folder / "out" / "killed" / "history.csv", newline="") as file:
        steps = [int(row["step"]) for row in csv.DictReader(file)]
    assert steps == list(range(steps[0], steps[0] + len(steps)))
    assert len(steps) >= 300


def test_the_table_is_a_parquet_file_too(swept):
    pandas, _ = pytest.importorskip("pandas"), pytest.importorskip("pyarrow")
    folder = swept[0] / "out"
    read = pandas.read_parquet(folder / "study.parquet")
    assert list(read["run"]) == [row["run"] for row in table(folder)]
    assert read["time"][0] == 0.03


def test_the_same_command_again_leaves_out_complete_runs(swept, monkeypatch, capsys):
    folder = swept[0]
    monkeypatch.chdir(folder)
    before = table(folder / "out")
    started = []

    def submit(self: LocalWorkers, run: Path) -> Future[Outcome]:
        started.append(run.name)
        task: Future[Outcome] = Future()
        task.set_result(Outcome(1, "error: as before"))
        return task

    monkeypatch.setattr(LocalWorkers, "submit", submit)
    assert app(["sweep", "study.toml", "--workers", "1"], result_action="return_value") == 1
    assert started == ["fails"]
    assert "fails: as before  (1 of 2 complete)" in capsys.readouterr().out
    after = table(folder / "out")
    assert [row["status"] for row in after] == ["complete", "as before"]
    assert after[0] == before[0]


INTERRUPTED = """
case = "base.toml"
folder = "out"

[set]
time.largest_step = 1e-4

[[runs]]
name = "finished"
time.end = 2e-4

[[runs]]
name = "running"
time.end = 0.04
checkpoint.interval = 1e-3

[[runs]]
name = "waiting"
time.end = 2e-4
"""


# A process started in the background ignores SIGINT; one on a terminal has Python's own handler.
ON_A_TERMINAL = """
import signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)
sys.argv[0] = "tipfem"
from tipfem.app.main import main
main()
"""


@pytest.mark.slow
def test_ctrl_c_keeps_what_is_done_and_the_same_command_goes_on(tmp_path):
    (tmp_path / "base.toml").write_text(BASE, encoding="utf-8")
    (tmp_path / "study.toml").write_text(INTERRUPTED, encoding="utf-8")
    words = [sys.executable, "-c", ON_A_TERMINAL, "sweep", "study.toml", "--workers", "1"]
    process = subprocess.Popen(words, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    out = tmp_path / "out"
    try:
        wait(lambda: has_gone_on(out / "running"), process)
        process.send_signal(signal.SIGINT)
        said = process.communicate(timeout=200)[0]
    finally:
        process.kill()
    assert process.returncode == 130, said
    assert "stopped; `tipfem sweep study.toml` goes on" in said
    assert "Traceback" not in said
    rows = table(out)
    assert [row["status"] for row in rows] == ["complete", "ended by signal 15", "not started"]
    assert not (out / "waiting" / "history.csv").exists()
    assert not (out / "running" / ".lock").exists()
    stopped = json.loads((out / "running" / "summary.json").read_text())
    assert 0 < stopped["steps"] < 400
    assert (out / "running" / "checkpoints" / f"step_{stopped['steps']:09d}.h5").exists()
    kept = (out / "finished" / "summary.json").read_bytes()

    done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stdout + done.stderr
    assert [row["status"] for row in table(out)] == ["complete"] * 3
    assert f"going on from step {stopped['steps']}, " in (out / "running" / "log.txt").read_text()
    with open(out / "running" / "history.csv", newline="") as file:
        steps = [int(row["step"]) for row in csv.DictReader(file)]
    assert steps == list(range(1, len(steps) + 1))
    assert (out / "finished" / "summary.json").read_bytes() == kept


def is_told_to_end(run: int, sweep: int) -> bool:
    """Whether a sweep has closed the pipe to a run, by which it asks it to end."""
    pipe = os.readlink(f"/proc/{run}/fd/0")
    assert pipe.startswith("pipe:")
    kept = []
    for path in Path(f"/proc/{sweep}/fd").iterdir():
        with contextlib.suppress(FileNotFoundError):  # closed meanwhile
            kept.append(os.readlink(path))
    return pipe not in kept


def has_ended(process: int) -> bool:
    """Whether a process is gone, or waits for its parent to ask how it ended."""
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] == "Z"
    except FileNotFoundError:
        return True


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/fd").exists(), reason="open files are read in /proc")
def test_a_second_ctrl_c_kills_the_runs(tmp_path):
    """The run is stopped, so that it cannot end by itself between the two."""
    (tmp_path / "base.toml").write_text(BASE, encoding="utf-8")
    endless = INTERRUPTED.replace("time.end = 2e-4", "time.end = 100")
    (tmp_path / "study.toml").write_text(endless, encoding="utf-8")
    words = [sys.executable, "-c", ON_A_TERMINAL, "sweep", "study.toml", "--workers", "1"]
    process = subprocess.Popen(words, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    run, worker = tmp_path / "out" / "finished", 0
    try:
        wait((run / "checkpoints" / "step_000000000.h5").exists, process)
        worker = json.loads((run / ".lock").read_text())["process"]
        os.kill(worker, signal.SIGSTOP)
        process.send_signal(signal.SIGINT)
        wait(lambda: is_told_to_end(worker, process.pid), process)
        process.send_signal(signal.SIGINT)
        said = process.communicate(timeout=200)[0]
        assert process.returncode == 130, said
        assert "stopped at once; `tipfem sweep study.toml` goes on from the last checkpoints" in said
        assert "Traceback" not in said
        end = time.monotonic() + 60
        while not has_ended(worker):
            assert time.monotonic() < end, "the run goes on"
            time.sleep(0.005)
    finally:
        process.kill()
        if worker:
            with contextlib.suppress(ProcessLookupError):
                os.kill(worker, signal.SIGKILL)


def test_overwriting_leaves_the_files_of_a_run_that_another_process_writes(tmp_path, capsys):
    (tmp_path / "base.toml").write_text(BASE, encoding="utf-8")
    (tmp_path / "study.toml").write_text(STUDY, encoding="utf-8")
    run = tmp_path / "out" / "killed"
    (run / "checkpoints").mkdir(parents=True)
    held = {
        ".lock": json.dumps({"host": socket.gethostname(), "process": os.getppid()}),
        "checkpoints/step_000000000.h5": "of that process",
        "summary.json": "{}",
    }
    for name, text in held.items():
        (run / name).write_text(text, encoding="utf-8")
    with contextlib.chdir(tmp_path):
        assert app(["sweep", "study.toml", "--overwrite"], result_action="return_value") == 2
    assert "a run is writing there" in capsys.readouterr().err
    assert {name: (run / name).read_text(encoding="utf-8") for name in held} == held


def test_an_error_of_the_disk_in_one_run_is_one_failed_row(tmp_path, monkeypatch):
    """The other runs go on, and the table is written."""

    class Workers:
        def submit(self, folder):
            done = Future()
            if folder.name == "fails":
                done.set_exception(OSError(28, "No space left on device"))
            else:
                done.set_result(Outcome(0, ""))
            return done

        def stop(self):
            pass

    (tmp_path / "base.toml").write_text(BASE, encoding="utf-8")
    (tmp_path / "study.toml").write_text(STUDY, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    told, rows = [], []
    sweep = Sweep(load_study(Path("study.toml")), Workers(), told.append, lambda failures: rows.append(dict(failures)))
    assert sweep.run() is None
    assert list(sweep.failures) == ["fails"]
    assert "No space left on device" in sweep.failures["fails"]
    assert len(told) == len(rows) == len(sweep.study.runs)


@pytest.mark.parametrize(
    "summary",
    [
        {"status": "complete", "time": None},
        {"status": "complete", "time": "0.03"},
        {"status": "complete", "time": 0.0, "validation": [1]},
        {"status": ["x"], "validation": "none"},
        [1],
    ],
)
def test_a_summary_that_says_nothing_is_that_of_a_run_that_is_not_complete(tmp_path, summary):
    (tmp_path / "summary.json").write_text(json.dumps(summary))
    assert status_of(tmp_path, 0.03) != "complete"
    assert not any(key.startswith("figure.") for key in figures_of(tmp_path))


def test_a_table_that_cannot_be_written_is_told_after_the_runs(tmp_path, monkeypatch, capsys):
    (tmp_path / "base.toml").write_text(BASE, encoding="utf-8")
    (tmp_path / "study.toml").write_text(
        'case = "base.toml"\nfolder = "o"\n[grid]\ntime.end = [1e-4]\n', encoding="utf-8"
    )
    monkeypatch.chdir(tmp_path)
    (tmp_path / "o" / "study.csv").mkdir(parents=True)
    monkeypatch.setattr(Sweep, "run", lambda sweep: sweep.ended({}))
    assert app(["sweep", "study.toml", "--workers", "1"], result_action="return_value") == 1
    said = capsys.readouterr()
    assert "note: the table cannot be written: " in said.out
    assert "error: the table of the runs, which have ended, cannot be written: " in said.err


def test_a_log_that_is_a_folder_is_one_failed_row(tmp_path, monkeypatch):
    (tmp_path / "base.toml").write_text(BASE, encoding="utf-8")
    (tmp_path / "study.toml").write_text(
        'case = "base.toml"\nfolder = "o"\n[grid]\ntime.end = [1e-4]\n', encoding="utf-8"
    )
    monkeypatch.chdir(tmp_path)
    (tmp_path / "o" / "end=0.0001" / "log.txt").mkdir(parents=True)
    sweep = Sweep(load_study(Path("study.toml")), LocalWorkers(1, 1), lambda line: None, lambda failures: None)
    sweep.run()
    assert "Is a directory" in sweep.failures["end=0.0001"]
