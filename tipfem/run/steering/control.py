"""RunControl: pause, single steps, going on and stopping, between the steps of a run."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from tipfem.run.steering.commands import Advance, Again, Command, Go, Pause, Stop, Undo
from tipfem.step.observer import Observer

if TYPE_CHECKING:
    from tipfem.step.stepper import Stepper  # which starts Taichi

WAIT = 0.05  # longest wait for a command while paused, after which signals are looked at again [s]


class RunControl(Observer):
    """Takes commands between the steps of a run, whose steps wait while it is ``paused``.

    ``receive`` takes a time to wait [s], 0 for none, and gives the commands that have come since; by default none ever
    come. ``report`` is called with a line when one is refused. The run is to end if ``stopped``, and to begin anew then
    if ``again``.
    """

    def __init__(
        self,
        receive: Callable[[float], Sequence[Command]] = lambda _: (),
        *,
        paused: bool = False,
        report: Callable[[str], None] = lambda _: None,
    ) -> None:
        self._receive, self._report = receive, report
        self._steps_left = 0  # single steps still to be taken while paused
        self.paused, self.stopped, self.again = paused, False, False

    @property
    def waits(self) -> bool:
        """Whether no step is to be taken now."""
        return self.paused and not self._steps_left

    def ready(self, flow: Stepper, steer: Callable[[Command], None]) -> bool:
        """Carry out commands that have come, in a pause waiting for them; whether the next step is to be taken now."""
        if self.waits:
            self.idle(flow)
        delay = 0.0 if self._steps_left else self.delay()
        self._take(steer, WAIT if self.waits else min(delay, WAIT))
        if self.waits or self.stopped or delay > WAIT:
            return False
        self._steps_left = max(self._steps_left - 1, 0)
        return True

    def delay(self) -> float:
        """Seconds by the clock for which the next step is to wait, so that a run is not faster than it is to be."""
        return 0.0

    def go_back(self) -> None:
        """Undo the last command to the physics; `ValueError` if there is none."""
        raise ValueError("undo: this run keeps no states to go back to")

    def idle(self, flow: Stepper) -> None:
        """The run waits; for what shows the run."""

    def _take(self, steer: Callable[[Command], None], wait: float) -> None:
        for command in self._receive(wait):
            try:
                if isinstance(command, Pause):
                    self.paused, self._steps_left = True, 0
                elif isinstance(command, Go):
                    self.paused = False
                elif isinstance(command, Advance):
                    self.paused, self._steps_left = True, self._steps_left + command.count
                elif isinstance(command, Undo):
                    self.go_back()
                elif isinstance(command, Stop | Again):
                    self.stopped, self.again = True, isinstance(command, Again)
                else:
                    steer(command)
            except ValueError as error:
                self._report(str(error))
