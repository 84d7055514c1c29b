"""live: run a simulation and show it."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Protocol

from tipfem.liveview.control import RATE, LiveControl, Steps
from tipfem.notebook import in_notebook
from tipfem.steering import RunControl

if TYPE_CHECKING:
    from tipfem.viewer.widget import View


class Run(Steps, Protocol):
    """A simulation that can be shown and run; see `tipfem.Simulation`."""

    def run(self, until: float, *, progress: bool = True, control: RunControl | None = None) -> None:
        """Step until a time [s]."""


def live(
    simulation: Run,
    until: float = math.inf,
    *,
    port: int | None = None,
    rate: float = RATE,
    browser: bool = True,
    paused: bool = False,
    native: bool = False,
    say: Callable[[str], None] = print,
) -> View | None:
    """Run a simulation, and show and steer it in a browser meanwhile; in a notebook, in a widget.

    A second process draws the latest state and serves the page; while nobody looks, the run is as fast as any.

    In a notebook the call returns at once, and the run goes on between cells, in the kernel itself: it takes and draws
    its steps by turns. Of the arguments, ``until``, ``rate`` and ``paused`` count there.

    Args:
        simulation: a `Simulation`, in 2-D.
        until: time to run to [s]; by default until it is told to stop.
        port: of 127.0.0.1, where the page is served; 0 for any, None for 8800 or one of the next.
        rate: most pictures per second.
        browser: open a browser where there is a display; the address is said in either case.
        paused: begin with a pause.
        native: show it in a window of its own, not in a browser; needs a display.
        say: takes lines of text: the address, and what becomes of the viewer.

    Returns:
        In a notebook the widget, with the same page; None elsewhere.

    Raises:
        ValueError: an argument is not possible, the case is not in 2-D, or the page cannot be served.
        SimulationError: see `Simulation.run`.
    """
    if in_notebook() and not native:
        from tipfem.liveview.kernel import KernelRun

        run = KernelRun(simulation, until, rate, paused)
        run.task = asyncio.get_running_loop().create_task(run.run())
        return run.view
    control = LiveControl(simulation, port=port, rate=rate, browser=browser, paused=paused, native=native, say=say)
    try:
        simulation.run(until, progress=math.isfinite(until), control=control)
    finally:
        control.close()
    return None
