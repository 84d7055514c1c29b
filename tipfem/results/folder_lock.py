"""The lock of a results folder: one run writes there at a time."""

from __future__ import annotations

import atexit
import json
import os
import socket
from contextlib import suppress
from pathlib import Path
from typing import Any

from tipfem.errors import FolderRefused

LOCK = ".lock"


class FolderLock:
    """Keeps two runs out of one folder: a file with the host and the process that writes there.

    A lock whose process has ended is taken over; so is one of this process. While ``beating``, this process renews its
    locks by `beat`, so that other hosts see when it has ended.
    """

    beating = False

    def __init__(self, folder: Path) -> None:
        self.path = folder / LOCK

    def beat(self) -> None:
        """Renew the time of the file, if it is there."""
        with suppress(OSError):
            os.utime(self.path)

    def last_beat(self) -> float | None:
        """Time [s], by the file system, at which another host's process renewed its lock; None if none does."""
        holder = self._holder()
        if holder is None or holder["host"] == socket.gethostname() or not holder["beats"]:
            return None
        try:
            return self.path.stat().st_mtime
        except OSError:
            return None

    def take(self) -> None:
        """Lock the folder; `ValueError` if another process that runs has, `OSError` if the file cannot be written."""
        own = {"host": socket.gethostname(), "process": os.getpid(), "beats": self.beating}
        try:
            with open(self.path, "x", encoding="utf-8") as file:
                json.dump(own, file)
        except FileExistsError:
            holder = self._holder()
            if holder and _is_ours(holder) and holder["beats"] == own["beats"]:
                return
            ended = holder and holder["host"] == own["host"] and _has_ended(holder["process"])
            if holder and not (ended or _is_ours(holder)):
                text = f"{str(self.path.parent)!r} is in use by process {holder['process']} on {holder['host']}; "
                text += f"name another folder, or remove {LOCK} there if that run has ended"
                raise FolderRefused(text) from None
            self._replace(own)
        atexit.register(self.release)

    def show_door(self, path: str) -> None:
        """Name the socket by which the run that holds this lock can be seen, see `tipfem.run.liveview.link.Door`."""
        if (holder := self._holder()) and _is_ours(holder):
            with suppress(OSError):
                self._replace({**holder, "door": path})

    def door(self) -> str | None:
        """The socket of a run on this host that holds the lock; None if there is none."""
        holder = self._holder()
        here = holder and holder["host"] == socket.gethostname() and not _has_ended(holder["process"])
        return holder["door"] if holder and here else None

    def release(self) -> None:
        """Unlock the folder, if this process has locked it."""
        if (holder := self._holder()) and _is_ours(holder):
            with suppress(OSError):
                self.path.unlink(missing_ok=True)

    def is_held(self) -> bool:
        """Whether a run is writing into the folder; of a run on another host, whether it has not said that it ended."""
        holder = self._holder()
        return holder is not None and not (holder["host"] == socket.gethostname() and _has_ended(holder["process"]))

    def _replace(self, content: dict[str, Any]) -> None:
        temporary = self.path.with_name(f"{LOCK}.{os.getpid()}")
        temporary.write_text(json.dumps(content), encoding="utf-8")
        os.replace(temporary, self.path)

    def _holder(self) -> dict[str, Any] | None:
        """Who has locked the folder; None for nobody, or a file that says nothing."""
        try:
            holder = json.loads(self.path.read_text(encoding="utf-8"))
            host, process, door = str(holder["host"]), _number(holder["process"]), holder.get("door")
            return {"host": host, "process": process, "beats": bool(holder.get("beats")), "door": door and str(door)}
        except (OSError, ValueError, KeyError, TypeError, RecursionError):
            return None


def _number(value: Any) -> int:
    """The number of a process; raises ValueError where there can be none of that number."""
    number = int(value)
    if not 0 < number < 2**31:
        raise ValueError(f"{number} is the number of no process")
    return number


def _is_ours(holder: dict[str, Any]) -> bool:
    """Whether this process is the holder of a lock."""
    return bool(holder["process"] == os.getpid() and holder["host"] == socket.gethostname())


def _has_ended(process: int) -> bool:
    """Whether no process of this host has that number."""
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return True
    except OSError:
        return False
    return False
