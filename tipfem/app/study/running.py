"""Runs of a study in processes on this machine; `tipfem.app.study.cluster` has those on others."""

from __future__ import annotations

import os
import queue
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from tipfem.app.study.study import Run, Study
from tipfem.app.study.table import status_of
from tipfem.casefile.describing import write_case
from tipfem.results.folder_lock import FolderLock
from tipfem.results.output import CASE_FILE
from tipfem.run.checkpoint import FOLDER
from tipfem.run.steering.stop_request import StopRequest

LOG = "log.txt"
MOST_STARTS = 4  # of a run that is killed again and again
POLL = 0.1  # [s]


@dataclass(frozen=True)
class Outcome:
    """End of the process of a run."""

    code: int  # its exit code; negative: the signal that killed it
    message: str  # its error, or the last line that it said, or the signal


def start_process(folder: Path, threads: int, cores: Sequence[int]) -> subprocess.Popen[bytes]:
    """Begin, or go on with, a folder's run, in a process on ``cores`` that stops when its standard input is closed."""
    words = [sys.executable, "-m", "tipfem.app.study.worker", str(folder), "--threads", str(threads)]
    words += ["--cores", *map(str, cores)]
    with open(folder / LOG, "ab") as log:
        # A session of its own: Ctrl-C on the terminal reaches the command alone, which then stops its runs.
        return subprocess.Popen(
            words, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=log, start_new_session=True
        )


def outcome_of(process: subprocess.Popen[bytes], log: Path, begin: int) -> Outcome:
    """Wait for the end of a process of `start_process`; its log had ``begin`` bytes when it began."""
    code = process.wait()
    if process.stdin:
        process.stdin.close()
    if code < 0:
        return Outcome(code, f"killed by signal {-code}")
    lines = log.read_bytes()[begin:].decode("utf-8", "replace").splitlines()
    errors = [line for line in lines if line.startswith("error: ")]
    return Outcome(code, (errors or lines or [f"ended with exit code {code}"])[-1])


class Workers(Protocol):
    """Workers that take runs."""

    def submit(self, folder: Path) -> Future[Outcome]:
        """Begin the run in a folder, or go on with it, when a worker is free."""

    def stop(self) -> None:
        """Stop all runs after their step and a checkpoint, and begin none."""

    def abandon(self) -> None:
        """End without waiting for the runs."""


class LocalWorkers:
    """So many workers, processes on this machine, each bound to cores of its own; `ValueError` if there are too few."""

    def __init__(self, workers: int, threads: int) -> None:
        cores = usable_cores()
        if workers * threads > len(cores):
            text = f"{workers} workers of {threads} threads need {workers * threads} cores, and this process may use "
            raise ValueError(f"{text}{len(cores)}; give fewer --workers or --threads")
        self._threads, self._pool = threads, ThreadPoolExecutor(workers)
        self._cores: queue.SimpleQueue[list[int]] = queue.SimpleQueue()
        for k in range(workers):
            self._cores.put(cores[k * threads : (k + 1) * threads])
        self._running: set[subprocess.Popen[bytes]] = set()
        self._lock, self._stopping = threading.Lock(), False

    def submit(self, folder: Path) -> Future[Outcome]:
        """Begin a run, or go on with it, when a worker is free."""
        return self._pool.submit(self._run, folder)

    def _run(self, folder: Path) -> Outcome:
        cores = self._cores.get()
        try:
            with self._lock:
                if self._stopping:
                    return Outcome(143, "not started")
                log = folder / LOG
                begin = log.stat().st_size if log.exists() else 0
                process = start_process(folder, self._threads, cores)
                self._running.add(process)
            try:
                return outcome_of(process, log, begin)
            finally:
                with self._lock:
                    self._running.discard(process)
        finally:
            self._cores.put(cores)

    def stop(self) -> None:
        """Stop all runs after their step and a checkpoint, and begin none."""
        with self._lock:
            self._stopping = True
            for process in self._running:
                if process.stdin:
                    process.stdin.close()
        self._pool.shutdown(wait=True)

    def abandon(self) -> None:
        """Kill all runs, and begin none; they keep their last checkpoints."""
        with self._lock:
            self._stopping = True
            for process in self._running:
                process.kill()


def usable_cores() -> list[int]:
    """The cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return sorted(os.sched_getaffinity(0))
    return list(range(os.cpu_count() or 1))


def prepare(study: Study, *, overwrite: bool) -> None:
    """Write the case of each run into its folder; with ``overwrite`` runs of another case there are removed.

    Raises:
        ValueError: a case is refused, or a folder holds a run of another case.
    """
    for run in study.runs:
        folder = folder_of(study, run)
        try:
            case = run.file.case()
        except ValueError as error:
            raise ValueError(f"run {run.name!r}: {error}") from None
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=folder) as made:
            new = Path(made) / CASE_FILE
            write_case(new, case, run.file.end, folder=str(folder), **run.file.settings())
            there = folder / CASE_FILE
            same = there.exists() and _content(there) == _content(new)
            begun = (folder / FOLDER).exists() or (folder / "history.csv").exists()
            if begun and not same and not overwrite:
                text = f"{folder} holds a run of another case; choose another folder for the study, or say --overwrite"
                raise ValueError(text)
            if (overwrite or not same) and FolderLock(folder).is_held():
                raise ValueError(f"{folder}: a run is writing there; stop it first, or choose another folder")
            if overwrite:
                shutil.rmtree(folder / FOLDER, ignore_errors=True)
                (folder / "summary.json").unlink(missing_ok=True)
            if not same:
                for file in Path(made).iterdir():
                    os.replace(file, folder / file.name)


def folder_of(study: Study, run: Run) -> Path:
    """The folder of a run."""
    return study.folder.resolve() / run.name


def _content(path: Path) -> list[str]:
    """The lines of a case file but that of the folder, which may have been moved."""
    return [line for line in path.read_text(encoding="utf-8").splitlines() if not line.startswith("folder = ")]


@dataclass
class Sweep:
    """The runs of a study on their way.

    Args:
        study: the study, prepared.
        workers: what the runs are given to.
        said: is told in a line of each run that has ended.
        ended: is called after each run that has ended; writes the table.
    """

    study: Study
    workers: Workers
    said: Callable[[str], None]
    ended: Callable[[dict[str, str]], None]
    failures: dict[str, str] = field(default_factory=dict)  # by the name of a run, why it did not reach its end

    def run(self) -> int | None:
        """Run all runs that are not complete; returns the signal that has stopped them, or None.

        Raises:
            KeyboardInterrupt: Ctrl-C came a second time; nothing was waited for.
        """
        due = [run for run in self.study.runs if status_of(folder_of(self.study, run), run.file.end) != "complete"]
        starts = dict.fromkeys((run.name for run in due), 1)
        with StopRequest() as stop, self._abandoned_at_a_second_signal():
            pending = {run.name: (run, self.workers.submit(folder_of(self.study, run))) for run in due}
            total, complete = len(self.study.runs), len(self.study.runs) - len(due)
            while pending and stop.signal is None:
                time.sleep(POLL)
                for name, (run, task) in list(pending.items()):
                    if not task.done():
                        continue
                    try:
                        outcome = task.result()
                    except OSError as error:  # of this run: its folder is gone or full, or no process could start
                        outcome = Outcome(1, f"cannot be started or followed: {error}")
                    killed = outcome.code < 0 or outcome.code in (130, 143)
                    if killed and starts[name] < MOST_STARTS:
                        self.said(f"{name}: killed; it goes on from its checkpoint")
                        starts[name] += 1
                        pending[name] = (run, self.workers.submit(folder_of(self.study, run)))
                        continue
                    del pending[name]
                    complete += outcome.code == 0
                    if outcome.code:
                        self.failures[name] = outcome.message.removeprefix("error: ")
                    self.said(f"{name}: {self.failures.get(name, 'complete')}  ({complete} of {total} complete)")
                    self.ended(self.failures)
            self.workers.stop()
            return stop.signal

    @contextmanager
    def _abandoned_at_a_second_signal(self) -> Iterator[None]:
        try:
            yield
        except KeyboardInterrupt:
            self.workers.abandon()
            raise
