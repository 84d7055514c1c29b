"""The process of one run of a study: goes on with the run in a folder, and stops when its parent has ended.

    python -m tipfem.app.study.worker FOLDER --threads 1 --cores 0 1

Its standard input is a pipe whose other end the parent holds and never writes to. When it is closed, because the parent
has been killed or wants to stop, the run finishes its step and writes a checkpoint.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from pathlib import Path
from typing import Annotated

from cyclopts import App, Parameter

from tipfem.app.commands import call
from tipfem.app.options import Shown
from tipfem.app.running import resume
from tipfem.results.folder_lock import FolderLock

PATIENCE = 60.0  # how long a run that is about to stop may still hold the folder [s]
BEAT = 5.0  # time between renewals of the lock [s]


def main(
    folder: Path, /, *, threads: int = 1, cores: Annotated[tuple[int, ...], Parameter(consume_multiple=True)] = ()
) -> int:
    """Go on with one run of a study; returns the exit code of `tipfem resume`."""
    if cores and hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, cores)
    threading.Thread(target=_stop_with_the_parent, daemon=True).start()
    lock(folder)
    threading.Thread(target=_beat, args=(folder,), daemon=True).start()
    return resume(folder, threads=threads, shown=Shown(progress=False))


def _stop_with_the_parent() -> None:
    while os.read(0, 1):  # not sys.stdin, whose lock this thread would still hold when the interpreter ends
        pass
    os.kill(os.getpid(), signal.SIGTERM)


def _beat(folder: Path) -> None:
    while True:
        time.sleep(BEAT)
        FolderLock(folder).beat()


def lock(folder: Path) -> None:
    """Lock the folder; a run whose parent has just been killed may hold it until it has stopped.

    A lock of a worker on another host that has not renewed it in the meantime is taken over: that host is lost.
    `SystemExit` if the folder is in use.
    """
    FolderLock.beating = True
    held, end = FolderLock(folder), time.monotonic() + PATIENCE
    beat = held.last_beat()
    while True:
        try:
            held.take()
            return
        except ValueError as error:
            if time.monotonic() > end:
                if beat is None or held.last_beat() != beat:
                    raise SystemExit(f"error: {error}") from None
                held.path.unlink(missing_ok=True)
            time.sleep(0.2)


if __name__ == "__main__":
    app = App()
    app.default(main)
    sys.exit(call(app))
