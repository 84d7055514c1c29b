"""A sweep on a Dask cluster of two workers on this machine, one of which is killed on its way."""

from __future__ import annotations

import csv
import json
import os
import signal
import socket
import subprocess
import sys
from pathlib import Path

import pytest
from test_sweep import wait

from tipfem.app.application import app
from tipfem.app.study import worker
from tipfem.results.folder_lock import FolderLock

distributed = pytest.importorskip("distributed")

BASE = Path(__file__).with_name("column.toml").read_text("utf-8")
STUDY = """
case = "base.toml"
folder = "out"

[set]
time.largest_step = 1e-4
checkpoint.interval = 0.002

[[runs]]
name = "long"
time.end = 0.06

[[runs]]
name = "short"
time.end = 0.002

[[runs]]
name = "fails"
time.end = 0.002
numerics.newton_iterations = 1
numerics.newton_tolerance = 1e-14
time.largest_step = 0.1  # so that refused steps soon are too short
output.interval = 0.1

[[runs]]
name = "last"
time.end = 0.004
"""


@pytest.fixture(scope="module")
def cluster():
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=None, silence_logs=50
    ) as cluster:
        yield cluster


@pytest.fixture
def study(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "base.toml").write_text(BASE, encoding="utf-8")
    (tmp_path / "study.toml").write_text(STUDY, encoding="utf-8")
    return tmp_path


def start(cluster, folder):
    return subprocess.Popen(
        [sys.executable, "-m", "tipfem", "sweep", "study.toml", "--scheduler", cluster.scheduler_address],
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )


def parent_of(process):
    """The number of the process that has started a process."""
    return int(Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[1])


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="needs /proc")
def test_a_run_whose_worker_is_killed_goes_on_elsewhere_and_the_table_is_complete(cluster, study):
    process = start(cluster, study)
    run = study / "out" / "long"
    try:
        wait(lambda: len(list((run / "checkpoints").glob("*.h5"))) > 1, process)
        os.kill(parent_of(json.loads((run / ".lock").read_text())["process"]), signal.SIGKILL)
        said = process.communicate(timeout=300)[0]
    finally:
        process.kill()
    assert process.returncode == 1, said  # for the run that fails
    with open(study / "out" / "study.csv", newline="") as file:
        rows = {row["run"]: row for row in csv.DictReader(file)}
    assert list(rows) == ["long", "short", "fails", "last"]
    assert [row["status"] == "complete" for row in rows.values()] == [True, True, False, True]
    assert float(rows["long"]["time"]) == 0.06
    assert "the run stops at t = " in rows["fails"]["status"]
    log = (run / "log.txt").read_text()
    assert log.count("going on from t = 0") == 1
    assert log.count("going on from step ") == 1
    with open(run / "history.csv", newline="") as file:
        steps = [int(row["step"]) for row in csv.DictReader(file)]
    assert steps == list(range(1, len(steps) + 1))
    assert "(3 of 4 complete)" in said
    assert "Traceback" not in said


@pytest.mark.slow
def test_ctrl_c_stops_the_runs_in_order_and_the_same_command_goes_on(cluster, study):
    process = start(cluster, study)
    run = study / "out" / "long"
    try:
        wait(lambda: len(list((run / "checkpoints").glob("*.h5"))) > 1, process)
        process.send_signal(signal.SIGINT)
        said = process.communicate(timeout=100)[0]
    finally:
        process.kill()
    assert process.returncode == 130, said
    assert "stopped; `tipfem sweep study.toml` goes on" in said
    assert not (run / ".lock").exists()
    assert not list((study / "out").glob(".s*"))
    assert json.loads((run / "summary.json").read_text())["status"] == "ended by signal 15"
    assert app(["sweep", "study.toml", "--scheduler", cluster.scheduler_address], result_action="return_value") == 1
    assert json.loads((run / "summary.json").read_text())["status"] == "complete"
    assert "going on from step " in (run / "log.txt").read_text()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--scheduler", "tcp://127.0.0.1:1"], "where no scheduler of Dask answers"),
        (["--scheduler", "nonsense"], "where no scheduler of Dask answers"),
        (["--scheduler", "tcp://127.0.0.1:1", "--workers", "2"], "--scheduler has workers of its own"),
    ],
)
def test_a_scheduler_that_is_none_is_refused(words, message, study, capsys, monkeypatch):
    monkeypatch.setattr("tipfem.app.study.cluster.CONNECT", 0.5)
    assert app(["sweep", "study.toml", *words], result_action="return_value") == 2
    said = capsys.readouterr().err
    assert message in said
    assert not list((study).glob("out/*/case.toml"))


@pytest.mark.slow
def test_a_lock_of_a_lost_host_is_taken_over_and_one_that_beats_is_not(tmp_path, monkeypatch):
    monkeypatch.setattr(worker, "PATIENCE", 0.5)
    monkeypatch.setattr(FolderLock, "beating", False)
    path = tmp_path / ".lock"
    path.write_text(json.dumps({"host": "elsewhere", "process": 1, "beats": True}))
    worker.lock(tmp_path)
    assert json.loads(path.read_text())["host"] == socket.gethostname()
    FolderLock(tmp_path).release()

    path.write_text(json.dumps({"host": "elsewhere", "process": 1, "beats": False}))  # not of a study
    with pytest.raises(SystemExit, match="is in use by process 1 on elsewhere"):
        worker.lock(tmp_path)

    path.write_text(json.dumps({"host": "elsewhere", "process": 1, "beats": True}))
    beat = iter(range(1, 1000))
    monkeypatch.setattr(FolderLock, "last_beat", lambda self: float(next(beat)))
    with pytest.raises(SystemExit, match="is in use by process 1 on elsewhere"):
        worker.lock(tmp_path)
