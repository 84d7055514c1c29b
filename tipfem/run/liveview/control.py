"""WatchedControl publishes a run to the process that draws it, and takes its commands; LiveControl starts one."""

from __future__ import annotations

import contextlib
import importlib.util
import math
import socket
import subprocess
import sys
import time as clock
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tipfem.arguments import is_number
from tipfem.case.case import Case
from tipfem.case.fluid import law_table, typical_viscosity
from tipfem.case.forces import Forces
from tipfem.case.outline import tank_pose
from tipfem.case.rheology import Law
from tipfem.casefile.record import case_facts, steered
from tipfem.physics.state import State
from tipfem.run.liveview.link import Door, Link, hand_over
from tipfem.run.liveview.memory import Snapshot, StateMemory
from tipfem.run.recorded_flow import RecordedFlow
from tipfem.run.steering import (
    Command,
    Gravity,
    Poke,
    Release,
    RunControl,
    Viscosity,
    command_from,
    limits,
    steered_walls,
    tensions,
)
from tipfem.run.steering.stop_request import StopRequest
from tipfem.step.stepper import Row, Stepper

RATE = 30.0  # states per second, by default; pages move evenly from one to the next
STARTS = 60.0  # longest wait for the process that draws [s]; with a cold cache Taichi compiles for a while
_STROKE, _UNDONE = 1.0, 30  # seconds between commands of one stroke; how many can be undone
_LATE = 0.2  # seconds that a run which was too slow makes up for
_MEAN = 1.0  # seconds over which steps per second are taken


class WatchedControl(RunControl):
    """Lets a run be seen and steered by processes that draw it: those that it starts, and those that knock.

    A run with a results folder has a door for `tipfem view`, see `tipfem.run.liveview.link`. One process draws it at a
    time. While nobody looks, it costs a call to the system per step. ``address`` is that of the page, with its token;
    "" while there is none. See `tipfem.live` for the arguments.
    """

    def __init__(
        self,
        simulation: RecordedFlow,
        *,
        rate: float = RATE,
        paused: bool = False,
        say: Callable[[str], None] = lambda _: None,
        pace: float | None = None,
    ) -> None:
        super().__init__(self._receive_commands, paused=paused, report=self._tell)
        self.address = ""
        self._simulation, self._say, self._rate = simulation, say, float(rate)
        self._door: Door | None = None
        self._link: Link | None = None
        self._memory: StateMemory | None = None
        self._process: subprocess.Popen[bytes] | None = None
        self._failed, self._left = "", False
        self._published: tuple[State, Forces] | None = None
        self._when, self._prompt = -math.inf, False
        self._steps: list[tuple[float, int, float]] = []
        # By the kind of the command and when it came: what there was before.
        self._kept: deque[tuple[type[Command], float, Mapping[str, Any]]] = deque(maxlen=_UNDONE)
        self._pace, self._next = pace, -math.inf  # when the next step may be taken

    # What a run calls

    def begin(self, flow: Stepper, until: float) -> None:
        """Open the door."""
        results = self._simulation.results
        if results is None or self._door is not None or not hasattr(socket, "AF_UNIX"):
            return
        with contextlib.suppress(OSError):  # a run that cannot be seen goes on
            self._door = Door()
            results.show_door(self._door.path)

    def ready(self, flow: Stepper, steer: Callable[[Command], None]) -> bool:
        """See `RunControl.ready`; a poke that nobody is left to release is released."""
        guest = self._door.guest() if self._door is not None else None
        if guest is not None:
            self._welcome(guest)
        goes_on = super().ready(flow, lambda command: self._steer(steer, command))
        if self._memory is not None:
            self._memory.paused = self.waits
        poke = flow.forces.poke
        if self._left and poke is not None and math.isinf(poke.end):
            steer(Release())
        self._left = False
        return goes_on

    def after_step(self, flow: Stepper, row: Row) -> None:
        """Publish the state if somebody looks and it is time."""
        if self._link is None:
            return
        now, state = clock.monotonic(), flow.state
        if self._pace is not None:
            self._next = max(self._next, now - _LATE) + row["time_step"] / self._pace
        self._steps.append((now, state.step, state.time))
        while now - self._steps[0][0] > _MEAN and len(self._steps) > 2:
            self._steps.pop(0)
        self._publish_if_due(now)

    def go_back(self) -> None:
        """Undo the last command, or the last stroke of the pointer or of gravity; see `RunControl.go_back`."""
        if not self._kept:
            raise ValueError("undo: there is nothing to undo")
        _, _, kept = self._kept.pop()
        self._simulation.go_back(kept)
        if self._door is not None and self._simulation.results is not None:
            self._simulation.results.show_door(self._door.path)
        self._steps.clear()
        self._prompt = True

    def _steer(self, steer: Callable[[Command], None], command: Command) -> None:
        """Keep the state for `go_back`, and carry out a command; what follows closely is a part of the same stroke."""
        now, last = clock.monotonic(), self._kept[-1] if self._kept else None
        if isinstance(command, Release) or (
            last and isinstance(command, last[0]) and command.strokes and now - last[1] < _STROKE
        ):
            if last:
                self._kept[-1] = last[0], now, last[2]
            steer(command)
            return
        kept = self._simulation.kept()
        steer(command)
        self._kept.append((type(command), now, kept))

    def delay(self) -> float:
        """See `RunControl.delay`."""
        watched = self._memory is not None and self._memory.wanted
        return max(0.0, self._next - clock.monotonic()) if watched else 0.0

    def idle(self, flow: Stepper) -> None:
        """Publish what a command has changed during a pause."""
        self._steps.clear()
        if self._memory is None:  # nobody is left to let it go on
            self.paused = False
            return
        self._memory.paused = True
        self._publish_if_due(clock.monotonic())

    def finish(self, flow: Stepper, until: float) -> None:
        """Publish the last state, and end the process, unless the run is to begin anew."""
        if self._memory is not None and self._memory.wanted:
            self._publish()
        if not self.again:
            self.close()

    def close(self) -> None:
        """Close the door, and end the process that draws."""
        if self._door is not None:
            self._door.close()
            self._door = None
        if self._memory is not None:
            self._memory.ended = True
        self._let_go()
        process, self._process = self._process, None
        if process is not None:
            try:
                process.wait(5)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()

    def begin_anew(self, simulation: RecordedFlow) -> None:
        """Show another simulation of the same case, at its start, after a run ended for that; the page stays."""
        self._simulation, self._published, self._prompt = simulation, None, True
        self.stopped, self.again, self.paused = False, False, False
        self._steps.clear()
        self._kept.clear()
        if self._door is not None:
            self._door.close()
            self._door = None

    # The states

    def _publish_if_due(self, now: float) -> None:
        if self._memory is None or not self._memory.wanted:
            return
        present = self._simulation.state, self._simulation.forces
        # States are told apart by what they are, not by their arrays.
        changed = self._published is None or any(a is not b for a, b in zip(self._published, present, strict=True))
        if changed and (self._prompt or now - self._when >= 1 / self._rate):
            self._publish()

    def _publish(self) -> None:
        assert self._memory is not None, "the callers have asked"
        self._memory.publish(snapshot_of(self._simulation, *self._speed()))
        self._published = self._simulation.state, self._simulation.forces
        self._when, self._prompt = clock.monotonic(), False

    def _speed(self) -> tuple[float, float]:
        """Steps, and simulated seconds, per second of late; NaN before there are two steps."""
        if len(self._steps) < 2:
            return math.nan, math.nan
        (start, first, then), (end, last, now) = self._steps[0], self._steps[-1]
        passed = max(end - start, 1e-9)
        return (last - first) / passed, (now - then) / passed

    # The process that draws

    def _welcome(self, guest: socket.socket) -> None:
        """Connect a process that asks to draw the run, or send it the address where the run is shown already."""
        with contextlib.suppress(OSError):
            if self._link is None:
                self._connect(guest, {})
            else:
                hand_over(guest, {"shown": self.address}, None).close()

    def _connect(self, end: socket.socket, settings: Mapping[str, Any]) -> None:
        """Share the states with the process at the other end; `OSError` if it has gone."""
        case, self._memory = self._simulation.case, StateMemory()
        self._memory.paused = self.waits
        self._publish()
        results = self._simulation.results
        facts = {**describe(case, results.path if results else None), "undo": True}
        try:
            told = {"facts": {**facts, **settings}, **settings}
            self._link = hand_over(end, told, self._memory.descriptor)
        except OSError:
            self._let_go()
            end.close()
            raise

    def _let_go(self) -> None:
        """End the line to the process."""
        if self._link is not None:
            self._link.close()
        if self._memory is not None:
            self._memory.close()
        self._link, self._memory, self._published, self.address = None, None, None, ""

    def _lost(self) -> None:
        """The process has ended before the run, which goes on."""
        shown = bool(self.address)
        self._let_go()
        process, self._process = self._process, None
        if process is not None:
            process.wait()
        self.paused, self._left = False, True
        if shown:
            self._say(f"the viewer has ended{f': {self._failed}' if self._failed else ''}; the run goes on")

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
        if self._link is None:
            if wait:
                clock.sleep(wait)
            return []
        found = []
        for line in self._link.read(wait):
            if "say" in line:
                if (text := str(line["say"])).startswith("Open "):
                    self.address = text.removeprefix("Open ")
                self._say(text)
            elif "address" in line:
                self.address = str(line["address"])
            elif "failed" in line:
                self._failed = str(line["failed"])
            else:
                found.append(line)
        if self._link.closed:
            self._lost()
        return found

    def _tell(self, message: str) -> None:
        """Show a line about a command on the page; left out if the process does not take it."""
        if self._link is not None:
            with contextlib.suppress(ValueError):
                self._link.send({"message": message})


class LiveControl(WatchedControl):
    """Shows a run while it goes on, and lets it be steered; give it to `Simulation.run` as ``control``.

    See `tipfem.live` for the arguments and errors; ``backend`` is of the pictures, see `tipfem.render.Renderer`, and
    ``again`` whether the run can begin anew.
    """

    def __init__(
        self,
        simulation: RecordedFlow,
        *,
        port: int | None = None,
        rate: float = RATE,
        browser: bool = True,
        paused: bool = False,
        backend: str = "raster",
        say: Callable[[str], None] = print,
        hand: bool = False,
        again: bool = False,
        pace: float | None = None,
    ) -> None:
        if pace is not None and not (is_number(pace) and pace > 0):
            raise ValueError(f"pace is {pace!r}; it must be a number of simulated seconds per second, above 0, or None")
        if not (is_number(rate) and 0 < rate <= 60):
            raise ValueError(f"rate is {rate!r}; it must be a number of states per second, at most 60")
        if port is not None and not (isinstance(port, int) and 0 <= port <= 65535):
            raise ValueError(f"port is {port!r}; it must be a whole number from 0 to 65535")
        if importlib.util.find_spec("websockets") is None:
            raise ValueError("the viewer needs websockets, which is not installed: pip install 'tipfem[view]'")
        super().__init__(simulation, rate=rate, paused=paused, say=say, pace=pace)
        simulation.make_consistent()
        ours, theirs = socket.socketpair()
        with StopRequest() as request:  # obeyed only once the process is known: none is left behind
            try:
                with theirs:
                    self._process = subprocess.Popen(
                        [sys.executable, "-m", "tipfem.run.liveview.process", str(theirs.fileno())],
                        pass_fds=(theirs.fileno(),),
                        start_new_session=True,  # Ctrl-C is for the run, which ends the process in good order
                    )
                settings = {"port": port, "browser": browser, "backend": backend, "hand": hand, "again": again}
                self._connect(ours, settings)
                self._wait_for_address(request)
            except BaseException:  # also when the process is told to end
                if self._process is not None:
                    self._process.kill()
                self.close()
                raise

    def _wait_for_address(self, request: StopRequest) -> None:
        """Wait until the page is served; `ValueError` if the process has ended, or takes too long."""
        end = clock.monotonic() + STARTS
        while not self.address and self._process is not None and clock.monotonic() < end:
            request.obey()
            self._read(0.1)
        request.obey()
        if self.address:
            return
        why = self._failed or f"the process that draws did not begin within {STARTS:g} s"
        raise ValueError(f"the run cannot be shown: {why}")


def snapshot_of(simulation: Stepper, speed: float, pace: float = math.nan) -> Snapshot:
    """The present state as it is drawn; it shares the arrays. ``speed`` [steps/s], ``pace`` [simulated s/s]."""
    state, forces = simulation.state, simulation.forces
    particles, mesh = state.particles, state.mesh
    gravity = simulation.case.gravity if forces.gravity is None else forces.gravity
    laws, tank = law_table(forces.fluids(simulation.case)), tank_pose(simulation.case, state.time)
    return Snapshot(
        step=state.step,
        time=state.time,
        gravity=tuple(map(float, gravity)),
        speed=speed,
        pace=pace,
        position=particles.position,
        velocity=particles.velocity,
        pressure=particles.pressure,
        fluid=particles.fluid,
        wall=particles.wall,
        cells=mesh.cells,
        cell_fluid=mesh.fluid,
        **({} if laws is None else {"laws": laws}),
        poses=np.vstack([*(part.poses for part in state.parts.values()), np.reshape(tank, (-1, 3))]),
        shut=tuple(number for part in state.parts.values() for number in part.shut(simulation.case, state.time)),
    )


def describe(case: Case, out: Path | None) -> dict[str, Any]:
    """Description of a case and its results folder for a `LiveSource`, as JSON."""
    lawful = any(isinstance(fluid.viscosity, Law) for fluid in case.fluids)  # a law has no one number to slide
    return {
        "name": out.resolve().name if out else "run",
        "folder": str(out) if out else None,
        **case_facts(case),
        "limits": limits(case),
        "steered": {
            **steered(case),
            "viscosity": [] if Viscosity.refused(case) or lawful else list(map(typical_viscosity, case.fluids)),
            "tension": tensions(case),
            "wall": [
                {"name": wall.name, "value": float(wall.speed(0.0)), "slides": wall.motion is None}
                for wall in steered_walls(case)
            ],
        },
    }
