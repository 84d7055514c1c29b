"""The line between a run and the process that draws it, and the door at which such a process knocks.

Both ends write lines of JSON to a Unix socket and never wait. The run's first line says what is drawn, and brings the
descriptor of the memory with the states. A run with a results folder has a door: a socket in a folder of the user
alone, which the lock of the results folder names, so that `tipfem view` finds it.
"""

from __future__ import annotations

import contextlib
import json
import os
import select
import shutil
import socket
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

_MOST = 65536  # bytes that are taken at a time; the rest wait
_LONGEST = 4096  # bytes of a line to the run
_UNSENT = 65536  # bytes that may wait for the other end


class Link:
    """One end of the line, by a socket, which it closes; ``closed`` when that or the other end has gone."""

    def __init__(self, end: socket.socket) -> None:
        end.setblocking(False)
        self._socket, self._come, self._unsent = end, b"", b""
        self.closed = False

    def fileno(self) -> int:
        """Descriptor of the socket, for `select`."""
        return self._socket.fileno()

    def send(self, message: Mapping[str, Any]) -> None:
        """Write a line; `ValueError` if the other end has gone, or has not taken the earlier lines yet."""
        line = json.dumps(message, allow_nan=False).encode() + b"\n"
        if not self.closed and len(self._unsent) + len(line) > _UNSENT:
            self._push()
        if self.closed:
            raise ValueError("the run has ended")
        if len(self._unsent) + len(line) > _UNSENT:
            raise ValueError("the run is busy with earlier commands; try again")
        self._unsent += line
        self._push()

    def _push(self) -> None:
        try:
            while self._unsent:
                self._unsent = self._unsent[self._socket.send(self._unsent) :]
        except BlockingIOError:
            pass
        except OSError:
            self.closed = True

    def read(self, wait: float | None = 0.0) -> list[dict[str, Any]]:
        """The lines that have come within ``wait`` [s], None until one comes; what is no line of JSON is left out."""
        if self.closed:
            return []
        if self._unsent:
            self._push()
        try:
            if not select.select([self._socket], [], [], wait)[0]:
                return []
            come = self._socket.recv(_MOST)
        except BlockingIOError:
            return []
        except (OSError, ValueError):  # closed meanwhile
            come = b""
        if not come:
            self.closed = True
            return []
        *lines, self._come = (self._come + come).split(b"\n")
        if len(self._come) > _LONGEST:
            self._come = b""
        found = []
        for text in lines:
            with contextlib.suppress(ValueError, RecursionError):
                line = json.loads(text)
                if isinstance(line, dict):
                    found.append(line)
        return found

    def close(self) -> None:
        """Close this end."""
        self.closed = True
        self._socket.close()


def hand_over(end: socket.socket, facts: Mapping[str, Any], descriptor: int | None) -> Link:
    """The run's end of a line whose other end has been told what is drawn; `OSError` if that has gone.

    ``facts`` are of `tipfem.run.liveview.control.describe`, and what else the process is to know; ``descriptor`` is of
    the memory with the states, None for a process that is not to have it.
    """
    text = json.dumps(facts).encode() + b"\n"
    end.settimeout(5.0)
    sent = socket.send_fds(end, [text], [] if descriptor is None else [descriptor])
    end.sendall(text[sent:])
    return Link(end)


def take_over(end: socket.socket) -> tuple[Link, dict[str, Any], int | None]:
    """The other end: what the run tells, and the memory's descriptor or None; `ValueError` if the run has ended."""
    end.setblocking(True)
    text, descriptor = b"", None
    while not text.endswith(b"\n"):
        come, given, _, _ = socket.recv_fds(end, _MOST, 1)
        if not come:
            raise ValueError("the run has ended")
        text, descriptor = text + come, given[0] if given else descriptor
    return Link(end), json.loads(text), descriptor


class Door:
    """A socket at ``path``, in a folder of this user alone, where its processes knock to see a run; or `OSError`."""

    def __init__(self) -> None:
        self._folder = tempfile.mkdtemp(prefix="tipfem-run-")
        self.path = str(Path(self._folder) / "door")
        self._owner = os.getpid()
        self._socket = socket.socket(socket.AF_UNIX)
        try:
            self._socket.bind(self.path)
            self._socket.listen(4)
            self._socket.setblocking(False)
        except OSError:
            self.close()
            raise

    def fileno(self) -> int:
        """Descriptor of the socket, for `select`."""
        return self._socket.fileno()

    def guest(self) -> socket.socket | None:
        """A process that has knocked, connected; None while there is none."""
        try:
            return self._socket.accept()[0]
        except OSError:
            return None

    def close(self) -> None:
        """Close the door, and remove it."""
        self._socket.close()
        if os.getpid() == self._owner:  # not in a process that was forked from the run's
            shutil.rmtree(self._folder, ignore_errors=True)


def knock(path: str) -> socket.socket | None:
    """Connect with the run behind a door; None if nobody is there."""
    end = socket.socket(socket.AF_UNIX)
    try:
        end.connect(path)
    except OSError:
        end.close()
        return None
    return end
