"""live: run a simulation and show it, in a browser or in a notebook."""

from __future__ import annotations

import asyncio
import math
import time as clock
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from tipfem.notebook import in_notebook
from tipfem.run.liveview.control import RATE, LiveControl, describe, snapshot_of
from tipfem.run.liveview.memory import Snapshot
from tipfem.run.simulation import Simulation
from tipfem.run.steering import Command, RunControl, command_from

if TYPE_CHECKING:
    from tipfem.render.viewer.widget import View

KERNEL_RATE = 5.0  # states per second in a notebook, by default
_PAUSED = 0.05  # seconds between looks for commands during a pause in a notebook


def live(
    simulation: Simulation,
    until: float = math.inf,
    *,
    port: int | None = None,
    rate: float | None = None,
    browser: bool = True,
    paused: bool = False,
    say: Callable[[str], None] = print,
    hand: bool = False,
    again: Callable[[], Simulation] | None = None,
    pace: float | None = None,
) -> View | None:
    """Run a simulation, and show and steer it in a browser meanwhile; in a notebook, in a widget.

    A second process draws the latest state and serves the page; while nobody looks, the run is as fast as any.

    In a notebook the call returns at once, and the run goes on between cells, in the kernel itself: it takes and draws
    its steps by turns. Of the arguments, ``until``, ``rate`` and ``paused`` count there.

    Args:
        simulation: a `Simulation`; in 3-D the page shows the densest fluid, which is not pushed, dropped or tilted.
        until: time to run to [s]; by default until it is told to stop.
        port: of 127.0.0.1, where the page is served; 0 for any, None for 8800 or one of the next.
        rate: most states per second; by default 30, and 5 in a notebook, whose kernel draws them.
        browser: open a browser where there is a display; the address is always printed.
        paused: begin with a pause.
        say: takes lines of text: the address, and what becomes of the viewer.
        hand: let the pointer push the fluids at first, rather than move the picture.
        pace: most simulated seconds per second while a page looks, 1 for real time; None for as fast as it can.
        again: makes the simulation with which the run begins anew when the page says so; None for no such button.

    Returns:
        In a notebook the widget, with the same page; None elsewhere.

    Raises:
        ValueError: an argument is not possible, or the page cannot be served.
        SimulationError: see `Simulation.run`.
    """
    if in_notebook():
        run = KernelRun(simulation, until, KERNEL_RATE if rate is None else rate, paused)
        run.task = asyncio.get_running_loop().create_task(run.run())
        return run.view
    control = LiveControl(
        simulation,
        port=port,
        rate=RATE if rate is None else rate,
        browser=browser,
        paused=paused,
        say=say,
        hand=hand,
        again=again is not None,
        pace=pace,
    )
    try:
        simulation.run(until, progress=math.isfinite(until), control=control)
        while control.again and again is not None:
            simulation = again()
            control.begin_anew(simulation)
            simulation.run(until, progress=math.isfinite(until), control=control)
    finally:
        control.close()
    return None


class KernelRun:
    """A run in a notebook's kernel, and what its viewer is told of it; see `live` for arguments and errors.

    Widgets hear nothing while a cell runs, so the cell that begins the run ends at once, and the run is a ``task`` of
    the kernel's own loop, which draws and answers between its steps. ``view`` is the widget; for ``published``,
    ``wanted``, ``ended`` and ``paused`` see `tipfem.run.liveview.source.Feed`.
    """

    def __init__(self, simulation: Simulation, until: float, rate: float, paused: bool) -> None:
        from tipfem.render.viewer.widget import View
        from tipfem.run.liveview.source import LiveSource

        self._simulation, self._until, self._rate = simulation, until, rate
        self._given: deque[Command] = deque()
        self._message, self._speed = "", math.nan
        self.task: asyncio.Task[None] | None = None
        self.published, self.wanted, self.ended = 1, False, False
        self._control = RunControl(self._receive, paused=paused, report=self._tell)
        simulation.make_consistent()
        out = simulation.results.path if simulation.results else None
        self.view = View(LiveSource(describe(simulation.case, out), self, self._send, lambda: self._message))

    @property
    def paused(self) -> bool:
        """Whether the run waits."""
        return self._control.waits

    def latest(self) -> Snapshot:
        """The present state."""
        return snapshot_of(self._simulation, self._speed)

    async def run(self) -> None:
        """Take steps until the time, or until told to stop, as `Simulation.run` does."""
        simulation, shown = self._simulation, -math.inf
        steps = simulation.steps(self._until, control=self._control)
        try:
            state, forces, begun = simulation.state, simulation.forces, clock.monotonic()
            for _ in steps:
                now, steered = clock.monotonic(), simulation.forces is not forces
                stepped = simulation.state is not state
                if stepped:
                    self._speed = 1 / max(now - begun, 1e-9)
                if (stepped or steered) and (steered or self.paused or now - shown >= 1 / self._rate):
                    self.published, shown = self.published + 1, now
                await asyncio.sleep(_PAUSED if self.paused else 0)
                state, forces, begun = simulation.state, simulation.forces, clock.monotonic()
        finally:
            steps.close()
            self.published += 1
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
