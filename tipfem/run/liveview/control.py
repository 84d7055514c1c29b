"""LiveControl: publishes a running simulation to the process that draws it, and takes the commands from there."""

from __future__ import annotations

import contextlib
import importlib.util
import json
import math
import os
import select
import subprocess
import sys
import time as clock
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tipfem.arguments import is_number
from tipfem.case.case import Case
from tipfem.case.forces import Forces
from tipfem.case.outline import tank_outline, tank_pose
from tipfem.physics.bodies.motion import BodyStates
from tipfem.physics.state import State
from tipfem.run.liveview.memory import Snapshot, StateMemory, slot_size
from tipfem.steering import Command, Gravity, Poke, Release, RunControl, command_from, limits
from tipfem.steering.stop_request import StopRequest
from tipfem.step.stepper import Row, Stepper

RATE = 5.0  # pictures per second, by default
STARTS = 60.0  # longest wait for the process that draws [s]; with a cold cache Taichi compiles for a while
_MOST = 65536  # bytes that are taken between two steps; the rest wait in the pipe
_LONGEST = 4096  # bytes of a line from the process that draws
_MEAN = 1.0  # seconds over which steps per second are taken


class LiveControl(RunControl):
    """Shows a run while it goes on, and lets it be steered; give it to `Simulation.run` as ``control``.

    Args:
        simulation: in 2-D.
        out: its results folder, or None.
        port: of 127.0.0.1, where the page is served; 0 for any, None for 8800 or one of the next.
        rate: most pictures per second.
        browser: open a browser where there is a display.
        paused: whether the run begins with a pause.
        backend: of the pictures, see `tipfem.render.Renderer`.
        say: takes lines of text: the address, and what becomes of the process.

    Attributes:
        address: of the page, with its token; "" while there is none.

    Raises:
        ValueError: an argument is not possible, the case is not in 2-D, or the process cannot serve a page.
    """

    def __init__(
        self,
        simulation: Stepper,
        *,
        out: Path | None = None,
        port: int | None = None,
        rate: float = RATE,
        browser: bool = True,
        paused: bool = False,
        backend: str = "raster",
        say: Callable[[str], None] = print,
    ) -> None:
        super().__init__(self._receive_commands, paused=paused, report=self._tell)
        if simulation.case.particles.dimension != 2:
            raise ValueError("the viewer shows cases in 2-D only; this one is in 3-D")
        if not (is_number(rate) and 0 < rate <= 60):
            raise ValueError(f"rate is {rate!r}; it must be a number of pictures per second, at most 60")
        if port is not None and not (isinstance(port, int) and 0 <= port <= 65535):
            raise ValueError(f"port is {port!r}; it must be a whole number from 0 to 65535")
        if importlib.util.find_spec("websockets") is None:
            raise ValueError("the viewer needs websockets, which is not installed: pip install 'tipfem[view]'")
        self.address = ""
        self._say, self._rate = say, float(rate)
        self._rest, self._failed = b"", ""
        self._published: tuple[State, Forces] | None = None
        self._when, self._prompt = -math.inf, False
        self._steps: list[tuple[float, int]] = []
        simulation.make_consistent()
        state, bodies = simulation.state, len(simulation.case.bodies) + 1
        # Room for twice the particles, so that drops do not move the memory.
        self._memory = StateMemory(room=slot_size(2 * len(state.particles), 2 * len(state.mesh.cells), bodies))
        self._memory.paused = paused
        self._publish(simulation)
        settings = {"facts": describe(simulation.case, out), "port": port, "browser": browser}
        with StopRequest() as request:  # obeyed only once the process is known: none is left behind
            self._process: subprocess.Popen[bytes] | None = self._start({**settings, "backend": backend})
            try:
                self._wait_for_address(request)
            except BaseException:  # also when the process is told to end
                if self._process is not None:
                    self._process.kill()
                self.close()
                raise

    # What a run calls

    def ready(self, flow: Stepper, steer: Callable[[Command], None]) -> bool:
        """See `RunControl.ready`; a poke that nobody is left to release is released."""
        goes_on = super().ready(flow, steer)
        self._memory.paused = self.waits
        poke = flow.forces.poke
        if self._process is None and poke is not None and math.isinf(poke.end):
            steer(Release())
        return goes_on

    def after_step(self, flow: Stepper, row: Row) -> None:
        """Publish the state if somebody looks and it is time."""
        now, step = clock.monotonic(), flow.state.step
        self._steps.append((now, step))
        while now - self._steps[0][0] > _MEAN and len(self._steps) > 2:
            self._steps.pop(0)
        self._publish_if_due(flow, now)

    def idle(self, flow: Stepper) -> None:
        """Publish what a command has changed during a pause."""
        self._memory.paused = True
        self._steps.clear()
        if self._process is None:  # nobody is left to let it go on
            self.paused = False
        self._publish_if_due(flow, clock.monotonic())

    def finish(self, flow: Stepper, until: float) -> None:
        """Publish the last state, and end the process."""
        if self._process is not None and self._memory.wanted:
            self._publish(flow)
        self.close()

    def close(self) -> None:
        """End the process that draws."""
        process, self._process = self._process, None
        if process is None:
            return
        self._memory.ended = True
        assert process.stdin is not None
        with contextlib.suppress(OSError):
            process.stdin.close()
        try:
            process.wait(5)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        os.close(self._pipe)
        self._memory.close()

    # The states

    def _publish_if_due(self, simulation: Stepper, now: float) -> None:
        if self._process is None or not self._memory.wanted:
            return
        changed = self._published is None or self._published != (simulation.state, simulation.forces)
        if changed and (self._prompt or now - self._when >= 1 / self._rate):
            self._publish(simulation)

    def _publish(self, simulation: Stepper) -> None:
        self._memory.publish(snapshot_of(simulation, self._speed()))
        state, forces = simulation.state, simulation.forces
        self._published, self._when, self._prompt = (state, forces), clock.monotonic(), False

    def _speed(self) -> float:
        """Steps per second of late; NaN before there are two."""
        if len(self._steps) < 2:
            return math.nan
        (start, first), (end, last) = self._steps[0], self._steps[-1]
        return (last - first) / max(end - start, 1e-9)

    # The process

    def _start(self, settings: dict[str, Any]) -> subprocess.Popen[bytes]:
        self._pipe, theirs = os.pipe()
        os.set_blocking(self._pipe, False)
        try:
            process = subprocess.Popen(
                [sys.executable, "-m", "tipfem.run.liveview.process"],
                stdin=subprocess.PIPE,
                pass_fds=(theirs, self._memory.descriptor),
                start_new_session=True,  # Ctrl-C is for the run, which ends the process in good order
            )
        finally:
            os.close(theirs)
        assert process.stdin is not None
        line = json.dumps({**settings, "pipe": theirs, "memory": self._memory.descriptor})
        process.stdin.write(line.encode() + b"\n")
        process.stdin.flush()
        os.set_blocking(process.stdin.fileno(), False)
        return process

    def _wait_for_address(self, request: StopRequest) -> None:
        """Wait until the page is served.

        Raises:
            KeyboardInterrupt: Ctrl-C.
            SystemExit: the run was told to end by another signal.
            ValueError: the process has ended, or takes too long.
        """
        end = clock.monotonic() + STARTS
        while not self.address and self._process is not None and clock.monotonic() < end:
            request.obey()
            self._read(0.1)
        request.obey()
        if self.address:
            return
        why = self._failed or f"the process that draws did not begin within {STARTS:g} s"
        raise ValueError(f"the run cannot be shown: {why}")

    def _receive_commands(self, wait: float) -> Sequence[Command]:
        found: list[Command] = []
        for line in self._read(wait):
            try:
                command = command_from(str(line["name"]), dict(line["values"]))
                if found and type(command) is type(found[-1]) and isinstance(command, Gravity | Poke):
                    found.pop()  # of a pointer that was moved in one step, the last place counts
                found.append(command)
            except (KeyError, TypeError, ValueError) as error:
                self._tell(str(error))
        if found:
            self._prompt = True
            self._tell("")
        return found

    def _read(self, wait: float) -> list[dict[str, Any]]:
        """The lines with commands that have come; those for the terminal are said."""
        if self._process is None:
            if wait:
                clock.sleep(wait)
            return []
        if not select.select([self._pipe], [], [], wait)[0]:
            return []
        try:
            read = os.read(self._pipe, _MOST)
        except BlockingIOError:
            return []
        if not read:
            self._lost()
            return []
        *lines, self._rest = (self._rest + read).split(b"\n")
        self._rest = self._rest[:_LONGEST]
        found = []
        for text in lines:
            try:
                line = json.loads(text)
            except ValueError:
                continue
            if not isinstance(line, dict):
                continue
            if "say" in line:
                self._hear(str(line["say"]))
            elif "failed" in line:
                self._failed = str(line["failed"])
            else:
                found.append(line)
        return found

    def _hear(self, line: str) -> None:
        if line.startswith("Open "):
            self.address = line.removeprefix("Open ")
        self._say(line)

    def _lost(self) -> None:
        """The process has ended before the run, which goes on."""
        process, self._process = self._process, None
        assert process is not None
        process.wait()
        os.close(self._pipe)
        self._memory.close()
        self.paused = False
        if self.address:
            self._say(f"the viewer has ended{f': {self._failed}' if self._failed else ''}; the run goes on")

    def _tell(self, message: str) -> None:
        """Let the page show a line about a command; left out if the process does not take it."""
        if self._process is not None and self._process.stdin is not None:
            with contextlib.suppress(OSError):
                os.write(self._process.stdin.fileno(), json.dumps({"message": message}).encode() + b"\n")


def snapshot_of(simulation: Stepper, speed: float) -> Snapshot:
    """The present state as it is drawn; it shares the arrays.

    Args:
        simulation: in 2-D.
        speed: steps per second by the clock.
    """
    state, forces = simulation.state, simulation.forces
    particles, mesh = state.particles, state.mesh
    gravity = simulation.case.gravity if forces.gravity is None else forces.gravity
    bodies = state.part(BodyStates)
    return Snapshot(
        step=state.step,
        time=state.time,
        gravity=(float(gravity[0]), float(gravity[1])),
        speed=speed,
        poked=forces.pokes(state.time),
        position=particles.position,
        velocity=particles.velocity,
        pressure=particles.pressure,
        fluid=particles.fluid,
        wall=particles.wall,
        cells=mesh.cells,
        cell_fluid=mesh.fluid,
        bodies=np.vstack([*([] if bodies is None else [bodies.position]), tank_pose(simulation.case, state.time)]),
    )


def describe(case: Case, out: Path | None) -> dict[str, Any]:
    """What a `LiveSource` needs to know of a case and its results folder, as JSON."""
    return {
        "name": out.resolve().name if out else "run",
        "folder": str(out) if out else None,
        "title": case.title,
        "fluid_names": [fluid.name for fluid in case.fluids],
        "fluid_densities": [float(fluid.density) for fluid in case.fluids],
        "spacing": float(case.particles.spacing),
        "lower": case.box[0].tolist(),
        "upper": case.box[1].tolist(),
        "period": case.period.width.tolist() if case.period else None,
        "limits": limits(case),
        "bodies": [{"corners": body.corners.tolist(), "reference": body.reference.tolist()} for body in case.bodies],
        "tank": tank_outline(case),
    }
