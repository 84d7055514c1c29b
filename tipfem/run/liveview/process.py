"""The process that draws and serves a run.

`LiveControl` starts it as ``python -m tipfem.run.liveview.process`` with the number of its end of the line;
`tipfem view` becomes one by knocking at the run's door. What is said between the two is in `tipfem.run.liveview.link`:
``{"say": line}`` for the terminal, ``{"address"}`` of the page, ``{"failed": why}``, and commands as
``{"name", "values"}``; from the run, ``{"message"}`` about a command.
"""

from __future__ import annotations

import contextlib
import os
import socket
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tipfem.results.folder_lock import FolderLock
from tipfem.run.liveview.link import Link, knock, take_over

NICE = 5  # the run comes first


def guest_of(folder: Path) -> socket.socket | None:
    """A connection with the run that is writing into a results folder; None if there is none on this machine."""
    door = FolderLock(folder).door()
    return None if door is None else knock(door)


def serve_guest(end: socket.socket, port: int | None, browser: bool, say: Callable[[str], None]) -> None:
    """Serve the run that a connection leads to, see `guest_of`, until it ends; say where it is shown if it is already.

    See `tipfem.render.viewer.serve` for the other arguments; `ValueError` if the run has ended, or it cannot be served.
    """
    link, told, memory = take_over(end)
    if memory is None:
        link.close()
        if not told["shown"]:
            raise ValueError("another viewer of this run is just starting; try again")
        say(f"Open {told['shown']}")
        return

    def hear(line: str) -> None:
        if line.startswith("Open "):
            link.send({"address": line.removeprefix("Open ")})
        say(line)

    serve_run(link, told["facts"], memory, {"port": port, "browser": browser, "backend": "raster"}, hear)


def serve_run(
    link: Link, facts: dict[str, Any], descriptor: int, settings: dict[str, Any], say: Callable[[str], None]
) -> None:
    """Serve a run until it ends, by a link to it, facts of its case, and the descriptor of its memory.

    ``settings`` has ``port``, ``browser`` and ``backend``, see `tipfem.render.viewer.serve`, also for errors; ``say``
    takes lines of text.
    """
    os.nice(NICE)
    # Read when Taichi starts: the cores are the run's.
    os.environ["TI_CPU_MAX_NUM_THREADS"] = "1"
    from tipfem.render.viewer import serve
    from tipfem.run.liveview.memory import StateMemory
    from tipfem.run.liveview.source import LiveSource

    memory, latest = StateMemory(descriptor), [""]

    def messages() -> str:
        for line in link.read():
            latest.append(str(line.get("message", "")))
        del latest[:-1]
        return latest[0]

    class Source(LiveSource):
        @property
        def ended(self) -> bool:
            return memory.ended or link.closed

    source = Source(facts, memory, lambda name, values: link.send({"name": name, "values": values}), messages)
    try:
        serve([source], settings["port"], settings["browser"], say, settings["backend"])
    finally:
        memory.wanted = False


def main() -> int:
    """Serve the run at the other end of the socket whose number is given; returns the exit code."""
    try:
        link, told, memory = take_over(socket.socket(fileno=int(sys.argv[1])))
    except (ValueError, OSError):  # the run has ended before it could say what it is
        return 0
    assert memory is not None, "the run that started this process shares its states"

    def tell(**line: str) -> None:
        with contextlib.suppress(ValueError):
            link.send(line)

    try:
        serve_run(link, told["facts"], memory, told, lambda line: tell(say=line))
    except (ValueError, RuntimeError) as error:
        tell(failed=str(error))
        return 1
    return 0


if __name__ == "__main__":
    code = main()
    sys.stdout.flush()
    os._exit(code)  # Taichi's exit is not waited for
