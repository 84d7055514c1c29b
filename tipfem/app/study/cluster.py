"""Runs of a study on the workers of a Dask cluster, which share the file system with the command."""

from __future__ import annotations

import time
import uuid
from concurrent.futures import Future
from importlib import import_module
from pathlib import Path
from typing import Any

from tipfem.app.study.running import LOG, Outcome, outcome_of, start_process

CONNECT = 30.0  # how long the command waits for the scheduler [s]
POLL = 0.2  # of a task: how often it looks whether the study is to stop [s]


class DaskWorkers:
    """The workers of a Dask cluster; each takes as many runs at a time as it has threads of Dask's.

    A task of Dask's starts the run in a process of its own. When a worker is lost, Dask gives its task to another one,
    which goes on from the run's newest checkpoint.

    Args:
        address: of the scheduler, such as tcp://10.0.0.1:8786.
        threads: of each run.
        folder: of the study, on a file system that all workers see under this name.

    Raises:
        ValueError: Dask is not installed, the scheduler does not answer, it has no workers, or they do not see the
            folder or have another version of tipfem.
    """

    def __init__(self, address: str, threads: int, folder: Path) -> None:
        try:
            distributed: Any = import_module("distributed")
        except ImportError:
            raise ValueError("--scheduler needs Dask: pip install 'tipfem[dask]'") from None
        try:
            self._client = distributed.Client(address, timeout=CONNECT, set_as_default=False)
        except (OSError, ValueError, TimeoutError) as error:
            reason = " ".join(str(error).split()) or type(error).__name__
            raise ValueError(f"--scheduler is {address!r}, where no scheduler of Dask answers ({reason})") from None
        self._threads, self._tasks = threads, list[Any]()
        # A file says that the study is to stop; Dask itself cannot stop a task that runs.
        self._stop = folder.resolve() / f".stop-{uuid.uuid4().hex}"
        try:
            self._check(address, folder.resolve())
        except BaseException:
            self._client.close()
            raise

    def _check(self, address: str, folder: Path) -> None:
        import tipfem

        if not self._client.scheduler_info()["workers"]:
            raise ValueError(f"--scheduler is {address!r}, which has no workers yet; start some, or wait for them")
        folder.mkdir(parents=True, exist_ok=True)
        mark = folder / f".seen-{uuid.uuid4().hex}"
        mark.write_text("", encoding="utf-8")
        try:
            answers = self._client.run(look, str(mark))
        finally:
            mark.unlink()
        for worker, (version, sees) in answers.items():
            if version != tipfem.__version__:
                text = f"the worker {worker} has tipfem {version}; it must be {tipfem.__version__}, as here"
                raise ValueError(text)
            if not sees:
                text = f"the worker {worker} does not see {str(folder)!r}; the folder of the study must be on a file "
                raise ValueError(f"{text}system that all workers share")

    def submit(self, folder: Path) -> Future[Outcome]:
        """Begin a run, or go on with it, when a worker is free."""
        answer: Future[Outcome] = Future()
        key = f"{folder.name}-{uuid.uuid4().hex}"
        try:
            task = self._client.submit(run_folder, str(folder), self._threads, str(self._stop), key=key, pure=False)
        except Exception as error:  # whatever Dask raises where it has lost its scheduler
            answer.set_result(Outcome(1, f"the scheduler did not accept the run: {error}"))
            return answer
        self._tasks.append(task)
        task.add_done_callback(lambda done: answer.set_result(_outcome(done)))
        return answer

    def stop(self) -> None:
        """Stop all runs after their step and a checkpoint, and begin none."""
        waiting = [task for task in self._tasks if not task.done()]
        if waiting:
            self._stop.write_text("", encoding="utf-8")
            try:
                processing = {key for keys in self._client.processing().values() for key in keys}
                self._client.cancel([task for task in waiting if task.key not in processing])
                for task in waiting:
                    if task.key in processing:
                        task.exception()  # waits
                time.sleep(POLL)
            finally:
                self._stop.unlink(missing_ok=True)
        self._client.close()

    def abandon(self) -> None:
        """Stop all runs by a file, which stays, and wait for none."""
        self._stop.write_text("", encoding="utf-8")
        self._client.close()


def _outcome(task: Any) -> Outcome:
    """Outcome of a task of Dask's."""
    if task.status == "finished":
        code, message = task.result()
        return Outcome(code, message)
    if task.status == "cancelled":
        return Outcome(143, "not started")
    error = task.exception()
    lost = type(error).__name__ == "KilledWorker"  # its workers were lost again and again
    return Outcome(-9 if lost else 1, f"{type(error).__name__}: {error}")


def look(mark: str) -> tuple[str, bool]:
    """On a worker: the version of tipfem, and whether it sees a file."""
    import tipfem

    return tipfem.__version__, Path(mark).exists()


def run_folder(folder: str, threads: int, stop: str) -> tuple[int, str]:
    """On a worker: begin the run in a folder, or go on with it; exit code and message of its process.

    ``stop`` is the name of a file; when it is there, the run finishes its step, writes a checkpoint and ends.
    """
    log = Path(folder) / LOG
    begin = log.stat().st_size if log.exists() else 0
    process = start_process(Path(folder), threads, ())
    assert process.stdin is not None
    while process.poll() is None:
        if Path(stop).exists() and not process.stdin.closed:
            process.stdin.close()
        time.sleep(POLL)
    outcome = outcome_of(process, log, begin)
    return outcome.code, outcome.message
