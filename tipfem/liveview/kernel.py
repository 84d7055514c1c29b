"""A running simulation in a notebook: it takes its steps in the kernel, between which the kernel draws and answers.

Widgets hear nothing while a cell runs, so the cell that begins the run ends at once, and the run is a task of the
kernel's own loop.
"""

from __future__ import annotations

import asyncio
import math
import time as clock
from collections import deque
from collections.abc import Mapping, Sequence
from typing import Any

from tipfem.liveview.control import Steps, describe, snapshot_of
from tipfem.liveview.memory import Snapshot
from tipfem.liveview.source import LiveSource
from tipfem.steering import Command, RunControl, command_from
from tipfem.viewer.widget import View

_PAUSED = 0.05  # seconds between looks for commands during a pause


class KernelRun:
    """A run in a notebook's kernel, and what its viewer is told of it.

    Args:
        simulation: in 2-D.
        until: time to run to [s].
        rate: most pictures per second.
        paused: whether it begins with a pause.

    Attributes:
        view: the widget.
        task: in which the run is, once it has begun.
        published, wanted, ended, paused: see `tipfem.liveview.source.Feed`.

    Raises:
        ValueError: the case is not in 2-D.
    """

    def __init__(self, simulation: Steps, until: float, rate: float, paused: bool) -> None:
        if simulation.case.particles.dimension != 2:
            raise ValueError("the viewer shows cases in 2-D only; this one is in 3-D")
        self._simulation, self._until, self._rate = simulation, until, rate
        self._given: deque[Command] = deque()
        self._message, self._speed = "", math.nan
        self.task: asyncio.Task[None] | None = None
        self.published, self.wanted, self.ended = 1, False, False
        self._control = RunControl(self._receive, paused=paused, report=self._tell)
        simulation.make_consistent()
        self.view = View(LiveSource(describe(simulation), self, self._send, lambda: self._message))

    @property
    def paused(self) -> bool:
        """Whether the run waits."""
        return self._control.waits

    def latest(self) -> Snapshot:
        """The present state."""
        return snapshot_of(self._simulation, self._speed)

    async def run(self) -> None:
        """Take steps until the time, or until told to stop; then write fields, a checkpoint and the summary."""
        simulation, control, shown = self._simulation, self._control, -math.inf
        status = "interrupted"
        try:
            while simulation.time < self._until and not control.stopped:
                state, forces, begun = simulation.state, simulation.forces, clock.monotonic()
                # A pause is waited for here, where the kernel goes on, and not in the control.
                goes_on = control.before_step(simulation, lambda: control.waits)
                if goes_on:
                    simulation.step(self._until)
                    self._speed = 1 / max(clock.monotonic() - begun, 1e-9)
                now = clock.monotonic()
                steered = simulation.forces is not forces
                changed = steered or simulation.state is not state
                if changed and (steered or not goes_on or now - shown >= 1 / self._rate):
                    self.published, shown = self.published + 1, now
                await asyncio.sleep(0 if goes_on else _PAUSED)
            status = "stopped by a command" if control.stopped else "complete"
        finally:
            self.published += 1
            if simulation.results:
                simulation.write_fields()
                simulation.write_checkpoint(self._until)
                simulation.write_summary({"status": status})
                simulation.results.close()
            self.ended = True

    def _send(self, name: str, values: Mapping[str, Any]) -> None:
        self._given.append(command_from(name, values))

    def _receive(self, _: float) -> Sequence[Command]:
        found = list(self._given)
        self._given.clear()
        if found:
            self._message = ""
        return found

    def _tell(self, message: str) -> None:
        self._message = message
