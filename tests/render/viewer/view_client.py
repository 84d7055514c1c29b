"""A viewer in a process of its own, as `tipfem view` starts it, and how a page talks to it."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import time
from contextlib import ExitStack
from typing import Any, NamedTuple

from tipfem.render.viewer import protocol
from websockets.sync.client import connect

PATIENCE = 240.0  # longest wait for an answer, which only a fault or a very busy machine makes as long [s]
TIMES = tuple(0.1 * k for k in range(12))


class Server(NamedTuple):
    """A viewer that runs: its process, where it is, and what it shows."""

    process: subprocess.Popen
    address: str
    port: int
    token: str
    out: Any


def start(*folders, port=0):
    """Start the command, and wait for its address."""
    words = [sys.executable, "-m", "tipfem", "view", *map(str, folders), "--port", str(port), "--no-browser"]
    process = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    line = process.stdout.readline()
    found = re.fullmatch(r"Open (http://127\.0\.0\.1:(\d+)/#(\S+))\n", line)
    assert found, line + process.stderr.read()
    return Server(process, found[1], int(found[2]), found[3], folders[0])


class Page:
    """What a page does, without the page: messages there and back."""

    def __init__(self, server, token=None, origin=None):
        address = f"ws://127.0.0.1:{server.port}/socket?token={server.token if token is None else token}"
        origin = f"http://127.0.0.1:{server.port}" if origin is None else origin
        self._open = ExitStack()
        self.socket = self._open.enter_context(connect(address, origin=origin, max_size=None, compression=None))
        self.frames = []
        self.status = {}

    def send(self, kind, **content):
        """Send a message."""
        self.socket.send(json.dumps({"type": kind, **content}))

    def receive(self, timeout=PATIENCE):
        """The next message: its JSON, with the bytes that follow it; frames and the status are kept."""
        data = self.socket.recv(timeout=timeout)
        message, rest = (json.loads(data), b"") if isinstance(data, str) else protocol.unpack(data)
        if message["type"] == "frame":
            self.frames.append(message)
        if message["type"] == "status":
            self.status = message
        return message, rest

    def until(self, kind, wanted=lambda message: True, acks=True, timeout=PATIENCE):
        """The next message of a type that is as wanted; frames on the way are acknowledged."""
        end = time.monotonic() + timeout
        while True:
            message, rest = self.receive(max(end - time.monotonic(), 0.0))
            if acks and message["type"] == "frame":
                self.send("ack", frame=message["frame"])
            if message["type"] == kind and wanted(message):
                return message, rest

    def until_status(self, wanted, timeout=PATIENCE):
        """Wait for a status that is as wanted; it may be the latest that has come."""
        if not (self.status and wanted(self.status)):
            self.until("status", wanted, timeout=timeout)

    def quiet(self, seconds=0.4):
        """Take what comes until nothing does."""
        taken = []
        while True:
            try:
                taken.append(self.receive(seconds)[0])
            except TimeoutError:
                return taken

    def close(self):
        """Go away as pages do."""
        self._open.close()
