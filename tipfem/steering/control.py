"""RunControl: pause, single steps, going on and stopping, between the steps of a run."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol

from tipfem.steering.commands import Advance, Command, Go, Pause, Stop

WAIT = 0.05  # longest wait for a command while paused, after which signals are looked at again [s]


class Steered(Protocol):
    """What takes the commands that change the physics; see `tipfem.Simulation`."""

    def steer(self, command: Command) -> None:
        """Give a command."""


class RunControl:
    """Takes commands between the steps of a run.

    Args:
        receive: function of a time to wait [s], 0 for none, to the commands that have come since the last call.
        paused: whether the run begins with a pause.
        report: called with a line when a command is refused.

    Attributes:
        paused: whether steps wait.
        stopped: whether the run is to end.
    """

    def __init__(
        self,
        receive: Callable[[float], Sequence[Command]],
        *,
        paused: bool = False,
        report: Callable[[str], None] = lambda _: None,
    ) -> None:
        self._receive, self._report = receive, report
        self._steps_left = 0  # single steps still to be taken while paused
        self.paused, self.stopped = paused, False

    @property
    def waits(self) -> bool:
        """Whether no step is to be taken now."""
        return self.paused and not self._steps_left

    def before_step(self, simulation: Steered, interrupted: Callable[[], bool]) -> bool:
        """Carry out the commands that have come, and wait while the run is paused.

        Args:
            simulation: takes the commands that change the physics.
            interrupted: whether the process has been told to stop.

        Returns:
            Whether the next step is to be taken; if not, the run ends.
        """
        self._take(simulation, 0.0)
        while self.waits and not self.stopped and not interrupted():
            self.idle(simulation)
            self._take(simulation, WAIT)
        if self.stopped or interrupted():
            return False
        self._steps_left = max(self._steps_left - 1, 0)
        return True

    def after_step(self, simulation: Steered) -> None:
        """A step has been taken; for what shows the run."""

    def idle(self, simulation: Steered) -> None:
        """The run waits; for what shows the run."""

    def finished(self, simulation: Steered, status: str) -> None:
        """The run has ended; for what shows the run."""

    def _take(self, simulation: Steered, wait: float) -> None:
        for command in self._receive(wait):
            try:
                if isinstance(command, Pause):
                    self.paused, self._steps_left = True, 0
                elif isinstance(command, Go):
                    self.paused = False
                elif isinstance(command, Advance):
                    self.paused, self._steps_left = True, self._steps_left + command.count
                elif isinstance(command, Stop):
                    self.stopped = True
                else:
                    simulation.steer(command)
            except ValueError as error:
                self._report(str(error))
