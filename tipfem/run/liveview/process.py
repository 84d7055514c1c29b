"""The process that draws and serves a run: ``python -m tipfem.run.liveview.process``, started by `LiveControl`.

It is told what it needs by a line of JSON on its standard input, which stays open as long as the run goes on, and
writes lines of JSON to a pipe: ``{"say": line}`` for the terminal, and ``{"name", "values"}`` for commands.
"""

from __future__ import annotations

import contextlib
import json
import os
import sys
import threading
from collections.abc import Mapping
from typing import Any

NICE = 5  # the run comes first


class Pipe:
    """Writes lines of JSON, and never waits.

    Args:
        descriptor: of the pipe.
    """

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        os.set_blocking(descriptor, False)

    def send(self, message: Mapping[str, Any]) -> None:
        """Write a message.

        Raises:
            ValueError: the run has not taken the earlier ones yet, or has ended.
        """
        line = json.dumps(message, allow_nan=False).encode() + b"\n"
        try:
            done = os.write(self._descriptor, line)  # whole or not at all: lines are shorter than PIPE_BUF
        except BlockingIOError:
            done = 0
        except OSError:
            raise ValueError("the run has ended") from None
        if done < len(line):
            raise ValueError("the run is busy with the commands before; try again")


class Messages:
    """Reads lines of JSON from the run, in a thread of its own; the end of them is the end of the run.

    Attributes:
        latest: the latest line about a command.
        ended: whether the run has ended.
    """

    def __init__(self) -> None:
        self.latest, self.ended = "", False

    def read(self) -> None:
        """Read until there is no more."""
        with contextlib.suppress(OSError, ValueError):
            for line in sys.stdin:
                self.latest = str(json.loads(line).get("message", ""))
        self.ended = True


def main() -> int:
    """Serve the run that standard input describes; returns the exit code."""
    line = sys.stdin.readline()
    if not line.endswith("\n"):  # the run has ended before it could say what it is
        return 0
    settings = json.loads(line)
    os.nice(NICE)
    # Read when Taichi starts: the cores are the run's.
    os.environ["TI_CPU_MAX_NUM_THREADS"] = "1"
    from tipfem.run.liveview.memory import StateMemory
    from tipfem.run.liveview.source import LiveSource

    pipe, messages = Pipe(int(settings["pipe"])), Messages()
    memory = StateMemory(int(settings["memory"]))

    class Source(LiveSource):
        @property
        def ended(self) -> bool:
            return memory.ended or messages.ended

    source = Source(
        settings["facts"],
        memory,
        lambda name, values: pipe.send({"name": name, "values": values}),
        lambda: messages.latest,
    )
    threading.Thread(target=messages.read, daemon=True).start()

    def say(line: str) -> None:
        with contextlib.suppress(ValueError):
            pipe.send({"say": line})

    from tipfem.viewer import serve

    try:
        serve([source], settings["port"], settings["browser"], say, settings["backend"])
    except (ValueError, RuntimeError) as error:
        with contextlib.suppress(ValueError):
            pipe.send({"failed": str(error)})
        return 1
    finally:
        memory.wanted = False
    return 0


if __name__ == "__main__":
    # Neither an exit of the thread that reads nor Taichi's are waited for.
    code = main()
    sys.stdout.flush()
    os._exit(code)
